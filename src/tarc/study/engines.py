"""Engines of a study: what runs a chunk of its runs."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import product
from typing import Protocol

import numpy as np

from tarc.core.tracing import TRACE_ERRORS
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.mujoco_gearbox import MujocoGearbox
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.sensors import Encoder
from tarc.simulation.casadi_backend import TracedLoop
from tarc.simulation.closed_loop import ClosedLoop
from tarc.simulation.dataset import largest_torques, with_derived_signals
from tarc.simulation.integration import Integration
from tarc.simulation.measures import SIGNALS, compute_measures
from tarc.simulation.monitor import DivergenceMonitor
from tarc.simulation.mujoco_backend import run_mujoco
from tarc.simulation.record import Record
from tarc.simulation.run import Run
from tarc.simulation.sampled_inputs import InitialConditions, SampledInputs, initial_conditions
from tarc.simulation.simulator import Simulation, prepare_simulation
from tarc.simulation.varying import DRAWN_BEFORE
from tarc.study.cases import Cases
from tarc.study.drawn_case import Case
from tarc.study.varied_loop import TRIAL_PERIODS, TrialRun, VariedLoop

VIRTUAL_MACHINE = "virtual machine"
MUJOCO = "MuJoCo"

FEW_PERIODS = 4
"""Periods from which the names of a law's measures are known."""

MAX_LOOPS = 16
"""Traced loops of a law that are kept."""


@dataclass(frozen=True, eq=False)
class ChunkResult:
    """Results of a chunk of runs, as arrays over the runs of the chunk and the laws.

    Attributes
    ----------
    measures
        Measures by name, each (runs, laws); NaN where a run ended before they begin.
    completed
        Whether each run came to its end, (runs, laws).
    end_time
        Time of divergence, or the duration [s], (runs, laws).
    applied
        Values that were read back from plant, sensor and law, by key: (runs,), or (runs, laws) for keys of laws.
    """

    measures: dict[str, Array]
    completed: Array
    end_time: Array
    applied: dict[str, Array]


@dataclass(frozen=True)
class Outcome:
    """Result of one run of one law.

    Attributes
    ----------
    measures
        By name; empty for a run that ended before they begin.
    completed
        Whether it came to its end.
    end_time
        Time of divergence, or the duration [s].
    """

    measures: dict[str, float]
    completed: bool
    end_time: float


class Engine(Protocol):
    """Runs chunks of a study. The results do not depend on how the runs are cut into chunks.

    Attributes
    ----------
    name
        ``virtual machine``, ``compiled``, ``lanes`` or ``MuJoCo``.
    """

    name: str

    def run(self, indices: Array, values: Array, seeds: Array) -> ChunkResult:
        """Run a chunk.

        Parameters
        ----------
        indices
            Numbers of the runs in the study, (runs,).
        values
            Drawn values, one row per run and one column per key, (runs, keys).
        seeds
            Seeds of the runs, (runs,).
        """
        ...


