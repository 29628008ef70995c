"""Rates, quantiles and paired comparisons against SciPy, closed forms and simulated coverage."""

import numpy as np
import pytest
from scipy import stats

from tarc.core.errors import InvalidParameter
from tarc.study.statistics import (
    compare_laws,
    holm,
    log_ratios,
    mean_interval,
    median_interval,
    quantile_interval,
    success_rate,
    wilcoxon_p_value,
)

N_SIMULATED = 500


def coverage(intervals, truth):
    return np.mean([interval.low <= truth <= interval.high for interval in intervals])


def test_success_rate_is_the_beta_quantile():
    """Clopper and Pearson's ends are quantiles of beta distributions."""
    interval = success_rate([True] * 97 + [False] * 3)
    assert interval.estimate == 0.97
    assert interval.low == pytest.approx(stats.beta.ppf(0.025, 97, 4))
    assert interval.high == pytest.approx(stats.beta.ppf(0.975, 98, 3))
    assert success_rate([True] * 300).low == pytest.approx(0.025 ** (1 / 300))
    assert success_rate([True] * 300).high == 1.0


def test_success_rate_of_every_probability_is_covered():
    """Exactly, by summing the binomial probabilities of the counts whose interval contains the truth."""
    n = 40
    intervals = [success_rate(np.arange(n) < count) for count in range(n + 1)]
    for truth in np.linspace(0.01, 0.99, 50):
        inside = [interval.low <= truth <= interval.high for interval in intervals]
        assert stats.binom.pmf(np.arange(n + 1), n, truth)[inside].sum() >= 0.95


@pytest.mark.parametrize("probability", [0.1, 0.5, 0.9])
def test_bootstrap_interval_is_the_limit_of_many_samples(probability):
    rng = np.random.default_rng(3)
    values = rng.lognormal(size=81)
    k = int(np.ceil(probability * 81)) - 1
    resampled = np.sort(rng.choice(values, (20_000, 81)), axis=1)[:, k]
    ordered = np.sort(values)
    low, high = np.quantile(resampled, [0.025, 0.975], method="inverted_cdf")
    interval = quantile_interval(values, probability, method="bootstrap")
    assert interval.estimate == ordered[k]
    for end, by_samples in ((interval.low, low), (interval.high, high)):
        places = np.searchsorted(ordered, [end, by_samples])
        assert abs(places[0] - places[1]) <= 1  # of 81, since 20,000 samples do not determine the last one


def test_exact_interval_of_a_quantile_by_the_binomial_distribution():
    """The least and the largest place whose tail is at most 2.5 %, found by trying all."""
    n = 150
    values = np.arange(1.0, n + 1)
    for probability in (0.05, 0.5, 0.9):
        low = max(place for place in range(1, n + 1) if stats.binom.cdf(place - 1, n, probability) <= 0.025)
        high = min(place for place in range(1, n + 1) if stats.binom.sf(place - 1, n, probability) <= 0.025)
        assert quantile_interval(values, probability)[1:] == (low, high)


@pytest.mark.parametrize(("probability", "n"), [(0.5, 40), (0.95, 200), (0.99, 1000), (0.99, 200)])
def test_exact_interval_covers_and_the_bootstrap_misses_above(probability, n):
    rows = np.random.default_rng(7).normal(size=(500, n))
    truth = stats.norm.ppf(probability)
    exact = [quantile_interval(row, probability) for row in rows]
    assert coverage(exact, truth) >= 0.94
    assert np.mean([interval.high < truth for interval in exact]) < 0.04
    if (probability, n) == (0.99, 1000):
        missed = [quantile_interval(row, probability, method="bootstrap").high < truth for row in rows]
        assert np.mean(missed) > 0.045


def test_median_interval_covers_and_is_antisymmetric():
    rng = np.random.default_rng(8)
    rows = rng.exponential(size=(N_SIMULATED, 30))
    assert coverage([median_interval(row) for row in rows], np.log(2)) >= 0.93
    first, second = median_interval(rows[0]), median_interval(-rows[0])
    assert first == (-second.estimate, -second.high, -second.low)
    assert first.estimate == np.median(rows[0])


@pytest.mark.slow
def test_mean_interval_covers():
    rng = np.random.default_rng(9)
    intervals = [mean_interval(row, resamples=500, seed=1) for row in rng.lognormal(sigma=0.5, size=(400, 50))]
    assert coverage(intervals, np.exp(0.125)) >= 0.92


def test_few_runs_leave_an_end_open():
    interval = quantile_interval(np.arange(50.0), 0.99)
    assert interval.high == np.inf
    assert np.isfinite(interval.low)
    assert quantile_interval(np.arange(50.0), 0.01).low == -np.inf
    assert np.isfinite(quantile_interval(np.arange(400.0), 0.99).high)  # 0.99^400 is less than 0.025


