"""Many runs of one closed loop in machine code: the loop over time inside, several runs side by side."""

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.lane_loop import OWN, PARAMETER, SHARED, LaneLoop, LaneResult, aligned, processor_lanes
from tarc.core.tracing import TRACE_ERRORS, expressions
from tarc.core.trees import pack
from tarc.core.types import Array, Tree, Vector
from tarc.simulation.batch_inputs import REFERENCE, BatchInputs, LoopCase, RunInputs, initials
from tarc.simulation.closed_loop import ClosedLoop, LoopInput, LoopState
from tarc.simulation.integration import Integration
from tarc.simulation.measure_sums import MeasureSums, Sums
from tarc.simulation.sampled_inputs import InitialConditions, SampledInputs
from tarc.simulation.varying import (
    DRAWN_BEFORE,
    Numbers,
    Path,
    are_close,
    at,
    changes,
    differing,
    numbers_at,
    replaced,
    with_symbols,
)

TRIAL_PERIODS = 25
"""Periods in which a loop with symbols is compared with one that was built with its numbers."""
PLANT = "plant"
"""First element of the path of a plant's parameter."""


class BatchInput(NamedTuple):
    """Inputs of one period by name: those that all runs share, those of each run, and the numbers that vary."""

    shared: dict[str, Vector]
    own: dict[str, Vector]
    varying: Vector


class BatchState(NamedTuple):
    """State of the loop, and the sums of its measures."""

    loop: LoopState
    sums: Sums


class BatchResult(NamedTuple):
    """Results of runs, each (runs,): measures by name, NaN where a run ended before; whether and when it ended [s]."""

    measures: dict[str, Array]
    completed: Array
    end_time: Array


