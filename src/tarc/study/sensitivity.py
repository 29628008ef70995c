"""Which draws matter: sensitivity of a measure with respect to what a study varies."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.study.statistics import CONFIDENCE, Interval

MAX_RUNS = 20_000
"""Runs beyond which the first ones alone are used; they determine an index to a hundredth."""

MIN_RUNS_PER_BIN = 8

RESAMPLES = 200
"""Number of bootstrap samples, of which the standard deviation is needed."""

MAX_BINS = 50


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity of a measure from the runs of a study.

    Attributes
    ----------
    keys
        What was drawn.
    first_order
        Share of the measure's variance that one draw explains alone, by key.
    rank_coefficients
        Standardised rank regression coefficients, by key; positive where a larger draw has a larger measure. None for
        draws that are no numbers.
    explained
        R² of the rank regression: below about 0.7 the coefficients do not describe the measure.
    n_runs
        Number of runs that were used: those that completed.
    is_log
        Whether the logarithm of the measure was used.
    """

    keys: tuple[str, ...]
    first_order: dict[str, Interval]
    rank_coefficients: dict[str, Interval | None]
    explained: float
    n_runs: int
    is_log: bool

    @property
    def order(self) -> list[str]:
        """Keys by their first-order index, the largest first."""
        return sorted(self.keys, key=lambda key: -self.first_order[key].estimate)


@dataclass(frozen=True)
class SobolIndices:
    """Sobol indices from further runs.

    Attributes
    ----------
    keys
        What was drawn.
    first_order
        Share of the variance that one draw explains alone, by key.
    total
        Share that is left when all other draws are known, by key: with all interactions.
    n_runs
        Number of runs.
    """

    keys: tuple[str, ...]
    first_order: dict[str, Interval]
    total: dict[str, Interval]
    n_runs: int


def estimate_sensitivity(
    draws: Mapping[str, Array], measure: Array, *, confidence: float = CONFIDENCE, seed: int = 0
) -> Sensitivity | None:
    """Estimate what a measure depends on from the runs that there are.

    The first-order index is the correlation ratio over bins of equal numbers of runs, without its bias:

        S_i = Var(E[y | x_i]) / Var(y) ≈ 1 − (1 − η²)(n − 1)/(n − B),    η² = Σ_b n_b (ȳ_b − ȳ)² / Σ (y − ȳ)²

    With correlated draws, S_i holds what x_i explains by way of the others too. The coefficients are those of a linear
    regression of the measure's rank on the ranks of the draws, standardised. Intervals are those of a normal
    distribution with the standard deviation of bootstrap samples, cut to the possible values.

    Parameters
    ----------
    draws
        Value of each draw in every run, by key, each of shape (runs,); numbers or words.
    measure
        Measure of every run, shape (runs,); NaN for one that diverged, which is left out. Where all are positive the
        logarithm is used.
    confidence
        Probability with which an interval contains the true index, for many independent runs.
    seed
        Of the bootstrap samples.

    Returns
    -------
    Sensitivity or None
        None where fewer than 32 runs completed, or where the measure is the same in all.

    Raises
    ------
    InvalidParameter
        Without draws, and for arrays of different lengths.

    References
    ----------
    Pearson, 1905; Kelley, PNAS 21, 1935 (bias); Saltelli et al., Global Sensitivity Analysis, 2008, 1.2.
    """
    values = np.asarray(measure, dtype=float)
    if not draws:
        raise InvalidParameter("draws: got none; the sensitivity to nothing is not defined")
    for key, column in draws.items():
        if np.shape(column) != values.shape:
            raise InvalidParameter(f"draws: {key} has shape {np.shape(column)}; the measure has {values.shape}")
    used = np.flatnonzero(np.isfinite(values))[:MAX_RUNS]
    values = values[used]
    if used.size < 4 * MIN_RUNS_PER_BIN or np.ptp(values) == 0:
        return None
    is_log = bool(np.all(values > 0))
    values = np.log(values) if is_log else values
    weights = _weights(used.size, seed)
    columns = {key: np.asarray(column)[used] for key, column in draws.items()}
    first_order = {key: _first_order(_bins(column), values, weights, confidence) for key, column in columns.items()}
    coefficients, explained = _rank_regression(columns, values, weights, confidence)
    return Sensitivity(tuple(draws), first_order, coefficients, explained, int(used.size), is_log)


def _weights(n: int, seed: int) -> Array:
    """Return how often each run is in the data, once, and in each bootstrap sample, shape (1 + samples, n)."""
    drawn = np.random.default_rng(seed).integers(0, n, (RESAMPLES, n)) + n * np.arange(RESAMPLES)[:, None]
    counts = np.bincount(drawn.ravel(), minlength=n * RESAMPLES).reshape(RESAMPLES, n)
    return np.vstack([np.ones(n), counts])


def _bins(column: Array) -> Array:
    """Return the number of each value's bin: one per word or number where few differ, else equal shares of the runs."""
    n_bins = int(np.clip(round(1.5 * column.size ** (1 / 3)), 4, MAX_BINS))
    different, places = np.unique(column, return_inverse=True)
    if column.dtype.kind not in "biuf" or different.size <= n_bins:
        return places.ravel()
    ranks = np.argsort(np.argsort(column, kind="stable"), kind="stable")
    return ranks * n_bins // column.size


