"""Gradient of the severity of a run with respect to its draws, through the whole closed loop."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.trees import pack
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.plants.symbolic import SymbolicPlant
from tarc.simulation.casadi_backend import TracedLoop, interpreted
from tarc.simulation.closed_loop import ClosedLoop
from tarc.simulation.sampled_inputs import InitialConditions, SampledInputs, initial_conditions
from tarc.simulation.simulator import Simulation
from tarc.simulation.tangent import Trajectory, log_error_gradient, position_derivatives
from tarc.study.cases import Cases
from tarc.study.engines import Simulator, traced_parameters
from tarc.study.objective import StudyObjective

STEP = 1e-6
"""Distance in the unit cube over which inputs and parameters are differenced; they are smooth in the draws."""

LOOP_STEP = 1e-4
"""The same for whole runs, of draws that change the loop itself."""


class _Loop(NamedTuple):
    """A run without quantisation, ready to be traced."""

    law: Law
    simulation: Simulation
    plant: SymbolicPlant
    initial: InitialConditions
    inputs: SampledInputs

    def is_like(self, other: "_Loop") -> bool:
        """Return whether both differ in inputs, start and parameters of the robot alone."""
        own, theirs = self.simulation, other.simulation
        return (
            self.law is other.law
            and own.drive is theirs.drive
            and own.controller.torque_limits is theirs.controller.torque_limits
            and own.controller.computation_delay == theirs.controller.computation_delay
            and traced_parameters(own.controller.sensor) == traced_parameters(theirs.controller.sensor)
        )


class LoopGradient:
    """Gradient of the logarithm of a law's RMS error with respect to a point of the unit cube.

    The loop is that of the study with a sensor that is not quantised, since the derivative of a rounded position is
    zero. So the gradient is a direction for the quantised loop, and not its derivative. Draws that change the robot's
    parameters, reference, disturbances, noise and the start are differentiated by the forward mode through the whole
    run. Draws that change the loop itself, such as the gains of a law, are differenced.

    Parameters
    ----------
    objective
        Of one law of a study.

    Raises
    ------
    InvalidParameter
        For a robot that is not simulated in symbols.
    """

    def __init__(self, objective: StudyObjective):
        self.objective = objective
        self.cases = Cases(objective.study)
        if not isinstance(self.cases.nominal.simulated, SymbolicPlant):
            raise InvalidParameter(
                "gradient: the robot is simulated in MuJoCo, which has none; search without gradients"
            )
        self._simulator = Simulator(self.cases, objective.integration, [objective.law])

    def __call__(self, point: Array) -> Array:
        """Return the gradient at a point (keys,); NaN where the run without quantisation diverges."""
        base = self._loop(point)
        steps = np.where(point + STEP < 1, STEP, -STEP)
        others = [self._loop(point + step * unit) for step, unit in zip(steps, np.eye(point.size), strict=True)]
        is_input = np.array([base.is_like(other) for other in others]) & (not self.cases.plant_is_rebuilt)
        gradient = np.full(point.size, np.nan)
        with np.errstate(all="ignore"):
            if np.any(is_input):
                chosen = [others[place] for place in np.flatnonzero(is_input)]
                gradient[is_input] = self._forward(base, chosen, steps[is_input])
            for place in np.flatnonzero(~is_input):
                shift = LOOP_STEP * np.eye(point.size)[place]
                rise = self.log_error(np.minimum(point + shift, 1)) - self.log_error(np.maximum(point - shift, 0))
                gradient[place] = rise / float(np.sum(np.minimum(point + shift, 1) - np.maximum(point - shift, 0)))
        return gradient

    def log_error(self, point: Array) -> float:
        """Return the logarithm of the RMS error without quantisation at a point (keys,)."""
        loop = self._loop(point)
        traced = self._traced(loop)
        run = _trajectory(traced, loop)
        positions = interpreted(traced.function, run.state.copy())(run.rows)[:, : loop.plant.n_joints]
        counted = self._counted(loop)
        error = positions[counted] - loop.inputs.reference[0].T[counted]
        return float(0.5 * np.log(np.mean(error**2)))

    def _forward(self, base: _Loop, others: list[_Loop], steps: Array) -> Array:
        """Return the gradient with respect to draws that are inputs of one traced loop."""
        traced = self._traced(base)
        run = _trajectory(traced, base)
        directions = [
            run.direction(_trajectory(traced, other), step) for other, step in zip(others, steps, strict=True)
        ]
        positions, derivatives = position_derivatives(traced.function, base.plant.n_joints, run, directions)
        counted = self._counted(base)
        reference = base.inputs.reference[0]
        changes = [(other.inputs.reference[0] - reference) / step for other, step in zip(others, steps, strict=True)]
        return log_error_gradient(
            positions[counted],
            derivatives[counted],
            reference.T[counted],
            np.stack(changes).transpose(2, 1, 0)[counted],
        )

    def _loop(self, point: Array) -> _Loop:
        """Return the run at a point, with a sensor that is not quantised."""
        objective = self.objective
        case = self.cases.build(objective.study.values_at(np.asarray(point)[None])[0])
        sensor = replace(case.setup.sensor, bits=None, resolution=None)
        case = replace(case, setup=replace(case.setup, sensor=sensor))
        law = case.setup.laws[objective.law]
        simulation = self._simulator.prepared(case, law, objective.seed)
        plant = simulation.plant
        assert isinstance(plant, SymbolicPlant)
        inputs = simulation.sample(objective.integration.substeps, self.cases.scenario.duration)
        initial = initial_conditions(plant, inputs, case.initial_position, case.initial_velocity, case.initial_torque)
        return _Loop(law, simulation, plant, initial, inputs)

    def _traced(self, loop: _Loop) -> TracedLoop:
        method = self.objective.integration
        closed = ClosedLoop(
            loop.plant, loop.simulation.controller, method.substeps, method.integrator, loop.simulation.drive
        )
        names = () if self.cases.plant_is_rebuilt else self.cases.plant_parameters or ()
        return TracedLoop(closed, loop.initial, loop.inputs, names)

    def _counted(self, loop: _Loop) -> Array:
        """Return which samples the measures count."""
        return loop.inputs.times >= self.cases.scenario.metrics_start - 1e-9


def _trajectory(traced: TracedLoop, loop: _Loop) -> Trajectory:
    """Return start and inputs of a run as vectors, for a loop that was traced for one like it."""
    closed = replace(traced.loop, plant=loop.plant)
    start, noise = loop.initial, loop.inputs.noise[:, 0]
    state = closed.init(start.position, start.velocity, start.torque, noise)
    return Trajectory(pack(state), traced.input_rows(loop.plant, loop.inputs))
