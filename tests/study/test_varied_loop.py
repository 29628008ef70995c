"""Loops of the virtual machine with drawn numbers as inputs: traced once, with the results of each run's own loop."""

import numpy as np
import pytest

import arm_study
from tarc.simulation.integration import Integration
from tarc.study import Study, engines
from tarc.study.cases import Cases
from tarc.study.engines import Simulator

METHOD = Integration("Runge–Kutta", 2)
SCENARIO = {
    **arm_study.SCENARIO,
    "law": [
        {**arm_study.TARC, "initial_gain": 0.5},
        {"kind": "ComputedTorque", "model": "robot", "natural_frequency": 10.0},
    ],
    "sensor": {"resolution": 1e-4, "noise": 1e-5},
    "torque_limits": {"magnitude": 80.0, "rate": 1e5},
}
PAYLOAD = {"uniform": [0.0, 1.0]}
DRAWS = {
    "law.0.natural_frequency": {"uniform": [12.0, 16.0]},
    "law.0.initial_gain": {"uniform": [0.2, 0.8]},
    "law.0.inertia.fraction": {"uniform": [0.06, 0.1]},
    "sensor.resolution": {"log_uniform": [1e-5, 1e-3]},
    "torque_limits.rate": {"uniform": [1e4, 1e5]},
    "robot.payload": PAYLOAD,
}


def make(draws, known=(), **scenario):
    content = {**SCENARIO, **scenario}
    study = Study.parse({"scenario": content, "runs": 5, "draws": draws, "known": list(known)})
    return study, Simulator(Cases(study), METHOD)


def run(study, simulator):
    draws = study.draw()
    return simulator.run(np.arange(study.runs), draws.values, draws.seeds)


@pytest.mark.parametrize(
    ("draws", "known"),
    [(DRAWS, []), ({"robot.payload": PAYLOAD}, ["robot.payload"]), ({"law.0.max_gain": {"choice": [0.6, 5.0]}}, [])],
)
def test_results_are_those_of_loops_built_with_their_numbers(monkeypatch, draws, known):
    study, simulator = make(draws, known)
    monkeypatch.setattr(Simulator, "_varied_loop", lambda *_: None)
    built = run(study, simulator)
    monkeypatch.undo()
    traced = run(*make(draws, known))
    assert np.array_equal(traced.end_time, built.end_time)
    for name, values in built.measures.items():
        np.testing.assert_allclose(traced.measures[name], values, rtol=1e-9, atol=1e-15, err_msg=name)


def test_no_run_is_traced_for_itself(monkeypatch):
    def refused(*_):
        raise AssertionError("traced for one run")

    monkeypatch.setattr(engines, "TracedLoop", refused)
    assert np.all(run(*make(DRAWS)).completed)


def test_each_choice_of_a_window_has_its_loop():
    draws = {"estimator.window": {"choice": [0.006, 0.014]}, "law.0.rise_rate": {"uniform": [1000.0, 3000.0]}}
    study, simulator = make(draws)
    result = run(study, simulator)
    windows = study.draw().values[:, 0]
    assert len(set(windows)) == 2
    for window in set(windows):
        estimator = {"kind": "Algebraic", "window": window, "degree": 2}
        other_study, other = make({**draws, "estimator.window": {"choice": [window]}}, estimator=estimator)
        chosen = windows == window
        drawn = study.draw()
        alone = other.run(np.flatnonzero(chosen), drawn.values[chosen], drawn.seeds[chosen])
        assert other_study.runs == study.runs
        assert np.array_equal(alone.measures["rms_error"], result.measures["rms_error"][chosen])