class Simulator:
    """Engine that simulates run by run, in CasADi's virtual machine, or in MuJoCo for a robot that is simulated there.

    A loop is traced once, with drawn parameters of plant, law and sensor as inputs. Other choices have loops of their
    own. Where a law decides by a number that is drawn, the loop is traced anew for each run.

    Parameters
    ----------
    cases
        What builds the parts of each run.
    integration
        Method and steps of all runs.
    laws
        Names of the laws to run; None for all.
    """

    def __init__(self, cases: Cases, integration: Integration, laws: Sequence[str] | None = None):
        self.cases = cases
        self.laws = self.cases.law_names if laws is None else list(laws)
        self.name = VIRTUAL_MACHINE if isinstance(self.cases.nominal.simulated, SymbolicPlant) else MUJOCO
        self._integration = integration
        self._loops: dict[str, list[tuple[tuple[object, ...], TracedLoop]]] = {}
        self._varied: dict[tuple[str, tuple[float, ...]], VariedLoop | None] = {}

    def run(self, indices: Array, values: Array, seeds: Array) -> ChunkResult:
        """Run a chunk, as `Engine.run`."""
        rows = [self._row(row, int(seed)) for row, seed in zip(values, seeds, strict=True)]
        applied = [case.applied for case, _ in rows]
        return chunk_result([outcomes for _, outcomes in rows], applied, self._law_places(), self._measures)

    def trace(self, row: Array, seed: int, law: str) -> Run:
        """Return one run with its trajectories, for a row of drawn values (keys,)."""
        case = self.cases.build(row)
        simulation = self.prepared(case, case.setup.laws[law], seed)
        inputs = simulation.sample(self._integration.substeps, self.cases.scenario.duration)
        record, monitor = self._simulated(case, law, simulation, inputs)
        return simulation.label(inputs, record, monitor, self._integration.integrator, np.nan)

    @cached_property
    def _measures(self) -> list[str]:
        """Measures of all laws, from a few periods of each."""
        duration = min(self.cases.scenario.duration, FEW_PERIODS * self.cases.scenario.period)
        names: dict[str, None] = {}
        for case, law in product(map(self.cases.build, self.cases.typical_rows), self.laws):
            simulation = self.prepared(case, case.setup.laws[law], 0)
            inputs = simulation.sample(self._integration.substeps, duration)
            record, monitor = self._simulated(case, law, simulation, inputs)
            names |= dict.fromkeys(outcome_of(simulation, inputs, record, monitor, 0.0).measures)
        return list(names)

    def _law_places(self) -> list[int]:
        """Return the numbers of the laws among all laws of the study."""
        return [self.cases.law_names.index(name) for name in self.laws]

    def _row(self, row: Array, seed: int) -> tuple[Case, list[Outcome]]:
        """Run all laws with the same values and the same noise."""
        case = self.cases.build(row)
        outcomes = []
        inputs: SampledInputs | None = None
        for law in self.laws:
            simulation = self.prepared(case, case.setup.laws[law], seed)
            if inputs is None:
                inputs = simulation.sample(self._integration.substeps, self.cases.scenario.duration)
            record, monitor = self._simulated(case, law, simulation, inputs)
            outcomes.append(outcome_of(simulation, inputs, record, monitor, self.cases.scenario.metrics_start))
        return case, outcomes

    def prepared(self, case: Case, law: Law, seed: int) -> Simulation:
        """Return the simulation of a case with a law."""
        setup, scenario = case.setup, self.cases.scenario
        return prepare_simulation(
            setup.simulated,
            law,
            setup.reference,
            scenario.duration,
            sensor=setup.sensor,
            events=setup.events,
            computation_delay=case.computation_delay,
            torque_limits=setup.torque_limits,
            drive=setup.drive,
            jitter=case.jitter,
            divergence_threshold=scenario.divergence_threshold,
            seed=seed,
            native=False,
        )

    def _simulated(
        self, case: Case, law: str, simulation: Simulation, inputs: SampledInputs
    ) -> tuple[Record, DivergenceMonitor]:
        """Simulate one law; return the record and what has watched it."""
        plant = simulation.plant
        initial = initial_conditions(plant, inputs, case.initial_position, case.initial_velocity, case.initial_torque)
        monitor = DivergenceMonitor(inputs, simulation.divergence_threshold, False)
        with np.errstate(all="ignore"):
            if isinstance(plant, SymbolicPlant):
                parts = simulation.controller, simulation.drive
                varied = self._varied_loop(law, case.choices)
                if varied is not None and varied.covers(parts, inputs):
                    return varied.traced.run(plant, initial, inputs, monitor, native=False, parts=parts), monitor
                loop = self._loop(case, law, simulation, initial, inputs)
                return loop.run(plant, initial, inputs, monitor, native=False), monitor
            assert isinstance(plant, MujocoPlant | MujocoGearbox)
            record = run_mujoco(plant, simulation.controller, initial, inputs, monitor, drive=simulation.drive)
            return record, monitor

    def _varied_loop(self, law: str, choices: tuple[float, ...]) -> VariedLoop | None:
        """Return the loop of a law with drawn numbers as inputs; None without any, or where a part decides by one."""
        if self.cases.plant_is_rebuilt or not self.cases.has_loop_keys:
            return None
        if (law, choices) not in self._varied:
            self._varied[law, choices] = self._traced_for_all(law, choices)
        return self._varied[law, choices]

    def _traced_for_all(self, law: str, choices: tuple[float, ...]) -> VariedLoop | None:
        """Trace the loop of a law for all runs with these choices; None where that is not possible."""
        try:
            runs = [self._trial_run(case, law) for case in self.cases.examples(choices)]
            return VariedLoop(runs, self.cases.plant_parameters or ())
        except TRACE_ERRORS:
            return None

    def _trial_run(self, case: Case, law: str) -> TrialRun:
        """Return loop, start and inputs of the first periods of a case."""
        method, simulation = self._integration, self.prepared(case, case.setup.laws[law], 0)
        plant = simulation.plant
        assert isinstance(plant, SymbolicPlant)
        inputs = simulation.sample(method.substeps, TRIAL_PERIODS * self.cases.scenario.period)
        initial = initial_conditions(plant, inputs, case.initial_position, case.initial_velocity, case.initial_torque)
        loop = ClosedLoop(plant, simulation.controller, method.substeps, method.integrator, simulation.drive)
        return TrialRun(loop, initial, inputs)

    def _loop(
        self, case: Case, law: str, simulation: Simulation, initial: InitialConditions, inputs: SampledInputs
    ) -> TracedLoop:
        """Return the traced loop of a law: that of a run before from which nothing but its inputs differs."""
        plant, controller = simulation.plant, simulation.controller
        assert isinstance(plant, SymbolicPlant)
        key = (
            case.choices,
            controller.law,
            traced_parameters(controller.sensor),
            controller.torque_limits,
            controller.computation_delay,
            simulation.drive,
            plant if self.cases.plant_is_rebuilt else None,
            inputs.periods is None,
            inputs.age is None,
        )
        kept = self._loops.setdefault(law, [])
        present = next((loop for other, loop in kept if other == key), None)
        if present is None:
            method = self._integration
            loop = ClosedLoop(plant, controller, method.substeps, method.integrator, simulation.drive)
            names = () if self.cases.plant_is_rebuilt else self.cases.plant_parameters or ()
            present = TracedLoop(loop, initial, inputs, names)
            kept[:] = [(key, present), *kept[: MAX_LOOPS - 1]]
        return present


