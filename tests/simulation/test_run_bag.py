"""Runs as ROS 2 bags: read by mcap and by rosbags, and followed as references."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tarc.core.errors import InvalidParameter
from tarc.scenario.model import Scenario
from tarc.signals import JointTrajectory, RecordedReference
from tarc.signals.log_file import read_log
from tarc.signals.ros2_messages import DEFINITIONS, JOINT_STATE, JOINT_TRAJECTORY
from tarc.simulation.run import Run

JOINTS = ["elbow", "wrist"]
N = 50


@pytest.fixture
def run():
    rng = np.random.default_rng(1)
    time = 0.002 * np.arange(N)
    keys = ("position", "measured_position", "velocity", "velocity_estimate", "torque", "acceleration")
    variables: dict[str, Any] = {key: (("time", "joint"), rng.standard_normal((N, 2))) for key in keys}
    variables["reference"] = (("time", "joint"), np.column_stack([np.sin(3 * time), np.cos(2 * time)]))
    variables["velocity_reference"] = (
        ("time", "joint"),
        np.column_stack([3 * np.cos(3 * time), -2 * np.sin(2 * time)]),
    )
    second = np.column_stack([-9 * np.sin(3 * time), -4 * np.cos(2 * time)])
    variables["acceleration_reference"] = (("time", "joint"), second)
    variables["gain"] = (("time",), rng.standard_normal(N))
    variables["torque_limit"] = (("joint",), np.array([1.0, 2.0]))
    coordinates = {"time": time, "joint": JOINTS, "joint_unit": ("joint", ["rad", "rad"])}
    return Run(xr.Dataset(variables, coordinates, {"divergence_time": np.nan}))


def write_states(path, names, rows, *, trajectories=0):
    """Write joint states with stamps of 10 ms, and trajectories of two points."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in DEFINITIONS.items()}
        for k, row in enumerate(rows):
            stamp = {"sec": 100, "nanosec": 10_000_000 * k}
            message = {"header": {"stamp": stamp, "frame_id": ""}, "name": names, "position": list(row)}
            message |= {"velocity": [], "effort": []}
            writer.write_message("/joint_states", schemas[JOINT_STATE], message, k, k)
        for k in range(trajectories):
            points = [
                {"positions": [t, -t], "velocities": [], "accelerations": [], "effort": [], "time_from_start": stamp}
                for t, stamp in ((0.0, {"sec": 0, "nanosec": 0}), (2.0, {"sec": 1, "nanosec": 0}))
            ]
            header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
            message = {"header": header, "joint_names": names[:2], "points": points}
            writer.write_message("/plan", schemas[JOINT_TRAJECTORY], message, k, k)
        writer.finish()
    return path


def test_a_run_is_read_by_mcap_and_by_rosbags(run, tmp_path):
    data = run.data
    path = run.save(tmp_path / "run.mcap")
    assert [file.name for file in tmp_path.iterdir()] == ["run.mcap"]
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        states = [row for *_, row in reader.iter_decoded_messages(topics=["/joint_states"])]
    assert list(states[3].name) == JOINTS
    np.testing.assert_array_equal([list(row.position) for row in states], data["measured_position"])
    np.testing.assert_array_equal([list(row.velocity) for row in states], data["velocity_estimate"])
    np.testing.assert_array_equal([list(row.effort) for row in states], data["torque"])
    found = {}
    with AnyReader([path]) as bag:
        for connection, time, raw in bag.messages():
            found.setdefault(connection.topic, []).append((time, bag.deserialize(raw, connection.msgtype)))
    assert set(found) == {
        "/joint_states",
        "/true_joint_states",
        "/joint_trajectory",
        "/tarc/gain",
        "/tarc/acceleration",
    }
    assert [time for time, _ in found["/tarc/gain"]] == [2_000_000 * k for k in range(N)]
    np.testing.assert_array_equal([row.data[0] for _, row in found["/tarc/gain"]], data["gain"])
    np.testing.assert_array_equal([row.position for _, row in found["/true_joint_states"]], data["position"])
    (_, trajectory), *more = found["/joint_trajectory"]
    assert more == []
    np.testing.assert_array_equal([point.positions for point in trajectory.points], data["reference"])


