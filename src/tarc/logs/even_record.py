"""A log on the ticks of its robot's clock, and the smooth motion through it."""

from dataclasses import dataclass, replace
from math import comb

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.logs.time_repair import Curve, LogTiming
from tarc.signals.robot_log import RobotLog
from tarc.signals.smoothing import smoothing_curve

MAX_ROWS = 5_000_000
"""Most ticks of a record."""
DIFFERENCE = 4
"""Order of the difference that shows noise and no motion."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EvenRecord:
    """A record with one row per period.

    Attributes
    ----------
    period
        T [s].
    times
        [s], shape (k,).
    position
        Measured positions [rad or m], shape (k, n). Where a tick is missing, the smooth motion and what neighbours
        differ from it.
    is_measured
        Whether a tick was measured, shape (k,).
    motion
        The smooth motion, as a function of times and derivative.
    velocity, torque, reference
        What the robot recorded, linear between ticks, each of shape (k, n), or None.
    """

    period: float
    times: Array
    position: Array
    is_measured: Array
    motion: Curve
    velocity: Array | None
    torque: Array | None
    reference: Array | None

    @classmethod
    def from_log(cls, log: RobotLog, timing: LogTiming, cutoff: float) -> "EvenRecord":
        """Put a log on the ticks of its clock.

        Raises
        ------
        InvalidParameter
            For a log that lasts for too many periods.
        """
        T, rows = timing.period, timing.is_new
        count = int(np.floor((timing.times[-1] - timing.times[0]) / T + 1e-6)) + 1
        if count > MAX_ROWS:
            raise InvalidParameter(f"log: {log.label} lasts for {count} periods; at most {MAX_ROWS} fit into memory")
        ticks = timing.times[0] + T * np.arange(count)
        own = timing.times[rows]
        later = np.concatenate([[True], np.diff(own) > 0])
        own = own[later]
        position = log.position[rows][later]
        motion = smoothing_curve(own, position, cutoff)

        def even(values: Array | None) -> Array | None:
            return None if values is None else _interpolated(ticks, timing.times[rows][later], values[rows][later])

        nearest = np.zeros(count, dtype=bool)
        places = np.round((own - ticks[0]) / T).astype(int)
        nearest[places[(places >= 0) & (places < count)]] = True
        difference = _interpolated(ticks, own, position - motion(own))
        return cls(
            period=T,
            times=ticks,
            position=motion(ticks) + difference,
            is_measured=nearest,
            motion=motion,
            velocity=even(log.velocity),
            torque=even(log.torque),
            reference=even(log.reference),
        )

    def smooth(self, values: Array, cutoff: float) -> Curve:
        """Return the smooth curve through values at the ticks, shape (k, n)."""
        return smoothing_curve(self.times, values, cutoff)

    def inner(self, margin: float) -> slice:
        """Return the rows that are farther than a margin [s] from both ends, at least half of all."""
        rows = min(int(np.ceil(margin / self.period)), len(self.times) // 4)
        return slice(rows, len(self.times) - rows)

    def split(self, count: int) -> list["EvenRecord"]:
        """Return parts of equal length, in the order of time."""
        length = len(self.times) // count
        tables = ("times", "position", "is_measured", "velocity", "torque", "reference")
        parts = []
        for k in range(count):
            rows = slice(k * length, (k + 1) * length)
            cut = {name: value[rows] for name in tables if (value := getattr(self, name)) is not None}
            parts.append(replace(self, **cut))
        return parts

    def position_noise(self) -> Array:
        """Return the standard deviation of white noise of the positions [rad or m], shape (n,).

        It is the RMS of the fourth differences over √70, which is theirs for noise of deviation one.
        """
        differences = np.diff(self.position, DIFFERENCE, axis=0)
        windows = np.lib.stride_tricks.sliding_window_view(self.is_measured, DIFFERENCE + 1).all(axis=1)
        used = differences[windows] if np.any(windows) else differences
        return np.sqrt(np.mean(used**2, axis=0) / comb(2 * DIFFERENCE, DIFFERENCE))


def _interpolated(instants: Array, times: Array, values: Array) -> Array:
    """Return values (k, n) linear between their times, without those that are NaN."""
    columns = []
    for column in values.T:
        is_valid = np.isfinite(column)
        columns.append(
            np.interp(instants, times[is_valid], column[is_valid])
            if np.any(is_valid)
            else np.full(len(instants), np.nan)
        )
    return np.column_stack(columns)
