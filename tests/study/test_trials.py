"""Trials of gains give what a run gives, and end early only where a run would have lost."""

import numpy as np
import pytest

import tarc
from tarc.certificates import certify_varying_ratio
from tarc.core.errors import NotConverged, UnsupportedLaw
from tarc.study import SearchSpace, TuningOptions, default_search_spaces, tune, tune_all, tune_front
from tarc.study.law_scores import FAILURE_SCORE, objective
from tarc.study.robust_margin import RobustMargin
from tarc.study.trial_runs import TrialScenario, shared_loop
from tarc.study.trials import DIVERGED, NOT_CERTIFIED, REFUSED, UNSTABLE, Trials

SPACE = SearchSpace(
    {"kind": "TDC", "estimator": {"kind": "Algebraic", "window": 0.010, "degree": 2}},
    {"inertia.fraction": (0.01, 1.5), "natural_frequency": (3.0, 60.0), "estimator.window": (0.002, 0.030)},
)
LIMIT = 1000.0


def scenario(**settings):
    """Return a second of the two-link arm."""
    return tarc.Scenario.load("train_two_link", ["duration=1.0", "metrics_start=0.3"]).model_copy(update=settings)


def random_gains(count, seed=0):
    """Draw gains over the ranges."""
    rng = np.random.default_rng(seed)
    return [
        {key: float(low * (high / low) ** rng.random()) for key, (low, high) in SPACE.free.items()}
        for _ in range(count)
    ]


def test_a_trial_is_a_run():
    trial = TrialScenario(scenario(substeps=2))
    part = SPACE.law({"inertia.fraction": 0.06, "natural_frequency": 20.0, "estimator.window": 0.01}, 1e-3)
    law = trial.build_law(part)
    assert law is not None
    (run,) = scenario(substeps=2, law=part).run(progress=False).values()
    measures = run.metrics(start_time=0.3)
    found = trial.run(law)
    assert found.rms_error == pytest.approx(measures["rms_error"], rel=1e-12)
    assert found.torque_variation == pytest.approx(measures["torque_variation"], rel=1e-12)


@pytest.mark.slow
def test_early_ends_do_not_change_the_best():
    """Of random gains the best of the trials is that of runs to the end, and only those that lose end early."""
    one = scenario()
    tried = Trials([one])
    parts = [SPACE.law(gains, 1e-3) for gains in random_gains(14)]
    outcomes = tried.evaluate(parts, run_unstable=False)
    truth = np.array([objective(one, part, LIMIT) for part in parts])
    scores = np.array([outcome.score([LIMIT]) if not outcome.failure else np.inf for outcome in outcomes])
    assert np.argmin(scores) == np.argmin(truth)
    completed = np.isfinite(scores)
    assert 3 <= completed.sum() <= 11
    assert np.all(truth[~completed] > truth[completed].min())
    np.testing.assert_allclose(scores[completed], truth[completed], atol=0.02)
    failures = {outcome.failure for outcome in outcomes}
    assert UNSTABLE in failures


def test_a_trial_ends_with_its_first_failure():
    one = scenario()
    tried = Trials([one, one])
    lost = SPACE.law({"inertia.fraction": 1.4, "natural_frequency": 50.0, "estimator.window": 0.03}, 1e-3)
    refused = SPACE.law({"inertia.fraction": 0.1, "natural_frequency": -1.0, "estimator.window": 0.01}, 1e-3)
    (early,) = tried.evaluate([lost], run_unstable=False)
    (run,) = tried.evaluate([lost], run_unstable=True)
    (none,) = tried.evaluate([refused], run_unstable=True)
    assert (early.failure, run.failure, none.failure) == (UNSTABLE, DIVERGED, REFUSED)
    assert 0 < run.survived < 1  # the second was not run
    assert min(early.growth_rates) > 0


