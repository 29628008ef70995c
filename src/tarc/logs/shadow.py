"""A law in shadow mode: what it would have commanded along a record."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tarc.control.controller import Controller
from tarc.core.errors import InvalidParameter, NotLinearisable, UnsupportedLaw
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.design.noise import measurement_deviation
from tarc.design.prediction import predict_error
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.logs.even_record import EvenRecord
from tarc.logs.model_check import POSTURES_OF_MEAN
from tarc.logs.time_repair import LogTiming
from tarc.plants.base import Plant
from tarc.signals.references import Reference
from tarc.signals.robot_log import RobotLog
from tarc.signals.sensors import Encoder
from tarc.simulation.dataset import describe, to_json

SEED = 0
"""Of the noise that is added to predict that of the torque."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ShadowCheck:
    """A law beside the robot: it is handed the record, and its torque is not applied.

    Attributes
    ----------
    torque
        Command of each period [N m or N], shape (k, n).
    difference
        RMS of command − recorded torque over the standard deviation of the recorded torque, shape (n,).
    faults
        Number of periods in which the law had given up, after too many missing samples.
    position_noise
        Standard deviation of the noise of the recorded positions [rad or m], shape (n,).
    assumed_noise
        The same of the design's encoder, shape (n,).
    torque_noise
        RMS of the command's own noise that the recorded positions cause [N m or N], shape (n,).
    predicted_torque_noise
        The same for the design's encoder, shape (n,).
    error
        RMS tracking error of the record [rad or m], shape (n,); None without a recorded reference.
    predicted_error
        RMS error that the linear loop of the law predicts for this motion [rad or m], shape (n,); infinite where it is
        unstable. None without a robot, and for a law that has no linear loop.
    """

    torque: Array
    difference: Array
    faults: int
    position_noise: Array
    assumed_noise: Array
    torque_noise: Array
    predicted_torque_noise: Array
    error: Array | None
    predicted_error: Array | None


def check_shadow(
    record: EvenRecord,
    law: Law,
    sensor: Encoder,
    plant: Plant | None,
    cutoff: float,
    changes: Sequence[tuple[float, Law]] = (),
) -> ShadowCheck | None:
    """Run a law along a record; None without recorded torque.

    ``changes`` are laws that take over at their times [s].

    The law gets each measured position, NaN for a missing one, and the torque that was applied. Its reference is the
    recorded one, smoothed, or the smooth motion itself. The torque's noise is that of the change by added noise.

    Raises
    ------
    InvalidParameter
        For a law with another number of joints or another period than the record.
    """
    if record.torque is None:
        return None
    n = record.position.shape[1]
    if law.n_joints != n or abs(law.period - record.period) > 1e-6 * record.period:
        raise InvalidParameter(
            f"law: it has {law.n_joints} joints and a period of {law.period:g} s; the log has {n} joints and "
            f"{record.period:g} s. Design it for these, with tarc design --control-rate {1 / record.period:.6g}",
            "law",
        )
    motion = record.motion if record.reference is None else record.smooth(record.reference, cutoff)
    desired = [motion(record.times, order) for order in range(3)]
    position = np.where(record.is_measured[:, None], record.position, np.nan)
    applied = record.torque
    rows = {int(np.searchsorted(record.times, time - record.period / 2)): changed for time, changed in changes}
    command, faults = _commands(law, position, desired, applied, rows)
    sigma = record.position_noise()
    assumed = measurement_deviation(sensor, n)
    noise = np.random.default_rng(SEED).standard_normal(position.shape)
    inner = record.inner(10 / cutoff)

    def torque_noise(deviation: Array) -> Array:
        noisy, _ = _commands(law, position + noise * deviation, desired, applied, rows)
        return np.sqrt(np.mean((noisy - command)[inner] ** 2, axis=0))

    difference = np.sqrt(np.mean((command - record.torque)[inner] ** 2, axis=0))
    error = None if record.reference is None else record.position - record.reference
    return ShadowCheck(
        torque=command,
        difference=difference / np.maximum(np.std(record.torque[inner], axis=0), 1e-300),
        faults=faults,
        position_noise=sigma,
        assumed_noise=assumed,
        torque_noise=torque_noise(sigma),
        predicted_torque_noise=torque_noise(assumed),
        error=None if error is None else np.sqrt(np.mean(error[inner] ** 2, axis=0)),
        predicted_error=_predicted(law, plant, motion, record, sensor, inner),
    )


def laws_over_time(log: RobotLog, timing: LogTiming, law: Law) -> list[tuple[float, Law]]:
    """Return the laws that took over in a log, with their repaired times [s].

    None for another law than the one that ran.
    """
    if not log.gain_changes or _description(to_json(describe(law))) != _description(log.law):
        return []
    laws: list[tuple[float, Law]] = []
    for time, gains in log.gain_changes:
        law = replace(law, **gains)
        row = int(np.searchsorted(log.times, time))
        if row < len(log.times):
            laws.append((float(timing.times[row]), law))
    return laws


def _description(text: str) -> dict[str, object]:
    """Return kind and parameters of a law but its torque limit, which a robot may have given it."""
    return {name: value for name, value in json.loads(text or "{}").items() if name != "torque_limit"}


def _commands(
    law: Law, position: Array, desired: list[Array], torque: Array, changes: Mapping[int, Law]
) -> tuple[Array, int]:
    """Return the commands of a law, shape (k, n), and the number of periods with a fault.

    ``changes`` are laws by the row from which they run.
    """
    controller = Controller(law)
    first = int(np.argmax(np.isfinite(position).all(axis=1)))
    controller.reset(position[first], torque[first])
    commands = np.empty_like(position)
    faults = 0
    for k in range(len(position)):
        applied = None if k == 0 else torque[k - 1]
        if k in changes:
            controller.change_law(controller.prepare(changes[k]))
        commands[k] = controller.step(position[k], desired[0][k], desired[1][k], desired[2][k], applied_torque=applied)
        faults += controller.fault
    return commands, faults


@dataclass(frozen=True, kw_only=True, eq=False)
class _Motion(Reference):
    """A smooth motion as a reference."""

    curve: Callable[..., Array]
    count: int

    @property
    def n_joints(self) -> int:
        """Return the number of joints."""
        return self.count

    def sample(self, times: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration at the times."""
        at = np.asarray(times, dtype=float)
        return self.curve(at).T, self.curve(at, 1).T, self.curve(at, 2).T


def _predicted(
    law: Law,
    plant: Plant | None,
    motion: Callable[..., Array],
    record: EvenRecord,
    sensor: Encoder,
    inner: slice,
) -> Array | None:
    """Return the RMS error that the law's linear loop predicts along a motion, or None."""
    if plant is None or not isinstance(law, PolePlacement):
        return None
    mean = plant.mean_inertia(record.position[inner][:: max(len(record.times) // POSTURES_OF_MEAN, 1)].T)
    ratio = float(np.mean(np.linalg.eigvals(np.linalg.solve(mean, law.M)).real))
    reference = _Motion(curve=motion, count=law.n_joints)
    duration = float(record.times[-1])
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop
            predicted = predict_error(law, [plant], reference, duration, sensor=sensor, mean_ratio=ratio)
    except (NotLinearisable, UnsupportedLaw):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        rms = predicted.rms(float(record.times[inner.start]))
    return np.where(np.isfinite(rms), rms, np.inf)
