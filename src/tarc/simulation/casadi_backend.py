"""The closed loop as one CasADi function, for plants in symbols."""

import numpy as np

from tarc.core.codegen import compiled
from tarc.core.tracing import BUFFER_PERIODS, PeriodBuffer, trace
from tarc.core.trees import pack
from tarc.simulation.closed_loop import ClosedLoop, LoopInput
from tarc.simulation.monitor import CHUNK, Watch
from tarc.simulation.record import Record
from tarc.simulation.sampled_inputs import Plan, Start


def run_fused(loop: "ClosedLoop", begin: Start, plan: Plan, watch: Watch, native: bool = False) -> Record:
    """The whole loop as one CasADi function, mapped over many periods a call."""
    n = loop.plant.n_joints
    state = loop.init(begin.position, begin.velocity, begin.torque, plan.noise[:, 0])
    shapes = {name: np.array(loop.plant.parameters[name]) for name in plan.schedules}
    rest = np.zeros(n)
    value = LoopInput(rest, rest, rest, rest, np.zeros((n, loop.substeps)), shapes)
    function, example = trace(loop.step, state, value, name="period")
    function = compiled(function) if native else function

    count = len(plan.times)
    outside = np.concatenate(
        [
            *plan.reference,
            plan.noise,
            plan.disturbance.transpose(2, 0, 1).reshape(n * loop.substeps, count),
            *plan.schedules.values(),
        ]
    ).T
    ring = PeriodBuffer(function, pack(state), BUFFER_PERIODS)
    rows, seen, end = np.empty((count, function.nnz_out(1))), 0, 0
    with watch.progress:
        for at in range(0, count, BUFFER_PERIODS):
            end = min(at + BUFFER_PERIODS, count)
            ring.rows["u"][: end - at] = outside[at:end]
            for call in ring.calls[: end - at]:
                call()
            rows[at:end] = ring.rows["y"][: end - at]
            if end - seen >= CHUNK or end == count:
                if not watch.look(seen, rows[seen:end, :n]):
                    break
                seen = end
    return Record.from_rows(example, rows[: watch.end(end)])
