"""Scenarios: what a user writes is checked, with the key, what came and what is allowed."""

import copy

import numpy as np
import pytest

import tarc
from tarc import Scenario, TarcError
from tarc.core.errors import InvalidParameter, ScenarioError
from tarc.scenario import schema
from tarc.scenario.loader import apply_setting, shipped_scenarios
from tarc.scenario.schema import SECTIONS, catalogue, parameters
from tarc.scenario.yaml_text import read_yaml, write_yaml

PLAIN = {
    "robot": {"kind": "TwoLinkArm"},
    "law": {"kind": "TDC", "inertia": [0.15, 0.05], "natural_frequency": 10.0},
    "estimator": {"kind": "Algebraic", "window": 0.010},
    "reference": {"kind": "Sinusoid", "amplitude": [0.2, 0.2], "frequency": 2.0},
    "duration": 0.2,
}


def scenario_content(**changes):
    return {**copy.deepcopy(PLAIN), **changes}


def content_with_settings(*settings):
    content = scenario_content()
    for setting in settings:
        apply_setting(content, setting)
    return content


def test_runs_and_equals_the_library():
    run = Scenario.parse(scenario_content()).run()["TDC"]
    law = tarc.laws.TDC(
        inertia=[0.15, 0.05], natural_frequency=10.0, period=1e-3, estimator=tarc.estimators.Algebraic(window=0.010)
    )
    reference = tarc.signals.Sinusoid(amplitude=[0.2, 0.2], frequency=2.0)
    same = tarc.simulate(tarc.plants.TwoLinkArm(), law, reference, 0.2)
    np.testing.assert_array_equal(run.data["torque"], same.data["torque"])


def test_yaml_round_trip(tmp_path):
    content = scenario_content(
        sensor={"bits": 16}, disturbance=[{"kind": "Payload", "mass": 1.0, "start_time": 0.1}], seed=7
    )
    first = Scenario.parse(content)
    (tmp_path / "a.yaml").write_text(first.to_yaml())
    again = Scenario.load(tmp_path / "a.yaml")
    assert again == first.model_copy(update={"name": "a" if first.name == "scenario" else first.name})


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_run(name):
    periods = Scenario.load(name).period / 1e-3
    runs = Scenario.load(name, [f"duration={0.3 * periods}", "metrics_start=0.0"]).run()
    assert all(run.status.completed for run in runs.values())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            ["law.natural_frequensy=10"],
            r"law.natural_frequensy: unknown key; TDC has .*natural_frequency.* Did you mean 'natural_frequency'\?",
        ),
        (["robot.mases=[1, 2]"], r"robot.mases: unknown key; .* Did you mean 'masses'\?"),
        (["law.natural_frequency=fast"], r"law.natural_frequency: got 'fast'; needs a number or a list of numbers"),
        (["law.synchronised=7"], "law.synchronised: got 7; needs true or false"),
        (["law.kind=TDCC"], r"law.kind: got 'TDCC'; known are .*TDC.*Did you mean 'TDC'\?"),
        (["robot.kind=TwoLink"], r"robot.kind: got 'TwoLink'; .* Did you mean 'TwoLinkArm'\?"),
        (
            ["estimator.window=0.0105"],
            "estimator.window: got 0.0105 s, .* the nearest is 0.01 s",
        ),
        (["estimator.window=0.001"], "estimator.window: 0.001 s holds 2 samples .* degree 2 needs 3"),
        (["law.inertia=[[1, 2], [2, 1]]"], "law.inertia: its smallest eigenvalue is -1"),
        (["duratio=3"], r"duratio: unknown key; .* Did you mean 'duration'\?"),
        (["duration=long"], "duration: got 'long'; needs a number"),
        (["sensor.bit=12"], r"sensor.bit: unknown key; Encoder has .* Did you mean 'bits'\?"),
        (["initial_torqe=rest"], r"initial_torqe: unknown key.* Did you mean 'initial_torque'\?"),
        (["law.inertia={fraction: -1}"], "law.inertia.fraction: got -1; needs a finite number above 0"),
        (["law.inertia={fractoin: 0.1}"], r"law.inertia.fractoin: unknown key.* Did you mean 'fraction'\?"),
        (["reference.amplitude=[1, 1, 1]"], "joints: the plant has 2, the law 2 .*, the reference 3"),
        (["robot={file: ur55e}"], r"robot file: 'ur55e' not found; looked for .* Did you mean 'ur5e'\?"),
        (["robot={file: ur5e, armatur: 0.1}"], r"robot.armatur: unknown key.* Did you mean 'armature'\?"),
        (["robot={}"], "robot.kind: missing; known are .*, or file:"),
        (["law=[]"], "law: got an empty list"),
        (["disturbance=[{kind: Payloads, mass: 1}]"], r"disturbance.kind: got 'Payloads'.* Did you mean 'Payload'\?"),
        (
            ["disturbance=[{kind: ParameterSchedule, parameter: pay, times: [0], values: [1]}]"],
            r"schedule parameter: got 'pay'",
        ),
    ],
)
def test_bad_keys_and_values(settings, message):
    with pytest.raises(TarcError, match=message):
        Scenario.parse(content_with_settings(*settings)).run()


