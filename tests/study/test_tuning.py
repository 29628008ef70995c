"""The search of gains: it finds what a sweep finds, keeps to its limit, and is the same every time."""

import numpy as np
import pytest

import tarc
from tarc import TarcError
from tarc.scenario.yaml_text import read_yaml
from tarc.study import SearchSpace, TuningOptions, tune
from tarc.study.law_scores import FAILURE_SCORE, objective
from tarc_command import run_tarc

SHORT = ["duration=1.0", "metrics_start=0.3"]
TDC = SearchSpace(
    {"kind": "TDC", "inertia": {"fraction": 0.08}, "estimator": {"kind": "Algebraic", "degree": 2, "window": 0.01}},
    {"natural_frequency": (3.0, 40.0)},
)


def training_scenario(name="train_two_link"):
    return tarc.Scenario.load(name, SHORT)


@pytest.mark.slow
def test_finds_what_a_sweep_finds():
    one = training_scenario()
    limit = 1500.0
    sweep = [objective(one, TDC.law({"natural_frequency": b}, 1e-3), limit) for b in np.geomspace(3.0, 40.0, 40)]
    law, score = tune(TDC, [one], [limit], TuningOptions(trials=40, progress=False))
    assert score <= min(sweep) + 0.1
    assert objective(one, law, limit) == pytest.approx(score, abs=0.02)


def test_is_the_same_every_time():
    one = training_scenario()
    runs = [tune(TDC, [one], [1000.0], TuningOptions(trials=6, seed=3, progress=False)) for _ in range(2)]
    assert runs[0] == runs[1]


@pytest.mark.slow
def test_the_limit_keeps_torque_variation_down():
    one = training_scenario()
    quiet, loud = (
        tune(TDC, [one], [limit], TuningOptions(trials=15, progress=False))[0]["natural_frequency"]
        for limit in (400.0, 1e6)
    )
    assert quiet < loud


def test_a_law_that_diverges_or_cannot_be_made_scores_worst():
    one = training_scenario()
    assert (
        objective(one, {"kind": "TDC", "inertia": {"fraction": 1.2}, "natural_frequency": 10.0}, 1e3)
        > FAILURE_SCORE - 2
    )
    assert (
        objective(one, {"kind": "TDC", "inertia": {"fraction": 0.1}, "natural_frequency": -1.0}, 1e3) == FAILURE_SCORE
    )


def test_windows_are_whole_periods():
    space = SearchSpace({"kind": "TDC"}, {"estimator.window": (0.002, 0.03)})
    assert space.law({"estimator.window": 0.01234}, 1e-3)["estimator"]["window"] == pytest.approx(0.012)
    assert space.fixed == {"kind": "TDC"}


def test_scenarios_that_a_law_cannot_run_in_are_left_out():
    model = SearchSpace(
        {"kind": "ProjectionARC", "model": "robot", "parameter_bounds": {"payload": [0.0, 3.0]}},
        {"natural_frequency": (5.0, 20.0)},
    )
    law, score = tune(
        model,
        [training_scenario(), training_scenario("train_ur5e")],
        [1e3, 1e3],
        TuningOptions(trials=2, progress=False),
    )
    assert law["kind"] == "ProjectionARC"
    assert np.isfinite(score)
    with pytest.raises(TarcError, match="cannot run in any"):
        tune(model, [training_scenario("train_ur5e")], [1e3], TuningOptions(trials=2, progress=False))


def test_limits_must_match():
    with pytest.raises(TarcError, match="limits: got 2 for 1"):
        tune(TDC, [training_scenario()], [1.0, 2.0], TuningOptions(trials=1))


@pytest.mark.slow
def test_command_writes_gains_and_how_they_were_found(tmp_path):
    call = ["tune", "train_two_link", "--laws", "tdc,pid", "--trials", "2", "--jobs", "1", "-o", "g.yaml"]
    done = run_tarc(*call, cwd=tmp_path)
    assert "written: g.yaml" in done.stdout
    assert "train_two_link: torque variation at most 1" in done.stdout
    content = read_yaml((tmp_path / "g.yaml").read_text(), "g.yaml")
    assert set(content["laws"]) == {"tdc", "pid"}
    assert content["command"].startswith("tarc tune train_two_link --laws tdc,pid --trials 2")
    wrong = run_tarc("tune", "train_two_link", "--laws", "xyz", cwd=tmp_path, status=2)
    assert "laws: got 'xyz'" in wrong.stderr