def outcome_of(
    simulation: Simulation, inputs: SampledInputs, record: Record, monitor: DivergenceMonitor, metrics_start: float
) -> Outcome:
    """Return what a study keeps of a run, with the measures from a time on [s]."""
    controller, index = simulation.controller, monitor.divergence_index
    with np.errstate(all="ignore"):
        signals = with_derived_signals(record, controller, inputs)
    times = inputs.times[: len(signals["position"])]
    period = controller.law.period
    end_time = len(inputs.times) * period if index is None else float(inputs.times[index])
    if len(times) < 2 or times[-2] < metrics_start:
        return Outcome({}, index is None, end_time)
    first = int(np.searchsorted(times, metrics_start - 1e-9))
    limits = controller.torque_limits
    with np.errstate(all="ignore"):
        measures = compute_measures(
            {name: signals[name][first:] for name in SIGNALS if name in signals},
            period,
            largest_torques(controller),
            simulation.plant.units,
            has_rate_limit=limits is not None and limits.rate is not None,
        )
    return Outcome(measures, index is None, end_time)


def traced_parameters(sensor: Encoder) -> tuple[object, ...]:
    """Return what a traced loop has of a sensor: its parameters but for the noise, which is an input."""
    return tuple(
        np.asarray(value).tolist() if value is not None else None
        for field in fields(sensor)
        if field.name not in DRAWN_BEFORE
        for value in [getattr(sensor, field.name)]
    )


def chunk_result(
    outcomes: Sequence[Sequence[Outcome]],
    applied: Sequence[dict[str, float | Array]],
    laws: Sequence[int],
    measures: Sequence[str],
) -> ChunkResult:
    """Join the outcomes of runs and laws.

    Parameters
    ----------
    outcomes
        Per run, and in it per law.
    applied
        Applied values of each run, by key: a number, or one per law of the study.
    laws
        Numbers of the laws of the outcomes among those of the study.
    measures
        Names of the measures.
    """
    values = {
        name: np.array([[outcome.measures.get(name, np.nan) for outcome in row] for row in outcomes])
        for name in measures
    }
    columns: dict[str, Array] = {}
    for key in applied[0] if applied else ():
        column = np.array([row[key] for row in applied])
        columns[key] = column[:, list(laws)] if column.ndim == 2 else column
    completed = np.array([[outcome.completed for outcome in row] for row in outcomes], dtype=bool)
    end_time = np.array([[outcome.end_time for outcome in row] for row in outcomes])
    return ChunkResult(values, completed, end_time, columns)


class SideBySide:
    """Engines of several laws as one: each runs its laws, on the same draws.

    Parameters
    ----------
    engines
        Engines, each with the numbers of its laws among those of the study.
    n_laws
        Number of laws of the study.
    """

    def __init__(self, engines: Sequence[tuple[Engine, Sequence[int]]], n_laws: int):
        self.engines = list(engines)
        self._n_laws = n_laws
        self.name = ", ".join(dict.fromkeys(engine.name for engine, _ in engines))

    def run(self, indices: Array, values: Array, seeds: Array) -> ChunkResult:
        """Run a chunk by every engine, as `Engine.run`."""
        shape = len(indices), self._n_laws
        joined = ChunkResult({}, np.zeros(shape, dtype=bool), np.full(shape, np.nan), {})
        for engine, laws in self.engines:
            result, places = engine.run(indices, values, seeds), list(laws)
            joined.completed[:, places] = result.completed
            joined.end_time[:, places] = result.end_time
            for name, block in result.measures.items():
                joined.measures.setdefault(name, np.full(shape, np.nan))[:, places] = block
            for key, column in result.applied.items():
                if column.ndim == 1:
                    joined.applied[key] = column
                else:
                    joined.applied.setdefault(key, np.full(shape, np.nan))[:, places] = column
        return joined
