"""Draws of texts: kinds, files and words in the scenario, as if each run were written with its own."""

import numpy as np
import pytest

import arm_study
from arm_study import TARC, TDC
from tarc.core.errors import InvalidParameter
from tarc.study import Study, find_worst_case
from tarc.study.cases import Cases
from tarc.study.distributions import Choice

LINKS = {"masses": [1.0, 1.0], "lengths": [0.5, 0.5], "centres": [0.3, 0.2], "inertias": [0.02, 0.01]}
SCENARIO = {
    **arm_study.SCENARIO,
    "robot": {"kind": "TwoLinkArm", **LINKS},
    "sensor": {"noise": 1e-6},
}
PAYLOAD = {"robot.payload": {"uniform": [0.0, 1.0]}}
PENDULUM = """<mujoco><worldbody><body><joint axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -1" size="0.02" mass="{mass}"/></body></worldbody></mujoco>"""


def make_study(draws, runs=12, **scenario):
    content = {**SCENARIO, **scenario}
    return Study.parse({"scenario": content, "runs": runs, "sampling": "sobol", "draws": {**PAYLOAD, **draws}})


def test_a_text_is_drawn_by_its_number_and_has_the_share_of_its_weight():
    choice = Choice(values=["b", "a", "c"], weights=[1, 2, 1])
    assert [choice.plain(number) for number in choice.quantile(np.array([0.1, 0.3, 0.7, 0.8]))] == ["b", "a", "a", "c"]
    assert choice.extremes == (0.0, 2.0)
    assert choice.texts == ("b", "a", "c")


@pytest.mark.parametrize("engine", ["virtual machine", "lanes"])
def test_each_run_is_that_of_a_scenario_with_its_text(tmp_path, engine):
    drawn = make_study({"law.0.growth": {"choice": ["window", "difference"]}}).run(tmp_path / "drawn", engine=engine)
    texts = drawn.data["drawn:law.0.growth"].values
    assert set(texts) == {"window", "difference"}
    assert drawn.data["applied:law.0.growth"].values.tolist() == [[text, ""] for text in texts]
    for text in set(texts):
        written = Study.parse(
            {
                "scenario": {**SCENARIO, "law": [{**TARC, "growth": text}, TDC]},
                "runs": 12,
                "sampling": "sobol",
                "draws": {**PAYLOAD, "sensor.noise": {"choice": [1e-6]}},
            }
        ).run(tmp_path / text, engine=engine)
        assert np.array_equal(written.data["drawn:robot.payload"], drawn.data["drawn:robot.payload"])
        for name in drawn.measures:
            ours, theirs = (result.data[name].values[texts == text] for result in (drawn, written))
            np.testing.assert_allclose(ours, theirs, rtol=1e-7, err_msg=name)


@pytest.mark.slow
def test_kinds_of_law_and_robot_have_all_their_measures_and_reach_the_report(tmp_path):
    """Both robots are the same arm, by equations of two links and of n."""
    draws = {
        "robot.kind": {"choice": ["TwoLinkArm", "NLinkArm"]},
        "law.1.kind": {"choice": ["TDC", "PID"]},
    }
    one_robot = make_study({**draws, "robot.kind": {"choice": ["TwoLinkArm"]}})
    by_engine = {
        engine: make_study(draws).run(tmp_path / engine, engine=engine) for engine in ("virtual machine", "lanes")
    }
    results = [*by_engine.values(), one_robot.run(tmp_path / "one", engine="lanes")]
    assert set(results[1].data["applied:robot.kind"].values) == {"TwoLinkArm", "NLinkArm"}
    assert results[1].data.attrs["engines"] == {"TARC": "lanes", "TDC": "lanes"}
    for name in results[0].measures:
        truth = results[0].data[name].values
        np.testing.assert_allclose(results[1].data[name].values, truth, rtol=1e-6, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(results[2].data[name].values, truth, rtol=1e-6, atol=1e-12, err_msg=name)
    sensitivity = make_study(draws, runs=64).run(tmp_path / "more", engine="lanes").summary()
    of_tdc = sensitivity.sensitivities["rms_error"]["TDC"]
    assert of_tdc.order[0] == "law.1.kind"
    assert of_tdc.rank_coefficients["law.1.kind"] is None
    assert "law.1.kind" in results[1].report().read_text(encoding="utf-8")


def test_files_of_robots_beside_the_study(tmp_path):
    for name, mass in (("light.xml", 1.0), ("heavy.xml", 2.0)):
        (tmp_path / name).write_text(PENDULUM.format(mass=mass), encoding="utf-8")
    scenario = {
        **SCENARIO,
        "robot": {"file": "light.xml"},
        "law": {**TDC, "inertia": 0.1},
        "reference": {"kind": "Sinusoid", "amplitude": [0.3], "frequency": 2.0},
    }
    draws = {"robot.file": {"choice": ["light.xml", "heavy.xml"]}, "robot.viscous": {"uniform": [0.1, 0.2]}}
    study = Study.parse({"scenario": scenario, "draws": draws, "runs": 8}, folder=tmp_path)
    cases = Cases(study)
    assert not cases.plant_is_rebuilt
    built = [cases.build(np.array([number, 0.15])) for number in (0, 1, 0)]
    masses = [float(case.setup.simulated.inertia([0.0])[0, 0]) for case in built]
    assert masses[1] == pytest.approx(2 * masses[0], rel=1e-3)
    assert masses[2] == masses[0]
    assert [case.applied["robot.file"] for case in built] == [0, 1, 0]


def test_the_worst_case_names_its_text(tmp_path):
    study = make_study({"law.1.kind": {"choice": ["TDC", "PID"]}})
    worst = find_worst_case(study, law="TDC", generations=1, population=4)
    assert worst.draws["law.1.kind"] == "PID"
    saved = worst.save(tmp_path / "worst.yaml")
    assert Study.load(saved).draw().shown("law.1.kind", np.zeros(1)).tolist() == ["PID"]


@pytest.mark.parametrize(
    ("draws", "message"),
    [
        ({"law.1.kind": {"choice": ["TDC", "TDQ"]}}, r"draws.law.1.kind: with 'TDQ', law.1.kind: got 'TDQ'; known are"),
        ({"law.0.kind": {"choice": ["TARC", "TDC"]}}, r"draws.law.0.kind: with 'TDC', law.0.rise_rate: unknown key"),
        ({"law.0.growth": {"choice": ["window", "slow"]}}, r"law.0.growth: got 'slow'; known are difference, window"),
        ({"law.1.kind": {"uniform": [0, 1]}}, r"draws.law.1.kind: got 0.\d+; needs a choice of texts"),
        ({"sensor.noise": {"choice": ["small", "large"]}}, r"draws.sensor.noise: with '\w+', sensor.noise: got '\w+'"),
        ({"robot.file": {"choice": ["ur5e"]}}, r"draws.robot.file: the scenario has no such key"),
    ],
)
def test_a_wrong_text_is_refused_before_the_first_run(tmp_path, draws, message):
    with pytest.raises(InvalidParameter, match=message):
        make_study(draws).run(tmp_path / "wrong", engine="virtual machine")


def test_texts_have_no_correlation():
    correlation = {"keys": ["robot.payload", "law.1.kind"], "matrix": [[1, 0.5], [0.5, 1]]}
    with pytest.raises(InvalidParameter, match=r"correlation.keys: law.1.kind is a choice of texts"):
        Study.parse(
            {
                "scenario": SCENARIO,
                "draws": {**PAYLOAD, "law.1.kind": {"choice": ["TDC", "PID"]}},
                "correlation": correlation,
            }
        )
