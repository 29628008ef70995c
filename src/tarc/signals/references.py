"""Reference trajectories with exact derivatives."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.types import Array, Vector
from tarc.core.validation import Numbers, Table
from tarc.signals.smoothing import smoothing_curve
from tarc.signals.trajectory_file import Record, are_numbered, check_overlap, read_record

POLYNOMIAL_DEGREE = 5
"""Largest degree of a piece of a reference."""


class PolynomialPieces(NamedTuple):
    """Polynomials of degree five in time, q = Σ c_j (t − t_i)^j from t_i to the next; held before and after.

    Attributes
    ----------
    times
        t_0, …, t_k [s], increasing, shape (k + 1,).
    coefficients
        c_j of each piece, shape (k, 6, n).
    end
        Position at the last time [rad or m], shape (n,).
    """

    times: Array
    coefficients: Array
    end: Array

    @classmethod
    def from_curve(cls, curve: Callable[..., np.ndarray], times: Array) -> "PolynomialPieces":
        """Return the pieces of a curve from a time to its next; each is its Taylor series there.

        Parameters
        ----------
        curve
            Function of times (k,) and the order of a derivative, with values (k, n).
        times
            Where pieces begin and end, shape (k + 1,).
        """
        starts = times[:-1]
        coefficients = [curve(starts, order) / factorial(order) for order in range(POLYNOMIAL_DEGREE + 1)]
        return cls(times, np.stack(coefficients, axis=1), curve(times[-1:])[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference(Component):
    """A trajectory qᵈ(t) with its first two derivatives."""

    @property
    @abstractmethod
    def n_joints(self) -> int:
        """Return the number of joints n."""

    @abstractmethod
    def sample(self, times: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration [rad or m, /s, /s²] at the times (k,), each of shape (n, k)."""

    def at(self, time: Vector) -> tuple[Vector, Vector, Vector]:
        """Return `sample` at one time, each (n,); accepts a CasADi symbol.

        Raises
        ------
        UnsupportedLaw
            For a symbol and a curve that is no formula, whose `pieces` are polynomials.
        """
        if ops.symbolic(time):
            raise UnsupportedLaw(f"reference: {type(self).__name__} is no formula in time; use its pieces")
        position, velocity, acceleration = self.sample(np.array([time]))
        return position[:, 0], velocity[:, 0], acceleration[:, 0]

    def pieces(self) -> "PolynomialPieces | None":
        """Return the polynomials that it consists of, or None for a formula in time."""
        return None

    def for_run(self, joint_names: Sequence[str], duration: float) -> "Reference":
        """Return the reference for a robot with these joints and a run of a duration [s]; by default itself.

        Raises
        ------
        InvalidParameter
            For a reference that does not fit the robot or the run.
        """
        return self


