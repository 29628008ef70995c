"""ROS 2 over DDS: bytes and hashes of ROS, what is taken and what is counted, and a loop with a peer."""

import os
import threading
import time
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

os.environ.setdefault(
    "CYCLONEDDS_URI",
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<Peers><Peer Address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>",
)

from cyclonedds.core import DDSException, Policy
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

import tarc
from reference.malformed_messages import damaged
from tarc.core.errors import InvalidParameter
from tarc.runtime import SafetyLimits, SimulatedClock, StartUp, run_live
from tarc.runtime.dds import DdsRobot
from tarc.runtime.online import OnlineReference
from tarc.runtime.ros2_inbox import Inbox
from tarc.runtime.ros2_types import (
    ROS_NAMES,
    Duration,
    Float64MultiArray,
    Header,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    MultiArrayDimension,
    MultiArrayLayout,
    Received,
    Time,
    decoded,
    encoded,
    quality_of_service,
    type_hash,
)
from tarc.signals.joint_trajectory import hermite_curve

JOINTS = ("shoulder", "elbow")
HASHES = {
    JointState: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    JointTrajectory: "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
    Float64MultiArray: "RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f",
}


def random_messages(rng):
    """Return messages with texts and lists of every length, so that every alignment occurs."""

    def numbers():
        return rng.standard_normal(rng.integers(0, 4)).tolist()

    def text():
        return "joint_ß"[: rng.integers(0, 8)]

    header = Header(Time(int(rng.integers(-5, 2**31)), int(rng.integers(0, 10**9))), text())
    points = [
        JointTrajectoryPoint(numbers(), numbers(), numbers(), numbers(), Duration(int(rng.integers(0, 9)), k))
        for k in range(rng.integers(0, 3))
    ]
    names = [text() for _ in range(rng.integers(0, 4))]
    layout = MultiArrayLayout([MultiArrayDimension(text(), 3, 4)] * int(rng.integers(0, 3)), 7)
    return [
        JointState(header, names, numbers(), numbers(), numbers()),
        JointTrajectory(header, names, points),
        Float64MultiArray(layout, numbers()),
    ]


def in_ros(store, message):
    """Return a message as the class of rosbags."""
    name = type(message).__idl_typename__.replace("::", "/").replace("/dds_", "").removesuffix("_")
    fields = {}
    for key in type(message).__dataclass_fields__:
        value = getattr(message, key)
        if hasattr(value, "__idl_typename__"):
            value = in_ros(store, value)
        elif isinstance(value, list) and value and hasattr(value[0], "__idl_typename__"):
            value = [in_ros(store, one) for one in value]
        elif isinstance(value, list) and not (value and isinstance(value[0], str)):
            is_numbers = key not in ("name", "joint_names", "points", "dim")
            value = np.array(value, dtype=float) if is_numbers else value
        fields[key] = value
    return store.types[name](**fields)


