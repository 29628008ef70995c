"""Inverse kinematics of a site or body of a MuJoCo model, by ``mink``."""

from tarc.core.optional import require

require("ik", "tarc.scenario.CartesianWaypoints", "daqp", "mink")

from dataclasses import dataclass

import mink
import mujoco
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array

TOLERANCE = 1e-9
"""Distance [m] and angle [rad] below which a pose is reached."""

MAX_ITERATIONS = 100
"""Steps of one solution."""

N_RESTARTS = 24
"""Random postures from which a pose is tried before it counts as out of reach."""


@dataclass(frozen=True)
class Solution:
    """Joint positions whose pose is nearest to the wanted one.

    Attributes
    ----------
    posture
        [rad or m], shape (n,).
    distance, angle
        Of the pose from the wanted one [m, rad].
    """

    posture: Array
    distance: float
    angle: float

    @property
    def is_reached(self) -> bool:
        """Return whether the pose is the wanted one."""
        return max(self.distance, self.angle) < TOLERANCE

    @property
    def miss(self) -> str:
        """Return distance and angle in words."""
        angle = f" and {np.degrees(self.angle):.3g}°" if self.angle >= TOLERANCE else ""
        return f"{self.distance:.3g} m{angle}"


class InverseKinematics:
    """Joint positions for poses of a site or body.

    Parameters
    ----------
    model
        The robot.
    frame
        Name of a site or a body.

    Raises
    ------
    InvalidParameter
        For a frame that the robot does not have.
    """

    def __init__(self, model: mujoco.MjModel, frame: str):
        sites = [model.site(i).name for i in range(model.nsite)]
        bodies = [model.body(i).name for i in range(1, model.nbody)]
        names = [name for name in dict.fromkeys(sites + bodies) if name and not name.startswith("tarc_")]
        kind = "site" if check.one_of("frame", frame, names) in sites else "body"
        self._configuration = mink.Configuration(model)
        self._tasks = {
            cost: mink.FrameTask(frame, kind, position_cost=1.0, orientation_cost=cost, lm_damping=1e-3)
            for cost in (0.0, 1.0)
        }
        self._limits = [mink.ConfigurationLimit(model, gain=1.0)]
        self._ranges = np.where(model.jnt_limited[:, None].astype(bool), model.jnt_range, [-np.pi, np.pi])

    def solve(self, position: Array, quaternion: Array | None, start: Array) -> Solution:
        """Return the solution that a descent from a start (n,) finds, within the ranges of the joints."""
        task = self._task(position, quaternion)
        self._configuration.update(start)
        for _ in range(MAX_ITERATIONS):
            solution = self._solution(task, quaternion)
            if solution.is_reached:
                break
            try:
                step = mink.solve_ik(self._configuration, [task], 1.0, "daqp", limits=self._limits)
            except mink.NoSolutionFound:
                break
            self._configuration.integrate_inplace(step, 1.0)
            if np.max(np.abs(step)) < 1e-13:
                break
        return self._solution(task, quaternion)

    def search(self, position: Array, quaternion: Array | None, start: Array) -> Solution:
        """Return the solution from a start (n,), or else the nearest to it of those from random postures."""
        nearest = self.solve(position, quaternion, start)
        if nearest.is_reached:
            return nearest
        rng = np.random.default_rng(0)
        low, high = self._ranges.T
        starts = rng.uniform(low, high, (N_RESTARTS, len(low)))
        solutions = [nearest, *(self.solve(position, quaternion, posture) for posture in starts)]
        reached = [solution for solution in solutions if solution.is_reached]
        if reached:
            return min(reached, key=lambda solution: float(np.linalg.norm(solution.posture - start)))
        return min(solutions, key=lambda solution: solution.distance + solution.angle)

    def errors(self, postures: Array, positions: Array, quaternions: Array | None) -> Array:
        """Return distances [m] and angles [rad], shape (k, 2), of poses from the wanted ones at postures (k, n)."""
        rows = []
        for number, posture in enumerate(postures):
            quaternion = None if quaternions is None else quaternions[number]
            self._configuration.update(posture)
            solution = self._solution(self._task(positions[number], quaternion), quaternion)
            rows.append([solution.distance, solution.angle])
        return np.array(rows)

    def _task(self, position: Array, quaternion: Array | None) -> mink.FrameTask:
        task = self._tasks[0.0 if quaternion is None else 1.0]
        rotation = mink.SO3.identity() if quaternion is None else mink.SO3(quaternion)
        task.set_target(mink.SE3.from_rotation_and_translation(rotation, position))
        return task

    def _solution(self, task: mink.FrameTask, quaternion: Array | None) -> Solution:
        pose = self._configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
        target = task.transform_target_to_world
        if target is None:
            raise InvalidParameter("frame: it has no target")
        distance = float(np.linalg.norm(pose.translation() - target.translation()))
        turn = (target.rotation().inverse() @ pose.rotation()).log()
        angle = 0.0 if quaternion is None else float(np.linalg.norm(turn))
        return Solution(self._configuration.q.copy(), distance, angle)
