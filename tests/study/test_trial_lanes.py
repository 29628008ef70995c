"""Trials side by side in machine code give what they give one by one, for every window."""

import numpy as np
import pytest

import tarc
from tarc.estimators import Algebraic
from tarc.laws.pole_placement import PolePlacement
from tarc.study import SearchSpace, default_search_spaces
from tarc.study.trial_lanes import PaddedWindow, longest_window, pad_window
from tarc.study.trial_runs import TrialScenario, shared_loop
from tarc.study.trial_slopes import SharedSlopes
from tarc.study.trials import Trials

SHORT = ["duration=1.0", "metrics_start=0.3"]


def trials_of(name, law, settings=()):
    """Return what tries a law in a scenario, and laws over its ranges with the shortest and longest windows."""
    space = default_search_spaces()[law]
    scenario = tarc.Scenario.load(name, [*SHORT, *settings])
    examples = [space.law(values, scenario.period) for values in space.examples()]
    return TrialScenario(scenario, examples), space, scenario


def laws_within(space, trial, count, seed=0):
    """Draw laws that hold a robot, and one that does not."""
    rng = np.random.default_rng(seed)
    known = {"inertia.fraction": 0.06, "natural_frequency": 20.0, "estimator.window": 0.008}
    middle = {**space.middle, **{key: value for key, value in known.items() if key in space.free}}
    drawn = [{key: value * 2 ** rng.uniform(-1, 1) for key, value in middle.items()} for _ in range(count)]
    drawn[-1]["inertia.fraction"] = 1.5
    laws = [trial.build_law(space.law(values, 1e-3)) for values in drawn]
    return [law for law in laws if law is not None]


def test_a_padded_window_estimates_the_same():
    short = Algebraic(window=0.006, degree=2).with_period(1e-3)
    padded = PaddedWindow.from_estimator(short, 31)
    rng = np.random.default_rng(0)
    states = short.init(np.zeros(2)), padded.init(np.zeros(2))
    for _ in range(60):
        sample = rng.normal(size=2) if rng.random() > 0.1 else np.array([np.nan, 1.0])
        steps = [one.step(state, sample) for one, state in zip((short, padded), states, strict=True)]
        states = steps[0][0], steps[1][0]
        for ours, theirs in zip(steps[0][1], steps[1][1], strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("train_masses", "tdc"),
        pytest.param("train_masses", "tdc-sync", marks=pytest.mark.slow),
        pytest.param("train_two_link", "tarc", marks=pytest.mark.slow),
        pytest.param("train_two_link", "tdc-kalman", marks=pytest.mark.slow),
        pytest.param("train_two_link", "adrc", marks=pytest.mark.slow),
        pytest.param("train_two_link", "barrier", marks=pytest.mark.slow),
        pytest.param("train_ur5e", "tdc-model", marks=pytest.mark.slow),
    ],
)
def test_side_by_side_is_one_by_one(name, law):
    trial, space, _ = trials_of(name, law)
    assert trial._lanes is not None
    laws = laws_within(space, trial, 11)
    assert len(trial._lanes.run(laws)[0]) == len(laws)  # all windows by one function
    for ours, theirs in zip(trial.run_all(laws), map(trial.run, laws), strict=True):
        assert ours.completed == theirs.completed
        assert ours.survived == pytest.approx(theirs.survived, abs=2e-3)
        if ours.completed:
            assert ours.rms_error == pytest.approx(theirs.rms_error, rel=1e-6)
            assert ours.torque_variation == pytest.approx(theirs.torque_variation, rel=1e-6)


def test_companions_do_not_matter():
    """The same bits in any company: a search that goes on in other batches finds the same."""
    trial, space, _ = trials_of("train_masses", "tdc")
    laws = laws_within(space, trial, 8)
    together = trial.run_all(laws)
    assert [trial.run_all([law])[0] for law in laws[:-1]] == together[:-1]
    assert trial.run_all(laws[:-1][::-1])[::-1] == together[:-1]


@pytest.mark.parametrize(("law", "settings"), [("fuzzy", []), ("tdc", ["native=false"])])
def test_what_has_no_common_machine_code_runs_one_by_one(law, settings):
    trial, space, _ = trials_of("train_masses", law, settings)
    assert trial._lanes is None
    laws = laws_within(space, trial, 3)
    assert trial.run_all(laws[:2]) == [trial.run(law) for law in laws[:2]]


def test_outcomes_are_the_same_either_way():
    _, space, scenario = trials_of("train_masses", "tdc")
    examples = [space.law(values, scenario.period) for values in space.examples()]
    parts = [space.law(values, scenario.period) for values in space.examples(7)]
    plain = Trials([scenario, scenario]).evaluate(parts, run_unstable=True)
    quick = Trials([scenario, scenario], examples=examples).evaluate(parts, run_unstable=True)
    assert [one.failure for one in plain] == [one.failure for one in quick]
    for ours, theirs in zip(quick, plain, strict=True):
        assert ours.rms_errors == pytest.approx(theirs.rms_errors, rel=1e-6)


def test_examples_differ_in_every_gain():
    space = SearchSpace({"kind": "TDC"}, {"a": (1.0, 10.0), "estimator.window": (0.002, 0.03)})
    drawn = space.examples()
    assert [one["estimator.window"] for one in drawn[:2]] == [0.002, 0.03]
    assert len({one["a"] for one in drawn}) == len(drawn)


@pytest.mark.parametrize("law", ["tdc", "tarc", "tdc-kalman", "pid", "adrc"])
def test_one_function_linearises_all_gains(law):
    trial, space, _ = trials_of("train_masses", law)
    laws = laws_within(space, trial, 9)
    drawn = [trial.build_law(space.law(values, 1e-3)) for values in space.examples()]
    examples = [one for one in drawn if isinstance(one, PolePlacement)]
    samples = longest_window(examples)
    slopes = SharedSlopes([pad_window(one, samples) for one in examples])
    for one in laws:
        assert isinstance(one, PolePlacement)
        channel = slopes.channel(pad_window(one, samples))
        loop = shared_loop(one)
        assert channel is not None
        assert loop is not None
        for ratio in (0.02, 0.1, 0.5):
            ours, theirs = (np.sort(np.abs(np.linalg.eigvals(part.state_matrix(ratio)))) for part in (channel, loop[0]))
            np.testing.assert_allclose(ours[-3:], theirs[-3:], atol=1e-9)


def test_another_structure_is_not_linearised_by_the_function():
    trial, space, _ = trials_of("train_masses", "tdc")
    laws = laws_within(space, trial, 4)
    first, *_ = plain = [one for one in laws if isinstance(one, PolePlacement)]
    slopes = SharedSlopes([pad_window(one, 31) for one in plain])
    assert slopes.channel(first) is None  # its own window
    slower = trial.build_law({**space.law(space.middle, 1e-3), "delay": 3e-3})
    assert isinstance(slower, PolePlacement)
    assert slopes.channel(pad_window(slower, 31)) is None
