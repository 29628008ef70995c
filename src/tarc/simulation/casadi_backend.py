"""The closed loop as one CasADi function, for plants in symbols."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from tarc.control.digital_controller import DigitalController
from tarc.core.codegen import CompiledLoop
from tarc.core.errors import CompilationError, MissingTool
from tarc.core.tracing import BUFFER_PERIODS, PeriodBuffer, n_distinct_instructions, n_instructions, trace
from tarc.core.trees import pack
from tarc.core.types import Array, Vector
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.drive import Drive
from tarc.simulation.closed_loop import ClosedLoop, LoopInput, LoopOutput, LoopState
from tarc.simulation.monitor import DIVERGENCE_CHECK_INTERVAL, DivergenceMonitor
from tarc.simulation.record import Record
from tarc.simulation.sampled_inputs import InitialConditions, SampledInputs
from tarc.simulation.varying import VaryingParts

COMPILATION = 5e7
"""Instructions of the virtual machine that take as long as it takes to compile anything."""

COMPILATION_PER_INSTRUCTION = 4e4
"""Further ones for each instruction that is compiled."""

SHORT_RUN = 5e6
"""Instructions up to which a run ends in the virtual machine before its C is written."""

_interpreted_work: Counter[tuple[int, ...]] = Counter()
"""Instructions that this process has interpreted of loops of the same sizes, such as those of a search for gains."""


class _VaryingInput(NamedTuple):
    """Inputs of a period, and numbers of the loop that vary from run to run."""

    loop: LoopInput
    numbers: Vector


class TracedLoop:
    """A closed loop as one CasADi function, for runs that differ in inputs, initial state and plant parameters.

    Parameters
    ----------
    loop
        The loop to trace.
    initial, inputs
        Those of one of the runs; the shapes per period are the same for all others.
    parameters
        Plant parameters that differ from run to run, beside those of schedules. They are inputs of the function.
    varying
        What differs in controller and drive; these numbers are inputs too. None for nothing.
    """

    def __init__(
        self,
        loop: ClosedLoop,
        initial: InitialConditions,
        inputs: SampledInputs,
        parameters: Iterable[str] = (),
        varying: VaryingParts | None = None,
    ):
        self.loop = loop
        self._varying = varying
        self._parameters = list(dict.fromkeys([*inputs.schedules, *parameters]))
        n = loop.plant.n_joints
        zero = np.zeros(n)
        values = {name: np.array(loop.plant.parameters[name]) for name in self._parameters}
        period = np.full(0 if inputs.periods is None else 1, loop.controller.law.period)
        age = np.zeros(0 if inputs.age is None else 1)
        value = LoopInput(zero, zero, zero, zero, np.zeros((n, loop.substeps)), values, period, age)
        state = loop.init(initial.position, initial.velocity, initial.torque, inputs.noise[:, 0])
        if varying is None:
            self.function, self._example = trace(loop.step, state, value, name="period")
            return

        def step(state: LoopState, value: _VaryingInput) -> tuple[LoopState, LoopOutput]:
            if isinstance(value.numbers, ca.SX):
                controller, drive = varying.with_symbols(value.numbers)
                return replace(loop, controller=controller, drive=drive).step(state, value.loop)
            return loop.step(state, value.loop)

        given = _VaryingInput(value, np.zeros(varying.size))
        self.function, self._example = trace(step, state, given, name="period")

    def run(
        self,
        plant: SymbolicPlant,
        initial: InitialConditions,
        inputs: SampledInputs,
        monitor: DivergenceMonitor,
        native: bool | None = None,
        parts: tuple[DigitalController, Drive | None] | None = None,
    ) -> Record:
        """Run the loop on a plant with the same equations, by CasADi's virtual machine or in machine code.

        The parts are controller and drive, where these vary.
        """
        loop = self.loop if plant is self.loop.plant else replace(self.loop, plant=plant)
        if parts is not None:
            loop = replace(loop, controller=parts[0], drive=parts[1])
        state = loop.init(initial.position, initial.velocity, initial.torque, inputs.noise[:, 0])
        n, n_periods = plant.n_joints, len(inputs.times)
        advance = _engine(self.function, pack(state), n_periods, native)
        columns = self.input_rows(plant, inputs, parts)
        rows = np.empty((n_periods, self.function.nnz_out(1)))
        stop = 0
        with monitor.progress:
            for start in range(0, n_periods, DIVERGENCE_CHECK_INTERVAL):
                stop = min(start + DIVERGENCE_CHECK_INTERVAL, n_periods)
                rows[start:stop] = advance(columns[start:stop])
                if not monitor.update(start, rows[start:stop, :n]):
                    break
        return Record.from_rows(self._example, rows[: monitor.valid_rows(stop)])

    def input_rows(
        self,
        plant: SymbolicPlant,
        inputs: SampledInputs,
        parts: tuple[DigitalController, Drive | None] | None = None,
    ) -> np.ndarray:
        """Return the inputs of each period as a row, in the order of `LoopInput`, and what varies of the parts."""
        n, n_periods, substeps = inputs.disturbance.shape
        disturbance = inputs.disturbance.transpose(2, 0, 1).reshape(n * substeps, n_periods)
        periods = [] if inputs.periods is None else [inputs.periods[None]]
        ages = [] if inputs.age is None else [inputs.age[None]]
        constant = {name: value for name, value in plant.parameters.items() if name in self._parameters}
        parameters = [
            inputs.schedules[name] if name in inputs.schedules else _over_time(constant[name], n_periods)
            for name in self._parameters
        ]
        own = [] if self._varying is None else [_over_time(self._varying.numbers(parts), n_periods)]
        return np.concatenate([*inputs.reference, inputs.noise, disturbance, *parameters, *periods, *ages, *own]).T


def _over_time(value: Array, n_periods: int) -> Array:
    """Return a constant parameter as a column per period, shape (size, periods)."""
    return np.broadcast_to(np.ravel(value, order="F")[:, None], (np.size(value), n_periods))


def run_casadi(
    loop: ClosedLoop,
    initial: InitialConditions,
    inputs: SampledInputs,
    monitor: DivergenceMonitor,
    native: bool | None = None,
) -> Record:
    """Trace the whole loop into one CasADi function; step it by CasADi's virtual machine, or in machine code."""
    return TracedLoop(loop, initial, inputs).run(loop.plant, initial, inputs, monitor, native)


