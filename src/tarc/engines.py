"""The two engines of `simulate`: fused in CasADi for symbolic plants, stepping for MuJoCo."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import mujoco
import numpy as np

from tarc import check
from tarc.errors import TarcError
from tarc.laws.base import Law
from tarc.plants.base import Plant
from tarc.plants.euler_lagrange import EulerLagrange
from tarc.plants.mujoco import MujocoPlant
from tarc.progress import Progress
from tarc.signals.disturbances import Disturbance, Payload, Schedule
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder
from tarc.system import Buffered, leaves, names, pack, trace

if TYPE_CHECKING:
    from tarc.loop import ClosedLoop, Drive

CHUNK = 500
"""Periods between two looks at whether the run has diverged."""


@dataclass(frozen=True)
class Plan:
    """All that a run is given from outside, sampled beforehand: arrays with time last."""

    times: np.ndarray
    reference: tuple[np.ndarray, np.ndarray, np.ndarray]
    noise: np.ndarray
    disturbance: np.ndarray
    schedules: dict[str, np.ndarray]
    events: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Start:
    """Where the robot and the law begin, each of shape (n,)."""

    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True)
class Record:
    """Recorded outputs: dotted name to array with time first."""

    arrays: dict[str, np.ndarray]

    @classmethod
    def from_rows(cls, example: Any, rows: np.ndarray) -> "Record":
        """Split rows, one an instant, by an output of the same structure."""
        arrays, start = {}, 0
        for name, leaf in zip(names(example), leaves(example), strict=True):
            size = int(np.size(leaf))
            block = rows[:, start : start + size]
            arrays[name.split(".")[-1]] = block.reshape(len(rows), *np.shape(leaf)[::-1])
            start += size
        return cls(arrays)


def fit(plant: Plant, law: Law, reference: Reference) -> None:
    """Check that all parts have the same number of joints."""
    if not isinstance(plant, EulerLagrange | MujocoPlant):
        raise TarcError(f"plant: got {plant!r}; needs one of tarc.plants")
    if not isinstance(law, Law):
        raise TarcError(f"law: got {law!r}; needs one of tarc.laws, constructed, such as tarc.laws.TDC(inertia=…)")
    if not isinstance(reference, Reference):
        raise TarcError(f"reference: got {reference!r}; needs one of tarc.signals, such as tarc.signals.Sinusoid(…)")
    if not plant.joints == law.joints == reference.joints:
        raise TarcError(
            f"joints: the plant has {plant.joints}, the law {law.joints} (told by its inertia), the reference "
            f"{reference.joints}; they must be the same"
        )


def plan(
    plant: Plant,
    law: Law,
    reference: Reference,
    duration: float,
    sensor: Encoder,
    events: Sequence[Any],
    substeps: int,
    seed: int,
) -> Plan:
    """Sample reference, noise, disturbances and schedules over the run."""
    n, T = plant.joints, law.period
    count = round(check.number("duration", duration, T) / T)
    times = np.arange(count) * T
    noise_rng, *rngs = np.random.default_rng(seed).spawn(1 + len(events))
    torque, schedules = np.zeros((n, count * substeps)), {}
    for event, rng in zip(events, rngs, strict=True):
        if isinstance(event, Payload):
            event = event.schedule
        if isinstance(event, Disturbance):
            torque += event.sample(np.arange(count * substeps) * (T / substeps), n, rng)
        elif isinstance(event, Schedule):
            known = plant.parameters
            name = check.one_of("schedule parameter", event.parameter, known)
            if name in schedules:
                raise TarcError(f"disturbance: two schedules change {name!r}; put both into one Schedule")
            schedules[name] = event.sample(times, known[name])
        else:
            raise TarcError(f"disturbance: got {event!r}; needs a Disturbance, Payload or Schedule of tarc.signals")
    blocks = torque.reshape(n, count, substeps)
    return Plan(
        times, reference.sample(times), sensor.sample_noise(n, count, noise_rng), blocks, schedules, tuple(events)
    )


def start(plant: Plant, plan: Plan, position: Any, velocity: Any, torque: Any) -> Start:
    """Initial position, velocity and torque from what the user gave."""
    n = plant.joints
    q = plan.reference[0][:, 0] if position is None else check.vector("position", position, n)
    if isinstance(torque, str):
        check.one_of("torque", torque, ["rest"])
        torque = plant.gravity_torque(q)
    return Start(q.copy(), check.vector("velocity", velocity, n), check.vector("torque", torque, n))


class Watch:
    """Looks at a run as it goes: shows progress, tells when it has diverged."""

    def __init__(self, plan: Plan, divergence: float, show: bool | None):
        self.limit = check.number("divergence", divergence, 0, strict=True)
        self.reference = plan.reference[0].T
        self.count = len(plan.times)
        self.progress = Progress("simulating", self.count, show)
        self.diverged_at: int | None = None

    def look(self, begin: int, positions: np.ndarray) -> bool:
        """Whether to go on after the instants from ``begin`` with these positions (k, n)."""
        self.progress.advance(len(positions))
        with np.errstate(invalid="ignore", over="ignore"):
            error = np.abs(positions - self.reference[begin : begin + len(positions)])
            wrong = ~np.all(error <= self.limit, axis=1)
        if wrong.any():
            self.diverged_at = begin + int(np.argmax(wrong))
        return self.diverged_at is None

    def end(self, rows: int) -> int:
        """How many of the rows are worth keeping."""
        return rows if self.diverged_at is None else max(self.diverged_at, 1)


def run_fused(loop: "ClosedLoop", begin: Start, plan: Plan, watch: Watch) -> Record:
    """The whole loop as one CasADi function, mapped over many periods a call."""
    from tarc.loop import LoopInput

    n = loop.plant.joints
    state = loop.init(begin.position, begin.velocity, begin.torque, plan.noise[:, 0])
    shapes = {name: np.array(loop.plant.parameters[name]) for name in plan.schedules}
    rest = np.zeros(n)
    value = LoopInput(rest, rest, rest, rest, np.zeros((n, loop.substeps)), shapes)
    function, example = trace(loop.step, state, value, symbol=ca.SX, name="period")

    count = len(plan.times)
    outside = np.concatenate(
        [
            *plan.reference,
            plan.noise,
            plan.disturbance.transpose(2, 0, 1).reshape(n * loop.substeps, count),
            *plan.schedules.values(),
        ]
    )
    chunk = min(CHUNK, count)
    many = function.mapaccum("run", chunk)
    x, rows, done = pack(state), [], 0
    with watch.progress:
        while done < count:
            piece = outside[:, done : done + chunk]
            size = piece.shape[1]
            if size < chunk:
                piece = np.concatenate([piece, np.repeat(piece[:, -1:], chunk - size, axis=1)], axis=1)
            states, outputs = many(x, piece)
            rows.append(np.array(outputs)[:, :size].T)
            x = np.array(states[:, -1]).ravel()
            if not watch.look(done, rows[-1][:, :n]):
                break
            done += size
    record = np.concatenate(rows)
    return Record.from_rows(example, record[: watch.end(len(record))])


def run_stepping(plant: Plant, drive: "Drive", begin: Start, plan: Plan, watch: Watch) -> Record:
    """MuJoCo steps the plant; the drive is called between steps over fixed memory."""
    from tarc.loop import DriveInput, LoopOutput

    assert isinstance(plant, MujocoPlant)
    n, count, substeps = plant.joints, len(plan.times), plan.disturbance.shape[2]
    model = plant.copy_model()
    model.opt.timestep = drive.law.period / substeps
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = begin.position, begin.velocity
    state = drive.init(begin.position, begin.torque, plan.noise[:, 0])
    rest = np.zeros(n)
    function, example = trace(drive.step, state, DriveInput(rest, rest, rest, rest, rest))
    controller = Buffered(function)
    controller.reset(pack(state))

    outside = np.ascontiguousarray(np.concatenate([*plan.reference, plan.noise]).T)
    push = plan.disturbance.transpose(1, 2, 0) if np.any(plan.disturbance) else None
    changes = _changes(plan)
    rows = np.empty((count, 3 * n + len(controller.output)))
    position_in, outside_in = controller.value[:n], controller.value[n:]
    torque_out, applied = controller.output[n : 2 * n], data.qfrc_applied
    qpos, qvel, qacc, output = data.qpos, data.qvel, data.qacc, controller.output
    log_q, log_v, log_a, log_y = rows[:, :n], rows[:, n : 2 * n], rows[:, 2 * n : 3 * n], rows[:, 3 * n :]
    advance, step = controller.step, mujoco.mj_step
    # Runge–Kutta leaves the acceleration of its last stage behind, so the one at the start is computed beforehand
    before = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    end_at = 0
    with watch.progress, _without_log_file():
        for begin_at in range(0, count, CHUNK):
            end_at = min(begin_at + CHUNK, count)
            for k in range(begin_at, end_at):
                if k in changes:
                    plant.set_parameters(model, changes[k])
                position_in[:] = log_q[k] = qpos
                outside_in[:] = outside[k]
                log_v[k] = qvel
                advance()
                log_y[k] = output
                applied[:] = torque_out
                if push is not None:
                    applied += push[k, 0]
                if before:
                    mujoco.mj_forward(model, data)
                    log_a[k] = qacc
                step(model, data)
                if not before:
                    log_a[k] = qacc
                for i in range(1, substeps):
                    if push is not None:
                        applied[:] = torque_out + push[k, i]
                    step(model, data)
            if not watch.look(begin_at, log_q[begin_at:end_at]):
                break
    blank = LoopOutput(rest, rest, rest, example)
    return Record.from_rows(blank, rows[: watch.end(end_at)])


@contextmanager
def _without_log_file() -> Iterator[None]:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT into the user's folder; the run's own status tells of divergence."""
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


def _changes(plan: Plan) -> dict[int, dict[str, np.ndarray]]:
    """Scheduled parameters that change, by the period in which they do."""
    result: dict[int, dict[str, np.ndarray]] = {}
    for name, values in plan.schedules.items():
        steps = np.any(np.diff(values, axis=1) != 0, axis=0)
        for k in [0, *(1 + np.flatnonzero(steps))]:
            result.setdefault(int(k), {})[name] = values[:, k]
    return result
