"""Studies from YAML: what is read, what is refused and how it is said."""

import pickle

import pytest

from tarc.core.errors import InvalidParameter, ScenarioError
from tarc.study.specification import Study

PAYLOAD = {"robot.payload": {"uniform": [0.0, 3.0]}}
LAWS = [
    {"kind": "TDC", "inertia": {"fraction": 0.08}, "natural_frequency": 15.0},
    {"kind": "PID", "inertia": 1.0, "natural_frequency": 15.0},
]


def study(**changes):
    return Study.parse({"scenario": "two_link_payload", "draws": PAYLOAD, **changes})


def test_a_scenario_is_named_or_stands_in_the_study(tmp_path):
    (tmp_path / "mine.yaml").write_text(
        "robot: {kind: Pendulum}\nlaw: {kind: TDC, inertia: 0.1, natural_frequency: 10}\n"
        "estimator: {kind: Algebraic, window: 0.01, degree: 2}\n"
        "reference: {kind: Sinusoid, amplitude: [0.3], frequency: 1}\nduration: 1\n",
        encoding="utf-8",
    )
    file = tmp_path / "study.yaml"
    file.write_text("scenario: mine.yaml\ndraws: {robot.payload: {uniform: [0, 1]}}\n", encoding="utf-8")
    loaded = Study.load(file)
    assert loaded.name == "study"
    assert loaded.undrawn_scenario.robot == {"kind": "Pendulum"}
    inline = Study.parse({"scenario": loaded.scenario, "draws": {"robot.payload": {"uniform": [0, 1]}}})
    assert inline.content_hash == loaded.content_hash


def test_a_study_survives_yaml_and_another_process(tmp_path):
    first = study(laws=LAWS, runs=50, traces=[3, 1], correlation=None)
    first.save(tmp_path / "study.yaml")
    again = Study.load(tmp_path / "study.yaml")
    assert again.content_hash == first.content_hash
    assert again.traced_runs == (1, 3)
    assert again.law_names == ["TDC", "PID"]
    sent = pickle.loads(pickle.dumps(first))
    assert sent.content_hash == first.content_hash
    assert (sent.draw().values == first.draw().values).all()


def test_the_hash_is_of_what_decides_the_results():
    assert study(name="other", traces=2).content_hash == study().content_hash
    for change in ({"seed": 1}, {"runs": 2000}, {"sampling": "sobol"}, {"laws": LAWS}):
        assert study(**change).content_hash != study().content_hash
    assert study(sampling="sobol", runs=10).content_hash == study(sampling="sobol").content_hash


