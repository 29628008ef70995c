"""Timing of a log, and the times at which its rows were really measured."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.signals.robot_log import MIN_ROWS, RobotLog
from tarc.signals.smoothing import smoothing_curve

MAX_TICK_DEVIATION = 0.15
"""Largest RMS distance of the steps from whole periods at which rows count as ticks of a clock."""
MAX_STEP_ERROR = 0.1
"""Largest deviation of a step from noise [periods] at which motion decides the step."""
EVEN_STAMPS = 0.02
"""Largest deviation of even stamps [periods]."""
PERIOD_DIGITS = 3
"""Digits to which a period is rounded, where the stamps agree."""
MAX_CLOCK_ERROR = 5e-4
"""Largest relative difference between the clocks of robot and recorder."""
REST_ROWS = 21
"""Number of rows about one that tell whether its encoders are still."""
MAX_REPEATS = 0.5
"""Largest share of these that may repeat the row before, where a repeat at rest still means a stale sample."""
N_COUNTS = 2
"""Repetitions of the count of ticks, each with the motion on the times of the one before."""
N_SHIFTS = 3
"""Repetitions of one shift per row, where rows are no ticks of a clock."""

Curve = Callable[..., Array]
"""Function of times and the order of a derivative, with values (k, n)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LogTiming:
    """Times of a log's rows: as stamped, and repaired by the motion that all joints share.

    Attributes
    ----------
    period
        T of the robot's clock [s].
    times
        Repaired time of each row [s], shape (k,), from 0 on.
    is_new
        Whether a row has a sample of its own, shape (k,); the others are stale.
    on_clock
        Whether the repaired times are whole periods.
    step_deviation
        Standard deviation of the steps of the stamps [s].
    stamp_error
        RMS of the stamps against the motion before the repair [s].
    stale
        Share of rows that repeat the sample of the row before.
    missing
        Share of periods without a row.
    lost
        Share of positions that are NaN.
    residual_before, residual
        RMS of positions against the smooth motion on stamped and on repaired times [rad or m], shape (n,).
    """

    period: float
    times: Array
    is_new: Array
    on_clock: bool
    step_deviation: float
    stamp_error: float
    stale: float
    missing: float
    lost: float
    residual_before: Array
    residual: Array

    @property
    def rate(self) -> float:
        """Return the samples per second that the log has of its own [Hz]."""
        return float(np.count_nonzero(self.is_new) / (self.times[-1] - self.times[0] + self.period))


def repair_time(log: RobotLog, *, period: float | None = None, cutoff: float = 25.0) -> LogTiming:
    """Find the times at which the rows of a log were measured.

    All joints of a row share its time error s. The smooth motion q(t) goes through the stamps. Joints are weighted by
    the inverse square of their range. Least squares give the step between two rows from the positions alone:

        Δt = (Δq · v̄) / (v̄ · v̄),    v̄ the mean of q̇ at both rows

    Where these steps are whole periods but for noise, rows are ticks of the robot's clock. A step of 0 is then a stale
    row, and a step of 2 a missing one. Where the robot rests, the stamps count; there a repeated row is a stale one
    only if few rows about it repeat. Otherwise each row is shifted by its own s, until the shifts repeat.

    Parameters
    ----------
    log
        The log.
    period
        T [s]; None for the one that stamps and motion agree on.
    cutoff
        Of the smooth motion [Hz], as in `smoothing_curve`.

    Raises
    ------
    InvalidParameter
        For a log that never moves or has too few complete rows, and a cut-off that its rate does not allow.
    """
    complete: Array = np.all(np.isfinite(log.position), axis=1)
    if np.count_nonzero(complete) < MIN_ROWS:
        raise InvalidParameter(f"log: {np.count_nonzero(complete)} rows of {log.label} are complete; needs {MIN_ROWS}")
    stamps = log.times - log.times[0]
    nominal = _nominal_period(stamps, period)
    repeats = np.zeros(len(stamps), dtype=bool)
    repeats[1:] = np.all(log.position[1:] == log.position[:-1], axis=1)
    weights = 1 / np.maximum(np.ptp(log.position[complete], axis=0), 1e-12) ** 2
    if not np.any(np.ptp(log.position[complete], axis=0) > 0):
        raise InvalidParameter(f"log: no joint of {log.label} moves, so that nothing shows the time of its rows")
    usable = complete & ~repeats
    curve = smoothing_curve(*_increasing(stamps[usable], log.position[usable]), cutoff)
    before = log.position - curve(stamps)
    on_clock, times = True, nominal * np.round(stamps / nominal)
    steps = np.diff(stamps)
    if np.any(repeats) or np.max(np.abs(stamps - times)) > EVEN_STAMPS * nominal:
        ticks, deviation = _ticks(log.position, curve(stamps, 1), stamps, nominal, weights, repeats)
        on_clock = deviation < MAX_TICK_DEVIATION
        if on_clock:
            for _ in range(N_COUNTS):
                nominal = _refined_period(stamps, ticks, nominal) if period is None else nominal
                times = nominal * ticks
                better = smoothing_curve(*_increasing(times[usable], log.position[usable]), cutoff)
                ticks, _ = _ticks(log.position, better(times, 1), stamps, nominal, weights, repeats)
            times = nominal * ticks
        else:
            times = _shifted(log.position, stamps, usable, weights, cutoff)
    is_new = np.array(complete)
    is_new[1:] &= (np.diff(times) > 0) if on_clock else ~repeats[1:]
    _, residual = _smooth(times[is_new], log.position[is_new], cutoff)
    n_periods = round((times[-1] - times[0]) / nominal) + 1
    shift = _shared_shift(before[usable], curve(stamps[usable], 1), weights)
    return LogTiming(
        period=nominal,
        times=times,
        is_new=is_new,
        on_clock=on_clock,
        step_deviation=float(np.std(steps)),
        stamp_error=_rms(shift),
        stale=float(1 - np.count_nonzero(is_new) / np.count_nonzero(complete)),
        missing=max(1 - float(np.count_nonzero(is_new | ~complete)) / n_periods, 0.0),
        lost=float(np.mean(~np.isfinite(log.position))),
        residual_before=np.sqrt(np.mean(before[usable] ** 2, axis=0)),
        residual=np.sqrt(np.mean(residual**2, axis=0)),
    )