@pytest.mark.parametrize("version", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_the_bytes_are_those_of_ros(version):
    store, rng = get_typestore(version), np.random.default_rng(0)
    for _ in range(40):
        for message in random_messages(rng):
            data = encoded(message)
            assert data == bytes(store.serialize_cdr(in_ros(store, message), ROS_NAMES[type(message)]))
            assert decoded(type(message), data) == message
    for kind, expected in HASHES.items():
        assert store.hash_rihs01(ROS_NAMES[kind]) == expected


def test_endpoints_are_as_ros_has_them():
    for kind, expected in HASHES.items():
        assert type_hash(kind) == expected
        quality = quality_of_service(kind)
        userdata = quality[Policy.Userdata]
        assert userdata is not None
        assert userdata.data == f"typehash={expected};".encode()
        assert quality[Policy.History] == Policy.History.KeepLast(10)
        assert isinstance(quality[Policy.Reliability], Policy.Reliability.Reliable)
    assert JointState.__idl_typename__ == "sensor_msgs::msg::dds_::JointState_"


def state(time, positions, names=("gripper", "elbow", "shoulder")):
    stamp = Time(int(time), round(1e9 * (time - int(time))))
    return JointState(Header(stamp), list(names), list(positions))


def test_what_is_taken_and_what_is_counted():
    inbox = Inbox(JOINTS)
    inbox.take_state(encoded(JointState()), 1)  # of no joint
    assert inbox.position() is None
    inbox.take_state(encoded(state(1.0, [7.0, 0.2, 0.1])), 1)
    np.testing.assert_array_equal(inbox.position(), [0.1, 0.2])
    assert inbox.position() is None
    inbox.take_state(encoded(state(2.0, [7.0, 0.3, 0.1])), 2)  # another sender
    inbox.take_state(encoded(state(2.0, [7.0, 0.3, 0.1], ["gripper", "wrist", "shoulder"])), 1)
    inbox.take_state(encoded(state(2.0, [7.0, 0.3, 0.1], ["elbow", "elbow", "shoulder"])), 1)
    inbox.take_state(encoded(state(1.0, [7.0, 0.3, 0.1])), 1)
    inbox.take_state(encoded(state(2.0, [7.0, 0.3])), 1)
    inbox.take_state(encoded(state(2.0, [7.0, 0.3, 0.1]))[:-9], 1)
    assert inbox.position() is None
    assert inbox.counts == {"malformed": 2, "strangers": 4, "stale": 1, "unsent": 0, "refused": 0}
    inbox.take_state(encoded(state(2.0, [7.0, np.nan, 0.4])), 1)
    np.testing.assert_array_equal(inbox.position(), [0.4, np.nan])


def test_trajectories_that_do_not_fit_are_refused():
    inbox = Inbox(JOINTS)

    def trajectory(names, *points):
        rows = [JointTrajectoryPoint(q, dq, ddq, [], Duration(0, round(1e9 * at))) for at, q, dq, ddq in points]
        return inbox.trajectory(encoded(JointTrajectory(Header(), list(names), rows)))

    taken = trajectory(("elbow", "shoulder"), (0.5, [1.0, 2.0], [3.0, 4.0], []))
    assert taken is not None
    np.testing.assert_array_equal(taken.positions, [[2.0, 1.0]])
    np.testing.assert_array_equal(taken.velocities, [[4.0, 3.0]])
    assert np.all(np.isnan(taken.accelerations))
    for names, points, reason in (
        (("elbow", "wrist"), [(0.5, [1.0, 2.0], [], [])], "needs shoulder, elbow"),
        (JOINTS, [(0.5, [1.0], [], [])], "1 positions for 2 joints"),
        (JOINTS, [(0.5, [1.0, 2.0], [1.0], [])], "1 velocities for 2 joints"),
        (JOINTS, [(0.5, [1.0, 2.0], [], []), (0.5, [1.0, 2.0], [], [])], "times that increase"),
        (JOINTS, [(0.0, [1.0, 2.0], [], [])], "is a jump"),
        (JOINTS, [(0.5, [1.0, np.inf], [], [])], "not finite"),
        (JOINTS, [], "needs points"),
    ):
        assert trajectory(names, *points) is None
        assert reason in inbox.refusal
    assert inbox.counts["refused"] == 7


def test_an_online_reference_follows_what_comes():
    reference = OnlineReference(position=[0.1, -0.2])
    motion = reference.motion(100, 0.01)
    assert len(motion) == 100
    np.testing.assert_array_equal(motion.at(9)[0], [0.1, -0.2])
    inbox = Inbox(JOINTS)
    rows = [JointTrajectoryPoint([0.5, 0.3], [0.0, 0.4], [], [], Duration(0, 305_000_000))]
    points = inbox.trajectory(encoded(JointTrajectory(Header(), list(JOINTS), rows)))
    assert points is not None
    reference.incoming.append(points)
    zero = [0.0, 0.0]
    curve = hermite_curve(
        np.array([0, 0.305]), np.array([[0.1, -0.2], [0.5, 0.3]]), np.array([zero, [0, 0.4]]), np.full((2, 2), np.nan)
    )
    for k in range(10, 45):
        found, time = motion.at(k), (k - 10) * 0.01
        for order in range(3):
            expected = curve(min(time, 0.305), order) if time < 0.305 or order == 0 else zero
            np.testing.assert_allclose(found[order], expected, atol=1e-12)


def fuzz(count, seed=0):
    """Yield bytes of messages that are cut, changed or absurd, and some that are right."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        names = ("elbow", "shoulder") if k % 3 else ("elbow", "wrist", "shoulder")
        yield damaged(rng, encoded(state(1 + 1e-3 * k, rng.standard_normal(len(names)), names)))


def test_a_flood_of_nonsense_gives_no_nonsense():
    law = make_law()
    controller, inbox, taken = tarc.Controller(law), Inbox(JOINTS), 0
    controller.reset(np.zeros(2))
    for data in fuzz(600):
        inbox.take_state(data, 1)
        inbox.trajectory(data)
        position = inbox.position()
        taken += position is not None
        torque = controller.step(np.full(2, np.nan) if position is None else position, *np.zeros((3, 2)))
        assert np.all(np.abs(torque) <= law.torque_limits)
    assert inbox.counts["malformed"] > 300
    assert taken > 50


def make_law():
    return tarc.laws.TDC(
        inertia=[0.03, 0.03],
        natural_frequency=8.0,
        period=0.002,
        estimator=tarc.estimators.Algebraic(window=0.012),
        torque_limit=[20.0, 10.0],
        max_missing=100,
    )


class Peer:
    """A robot of two joints that speaks as ROS does, in a thread: a step per command, so that load does not matter."""

    def __init__(self, domain, period=0.002, names=("gripper", "elbow", "shoulder")):
        self.names, self.period, self.states = names, period, np.zeros((2, 2))
        participant = DomainParticipant(domain)
        self.state = self.writer(participant, "rt/joint_states", JointState)
        self.trajectory = self.writer(participant, "rt/tarc/joint_trajectory", JointTrajectory)
        topic = Topic(participant, "rt/effort_controller/commands", Float64MultiArray)
        self.command = DataReader(participant, topic, qos=quality_of_service(Float64MultiArray))
        self.stop = threading.Event()
        self.torques = []
        self.thread = threading.Thread(target=self.run)

    @staticmethod
    def writer(participant, topic, kind):
        quality = quality_of_service(kind)
        return DataWriter(participant, Topic(participant, topic, kind, qos=quality), qos=quality)

    def run(self):
        begin, k, last = time.time(), 0, 0.0
        take: Any = self.command.take  # its messages are bytes
        while not self.stop.is_set():
            commands = [decoded(Float64MultiArray, one.data) for one in take(N=1) if isinstance(one, Received)]
            for command in commands:
                assert command is not None
                self.torques.append(np.array(command.data))
                position, velocity = self.states
                velocity += (10 * self.torques[-1] - 0.5 * velocity) * self.period
                position += velocity * self.period
            if commands or time.time() - last > (IDLE if self.torques else self.period):
                k, last = k + 1, time.time()
                position = self.states[0]
                self.state.write(state(begin + k * self.period, [7.0, position[1], position[0]], self.names))
            self.stop.wait(1e-4)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.stop.set()
        self.thread.join()


IDLE = 0.3
"""Time after which a state comes without a command [s]."""


class StepRobot(DdsRobot):
    """A robot whose states are waited for."""

    def read(self):
        end = time.monotonic() + 100 * IDLE
        while np.all(np.isnan(position := super().read())) and time.monotonic() < end:
            time.sleep(1e-4)
        return position


DOMAIN = 101 + os.getpid() % 100


@pytest.mark.slow
def test_a_law_runs_a_robot_over_dds():
    law = make_law()
    with Peer(DOMAIN) as peer, StepRobot(JOINTS, domain=DOMAIN, timeout=30.0) as robot:
        reference = robot.reference = OnlineReference(position=[0.0, 0.0])
        points = [JointTrajectoryPoint([0.2, 0.1], [0.0, 0.0], [0.0, 0.0], [], Duration(1, 0))]
        message = JointTrajectory(Header(), ["elbow", "shoulder"], points)
        result = run_live(
            law,
            robot,
            reference,
            1.5,
            limits=SafetyLimits(error=0.5),
            start_up=StartUp(hold_time=0.1, ramp_time=0.1, brake_time=0.05),
            watchdog=60.0,
            clock=SimulatedClock(),
            on_log=lambda _: peer.trajectory.write(message),
        )
        position = peer.states[0].copy()
    assert result.ended == "completed"
    np.testing.assert_allclose(position, [0.1, 0.2], atol=0.02)
    assert np.all(peer.torques[-1] == 0)
    assert result.counts["malformed"] == result.counts["refused"] == 0


def refusal_of_strangers(domain: int) -> str:
    """Return why a robot with other joints is refused; a busy machine may take long to find it."""
    text = ""
    for timeout in (1.0, 5.0, 30.0):
        with pytest.raises(InvalidParameter) as refused:
            DdsRobot(JOINTS, domain=domain, timeout=timeout)
        text = str(refused.value)
        if "nothing at all" not in text:
            break
    return text


@pytest.mark.slow
def test_robots_that_do_not_fit_are_refused(monkeypatch):
    domain = DOMAIN + 1
    with Peer(domain, names=("gripper", "elbow", "wrist")):
        assert "one had the joints gripper, elbow, wrist" in refusal_of_strangers(domain)
    with Peer(domain + 1, period=0.04), pytest.raises(InvalidParameter, match="come at 25 Hz; the law is for 200 Hz"):
        DdsRobot(JOINTS, period=0.005, domain=domain + 1, timeout=30.0)
    with pytest.raises(InvalidParameter, match="nothing at all"):
        DdsRobot(JOINTS, domain=domain + 2, timeout=0.2)
    with pytest.raises(InvalidParameter, match="domain"):
        DdsRobot(JOINTS, domain=900)
    interface = (
        "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='none'/></Interfaces></General></Domain>"
    )
    monkeypatch.setenv("CYCLONEDDS_URI", f"{interface}</CycloneDDS>")
    with pytest.raises(InvalidParameter, match="cannot join domain"):
        DdsRobot(JOINTS, domain=domain + 3)


@pytest.mark.slow
def test_nonsense_over_the_wire_changes_nothing():
    with Peer(DOMAIN + 5) as peer, DdsRobot(JOINTS, domain=DOMAIN + 5) as robot:
        stranger = Peer.writer(DomainParticipant(DOMAIN + 5), "rt/joint_states", JointState)
        for data in fuzz(300):
            message: Any = JointState()
            message.serialize = lambda data=data, **_: data
            try:
                stranger.write(message)
            except DDSException:  # Cyclone itself refuses most of it
                continue
            position = robot.read()
            assert np.all(np.isnan(position) | (position == peer.states[0]))
        end = time.monotonic() + 60
        is_taken = False
        while not (is_taken and robot.counts["strangers"] > 20):  # the peer may be silent while the nonsense comes
            assert time.monotonic() < end
            position = robot.read()
            assert np.all(np.isnan(position) | (position == peer.states[0]))
            is_taken |= bool(np.all(np.isfinite(position)))
            time.sleep(0.005)
