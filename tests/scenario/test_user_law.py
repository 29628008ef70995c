"""Laws from a user's own file: they run, certify and compare, and faults of the file are explained."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter, ScenarioError, UnsupportedLaw
from tarc.scenario.schema import parameters_of_law
from tarc.scenario.yaml_text import read_yaml
from tarc.study import TuningOptions, compare, load_gains, tune, user_search_space

TARC = str(Path(sys.executable).parent / "tarc")
SHORT = ["duration=0.5", "metrics_start=0.2"]
HEAD = """
from dataclasses import dataclass
import math
import numpy as np
import tarc
from tarc.core import array_ops as ops

@dataclass(frozen=True, kw_only=True, eq=False)
class Plain(tarc.laws.TDE):
    push: float = 0.0
    robust_slope_bound = 0.0
    def robust_init(self):
        return ()
    def robust(self, state, tracking):
        return state, -self.push * ops.tanh(tracking.error), {}

@dataclass(frozen=True, kw_only=True, eq=False)
class Needy(Plain):
    strength: float

class Bare(Plain):
    width: float

class Incomplete(tarc.laws.Law):
    pass
"""
EQUATIONS = {
    "If": "return state, (tracking.error if tracking.error[0] > 0 else 0 * tracking.error), {}",
    "Max": "return state, max(tracking.error[0], 0.0) + 0 * tracking.error, {}",
    "Loop": "return state, sum(e for e in tracking.error) + 0 * tracking.error, {}",
    "Math": "return state, math.sin(tracking.error[0]) + 0 * tracking.error, {}",
    "Typo": "return state, tracking.eror, {}",
}


@pytest.fixture
def folder(tmp_path):
    subclasses = [
        f"class {name}(Plain):\n    def robust(self, state, tracking):\n        {line}"
        for name, line in EQUATIONS.items()
    ]
    (tmp_path / "mine.py").write_text(HEAD + "\n\n".join(subclasses))
    scenario = (tarc.scenario.loader.SHIPPED / "two_link_payload.yaml").read_text()
    (tmp_path / "arm.yaml").write_text(scenario)
    return tmp_path


def arm(folder, kind="mine.Plain", **options):
    return tarc.Scenario.load(
        folder / "arm.yaml", [*SHORT, f"law.kind={kind}", *(f"law.{k}={v}" for k, v in options.items())]
    )


@pytest.mark.parametrize("kind", ["mine.Plain", "mine.py:Plain"])
def test_runs_as_the_law_that_it_extends(folder, kind):
    own = arm(folder, kind).run()["Plain"]
    tdc = tarc.Scenario.load(folder / "arm.yaml", SHORT).run()["TDC"]
    assert np.array_equal(own.data["torque"], tdc.data["torque"])


def test_certifies(folder):
    certification = arm(folder).certify(samples=50)["Plain"]
    assert certification.certificates["constant_ratio"].certified


def test_is_compared_in_other_processes(folder):
    laws = {"one": arm(folder).laws["Plain"], "two": arm(folder, push=2.0).laws["Plain"]}
    found = compare(tarc.Scenario.load(folder / "arm.yaml", SHORT), laws, jobs=2)
    assert set(found.runs) == {"one", "two"}


def test_is_tuned(folder):
    kind = arm(folder).laws["Plain"]["kind"]
    space = user_search_space(kind, {"push": (0.1, 10.0)})
    assert set(space.free) == {"inertia.fraction", "natural_frequency", "estimator.window", "push"}
    law, _ = tune(space, [arm(folder)], [1e4], TuningOptions(trials=2))
    assert 0.1 <= law["push"] <= 10.0
    with pytest.raises(InvalidParameter, match="Needy needs a range for strength, such as --range strength=0.1,10"):
        user_search_space(kind.replace("Plain", "Needy"), {})


def test_a_saved_scenario_names_the_file_from_its_folder(folder):
    scenario = arm(folder)
    saved = scenario.save(folder / "again.yaml")
    assert read_yaml(saved.read_text(), "again")["law"]["kind"] == "mine.py:Plain"
    assert tarc.Scenario.load(saved).law == scenario.law


def test_law_replaces_those_of_the_scenario_and_keeps_their_gains(folder, monkeypatch):
    monkeypatch.chdir(folder)
    scenario = tarc.Scenario.load("two_link_payload", [*SHORT, "law.push=3.0"], law="mine.py:Plain")
    assert scenario.laws["Plain"] == {
        "kind": f"{folder / 'mine.py'}:Plain",
        "inertia": {"fraction": 0.08},
        "natural_frequency": 15.0,
        "push": 3.0,
    }
    assert set(tarc.Scenario.load("ur5e", law="TDC").laws) == {"TDC"}
    assert "push" in parameters_of_law("mine.py:Plain")


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("mine.Plainn", r"mine.py has no Plainn; its laws are .* Did you mean 'Plain'\?"),
        ("other.Plain", "no file .*other.py; needs my_file.py:MyLaw"),
        ("mine.np", "np in mine.py is no law"),
        ("mine.Incomplete", "Incomplete in mine.py lacks control, initial_state, n_joints"),
        ("mine.Bare", "Bare in mine.py has parameters but is no dataclass"),
        ("mine.Typo", r"Typo fails with AttributeError: .*\(mine.py, line \d+: `return state, tracking.eror"),
        ("mine.Math", "other results for symbols than for numbers, perhaps by a function of `math`"),
        ("a.py:b:c", "no file|needs my_file"),
    ],
)
def test_faults_of_a_file_are_named(folder, kind, message):
    with pytest.raises(InvalidParameter, match=message):
        arm(folder, kind).build()


@pytest.mark.parametrize("kind", ["If", "Max", "Loop"])
def test_a_decision_by_a_symbol_is_explained_without_the_library(folder, kind):
    with pytest.raises(UnsupportedLaw, match=r"mine.py, line \d+: .*of tarc.core.array_ops") as caught:
        arm(folder, f"mine.{kind}").build()
    assert "casadi" not in str(caught.value).lower()


def test_a_file_that_fails_is_named(folder):
    (folder / "broken.py").write_text("import nowhere_to_be_found\n")
    with pytest.raises(InvalidParameter, match="broken.py fails with ModuleNotFoundError"):
        arm(folder, "broken.X")


def test_gains_of_a_file(folder):
    (folder / "gains.yaml").write_text("laws:\n  quick: {kind: mine.Plain, natural_frequency: 9.0}\n")
    assert load_gains(folder / "gains.yaml")["quick"]["kind"] == f"{folder / 'mine.py'}:Plain"
    (folder / "none.yaml").write_text("scores: {}\n")
    with pytest.raises(ScenarioError, match="has no laws"):
        load_gains(folder / "none.yaml")
    (folder / "odd.yaml").write_text("laws: {quick: 3}\n")
    with pytest.raises(ScenarioError, match=r"laws.quick.kind: missing; got 3"):
        load_gains(folder / "odd.yaml")
    with pytest.raises(ScenarioError, match="cannot be read"):
        load_gains(folder / "absent.yaml")


@pytest.mark.slow
def test_commands(folder):
    """Tune a law of one's own, then compare it by the file of gains."""
    short = [part for setting in SHORT for part in ("--set", setting)]
    searched = ["tune", "arm.yaml", "--law", "mine.py:Plain", "--range", "push=0.1,9", "--trials", "1", "--jobs", "1"]
    compared = ["compare", "arm.yaml", "--gains", "gains.yaml", "--law", "TDC", *short, "--no-figures", "--jobs", "1"]
    for arguments, words in ((searched, "written: gains.yaml"), (compared, "Plain")):
        done = subprocess.run([TARC, *arguments], cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert words in done.stdout
    assert "TDC" in done.stdout
    assert read_yaml((folder / "gains.yaml").read_text(), "gains")["laws"]["Plain"]["kind"] == "mine.py:Plain"