def test_all_faults_of_a_part_are_reported_at_once():
    content = scenario_content(law={"kind": "TARC", "inertia": [0.1, 0.1], "bandwidht": 1.0, "fall_rate": "x"})
    with pytest.raises(TarcError) as caught:
        Scenario.parse(content)
    assert {line.split(":")[0] for line in str(caught.value).splitlines()} == {
        "law.bandwidht",
        "law.fall_rate",
        "law.rise_rate",
    }


def test_missing_sections_are_named():
    with pytest.raises(TarcError, match="law: missing; .* needs it"):
        Scenario.parse({key: value for key, value in PLAIN.items() if key != "law"})


def test_settings_reach_every_law_or_one():
    content = scenario_content(law=[dict(PLAIN["law"]), dict(PLAIN["law"])])
    apply_setting(content, "law.natural_frequency=15")
    apply_setting(content, "law.1.natural_frequency=20.5")
    assert [law["natural_frequency"] for law in content["law"]] == [15, 20.5]
    assert list(Scenario.parse(content).laws) == ["TDC", "TDC 2"]


@pytest.mark.parametrize(
    "setting", ["law.natural_frequency", "=3", "law.5.natural_frequency=1", "law.kind.deep=1", "law.x=[1"]
)
def test_bad_settings(setting):
    content = scenario_content(law=[dict(PLAIN["law"])])
    with pytest.raises(TarcError, match="--set: "):
        apply_setting(content, setting)


@pytest.mark.parametrize(
    ("text", "message"),
    [("robot: [", "no valid YAML"), ("- 1\n", "holds no scenario"), ("", "holds no scenario")],
)
def test_bad_files(tmp_path, text, message):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(TarcError, match=message):
        Scenario.load(tmp_path / "bad.yaml")


def test_columns_of_a_record_are_matched_from_yaml(tmp_path):
    t = np.arange(0, 1, 0.01)
    table = np.column_stack([5.0 + t, 0.2 + 0 * t, 0.1 + 0 * t])
    np.savetxt(tmp_path / "path.csv", table, delimiter=",", header="time,elbow,shoulder", comments="")

    def scenario(**options):
        reference = {"kind": "RecordedReference", "path": "path.csv", **options}
        (tmp_path / "a.yaml").write_text(write_yaml(scenario_content(reference=reference)))
        return Scenario.load(tmp_path / "a.yaml")

    with pytest.raises(InvalidParameter, match="the robot's joints are joint1, joint2"):
        scenario().run()
    names = ["shoulder", "elbow"]
    run = scenario(joint_names=names).run()["TDC"]
    np.testing.assert_allclose(run.data["reference"].values[-1], [0.1, 0.2])
    with pytest.raises(InvalidParameter, match="lasts from 5 s to 5.99 s, the run from 0 to 0.2 s"):
        scenario(joint_names=names, starts_at_zero=False).run()