@pytest.mark.slow
def test_the_growth_rate_is_that_of_the_warning():
    for gains in random_gains(6, seed=1):
        part = SPACE.law(gains, 1e-3)
        one = scenario(law=part, duration=0.4)
        trial = TrialScenario(one)
        law = trial.build_law(part)
        assert law is not None
        loop = shared_loop(law)
        assert loop is not None
        rate = trial.growth_rate(law, [channel.with_delay(1) for channel in loop])
        assert rate == trial.growth_rate(law)
        (run,) = one.run(progress=False).values()
        assert bool(rate) == bool(run.instability)


def test_the_margin_is_that_of_the_certificate():
    one = scenario()
    setup = one.build()
    workspace, plants = one.certified_region(setup)
    margin = RobustMargin(plants, workspace, one.computation_delay)
    for fraction in (0.02, 0.05):
        part = SPACE.law({"inertia.fraction": fraction, "natural_frequency": 10.0, "estimator.window": 0.008}, 1e-3)
        law = one.build_law(part, setup)
        assert isinstance(law, tarc.laws.TDC)
        spread = tarc.analysis.inertia_spread(plants, law.M, workspace, samples=500, refine=4)
        ends = spread.min_ratio, spread.max_ratio
        certificate = certify_varying_ratio(law, ratio_range=ends, computation_delay=1, affine=False)
        assert margin.ratio_range(law) == pytest.approx(ends, rel=1e-6)
        assert margin.of(law) == pytest.approx(certificate.margin, abs=2e-3)


@pytest.mark.slow
def test_only_certified_gains_are_chosen():
    """The same search without the margin chooses gains that have less."""
    one = scenario()
    free, _ = tune(SPACE, [one], [LIMIT], TuningOptions(trials=16, progress=False))
    more = Trials([one]).margin_of(free) + 0.5
    bound, score = tune(SPACE, [one], [LIMIT], TuningOptions(trials=16, margin=more, progress=False))
    tried = Trials([one], more)
    assert tried.margin_of(bound) >= more
    assert score < FAILURE_SCORE - 10
    (outcome,) = tried.evaluate([free], run_unstable=False)
    assert outcome.failure == NOT_CERTIFIED
    assert not outcome.rms_errors


def test_a_law_without_the_certificate_is_said_to_have_none():
    with pytest.raises(UnsupportedLaw, match="margin"):
        tune(default_search_spaces()["asmc-tde"], [scenario()], [LIMIT], TuningOptions(trials=2, margin=0.0))
    with pytest.raises(NotConverged, match="largest is"):
        tune(SPACE, [scenario()], [LIMIT], TuningOptions(trials=3, margin=50.0))


def test_a_front_is_of_stable_gains_that_no_others_beat():
    front = tune_front(SPACE, [scenario()], [LIMIT], TuningOptions(trials=24, progress=False))
    errors = np.array([point.rms_error for point in front.points])
    variations = np.array([point.torque_variation for point in front.points])
    assert np.all(np.diff(errors) > 0)
    assert np.all(np.diff(variations) < 0)
    assert front.trials == 24
    assert front.failures[UNSTABLE] > 0
    assert all(point.least_error is None or point.least_error <= point.rms_error for point in front.points)


@pytest.mark.slow
def test_every_law_has_the_same_number_of_warm_starts(tmp_path):
    """A plain law starts at the scenario's law, one that extends it at its best."""
    from tarc.study.search_storage import open_storage

    one = scenario()
    found = tune_all(
        ["tdc", "tarc"], [one], [LIMIT], TuningOptions(trials=18, storage=tmp_path / "s", jobs=1, progress=False)
    )
    import optuna

    storage = open_storage(tmp_path / "s")
    kept = 15.0
    for name in ("tdc", "tarc"):
        study = optuna.load_study(study_name=name, storage=storage)
        frequencies = [trial.params["natural_frequency"] for trial in study.get_trials()]
        assert frequencies[:3] == [kept] * 3
        assert frequencies.count(kept) == 3
        kept = float(f"{study.best_params['natural_frequency']:.4g}")
    again = tune_all(
        ["tdc", "tarc"], [one], [LIMIT], TuningOptions(trials=18, storage=tmp_path / "s", jobs=1, progress=False)
    )
    assert again == found
