"""Draws: distributions against closed forms, the copula's correlation, rows that depend on seed and index alone."""

import math

import numpy as np
import pytest
from scipy import stats

from tarc.core.errors import InvalidParameter
from tarc.study.distributions import Choice, LogUniform, Normal, Uniform, read_distribution
from tarc.study.draws import checked_correlation, draw, run_seeds

UNIFORM = Uniform(low=0.0, high=1.0)
KEYS = ("a", "b", "c")


def three(**options):
    return draw({key: UNIFORM for key in KEYS}, **{"runs": 100, "seed": 3, "sampling": "independent", **options}).values


CLOSED_FORMS = [
    (Uniform(low=-1.0, high=3.0), stats.uniform(-1, 4)),
    (LogUniform(low=1e-6, high=1e-4), stats.loguniform(1e-6, 1e-4)),
    (Normal(mean=2.0, deviation=0.5), stats.norm(2, 0.5)),
    (Normal(mean=0.5, deviation=0.1, low=0.45), stats.truncnorm(-0.5, np.inf, 0.5, 0.1)),
    (Normal(mean=0.0, deviation=1.0, low=5.0, high=6.0), stats.truncnorm(5, 6)),
    (Normal(mean=0.0, deviation=1.0, low=-6.0, high=-5.0), stats.truncnorm(-6, -5)),
]


@pytest.mark.parametrize(("distribution", "reference"), CLOSED_FORMS, ids=lambda x: type(x).__name__)
def test_quantiles_are_those_of_the_closed_form(distribution, reference):
    probability = np.array([1e-9, 0.01, 0.3, 0.5, 0.9, 1 - 1e-9])
    np.testing.assert_allclose(distribution.quantile(probability), reference.ppf(probability), rtol=1e-7)


@pytest.mark.parametrize(("distribution", "reference"), CLOSED_FORMS, ids=lambda x: type(x).__name__)
@pytest.mark.parametrize("sampling", ["independent", "latin_hypercube", "sobol"])
def test_samples_have_the_distribution(distribution, reference, sampling):
    values = draw({"x": distribution}, 2000, 11, sampling).values[:, 0]
    assert stats.kstest(values, reference.cdf).pvalue > 0.01


def test_a_choice_has_the_shares_of_its_weights_and_keeps_whole_numbers():
    choice = Choice(values=[18, 14, 16], weights=[1, 2, 5])
    values = draw({"x": choice}, 8000, 0, "latin_hypercube").values[:, 0]
    shares = [float(np.mean(values == number)) for number in (14, 16, 18)]
    np.testing.assert_allclose(shares, [2 / 8, 5 / 8, 1 / 8], atol=1.5 / 8000)
    assert isinstance(choice.plain(14.0), int)
    assert choice.extremes == (14.0, 18.0)
    never = Choice(values=[1.0, 2.0], weights=[1.0, 0.0])
    assert set(never.quantile(np.array([0.0, 0.5, 1.0]))) == {1.0}


@pytest.mark.parametrize("sampling", ["independent", "sobol"])
def test_more_runs_keep_the_first_rows(sampling):
    few, many = three(sampling=sampling, runs=37), three(sampling=sampling, runs=400)
    np.testing.assert_array_equal(few, many[:37])


def test_a_latin_hypercube_has_one_row_in_each_stratum():
    values = three(sampling="latin_hypercube", runs=50)
    strata = np.sort(np.floor(values * 50), axis=0)
    np.testing.assert_array_equal(strata, np.tile(np.arange(50.0)[:, None], 3))


def test_another_seed_draws_other_rows_and_the_same_seed_the_same():
    assert np.array_equal(three(), three())
    assert not np.any(three() == three(seed=4))


@pytest.mark.parametrize("sampling", ["independent", "latin_hypercube", "sobol"])
def test_the_normal_scores_have_the_correlations(sampling):
    matrix = np.array([[1, 0.6, -0.3], [0.6, 1, 0.2], [-0.3, 0.2, 1]])
    distributions = {
        "a": LogUniform(low=1.0, high=9.0),
        "free": UNIFORM,
        "b": Normal(mean=0.0, deviation=2.0),
        "c": UNIFORM,
    }
    values = draw(distributions, 4096, 5, sampling, (KEYS, matrix)).values
    scores = np.column_stack(
        [stats.norm.ppf(stats.loguniform(1, 9).cdf(values[:, 0])), values[:, 2] / 2, stats.norm.ppf(values[:, 3])]
    )
    np.testing.assert_allclose(np.corrcoef(scores.T), matrix, atol=0.04)
    for column, reference in ((0, stats.loguniform(1, 9)), (1, stats.uniform()), (2, stats.norm(0, 2))):
        assert stats.kstest(values[:, column], reference.cdf).pvalue > 0.01
    # Spearman's rank correlation of a Gaussian copula is 6/π asin(ρ/2)
    rank_correlation = stats.spearmanr(values[:, 0], values[:, 2])[0]
    assert rank_correlation == pytest.approx(6 / math.pi * math.asin(0.3), abs=0.04)


