"""Engine of studies in machine code: all laws on the same draws and the same noise, several runs side by side."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tarc.control.digital_controller import DigitalController
from tarc.core.errors import CompilationError, EngineWarning, UnsupportedLaw
from tarc.core.lane_loop import processor_lanes
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.plants.symbolic import SymbolicPlant
from tarc.simulation.batch import BatchLoop, BatchResult
from tarc.simulation.batch_inputs import LoopCase, RunInputs
from tarc.simulation.integration import Integration
from tarc.simulation.simulator import with_limits
from tarc.study.cases import Cases
from tarc.study.direct_draws import DirectDraws, DirectRun
from tarc.study.distributions import Choice
from tarc.study.drawn_case import Case
from tarc.study.drawn_keys import NUMBERS
from tarc.study.engines import ChunkResult, Simulator

COMPILED = "compiled"
LANES = "lanes"

Structure = tuple[float, ...]
"""Choices that make loops of their own, such as numbers of bits."""


@dataclass
class _Run:
    """A run that waits for its lane: its number in the chunk, its parts, its seed, and its inputs once sampled."""

    place: int
    parts: Case | DirectRun
    seed: int
    loops: dict[str, LoopCase] = field(default_factory=dict)
    inputs: RunInputs | None = None


class CompiledEngine:
    """Engine that runs loops in machine code.

    Runs whose loop has another structure, such as another number of bits, have a function of their own. What differs in
    constants alone shares its machine code. A run with a number that the examples do not show as varying is left to the
    virtual machine.

    Parameters
    ----------
    cases
        What builds the parts of each run.
    integration
        Method and steps of all runs.
    laws
        Names of the laws to run.
    lanes
        Runs side by side; None for as many as a vector of this processor holds.

    Attributes
    ----------
    n_left
        Count of runs, of one law each, that were left to the virtual machine.

    Raises
    ------
    UnsupportedLaw
        For a law that has no C or is traced with numbers alone where numbers are drawn. For a robot in MuJoCo, and one
        whose equations change from run to run.
    MissingTool, CompilationError
        Without a C compiler, and where it fails.
    """

    def __init__(self, cases: Cases, integration: Integration, laws: Sequence[str], lanes: int | None = None):
        if not isinstance(cases.nominal.simulated, SymbolicPlant):
            raise UnsupportedLaw("compiled: the robot is simulated in MuJoCo")
        if cases.plant_is_rebuilt:
            raise UnsupportedLaw("compiled: the draws change the robot's equations, and not its parameters alone")
        self.cases = cases
        self.laws: list[str] = []
        self.lanes = processor_lanes() if lanes is None else lanes
        self.name = COMPILED if self.lanes == 1 else LANES
        self._integration = integration
        self._loops: dict[tuple[str, Structure], BatchLoop] = {}
        self._nominal_laws: dict[tuple[str, tuple[float, ...]], Law] = {}
        self._nominal_cases: dict[str, LoopCase] = {}
        self._simulators: dict[str, Simulator] = {}
        self._direct = DirectDraws(cases) if DirectDraws.is_possible(cases) else None
        self._structural: set[int] = set()
        self.n_left = 0
        for law in laws:
            self.add(law)

    def add(self, law: str) -> None:
        """Compile one more law; it raises what the class raises.

        A compiler without vector types compiles the first law once more, for one run at a time.
        """
        self._find_structural(law)
        try:
            _ = self._loop(law, self.cases.typical_row).machine
        except CompilationError:
            if self.lanes == 1 or self.laws:
                raise
            self.lanes, self.name = 1, COMPILED
            self._loops.clear()
            _ = self._loop(law, self.cases.typical_row).machine
        self.laws.append(law)

    def run(self, indices: Array, values: Array, seeds: Array) -> ChunkResult:
        """Run a chunk, as `Engine.run`."""
        shape = len(indices), len(self.laws)
        result = ChunkResult({}, np.zeros(shape, dtype=bool), np.full(shape, np.nan), {})
        groups: dict[Structure, list[_Run]] = {}
        direct = self._direct.runs(values) if self._direct and len(values) else []
        for place, (row, seed) in enumerate(zip(values, seeds, strict=True)):
            parts = direct[place] if direct else self.cases.build(row)
            self._keep_applied(result, place, shape, parts)
            groups.setdefault(self._structure(row), []).append(_Run(place, parts, int(seed)))
        left = []
        for group in groups.values():
            for start in range(0, len(group), self.lanes):
                left += self._side_by_side(group[start : start + self.lanes], values, result, shape)
        if left and not self.n_left:
            warnings.warn(
                "lanes: some runs have numbers or choices that are no arguments of the compiled loop; they are "
                "simulated in the virtual machine",
                EngineWarning,
                stacklevel=2,
            )
        self.n_left += len(left)
        self._by_virtual_machine(left, indices, values, seeds, result, shape)
        return result

    def _side_by_side(
        self, runs: Sequence[_Run], values: Array, result: ChunkResult, shape: tuple[int, int]
    ) -> list[tuple[int, str]]:
        """Run all laws of some runs of the same structure; return number and law of those that are not covered."""
        left = []
        for run in runs:
            run.loops = {law: self._loop_of(run.parts, law) for law in self.laws}
        for number, law in enumerate(self.laws):
            try:
                loop = self._loop(law, values[runs[0].place])
            except UnsupportedLaw:  # for these choices alone; the others have their loop
                left += [(run.place, law) for run in runs]
                continue
            covered = [run for run in runs if self._direct or loop.covers(run.loops[law])]
            left += [(run.place, law) for run in runs if run not in covered]
            if not covered:
                continue
            for run in covered:
                if run.inputs is None or len(run.inputs.own) != loop.inputs.n_own:
                    run.inputs = loop.inputs.of_run(run.loops[law], run.seed)
            inputs = [run.inputs for run in covered if run.inputs is not None]
            batch = loop.run([run.loops[law] for run in covered], inputs)
            _keep(result, shape, [run.place for run in covered], number, batch)
        for run in runs:  # a chunk may have thousands
            run.inputs, run.loops = None, {}
        return left

    def _by_virtual_machine(
        self,
        left: Sequence[tuple[int, str]],
        indices: Array,
        values: Array,
        seeds: Array,
        result: ChunkResult,
        shape: tuple[int, int],
    ) -> None:
        """Run what is not covered, one by one."""
        for place, law in left:
            if law not in self._simulators:
                self._simulators[law] = Simulator(self.cases, self._integration, [law])
            rows = slice(place, place + 1)
            one = self._simulators[law].run(indices[rows], values[rows], seeds[rows])
            measures = {name: block[:, 0] for name, block in one.measures.items()}
            batch = BatchResult(measures, one.completed[:, 0], one.end_time[:, 0])
            _keep(result, shape, [place], self.laws.index(law), batch)

    def _keep_applied(self, result: ChunkResult, place: int, shape: tuple[int, int], case: Case | DirectRun) -> None:
        """Keep the values that were read back of a run."""
        places = [self.cases.law_names.index(name) for name in self.laws]
        for key, value in case.applied.items():
            is_of_law = np.ndim(value) == 1
            column = result.applied.setdefault(key, np.full(shape if is_of_law else shape[:1], np.nan))
            column[place] = np.asarray(value)[places] if is_of_law else value

    def _loop_of(self, parts: Case | DirectRun, law: str) -> LoopCase:
        """Return the loop of one law in a run."""
        if isinstance(parts, Case):
            return self._loop_case(parts, law)
        return self._nominal_case(law).with_numbers(parts.parameters, parts.sensor)

    def _nominal_case(self, law: str) -> LoopCase:
        """Return the loop of one law in the scenario as written."""
        if law not in self._nominal_cases:
            scenario, nominal = self.cases.scenario, self.cases.nominal
            more = {name: getattr(scenario, name) for name in NUMBERS}
            self._nominal_cases[law] = self._loop_case(Case(nominal, **more, applied={}), law)
        return self._nominal_cases[law]

    def _loop_case(self, case: Case, law: str) -> LoopCase:
        """Return the loop of one law in a case."""
        setup, plant = case.setup, case.setup.simulated
        assert isinstance(plant, SymbolicPlant)
        if (law, case.choices) not in self._nominal_laws:  # the checks of `simulate`, once
            Simulator(self.cases, self._integration, [law]).prepared(case, setup.laws[law], 0)
            self._nominal_laws[law, case.choices] = with_limits(self.cases.nominal.laws[law], plant)
        is_nominal = setup.laws[law] is self.cases.nominal.laws[law]
        limited = self._nominal_laws[law, case.choices] if is_nominal else with_limits(setup.laws[law], plant)
        return LoopCase(
            plant,
            DigitalController(setup.sensor, limited, case.computation_delay, setup.torque_limits),
            setup.reference.for_run(plant.joint_names, self.cases.scenario.duration),
            tuple(setup.events),
            setup.drive,
            case.jitter,
            case.initial_position,
            case.initial_velocity,
            case.initial_torque,
        )

    def _loop(self, law: str, row: Array) -> BatchLoop:
        """Return the loop of a law in machine code, for runs with the structural choices of a row."""
        key = law, self._structure(row)
        if key not in self._loops:
            self._loops[key] = self._traced(law, self._examples(row))
        return self._loops[key]

    def _structure(self, row: Array) -> Structure:
        """Return the choices of a row that make loops of their own."""
        return tuple(float(row[column]) for column in sorted(self._structural))

    def _traced(self, law: str, rows: Array) -> BatchLoop:
        """Trace the loop of a law for runs like those of some rows."""
        scenario = self.cases.scenario
        return BatchLoop(
            [self._loop_case(self.cases.build(row), law) for row in rows],
            self._integration,
            scenario.duration,
            metrics_start=scenario.metrics_start,
            divergence_threshold=scenario.divergence_threshold,
            lanes=self.lanes,
        )

    def _find_structural(self, law: str) -> None:
        """Find the choices whose values are no arguments of one loop, such as numbers of bits."""
        for column, one in enumerate(self.cases.distributions):
            if not isinstance(one, Choice) or column in self._structural:
                continue
            if one.texts:
                self._structural.add(column)
                continue
            values = np.unique(one.numbers)
            rows = np.tile(self.cases.typical_row, (len(values), 1))
            rows[:, column] = values
            try:
                self._traced(law, rows)
            except UnsupportedLaw:
                self._structural.add(column)

    def _examples(self, row: Array) -> Array:
        """Return rows that depend on the study alone, but for the structural choices, which are those of a row."""
        rows = self.cases.example_rows()
        for column in self._structural:
            rows[:, column] = row[column]
        return rows


def _keep(result: ChunkResult, shape: tuple[int, int], places: Sequence[int], law: int, batch: BatchResult) -> None:
    """Put the results of some runs of one law among those of the chunk."""
    for name, values in batch.measures.items():
        result.measures.setdefault(name, np.full(shape, np.nan))[places, law] = values
    result.completed[places, law] = batch.completed
    result.end_time[places, law] = batch.end_time
