"""ROS 2 over DDS: nonsense by the million, and a law at 1 kHz against a robot in MuJoCo in a second process.

python -m benchmarks.ros2 [SECONDS] [MESSAGES]
"""

import logging
import os
import subprocess
import sys
import time

import numpy as np

import tarc
from reference.malformed_messages import damaged
from tarc.runtime.ros2_inbox import Inbox
from tarc.runtime.ros2_types import Header, JointState, Time, encoded

LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<Peers><Peer Address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>"
)
JOINTS = ("shoulder", "elbow")
MAX_MISSING = 50
"""Samples in a row that the law bridges: on a machine shared with others a process may stand still for 10 ms."""
KNOWN = 512
"""Right messages, of which the others are made."""


def fuzz(count: int) -> None:
    """Take messages, most of them malformed, and step a law on what is left of them."""
    logging.getLogger("tarc").setLevel(logging.CRITICAL)
    rng = np.random.default_rng(0)
    law = tarc.laws.TDC(
        inertia=[0.1, 0.1],
        natural_frequency=10.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.010),
        torque_limit=[20.0, 10.0],
    )
    right = [
        encoded(JointState(Header(Time(k + 1)), ["elbow", "shoulder"], rng.standard_normal(2).tolist()))
        for k in range(KNOWN)
    ]
    controller, inbox, taken, worst = tarc.Controller(law), Inbox(JOINTS), 0, 0.0
    controller.reset(np.zeros(2))
    nothing, zero, begin = np.full(2, np.nan), np.zeros(2), time.perf_counter()
    for k in range(count):
        if k % KNOWN == 0:
            inbox = _restarted(inbox)
        data = damaged(rng, right[k % KNOWN])
        inbox.take_state(data, 1)
        inbox.trajectory(data)
        position = inbox.position()
        taken += position is not None
        torque = controller.step(nothing if position is None else position, zero, zero, zero)
        if controller.fault:
            controller.reset(zero)
        share = float(np.max(np.abs(torque) / law.torque_limits))
        worst = max(worst, share)
        if not share <= 1:
            raise SystemExit(f"message {k}: torque {torque} beyond {law.torque_limits}")
    per_message = 1e6 * (time.perf_counter() - begin) / count
    print(f"{count} messages: {taken} taken, {inbox.counts}; largest torque {worst:.3g} of its limit")
    print(f"{per_message:.0f} µs per message and step")


def _restarted(inbox: Inbox) -> Inbox:
    """Return an inbox that takes stamps from the start on, with the counts so far."""
    fresh = Inbox(JOINTS)
    fresh.counts = inbox.counts
    return fresh


def peer(seconds: float) -> int:
    """Run a law over DDS against a robot in a second process."""
    environment = {"CYCLONEDDS_URI": LOOPBACK, "ROS_DOMAIN_ID": "77"} | os.environ
    command = [sys.executable, "-m", "tarc", "ros2"]
    robot = subprocess.Popen([*command, "simulate", "ur5e"], env=environment)
    try:
        options = ["--law", "TARC", "--set", f"law.max_missing={MAX_MISSING}"]
        options += ["--duration", str(seconds), "--timeout", "30"]
        return subprocess.run([*command, "run", "ur5e", *options], env=environment, check=False).returncode
    finally:
        robot.kill()
        robot.wait()


def main() -> int:
    """Run both."""
    numbers = [float(text) for text in sys.argv[1:]]
    fuzz(int(numbers[1]) if len(numbers) > 1 else 1_000_000)
    return peer(numbers[0] if numbers else 60.0)


if __name__ == "__main__":
    raise SystemExit(main())
