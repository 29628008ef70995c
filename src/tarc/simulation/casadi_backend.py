"""The closed loop as one CasADi function, for plants in symbols."""

import numpy as np

from tarc.core.codegen import compiled
from tarc.core.tracing import BUFFER_PERIODS, PeriodBuffer, trace
from tarc.core.trees import pack
from tarc.simulation.closed_loop import ClosedLoop, LoopInput
from tarc.simulation.monitor import DIVERGENCE_CHECK_INTERVAL, DivergenceMonitor
from tarc.simulation.record import Record
from tarc.simulation.sampled_inputs import InitialConditions, SampledInputs


def run_casadi(
    loop: ClosedLoop,
    initial: InitialConditions,
    inputs: SampledInputs,
    monitor: DivergenceMonitor,
    native: bool = False,
) -> Record:
    """Trace the whole loop into one CasADi function and call it once per period over fixed memory."""
    n = loop.plant.n_joints
    state = loop.init(initial.position, initial.velocity, initial.torque, inputs.noise[:, 0])
    parameters = {name: np.array(loop.plant.parameters[name]) for name in inputs.schedules}
    zero = np.zeros(n)
    value = LoopInput(zero, zero, zero, zero, np.zeros((n, loop.substeps)), parameters)
    function, example = trace(loop.step, state, value, name="period")
    buffer = PeriodBuffer(compiled(function) if native else function, pack(state), BUFFER_PERIODS)

    n_periods = len(inputs.times)
    columns = _input_rows(inputs)
    rows = np.empty((n_periods, function.nnz_out(1)))
    n_checked = 0
    stop = 0
    with monitor.progress:
        for start in range(0, n_periods, BUFFER_PERIODS):
            stop = min(start + BUFFER_PERIODS, n_periods)
            buffer.rows["u"][: stop - start] = columns[start:stop]
            for call in buffer.calls[: stop - start]:
                call()
            rows[start:stop] = buffer.rows["y"][: stop - start]
            if stop - n_checked >= DIVERGENCE_CHECK_INTERVAL or stop == n_periods:
                if not monitor.update(n_checked, rows[n_checked:stop, :n]):
                    break
                n_checked = stop
    return Record.from_rows(example, rows[: monitor.valid_rows(stop)])


def _input_rows(inputs: SampledInputs) -> np.ndarray:
    """Return the inputs of each period as a row, in the order of `LoopInput`."""
    n, n_periods, substeps = inputs.disturbance.shape
    disturbance = inputs.disturbance.transpose(2, 0, 1).reshape(n * substeps, n_periods)
    return np.concatenate([*inputs.reference, inputs.noise, disturbance, *inputs.schedules.values()]).T