def _nominal_period(stamps: Array, period: float | None) -> float:
    """Return the given period, or the median step of the stamps, rounded where that is near."""
    if period is not None:
        return check.number("period", period, 0, strict=True)
    steps = np.diff(stamps)
    return _rounded(float(np.median(steps[steps > 0])))


def _rounded(period: float) -> float:
    near = float(f"{period:.{PERIOD_DIGITS}g}")
    return near if abs(near - period) < MAX_CLOCK_ERROR * period else period


def _refined_period(stamps: Array, ticks: Array, nominal: float) -> float:
    """Return the period by which ticks and stamps run together, rounded where that is near."""
    slope = float(np.polyfit(ticks, stamps, 1)[0])
    return nominal if abs(slope - nominal) < MAX_CLOCK_ERROR * nominal else _rounded(slope)


def _increasing(times: Array, values: Array) -> tuple[Array, Array]:
    """Return the rows whose time is later than all before."""
    later = np.ones(len(times), dtype=bool)
    later[1:] = np.diff(np.maximum.accumulate(times)) > 0
    return times[later], values[later]


def _ticks(
    position: Array, velocity: Array, stamps: Array, period: float, weights: Array, repeats: Array
) -> tuple[Array, float]:
    """Return the tick of each row, shape (k,), and the RMS distance of fast steps from whole periods."""
    mean_velocity = (velocity[1:] + velocity[:-1]) / 2
    moved = np.diff(position, axis=0)
    energy = np.sum(weights * mean_velocity**2, axis=1)
    by_motion = np.sum(weights * moved * mean_velocity, axis=1) / np.maximum(energy, 1e-300) / period
    distance = by_motion - np.round(by_motion)
    speed = np.sqrt(energy)
    fast = np.isfinite(by_motion) & (speed > np.median(speed))
    noise = np.median(np.abs(distance[fast]) * speed[fast]) / 0.6745 if np.any(fast) else np.inf
    is_certain = np.isfinite(by_motion) & (noise < MAX_STEP_ERROR * speed)
    counts = np.where(is_certain, np.maximum(np.round(np.where(is_certain, by_motion, 0.0)), 0.0), np.nan)
    deviation = _rms(distance[fast]) if np.any(fast) else 0.0
    return _counted(counts, stamps, period, repeats & ~_is_still(repeats)), deviation


def _is_still(repeats: Array) -> Array:
    """Return whether most rows about each repeat the one before, (k,): encoders at rest without noise."""
    window = min(REST_ROWS, len(repeats))
    return np.convolve(repeats, np.full(window, 1 / window), mode="same") > MAX_REPEATS


def _counted(counts: Array, stamps: Array, period: float, repeats: Array) -> Array:
    """Return ticks from the counts between rows; where these are NaN, by the stamps since the last known count."""
    ticks = np.zeros(len(stamps))
    anchor = 0
    for row in range(1, len(ticks)):
        if np.isfinite(counts[row - 1]):
            ticks[row] = ticks[row - 1] + counts[row - 1]
            anchor = row
        elif repeats[row]:
            ticks[row] = ticks[row - 1]
        else:
            ticks[row] = max(ticks[anchor] + np.round((stamps[row] - stamps[anchor]) / period), ticks[row - 1])
    return ticks


def _shared_shift(residual: Array, velocity: Array, weights: Array) -> Array:
    """Return the time error of each row [s]: least squares of q − q(t) = q̇ s over the joints."""
    energy = np.sum(weights * velocity**2, axis=1)
    least = 1e-3 * np.mean(energy)
    return np.where(energy > least, np.sum(weights * residual * velocity, axis=1) / np.maximum(energy, least), 0.0)


def _shifted(position: Array, stamps: Array, usable: Array, weights: Array, cutoff: float) -> Array:
    """Return the stamps shifted row by row onto the smooth motion."""
    times = stamps.copy()
    for _ in range(N_SHIFTS):
        curve = smoothing_curve(*_increasing(times[usable], position[usable]), cutoff)
        shift = _shared_shift(position[usable] - curve(times[usable]), curve(times[usable], 1), weights)
        times[usable] += shift
    return np.maximum.accumulate(times)


def _smooth(times: Array, values: Array, cutoff: float) -> tuple[Curve, Array]:
    """Return the smooth curve through values, and what is left of them."""
    curve = smoothing_curve(*_increasing(times, values), cutoff)
    return curve, values - curve(times)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
