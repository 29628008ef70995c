"""Encoders of a logged loop: step, noise, missing and stale samples, and jitter of the sampling times."""

from dataclasses import dataclass
from math import comb

import numpy as np

from tarc.core.types import Array
from tarc.logs.loop_checks import longest_run
from tarc.logs.loop_log import LoopLog

DIFFERENCE = 6
"""Order of the difference that shows noise and no motion."""
MULTIPLE = 0.02
"""Largest distance of a difference from whole steps, over the step."""
FULL_SHARE = 0.999
"""Share of the differences that must be whole steps."""
N_PARTS = 8
"""Parts of a log from whose scatter the error of the jitter follows."""
SIGNIFICANT = 3.0
"""Standard errors by which a variance by jitter must differ from zero."""
MAX_JITTER_SHARE = 0.75
"""Largest share of the noise's variance that jitter may have, so that the rest shows."""
STALE_STEPS = 3.0
"""Steps or deviations of noise by which a joint moves in a period where a repeated row counts as stale."""
SPEED_SPAN = 5
"""Periods before and after a sample over which its speed is measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EncoderCheck:
    """What the measured positions show of their encoders.

    Attributes
    ----------
    resolution
        Step [rad or m], NaN where the readings show none, shape (n,).
    noise
        Standard deviation of white noise, rounding included and jitter taken out [rad or m], shape (n,). NaN where
        jitter hides it.
    missing
        Share of the samples that are missing, shape (n,).
    longest_gap
        Most periods in a row without a complete sample.
    stale
        Share of the rows that repeat the one before while the robot moves.
    jitter
        Standard deviation of the sampling times [s]: of the robot's stamps, else from the motion of all joints.
    jitter_error
        Its standard error [s].
    """

    resolution: Array
    noise: Array
    missing: Array
    longest_gap: int
    stale: float
    jitter: float
    jitter_error: float


def check_encoders(log: LoopLog) -> EncoderCheck:
    """Return step, noise, gaps and jitter of a log's measured positions.

    Noise is the RMS of the sixth differences over √924, which is theirs for noise of deviation one. Jitter s moves
    the samples of all joints along their velocities. So its variance is the slope of the product of two joints' noise
    over the product of their velocities. Independent noise has no effect on it.
    """
    is_measured: Array = np.isfinite(log.measured)
    resolution = np.array([_resolution(column) for column in log.measured.T])
    is_stale, stale = _stale(log, np.fmax(_noise(log.measured), np.nan_to_num(resolution)))
    fresh = np.where(is_stale[:, None], np.nan, log.measured)
    by_motion, error_by_motion = _jitter(log, fresh, np.nan_to_num(resolution))
    jitter, error = _stamped_jitter(log) or (by_motion, error_by_motion)
    significant = by_motion if by_motion > SIGNIFICANT * error_by_motion else 0.0
    moved = significant**2 * np.mean(log.reference[1] ** 2, axis=0)
    total = _noise(fresh) ** 2
    return EncoderCheck(
        resolution=resolution,
        noise=np.sqrt(np.where(moved < MAX_JITTER_SHARE * total, total - moved, np.nan)),
        missing=np.mean(~is_measured, axis=0),
        longest_gap=longest_run(~np.all(is_measured, axis=1)),
        stale=stale,
        jitter=jitter,
        jitter_error=error,
    )


def _resolution(values: Array) -> float:
    """Return the step of which all differences are whole multiples, by Euclid's algorithm; NaN for none."""
    valid = values[np.isfinite(values)]
    sizes = np.unique(np.abs(np.diff(valid)))
    rounding = 64 * np.finfo(float).eps * float(np.max(np.abs(valid), initial=0.0))
    sizes = sizes[sizes > rounding]
    if len(sizes) < 2:
        return float(sizes[0]) if len(sizes) else np.nan
    step = float(sizes[0])
    for _ in range(20):
        counts = np.round(sizes / step)
        small = counts < 0.2 * MULTIPLE * step / max(rounding, 1e-300)
        few = small & (counts <= 1000)
        if 2 * np.count_nonzero(small) < len(sizes) or not np.any(few):
            return np.nan
        remainders = np.abs(sizes - counts * step)
        odd: Array = remainders[small & (remainders > MULTIPLE * step)]
        if len(odd) <= (1 - FULL_SHARE) * np.count_nonzero(small):
            return float(np.sum(sizes[few]) / np.sum(counts[few]))
        step = float(np.min(odd))
        if step < 10 * rounding:
            return np.nan
    return np.nan


