"""The law in CasADi and the robot in MuJoCo, step by step."""

from itertools import pairwise
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from tarc.control.digital_controller import ControllerInput, DigitalController
from tarc.core.codegen import compiled
from tarc.core.tracing import BUFFER_PERIODS, PeriodBuffer, trace
from tarc.core.trees import pack
from tarc.estimators.oracle import TrueDerivatives
from tarc.plants.base import Plant
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.robot_file import without_log_file
from tarc.simulation.closed_loop import LoopOutput
from tarc.simulation.monitor import CHUNK, Watch
from tarc.simulation.record import Record
from tarc.simulation.sampled_inputs import Plan, Start


def run_stepping(
    plant: Plant, drive: "DigitalController", begin: Start, plan: Plan, watch: Watch, native: bool = False
) -> Record:
    """MuJoCo steps the plant; the drive is called between steps over fixed memory."""

    def tell_and_drive(state: Any, value: tuple[Any, Any, ControllerInput]) -> tuple[Any, Any]:
        velocity, acceleration, given = value
        return drive.step(drive.with_true_derivatives(state, velocity, acceleration), given)

    assert isinstance(plant, MujocoPlant)
    n, count, substeps = plant.n_joints, len(plan.times), plan.disturbance.shape[2]
    model = plant.copy_model()
    model.opt.timestep = drive.law.period / substeps
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = begin.position, begin.velocity
    state = drive.init(begin.position, begin.torque, plan.noise[:, 0])
    rest = np.zeros(n)
    value = rest, rest, ControllerInput(rest, rest, rest, rest, rest)
    function, example = trace(tell_and_drive, state, value, name="drive")
    # Runge–Kutta leaves the acceleration of its last stage behind, so the one at the start is computed beforehand
    before = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    oracle = isinstance(drive.law.estimator, TrueDerivatives)
    plain = substeps == 1 and not before and not oracle
    acceleration, last = data.qacc if plain else np.zeros(n), np.zeros(n)
    plug = {"q": data.qpos, "v": data.qvel, "a": acceleration, "last": last, "torque": data.qfrc_applied}
    plugged = _plugged(function, n)
    ring = PeriodBuffer(compiled(plugged) if native else plugged, pack(state), BUFFER_PERIODS, plug)

    outside = np.concatenate([*plan.reference, plan.noise, plan.disturbance[:, :, 0]]).T
    later = np.diff(plan.disturbance, axis=2).transpose(1, 2, 0)
    changes = _changes(plan)
    rows = np.empty((count, ring.rows["row"].shape[1]))
    stops = sorted({*range(0, count, BUFFER_PERIODS), *changes, count})
    advance, seen, end = mujoco.mj_step, 0, 0

    def look_back() -> None:
        """The acceleration that the oracle is told, of the torque that is about to change."""
        mujoco.mj_forward(model, data)
        last[:] = data.qacc

    with watch.progress, without_log_file():
        if oracle:
            data.qfrc_applied[:] = state.torque_delay_line[:, -1]
            look_back()
        for at, end in pairwise(stops):
            if at in changes:
                plant.set_parameters(model, changes[at])
            here = slice(at % BUFFER_PERIODS, at % BUFFER_PERIODS + end - at)
            ring.rows["outside"][here] = outside[at:end]
            if plain:
                for call in ring.calls[here]:
                    call()
                    advance(model, data)
            else:
                for call, steps in zip(ring.calls[here], later[at:end], strict=True):
                    call()
                    if before:
                        mujoco.mj_forward(model, data)
                        acceleration[:] = data.qacc
                    advance(model, data)
                    if not before:
                        acceleration[:] = data.qacc
                    for change in steps:
                        data.qfrc_applied += change
                        advance(model, data)
                    if oracle:
                        look_back()
            rows[at:end] = ring.rows["row"][here]
            if end - seen >= CHUNK or end == count:
                if not watch.look(seen, rows[seen:end, :n]):
                    break
                seen = end
    log = rows[:end, 2 * n : 3 * n]  # each row has the acceleration of the step before
    log[:-1], log[-1] = log[1:].copy(), acceleration
    blank = LoopOutput(rest, rest, rest, example)
    return Record.from_rows(blank, rows[: watch.end(end)])


def _plugged(drive: ca.Function, n: int) -> ca.Function:
    """The drive as it is plugged into a simulator, which it hands the torque; a row is all there is to record."""
    x, outside = ca.SX.sym("x", drive.nnz_in(0)), ca.SX.sym("outside", 5 * n)
    q, v, a, last = (ca.SX.sym(name, n) for name in ("q", "v", "a", "last"))
    x_next, y = drive(x, ca.vertcat(v, last, q, outside[:-n]))
    torque = y[n : 2 * n] + outside[-n:]
    names = ["x", "q", "v", "a", "last", "outside"], ["x_next", "torque", "row"]
    return ca.Function("plugged", [x, q, v, a, last, outside], [x_next, torque, ca.vertcat(q, v, a, y)], *names)


def _changes(plan: Plan) -> dict[int, dict[str, np.ndarray]]:
    """Scheduled parameters that change, by the period in which they do."""
    result: dict[int, dict[str, np.ndarray]] = {}
    for name, values in plan.schedules.items():
        steps = np.any(np.diff(values, axis=1) != 0, axis=0)
        for k in [0, *(1 + np.flatnonzero(steps))]:
            result.setdefault(int(k), {})[name] = values[:, k]
    return result