def test_seeds_are_those_of_numpys_spawn_keys():
    seeds = run_seeds(7, np.array([0, 5, 10**7]))
    expected = [np.random.SeedSequence(7, spawn_key=(i,)).generate_state(1, np.uint64)[0] // 2 for i in (0, 5, 10**7)]
    assert seeds.tolist() == [int(seed) for seed in expected]
    assert len(set(run_seeds(7, np.arange(500)).tolist())) == 500
    assert np.all(seeds >= 0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"uniform": [0, math.nan]}, r"draws.x.uniform: high: got nan; needs a finite number"),
        ({"uniform": [2, 1]}, r"draws.x.uniform: low, high: got 2 and 1; low must be below high"),
        ({"uniform": [1]}, r"draws.x.uniform: got \[1\]; needs two numbers, \[low, high\]"),
        ({"uniform": "0, 1"}, r"needs two numbers"),
        ({"log_uniform": [0, 1]}, r"draws.x.log_uniform: low: got 0; needs a finite number above 0"),
        ({"normal": {"mean": 0, "deviation": 0}}, r"draws.x.normal: deviation: got 0"),
        ({"normal": {"mean": 0, "sigma": 1}}, r"draws.x.normal: Normal: unknown parameter 'sigma'"),
        ({"normal": [0, 1]}, r"draws.x.normal: got \[0, 1\]; needs keys and values"),
        ({"normal": {"mean": 0, "deviation": 1, "low": 50, "high": 51}}, r"has no probability; move them"),
        ({"choice": []}, r"draws.x.choice: choice: got \[\]; needs a list of numbers or texts"),
        ({"choice": [1, "two"]}, r"choice: got \[1, 'two'\]; needs numbers alone or texts alone"),
        ({"choice": [1, 1]}, r"some twice; give weights instead"),
        ({"choice": [1, 2], "weights": [1]}, r"weights: got 1 for 2 values"),
        ({"choice": [1, 2], "weights": [0, 0]}, r"at least one must be above 0"),
        ({"choice": [1, 2], "weights": [-1, 2]}, r"weights: got -1"),
        ({"unifrm": [0, 1]}, r"draws.x.unifrm: unknown distribution; known are .*Did you mean 'uniform'"),
        ({"uniform": [0, 1], "choice": [1]}, r"got uniform and choice; give one distribution"),
        ({"uniform": [0, 1], "weights": [1]}, r"draws.x.weights: unknown distribution"),
        (3.0, r"draws.x: got 3.0; needs a distribution, such as"),
    ],
)
def test_a_wrong_distribution_is_refused_with_what_is_allowed(given, message):
    with pytest.raises(InvalidParameter, match=message):
        read_distribution("draws.x", given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"keys": ["a", "b"], "matrix": [[1, 1.1], [1.1, 1]]},
            r"smallest eigenvalue is -0.1; needs a positive definite",
        ),
        ({"keys": ["a", "b"], "matrix": [[1, 1], [1, 1]]}, r"needs a positive definite matrix"),
        ({"keys": ["a", "b"], "matrix": [[1, 0.5], [0.4, 1]]}, r"which is not symmetric"),
        ({"keys": ["a", "b"], "matrix": [[2, 0.5], [0.5, 1]]}, r"its diagonal is \[2.0, 1.0\]; each entry must be 1"),
        ({"keys": ["a", "b"], "matrix": [[1, math.nan], [0.5, 1]]}, r"needs finite numbers, not NaN"),
        ({"keys": ["a", "b"], "matrix": [[1]]}, r"got shape \(1, 1\); needs \(2, 2\)"),
        ({"keys": ["a", "bb"], "matrix": [[1, 0], [0, 1]]}, r"'bb' is not among draws, which has a, b, c"),
        ({"keys": ["a", "a"], "matrix": [[1, 0], [0, 1]]}, r"one twice; name each once"),
        ({"keys": ["a"], "matrix": [[1]]}, r"needs a list of two keys or more"),
        ({"keys": ["a", "b"]}, r"needs keys and matrix"),
    ],
)
def test_a_wrong_correlation_is_refused_with_the_reason(given, message):
    with pytest.raises(InvalidParameter, match=message):
        checked_correlation(given, KEYS)