def test_the_reference_of_a_run_is_followed_again(run, tmp_path):
    data = run.data
    path = run.save(tmp_path / "run.mcap")
    again = JointTrajectory(path=path).for_run(JOINTS[::-1], 0.1)
    found = again.sample(data["time"].values)
    for key, values in zip(("reference", "velocity_reference", "acceleration_reference"), found, strict=True):
        np.testing.assert_allclose(values[::-1].T, data[key], atol=1e-9)
    log = read_log(path)  # of /joint_states, though there are others
    np.testing.assert_array_equal(log.position, data["measured_position"])


def test_joint_states_of_a_robot_with_a_gripper_are_a_reference(tmp_path):
    rows = np.random.default_rng(0).standard_normal((20, 3))
    path = write_states(tmp_path / "a.mcap", ["gripper", "wrist", "elbow"], rows)
    reference = RecordedReference(path=path).for_run(JOINTS, 0.1)
    assert reference.n_joints == 2
    np.testing.assert_allclose(reference.sample(0.01 * np.arange(20))[0].T, rows[:, [2, 1]], atol=1e-8)
    with pytest.raises(
        InvalidParameter, match="has the columns gripper, wrist, elbow; the robot's joints are shoulder"
    ):
        RecordedReference(path=path).for_run(["shoulder", "wrist"], 0.1)


def test_scenarios_follow_bags(tmp_path):
    names = Scenario.load("ur5e").build().plant.joint_names
    rows = np.zeros((30, 6)) + np.linspace(0, 0.1, 30)[:, None]
    path = write_states(tmp_path / "a.mcap", list(names), rows)
    loaded = Scenario.load("ur5e", reference=path)
    assert loaded.reference == {"kind": "RecordedReference", "path": str(path)}
    assert loaded.duration == 0.29
    assert Scenario.load("ur5e", ["duration=0.2"], reference=path).duration == 0.2
    plan = write_states(tmp_path / "plan.mcap", list(names), rows, trajectories=1)
    assert Scenario.load("ur5e", reference=plan).reference["kind"] == "JointTrajectory"


def test_bags_that_are_no_reference_are_refused(tmp_path):
    two = write_states(tmp_path / "two.mcap", JOINTS, np.zeros((9, 2)), trajectories=2)
    with pytest.raises(InvalidParameter, match="has 2 trajectories; needs one"):
        JointTrajectory(path=two)
    few = write_states(tmp_path / "few.mcap", JOINTS, np.zeros((3, 2)))
    with pytest.raises(InvalidParameter, match="fewer|at least 6"):
        RecordedReference(path=few)
    with pytest.raises(InvalidParameter, match="no topic with trajectories; needs one topic of trajectories"):
        JointTrajectory(path=few)
    for content in (b"", b"no bag at all", few.read_bytes()[:300]):
        broken = tmp_path / "broken.mcap"
        broken.write_bytes(content)
        with pytest.raises(InvalidParameter, match="does not read as MCAP"):
            Scenario.load("ur5e", reference=broken)
    with pytest.raises(InvalidParameter, match="no bag"):
        Scenario.load("ur5e", reference=tmp_path / "none.mcap")


@pytest.mark.parametrize("store", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_definitions_are_those_of_ros(store):
    theirs = get_typestore(store)
    for kind, text in DEFINITIONS.items():
        for name, fields in get_types_from_msg(text, kind).items():
            assert fields[1] == theirs.fielddefs[name][1]


def test_the_suffix_decides(run, tmp_path):
    assert Run.load(run.save(tmp_path / "run.nc")).data.sizes["time"] == N
    with pytest.raises(InvalidParameter, match="no netCDF"):
        Run.load(run.save(tmp_path / "run.mcap"))
    assert Path(tmp_path / "run.mcap").is_file()
