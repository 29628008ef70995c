"""PID against python-control, and its integral at a limit."""

import control
import numpy as np
import pytest

from law_catalogue import make_law
from tarc import certificates, estimators, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter
from tarc.laws import LawInput

MASS = plants.MassSpringDamper(masses=(1.0,), springs=0.0, dampers=0.0)


def test_equals_python_control():
    """The response of a mass to a step of the reference, with the loop put together from transfer functions."""
    T, M, gain = 1e-3, 0.8, 4.0
    estimator = estimators.FilteredDifference(cutoff=300.0)
    law = laws.PID(inertia=M, natural_frequency=20.0, integral_gain=gain, period=T, estimator=estimator)
    K1, K2 = law.K1[0, 0], law.K2[0, 0]
    p = estimator.with_period(T).pole
    derivative = control.tf((1 - p) * np.array([1.0, -1.0]) / T, [1.0, -p], T)
    proportional = control.ss(control.tf([M * K1 * (1 + gain * T), -M * K1], [1.0, -1.0], T))
    plant = control.sample_system(control.ss(control.tf([1.0], [1.0, 0.0, 0.0])), T)
    inner = control.feedback(plant, control.ss(M * K2 * derivative))  # type: ignore[arg-type]
    response = control.forced_response(control.feedback(inner * proportional, 1), U=np.full(800, 0.1)).outputs
    reference = signals.Sinusoid(amplitude=0.0, frequency=1.0, offset=0.1)
    run = simulate(MASS, law, reference, 0.8, initial_position=[0.0])
    np.testing.assert_allclose(run.data["position"].values[:, 0], response, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("gain", "offset"), [(0.0, (0.01, 0.1)), (5.0, (0.0, 1e-5))])
def test_integral_takes_up_a_constant_load(gain, offset):
    law = make_law(laws.PID, integral_gain=gain, inertia=[3.0, 1.0], natural_frequency=15.0)
    reference = signals.Sinusoid(amplitude=0.0, frequency=1.0, offset=[0.4, 0.5])
    data = simulate(plants.TwoLinkArm(), law, reference, 4.0).data
    assert offset[0] <= np.abs(data["position"].values[-1] - [0.4, 0.5]).max() <= offset[1]


def test_does_not_wind_up():
    """Held away at a limit, z settles where ż = 0: at the acceleration that the limit allows, and not beyond."""
    law = make_law(laws.PID, joints=1, inertia=0.1, integral_gain=5.0, torque_limit=2.0)
    state, value = law.init([0.0]), law.example()[1]
    output = None
    for _ in range(4000):
        state, output = law.step(state, value._replace(reference=np.array([1.0])))
    assert output is not None
    np.testing.assert_allclose(output.torque, 2.0)
    np.testing.assert_allclose(output.signals["integral"], 2.0 / 0.1, rtol=1e-6)


def test_unwinds_from_the_torque_that_came_late():
    """With a known delay the torque asked for is compared with what became of it, not with a later one."""
    law = make_law(laws.PID, integral_gain=5.0, actuation_delay=3)
    free = make_law(laws.PID, integral_gain=5.0)
    state, twin, value = law.init(np.zeros(2)), free.init(np.zeros(2)), law.example()[1]
    for k in range(30):
        position = value._replace(position=0.1 * np.sin([0.1 * k, 0.2 * k]))
        (state, output), (twin, twin_output) = law.step(state, position), free.step(twin, position)
        np.testing.assert_allclose(output.torque, twin_output.torque, rtol=1e-12)


@pytest.mark.parametrize("gain", [0.0, 3.0])
def test_keeps_the_torque_applied_before_only_with_an_integral(gain):
    law = make_law(laws.PID, integral_gain=gain)
    _, output = law.step(law.init(np.zeros(2), [3.0, -1.0]), law.example()[1])
    np.testing.assert_allclose(output.torque, [3.0, -1.0] if gain else 0.0, atol=1e-12)


def test_certificate_knows_the_continuous_limit():
    """With M̂ = M the loop is stable for integral < K2; the window's delay takes a little of that."""
    common = {"inertia": 0.1, "natural_frequency": 10.0, "joints": 1, "estimator_name": "difference"}
    assert (
        certificates.certify_constant_ratio(make_law(laws.PID, integral_gain=19.0, **common), 1.0).verdict
        == "certified"
    )
    assert (
        certificates.certify_constant_ratio(make_law(laws.PID, integral_gain=20.5, **common), 1.0).verdict == "refuted"
    )
    assert certificates.certify_constant_ratio(make_law(laws.PID, **common), 1.0).verdict == "certified"


def test_bad_parameters():
    with pytest.raises(InvalidParameter, match="integral_gain: got -1; needs a finite number of at least 0"):
        make_law(laws.PID, integral_gain=-1.0)


def test_gravity_compensation_adds_the_gravity_of_the_model():
    arm = plants.TwoLinkArm(viscous=0.5, coulomb=0.3)
    plain, compensated = make_law(laws.PID), make_law(laws.PID, model=arm)
    value = LawInput(np.array([0.3, 0.8]), np.array([0.2, 0.9]), np.ones(2), np.zeros(2))
    torques = [law.step(law.init(np.array([0.3, 0.8])), value)[1].torque for law in (plain, compensated)]
    np.testing.assert_allclose(torques[1] - torques[0], arm.gravity_torque(np.array([0.3, 0.8])), rtol=1e-12)
    assert compensated.has_model
    assert not compensated.without_model().has_model


def test_pd_with_gravity_compensation_holds_where_pd_sags():
    arm, posture = plants.TwoLinkArm(viscous=0.5), np.array([0.4, 0.7])
    still = signals.Sinusoid(amplitude=[0.0, 0.0], frequency=1.0, offset=posture)
    errors = []
    for model in (None, arm):
        law = make_law(laws.PID, model=model, natural_frequency=8.0, estimator=estimators.BackwardDifference())
        errors.append(simulate(arm, law, still, 2.0).metrics(start_time=1.5)["rms_error"])
    assert errors[0] > 0.1
    assert errors[1] < 1e-9


def test_a_model_of_other_joints_is_refused():
    with pytest.raises(InvalidParameter, match="model: it has 1 joints, the inertia 2"):
        make_law(laws.PID, model=plants.Pendulum())
