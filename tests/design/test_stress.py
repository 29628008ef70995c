"""Limits of a design against direct certificates, its own prediction of noise, and simulation."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import tarc
from law_catalogue import make_tdc
from slow_cases import slow
from tarc import TarcError
from tarc.analysis import Workspace
from tarc.certificates import certify_robot
from tarc.design import design_controller
from tarc.design.stress import TOLERANCE, stress_test
from tarc.design.stress_case import StressCase
from tarc.estimators import Algebraic
from tarc.plants import TwoLinkArm

SAMPLES = 60
LIMIT = np.array([90.0, 40.0])


@pytest.fixture(scope="module", params=[slow(None)], ids=["any speed"])
def arm_design(request):
    """Return a design from few loops, so that it is quick."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("tarc.design.candidates"), "WINDOWS", (12,))
        patch.setattr(import_module("tarc.design.candidates"), "NATURAL_FREQUENCIES", (8.0,))
        space = Workspace.box([-np.pi, -2.0], [np.pi, 2.0], speed=request.param)
        return design_controller(TwoLinkArm(), payload=(0, 0.5), workspace=space, torque_limits=LIMIT, samples=SAMPLES)


@pytest.fixture(scope="module")
def stress_limits(arm_design):
    return stress_test(arm_design, duration=2.0)


def is_certified(arm_design, law=None, mass=None, delay=0):
    plants = arm_design.plants if mass is None else [TwoLinkArm(), TwoLinkArm(payload=mass)]
    law = arm_design.law if law is None else law
    return certify_robot(law, plants, arm_design.workspace, computation_delay=delay, samples=SAMPLES).certified


def test_payload_lies_between_certified_and_not(arm_design, stress_limits):
    one = stress_limits["payload"]
    assert 0.5 <= one.value < one.beyond
    assert one.beyond - one.value <= 2 * TOLERANCE * one.beyond
    masses = [0.9 * one.value, one.value, one.beyond, 1.5 * one.beyond]
    assert [is_certified(arm_design, mass=mass) for mass in masses] == [True, True, False, False]
    assert one.verdict.startswith("certified")
    assert not one.beyond_verdict.startswith("certified")


def law_at_rate(arm_design, rate):
    """Return the law at another rate, its window as near as whole periods allow."""
    window = arm_design.candidate.window * arm_design.law.period
    count = max(round(window * rate), arm_design.candidate.degree)
    estimator = Algebraic(window=count / rate, degree=arm_design.candidate.degree)
    return replace(arm_design.law, period=1 / rate, estimator=estimator)


def test_rate_lies_between_certified_and_not(arm_design, stress_limits):
    one = stress_limits["rate"]
    assert one.beyond < one.value <= 1 / arm_design.law.period
    assert one.value - one.beyond <= 3 * TOLERANCE * one.value
    assert [is_certified(arm_design, law=law_at_rate(arm_design, rate)) for rate in (one.value, one.beyond)] == [
        True,
        False,
    ]


def test_speed_lies_between_certified_and_not(arm_design, monkeypatch):
    """One step, to where a Lyapunov function affine in the inertia certifies more than balls do."""
    monkeypatch.setattr(import_module("tarc.design.stress"), "MAX_CERTIFICATES", 1)
    loaded, speed = [TwoLinkArm(), TwoLinkArm(payload=0.8)], 1.87

    def certificate(speed):
        space = arm_design.workspace.with_speed_limits([speed / 2, speed])
        return certify_robot(arm_design.law, loaded, space, samples=20)

    space = arm_design.workspace.with_speed_limits([speed / 2, speed])
    faster = replace(arm_design, plants=loaded, workspace=space, certificates={"robot": certificate(speed)})
    one = stress_test(faster, questions="speed", duration=2.0)["speed"]
    assert one.confirmed
    assert one.value == 1.25 * speed
    assert certificate(speed).certified
    assert not certificate(one.value).certified
    assert one.verdict.startswith("certified")


def test_what_only_a_lyapunov_function_certifies_has_the_verdict_of_the_command(arm_design):
    plants, inertia = [TwoLinkArm(), TwoLinkArm(payload=2.0)], 0.1 * np.array([[13.448, 5.043], [5.043, 5.043]])
    law = make_tdc(window=6, natural_frequency=40.0, synchronised=True, inertia=inertia)
    space = Workspace.from_joint_limits(plants[0], speed=2.0)
    ball = certify_robot(law, plants, space, samples=30)
    assert ball.verdict == "inconclusive"
    design = replace(arm_design, law=law, plants=plants, workspace=space, certificates={"robot": ball})
    found = StressCase.from_design(design).certificate()
    command = tarc.certify_law(law, plants, space, samples=30).strengthened(plants, space, samples=30).verdict
    assert found.certified
    assert (found.verdict, found.evidence.method) == (command.verdict, command.evidence.method)
    assert found.margin == pytest.approx(command.margin)