def _engine(function: ca.Function, state: Array, n_periods: int, native: bool | None) -> Callable[[Array], Array]:
    """Return what steps the loop: machine code if ``native``, by default where that takes less time."""
    if native is None:
        if not _pays_off(function, n_periods):
            return interpreted(function, state)
        try:
            return _compiled(function, state)
        except (MissingTool, CompilationError):
            return interpreted(function, state)
    return _compiled(function, state) if native else interpreted(function, state)


def _pays_off(function: ca.Function, n_periods: int) -> bool:
    """Return whether this run, with those like it before, is long enough to be compiled.

    Loops that differ only in their parameters share their machine code, so that one compilation serves all of them.
    """
    work = n_instructions(function) * n_periods
    if work < SHORT_RUN:
        return False
    sizes = function.n_instructions(), function.nnz_in(0), function.nnz_in(1), function.nnz_out(1)
    _interpreted_work[sizes] += work
    return _interpreted_work[sizes] >= COMPILATION + COMPILATION_PER_INSTRUCTION * n_distinct_instructions(function)


def _compiled(function: ca.Function, state: Array) -> Callable[[Array], Array]:
    """Return what steps the loop in machine code, from rows of inputs (k, inputs) to rows of outputs (k, outputs)."""
    loop = CompiledLoop(function)
    return lambda inputs: loop.run(state, inputs)


def interpreted(function: ca.Function, state: Array) -> Callable[[Array], Array]:
    """Return what steps the loop in the virtual machine, from rows of inputs to rows of outputs."""
    buffer = PeriodBuffer(function, state, BUFFER_PERIODS)

    def advance(inputs: Array) -> Array:
        outputs = np.empty((len(inputs), function.nnz_out(1)))
        for start in range(0, len(inputs), BUFFER_PERIODS):
            count = min(BUFFER_PERIODS, len(inputs) - start)
            buffer.rows["u"][:count] = inputs[start : start + count]
            for call in buffer.calls[:count]:
                call()
            outputs[start : start + count] = buffer.rows["y"][:count]
        return outputs

    return advance