def _differences(values: Array) -> Array:
    """Return differences of an order that motion does not reach, scaled to the size of white noise."""
    return np.diff(values, DIFFERENCE, axis=0) / np.sqrt(comb(2 * DIFFERENCE, DIFFERENCE))


def _noise(measured: Array) -> Array:
    differences = _differences(measured)
    with np.errstate(invalid="ignore"):
        counts = np.sum(np.isfinite(differences), axis=0)
        return np.where(counts > 0, np.sqrt(np.nansum(differences**2, axis=0) / np.maximum(counts, 1)), np.nan)


def _stale(log: LoopLog, size: Array) -> tuple[Array, float]:
    """Return which rows repeat the row before though the robot moves, shape (k,), and their share of all that move."""
    speed = np.zeros(log.position.shape)
    span = 2 * SPEED_SPAN
    speed[SPEED_SPAN:-SPEED_SPAN] = np.abs(log.position[span:] - log.position[:-span]) / span
    moving = (speed > STALE_STEPS * size).any(axis=1)
    repeats = np.zeros(len(log.times), dtype=bool)
    repeats[1:] = np.all(log.measured[1:] == log.measured[:-1], axis=1)
    count = np.count_nonzero(moving)
    share = np.count_nonzero(repeats & moving) / count if count >= 2 * N_PARTS else 0.0
    return repeats & moving, float(share)


def _stamped_jitter(log: LoopLog) -> tuple[float, float] | None:
    """Return deviation and error of the robot's own stamps about an even clock; None without stamps."""
    data = log.run.data
    if "sample_time" not in data:
        return None
    stamps = data["sample_time"].values
    is_stamped = np.isfinite(stamps)
    if np.count_nonzero(is_stamped) < N_PARTS:
        return None
    ticks = np.arange(len(stamps))[is_stamped]
    offsets = stamps[is_stamped] - np.polyval(np.polyfit(ticks, stamps[is_stamped], 1), ticks)
    deviation = float(np.std(offsets))
    return deviation, deviation / np.sqrt(2 * len(ticks))


def _jitter(log: LoopLog, measured: Array, resolution: Array) -> tuple[float, float]:
    """Return deviation and error [s] of the sampling times from the motion that all joints share.

    Rounding is white only where a joint moves by more than a step per period; a slower one is left out.
    """
    noise = _differences(measured)
    velocity = log.reference[1][DIFFERENCE // 2 : DIFFERENCE // 2 + len(noise)]
    noise = np.where(np.abs(velocity) * log.period > resolution, noise, np.nan)
    size = np.sqrt(np.nanmean(noise**2, axis=0)) if np.isfinite(noise).any(axis=0).all() else np.zeros(log.n_joints)
    if log.n_joints < 2 or not np.all(size > 0):
        return 0.0, np.inf
    products = _pair_products(np.clip(noise / size, -6, 6))
    speeds = _pair_products(velocity / size)
    is_valid = np.isfinite(products)
    products, speeds = np.where(is_valid, products, 0.0), np.where(is_valid, speeds, 0.0)
    parts = np.array_split(np.arange(len(noise)), N_PARTS)
    above = np.array([np.sum(products[rows] * speeds[rows]) for rows in parts])
    below = np.array([np.sum(speeds[rows] ** 2) for rows in parts])
    if np.count_nonzero(is_valid) < 10 * N_PARTS or not np.sum(below) > 0:
        return 0.0, np.inf
    variance = float(np.sum(above) / np.sum(below))
    scatter = float(np.sqrt(np.sum((above - variance * below) ** 2)) / np.sum(below))
    deviation = float(np.sqrt(max(variance, 0.0)))
    shows = variance > SIGNIFICANT * scatter
    return deviation, scatter / (2 * deviation) if shows else float(np.sqrt(scatter))


def _pair_products(values: Array) -> Array:
    """Return the product of each pair of columns, shape (k, n (n − 1)/2)."""
    first, second = np.triu_indices(values.shape[1], 1)
    return values[:, first] * values[:, second]
