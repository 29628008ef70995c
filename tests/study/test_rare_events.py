"""Subset simulation against probabilities in closed form."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from tarc.core.errors import InvalidParameter, NotConverged
from tarc.study.rare_events import log_mean_interval, rare_probability


def linear(points, seeds):
    """Sum of the coordinates over √d: a normal number, so that P(g ≥ β) = Φ(−β)."""
    return points.sum(axis=1) / np.sqrt(points.shape[1])


def radius(points, seeds):
    """P(|u|² ≥ r²) is that of χ²: a limit that surrounds the origin, where one direction is not enough."""
    return np.sum(points**2, axis=1)


def with_seed(points, seeds):
    """Add a normal number of the point and another of the seed's noise: P(g ≥ β √2) = Φ(−β)."""
    noise = norm.ppf((seeds % 2**52 + 0.5) / 2**52)
    return points[:, 0] + noise


@pytest.mark.parametrize(
    ("performance", "dimension", "threshold", "truth"),
    [
        (linear, 2, 4.75, norm.sf(4.75)),
        (linear, 10, 3.0, norm.sf(3.0)),
        (radius, 3, chi2.isf(1e-5, 3), 1e-5),
        (with_seed, 1, 3.5 * np.sqrt(2), norm.sf(3.5)),
    ],
)
def test_closed_forms(performance, dimension, threshold, truth):
    found = rare_probability(performance, dimension, threshold, samples=1000, repetitions=10, seed=1)
    assert found.probability.low < truth < found.probability.high
    assert found.probability.estimate == pytest.approx(truth, rel=0.3)
    assert found.n_runs < 80_000  # plain sampling needs 100 / truth for the same: ten thousand times as many
    assert performance(found.worst_point[None], np.array([found.worst_seed]))[0] >= threshold


def test_frequent_event_is_plain_sampling():
    found = rare_probability(linear, 2, 0.5, samples=1000, repetitions=5, seed=2)
    assert all(len(levels) == 1 for levels in found.levels)
    assert found.n_runs == 5000
    assert found.probability.estimate == pytest.approx(norm.sf(0.5), abs=0.02)


def test_theory_agrees_with_repetitions():
    found = rare_probability(linear, 3, 4.0, samples=1000, repetitions=30, seed=3)
    measured = np.std(found.estimates, ddof=1) / np.mean(found.estimates)
    assert found.variation == pytest.approx(measured, rel=0.5)


@pytest.mark.slow
def test_intervals_cover():
    truth = norm.sf(3.7)
    inside = 0
    for seed in range(100):
        found = rare_probability(linear, 2, 3.7, samples=500, repetitions=8, seed=seed)
        inside += found.probability.low <= truth <= found.probability.high
    assert inside >= 90


def test_values_in_steps_are_no_obstacle_and_two_values_are():
    def steps(points, seeds):
        return np.floor(4 * linear(points, seeds)) / 4

    found = rare_probability(steps, 2, 4.0, samples=1000, repetitions=10, seed=4)
    assert found.probability.low < norm.sf(4.0) < found.probability.high
    with pytest.raises(NotConverged, match="performance"):
        rare_probability(lambda points, seeds: (linear(points, seeds) > 4.5) * 1.0, 2, 1.0, repetitions=3)


def test_impossible_event_stops():
    with pytest.raises(NotConverged):
        rare_probability(lambda points, seeds: np.tanh(points[:, 0]), 1, 1.5, repetitions=3, max_levels=8)


def test_same_seed_same_estimate():
    first, second = (rare_probability(linear, 2, 3.0, repetitions=3, seed=5) for _ in range(2))
    assert first.estimates == second.estimates


def test_interval_of_equal_estimates_is_a_point():
    assert log_mean_interval((1e-5, 1e-5, 1e-5)) == pytest.approx((1e-5, 1e-5, 1e-5))
    assert log_mean_interval((0.0, 0.0, 0.0)) == (0.0, 0.0, 1.0)


def test_bad_input_is_refused():
    with pytest.raises(InvalidParameter, match="level_probability"):
        rare_probability(linear, 2, 3.0, samples=1000, level_probability=0.3)
    with pytest.raises(InvalidParameter, match="performance"):
        rare_probability(lambda points, seeds: np.full(len(seeds), np.nan), 2, 3.0)