@dataclass(frozen=True, kw_only=True, eq=False)
class Sinusoid(Reference):
    """qᵈ = offset + amplitude sin(frequency t + phase), one number or one per joint each.

    Parameters
    ----------
    amplitude, offset
        [rad or m].
    frequency
        [rad/s].
    phase
        [rad]; π/2 starts at an extreme, at rest.
    """

    amplitude: Numbers
    frequency: Numbers
    phase: Numbers = 0.0
    offset: Numbers = 0.0

    def __post_init__(self) -> None:
        _ = self._table

    @cached_property
    def _table(self) -> np.ndarray:
        rows = {name: check.array(name, getattr(self, name)) for name in ("amplitude", "frequency", "phase", "offset")}
        size = max(row.size for row in rows.values())
        return np.array([check.vector(name, row, size) for name, row in rows.items()])

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return self._table.shape[1]

    def sample(self, times: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration, each of shape (n, k)."""
        return self._formula(np.asarray(times, dtype=float), self._table[..., None])

    def at(self, time: Vector) -> tuple[Vector, Vector, Vector]:
        """Return position, velocity and acceleration at one time, each (n,); accepts a CasADi symbol."""
        return self._formula(time, self._table)

    @staticmethod
    def _formula(times: Vector, table: np.ndarray) -> tuple[Vector, Vector, Vector]:
        amplitude, frequency, phase, offset = table
        angle = frequency * times + phase
        wave, slope = amplitude * ops.sin(angle), amplitude * ops.cos(angle)
        return offset + wave, frequency * slope, -(frequency**2) * wave


@dataclass(frozen=True, kw_only=True, eq=False)
class Multisine(Reference):
    """qᵈ_i = offset_i + Σ_m amplitude_im sin(frequency_m t + phase_im).

    Parameters
    ----------
    amplitude
        [rad or m], shape (n, m) or, the same for each frequency, (n,).
    frequency
        [rad/s], shape (m,).
    phase
        [rad], shape (n, m); None for Schroeder's phases −π m²/M, shifted from joint to joint, which keep the crest low.
    offset
        [rad or m], one number or one per joint.
    """

    amplitude: Numbers | Table
    frequency: Sequence[float] | np.ndarray
    phase: Table | None = None
    offset: Numbers = 0.0

    def __post_init__(self) -> None:
        _ = self._tables

    @cached_property
    def _tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        frequency = np.atleast_1d(check.array("frequency", self.frequency))
        tones = len(frequency)
        amplitude = np.atleast_1d(check.array("amplitude", self.amplitude))
        if amplitude.ndim == 1:
            amplitude = np.repeat(amplitude[:, None], tones, axis=1)
        if amplitude.shape[1] != tones:
            raise InvalidParameter(
                f"amplitude: got shape {amplitude.shape}; needs (joints, {tones}), one column per frequency"
            )
        n = len(amplitude)
        if self.phase is None:
            m = np.arange(1, tones + 1)
            phase = -np.pi * m**2 / tones + np.arange(n)[:, None]
        else:
            phase = check.array("phase", self.phase)
            if phase.shape != amplitude.shape:
                raise InvalidParameter(f"phase: got shape {phase.shape}; needs {amplitude.shape}, as the amplitude")
        return amplitude, frequency, phase, check.vector("offset", self.offset, n)

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return len(self._tables[0])

    def sample(self, times: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration, each of shape (n, k)."""
        amplitude, frequency, phase, offset = self._tables
        angle = np.multiply.outer(frequency, np.asarray(times, dtype=float))[None] + phase[..., None]
        sine, cosine = np.sin(angle), np.cos(angle)
        position = offset[:, None] + np.einsum("nm,nmk->nk", amplitude, sine)
        velocity = np.einsum("nm,nmk->nk", amplitude * frequency, cosine)
        return position, velocity, -np.einsum("nm,nmk->nk", amplitude * frequency**2, sine)

    def at(self, time: Vector) -> tuple[Vector, Vector, Vector]:
        """Return position, velocity and acceleration at one time, each (n,); accepts a CasADi symbol."""
        amplitude, frequency, phase, offset = self._tables
        position, velocity, acceleration = offset, 0.0, 0.0
        for tone, rate in enumerate(frequency.tolist()):
            angle = rate * time + phase[:, tone]
            wave, slope = amplitude[:, tone] * ops.sin(angle), amplitude[:, tone] * ops.cos(angle)
            position = position + wave
            velocity = velocity + rate * slope
            acceleration = acceleration - rate**2 * wave
        return position, velocity, acceleration


@dataclass(frozen=True, kw_only=True, eq=False)
class Chirp(Reference):
    """Sine whose frequency sweeps linearly from start to stop over the duration, then stays.

    Parameters
    ----------
    amplitude, offset
        [rad or m], one number or one per joint.
    start_frequency, stop_frequency
        [rad/s].
    sweep_time
        Duration of the sweep [s].
    """

    amplitude: Numbers
    start_frequency: float
    stop_frequency: float
    sweep_time: float
    offset: Numbers = 0.0

    def __post_init__(self) -> None:
        check.number("start_frequency", self.start_frequency, 0)
        check.number("stop_frequency", self.stop_frequency, 0)
        check.number("sweep_time", self.sweep_time, 0, strict=True)
        check.vector("offset", self.offset, self.n_joints)

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return np.atleast_1d(check.array("amplitude", self.amplitude)).size

    def sample(self, times: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration, each of shape (n, k)."""
        amplitude = check.vector("amplitude", self.amplitude, self.n_joints)[:, None]
        offset = check.vector("offset", self.offset, self.n_joints)[:, None]
        return self._formula(np.asarray(times, dtype=float), amplitude, offset)

    def at(self, time: Vector) -> tuple[Vector, Vector, Vector]:
        """Return position, velocity and acceleration at one time, each (n,); accepts a CasADi symbol."""
        amplitude = check.vector("amplitude", self.amplitude, self.n_joints)
        return self._formula(time, amplitude, check.vector("offset", self.offset, self.n_joints))

    def _formula(self, t: Vector, amplitude: np.ndarray, offset: np.ndarray) -> tuple[Vector, Vector, Vector]:
        inside = ops.minimum(t, self.sweep_time)
        rate = (self.stop_frequency - self.start_frequency) / self.sweep_time
        angle = self.start_frequency * inside + rate * inside**2 / 2 + self.stop_frequency * (t - inside)
        frequency, slope = self.start_frequency + rate * inside, ops.where(t < self.sweep_time, rate, 0.0)
        acceleration = slope * ops.cos(angle) - frequency**2 * ops.sin(angle)
        return (
            offset + amplitude * ops.sin(angle),
            amplitude * frequency * ops.cos(angle),
            amplitude * acceleration,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Quintic(Reference):
    """Quintic spline through way-points, at rest at both ends; before and after, it stays at the end points.

    Parameters
    ----------
    points
        Way-points [rad or m], shape (k, n), one row per point.
    times
        Time at each way-point [s], increasing, shape (k,).
    stop_at_points
        Whether to stop at each way-point, instead of passing with continuous derivatives up to the fourth.
    """

    points: Table
    times: Sequence[float] | np.ndarray
    stop_at_points: bool = False

    def __post_init__(self) -> None:
        _ = self._curve

    @cached_property
    def _curve(self) -> Callable[..., np.ndarray]:
        from scipy.interpolate import BPoly, make_interp_spline

        times = np.atleast_1d(check.array("times", self.times))
        points = check.array("points", self.points)
        if points.ndim != 2 or len(points) != len(times) or len(points) < 2:
            raise InvalidParameter(
                f"points: got shape {points.shape} with {len(times)} times; needs (k, n), one row per time, two or more"
            )
        if np.any(np.diff(times) <= 0):
            raise InvalidParameter(f"times: got {times.tolist()}; must increase")
        zero = np.zeros(points.shape[1])
        if self.stop_at_points:
            return BPoly.from_derivatives(times, [[point, zero, zero] for point in points])
        at_rest = [(1, zero), (2, zero)]
        return make_interp_spline(times, points, k=5, bc_type=(at_rest, at_rest))

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return np.shape(self.points)[1]

    def sample(self, times: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration, each of shape (n, k)."""
        return sample_curve(self._curve, np.asarray(times, dtype=float), self.times[0], self.times[-1])

    def pieces(self) -> PolynomialPieces:
        """Return the polynomials between the way-points."""
        return PolynomialPieces.from_curve(self._curve, np.array(self.times, dtype=float))


def sample_curve(
    curve: Callable[..., np.ndarray], t: np.ndarray, first: float, last: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a curve and its first two derivatives at times (k,), each (n, k), held outside its range."""
    inside = np.clip(t, first, last)
    moving = ((t >= first) & (t <= last)).astype(float)
    return curve(inside).T, curve(inside, 1).T * moving, curve(inside, 2).T * moving


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedReference(Reference):
    """Trajectory from a file: a quintic spline through its samples gives the derivatives, or a smoothing spline.

    `tarc.simulate` and scenarios match a header that names joints with the joints of the robot. Names such as ``q1``,
    ``q2``, … and a file without a header mean the order of the robot's joints.

    Parameters
    ----------
    path
        CSV with a header or without, or a NumPy ``.npy`` array: the first column time [s], then one per joint
        [rad or m]. At least 6 rows. Or a ROS 2 bag ``.mcap`` with joint states, of which those of the robot are taken.
    starts_at_zero
        Whether times count from the first stamp, which is then time 0 of the run. False takes the stamps as times of
        the run.
    joint_names
        Names of the columns in the order of the robot's joints, where they differ from the robot's own names. None
        takes the robot's.
    cutoff
        Frequency [Hz] at which smoothing leaves 1/√2 of an amplitude (−3 dB), for records with noise. None passes
        through every sample. See `smoothing_curve`.
    """

    path: str | Path
    starts_at_zero: bool = True
    joint_names: Sequence[str] | None = None
    cutoff: float | None = None

    def __post_init__(self) -> None:
        _ = self._curve

    @cached_property
    def _record(self) -> Record:
        return read_record(self.path)

    @cached_property
    def _times(self) -> np.ndarray:
        times = self._record.table[:, 0]
        return times - times[0] if self.starts_at_zero else times

    @cached_property
    def _curve(self) -> Callable[..., np.ndarray]:
        from scipy.interpolate import make_interp_spline

        positions = self._record.table[:, 1:]
        columns = self._record.columns
        if self.joint_names is not None:
            names = list(self.joint_names)
            if columns is None or sorted(names) != sorted(self._needed(columns, names)):
                raise InvalidParameter(
                    f"joint_names: got {', '.join(map(str, names))}; {self.path} has "
                    f"{'no header' if columns is None else 'the columns ' + ', '.join(columns)}; "
                    "needs the name of every column once",
                    "joint_names",
                )
            positions = positions[:, [columns.index(name) for name in names]]
        if self.cutoff is not None:
            return smoothing_curve(self._times, positions, self.cutoff)
        return make_interp_spline(self._times, positions, k=5)

    @property
    def end_time(self) -> float:
        """Return the time of the last row [s]."""
        return float(self._times[-1])

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return self._record.table.shape[1] - 1 if self.joint_names is None else len(self.joint_names)

    def _needed(self, columns: list[str], names: Sequence[str]) -> list[str]:
        """Return the columns, of a bag those of the named joints alone."""
        is_bag = Path(self.path).suffix.lower() == ".mcap"
        return [name for name in columns if name in names] if is_bag else columns

    def for_run(self, joint_names: Sequence[str], duration: float) -> Reference:
        """Return the reference with its columns in the order of the robot's joints.

        Raises
        ------
        InvalidParameter
            For a header that names other joints, and for a record that lies outside the run.
        """
        check_overlap(self.path, self._times[0], self._times[-1], duration)
        columns = self._record.columns
        if columns is None or self.joint_names is not None or columns == list(joint_names):
            return self
        if sorted(self._needed(columns, joint_names)) == sorted(joint_names):
            return replace(self, joint_names=tuple(joint_names))
        if len(columns) == 1 or are_numbered(columns):
            return self
        unknown = next((name for name in columns if name not in joint_names), columns[0])
        raise InvalidParameter(
            f"reference: {self.path} has the columns {', '.join(columns)}; the robot's joints are "
            f"{', '.join(joint_names)}.{check.did_you_mean(unknown, joint_names)} Name each column as its joint, or "
            "q1, q2, … for the robot's order. Or give joint_names: the columns' names in the robot's order",
            "reference",
        )

    def sample(self, times: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration, each of shape (n, k); held before and after the record."""
        return sample_curve(self._curve, np.asarray(times, dtype=float), self._times[0], self._times[-1])

    def pieces(self) -> PolynomialPieces:
        """Return the polynomials between the rows."""
        return PolynomialPieces.from_curve(self._curve, self._times)
