"""Settings that `tarc certify` proposes for a law that is not certified: with them it is."""

import shlex

import pytest

import tarc
from tarc.scenario.loader import apply_setting
from tarc.scenario.repair import certifying_settings
from tarc_command import run_tarc

TDC = {"kind": "TDC", "inertia": {"fraction": 0.6}, "natural_frequency": 12.0}
TARC = {**TDC, "kind": "TARC", "rise_rate": 100.0, "fall_rate": 200.0, "max_gain": 1.0}


def arm(law, **changes):
    return tarc.Scenario.parse(
        {
            "robot": {"kind": "TwoLinkArm"},
            "law": law,
            "estimator": {"kind": "Algebraic", "window": 0.01, "degree": 2},
            "reference": {"kind": "Sinusoid", "amplitude": [0.3, 0.2], "frequency": [1.0, 2.0], "offset": [0.0, 1.5]},
            "duration": 7.0,
            **changes,
        }
    )


def slow(law):
    return pytest.param(law, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    "law",
    [
        TDC,
        slow({**TDC, "inertia": [1.5, 0.6]}),
        {**TDC, "inertia": [[1.5, 0.4], [0.4, 0.5]]},
        slow({**TDC, "delay": 0.001}),
        slow({**TDC, "kind": "PID", "inertia": {"fraction": 1e-4}}),
        TARC,
        slow(
            [
                {"kind": "ADRC", "inertia": {"fraction": 0.05}, "natural_frequency": 10.0, "observer_bandwidth": 60.0},
                TDC,
            ]
        ),
    ],
    ids=["fraction", "diagonal", "matrix", "delay", "PID", "TARC", "list"],
)
def test_with_the_settings_the_law_is_certified(law):
    scenario = arm(law)
    certified = scenario.certify(samples=40)
    name = list(certified)[-1]
    assert not certified[name].verdict.certified
    settings = certifying_settings(scenario, certified, name)
    assert settings
    content = scenario.model_dump()
    for setting in settings:
        apply_setting(content, setting)
    assert tarc.Scenario.parse(content).certify(samples=40)[name].verdict.certified


def test_where_no_ball_suffices_a_lyapunov_function_does():
    fast = {"kind": "Sinusoid", "amplitude": [1.0, 1.0], "frequency": [4.0, 5.0], "offset": [0.0, 1.5]}
    scenario = arm(TDC, reference=fast)
    settings = certifying_settings(scenario, scenario.certify(samples=40), "TDC", progress=False)
    assert settings
    content = scenario.model_dump()
    for setting in settings:
        apply_setting(content, setting)
    certified = tarc.Scenario.parse(content).certify(samples=40)
    assert not certified["TDC"].verdict.certified
    certified.strengthen(progress=False)
    assert certified["TDC"].verdict.certified


def test_no_settings_for_what_no_change_certifies():
    unbounded = {key: value for key, value in TARC.items() if key != "max_gain"}
    scenario = arm(unbounded)
    assert certifying_settings(scenario, scenario.certify(samples=20), "TARC") == []


@pytest.mark.slow
def test_the_command_that_is_printed_certifies(tmp_path):
    arm(TDC).save(tmp_path / "arm.yaml")
    printed = run_tarc("certify", "arm.yaml", "--samples", "40", "--no-figures", cwd=tmp_path).stdout
    (line,) = [line for line in printed.splitlines() if line.startswith("Try: tarc certify arm.yaml")]
    printed = run_tarc(*shlex.split(line.removeprefix("Try: "))[1:], cwd=tmp_path).stdout
    assert "certified on 40" in " ".join(printed.split())
    assert "Try:" not in printed
