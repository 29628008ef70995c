"""The tube of a law with M̂(q): what its Lyapunov function must tolerate."""

from dataclasses import replace

from tarc.analysis.known_tube import KnownTube
from tarc.certificates.region_form import InputBounds
from tarc.certificates.region_tube import MARGIN, RegionProblem, TubeCase, TubeSize, tolerated_ratios


class KnownRegion:
    """Tubes about a reference, for a law with M̂(q).

    Attributes
    ----------
    nominal_inertia
        A matrix [kg m² or kg] at least as large as M̂ at the start, (n, n).
    units
        Largest √(M̂⁻¹)_ii in the tube, (n,): the largest error of each joint over ‖M̂^½ e‖.
    size
        Largest ‖M̂^½ e‖ within the errors that are allowed.
    """

    def __init__(self, problem: RegionProblem):
        self._problem = problem
        self._tube = KnownTube(
            law=problem.law,
            plants=problem.plants,
            reference=problem.reference,
            duration=problem.duration,
            error=problem.max_error,
            error_rate=0 * problem.max_error,
            noise=problem.disturbances.noise,
            samples=problem.samples,
            seed=problem.seed,
        )
        room = 1 + MARGIN
        self.units = room * self._tube.units_of_joints()
        self.size = float((problem.max_error / self.units).min())
        self._tube = replace(self._tube, error=self.size * self.units)
        self.nominal_inertia = room * self._tube.start_inertia()

    def case(self, tube: TubeSize) -> TubeCase:
        """Return what the loop must tolerate in a tube of the errors `size`."""
        given, room = self._problem.disturbances, 1 + MARGIN
        within = replace(self._tube, error_rate=tube.error_rate * self.units)
        found = within.bounds(given.torque_rate, given.max_torque, given.friction, self._problem.residuals)
        robot = found.robot
        ratios = tolerated_ratios(robot, self._tube.law.period)
        ratios = replace(ratios, rate=ratios.relative_rate / ratios.min_ratio, nominal_rate=found.nominal_rate * room)
        noise = room * found.noise
        bounds = InputBounds(
            noise=noise,
            residual=room * found.residual,
            change=room * (found.change + found.disturbance_change + ratios.max_nominal_change * found.disturbance),
            held=room * (found.held + found.disturbance_change),
            torque=room * (found.friction + found.own_stiffness * noise),
        )
        start = room * robot.rest_stiffness, room * found.start_torque, room * found.start_velocity
        return TubeCase(tube, ratios, bounds, start)
