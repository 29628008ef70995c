"""Joint references from way-points in space, by inverse kinematics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.optional import require
from tarc.core.types import Array
from tarc.core.validation import Numbers, Table
from tarc.plants.base import Plant
from tarc.signals.joint_trajectory import hermite_curve
from tarc.signals.references import Quintic, Reference, sample_curve

if TYPE_CHECKING:
    import mujoco
    from scipy.spatial.transform import Rotation

    from tarc.scenario.inverse_kinematics import InverseKinematics, Solution

MAX_PATH_ERROR = 1e-5
"""Largest distance between the path of the joints and the path in space [m], and angle [rad]."""

SAMPLES_PER_PIECE = 8
"""Solutions per piece between two way-points at first; they double until the path is met."""

MAX_DOUBLINGS = 6
"""Doublings of the number of solutions, after which the path is taken to jump."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CartesianWaypoints(Reference):
    """Joint reference whose site or body passes way-points in space, at rest at both ends.

    In space, a quintic spline passes through the way-points, of the orientations as rotation vectors from the first
    one. Inverse kinematics (``mink``) follows it in small steps, each from the last solution. A quintic spline
    through the solutions gives exact derivatives. Its distance from the path in space is below 1e-5 m (or rad).

    Parameters
    ----------
    frame
        Name of a site or a body of the robot.
    points
        Positions of its origin in the world [m], shape (k, 3).
    times
        Time at each way-point [s], increasing, shape (k,).
    quaternions
        Orientations (w, x, y, z), shape (k, 4). None leaves the orientation free.
    stop_at_points
        Whether to stop at each way-point, on straight lines between them.
    posture
        Joint positions [rad or m] from which the inverse kinematics begins, shape (n,); it decides between several
        solutions. None for the home posture.
    robot
        A robot from a file. In a scenario it is the scenario's.

    Raises
    ------
    InvalidParameter
        For way-points out of reach, with their distances, a path with a jump, and an unknown frame.
    MissingTool
        Without the extra ``ik``.
    """

    frame: str
    points: Table
    times: Sequence[float] | np.ndarray
    robot: Plant
    quaternions: Table | None = None
    stop_at_points: bool = False
    posture: Numbers | None = None

    def __post_init__(self) -> None:
        _ = self._curve

    @cached_property
    def _model(self) -> "mujoco.MjModel":
        model = getattr(getattr(self.robot, "mujoco", self.robot), "model", None)
        if model is None:
            raise InvalidParameter(f"robot: got {self.robot!r}; way-points in space need a robot from a file", "robot")
        self.robot.require_fully_driven("inverse kinematics")
        return model

    @cached_property
    def _path(self) -> Quintic:
        """The path in space, of position and rotation vector, (6,), or of position alone, (3,)."""
        points = check.array("points", self.points)
        if points.ndim != 2 or points.shape[1] != 3:
            raise InvalidParameter(f"points: got shape {points.shape}; needs (k, 3), one row per way-point", "points")
        if self.quaternions is not None:
            rotations = self._orientations(len(points))
            points = np.hstack([points, rotation_vectors(rotations)])
        return Quintic(points=points, times=self.times, stop_at_points=self.stop_at_points)

    def _orientations(self, count: int) -> "Rotation":
        from scipy.spatial.transform import Rotation

        quaternions = check.array("quaternions", self.quaternions)
        if quaternions.shape != (count, 4) or not np.all(np.linalg.norm(quaternions, axis=1) > 0):
            raise InvalidParameter(
                f"quaternions: got shape {quaternions.shape} for {count} points; needs (w, x, y, z) of each, not zero",
                "quaternions",
            )
        return Rotation.from_quat(quaternions[:, [1, 2, 3, 0]])

    def pose(self, times: Numbers) -> tuple[Array, Array | None]:
        """Return the wanted positions (k, 3) [m] and quaternions (k, 4), or None, at times (k,)."""
        from scipy.spatial.transform import Rotation

        values = self._path.sample(np.atleast_1d(np.asarray(times, dtype=float)))[0].T
        if self.quaternions is None:
            return values, None
        first = self._orientations(len(np.asarray(self.points)))[0]
        quaternions = (first * Rotation.from_rotvec(values[:, 3:])).as_quat()
        return values[:, :3], quaternions[:, [3, 0, 1, 2]]

    @cached_property
    def _curve(self) -> Callable[..., np.ndarray]:
        require("ik", "CartesianWaypoints", "daqp", "mink")
        from tarc.scenario.inverse_kinematics import InverseKinematics

        times = np.atleast_1d(check.array("times", self.times))
        _ = self._path
        solver = InverseKinematics(self._model, self.frame)
        home = self.robot.home if self.posture is None else check.vector("posture", self.posture, self.robot.n_joints)
        start = self._check_reach(solver, times, home)
        middles, errors = times, np.array([[np.inf]])
        for doubling in range(MAX_DOUBLINGS):
            pieces = [np.linspace(a, b, SAMPLES_PER_PIECE * 2**doubling + 1) for a, b in pairwise(times)]
            postures = self._follow(solver, np.concatenate([piece[:-1] for piece in pieces] + [times[-1:]]), start)
            curve = self._spline(pieces, postures)
            middles = np.concatenate([(piece[:-1] + piece[1:]) / 2 for piece in pieces])
            errors = solver.errors(curve(middles), *self.pose(middles))
            if np.max(errors) < MAX_PATH_ERROR:
                return curve
        worst = int(np.argmax(np.max(errors, axis=1)))
        raise InvalidParameter(
            f"points: the joints cannot follow the path near {middles[worst]:.4g} s, where they would have to jump. "
            "Give another posture, more way-points or none near a singular posture",
            "points",
        )

    def _check_reach(self, solver: "InverseKinematics", times: Array, home: Array) -> Array:
        """Return the joint positions at the first way-point; refuse way-points that are out of reach."""
        positions, quaternions = self.pose(times)
        faults = []
        first, posture = home, home
        for number, time in enumerate(times):
            target = positions[number], None if quaternions is None else quaternions[number]
            solution = solver.search(*target, posture)
            if not solution.is_reached:
                where = ", ".join(f"{value:.4g}" for value in np.asarray(self.points)[number])
                faults.append(f"way-point {number + 1} of {len(times)} at {time:g} s, ({where}) m, by {solution.miss}")
                continue
            posture = solution.posture
            first = posture if number == 0 else first
        if faults:
            free = "" if quaternions is None else ", or leave the orientation free"
            raise InvalidParameter(
                f"points: {self.frame} of {self.robot.label} cannot reach {'; '.join(faults)}. Move these way-points"
                f"{free}",
                "points",
            )
        return first

    def _follow(self, solver: "InverseKinematics", times: Array, start: Array) -> Array:
        """Return the joint positions (k, n) along the path, each solved from the last one."""
        positions, quaternions = self.pose(times)
        postures = [start]
        for number, time in enumerate(times[1:], 1):
            target = positions[number], None if quaternions is None else quaternions[number]
            solution: Solution = solver.solve(*target, postures[-1])
            if not solution.is_reached:
                raise InvalidParameter(
                    f"points: the path of {self.frame} leaves the reach of {self.robot.label} at {time:.4g} s, by "
                    f"{solution.miss}. Give another posture, or way-points around it",
                    "points",
                )
            postures.append(solution.posture)
        return np.array(postures)

    def _spline(self, pieces: list[Array], postures: Array) -> Callable[..., np.ndarray]:
        """Return the quintic spline through the solutions, at rest at both ends or at each way-point."""
        sections = pieces if self.stop_at_points else [np.concatenate([p[:-1] for p in pieces] + [pieces[-1][-1:]])]
        states: list[list[Array]] = [[], [], []]
        times: list[Array] = []
        begin = 0
        for section in sections:
            spline = Quintic(points=postures[begin : begin + len(section)], times=section)
            keep = slice(1 if times else 0, None)  # a way-point belongs to the piece before it
            times.append(section[keep])
            for values, state in zip(states, spline.sample(section), strict=True):
                values.append(state.T[keep])
            begin += len(section) - 1
        return hermite_curve(np.concatenate(times), *(np.concatenate(values) for values in states))

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return self.robot.n_joints

    def for_run(self, joint_names: Sequence[str], duration: float) -> Reference:
        """Return the reference itself; refuse another robot.

        Raises
        ------
        InvalidParameter
            For other joints than the robot's.
        """
        if list(joint_names) != self.robot.joint_names:
            raise InvalidParameter(
                f"reference: its way-points were solved for the joints {', '.join(self.robot.joint_names)}; the run "
                f"has {', '.join(joint_names)}. Construct it with the same robot",
                "reference",
            )
        return self

    def sample(self, times: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration, each of shape (n, k); held before and after the way-points."""
        ends = np.atleast_1d(self.times)[[0, -1]]
        return sample_curve(self._curve, np.asarray(times, dtype=float), *ends)


def rotation_vectors(rotations: "Rotation") -> Array:
    """Return the rotation vectors from the first of k rotations [rad], shape (k, 3), each nearest to the one before."""
    vectors = (rotations[0].inv() * rotations).as_rotvec()
    for number in range(1, len(vectors)):
        angle = np.linalg.norm(vectors[number])
        if angle > 0:
            axis = vectors[number] / angle
            turns = np.round((vectors[number - 1] @ axis - angle) / (2 * np.pi))
            vectors[number] += 2 * np.pi * turns * axis
    return vectors
