"""A reference that comes while the loop runs: rest, and trajectories one after the other."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.runtime.motion import Motion
from tarc.signals.joint_trajectory import hermite_curve
from tarc.signals.references import Reference
from tarc.signals.trajectory_message import TrajectoryPoints


@dataclass(frozen=True, kw_only=True, eq=False)
class OnlineReference(Reference):
    """Rest at a position, until trajectories come.

    Each begins in the period after it came, at the reference of then, and replaces the one before. Between points it is
    linear, cubic or quintic, as `tarc.signals.JointTrajectory`. After its end the last point is held.

    Parameters
    ----------
    position
        Where it rests at first [rad or m], shape (n,).

    Attributes
    ----------
    incoming
        Where trajectories are put, their joints in the law's order.
    """

    position: Numbers
    incoming: "deque[TrajectoryPoints]" = field(default_factory=deque, init=False, repr=False)

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return np.atleast_1d(check.array("position", self.position)).size

    def sample(self, times: Numbers) -> tuple[Array, Array, Array]:
        """Return rest, each of shape (n, k): what comes later is not known."""
        place = np.repeat(np.atleast_1d(self.position)[:, None], np.size(times), axis=1).astype(float)
        return place, np.zeros_like(place), np.zeros_like(place)

    def motion(self, periods: int, period: float) -> Motion:
        """Return the motion of a number of periods [s], which follows what comes."""
        place = np.atleast_1d(np.array(self.position, dtype=float))[None, :]
        zero = np.zeros_like(place)
        rows = np.repeat(place, 2, axis=0)
        hermite_curve(np.arange(2.0), rows, 0 * rows, 0 * rows)(0.5)  # its libraries are loaded before the loop starts
        follower = _Follower(self.incoming, period, (place[0], zero[0], zero[0]), zero[0])
        return _OnlineMotion(place, zero, zero, follower, periods)


class _Follower:
    """The trajectory that is followed, and where the reference is now, each (n,)."""

    def __init__(
        self, incoming: "deque[TrajectoryPoints]", period: float, now: tuple[Array, Array, Array], offset: Array
    ):
        self.incoming, self.period, self.now, self.offset = incoming, period, now, offset
        self._curve: Callable[..., Array] | None = None
        self._end = 0.0
        self._first = 0

    def at(self, k: int) -> tuple[Array, Array, Array]:
        """Return the rows of a period, each (n,)."""
        while self.incoming:
            self._curve, self._end = online_curve(self.incoming.popleft(), self.offset, self.now)
            self._first = k
        if self._curve is not None:
            time = (k - self._first) * self.period
            curve, inside = self._curve, min(time, self._end)
            zero = np.zeros_like(self.offset)
            self.now = (
                (curve(inside), curve(inside, 1), curve(inside, 2)) if time < self._end else (curve(inside), zero, zero)
            )
        return self.now


@dataclass(frozen=True)
class _OnlineMotion(Motion):
    """The motion, whose rows are computed when they are needed."""

    follower: _Follower
    periods: int

    def __len__(self) -> int:
        return self.periods

    def shifted(self, offset: Array) -> "_OnlineMotion":
        """Return the motion with an offset of its positions (n,)."""
        old = self.follower
        now = old.now[0] + offset, old.now[1], old.now[2]
        follower = _Follower(old.incoming, old.period, now, old.offset + offset)
        return replace(self, position=self.position + offset, follower=follower)

    def at(self, k: int) -> tuple[Array, Array, Array]:
        """Return the rows of a period, each (n,)."""
        return self.follower.at(k)


def online_curve(
    points: TrajectoryPoints, offset: Array, now: tuple[Array, Array, Array]
) -> tuple[Callable[..., Array], float]:
    """Return the curve of a trajectory that begins at a state now, each (n,), and its last time [s]."""
    times, positions = points.times, points.positions + offset
    velocities, accelerations = points.velocities, points.accelerations
    if times[0] > 0:
        times = np.concatenate([[0.0], times])
        positions = np.vstack([now[0], positions])
        velocities = np.vstack([now[1], velocities])
        accelerations = np.vstack([now[2], accelerations])
    return hermite_curve(times, positions, velocities, accelerations), float(times[-1])


def checked_points(points: TrajectoryPoints, joint_names: Sequence[str]) -> TrajectoryPoints:
    """Return points with their joints in the order of some names.

    Raises
    ------
    InvalidParameter
        For other joints, no point, numbers that are not finite, and times that do not increase.
    """
    names = points.joint_names
    if sorted(names) != sorted(joint_names):
        raise InvalidParameter(
            f"joint_trajectory: got the joints {', '.join(names) or 'none'}; needs {', '.join(joint_names)}",
            "joint_trajectory",
        )
    order = [names.index(name) for name in joint_names]
    times = points.times
    if len(times) < 1 or not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0) or times[0] < 0:
        raise InvalidParameter("joint_trajectory: needs points at times that increase from 0 on", "joint_trajectory")
    if len(times) == 1 and times[0] <= 0:
        raise InvalidParameter(
            "joint_trajectory: one point at time 0 is a jump; give it a later time", "joint_trajectory"
        )
    if not np.all(np.isfinite(points.positions)):
        raise InvalidParameter("joint_trajectory: a position is not finite", "joint_trajectory")
    tables = (points.positions, points.velocities, points.accelerations)
    return TrajectoryPoints(list(joint_names), times, *(table[:, order] for table in tables))
