"""Studies in machine code: the results of the virtual machine, law by law, and a reason where that is not possible."""

import numpy as np
import pytest

import arm_study
from arm_study import TARC
from tarc.core.errors import CompilationError, EngineWarning, InvalidParameter, UnsupportedLaw
from tarc.core.lane_loop import LaneLoop
from tarc.simulation.integration import Integration
from tarc.study import execution
from tarc.study.cases import Cases
from tarc.study.compiled_engine import CompiledEngine
from tarc.study.direct_draws import DirectDraws
from tarc.study.engines import Simulator
from tarc.study.specification import Study

METHOD = Integration("Runge–Kutta", 2)
SCENARIO = {**arm_study.SCENARIO, "sensor": {"bits": 16, "noise": 1e-5}}


def make_study(draws=None, runs=6, *, draws_noise=True, **more):
    scenario = SCENARIO
    if "sensor.resolution" in (draws or {}):
        scenario = {**SCENARIO, "sensor": {"resolution": 1e-4, "noise": 1e-5}}
    keys = {"robot.payload": {"uniform": [0.0, 1.0]}, "sensor.noise": {"log_uniform": [1e-6, 1e-5]}, **(draws or {})}
    if not draws_noise:
        del keys["sensor.noise"]
    return Study.parse({"scenario": scenario, "runs": runs, "draws": keys, **more})


def run(engine, study):
    draws = study.draw()
    return engine.run(np.arange(study.runs), draws.values, draws.seeds)


def check_equal(ours, theirs, rtol=1e-6):
    assert set(ours.measures) == set(theirs.measures)
    np.testing.assert_array_equal(ours.completed, theirs.completed)
    np.testing.assert_array_equal(ours.end_time, theirs.end_time)
    for name, values in theirs.measures.items():
        np.testing.assert_allclose(ours.measures[name], values, rtol=rtol, atol=1e-12, err_msg=name)
    assert set(ours.applied) == set(theirs.applied)
    for key, values in theirs.applied.items():
        np.testing.assert_array_equal(ours.applied[key], values)


@pytest.mark.slow
@pytest.mark.parametrize(
    "draws",
    [
        {},
        {"law.natural_frequency": {"uniform": [12.0, 16.0]}, "law.boundary_layer": {"uniform": [0.01, 0.02]}},
        {"sensor.bits": {"choice": [15, 17]}, "computation_delay": {"choice": [0, 1]}},
        {"reference.amplitude.0": {"uniform": [0.1, 0.3]}, "initial_velocity": {"uniform": [0.0, 0.1]}},
        {"sensor.delay": {"choice": [0.0, 0.4, 1.0]}, "estimator.window": {"choice": [0.008, 0.012]}},
        {"law.natural_frequency": {"choice": [12.0, 15.0]}, "jitter": {"choice": [0.0, 0.3]}},
        {"sensor.delay": {"uniform": [0.1, 0.9]}, "sensor.resolution": {"uniform": [1e-4, 2e-4]}},
    ],
    ids=lambda draws: " ".join(draws) or "robot",
)
def test_results_are_those_of_the_virtual_machine(draws):
    study = make_study(draws)
    cases = Cases(study)
    engine = CompiledEngine(cases, METHOD, study.law_names)
    check_equal(run(engine, study), run(Simulator(cases, METHOD), study))
    assert engine.n_left == 0  # to the virtual machine


@pytest.mark.slow
@pytest.mark.parametrize("key", ["robot.viscous", "robot.viscous.1", "sensor.noise.0"])
def test_numbers_of_the_robot_need_no_parts(key):
    """Handed to the loop directly, they give the bits of runs whose parts are built."""
    study = make_study({key: {"uniform": [1e-6, 1e-5]}}, draws_noise=key.startswith("robot"))
    engine, built = (CompiledEngine(Cases(study), METHOD, study.law_names) for _ in range(2))
    assert engine._direct is not None
    built._direct = None
    ours, theirs = run(engine, study), run(built, study)
    check_equal(ours, theirs, rtol=0)


def test_refused_values_of_the_robot():
    study = make_study({"robot.coulomb": {"uniform": [-0.5, 1.0]}})
    with pytest.raises(InvalidParameter, match="coulomb"):
        DirectDraws(Cases(study)).runs(study.draw().values)


@pytest.mark.slow
def test_a_model_in_the_law_knows_the_drawn_robot():
    laws = [{"kind": "ComputedTorque", "model": "robot", "natural_frequency": 12.0}, TARC]
    study = make_study({"law.0.natural_frequency": {"uniform": [10.0, 12.0]}}, laws=laws, known=["robot.payload"])
    cases = Cases(study)
    engine = CompiledEngine(cases, METHOD, study.law_names)
    check_equal(run(engine, study), run(Simulator(cases, METHOD), study))
    assert engine.n_left == 0


@pytest.mark.slow
def test_lanes_have_the_bits_of_one_run():
    study = make_study({"sensor.bits": {"choice": [15, 17]}}, 11)
    wide, narrow = (CompiledEngine(Cases(study), METHOD, study.law_names, lanes) for lanes in (None, 1))
    assert narrow.name == "compiled"
    ours, theirs = run(wide, study), run(narrow, study)
    for name, values in theirs.measures.items():
        np.testing.assert_array_equal(ours.measures[name], values)


def test_draws_that_change_the_equations_are_refused():
    study = make_study({"robot.masses.0": {"uniform": [0.9, 1.1]}})
    cases = Cases(study)
    cases.plant_is_rebuilt = True
    with pytest.raises(UnsupportedLaw, match="the robot's equations"):
        CompiledEngine(cases, METHOD, study.law_names)


def test_without_a_compiler_the_virtual_machine_takes_over(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "no-such-compiler")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(execution, "SHORT_STUDY", 0)
    with pytest.warns(EngineWarning, match="no-such-compiler") as caught:
        engine = execution.build_engine(make_study(), METHOD, "auto")
    assert engine.name == "virtual machine"
    assert len(caught) == 1


@pytest.mark.slow
def test_without_vector_types_runs_are_one_by_one(monkeypatch):
    def only_single(self, function, places, n_sums, lanes):
        if lanes > 1:
            raise CompilationError("no vector types")
        start(self, function, places, n_sums, lanes)

    start = LaneLoop.__init__
    monkeypatch.setattr(LaneLoop, "__init__", only_single)
    study = make_study()
    engine = CompiledEngine(Cases(study), METHOD, study.law_names)
    assert engine.name == "compiled"
    assert np.all(run(engine, study).completed)