class BatchLoop:
    """A closed loop as one function in machine code, for runs that differ in numbers, inputs and initial state.

    The numbers that differ between the examples are arguments, so that one compilation serves all runs.

    Parameters
    ----------
    cases
        Examples that show what varies, at least one.
    integration
        Method and steps of the plant.
    duration
        Of each run [s].
    metrics_start
        Time from which the measures count [s].
    divergence_threshold
        Error [rad or m] beyond which a run ends.
    lanes
        Runs side by side; None for as many as a vector of this processor holds.

    Raises
    ------
    UnsupportedLaw
        For parts that are traced with numbers alone where numbers vary, and for loops of different structure.
    """

    def __init__(
        self,
        cases: Sequence[LoopCase],
        integration: Integration,
        duration: float,
        *,
        metrics_start: float = 0.0,
        divergence_threshold: float = 5.0,
        lanes: int | None = None,
    ):
        self._integration, self._threshold = integration, divergence_threshold
        self._base = base = cases[0]
        self.inputs = BatchInputs(cases, integration.substeps, duration)
        self._duration, self._metrics_start = self.inputs.n_periods * base.controller.law.period, metrics_start
        self._first_measured = self._measured_from(base, cases)
        state, example = self._example(base)
        self._sums = MeasureSums(base.loop(integration), example)
        self._state = BatchState(state, self._sums.start())
        self._packed_sums = pack(self._sums.start())
        for case in cases[1:]:
            self._example(case)  # so that all have computed what they keep
        self._numbers = [_Parts(case) for case in cases]
        self._varying_masks = self._varying()
        self._masks = dict(self._varying_masks)
        self._function_of_loop = self._traced(cases)
        self.lanes = processor_lanes() if lanes is None else lanes

    @cached_property
    def machine(self) -> LaneLoop:
        """The loop in machine code, compiled when it is first needed.

        Raises
        ------
        UnsupportedLaw
            For a law that has no C.
        MissingTool, CompilationError
            Without a C compiler, and where it fails.
        """
        return LaneLoop(self._function_of_loop, self._places(), len(self._packed_sums), self.lanes)

    @property
    def varying(self) -> list[str]:
        """Return the names of what varies between the runs and is an argument, with the place in a vector or matrix."""
        return [
            ".".join(map(str, path)) + "".join(f"[{i}]" for i in place)
            for path, mask in self._masks.items()
            for place in np.argwhere(mask)
        ]

    def _measured_from(self, base: LoopCase, cases: Sequence[LoopCase]) -> int:
        """Return the first period that the measures count."""
        period, start = base.controller.law.period, self._metrics_start - 1e-9
        first = int(np.searchsorted(np.arange(self.inputs.n_periods) * period, start))
        is_whole = abs(self._metrics_start / period - round(self._metrics_start / period)) < 1e-6
        if any(case.jitter for case in cases) and not is_whole:
            raise UnsupportedLaw("compiled: with jitter, metrics_start must be a whole number of periods")
        return first

    def _example(self, case: LoopCase) -> tuple[LoopState, Any]:
        """Return state and output of one period with numbers."""
        loop, sampled = case.loop(self._integration), self.inputs.of_run(case, 1).sampled
        state = self._start(case, sampled)
        shapes, n = self.inputs.shapes, case.plant.n_joints
        zero = np.zeros(n)
        schedules = {name: np.ravel(case.parameters[name]) for name in sampled.schedules}
        value = LoopInput(
            reference=zero,
            velocity_reference=zero,
            acceleration_reference=zero,
            noise=zero,
            disturbance=np.zeros((n, self._integration.substeps)),
            parameters=schedules,
            period=np.full(1 if "period" in shapes else 0, loop.controller.law.period),
            age=np.zeros(1 if "age" in shapes else 0),
        )
        _, output = loop.step(state, value)
        return state, output

    def _start(self, case: LoopCase, sampled: SampledInputs, initial: InitialConditions | None = None) -> LoopState:
        """Return the state of the loop at the start of a run."""
        initial = initial or case.initial(sampled)
        needs_plant = case.controller.needs_true_derivatives
        loop = case.loop(self._integration, case.actual_plant if needs_plant else case.plant)
        return loop.init(initial.position, initial.velocity, initial.torque, sampled.noise[:, 0])

    def _varying(self) -> dict[Path, Array]:
        """Return what varies between the examples, as masks by path."""
        first = self._numbers[0]
        for other in self._numbers[1:]:
            different = [path for path, value in first.structure.items() if other.structure.get(path) != value]
            if different or len(first.structure) != len(other.structure):
                places = ", ".join(".".join(map(str, path)) for path in different[:3])
                raise UnsupportedLaw(f"compiled: the runs differ in {places or 'their structure'}, which is no number")
        return differing([part.numbers for part in self._numbers])

    def _traced(self, cases: Sequence[LoopCase]) -> ca.Function:
        """Trace with symbols for as much of what varies as can be, and compare with loops built with their numbers."""
        every = dict(self._masks)
        function = self._function(cases[0], every)
        if function is None:
            taken: dict[Path, Array] = {}
            for path, mask in every.items():
                if self._function(cases[0], {**taken, path: mask}) is not None:
                    taken[path] = mask
            self._masks = taken
            function = self._function(cases[0], taken)
            if function is None:
                function = self._function(cases[0], {}, is_checked=False)
                self._masks = {}
        assert function is not None
        if every:
            for case in cases[1:]:
                self._compare(function, case)
        return function

    def _function(self, case: LoopCase, masks: dict[Path, Array], *, is_checked: bool = True) -> ca.Function | None:
        """Trace a case with symbols at some numbers; None where a part decides by one."""
        count = sum(int(np.sum(mask)) for mask in masks.values())
        value = BatchInput(
            {name: np.zeros(self.inputs.shapes[name]) for name in self.inputs.shared},
            {name: np.zeros(self.inputs.shapes[name]) for name in self.inputs.own},
            np.zeros(count),
        )

        def step(state: BatchState, value: BatchInput) -> tuple[BatchState, Tree]:
            return self._step(case, masks, state, value)

        try:
            inputs, results = expressions(step, self._state, value, name="period")
        except TRACE_ERRORS as error:
            if masks and is_checked:
                return None
            message, _, _ = str(error).partition("\n")
            raise UnsupportedLaw(f"compiled: the loop cannot be traced: {message}") from error
        next_state, output = (ca.densify(result) for result in results)
        outputs = [next_state, output[:-1], output[-1]]
        return ca.Function("period", inputs, outputs, ["x", "u"], ["next", "torque", "bounded"], {"cse": True})

    def _step(
        self, case: LoopCase, masks: dict[Path, Array], state: BatchState, value: BatchInput
    ) -> tuple[BatchState, Tree]:
        """Step the loop and the sums; the output is the torque, and whether the error is within bounds."""
        numbers = _Parts(case).numbers
        symbols, start = {}, 0
        for path, mask in masks.items():
            stop = start + int(np.sum(mask))
            symbols[path] = with_symbols(numbers.values[path], mask, value.varying[start:stop])
            start = stop
        loop = case.loop(self._integration)
        parts = {path: symbol for path, symbol in symbols.items() if path[0] != PLANT}
        controller, drive = replaced((loop.controller, loop.drive), parts)
        loop = ClosedLoop(loop.plant, controller, loop.substeps, loop.integrator, drive)
        constant = {name: ca.SX(np.ravel(value)) for name, value in case.plant_parameters.items()}
        parameters = constant | {str(path[1]): symbol for path, symbol in symbols.items() if path[0] == PLANT}
        inputs = self._loop_input(value, parameters)
        next_state, output = loop.step(state.loop, inputs)
        sums = self._sums.step(state.sums, loop, inputs, output)
        error = ca.fabs(output.position - inputs.reference)
        is_bounded = ca.SX(1)
        for joint in range(error.shape[0]):
            is_bounded = ca.logic_and(is_bounded, error[joint] <= self._threshold)
        return BatchState(next_state, sums), (output.controller.torque, is_bounded)

    def _loop_input(self, value: BatchInput, parameters: dict[str, Vector]) -> LoopInput:
        """Return the inputs of a period; those that are zero in all runs are constants."""
        given = {**value.shared, **value.own}
        n, substeps = self._base.plant.n_joints, self._integration.substeps

        def block(name: str, *shape: int) -> Vector:
            return given[name] if name in given else ca.SX(np.zeros(shape))

        scheduled = {name.removeprefix("parameters."): rows for name, rows in given.items() if "parameters." in name}
        nothing = np.zeros(0)
        reference, velocity_reference, acceleration_reference = (block(name, n) for name in REFERENCE)
        return LoopInput(
            reference,
            velocity_reference,
            acceleration_reference,
            block("noise", n),
            block("disturbance", n, substeps),
            {**parameters, **scheduled},
            given.get("period", nothing),
            given.get("age", nothing),
        )

    def _places(self) -> list[tuple[str, int]]:
        """Return array and index of each element of the input."""
        places: list[tuple[str, int]] = []
        for array, names in ((SHARED, self.inputs.shared), (OWN, self.inputs.own)):
            count = sum(int(np.prod(self.inputs.shapes[name])) for name in names)
            places += [(array, i) for i in range(count)]
        return places + [(PARAMETER, i) for i in range(sum(int(np.sum(mask)) for mask in self._masks.values()))]

    def _compare(self, function: ca.Function, case: LoopCase) -> None:
        """Refuse a function whose symbols do not do what the numbers do with which a loop is built."""
        expected = self._function(case, {})
        assert expected is not None
        inputs = self.inputs.of_run(case, 2)
        state = pack(BatchState(self._start(case, inputs.sampled), self._sums.start()))
        values = self.arguments(case)
        for k in range(min(TRIAL_PERIODS, self.inputs.n_periods)):
            row = np.concatenate([self.inputs.rows[k], inputs.own[:, k]])
            theirs = [np.array(one)[:, 0] for one in expected(state, row)]
            ours = [np.array(one)[:, 0] for one in function(state, np.concatenate([row, values]))]
            if not all(map(are_close, ours, theirs)):
                names = ", ".join(".".join(map(str, path)) for path in self._varying_masks)
                raise UnsupportedLaw(
                    f"compiled: of the numbers that vary ({names}), one enters what is computed when a part is built"
                )
            state = theirs[0]

    def arguments(self, case: LoopCase) -> Array:
        """Return the numbers of a case that are arguments, in the order of `varying`."""
        parts, parameters = (case.controller, case.drive), case.parameters
        values = [
            numbers_at(parameters[str(path[1])] if path[0] == PLANT else at(parts, path), mask)
            for path, mask in self._masks.items()
        ]
        return np.concatenate(values) if values else np.zeros(0)

    def covers(self, case: LoopCase) -> bool:
        """Return whether a case differs from the examples in nothing but its inputs and arguments."""
        ours, theirs = self._base.controller, case.controller
        pairs: list[tuple[Path, object, object]] = [
            ((0, name), getattr(ours, name), getattr(theirs, name))
            for name in ("law", "sensor", "torque_limits", "computation_delay")
        ]
        pairs.append(((1,), self._base.drive, case.drive))
        changed = [one for path, our, their in pairs for one in changes(our, their, path)]
        base = self._base.parameters
        changed += [((PLANT, name), base[name], value) for name, value in case.parameters.items()]
        return all(self._may_differ(*one) for one in changed) and self._has_same_structure(case, pairs, changed)

    def _has_same_structure(
        self,
        case: LoopCase,
        pairs: Sequence[tuple[Path, object, object]],
        changed: Sequence[tuple[Path, object, object]],
    ) -> bool:
        """Return whether what a case computes from changed numbers has the same counts as in the first example."""
        if bool(case.jitter) != bool(self._base.jitter):
            return False
        method, period = self._integration, case.controller.law.period
        if case.drive is not self._base.drive and case.drive is not None and self._base.drive is not None:
            ours, theirs = (one.segments(method.substeps, period) for one in (self._base.drive, case.drive))
            if ours != theirs:
                return False
        structure = self._numbers[0].structure
        for path, _, part in pairs:
            if any(one[: len(path)] == path and one[-1] not in DRAWN_BEFORE for one, _, _ in changed):
                theirs = Numbers(part).structure
                if any(structure.get((*path, *inner), one) != one for inner, one in theirs.items()):
                    return False
        return True

    def _may_differ(self, path: Path, ours: object, theirs: object) -> bool:
        """Return whether values of two cases are equal but for what varies between the examples."""
        mask = self._varying_masks.get(path)
        ours, theirs = np.asarray(ours), np.asarray(theirs)
        if ours.shape != theirs.shape or ours.dtype != theirs.dtype:
            return False
        is_equal = ours == theirs
        return bool(np.all(is_equal if mask is None else is_equal | mask))

    def run(self, cases: Sequence[LoopCase], inputs: Sequence[RunInputs]) -> BatchResult:
        """Run the cases, each with its inputs, as `BatchInputs.of_run` of `inputs` samples them."""
        if len(cases) != len(inputs):
            raise InvalidParameter(f"cases, inputs: got {len(cases)} and {len(inputs)}; needs those of each case")
        parts = []
        for start in range(0, len(cases), self.lanes):
            parts.append(self._side_by_side(cases[start : start + self.lanes], inputs[start : start + self.lanes]))
        names = parts[0].measures
        return BatchResult(
            {name: np.concatenate([part.measures[name] for part in parts]) for name in names},
            np.concatenate([part.completed for part in parts]),
            np.concatenate([part.end_time for part in parts]),
        )

    def sample(self, cases: Sequence[LoopCase], seeds: Iterable[int]) -> list[RunInputs]:
        """Sample the inputs of each case with its seed."""
        return [self.inputs.of_run(case, int(seed)) for case, seed in zip(cases, seeds, strict=True)]

    def _side_by_side(self, cases: Sequence[LoopCase], inputs: Sequence[RunInputs]) -> BatchResult:
        """Run at most as many cases as there are lanes."""
        return self._results(self.machine.run(*self.lane_arrays(cases, inputs)), inputs)

    def lane_arrays(
        self, cases: Sequence[LoopCase], inputs: Sequence[RunInputs]
    ) -> tuple[int, int, *tuple[Array, ...]]:
        """Return what `LaneLoop.run` takes for at most as many cases as there are lanes; the last fills those left."""
        n_periods, n_runs = self.inputs.n_periods, len(cases)
        own = aligned((n_periods, self.inputs.n_own, self.lanes))
        arguments = aligned((sum(int(np.sum(mask)) for mask in self._masks.values()), self.lanes))
        states = np.zeros((len(self._packed_sums) + len(pack(self._state.loop)), self.lanes))
        initial = initials(cases, [run.sampled for run in inputs])
        for lane in range(self.lanes):
            if lane >= n_runs:
                for array in (own, arguments, states):
                    array[..., lane] = array[..., n_runs - 1]
                continue
            case, run = cases[lane], inputs[lane]
            own[:, :, lane] = run.own.T
            arguments[:, lane] = self.arguments(case)
            start = pack(self._start(case, run.sampled, initial[lane]))
            states[: len(start), lane] = start
        return n_periods, self._first_measured, states, self.inputs.rows, own, arguments

    def _results(self, result: LaneResult, runs: Sequence[RunInputs]) -> BatchResult:
        """Return measures and ends of the runs."""
        n_periods, first, n_runs = self.inputs.n_periods, self._first_measured, len(runs)
        ends = result.ends[:n_runs]
        completed = ends < 0
        last = np.where(completed, n_periods, np.maximum(ends, 1))
        end_time = np.array(
            [
                self._duration if is_done else run.times[end]
                for is_done, run, end in zip(completed, runs, ends, strict=True)
            ]
        )
        has_measures = np.array(
            [stop >= 2 and run.times[stop - 2] >= self._metrics_start for run, stop in zip(runs, last, strict=True)]
        )
        sums = self._sums.by_name(result.state[len(result.state) - len(self._packed_sums) :, :n_runs])
        torque = np.ascontiguousarray(result.record[first:, :, :n_runs].transpose(2, 1, 0))
        shares: dict[str, Array] = {}
        for stop in np.unique(last[has_measures]):
            chosen = np.flatnonzero(has_measures & (last == stop))
            for suffix, values in self._sums.shares(torque[chosen, :, : stop - first]).items():
                shares.setdefault(suffix, np.full(n_runs, np.nan))[chosen] = values
        shares = shares or {suffix: np.full(n_runs, np.nan) for suffix in self._sums.suffixes}
        with np.errstate(divide="ignore", invalid="ignore"):
            measures = self._sums.measures(sums, shares)
        measures = {name: np.where(has_measures, value, np.nan) for name, value in measures.items()}
        return BatchResult(measures, completed, end_time)


class _Parts:
    """Numbers of a case by path: those of controller and drive, and the plant's parameters."""

    def __init__(self, case: LoopCase):
        self.numbers = Numbers((case.controller, case.drive))
        for name, value in case.parameters.items():
            self.numbers.values[PLANT, name] = value
            self.numbers.structure[PLANT, name] = value.shape

    @property
    def structure(self) -> dict[Path, object]:
        """Return what is no number."""
        return self.numbers.structure