def test_no_speed_is_asked_of_a_design_for_any(arm_design):
    free = replace(arm_design, workspace=arm_design.workspace.with_speed_limits(None))
    assert "any speed" in stress_test(free, questions="speed", simulate=False)["speed"].explain()


def test_delay_is_the_last_certified(arm_design, stress_limits):
    one = stress_limits["computation_delay"]
    assert one.beyond == one.value + 1
    assert [is_certified(arm_design, delay=delay) for delay in range(one.value + 2)] == [True] * (one.value + 1) + [
        False
    ]


def test_bits_by_the_noise_that_was_predicted(arm_design, stress_limits):
    """Each bit less doubles the noise."""
    one = stress_limits["bits"]
    own = np.max(arm_design.torque_noise / LIMIT)
    allowed = max(0.05, own)
    assert own * 2 ** (17 - one.value) <= allowed < own * 2 ** (17 - one.beyond)
    looser = stress_test(arm_design, questions="bits", noise_budget=4.1 * allowed, simulate=False)["bits"]
    assert looser.value == one.value - 2
    assert looser.run is looser.confirmed is None


def test_own_noise_is_always_allowed(arm_design):
    one = stress_test(arm_design, questions=["bits"], noise_budget=1e-9, simulate=False)["bits"]
    assert one.value == 17


def test_simulations_complete(arm_design, stress_limits):
    applicable = [one for one in stress_limits.values() if one.value is not None]
    assert len(applicable) == 5 - (arm_design.workspace.speed is None)
    for one in applicable:
        assert one.confirmed, one.explain()
        assert one.run.value == one.value
        just, _ = one.beyond_runs
        assert just.value == one.beyond
        assert 0 < one.run.rms_error < 0.05
        assert "NOT" not in one.explain()


def test_a_wrong_certificate_is_found_out(arm_design, monkeypatch):
    """One that certifies everything leads to limits at which the simulation goes wrong."""
    monkeypatch.setattr(
        import_module("tarc.design.stress_case"), "certify_robot", lambda *_, **__: arm_design.certificates["robot"]
    )
    one = stress_test(arm_design, questions="rate", duration=2.0)["rate"]
    assert one.beyond is None
    assert one.confirmed is False
    assert "times the error of the design itself" in one.explain()
    assert "NOT CONFIRMED" in one.explain()


def test_simulated_noise_stays_below_the_predicted(arm_design, stress_limits):
    """Predicted at the worst posture and over all frequencies: above what one motion shows, but not by far."""
    predicted = arm_design.torque_noise * 2 ** (17 - stress_limits["bits"].value)
    measured = stress_limits["bits"].run.torque_noise
    assert np.all(measured < 1.1 * predicted)
    assert np.all(measured > 0.2 * predicted)


def test_questions_that_do_not_apply(arm_design, monkeypatch):
    monkeypatch.setattr(TwoLinkArm, "parameters", property(lambda self: {}))
    other = replace(arm_design, plants=arm_design.plants[:1], law=replace(arm_design.law, torque_limit=None))
    answers = stress_test(other, questions=["payload", "bits"], simulate=False)
    assert [one.value for one in answers.values()] == [None, None]
    assert "TwoLinkArm has no such parameter" in answers["payload"].explain()
    assert "torque_limit" in answers["bits"].explain()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"questions": ["paylod"]}, "Did you mean 'payload'?"),
        ({"noise_budget": 0}, "noise_budget: got 0; needs a finite number above 0"),
        ({"duration": 0.1}, "duration: got 0.1; needs a finite number of at least 1"),
    ],
)
def test_bad_input(arm_design, options, message):
    with pytest.raises(TarcError, match=message.replace("?", r"\?")):
        stress_test(arm_design, **options)


def test_no_design():
    with pytest.raises(TarcError, match="got TwoLinkArm; needs what tarc.design.design_controller returns"):
        stress_test(TwoLinkArm())  # pyright: ignore[reportArgumentType]
