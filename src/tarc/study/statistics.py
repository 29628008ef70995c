"""Statistics of many runs: rates, quantiles and paired comparisons of laws, each with its interval.

A run that diverged has no measure. Here its measure counts as infinite: it is worse than every run that completed. So a
law cannot gain by leaving out the draws on which it fails.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array

CONFIDENCE = 0.95
"""Probability with which an interval contains the true value."""

RESAMPLES = 2000
"""Number of bootstrap samples of a mean."""


class Interval(NamedTuple):
    """An estimate with the ends of its confidence interval; an end is infinite where the runs do not bound it."""

    estimate: float
    low: float
    high: float

    def excludes(self, value: float) -> bool:
        """Return whether a value is outside the interval."""
        return not self.low <= value <= self.high


@dataclass(frozen=True)
class PairedComparison:
    """A measure of one law against that of another on the same draws.

    Attributes
    ----------
    law, reference
        Their names.
    ratio
        Median over the draws of the law's measure over that of the reference; below one the law's is less.
    wins, losses, ties
        Number of draws on which the law's measure is less, more, and the same. A draw on which both diverged is a tie.
    only_law_diverged, only_reference_diverged, both_diverged
        Number of draws.
    p_value
        Of Wilcoxon's signed-rank test that the log ratio is symmetric about zero.
    adjusted_p_value
        The same after Holm's correction for the number of comparisons.
    confidence
        Confidence of the interval: that of all comparisons at once, by Bonferroni's correction.
    """

    law: str
    reference: str
    ratio: Interval
    wins: int
    losses: int
    ties: int
    only_law_diverged: int
    only_reference_diverged: int
    both_diverged: int
    p_value: float
    adjusted_p_value: float
    confidence: float

    @property
    def verdict(self) -> str:
        """Return ``less`` or ``more`` where the interval of the ratio excludes one, else ``open``."""
        if not self.ratio.excludes(1.0):
            return "open"
        return "less" if self.ratio.high < 1 else "more"


def success_rate(succeeded: Sequence[bool] | Array, confidence: float = CONFIDENCE) -> Interval:
    """Return the share of runs that succeeded, with the interval of Clopper and Pearson.

    The interval contains the true probability with at least the stated confidence, for any probability and number of
    independent runs.

    Parameters
    ----------
    succeeded
        Whether each run succeeded, shape (runs,).
    confidence
        Probability with which the interval contains the true one.

    Raises
    ------
    InvalidParameter
        Without runs, and for a confidence outside (0, 1).

    References
    ----------
    Clopper, Pearson, Biometrika 26, 1934.
    """
    from scipy.stats import binomtest

    runs = np.asarray(succeeded, dtype=bool)
    _check(runs, confidence)
    count = int(runs.sum())
    interval = binomtest(count, runs.size).proportion_ci(confidence, "exact")
    return Interval(count / runs.size, float(interval.low), float(interval.high))


def quantile_interval(
    values: Sequence[float] | Array, probability: float, confidence: float = CONFIDENCE, *, method: str = "exact"
) -> Interval:
    """Return a quantile with its interval, for a measure whose missing values count as infinite.

    The quantile is the smallest value x_(k) with k ≥ p n. The number of values below the true quantile is binomial,
    whatever the distribution. So the exact interval is between two values of the data,

        x_(l) to x_(u),    P(B(n, p) < l) ≤ (1 − c)/2,    P(B(n, p) ≥ u) ≤ (1 − c)/2,

    and contains the true quantile with at least the stated confidence. An end is infinite where there are too few runs
    for it. The bootstrap interval is narrower at the upper end: for the 99 % quantile of 1000 runs the truth exceeds it
    in 7 % of all studies, and not in 2.5 %. Its percentiles, those of infinitely many samples, are values of the data
    too, so that no sample is drawn:

        P(X*_(k) ≤ x_(j)) = P(B(n, j/n) ≥ k) = I_{j/n}(k, n − k + 1)

    Parameters
    ----------
    values
        Measure of each run, shape (runs,); NaN for a run that diverged.
    probability
        p, in (0, 1).
    confidence
        c, the probability with which the interval contains the true quantile, for independent runs.
    method
        ``exact`` or ``bootstrap``.

    Raises
    ------
    InvalidParameter
        Without values, for a probability or confidence outside (0, 1), and an unknown method.

    References
    ----------
    Conover, Practical Nonparametric Statistics, 1999, 3.2; `scipy.stats.quantile_test`. Maritz, Jarrett, Journal of the
    American Statistical Association 73, 1978 (bootstrap).
    """
    ordered = np.sort(_with_infinity(values))
    _check(ordered, confidence)
    _between_zero_and_one("probability", probability)
    find = _EXACT_OR_BOOTSTRAP[check.one_of("method", method, _EXACT_OR_BOOTSTRAP)]
    k = max(int(np.ceil(probability * ordered.size * (1 - 1e-12))), 1)
    return Interval(float(ordered[k - 1]), *find(ordered, k, probability, confidence))


def _exact_ends(ordered: Array, k: int, probability: float, confidence: float) -> tuple[float, float]:
    """Return the ends of the exact interval of a quantile of ordered values."""
    low, high = _exact_places(ordered.size, probability, confidence)
    return (
        -np.inf if np.isnan(low) else float(ordered[int(low) - 1]),
        np.inf if np.isnan(high) else float(ordered[int(high) - 1]),
    )


@lru_cache
def _exact_places(n: int, probability: float, confidence: float) -> tuple[float, float]:
    """Return the places l and u of the exact interval among n values; NaN where there is none."""
    from scipy.stats import quantile_test

    ends = quantile_test(np.arange(1.0, n + 1), p=probability).confidence_interval(confidence)
    return float(ends.low), float(ends.high)


def _bootstrap_ends(ordered: Array, k: int, probability: float, confidence: float) -> tuple[float, float]:
    """Return the percentiles of infinitely many bootstrap samples of the k-th of ordered values."""
    from scipy.special import betaincinv

    n, tail = ordered.size, (1 - confidence) / 2
    shares = betaincinv(k, n - k + 1, [tail, 1 - tail])
    low, high = np.clip(np.ceil(n * shares * (1 - 1e-12)).astype(int), 1, n) - 1
    return float(ordered[low]), float(ordered[high])


_EXACT_OR_BOOTSTRAP = {"exact": _exact_ends, "bootstrap": _bootstrap_ends}


def median_interval(values: Sequence[float] | Array, confidence: float = CONFIDENCE) -> Interval:
    """Return the median with its exact interval; the interval of the negated values is the negated interval.

    For an even number of values the median is the mean of the two in the middle. The interval joins those of both.

    Parameters
    ----------
    values
        Numbers, shape (runs,); infinities are allowed, NaN is not.
    confidence
        Probability with which the interval contains the true median, for independent runs.

    Raises
    ------
    InvalidParameter
        Without values, for NaN, and for a confidence outside (0, 1).
    """
    numbers = np.asarray(values, dtype=float)
    if np.any(np.isnan(numbers)):
        raise InvalidParameter("values: got NaN; give an infinite value to a run that diverged")
    below = quantile_interval(numbers, 0.5, confidence)
    above = quantile_interval(-numbers, 0.5, confidence)
    middle = below.estimate, -above.estimate
    estimate = middle[0] if middle[0] == middle[1] else sum(middle) / 2
    return Interval(0.0 if np.isnan(estimate) else estimate, below.low, -above.low)


def mean_interval(
    values: Sequence[float] | Array, confidence: float = CONFIDENCE, *, resamples: int = RESAMPLES, seed: int = 0
) -> Interval:
    """Return the mean with its bias-corrected and accelerated (BCa) bootstrap interval.

    Parameters
    ----------
    values
        Finite numbers, shape (runs,), at least two.
    confidence
        Probability with which the interval contains the true mean, for many independent runs.
    resamples
        Number of bootstrap samples.
    seed
        Of the bootstrap samples.

    Raises
    ------
    InvalidParameter
        For fewer than two values, numbers that are not finite, and a confidence outside (0, 1).

    References
    ----------
    Efron, Journal of the American Statistical Association 82, 1987.
    """
    from scipy.stats import bootstrap

    numbers = check.array("values", values)
    _check(numbers, confidence)
    if numbers.size < 2:
        raise InvalidParameter("values: got one; a bootstrap needs two or more")
    mean = float(np.mean(numbers))
    if np.ptp(numbers) == 0:
        return Interval(mean, mean, mean)
    batch = max(1, 2_000_000 // numbers.size)
    result = bootstrap(
        (numbers,),
        np.mean,
        confidence_level=confidence,
        n_resamples=resamples,
        batch=batch,
        method="BCa",
        rng=np.random.default_rng(seed),
    )
    return Interval(mean, float(result.confidence_interval.low), float(result.confidence_interval.high))


def log_ratios(values: Array, others: Array) -> Array:
    """Return the log ratio of two measures on each draw, shape (runs,).

    It is +∞ where the first law alone diverged, −∞ where the other alone did, and 0 where both did or both are equal.
    """
    first, second = _with_infinity(values), _with_infinity(others)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.log(first) - np.log(second)
    return np.where(first == second, 0.0, ratios)


def compare_laws(
    values: Array, names: Sequence[str], reference: str | None = None, confidence: float = CONFIDENCE
) -> list[PairedComparison]:
    """Compare a measure of every law with that of a reference on the same draws.

    Each draw gives one log ratio. A law that diverges where the reference does not loses that draw by an infinite
    ratio; where both diverge the draw is a tie. Medians, signs and ranks of such ratios exist, so that nothing is left
    out.
    With m comparisons each interval has the confidence 1 − (1 − c)/m: all of them hold at once with confidence c.

    Parameters
    ----------
    values
        Measure without sign, shape (runs, laws); NaN for a run that diverged.
    names
        Names of the laws.
    reference
        Name of the law to compare with; the first without a name.
    confidence
        Probability c with which all intervals hold at once, for independent runs.

    Returns
    -------
    list
        One comparison for each law but the reference.

    Raises
    ------
    InvalidParameter
        For an unknown reference, arrays of another shape, a negative measure, and a confidence outside (0, 1).
    """
    table = np.asarray(values, dtype=float)
    names = list(names)
    if table.ndim != 2 or table.shape[1] != len(names):
        raise InvalidParameter(f"values: got shape {table.shape}; needs (runs, {len(names)}), one column per law")
    _check(table, confidence)
    if np.any(table < 0):
        raise InvalidParameter("values: got a negative one; ratios need measures of at least 0")
    chosen = names.index(check.one_of("reference", names[0] if reference is None else reference, names))
    others = [column for column in range(len(names)) if column != chosen]
    ratios = [log_ratios(table[:, column], table[:, chosen]) for column in others]
    p_values = [wilcoxon_p_value(ratio) for ratio in ratios]
    single = 1 - (1 - confidence) / max(len(others), 1)
    has_failed = ~np.isfinite(table)
    result = []
    for column, ratio, p_value, adjusted in zip(others, ratios, p_values, holm(p_values), strict=True):
        own, its = has_failed[:, column], has_failed[:, chosen]
        result.append(
            PairedComparison(
                names[column],
                names[chosen],
                Interval(*(float(np.exp(end)) for end in median_interval(ratio, single))),
                wins=int(np.sum(ratio < 0)),
                losses=int(np.sum(ratio > 0)),
                ties=int(np.sum(ratio == 0)),
                only_law_diverged=int(np.sum(own & ~its)),
                only_reference_diverged=int(np.sum(its & ~own)),
                both_diverged=int(np.sum(own & its)),
                p_value=p_value,
                adjusted_p_value=float(adjusted),
                confidence=single,
            )
        )
    return result


def wilcoxon_p_value(differences: Array) -> float:
    """Return the p-value of Wilcoxon's signed-rank test; infinite differences have the highest rank.

    It is one where no difference is left. Zeros count half for each sign (zsplit), so that ties weaken the evidence.
    """
    from scipy.stats import wilcoxon

    finite = np.isfinite(differences)
    if not np.any(differences != 0):
        return 1.0
    highest = 2 * float(np.max(np.abs(differences[finite]), initial=1.0))
    ranked = np.where(finite, differences, np.sign(differences) * highest)
    result: Any = wilcoxon(ranked, zero_method="zsplit", method="approx")
    return float(result.pvalue)


def holm(p_values: Sequence[float] | Array) -> Array:
    """Return p-values adjusted by Holm's step-down correction, in the order given.

        p̃_(i) = max over j ≤ i of min(1, (m − j + 1) p_(j))

    A test whose adjusted value is below α is significant at the level α for all m tests together, whatever their
    dependence.

    References
    ----------
    Holm, Scandinavian Journal of Statistics 6, 1979.
    """
    values = np.asarray(p_values, dtype=float)
    order = np.argsort(values, kind="stable")
    steps = (values.size - np.arange(values.size)) * values[order]
    adjusted = np.empty(values.size)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0) if values.size else steps
    return adjusted


def _with_infinity(values: Sequence[float] | Array) -> Array:
    """Return the values with infinity where a run has none."""
    numbers = np.asarray(values, dtype=float)
    return np.where(np.isnan(numbers), np.inf, numbers)


def _check(values: Array, confidence: float) -> None:
    if values.size == 0:
        raise InvalidParameter("values: got none; needs one run or more")
    _between_zero_and_one("confidence", confidence)


def _between_zero_and_one(name: str, value: float) -> None:
    if not 0 < value < 1:
        raise InvalidParameter(f"{name}: got {value:g}; needs a number between 0 and 1", name)
