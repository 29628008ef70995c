"""What came from ROS 2: joint states and trajectories, checked before anything is done with them."""

from tarc.core.optional import require

require("ros2", "ROS 2 over DDS", "cyclonedds", "rosbags")

import time
from collections.abc import Sequence

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.runtime.online import checked_points
from tarc.runtime.ros2_types import JointState, JointTrajectory, decoded
from tarc.signals.trajectory_message import TrajectoryPoints

COUNTED = ("malformed", "strangers", "stale", "unsent", "refused")
"""Events that are counted."""
SILENCE = 1.0
"""Time without a joint state after which another sender may take over [s]."""


class Inbox:
    """The newest joint state and trajectory.

    Parameters
    ----------
    joint_names
        Names of the law's joints, in its order.

    Attributes
    ----------
    counts
        Messages that were malformed, of strangers or stale, commands that were not sent, trajectories that were
        refused.
    effort
        Torque of the newest joint state [N m or N], shape (n,), NaN where a joint has none.
    stamp
        Stamp of the newest joint state [s]; NaN without one.
    other_names
        Joints of a message that lacks those of the robot.
    refusal
        Why the last trajectory was refused.
    """

    def __init__(self, joint_names: Sequence[str]):
        self._joint_names = tuple(joint_names)
        self.counts: dict[str, int] = dict.fromkeys(COUNTED, 0)
        self.stamp = np.nan
        self.other_names: tuple[str, ...] = ()
        self.refusal = ""
        self._names: list[str] | None = None
        self._order: list[int] = []
        self._sender: int | None = None
        self._last_state = -np.inf
        self._position = np.full(len(self._joint_names), np.nan)
        self.effort = self._position
        self._is_new = False

    def position(self) -> Array | None:
        """Return the newest position (n,), in the law's order; None where none came since the call before."""
        if not self._is_new:
            return None
        self._is_new = False
        return self._position

    def take_state(self, data: bytes, sender: int) -> None:
        """Take the bytes of a joint state from a sender, by its handle."""
        message = decoded(JointState, data)
        lengths = (0, len(message.name)) if message is not None else ()
        if message is None or len(message.position) != len(message.name) or len(message.effort) not in lengths:
            self.counts["malformed"] += 1
            return
        now = time.monotonic()
        is_other = sender != self._sender and now - self._last_state < SILENCE
        if is_other or (message.name != self._names and not self._find_joints(message.name)):
            self.counts["strangers"] += 1
            return
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if stamp > 0 and sender == self._sender and stamp <= self.stamp:
            self.counts["stale"] += 1
            return
        self._sender, self._last_state = sender, now
        self.stamp = stamp if stamp > 0 else np.nan
        self._position = np.array([message.position[i] for i in self._order])
        self.effort = np.array([message.effort[i] if message.effort else np.nan for i in self._order])
        self._is_new = True

    def _find_joints(self, names: list[str]) -> bool:
        """Note where a message has the joints; return whether it has each once."""
        if any(names.count(name) != 1 for name in self._joint_names):
            self.other_names = tuple(names)
            return False
        self._names = list(names)
        self._order = [names.index(name) for name in self._joint_names]
        return True

    def trajectory(self, data: bytes) -> TrajectoryPoints | None:
        """Return the trajectory of some bytes; None for one that is malformed or does not fit, which is counted."""
        message = decoded(JointTrajectory, data)
        if message is None:
            self.counts["malformed"] += 1
            return None
        try:
            return checked_points(_points(message), self._joint_names)
        except InvalidParameter as error:
            self.counts["refused"] += 1
            self.refusal = str(error)
            return None


def _points(message: JointTrajectory) -> TrajectoryPoints:
    """Return the points of a message, NaN where a point has no velocities or accelerations.

    Raises
    ------
    InvalidParameter
        For points with another number of numbers than one per joint.
    """
    n, rows = len(message.joint_names), []
    for point in message.points:
        row = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec]
        for name in ("positions", "velocities", "accelerations"):
            values = list(getattr(point, name))
            if len(values) != n and (values or name == "positions"):
                raise InvalidParameter(f"joint_trajectory: a point has {len(values)} {name} for {n} joints")
            row += values or [np.nan] * n
        rows.append(row)
    table = np.array(rows, dtype=float).reshape(len(rows), 1 + 3 * n)
    return TrajectoryPoints(list(message.joint_names), table[:, 0], *np.hsplit(table[:, 1:], 3))
