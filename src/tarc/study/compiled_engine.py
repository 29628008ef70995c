"""Engine of studies in machine code: all laws on the same draws and the same noise, several runs side by side."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tarc.control.digital_controller import DigitalController
from tarc.core.errors import UnsupportedLaw
from tarc.core.lane_loop import processor_lanes
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.plants.symbolic import SymbolicPlant
from tarc.simulation.batch import BatchLoop, BatchResult
from tarc.simulation.batch_inputs import LoopCase, RunInputs
from tarc.simulation.integration import Integration
from tarc.simulation.simulator import with_limits
from tarc.simulation.varying import Numbers
from tarc.study.cases import Case, Cases
from tarc.study.distributions import Choice
from tarc.study.engines import ChunkResult, Simulator

COMPILED = "compiled"
LANES = "lanes"

EXAMPLES = 4
"""Rows of values from which is seen what varies from run to run."""

Structure = tuple[object, ...]
"""What of a case is no number: cases that differ in it are different loops."""


@dataclass
class _Run:
    """A run that waits for its lane: its number in the chunk, its case, its seed, and its inputs once sampled."""

    place: int
    case: Case
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
        self._nominal_laws: dict[str, Law] = {}
        for law in laws:
            self.add(law)

    def add(self, law: str) -> None:
        """Compile one more law; it raises what the class raises."""
        self._loop(law, self._examples(None)[0])
        self.laws.append(law)

    def run(self, indices: Array, values: Array, seeds: Array) -> ChunkResult:
        """Run a chunk, as `Engine.run`."""
        shape = len(indices), len(self.laws)
        result = ChunkResult({}, np.zeros(shape, dtype=bool), np.full(shape, np.nan), {})
        groups: dict[Structure, list[_Run]] = {}
        for place, (row, seed) in enumerate(zip(values, seeds, strict=True)):
            case = self.cases.build(row)
            self._keep_applied(result, place, shape, case)
            groups.setdefault(self._structure(case), []).append(_Run(place, case, int(seed)))
        left = []
        for group in groups.values():
            for start in range(0, len(group), self.lanes):
                left += self._side_by_side(group[start : start + self.lanes], values, result, shape)
        self._by_virtual_machine(left, indices, values, seeds, result, shape)
        return result

    def _side_by_side(
        self, runs: Sequence[_Run], values: Array, result: ChunkResult, shape: tuple[int, int]
    ) -> list[tuple[int, str]]:
        """Run all laws of some runs of the same structure; return number and law of those that are not covered."""
        left = []
        for run in runs:
            run.loops = {law: self._loop_case(run.case, law) for law in self.laws}
        for number, law in enumerate(self.laws):
            loop = self._loop(law, runs[0].case)
            covered = [run for run in runs if loop.covers(run.loops[law])]
            left += [(run.place, law) for run in runs if run not in covered]
            if not covered:
                continue
            for run in covered:
                if run.inputs is None or len(run.inputs.own) != loop.inputs.n_own:
                    run.inputs = loop.inputs.of_run(run.loops[law], run.seed)
            inputs = [run.inputs for run in covered if run.inputs is not None]
            batch = loop.run([run.loops[law] for run in covered], inputs)
            _keep(result, shape, [run.place for run in covered], number, batch)
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
            simulator = Simulator(self.cases, self._integration, [law])
            rows = slice(place, place + 1)
            one = simulator.run(indices[rows], values[rows], seeds[rows])
            measures = {name: block[:, 0] for name, block in one.measures.items()}
            batch = BatchResult(measures, one.completed[:, 0], one.end_time[:, 0])
            _keep(result, shape, [place], self.laws.index(law), batch)

    def _keep_applied(self, result: ChunkResult, place: int, shape: tuple[int, int], case: Case) -> None:
        """Keep the values that were read back of a run."""
        places = [self.cases.law_names.index(name) for name in self.laws]
        for key, value in case.applied.items():
            is_of_law = np.ndim(value) == 1
            column = result.applied.setdefault(key, np.full(shape if is_of_law else shape[:1], np.nan))
            column[place] = np.asarray(value)[places] if is_of_law else value

    def _loop_case(self, case: Case, law: str) -> LoopCase:
        """Return the loop of one law in a case."""
        setup, plant = case.setup, case.setup.simulated
        assert isinstance(plant, SymbolicPlant)
        if law not in self._nominal_laws:  # the checks of `simulate`, once
            Simulator(self.cases, self._integration, [law]).prepared(case, setup.laws[law], 0)
            self._nominal_laws[law] = with_limits(self.cases.nominal.laws[law], plant)
        is_nominal = setup.laws[law] is self.cases.nominal.laws[law]
        limited = self._nominal_laws[law] if is_nominal else with_limits(setup.laws[law], plant)
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

    def _structure(self, case: Case) -> Structure:
        """Return what of a case is no number, as far as it may differ from the scenario's."""
        setup, nominal = case.setup, self.cases.nominal
        pairs = [
            (setup.sensor, nominal.sensor),
            (setup.torque_limits, nominal.torque_limits),
            (setup.drive, nominal.drive),
            *((setup.laws[name], nominal.laws[name]) for name in self.cases.law_names),
        ]
        method = self._integration
        segments = None if setup.drive is None else setup.drive.segments(method.substeps, self.cases.scenario.period)
        drawn = tuple(
            None if part is of_scenario else tuple(Numbers.declared(part).structure.items())
            for part, of_scenario in pairs
        )
        return (*drawn, case.computation_delay, bool(case.jitter), None if segments is None else tuple(segments))

    def _loop(self, law: str, case: Case) -> BatchLoop:
        """Return the loop of a law in machine code, for cases of the structure of one."""
        structure = self._structure(case)
        key = law, structure
        if key not in self._loops:
            examples = [one for one in self._examples(case) if self._structure(one) == structure] or [case]
            scenario = self.cases.scenario
            self._loops[key] = BatchLoop(
                [self._loop_case(one, law) for one in examples],
                self._integration,
                scenario.duration,
                metrics_start=scenario.metrics_start,
                divergence_threshold=scenario.divergence_threshold,
                lanes=self.lanes,
            )
        return self._loops[key]

    def _examples(self, case: Case | None) -> list[Case]:
        """Return cases that depend on the study alone, with the choices of one where there is one."""
        distributions = self.cases.distributions
        probabilities = np.random.default_rng(0).uniform(0.05, 0.95, (EXAMPLES, len(distributions)))
        columns = [one.quantile(column) for one, column in zip(distributions, probabilities.T, strict=True)]
        for number, (key, one) in enumerate(zip(self.cases.keys, distributions, strict=True)):
            if case is not None and isinstance(one, Choice):
                applied = np.asarray(case.applied[key.name], dtype=float)
                columns[number] = np.full(EXAMPLES, np.ravel(applied[~np.isnan(applied)])[0])
        return [self.cases.build(row) for row in np.array(columns).T]


def _keep(result: ChunkResult, shape: tuple[int, int], places: Sequence[int], law: int, batch: BatchResult) -> None:
    """Put the results of some runs of one law among those of the chunk."""
    for name, values in batch.measures.items():
        result.measures.setdefault(name, np.full(shape, np.nan))[places, law] = values
    result.completed[places, law] = batch.completed
    result.end_time[places, law] = batch.end_time