def test_sensors_wrap_and_drop_jumps_from_yaml():
    reference = {"kind": "Sinusoid", "amplitude": [8.0, 0.2], "frequency": 8.0, "phase": 1.5708}
    torques = []
    for sensor in ({}, {"span": [6.283185307179586, float("inf")], "max_step": 0.5}):
        text = write_yaml(scenario_content(reference=reference, sensor=sensor))
        torques.append(Scenario.parse(read_yaml(text, "a.yaml")).run()["TDC"].data["torque"])
    np.testing.assert_array_equal(*torques)
    with pytest.raises(InvalidParameter, match=r"sensor.span: got 3 numbers; needs one number or 2 of them"):
        Scenario.parse(scenario_content(sensor={"span": [1.0, 1.0, 1.0]})).run()
    with pytest.raises(InvalidParameter, match=r"sensor.max_step: got -1.0; needs one number above 0"):
        Scenario.parse(scenario_content(sensor={"max_step": -1.0})).run()


def test_missing_file_says_where_it_looked(tmp_path):
    with pytest.raises(TarcError, match=rf"not found; looked for {tmp_path}/none.yaml and among the shipped scenarios"):
        Scenario.load(tmp_path / "none.yaml")


def test_files_beside_the_scenario_are_found(tmp_path, monkeypatch):
    t = np.arange(0, 1, 0.01)
    np.savetxt(tmp_path / "path.csv", np.column_stack([t, 0.1 * t**2, 0.2 * t**2]), delimiter=",")
    content = scenario_content(reference={"kind": "RecordedReference", "path": "path.csv"})
    (tmp_path / "a.yaml").write_text(write_yaml(content))
    monkeypatch.chdir("/")
    run = Scenario.load(tmp_path / "a.yaml").run()["TDC"]
    assert run.data["reference"].values[100, 1] == pytest.approx(0.2 * 0.1**2)


def test_fraction_is_of_the_mean_inertia_along_the_path():
    content = scenario_content(law={**PLAIN["law"], "inertia": {"fraction": 0.05, "diagonal": True}})
    parsed = Scenario.parse(content)
    plant = parsed.build_plant()
    from tarc.signals import Sinusoid

    reference = Sinusoid(amplitude=[0.2, 0.2], frequency=2.0)
    (law,) = parsed.build_laws(plant, reference).values()
    assert isinstance(law, tarc.laws.TDC)
    path = reference.sample(np.linspace(0, 0.2, 2001))[0]
    mean = np.mean([plant.inertia(q) for q in path.T], axis=0)
    np.testing.assert_allclose(law.M, 0.05 * np.diag(np.diag(mean)), rtol=1e-3)


@pytest.mark.parametrize("section", SECTIONS)
def test_every_kind_has_parameters_with_words(section):
    for name, kind in catalogue(section).items():
        for parameter in parameters(kind).values():
            assert "typing" not in parameter.words, (name, parameter.name)
            assert parameter.words, (name, parameter.name)


def test_one_number_of_inertia_stands_for_every_joint():
    parsed = Scenario.parse(content_with_settings("law.inertia=0.05"))
    (law,) = parsed.build().laws.values()
    assert isinstance(law, tarc.laws.TDC)
    np.testing.assert_array_equal(law.M, 0.05 * np.eye(2))


def test_a_saved_scenario_runs_from_anywhere(tmp_path, monkeypatch):
    robot = tmp_path / "robot.xml"
    robot.write_text("<mujoco><worldbody><body><joint name='j'/><geom size='.1'/></body></worldbody></mujoco>")
    content = scenario_content(robot={"file": "robot.xml"}, law={**PLAIN["law"], "inertia": 1e-3})
    content["reference"] = {"kind": "Sinusoid", "amplitude": [0.1], "frequency": 2.0}
    (tmp_path / "a.yaml").write_text(write_yaml(content))
    (tmp_path / "elsewhere").mkdir()
    saved = Scenario.load(tmp_path / "a.yaml").save(tmp_path / "elsewhere" / "saved.yaml")
    assert str(tmp_path) not in saved.read_text()
    assert read_yaml(saved.read_text(), "saved")["robot"] == {"file": "../robot.xml"}
    monkeypatch.chdir("/")
    assert Scenario.load(tmp_path / "elsewhere" / "saved.yaml").run()["TDC"].status.completed


