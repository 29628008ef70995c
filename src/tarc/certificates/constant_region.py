"""The tube of a law with a constant M̂: what its Lyapunov function must tolerate."""

from itertools import product

import numpy as np

from tarc.analysis.operating_points import matrix_roots
from tarc.analysis.tube import ReferenceBounds, feedforward_along, reference_bounds, tube_bounds
from tarc.analysis.workspace import Workspace
from tarc.certificates.region_form import InputBounds
from tarc.certificates.region_tube import MARGIN, RegionProblem, TubeCase, TubeSize, tolerated_ratios
from tarc.core.types import Array

MAX_CORNER_JOINTS = 12
"""Number of joints up to which all combinations of signs are tried."""


class ConstantRegion:
    """Tubes about a reference, for a law with a constant M̂.

    Attributes
    ----------
    nominal_inertia
        M̂ [kg m² or kg], (n, n).
    units
        √(M̂⁻¹)_ii, (n,): the largest error of each joint over ‖M̂^½ e‖.
    size
        Largest ‖M̂^½ e‖ within the errors that are allowed.
    """

    def __init__(self, problem: RegionProblem):
        self._problem, law = problem, problem.law
        self.nominal_inertia = law.M
        self._root, self._inverse_root = matrix_roots(law.M)
        self.units = np.sqrt(np.diag(np.linalg.inv(law.M)))
        self.size = float((problem.max_error / self.units).min())
        forward, self._model_stiffness = (None, None) if law.feedforward is None else feedforward_along(law)
        self._motion = reference_bounds(
            problem.plants, self._inverse_root, problem.reference, problem.duration, law.period, forward
        )
        self._residual = float(np.linalg.norm(self._root @ problem.residuals, axis=0).max())

    def case(self, tube: TubeSize) -> TubeCase:
        """Return what the loop must tolerate in a tube of the errors `size`."""
        problem, motion, room = self._problem, self._motion, 1 + MARGIN
        given, samples, seed = problem.disturbances, problem.samples, problem.seed
        period, stiffness = problem.law.period, self._model_stiffness
        disturbed = period * largest_norm(self._inverse_root, given.torque_rate)
        bounds = InputBounds(
            noise=largest_norm(self._root, given.noise),
            residual=room * self._residual,
            change=room * period * motion.command_rate + disturbed,
            held=room * period * motion.torque_rate + disturbed,
            torque=largest_norm(self._inverse_root, given.friction),
        )
        space = tube_workspace(motion, tube, self.units)
        robot = tube_bounds(problem.plants, problem.law.M, space, samples=samples, seed=seed, model_stiffness=stiffness)
        start_torque = motion.start_torque
        if stiffness is not None:  # the model's torque at the start is that of the measured position
            known = self._inverse_root @ stiffness(space.sample(samples, seed).T) @ self._inverse_root
            start_torque += room * float(np.linalg.norm(known, 2, axis=(1, 2)).max()) * bounds.noise
        velocity = float(np.linalg.norm(self._root @ motion.start_velocity))
        start = room * robot.rest_stiffness, start_torque, velocity
        return TubeCase(tube, tolerated_ratios(robot, period), bounds, start)


def largest_norm(matrix: Array, limits: Array) -> float:
    """Return the largest ‖A x‖ with |x_i| at most the limits, at a corner; for many joints a bound."""
    if len(limits) > MAX_CORNER_JOINTS:
        return float(np.linalg.norm(np.abs(matrix) @ limits))
    corners = np.array(list(product((-1.0, 1.0), repeat=len(limits)))) * limits
    return float(np.linalg.norm(corners @ matrix.T, axis=1).max())


def tube_workspace(motion: ReferenceBounds, tube: TubeSize, units: Array) -> Workspace:
    """Return the box of postures and speeds of a tube; ``units`` are √(M̂⁻¹)_ii (n,)."""
    return Workspace.box(
        motion.low - tube.error * units,
        motion.high + tube.error * units,
        speed=motion.speed + tube.error_rate * units,
        acceleration=motion.acceleration,
    )
