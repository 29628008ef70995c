"""Sensitivity indices against the Ishigami function and an additive one, in closed form."""

import numpy as np
import pytest

from tarc.core.errors import InvalidParameter
from tarc.study.sensitivity import estimate_sensitivity, sobol_indices

ISHIGAMI_FIRST = (0.3139, 0.4424, 0.0)
ISHIGAMI_TOTAL = (0.5576, 0.4424, 0.2437)
KEYS: tuple[str, ...] = ("a", "b", "c")


def ishigami(points):
    """Ishigami and Homma, 1990, with a = 7 and b = 0.1, at points of the unit cube."""
    x1, x2, x3 = (np.pi * (2 * points - 1)).T
    return np.sin(x1) + 7 * np.sin(x2) ** 2 + 0.1 * x3**4 * np.sin(x1)


def draws(points):
    return dict(zip(KEYS, points.T, strict=True))


def test_ishigami_from_given_runs():
    points = np.random.default_rng(1).random((10_000, 3))
    found = estimate_sensitivity(draws(points), ishigami(points) - 100)  # negative: no logarithm
    assert found is not None
    assert not found.is_log
    for key, truth in zip(KEYS, ISHIGAMI_FIRST, strict=True):
        interval = found.first_order[key]
        assert interval.estimate == pytest.approx(truth, abs=0.02)
        assert interval.low - 0.01 <= truth <= interval.high + 0.01
    assert found.explained < 0.3  # no line describes it
    assert found.order[:2] == ["b", "a"]


def test_ishigami_from_further_runs():
    found = sobol_indices(ishigami, KEYS, 1024, seed=2)
    assert found.n_runs == 1024 * 5
    for key, first, total in zip(KEYS, ISHIGAMI_FIRST, ISHIGAMI_TOTAL, strict=True):
        assert found.first_order[key].estimate == pytest.approx(first, abs=0.03)
        assert found.total[key].estimate == pytest.approx(total, abs=0.03)


def test_additive_function():
    """y = Σ w x has S_i = w_i² / Σ w², and so have the squares of the coefficients of its ranks, nearly."""
    weights = np.array([3.0, -2.0, 1.0, 0.0])
    points = np.random.default_rng(3).random((4000, 4))
    truth = weights**2 / np.sum(weights**2)
    found = estimate_sensitivity(dict(zip("wxyz", points.T, strict=True)), points @ weights - 10)
    assert found is not None
    for place, key in enumerate("wxyz"):
        assert found.first_order[key].estimate == pytest.approx(truth[place], abs=0.02)
        coefficient = found.rank_coefficients[key]
        assert coefficient is not None
        assert coefficient.estimate == pytest.approx(np.sign(weights[place]) * np.sqrt(truth[place]), abs=0.03)
    assert found.explained > 0.95


def test_nothing_matters_in_noise():
    """The correlation ratio of bins is 0.03 without its correction; the corrected one is zero."""
    rng = np.random.default_rng(4)
    found = estimate_sensitivity(draws(rng.random((1000, 3))), rng.lognormal(size=1000))
    assert found is not None
    assert found.is_log
    assert max(found.first_order[key].estimate for key in KEYS) < 0.015
    assert all(found.first_order[key].low == 0 for key in KEYS)


def test_words_and_choices():
    rng = np.random.default_rng(5)
    words, bits = rng.choice(["left", "right"], 400), rng.choice([14, 16, 18], 400)
    found = estimate_sensitivity(
        {"side": words, "bits": bits}, np.where(words == "left", 1.0, 2.0) + 0.1 * rng.random(400)
    )
    assert found is not None
    assert found.first_order["side"].estimate > 0.95
    assert found.rank_coefficients["side"] is None
    of_bits = found.rank_coefficients["bits"]
    assert of_bits is not None
    assert abs(of_bits.estimate) < 0.2


def test_diverged_runs_are_left_out_and_counted():
    points = np.random.default_rng(6).random((500, 3))
    measure = points[:, 0].copy() + 1
    measure[:100] = np.nan
    found = estimate_sensitivity(draws(points), measure)
    assert found is not None
    assert found.n_runs == 400
    assert found.first_order["a"].estimate > 0.95


def test_too_few_runs_have_no_sensitivity():
    points = np.random.default_rng(7).random((20, 3))
    assert estimate_sensitivity(draws(points), points[:, 0]) is None
    assert estimate_sensitivity(draws(np.random.default_rng(7).random((50, 3))), np.ones(50)) is None


@pytest.mark.slow
def test_first_order_intervals_cover():
    """Of y = x1 + x2 / 2 + noise; a normal interval near zero is cut, so that it covers more."""
    rng = np.random.default_rng(8)
    variances = np.array([1 / 12, 1 / 48, 0.01])
    truth = variances[:2] / variances.sum()
    inside = []
    for seed in range(200):
        points = rng.random((400, 2))
        y = points @ [1.0, 0.5] + 0.1 * rng.standard_normal(400) - 10
        found = estimate_sensitivity(dict(zip("ab", points.T, strict=True)), y, seed=seed)
        assert found is not None
        intervals = [found.first_order[key] for key in "ab"]
        inside.append([one.low <= share <= one.high for one, share in zip(intervals, truth, strict=True)])
    assert np.all(np.mean(inside, axis=0) > 0.9)


def test_bad_input_is_refused():
    with pytest.raises(InvalidParameter):
        estimate_sensitivity({}, np.ones(50))
    with pytest.raises(InvalidParameter):
        estimate_sensitivity({"a": np.ones(49)}, np.ones(50))
    with pytest.raises(InvalidParameter):
        sobol_indices(ishigami, KEYS, 1000)
    with pytest.raises(InvalidParameter, match="not finite"):
        sobol_indices(lambda points: np.full(len(points), np.nan), KEYS, 16)
