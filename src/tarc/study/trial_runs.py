"""Trials of gains in one scenario: what their runs share is built once, and only the law for each trial."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeGuard

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels, joints_share_loop
from tarc.analysis.rest_stability import RobotAtRest, fastest_at_rest
from tarc.control.digital_controller import DigitalController, checked_limits
from tarc.core.errors import DesignWarning, InvalidParameter, JointLimitWarning, NotLinearisable, ScenarioError
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant
from tarc.scenario.model import Scenario
from tarc.simulation.batch import BatchResult
from tarc.simulation.batch_inputs import LoopCase
from tarc.simulation.casadi_backend import run_casadi
from tarc.simulation.closed_loop import ClosedLoop
from tarc.simulation.integration import Integration, choose_integration, integration_error, max_error
from tarc.simulation.monitor import DivergenceMonitor
from tarc.simulation.record import Record
from tarc.simulation.sampled_inputs import (
    InitialConditions,
    SampledInputs,
    check_compatible,
    initial_conditions,
    robots_at_rest,
    sample_inputs,
)
from tarc.simulation.simulator import PILOT_PERIODS
from tarc.study.trial_lanes import TrialLanes, lanes_or_none

N_COMPARED = 2
"""Laws that are run in both ways before trials run side by side."""
AGREEMENT = 1e-3
"""Largest relative difference of their measures: a quantiser may flip at the last bit."""


@dataclass(frozen=True)
class TrialRun:
    """Outcome of one law in one scenario.

    Attributes
    ----------
    rms_error, torque_variation
        As in `tarc.Run.metrics` [rad or m, N m/s or N/s]; nan for a run that did not complete.
    survived
        Share of the duration before the run diverged; 1 for one that completed.
    """

    rms_error: float
    torque_variation: float
    survived: float

    @property
    def completed(self) -> bool:
        """Whether the run ran to its end."""
        return self.survived == 1.0


class TrialScenario:
    """A scenario in which many laws are tried.

    Robot, reference, noise and disturbances are built and sampled once. The steps of the integration are those that the
    scenario's own laws need.

    Parameters
    ----------
    scenario
        The scenario. Its laws serve to choose the steps.
    examples
        Laws as a scenario writes them, which differ in all that may differ between trials, for `TrialLanes`. Without
        them trials run one by one.

    Raises
    ------
    InvalidParameter
        For measures that begin after the end.
    """

    def __init__(self, scenario: Scenario, examples: Sequence[dict[str, Any]] = ()):
        if scenario.metrics_start + 1.5 * scenario.period >= scenario.duration:
            raise InvalidParameter(
                f"metrics_start: got {scenario.metrics_start:g} s of {scenario.duration:g} s; needs two periods or "
                "more after it",
                "metrics_start",
            )
        self.scenario = scenario
        self.setup = scenario.build()
        self.plant: Plant = self.setup.simulated
        self._inputs: dict[tuple[int, float], SampledInputs] = {}
        self._examples = examples

    def build_law(self, part: dict[str, Any]) -> Law | None:
        """Return a law as a scenario writes it, constructed, or None where it or the robot refuses it."""
        try:
            law = self.scenario.build_law(part, self.setup)
            check_compatible(self.plant, law, self.setup.reference, self.setup.sensor)
        except (InvalidParameter, ScenarioError):
            return None
        return law

    def growth_rate(self, law: Law, channels: Sequence[Channel] | None = None) -> float:
        """Return the growth rate of the fastest unstable mode at rest in a posture of the reference [1/s].

        Zero for a loop that is stable there, and for a law that `fastest_at_rest` does not decide.
        """
        witness = fastest_at_rest(law, self._rest, self.scenario.computation_delay, channels=channels)
        return 0.0 if witness is None else witness.growth_rate

    def run_all(self, laws: Sequence[Law]) -> list[TrialRun]:
        """Simulate some laws, side by side where there is machine code for them."""
        places, batch = ([], None) if self._lanes is None or not laws else self._lanes.run(laws)
        if batch is None:
            return [self.run(law) for law in laws]
        runs = dict(zip(places, self._batch_runs(batch), strict=True))
        return [runs[place] if place in runs else self.run(law) for place, law in enumerate(laws)]

    def _batch_runs(self, batch: BatchResult) -> list[TrialRun]:
        """Return the results of a batch."""
        runs = []
        numbers = batch.measures["rms_error"], batch.measures["torque_variation"], batch.completed, batch.end_time
        for error, variation, completed, end in zip(*numbers, strict=True):
            share = min(float(end) / self.scenario.duration, 1 - 1e-9)
            runs.append(TrialRun(float(error), float(variation), 1.0) if completed else TrialRun(np.nan, np.nan, share))
        return runs

    @cached_property
    def _lanes(self) -> TrialLanes | None:
        """What runs trials side by side; None without examples, for robots in MuJoCo and where nothing compiles."""
        laws = [law for part in self._examples if (law := self.build_law(part)) is not None]
        if len(laws) < 2 or not isinstance(self.plant, SymbolicPlant) or self.scenario.native is False:
            return None
        scenario = self.scenario
        lanes = lanes_or_none(
            lambda: TrialLanes(
                laws,
                self._loop_case,
                self._method,
                duration=scenario.duration,
                metrics_start=scenario.metrics_start,
                divergence_threshold=scenario.divergence_threshold,
                seed=scenario.seed,
            )
        )
        return lanes if lanes is not None and self._agrees(lanes, laws) else None

    def _agrees(self, lanes: TrialLanes, laws: Sequence[Law]) -> bool:
        """Return whether some laws have the same measures side by side as one by one."""
        places, batch = lanes.run(laws)
        in_batch = [] if batch is None else list(zip(places, self._batch_runs(batch), strict=True))
        completed = [(place, run) for place, run in in_batch if run.completed][:N_COMPARED]
        for place, ours in completed:
            theirs = self.run(laws[place])
            pairs = zip(
                (ours.rms_error, ours.torque_variation), (theirs.rms_error, theirs.torque_variation), strict=True
            )
            if not all(abs(in_lanes - alone) <= AGREEMENT * abs(alone) for in_lanes, alone in pairs):
                return False
        return bool(completed)

    def _loop_case(self, law: Law) -> LoopCase:
        """Return the loop of a law as a case of a batch."""
        scenario, loop = self.scenario, self._loop(law, self._method)
        return LoopCase(
            loop.plant,
            loop.controller,
            self.setup.reference,
            tuple(self.setup.events),
            self.setup.drive,
            scenario.jitter,
            scenario.initial_position,
            scenario.initial_velocity,
            scenario.initial_torque,
        )

    def run(self, law: Law) -> TrialRun:
        """Simulate a law and return its error and torque variation."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", DesignWarning)
            warnings.simplefilter("ignore", JointLimitWarning)
            if not isinstance(self.plant, SymbolicPlant):
                return self._run_in_mujoco(law)
            record, divergence_index = self._simulate(law, self._method, self.scenario.duration)
        inputs = self._sample(self._method.substeps, self.scenario.duration)
        if divergence_index is not None:
            return TrialRun(np.nan, np.nan, min(divergence_index / len(inputs.times), 1 - 1e-9))
        return self._measured(record, inputs)

    def _measured(self, record: Record, inputs: SampledInputs) -> TrialRun:
        """Return the measures from ``metrics_start`` on."""
        first = int(np.searchsorted(inputs.times, self.scenario.metrics_start - 1e-9))
        error = record.arrays["position"][first:] - inputs.reference[0].T[first:]
        torque = record.arrays["torque"][first:]
        seconds = self.scenario.period * (len(torque) - 1)
        variation = float(np.sum(np.abs(np.diff(torque, axis=0)))) / seconds
        return TrialRun(float(np.sqrt(np.mean(error**2))), variation, 1.0)

    def _run_in_mujoco(self, law: Law) -> TrialRun:
        run = self.scenario.run_law(law, self.setup, progress=False)
        if not run.status.completed:
            share = float(run.data["time"].values[-1]) / self.scenario.duration
            return TrialRun(np.nan, np.nan, min(share, 1 - 1e-9))
        measures = run.metrics(start_time=self.scenario.metrics_start)
        return TrialRun(measures["rms_error"], measures["torque_variation"], 1.0)

    @cached_property
    def _rest(self) -> list[RobotAtRest]:
        """The robot between two changes, in the postures of the reference then."""
        times = np.arange(round(self.scenario.duration / self.scenario.period)) * self.scenario.period
        return robots_at_rest(self.plant, self.setup.events, times, self.setup.reference.sample(times)[0])

    @cached_property
    def _method(self) -> Integration:
        """The finest of the steps that the scenario's own laws need."""
        if self.scenario.substeps is not None:
            return Integration("Runge–Kutta", self.scenario.substeps)
        duration = min(self.scenario.duration, PILOT_PERIODS * self.scenario.period)
        methods = [self._chosen(law, duration) for law in self.setup.laws.values()]
        return max(methods, key=lambda method: (method.integrator != "midpoint", method.substeps))

    def _chosen(self, law: Law, duration: float) -> Integration:
        """Return the steps that the simulation would choose for a law."""

        def trial(method: Integration) -> tuple[float, bool]:
            record, divergence_index = self._simulate(law, method, duration)
            disturbance = self._sample(method.substeps, duration).disturbance[:, :, 0]
            assert isinstance(self.plant, SymbolicPlant)
            error = integration_error(self.plant, record, disturbance, self.scenario.period, method)
            return error, divergence_index is not None

        return choose_integration(trial, max_error(self.setup.sensor))

    def _sample(self, substeps: int, duration: float) -> SampledInputs:
        """Return reference, noise and disturbances of every trial, sampled once."""
        key = substeps, duration
        if key not in self._inputs:
            setup, scenario = self.setup, self.scenario
            self._inputs[key] = sample_inputs(
                self.plant,
                scenario.period,
                setup.reference,
                duration,
                setup.sensor,
                setup.events,
                substeps,
                scenario.seed,
                scenario.jitter,
            )
        return self._inputs[key]

    @cached_property
    def _initial(self) -> InitialConditions:
        scenario = self.scenario
        inputs = self._sample(1, scenario.duration)
        start = scenario.initial_position, scenario.initial_velocity, scenario.initial_torque
        return initial_conditions(self.plant, inputs, *start)

    def _loop(self, law: Law, method: Integration) -> ClosedLoop:
        """Return the closed loop of a law."""
        setup, scenario = self.setup, self.scenario
        limits = checked_limits(setup.torque_limits, law)
        controller = DigitalController(setup.sensor, law, scenario.computation_delay, limits)
        assert isinstance(self.plant, SymbolicPlant)
        return ClosedLoop(self.plant, controller, method.substeps, method.integrator, setup.drive)

    def _simulate(self, law: Law, method: Integration, duration: float) -> tuple[Record, int | None]:
        """Return the record of a run, and the index of the sample at which it diverged."""
        inputs = self._sample(method.substeps, duration)
        monitor = DivergenceMonitor(inputs, self.scenario.divergence_threshold, False)
        record = run_casadi(self._loop(law, method), self._initial, inputs, monitor, self.scenario.native)
        return record, monitor.divergence_index


def has_shared_loop(law: Law) -> TypeGuard[PolePlacement]:
    """Return whether all joints of a law share a loop, whose linearisation does not depend on the posture."""
    if not isinstance(law, PolePlacement) or not joints_share_loop(law):
        return False
    return not law.has_model or isinstance(law.inertia, NominalInertia)


def shared_loop(law: Law) -> Sequence[Channel] | None:
    """Return the linearised loop that all joints of a law share, without computation delay; None where there is none.

    It does not depend on M̂ and on the torque limits.
    """
    if not has_shared_loop(law):
        return None
    try:
        return decoupled_channels(law)
    except NotLinearisable:
        return None
