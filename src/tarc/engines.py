"""The two engines of `simulate`: fused in CasADi for symbolic plants, stepping for MuJoCo."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import casadi as ca
import mujoco
import numpy as np

from tarc import check
from tarc.errors import DesignWarning, TarcError
from tarc.estimators.oracle import TrueDerivatives
from tarc.laws.base import Law
from tarc.native import compiled
from tarc.plants.base import Plant
from tarc.plants.euler_lagrange import EulerLagrange
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.robot_file import without_log_file
from tarc.progress import Progress
from tarc.signals.disturbances import Disturbance, Payload, Schedule
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder
from tarc.system import Ring, leaves, names, pack, trace

if TYPE_CHECKING:
    from tarc.loop import ClosedLoop, Drive

CHUNK = 500
"""Periods between two looks at whether the run has diverged."""

LONGEST = 10_000_000
"""Most periods of a run."""

RING = 32
"""Periods between two copies of what was recorded; few, so that all memory of a ring stays in the fast cache."""


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
        for label, leaf in zip(names(example), leaves(example), strict=True):
            name = label.split(".")[-1]
            if name in arrays:
                raise TarcError(f"signals: two are called {name!r}; a law's signals need names of their own")
            size = int(np.size(leaf))
            block = rows[:, start : start + size]
            arrays[name] = block.reshape(len(rows), *np.shape(leaf)[::-1])
            start += size
        return cls(arrays)


def fit(plant: Plant, law: Law, reference: Reference, sensor: Encoder) -> None:
    """Check that all parts have the same number of joints."""
    if not isinstance(plant, EulerLagrange | MujocoPlant):
        raise TarcError(f"plant: got {plant!r}; needs one of tarc.plants")
    if not isinstance(law, Law):
        raise TarcError(f"law: got {law!r}; needs one of tarc.laws, constructed, such as tarc.laws.TDC(inertia=…)")
    if not isinstance(reference, Reference):
        raise TarcError(f"reference: got {reference!r}; needs one of tarc.signals, such as tarc.signals.Sinusoid(…)")
    if not isinstance(sensor, Encoder):
        raise TarcError(f"sensor: got {sensor!r}; needs a tarc.signals.Encoder, constructed")
    if sensor.increment.size not in (1, plant.joints):
        raise TarcError(
            f"sensor: its resolution has {sensor.increment.size} numbers; the plant has {plant.joints} joints"
        )
    if not plant.joints == law.joints == reference.joints:
        raise TarcError(
            f"joints: the plant has {plant.joints}, the law {law.joints} (told by its inertia), the reference "
            f"{reference.joints}; they must be the same: give one number a joint ({', '.join(plant.joint_names)})"
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
    count = round(check.number("duration", duration, T, high=LONGEST * T) / T)
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
            _check_schedule(plant, event)
            if name in schedules:
                raise TarcError(f"disturbance: two schedules change {name!r}; put both into one Schedule")
            schedules[name] = event.sample(times, known[name])
        else:
            raise TarcError(f"disturbance: got {event!r}; needs a Disturbance, Payload or Schedule of tarc.signals")
    blocks = torque.reshape(n, count, substeps)
    return Plan(
        times, reference.sample(times), sensor.sample_noise(n, count, noise_rng), blocks, schedules, tuple(events)
    )


def variants(plant: Plant, events: Sequence[Any]) -> list[tuple[float, Plant]]:
    """The robot as it is from each instant [s] on, with what payloads and schedules have made of it by then."""
    schedules = [event.schedule if isinstance(event, Payload) else event for event in events]
    schedules = [event for event in schedules if isinstance(event, Schedule)]
    knots = sorted({0.0, *(float(max(time, 0.0)) for event in schedules for time in np.ravel(event.times))})
    known, result = plant.parameters, []
    for knot in knots:
        values = {}
        for event in schedules:
            value = event.sample(np.array([knot]), known[event.parameter])[:, 0]
            values[event.parameter] = np.reshape(value, np.shape(known[event.parameter]))
        result.append((knot, plant.with_parameters(values) if values else plant))
    return result


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
            fine = error.max() <= self.limit
        if not fine:
            self.diverged_at = begin + int(np.argmax(~np.all(error <= self.limit, axis=1)))
        return self.diverged_at is None

    def end(self, rows: int) -> int:
        """How many of the rows are worth keeping."""
        return rows if self.diverged_at is None else max(self.diverged_at, 1)


def run_fused(loop: "ClosedLoop", begin: Start, plan: Plan, watch: Watch, native: bool = False) -> Record:
    """The whole loop as one CasADi function, mapped over many periods a call."""
    from tarc.loop import LoopInput

    n = loop.plant.joints
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
    ring = Ring(function, pack(state), RING)
    rows, seen, end = np.empty((count, function.nnz_out(1))), 0, 0
    with watch.progress:
        for at in range(0, count, RING):
            end = min(at + RING, count)
            ring.rows["u"][: end - at] = outside[at:end]
            for call in ring.calls[: end - at]:
                call()
            rows[at:end] = ring.rows["y"][: end - at]
            if end - seen >= CHUNK or end == count:
                if not watch.look(seen, rows[seen:end, :n]):
                    break
                seen = end
    return Record.from_rows(example, rows[: watch.end(end)])


def run_stepping(plant: Plant, drive: "Drive", begin: Start, plan: Plan, watch: Watch, native: bool = False) -> Record:
    """MuJoCo steps the plant; the drive is called between steps over fixed memory."""
    from tarc.loop import DriveInput, LoopOutput

    def tell_and_drive(state: Any, value: tuple[Any, Any, DriveInput]) -> tuple[Any, Any]:
        velocity, acceleration, given = value
        return drive.step(drive.tell(state, velocity, acceleration), given)

    assert isinstance(plant, MujocoPlant)
    n, count, substeps = plant.joints, len(plan.times), plan.disturbance.shape[2]
    model = plant.copy_model()
    model.opt.timestep = drive.law.period / substeps
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = begin.position, begin.velocity
    state = drive.init(begin.position, begin.torque, plan.noise[:, 0])
    rest = np.zeros(n)
    value = rest, rest, DriveInput(rest, rest, rest, rest, rest)
    function, example = trace(tell_and_drive, state, value, name="drive")
    # Runge–Kutta leaves the acceleration of its last stage behind, so the one at the start is computed beforehand
    before = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    oracle = isinstance(drive.law.estimator, TrueDerivatives)
    plain = substeps == 1 and not before and not oracle
    acceleration, last = data.qacc if plain else np.zeros(n), np.zeros(n)
    plug = {"q": data.qpos, "v": data.qvel, "a": acceleration, "last": last, "torque": data.qfrc_applied}
    plugged = _plugged(function, n)
    ring = Ring(compiled(plugged) if native else plugged, pack(state), RING, plug)

    outside = np.concatenate([*plan.reference, plan.noise, plan.disturbance[:, :, 0]]).T
    later = np.diff(plan.disturbance, axis=2).transpose(1, 2, 0)
    changes = _changes(plan)
    rows = np.empty((count, ring.rows["row"].shape[1]))
    stops = sorted({*range(0, count, RING), *changes, count})
    advance, seen, end = mujoco.mj_step, 0, 0

    def look_back() -> None:
        """The acceleration that the oracle is told, of the torque that is about to change."""
        mujoco.mj_forward(model, data)
        last[:] = data.qacc

    with watch.progress, without_log_file():
        if oracle:
            data.qfrc_applied[:] = state.queue[:, -1]
            look_back()
        for at, end in pairwise(stops):
            if at in changes:
                plant.set_parameters(model, changes[at])
            here = slice(at % RING, at % RING + end - at)
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


def warn_if_unstable(plant: Plant, law: Law, plan: Plan, computation_delay: int, postures: int = 60) -> None:
    """Warn of a design whose loop, at rest in a posture of the reference, is unstable, with the remedy."""
    from tarc.certificates.robot import remedy, unstable_posture

    moments = np.unique(np.linspace(0, len(plan.times) - 1, postures).astype(int))
    robots = variants(plant, plan.events)
    found = None
    for (begin, robot), (end, _) in pairwise([*robots, (np.inf, plant)]):
        during = moments[(plan.times[moments] >= begin) & (plan.times[moments] < end)]
        if during.size:
            witness = unstable_posture(law, robot, plan.reference[0][:, during], computation_delay)
            if witness and (found is None or witness["growth rate [1/s]"] > found["growth rate [1/s]"]):
                found = witness
    if found:
        warnings.warn(remedy(law, found, computation_delay), DesignWarning, stacklevel=3)


def _check_schedule(plant: Plant, event: Schedule) -> None:
    """Refuse values that the plant itself would refuse."""
    shape = np.shape(plant.parameters[event.parameter])
    for value in event.values:
        value = np.reshape(value, shape) if np.size(value) == np.prod(shape) else value
        if isinstance(plant, EulerLagrange):
            replace(plant, **{event.parameter: value})
        elif np.any(check.array(f"schedule of {event.parameter!r}, values", value) < 0):
            raise TarcError(f"schedule of {event.parameter!r}: got {np.asarray(value).tolist()}; must be at least 0")


def _changes(plan: Plan) -> dict[int, dict[str, np.ndarray]]:
    """Scheduled parameters that change, by the period in which they do."""
    result: dict[int, dict[str, np.ndarray]] = {}
    for name, values in plan.schedules.items():
        steps = np.any(np.diff(values, axis=1) != 0, axis=0)
        for k in [0, *(1 + np.flatnonzero(steps))]:
            result.setdefault(int(k), {})[name] = values[:, k]
    return result