def test_a_changed_robot_file_changes_the_hash(tmp_path):
    robot = tmp_path / "robot.xml"
    content = {"robot": {"file": str(robot)}, "law": LAWS[0], "estimator": {}, "reference": {}, "duration": 1.0}
    hashes = []
    for text in ("<mujoco/>", "<mujoco />"):
        robot.write_text(text, encoding="utf-8")
        hashes.append(Study(scenario=content, draws=PAYLOAD).content_hash)
    assert hashes[0] != hashes[1]


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("robot.paylod", r"draws.robot.paylod: the scenario has no such key; known are .*Did you mean 'robot.payload'"),
        ("robt.payload", r"Did you mean 'robot.payload'"),
        ("robot", r"draws.robot: the scenario has no such key"),
        ("payload", r"draws.payload: the scenario has no such key"),
        ("sensor.nose", r"Did you mean 'sensor.noise'"),
        ("law.naturl_frequency", r"Did you mean 'law.natural_frequency'"),
        ("law.3.natural_frequency", r"the scenario has no such key"),
        ("disturbance.1.mass", r"known are disturbance.0.mass"),
        ("disturbance.mass", r"known are disturbance.0.mass"),
        ("drive.time_constant", r"since it has no drive; add one, such as drive: \{time_constant: 0.002\}"),
        ("duration", r"duration cannot be drawn: all runs of a study last as long"),
        ("period", r"period cannot be drawn"),
        ("seed", r"each run has a seed of its own"),
        ("estimator.windw", r"Did you mean 'estimator.window'"),
    ],
)
def test_an_unknown_key_is_refused_with_the_nearest(key, message):
    with pytest.raises(InvalidParameter, match=message) as caught:
        study(draws={key: {"uniform": [0.1, 0.2]}})
    assert caught.value.path == f"draws.{key}"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"runs": 0}, r"runs: got 0; needs a whole number from 1"),
        ({"seed": -1}, r"seed: got -1"),
        ({"sampling": "lhs"}, r"sampling: got 'lhs'; known are independent, latin_hypercube, sobol"),
        ({"draws": {}}, r"draws: got none; needs at least one key"),
        ({"laws": []}, r"laws: got an empty list"),
        ({"traces": [0, 1000]}, r"traces: got 1000; needs a whole number from 0 to 999"),
        ({"known": ["robot.payload", "robot.mass"]}, r"known: got 'robot.mass'; known are robot.payload"),
        (
            {"draws": {**PAYLOAD, "sensor.noise": {"uniform": [0, 1]}}, "known": ["sensor.noise"]},
            r"laws are built from robot and reference alone",
        ),
        (
            {"draws": {"robot.viscous": {"uniform": [0, 1]}, "robot.viscous.1": {"uniform": [0, 1]}}},
            r"draws.robot.viscous.1: it is the same number as robot.viscous; draw one of them",
        ),
        (
            {"draws": {"law.natural_frequency": {"uniform": [9, 10]}, "law.0.natural_frequency": {"uniform": [9, 10]}}},
            r"it is the same number as law.natural_frequency",
        ),
        (
            {"correlation": {"keys": ["robot.payload", "sensor.noise"], "matrix": [[1, 0.5], [0.5, 1]]}},
            r"'sensor.noise' is not among draws",
        ),
    ],
)
def test_a_wrong_study_is_refused(changes, message):
    with pytest.raises(InvalidParameter, match=message):
        study(**changes)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (["scenario"], r"study: got list; needs keys and values"),
        ({"scenario": "two_link_payload", "draws": PAYLOAD, "run": 3}, r"run: unknown key; .*Did you mean 'runs'"),
        ({"scenario": "two_link_payloads", "draws": PAYLOAD}, r"not found.*Did you mean 'two_link_payload'"),
        ({"scenario": "two_link_payload"}, r"draws: missing"),
        ({"scenario": "two_link_payload", "draws": PAYLOAD, "runs": "many"}, r"runs: got 'many'; needs a whole number"),
        ({"draws": PAYLOAD}, r"scenario: got None"),
        ({"robot": {}, "law": {}}, r"this is a scenario; a study names it under scenario: .*tarc study --example"),
    ],
)
def test_wrong_keys_are_refused(content, message):
    with pytest.raises(ScenarioError, match=message):
        Study.parse(content)


def test_a_key_that_is_drawn_twice_is_refused(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(
        "scenario: two_link_payload\ndraws:\n  robot.payload: {uniform: [0, 1]}\n  robot.payload: {uniform: [0, 2]}\n",
        encoding="utf-8",
    )
    with pytest.raises(ScenarioError, match=r"line 4: found duplicate key \"robot.payload\"; keep one of them"):
        Study.load(file)


def test_a_missing_file_says_how_to_begin(tmp_path):
    with pytest.raises(ScenarioError, match=r"not found; .*tarc study --example > study.yaml"):
        Study.load(tmp_path / "none.yaml")


def test_a_law_of_ones_own_is_found_beside_the_study(tmp_path):
    (tmp_path / "my_law.py").write_text("from tarc.laws import TDC\n\n\nclass Mine(TDC):\n    pass\n", encoding="utf-8")
    file = tmp_path / "study.yaml"
    file.write_text(
        "scenario: two_link_payload\ndraws: {robot.payload: {uniform: [0, 1]}}\n"
        "laws:\n  - {kind: my_law.Mine, inertia: 0.1, natural_frequency: 10}\n",
        encoding="utf-8",
    )
    loaded = Study.load(file)
    assert loaded.law_names == ["Mine"]
    before = loaded.content_hash
    loaded.save(tmp_path / "again.yaml")
    assert "kind: my_law.py:Mine" in (tmp_path / "again.yaml").read_text(encoding="utf-8")
    assert Study.load(tmp_path / "again.yaml").content_hash == before
    (tmp_path / "my_law.py").write_text("from tarc.laws import TDC\n\n\nclass Mine(TDC): ...\n", encoding="utf-8")
    assert Study.load(file).content_hash != before
