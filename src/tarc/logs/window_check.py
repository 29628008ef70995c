"""Derivatives of a window held against a record: delay and error."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic, polynomial_weights
from tarc.logs.even_record import EvenRecord
from tarc.logs.time_repair import Curve, LogTiming
from tarc.numerics.interval_minimum import minimise_in_interval
from tarc.signals.robot_log import RobotLog

BAND = 0.25
"""Cut-off of the motion against which a delay is measured, over 1/ς."""
MOTION_BAND = 0.2
"""The same over the cut-off of the smooth motion, at most."""
MAX_RECORDED_DELAY = 0.05
"""Largest delay of a recorded velocity that is looked for [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowCheck:
    """Estimates of one window along a record.

    Attributes
    ----------
    window
        ς [s].
    predicted_delay
        Group delay of the acceleration [s].
    delay
        Measured delay of the acceleration against the smooth motion [s], shape (n,).
    delay_by_velocity
        Measured delay against the derivative of the recorded velocity, whose own delay is added [s], shape (n,). None
        without a recorded velocity.
    error_of_rows
        RMS error of the acceleration with each row taken as one period [rad/s² or m/s²], shape (n,).
    error_of_stamps
        The same with weights for the stamps of the rows.
    error
        The same on repaired times.
    error_without_delay
        The same against the motion at the predicted delay before.
    noise
        RMS of the acceleration that the noise of the positions causes, by the window's noise gain.
    """

    window: float
    predicted_delay: float
    delay: Array
    delay_by_velocity: Array | None
    error_of_rows: Array
    error_of_stamps: Array
    error: Array
    error_without_delay: Array
    noise: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class VelocityCheck:
    """The recorded velocity against the derivative of the recorded position.

    Attributes
    ----------
    delay
        By which the recorded velocity is late [s], shape (n,).
    correlation
        Of both, with this delay taken out, shape (n,).
    error
        RMS of the difference, with this delay taken out [rad/s or m/s], shape (n,).
    """

    delay: Array
    correlation: Array
    error: Array


def check_window(
    log: RobotLog,
    timing: LogTiming,
    record: EvenRecord,
    window: float,
    cutoff: float,
) -> WindowCheck:
    """Compare the acceleration of a window of degree 2 with the smooth motion.

    Parameters
    ----------
    log, timing, record
        The log, its timing, and the log on its clock.
    window
        ς [s], a multiple of the period.
    cutoff
        Of the smooth motion [Hz].

    Raises
    ------
    InvalidParameter
        For a window that is no multiple of the period, or holds fewer than three samples.
    """
    estimator = Algebraic(window=window).with_period(record.period)
    weights = estimator.weights(2)
    delay = estimator.group_delay(2)
    inner = record.inner(max(10 / cutoff, 2 * window))
    estimate = _filtered(record.position, weights)
    by_rows = _filtered(log.position, weights)
    by_stamps = _on_stamps(log, estimator.samples)
    truth_of_rows = record.motion(timing.times, 2)
    first, last = record.times[inner.start], record.times[inner.stop - 1]
    rows = (timing.times >= first) & (timing.times <= last) & np.isfinite(by_rows).all(axis=1)
    rows &= np.isfinite(by_stamps).all(axis=1)
    band = min(MOTION_BAND * cutoff, BAND / window)
    slow = record.smooth(np.nan_to_num(estimate), band)(record.times)
    return WindowCheck(
        window=window,
        predicted_delay=delay,
        delay=_delays(slow, record.position, 2, record, inner, band, window),
        delay_by_velocity=_delay_by_velocity(slow, record, inner, band, window),
        error_of_rows=_rms(by_rows[rows] - truth_of_rows[rows]),
        error_of_stamps=_rms(by_stamps[rows] - truth_of_rows[rows]),
        error=_rms((estimate - record.motion(record.times, 2))[inner]),
        error_without_delay=_rms((estimate - record.motion(record.times - delay, 2))[inner]),
        noise=estimator.noise_gain(2) * record.position_noise(),
    )


def check_velocity(record: EvenRecord, cutoff: float) -> VelocityCheck | None:
    """Compare the recorded velocity with the derivative of the smooth motion; None without one."""
    if record.velocity is None:
        return None
    inner = record.inner(10 / cutoff)
    times = record.times[inner]
    by_joint = []
    for i, column in enumerate(record.velocity[inner].T):
        motion = record.smooth(record.position[:, [i]], cutoff)
        delay, correlation = _delay(column, _derivative(motion, 1), times, -MAX_RECORDED_DELAY, MAX_RECORDED_DELAY)
        difference = column - motion(times - delay, 1)[:, 0]
        by_joint.append((delay, correlation, float(np.sqrt(np.mean(difference**2)))))
    delays, correlations, errors = np.array(by_joint).T
    return VelocityCheck(delay=delays, correlation=correlations, error=errors)


def _delays(
    estimate: Array, values: Array, derivative: int, record: EvenRecord, inner: slice, band: float, window: float
) -> Array:
    """Return the delay of each joint's estimate against a derivative of values below a frequency."""
    delays = []
    for i, column in enumerate(estimate[inner].T):
        slow = _derivative(record.smooth(values[:, [i]], band), derivative)
        delays.append(_delay(column, slow, record.times[inner], -window, window)[0])
    return np.array(delays)


def _delay_by_velocity(estimate: Array, record: EvenRecord, inner: slice, band: float, window: float) -> Array | None:
    """Return the delay against the derivative of the recorded velocity, that of the velocity itself added."""
    if record.velocity is None:
        return None
    recorded = record.smooth(record.velocity, band)(record.times, 1)
    own = _delays(recorded, record.position, 2, record, inner, band, MAX_RECORDED_DELAY)
    return _delays(estimate, record.velocity, 1, record, inner, band, window) + own


def _derivative(motion: Curve, derivative: int) -> Callable[[Array], Array]:
    """Return a derivative of one joint as a function of times."""
    return lambda times: motion(times, derivative)[:, 0]


def _delay(
    signal: Array, curve: Callable[[Array], Array], times: Array, least: float, largest: float
) -> tuple[float, float]:
    """Return the delay of a signal against a curve at which they correlate best, and the correlation there."""
    centred = signal - np.mean(signal)
    size = np.sqrt(np.sum(centred**2))

    def misfit(delay: float) -> float:
        values = curve(times - delay)
        values = values - np.mean(values)
        return -float(centred @ values / max(size * np.sqrt(np.sum(values**2)), 1e-300))

    coarse = np.linspace(least, largest, 21)
    start = coarse[int(np.argmin([misfit(delay) for delay in coarse]))]
    step = coarse[1] - coarse[0]
    delay, least_misfit = minimise_in_interval(misfit, start - step, start + step, 1e-7)
    return delay, -least_misfit


def _filtered(values: Array, weights: Array) -> Array:
    """Return weighted sums over the newest rows, NaN where the window is not full."""
    result = np.full(values.shape, np.nan)
    result[len(weights) - 1 :] = np.column_stack([np.convolve(column, weights, "valid") for column in values.T])
    return result


def _on_stamps(log: RobotLog, samples: int) -> Array:
    """Return the acceleration with weights for the stamps of each window, NaN where it has too few times."""
    ages = np.lib.stride_tricks.sliding_window_view(log.times, samples)[:, ::-1]
    ages = ages[:, :1] - ages
    windows = np.lib.stride_tricks.sliding_window_view(log.position, samples, axis=0)[:, :, ::-1]
    result = np.full(log.position.shape, np.nan)
    separate = np.count_nonzero(np.diff(ages, axis=1) > 0, axis=1) >= 2
    weights = polynomial_weights(ages[separate], 2, 2)
    inside = np.full(windows.shape[:2], np.nan)
    inside[separate] = np.einsum("kns,ks->kn", windows[separate], weights)
    result[samples - 1 :] = inside
    return result


def _rms(values: Array) -> Array:
    return np.sqrt(np.mean(values**2, axis=0))