def test_diverged_runs_are_the_worst():
    values = np.append(np.arange(90.0), np.full(10, np.nan))
    assert quantile_interval(values, 0.95).estimate == np.inf
    assert quantile_interval(values, 0.5).estimate == 49.0
    assert log_ratios(np.array([1.0, np.nan, 2.0, np.nan]), np.array([2.0, 1.0, np.nan, np.nan])).tolist() == [
        -np.log(2.0),
        np.inf,
        -np.inf,
        0.0,
    ]


def test_law_cannot_win_by_diverging():
    """On two thirds of the draws it has half of the error, and diverges on the others: the median knows."""
    rng = np.random.default_rng(10)
    reference = rng.lognormal(size=300)
    law = 0.5 * reference
    law[rng.random(300) < 0.6] = np.nan
    (comparison,) = compare_laws(np.column_stack([reference, law]), ["TDC", "TARC"])
    assert comparison.verdict == "more"
    assert comparison.ratio.estimate == np.inf
    assert comparison.only_law_diverged == comparison.losses == int(np.isnan(law).sum())
    assert comparison.adjusted_p_value < 1e-3


def test_comparison_finds_a_small_difference_on_the_same_draws():
    """Of two per cent, between runs that differ by a factor of ten."""
    rng = np.random.default_rng(11)
    reference = rng.lognormal(sigma=2.0, size=200)
    law = 0.98 * reference * rng.lognormal(sigma=0.05, size=200)
    values = np.column_stack([law, reference])
    comparison, opposite = compare_laws(values, ["a", "b"], "b")[0], compare_laws(values, ["a", "b"], "a")[0]
    assert comparison.verdict == "less"
    assert comparison.ratio.low < 0.98 < comparison.ratio.high
    assert comparison.wins + comparison.losses == 200
    assert opposite.ratio == pytest.approx(
        (1 / comparison.ratio.estimate, 1 / comparison.ratio.high, 1 / comparison.ratio.low)
    )
    assert opposite.p_value == pytest.approx(comparison.p_value)


def test_same_law_twice_is_not_decided():
    values = np.random.default_rng(12).lognormal(size=(50, 1)).repeat(2, axis=1)
    (comparison,) = compare_laws(values, ["a", "b"])
    assert comparison.verdict == "open"
    assert comparison.ratio == (1.0, 1.0, 1.0)
    assert comparison.p_value == 1.0
    assert comparison.ties == 50


def test_all_intervals_hold_at_once():
    """Of twelve laws that are the same up to noise, in 95 % of the studies none is found to differ."""
    rng = np.random.default_rng(13)
    false_alarms = 0
    for _ in range(40):
        values = rng.lognormal(size=(60, 1)) * rng.lognormal(sigma=0.1, size=(60, 12))
        found = compare_laws(values, [str(k) for k in range(12)])
        false_alarms += any(one.verdict != "open" for one in found)
    assert false_alarms <= 5  # of 40 studies at 5 %: more than 5 in 1 of 70 tests


def test_holm_by_hand():
    """The example of four values: 0.005, 0.01, 0.03, 0.04 have 0.02, 0.03, 0.06, 0.06."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == pytest.approx([1.0, 1.0])
    assert holm([]).size == 0


def test_wilcoxon_agrees_with_scipy():
    differences = np.random.default_rng(14).normal(0.3, 1.0, 80)
    exact = stats.wilcoxon(differences).pvalue  # type: ignore[attr-defined] - a tuple to the stub
    assert wilcoxon_p_value(differences) == pytest.approx(exact, rel=0.02)
    with_infinite = np.append(differences, [np.inf, np.inf, -np.inf])
    ranked = np.append(differences, [99.0, 99.0, -99.0])
    assert wilcoxon_p_value(with_infinite) == wilcoxon_p_value(ranked)


@pytest.mark.parametrize(
    "call",
    [
        lambda: success_rate([]),
        lambda: success_rate([True], confidence=1.0),
        lambda: quantile_interval([1.0], 1.5),
        lambda: quantile_interval([], 0.5),
        lambda: quantile_interval([1.0], 0.5, method="jackknife"),
        lambda: median_interval([1.0, np.nan]),
        lambda: mean_interval([1.0]),
        lambda: mean_interval([1.0, np.inf]),
        lambda: compare_laws(np.ones((4, 2)), ["a"]),
        lambda: compare_laws(np.ones((4, 2)), ["a", "b"], "c"),
        lambda: compare_laws(-np.ones((4, 2)), ["a", "b"]),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(InvalidParameter):
        call()
