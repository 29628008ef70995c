"""Trajectories as ROS sends them to its ``joint_trajectory_controller``."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.signals.references import PolynomialPieces, Reference, sample_curve
from tarc.signals.trajectory_file import check_overlap
from tarc.signals.trajectory_message import TrajectoryPoints, read_points


@dataclass(frozen=True, kw_only=True, eq=False)
class JointTrajectory(Reference):
    """Trajectory of a ROS message ``trajectory_msgs/JointTrajectory``, interpolated as ROS does.

    Between two points the position is linear in time. It is cubic where both have velocities, and quintic where both
    have velocities and accelerations. These are met exactly at the points.

    Parameters
    ----------
    path
        YAML as ``ros2 topic echo --once --full-length`` prints it (``joint_names``, and ``points`` with
        ``positions``, ``velocities``, ``accelerations``, ``time_from_start``), with the suffix ``.yaml`` or ``.json``.
        Also a ``RobotTrajectory`` of MoveIt, or a goal of ``FollowJointTrajectory``, that holds one. Or CSV with the
        columns ``time``, ``elbow``, ``elbow/velocity``, ``elbow/acceleration``, …, derivatives where known. Or a ROS 2
        bag ``.mcap`` with one such message.
        Units: s, rad or m, /s, /s².
    starts_at_zero
        Whether times count from the first point, which is then time 0 of the run. False takes ``time_from_start`` as
        time of the run.
    joint_names
        Names of the file's joints in the order of the robot's joints, where they differ from the robot's own names.
        None takes the robot's.

    Raises
    ------
    InvalidParameter
        For a file that is not as described, and for names that do not fit, with those missing, unknown and repeated.
    MissingTool
        For YAML and bags without the libraries that read them.

    References
    ----------
    ros2_controllers, ``joint_trajectory_controller``, page "Trajectory Representation".
    """

    path: str | Path
    starts_at_zero: bool = True
    joint_names: Sequence[str] | None = None

    def __post_init__(self) -> None:
        _ = self._curve

    @cached_property
    def _points(self) -> TrajectoryPoints:
        return read_points(self.path)

    @cached_property
    def _times(self) -> Array:
        times = self._points.times
        return times - times[0] if self.starts_at_zero else times

    @cached_property
    def _curve(self) -> Callable[..., np.ndarray]:
        points = self._points
        order = list(range(len(points.joint_names)))
        if self.joint_names is not None:
            names = list(self.joint_names)
            _check_names(self.path, points.joint_names, names, "joint_names")
            order = [points.joint_names.index(name) for name in names]
        states = (points.positions, points.velocities, points.accelerations)
        return hermite_curve(self._times, *(state[:, order] for state in states))

    @property
    def end_time(self) -> float:
        """Return the time of the last point [s]."""
        return float(self._times[-1])

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return len(self._points.joint_names)

    def for_run(self, joint_names: Sequence[str], duration: float) -> Reference:
        """Return the reference with its joints in the order of the robot's.

        Raises
        ------
        InvalidParameter
            For other joints than the robot's, and for a trajectory that lies outside the run.
        """
        check_overlap(self.path, self._times[0], self._times[-1], duration)
        if self.joint_names is not None:
            return self
        _check_names(self.path, self._points.joint_names, list(joint_names), "reference")
        return replace(self, joint_names=tuple(joint_names))

    def sample(self, times: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration, each of shape (n, k); held before and after the trajectory."""
        return sample_curve(self._curve, np.asarray(times, dtype=float), self._times[0], self._times[-1])

    def pieces(self) -> PolynomialPieces:
        """Return the polynomials between the points."""
        return PolynomialPieces.from_curve(self._curve, self._times)


def hermite_curve(times: Array, positions: Array, velocities: Array, accelerations: Array) -> Callable[..., np.ndarray]:
    """Return the piecewise polynomial through points (k, n), of a degree by what both ends of a piece have.

    With u the time since the start of a piece of duration h, and Δ = q₁ − q₀:

        linear   q = q₀ + Δ u / h
        cubic    q = q₀ + v₀ u + (3Δ/h − 2v₀ − v₁) u²/h + (v₀ + v₁ − 2Δ/h) u³/h²
        quintic  q = q₀ + v₀ u + a₀ u²/2 + c₃ u³ + c₄ u⁴ + c₅ u⁵, by the state at u = h

    Velocities and accelerations are NaN where there are none.
    """
    from scipy.interpolate import PPoly

    h = np.diff(times)[:, None]
    slope = np.diff(positions, axis=0) / h
    v0, v1 = velocities[:-1], velocities[1:]
    a0, a1 = accelerations[:-1] * h, accelerations[1:] * h
    zero = np.zeros_like(slope)
    start = positions[:-1]
    linear = np.array([zero, zero, zero, zero, slope, start])
    cubic = np.array([zero, zero, (v0 + v1 - 2 * slope) / h**2, (3 * slope - 2 * v0 - v1) / h, v0, start])
    quintic = np.array(
        [
            (12 * slope - 6 * (v0 + v1) + a1 - a0) / (2 * h**4),
            (-30 * slope + 16 * v0 + 14 * v1 + 3 * a0 - 2 * a1) / (2 * h**3),
            (20 * slope - 12 * v0 - 8 * v1 - 3 * a0 + a1) / (2 * h**2),
            a0 / (2 * h),
            v0,
            start,
        ]
    )
    pieces = np.where(np.isfinite(v0 + v1), cubic, linear)
    return PPoly(np.where(np.isfinite(v0 + v1 + a0 + a1), quintic, pieces), times)


def _check_names(path: str | Path, names: list[str], wanted: list[str], parameter: str) -> None:
    """Refuse a file whose joints are not those of the robot, each once."""
    faults = {
        "missing": [name for name in wanted if name not in names],
        "unknown": [name for name in names if name not in wanted],
        "twice": sorted({name for name in wanted if wanted.count(name) > 1}),
    }
    texts = [f"{fault}: {', '.join(some)}" for fault, some in faults.items() if some]
    if texts:
        unknown = (faults["unknown"] or faults["missing"] or faults["twice"])[0]
        raise InvalidParameter(
            f"{parameter}: {path} has the joints {', '.join(names)}, where {', '.join(wanted)} are needed; "
            f"{'; '.join(texts)}.{check.did_you_mean(unknown, wanted)} Name the joints as the robot's, or give "
            "joint_names: the file's names in the robot's order",
            parameter,
        )
