"""Rotor inertia, friction, payload, delay and encoder noise of a real robot, from its log and its file."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tarc.core.errors import InvalidParameter, NotIdentifiable
from tarc.core.progress import Progress
from tarc.core.types import Array
from tarc.design.identification import IdentifiedInertia, inertia_from_data
from tarc.logs.even_record import EvenRecord
from tarc.logs.least_squares import N_BLOCKS, Fit, Interval, fit
from tarc.logs.model_check import model_torque
from tarc.logs.time_repair import repair_time
from tarc.plants.base import Plant
from tarc.plants.load import load_robot
from tarc.plants.rigid_body import RigidBody
from tarc.signals.log_columns import LogColumns
from tarc.signals.log_file import read_log
from tarc.signals.robot_log import RobotLog

MAX_INSTANTS = 2000
"""Instants of a record that are used."""
MIN_INSTANTS = 400
"""Fewest instants."""
HELD_OUT = 0.4
"""Share at the end of the record on which a fit to its beginning is tried."""
WIDTHS = (0.003, 0.01, 0.03, 0.1)
"""Widths of the smooth sign of dry friction that are tried [rad/s or m/s]."""
LINK_PRIOR = 300.0
"""Deviation of a link's parameters from the file over their own size, per instant."""
SMALL = 0.01
"""Least size of a link's parameter [kg, kg m, kg m²]."""
PER_JOINT = ("armature", "viscous", "coulomb", "offset")
"""What is identified at each joint, in the order of the columns."""
MIN_GAIN = 0.01
"""Share of the torque that links of their own must explain beyond the file's, at some joint."""
N_POSTURES = 100
"""Postures along a record at which inertias are compared."""
N_DELAYS = 3
"""Rounds in which the delay is corrected."""


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentifiedModel:
    """What a log shows of a robot whose file is known; each with its 95 % interval.

    Attributes
    ----------
    joint_names
        Name of each joint.
    armature
        Rotor inertia at the joint [kg m² or kg], shape (n,).
    viscous, coulomb
        Friction [N m s/rad or N s/m, N m or N], shape (n,).
    coulomb_width
        Width of the smooth sign of dry friction [rad/s or m/s].
    offset
        Torque that the sensor shows beside that of the model [N m or N], shape (n,).
    payload
        Load [kg] at the tool, shape (); None where the links are identified, the last of which contains it.
    actuation_delay
        Time by which the recorded torque is ahead of the motion [s], shape ().
    encoder_noise
        Standard deviation of the positions [rad or m], shape (n,).
    explained_by_file
        Share of the torque's variance that the file explains on the end of the record, shape (n,).
    explained
        Share that the model identified on the beginning explains on the end, shape (n,).
    inertia_ratio
        Least and greatest eigenvalue of M_file(q)⁻¹ M(q) along the record, with the identified M and a rotor inertia of
        at least zero. It is not the file's robot where these are far from 1.
    has_links
        Whether the mass, centre and inertia of each link were identified too.
    """

    joint_names: tuple[str, ...]
    armature: Interval
    viscous: Interval
    coulomb: Interval
    coulomb_width: float
    offset: Interval
    payload: Interval | None
    actuation_delay: Interval
    encoder_noise: Interval
    explained_by_file: Array
    explained: Array
    inertia_ratio: tuple[float, float]
    has_links: bool

    def design_options(self) -> list[str]:
        """Return the options of `tarc design` for this robot.

        They have the low end of the rotor inertia, with which the eigenvalues of M(q)⁻¹M̂ spread most, and both ends of
        the load. What is below zero becomes zero.
        """

        def numbers(values: Array) -> str:
            return ",".join(f"{value:.3g}" for value in np.maximum(values, 0.0))

        options = [
            f"--armature {numbers(self.armature.low)}",
            f"--viscous {numbers(self.viscous.value)}",
            f"--coulomb {numbers(self.coulomb.value)}",
        ]
        if self.payload is not None and self.payload.high > 0:
            options.append(f"--payload {max(float(self.payload.low), 0.0):.3g} {float(self.payload.high):.3g}")
        return options

    def remarks(self) -> list[str]:
        """Return what the numbers say about the record or the file, beyond themselves."""
        remarks = []
        negative = [name for name, high in zip(self.joint_names, self.armature.high, strict=True) if high < 0]
        if negative:
            remarks.append(
                f"rotor inertia below zero at {', '.join(negative)}: the torque is measured behind the rotor, or the "
                "links of the file are too heavy. It counts as zero"
            )
        if self.payload is not None and self.payload.high < 0:
            remarks.append(
                f"the tool of the file is {-float(self.payload.value):.2g} kg heavier than that of the robot"
            )
        wide = np.flatnonzero(self.armature.high - self.armature.low > np.maximum(np.abs(self.armature.value), 1e-3))
        if wide.size:
            remarks.append(
                f"rotor inertia is uncertain at {', '.join(self.joint_names[i] for i in wide)}: accelerate these "
                "joints more, such as by tarc.design.excitation_reference"
            )
        if self.actuation_delay.low > 0:
            remarks.append(f"torque acts {1e3 * float(self.actuation_delay.value):.1f} ms after it is recorded")
        if self.actuation_delay.high < 0:
            remarks.append(f"torque is recorded {-1e3 * float(self.actuation_delay.value):.1f} ms after it acts")
        return remarks

    def summary(self) -> dict[str, Any]:
        """Return all numbers as lists, intervals with value, low and high."""
        result: dict[str, Any] = {}
        for name, part in vars(self).items():
            if isinstance(part, Interval):
                result[name] = {key: np.asarray(value).tolist() for key, value in vars(part).items()}
            else:
                result[name] = part.tolist() if isinstance(part, np.ndarray) else part
        return result


