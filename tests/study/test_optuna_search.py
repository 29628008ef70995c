"""The search itself, on objectives whose answer is known: resume, shared storage, front, constraint, failures."""

import threading

import numpy as np
import optuna
import pytest

from tarc import TarcError
from tarc.study.optuna_search import Search
from tarc.study.search_sampler import LONG_SEARCH, SeededSampler
from tarc.study.search_storage import Workers, open_storage, open_study
from tarc.study.trials import DIVERGED, NOT_CERTIFIED, UNSTABLE, TrialOutcome

SPACE = {name: optuna.distributions.FloatDistribution(0.1, 10.0, log=True) for name in ("x", "y")}
LIMITS = [1.0]


def outcome(gains):
    """Error y/x and variation x y: every x is on the front, with y at its least."""
    x, y = gains["x"], gains["y"]
    return TrialOutcome((y / x,), (x * y,), (0.0,), survived=1.0)


def bowl(gains):
    """Least error at x = 2, y = 0.5; no variation."""
    distance = np.log(gains["x"] / 2) ** 2 + np.log(gains["y"] / 0.5) ** 2
    return TrialOutcome((float(np.exp(distance)),), (0.5,), (0.0,), survived=1.0)


def search(path, *, trials=12, function=bowl, n_objectives=1, seed=0, problem=1, warm=(), margin=None):
    """Search, and return gains and outcome of each trial in their order."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = SeededSampler(SPACE, seed, trials // 3, trials >= LONG_SEARCH, warm, trials // 6)
    with Workers(path, "law") as workers:
        study = open_study("law", {"problem": problem}, sampler, n_objectives, open_storage(path))
        one = Search(
            study, SPACE, trials, LIMITS, lambda sets, run: [function(gains) for gains in sets], margin, workers
        )
        finished = one.run()
    return [(trial.number, trial.params, trial.user_attrs["outcome"]) for trial in finished]


def test_a_line_that_was_cut_off_is_passed_over(tmp_path):
    undisturbed = search(tmp_path / "whole", trials=10)
    cut(tmp_path / "whole", tmp_path / "part", 0.6)
    with (tmp_path / "part").open("ab") as file:
        file.write(b'{"op_code":')
    assert search(tmp_path / "part", trials=10) == undisturbed
    assert search(tmp_path / "part", trials=10) == undisturbed


def test_finds_the_least():
    best = min(search(None, trials=60), key=lambda trial: trial[2]["rms_errors"][0])[1]
    assert best["x"] == pytest.approx(2.0, rel=0.3)
    assert best["y"] == pytest.approx(0.5, rel=0.3)


def test_finds_the_end_of_a_narrow_valley():
    """The error is small along x y = 1, which is thirty times as narrow as long, and least at x = 4."""

    def valley(gains):
        along, across = np.log(gains["x"] / gains["y"]) - 2 * np.log(4), np.log(gains["x"] * gains["y"])
        distance = min(along**2 + (30 * across) ** 2, 100.0)
        return TrialOutcome((float(np.exp(distance)),), (0.5,), (0.0,), survived=1.0)

    for seed in range(3):
        best = min(
            search(None, trials=5 * LONG_SEARCH, function=valley, seed=seed),
            key=lambda trial: trial[2]["rms_errors"][0],
        )
        assert best[1]["x"] == pytest.approx(4.0, rel=0.01)
        assert best[1]["y"] == pytest.approx(0.25, rel=0.01)


def cut(whole, part, share):
    """Copy the first lines of a storage, as a killed process leaves them."""
    lines = whole.read_bytes().splitlines(keepends=True)
    part.write_bytes(b"".join(lines[: max(int(share * len(lines)), 1)]))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.97])
def test_a_killed_search_goes_on_as_if_nothing_had_been(tmp_path, share):
    undisturbed = search(tmp_path / "whole", trials=50)
    cut(tmp_path / "whole", tmp_path / "part", share)
    assert search(tmp_path / "part", trials=50) == undisturbed
    assert search(None, trials=50) == undisturbed


@pytest.mark.slow
def test_a_search_goes_on_from_every_line_of_its_storage(tmp_path):
    undisturbed = search(tmp_path / "whole", trials=26)
    n_lines = len((tmp_path / "whole").read_bytes().splitlines())
    for count in range(1, n_lines):
        cut(tmp_path / "whole", tmp_path / f"part{count}", (count + 0.5) / n_lines)
        assert search(tmp_path / f"part{count}", trials=26) == undisturbed


def test_more_trials_keep_those_that_are_there(tmp_path):
    first = search(tmp_path / "a", trials=20)
    more = search(tmp_path / "a", trials=30)
    assert more[:20] == first
    assert len(more) == 30


def test_two_processes_share_the_trials(tmp_path):
    results = {}

    def work(name):
        results[name] = search(tmp_path / "a", trials=30)

    threads = [threading.Thread(target=work, args=(name,)) for name in "ab"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [number for number, *_ in results["a"]] == list(range(30))
    assert results["a"] == results["b"]


def test_a_storage_of_another_problem_is_refused(tmp_path):
    search(tmp_path / "a", trials=2)
    with pytest.raises(TarcError, match="other problem .*give another file"):
        search(tmp_path / "a", trials=2, problem=2)


@pytest.mark.parametrize("text", ["laws: {}\n", '{"a": 1}\n', "\x00\x01"])
def test_a_file_of_something_else_is_refused_and_stays(tmp_path, text):
    (tmp_path / "a").write_text(text)
    with pytest.raises(TarcError, match="no storage of tarc tune"):
        search(tmp_path / "a", trials=2)
    assert (tmp_path / "a").read_text() == text


def test_a_storage_in_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(TarcError, match="does not exist"):
        search(tmp_path / "missing" / "a")


def test_the_front_is_found():
    trials = search(None, trials=120, function=outcome, n_objectives=2)
    products = [content["rms_errors"][0] * content["torque_variations"][0] for *_, content in trials]
    spread = [
        gains["x"] for _, gains, content in trials if content["rms_errors"][0] * content["torque_variations"][0] < 0.02
    ]
    assert min(products) < 0.012  # y² at its least, 0.01
    assert max(spread) / min(spread) > 20


def test_the_search_leaves_what_is_not_certified():
    """The least error is at x = 2, and only x below 1 is certified."""

    def certified(gains):
        margin = float(-np.log(gains["x"]))
        if margin < 0.0:
            return TrialOutcome(margin=margin, failure=NOT_CERTIFIED)
        return TrialOutcome(**{**bowl(gains).to_dict(), "margin": margin})

    trials = search(None, trials=60, function=certified, margin=0.0)
    late = [content["failure"] for _, _, content in trials[30:]]
    assert late.count("") > 15
    best = min((one for one in trials if not one[2]["failure"]), key=lambda one: one[2]["rms_errors"])
    assert 0.7 < best[1]["x"] <= 1.0


@pytest.mark.parametrize("failure", [DIVERGED, UNSTABLE])
def test_the_search_leaves_what_fails(failure):
    def fragile(gains):
        if gains["y"] > 1.0:
            return TrialOutcome(growth_rates=(gains["y"],), failure=failure)
        return bowl(gains)

    trials = search(None, trials=60, function=fragile)
    assert sum(not content["failure"] for *_, content in trials[30:]) > 20


def test_the_first_trials_keep_warm_starts():
    trials = search(None, trials=30, warm=[{"x": 3.0}, {"x": 4.0, "y": 99.0}])
    gains = [values for _, values, _ in trials]
    assert [values["x"] for values in gains[:5]] == [3.0, 4.0, 3.0, 4.0, 3.0]
    assert gains[1]["y"] == 10.0  # the end of its range
    assert len({values["x"] for values in gains[5:]}) > 10


def test_unstable_gains_are_run_until_stable_ones_are_known():
    flags = []

    def evaluate(sets, run_unstable):
        flags.append(run_unstable)
        growth = 1.0 if len(flags) < 4 else 0.0
        return [TrialOutcome((1.0,), (0.5,), (growth,), survived=1.0) for _ in sets]

    with Workers(None, "law") as workers:
        study = open_study("law", {}, SeededSampler(SPACE, 0, 3, is_long=False), 1, open_storage(None))
        Search(study, SPACE, 8, LIMITS, evaluate, None, workers).run()
    assert flags == [True, True, True, True, False, False, False, False]