def test_the_entry_at_fault_is_named_in_a_list_of_laws():
    content = scenario_content(law=[dict(PLAIN["law"]), {**PLAIN["law"], "bandwith": 1.0}])
    with pytest.raises(TarcError, match=r"law\.1\.bandwith: unknown key"):
        Scenario.parse(content)


def test_a_key_given_twice_is_refused(tmp_path):
    (tmp_path / "a.yaml").write_text("duration: 1.0\nseed: 1\nduration: 2.0\n")
    with pytest.raises(TarcError, match='a.yaml: line 3: found duplicate key "duration"; keep one'):
        Scenario.load(tmp_path / "a.yaml")


def test_the_path_of_a_fault_is_an_attribute():
    content = scenario_content(law=[dict(PLAIN["law"]), {**PLAIN["law"], "natural_frequency": "fast"}])
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(content)
    assert caught.value.path == "law.1.natural_frequency"
    content["law"][1]["natural_frequency"] = -1.0
    with pytest.raises(InvalidParameter, match=r"law\.1\.natural_frequency: got") as refused:
        Scenario.parse(content).build()
    assert refused.value.path == "law.1.natural_frequency"


def test_each_part_is_constructed_once(monkeypatch):
    """Two laws: two laws, one estimator, one plant, and a schema class per distinct kind."""
    content = scenario_content(law=[dict(PLAIN["law"]), {**PLAIN["law"], "kind": "TDC", "natural_frequency": 12.0}])
    content["estimator"]["degree"] = 2
    counts = {"law": 0, "estimator": 0, "plant": 0, "schema": 0}

    def count(name, owner, attribute):
        original = getattr(owner, attribute)

        def counted(*arguments, **options):
            counts[name] += 1
            return original(*arguments, **options)

        monkeypatch.setattr(owner, attribute, counted)

    count("law", tarc.laws.Law, "__post_init__")
    count("estimator", tarc.estimators.Estimator, "__post_init__")
    count("plant", tarc.plants.TwoLinkArm, "__post_init__")
    count("schema", schema, "create_model")
    schema._parameter_model.cache_clear()
    Scenario.parse(content).build()
    # TwoLinkArm, TDC, Algebraic, Sinusoid, Encoder
    assert counts == {"law": 2, "estimator": 1, "plant": 1, "schema": 5}
    Scenario.parse(content)
    assert counts["schema"] == 5


def test_a_shipped_file_is_saved_by_its_name(tmp_path):
    saved = Scenario.load("wheeled_figure_eight").save(tmp_path / "a.yaml")
    assert "path: figure_eight.csv" in saved.read_text()
    assert Scenario.load(saved).build_reference().n_joints > 0
    with pytest.raises(TarcError, match=r"save: got '.*nodir/a.yaml'; the folder .*nodir does not exist"):
        Scenario.load("ur5e").save(tmp_path / "nodir" / "a.yaml")


def test_a_scenario_says_what_it_is():
    scenario = Scenario.load("UR5e", ["law.0.label=a<b"])
    assert repr(scenario) == "<Scenario ur5e: a<b, TDC on ur5e, 20 s>"
    assert "label: a&lt;b" in scenario._repr_html_()


def test_limits_of_the_torque_are_a_section(tmp_path):
    scenario = Scenario.parse(scenario_content(torque_limits={"magnitude": [5.0, 2.0], "rate": 300.0}))
    run = scenario.run()["TDC"]
    rate = np.abs(np.diff(run.data["torque"].values, axis=0)).max() / 1e-3
    assert 200 < rate < 300 * (1 + 1e-9)
    assert run.metrics()["peak_torque_rate"] == pytest.approx(rate)
    assert Scenario.load(scenario.save(tmp_path / "limited.yaml")).torque_limits == scenario.torque_limits
    with pytest.raises(ScenarioError, match=r"torque_limits.rates: unknown key; .*Did you mean 'rate'"):
        Scenario.parse(scenario_content(torque_limits={"rates": 300.0}))