class _Regression:
    """Torque of a robot along a record, linear in what is identified."""

    def __init__(self, record: EvenRecord, plant: RigidBody, cutoff: float, with_links: bool):
        torque = _torque(record)
        inner = record.inner(1 / cutoff)
        count = len(record.times[inner])
        step = max(1, count // MAX_INSTANTS)
        self.times = record.times[inner][::step]
        self.torque = torque[inner][::step]
        if len(self.times) < MIN_INSTANTS:
            raise NotIdentifiable(
                f"log: it has {len(self.times)} instants between its ends; needs {MIN_INSTANTS}: record for longer"
            )
        self.motion = record.motion
        n = plant.n_joints
        bare = dict.fromkeys(("armature", "viscous", "coulomb"), np.zeros(n)) | {"payload": 0.0}
        self.bare = plant.with_parameters(bare)
        self.loaded = plant.with_parameters({**bare, "payload": 1.0})
        self.with_links = with_links
        self.links, self.link_parameters = plant.link_regressor() if with_links else (None, np.zeros(0))
        used = [np.full(len(PER_JOINT) * n, np.inf)]
        used.append(LINK_PRIOR * np.maximum(np.abs(self.link_parameters), SMALL) if with_links else np.array([np.inf]))
        self.prior = np.concatenate([*used, [np.inf]])

    def at(self, delay: float, width: float) -> tuple[Array, Array]:
        """Return the torque of the file (k, n), and the columns of what is identified (k, n, m), a time later."""
        q, v, a = (self.motion(self.times + delay, order) for order in range(3))
        base = model_torque(self.bare, q, v, a)
        k, n = q.shape
        per_joint = np.zeros((k, n, len(PER_JOINT), n))
        for i in range(n):
            per_joint[:, i, :, i] = np.column_stack([a[:, i], v[:, i], np.tanh(v[:, i] / width), np.ones(k)])
        parts = [per_joint.reshape(k, n, -1)]
        if self.links is None:
            parts.append((model_torque(self.loaded, q, v, a) - base)[:, :, None])
        else:
            parts.append(np.array(self.links(q.T, v.T, a.T)).reshape(n, k, -1).transpose(1, 0, 2))
        return base, np.concatenate(parts, axis=2)

    def rate(self, delay: float, width: float, parameters: Array) -> Array:
        """Return the time derivative of the torque of some parameters [N m/s or N/s], shape (k, n)."""
        step = self.times[1] - self.times[0]
        ends = [base + X @ parameters for base, X in (self.at(delay + side * step, width) for side in (0.5, -0.5))]
        return (ends[0] - ends[1]) / step

    @property
    def fitted_part(self) -> Array:
        """Return the mask of the beginning of the record, to which a fit is made before it is tried on the end."""
        return np.arange(len(self.times)) < (1 - HELD_OUT) * len(self.times)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Solution:
    """A fit with the delay as its last parameter, and the share of the torque explained on the end of the record."""

    fit: Fit
    delay: float
    explained: Array


def identify_model(
    log: RobotLog | str | Path,
    robot: Plant | str | Path,
    *,
    columns: LogColumns | Mapping[str, Any] | str | Path | None = None,
    links: bool | None = None,
    period: float | None = None,
    start_time: float | None = None,
    stop_time: float | None = None,
    cutoff: float = 25.0,
    progress: bool | None = None,
) -> IdentifiedModel:
    """Identify what the file of a robot does not know, from a log of the real one.

        τ(t) = M(q) q̈ + c(q, q̇) + g(q) + J q̈ + F_v q̇ + F_C tanh(q̇/w) + τ_0 at t + d

    The torque is linear in rotor inertia J, friction F_v and F_C, offset τ_0, the load, and the ten parameters of each
    link. The delay d enters by the time derivative of the torque. All are found by least squares on the smooth motion,
    the joints weighted by what is left of their torque. The intervals come from the scatter between twenty parts of the
    record, so that slow errors of the model widen them.

    Parameters
    ----------
    log
        The log with torques, or its file as `tarc.signals.read_log` takes it.
    robot
        A `RigidBody`, or a robot file or shipped name.
    columns
        Names of the log's columns, where they are not known.
    links
        Identify mass, centre and inertia of each link too, held weakly at the file. None for where that explains at
        least 1 % more of a joint's torque on the end of the record.
    period
        T of the robot's clock [s]; None for the one that stamps and motion agree on.
    start_time, stop_time
        Part of the log to use, counted from its first stamp [s].
    cutoff
        Frequency up to which motion is taken as true [Hz].
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Raises
    ------
    InvalidParameter
        For a log that does not read, and a robot that is not in symbols or has another number of joints.
    NotIdentifiable
        For a log without torques, or one that is too short.
    RobotFileError
        For a robot that does not read.

    References
    ----------
    W. Khalil and E. Dombre, Modeling, Identification and Control of Robots, 2002, chapter 12.
    """
    rows = log if isinstance(log, RobotLog) else read_log(log, columns)
    rows = rows.between(start_time, stop_time)
    plant = load_robot(robot) if isinstance(robot, str | Path) else robot
    if not isinstance(plant, RigidBody) or plant.n_joints != rows.n_joints:
        kind = f"{plant.label} with {plant.n_joints} joints, as {type(plant).__name__}"
        raise InvalidParameter(
            f"robot: got {kind}; needs a robot from a file in symbols with the {rows.n_joints} joints of the log",
            "robot",
        )
    with Progress("identification", 4 + 2 * N_DELAYS, progress) as bar:
        record = EvenRecord.from_log(rows, repair_time(rows, period=period, cutoff=cutoff), cutoff)
        bar.advance()
        regression = _Regression(record, plant, cutoff, False)
        width = min(WIDTHS, key=lambda w: _misfit(regression, w))
        bar.advance()
        solution = _solve(regression, width, bar)
        if links is not False:
            full = _Regression(record, plant, cutoff, True)
            better = _solve(full, width, bar)
            if links or np.max(better.explained - solution.explained) > MIN_GAIN:
                regression, solution = full, better
    return _result(record, plant, regression, solution, width)


def inertia_from_log(
    log: RobotLog | str | Path,
    *,
    columns: LogColumns | Mapping[str, Any] | str | Path | None = None,
    period: float | None = None,
    start_time: float | None = None,
    stop_time: float | None = None,
    cutoff: float = 25.0,
) -> IdentifiedInertia:
    """Identify M̂ from a log alone, by `tarc.design.inertia_from_data` on repaired times.

    Parameters
    ----------
    log, columns, period, start_time, stop_time, cutoff
        As in `identify_model`.

    Raises
    ------
    InvalidParameter
        For a log that does not read.
    NotIdentifiable
        For a log without torques, and a motion that does not show M.
    """
    rows = log if isinstance(log, RobotLog) else read_log(log, columns)
    rows = rows.between(start_time, stop_time)
    record = EvenRecord.from_log(rows, repair_time(rows, period=period, cutoff=cutoff), cutoff)
    return inertia_from_data(record.position, _torque(record), record.period)


def _torque(record: EvenRecord) -> Array:
    """Return the torques of a record."""
    if record.torque is None:
        raise NotIdentifiable("log: it has no torques, which identification needs; name their columns")
    return record.torque


def _misfit(regression: _Regression, width: float) -> float:
    """Return the log of what a fit without delay leaves at the joints, for a width of dry friction."""
    base, X = regression.at(0.0, width)
    solution = fit(X, regression.torque - base, regression.prior[:-1], regression.fitted_part)
    return float(np.sum(np.log(solution.deviations)))


def _solve(regression: _Regression, width: float, bar: Progress) -> _Solution:
    """Return the fit to the whole record, and the share that the fit to its beginning explains on its end."""
    delay = 0.0
    parts = regression.fitted_part, np.ones(len(regression.times), dtype=bool)
    base, X = regression.at(delay, width)
    solution = fit(X, regression.torque - base, regression.prior[:-1], parts[1])
    for _ in range(N_DELAYS):
        rate = regression.rate(delay, width, solution.parameters[: X.shape[2]])
        base, X = regression.at(delay, width)
        with_rate = np.concatenate([X, rate[:, :, None]], axis=2)
        solution = fit(with_rate, regression.torque - base, regression.prior, parts[1])
        delay += float(solution.parameters[-1])
        bar.advance()
    base, X = regression.at(delay, width)
    begin = fit(X, regression.torque - base, regression.prior[:-1], parts[0])
    residual = (regression.torque - base - X @ begin.parameters)[~parts[0]]
    return _Solution(fit=solution, delay=delay, explained=_explained(residual, regression.torque[~parts[0]]))


def _explained(residual: Array, torque: Array) -> Array:
    return 1 - np.var(residual, axis=0) / np.maximum(np.var(torque, axis=0), 1e-300)


def _result(
    record: EvenRecord, plant: RigidBody, regression: _Regression, solution: _Solution, width: float
) -> IdentifiedModel:
    """Return the numbers of a solution with their intervals."""
    n = plant.n_joints
    values, errors = solution.fit.parameters, solution.fit.errors
    per_joint = {
        name: Interval.about(values[i * n : (i + 1) * n], errors[i * n : (i + 1) * n])
        for i, name in enumerate(PER_JOINT)
    }
    inertial = slice(len(PER_JOINT) * n, -1)
    end = ~regression.fitted_part
    q, v, a = (record.motion(regression.times[end], order) for order in range(3))
    own = model_torque(plant, q, v, a)
    return IdentifiedModel(
        joint_names=tuple(plant.joint_names),
        **per_joint,
        coulomb_width=width,
        payload=None if regression.with_links else Interval.about(values[inertial][0], errors[inertial][0]),
        actuation_delay=Interval.about(np.array(solution.delay), errors[-1]),
        encoder_noise=_noise(record),
        explained_by_file=_explained(regression.torque[end] - own, regression.torque[end]),
        explained=solution.explained,
        inertia_ratio=_inertia_ratio(plant, regression, np.maximum(per_joint["armature"].value, 0.0), values[inertial]),
        has_links=regression.with_links,
    )


def _noise(record: EvenRecord) -> Interval:
    """Return the noise of the positions, with the scatter between parts of the record."""
    value = record.position_noise()
    parts = np.array([part.position_noise() for part in record.split(N_BLOCKS)])
    return Interval.about(value, np.std(parts, axis=0, ddof=1) / np.sqrt(N_BLOCKS))


def _inertia_ratio(plant: RigidBody, regression: _Regression, armature: Array, inertial: Array) -> tuple[float, float]:
    """Return the extreme eigenvalues of M_file(q)⁻¹ M(q) along a record."""
    from scipy.linalg import eigh

    n = len(armature)
    zero, extremes = np.zeros(n), []
    for q in regression.motion(regression.times[:: len(regression.times) // N_POSTURES], 0):
        M = regression.bare.inertia(q)
        if regression.links is None:
            change = inertial[0] * (regression.loaded.inertia(q) - M)
        else:
            gravity = np.array(regression.links(q, zero, zero)) @ inertial
            columns = [np.array(regression.links(q, zero, axis)) @ inertial - gravity for axis in np.eye(n)]
            change = np.column_stack(columns)
        M = M + np.diag(armature) + (change + change.T) / 2
        extremes.append(eigh(M, plant.inertia(q), eigvals_only=True)[[0, -1]])
    low, high = np.transpose(extremes)
    return float(low.min()), float(high.max())