def _first_order(bins: Array, values: Array, weights: Array, confidence: float) -> Interval:
    """Return the unbiased correlation ratio; the first row of the weights is the data, the others its resamples."""
    n, n_bins = values.size, int(bins.max()) + 1
    centred = values - values.mean()
    members = np.zeros((n, n_bins))
    members[np.arange(n), bins] = 1.0
    sizes = weights @ members
    sums = weights @ (members * centred[:, None])
    totals, squares = weights @ centred, weights @ centred**2
    with np.errstate(divide="ignore", invalid="ignore"):
        between = np.sum(np.where(sizes > 0, sums**2 / sizes, 0.0), axis=1) - totals**2 / n
        ratios = between / (squares - totals**2 / n)
    unbiased = 1 - (1 - ratios) * (n - 1) / max(n - n_bins, 1)
    return _interval(float(unbiased[0]), unbiased[1:], confidence, 0.0)


def _rank_regression(
    columns: Mapping[str, Array], values: Array, weights: Array, confidence: float
) -> tuple[dict[str, Interval | None], float]:
    """Return the standardised coefficients of the regression of ranks, by key, and its R²."""
    from scipy.stats import rankdata

    numeric = [key for key, column in columns.items() if column.dtype.kind in "biuf" and np.ptp(column) > 0]
    coefficients: dict[str, Interval | None] = dict.fromkeys(columns)
    if not numeric:
        return coefficients, 0.0
    ranks = np.array([rankdata(columns[key]) for key in numeric] + [rankdata(values)]).T
    ranks = (ranks - ranks.mean(axis=0)) / ranks.std(axis=0)
    n, size = ranks.shape
    products = (ranks[:, :, None] * ranks[:, None, :]).reshape(n, size * size)
    means = weights @ ranks / n
    covariances = (weights @ products / n).reshape(-1, size, size) - means[:, :, None] * means[:, None, :]
    deviations = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    correlations = covariances / (deviations[:, :, None] * deviations[:, None, :])
    right = correlations[:, :-1, -1:]
    solved = (np.linalg.pinv(correlations[:, :-1, :-1], hermitian=True) @ right)[:, :, 0]
    for place, key in enumerate(numeric):
        coefficients[key] = _interval(float(solved[0, place]), solved[1:, place], confidence, -1.0)
    return coefficients, float(np.clip(solved[0] @ right[0, :, 0], 0.0, 1.0))


def _interval(estimate: float, resampled: Array, confidence: float, least: float) -> Interval:
    """Return the normal interval about an estimate, cut to the possible values."""
    from scipy.stats import norm

    half = float(norm.ppf((1 + confidence) / 2) * np.std(resampled, ddof=1))
    return Interval(*(float(np.clip(value, least, 1.0)) for value in (estimate, estimate - half, estimate + half)))


def sobol_indices(
    function: Callable[[Array], Array],
    keys: tuple[str, ...],
    n: int = 1024,
    *,
    confidence: float = CONFIDENCE,
    seed: int = 0,
) -> SobolIndices:
    """Compute first-order and total Sobol indices by further runs, n (k + 2) of them for k independent draws.

    Parameters
    ----------
    function
        Output of many runs, shape (runs,), at points of the unit cube, shape (runs, k): each coordinate is the
        probability with which its draw is less. It must be finite; `tarc.study.objective` makes it so for runs that
        diverge.
    keys
        Names of the draws.
    n
        Number of base points, a power of two.
    confidence
        Probability of the bootstrap intervals.
    seed
        Of the points and the bootstrap.

    Raises
    ------
    InvalidParameter
        For an n that is no power of two, and an output that is not finite.

    References
    ----------
    Saltelli et al., Computer Physics Communications 181, 2010; `scipy.stats.sobol_indices`.
    """
    from scipy.stats import sobol_indices as scipy_sobol_indices
    from scipy.stats import uniform

    if check.integer("n", n, 2) & (n - 1):
        raise InvalidParameter(f"n: got {n}; needs a power of two", "n")
    n_runs = 0

    def outputs(points: Array) -> Array:
        nonlocal n_runs
        result = np.asarray(function(points.T), dtype=float)
        n_runs += points.shape[1]
        if not np.all(np.isfinite(result)):
            raise InvalidParameter("function: its output is not finite everywhere; give diverged runs a finite number")
        return result[None, :]

    result = scipy_sobol_indices(func=outputs, n=n, dists=[uniform()] * len(keys), rng=np.random.default_rng(seed))
    intervals = result.bootstrap(confidence_level=confidence)

    first, total = intervals.first_order.confidence_interval, intervals.total_order.confidence_interval

    def by_key(estimates: Array, low: Array, high: Array) -> dict[str, Interval]:
        rows = zip(keys, np.ravel(estimates), np.ravel(low), np.ravel(high), strict=True)
        return {key: Interval(float(value), float(least), float(largest)) for key, value, least, largest in rows}

    return SobolIndices(
        keys,
        by_key(result.first_order, first.low, first.high),
        by_key(result.total_order, total.low, total.high),
        n_runs,
    )
