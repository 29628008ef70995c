"""Corless and Leitmann's control: the ball in which the error ends, and its nominal model."""

import numpy as np
import pytest

from law_catalogue import make_law
from tarc import analysis, certificates, estimators, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.laws import LawInput

MASS = plants.MassSpringDamper(masses=(1.0,), springs=0.0, dampers=0.0)


def fast_sampled_law(**options):
    given = {"inertia": 1.0, "natural_frequency": 5.0, "period": 1e-4, "estimator": estimators.BackwardDifference()}
    return laws.CorlessLeitmann(**{**given, "boundary_layer": 0.01, **options})


@pytest.mark.parametrize("frequency", [0.0, 2.0, 5.0, 12.0])
def test_error_ends_in_the_known_ball(frequency):
    """Whatever the disturbance within ρ does; one at rest comes near enough to show that the bound means something."""
    law = fast_sampled_law(uncertainty_bound=6.0)
    wave = signals.SineDisturbance(amplitude=6.0, frequency=frequency, phase=np.pi / 2)
    data = simulate(
        MASS, law, signals.Sinusoid(amplitude=0.0, frequency=1.0), 6.0, initial_position=[0.5], disturbance=wave
    ).data
    worst = np.abs(data["position"].values[data["time"].values > 4.0]).max()
    assert worst <= law.error_bound
    if frequency == 0.0:
        # K1 e1 = d − ρ s/ε with s = e1 at rest
        np.testing.assert_allclose(worst, 6.0 / (25.0 + 6.0 / 0.01), rtol=1e-4)
        assert worst > law.error_bound / 10


def test_plain_pole_placement_leaves_the_ball():
    law = fast_sampled_law(uncertainty_bound=0.0)
    disturbance = signals.StepDisturbance(amplitude=6.0)
    data = simulate(MASS, law, signals.Sinusoid(amplitude=0.0, frequency=1.0), 4.0, disturbance=disturbance).data
    assert abs(data["position"].values[-1, 0]) > fast_sampled_law(uncertainty_bound=6.0).error_bound


def test_lyapunov_function():
    law = make_law(laws.CorlessLeitmann, natural_frequency=[12.0, 5.0], damping_ratio=0.8)
    Q = np.diag([2 * 144.0, 2 * 25.0, 2.0, 2.0])
    np.testing.assert_allclose(law.A.T @ law.P + law.P @ law.A, -Q, atol=1e-9)


def test_equation():
    arm = plants.TwoLinkArm()
    law = make_law(
        laws.CorlessLeitmann,
        uncertainty_bound=4.0,
        boundary_layer=0.01,
        model=arm,
        natural_frequency=12.0,
        damping_ratio=0.8,
    )
    rng = np.random.default_rng(1)
    state, value = law.init(rng.normal(size=2)), LawInput(*rng.normal(size=(4, 2)))
    _, estimate = law.estimator.step(state.estimator, value.position)
    e, rate = value.position - value.reference, estimate.velocity - value.velocity_reference
    s = e + rate / (0.8 * 12.0)
    u = value.acceleration_reference - 2 * 0.8 * 12.0 * rate - 144.0 * e - 4.0 * s / np.linalg.norm(s)
    expected = law.M @ u + arm.evaluate("bias", value.position, estimate.velocity)
    np.testing.assert_allclose(law.step(state, value)[1].torque, expected, rtol=1e-9)


def test_a_model_makes_up_for_gravity():
    reference = signals.Sinusoid(amplitude=0.6, frequency=[2.0, 2.5], phase=np.pi / 2)
    errors = []
    for model in (None, plants.TwoLinkArm()):
        inertia = np.array([[3.0, 1.0], [1.0, 1.0]])
        law = make_law(laws.CorlessLeitmann, uncertainty_bound=3.0, boundary_layer=0.02, inertia=inertia, model=model)
        run = simulate(plants.TwoLinkArm(), law, reference, 3.0, sensor=signals.Encoder(bits=16))
        errors.append(run.metrics(start_time=1.0)["rms_error"])
    assert errors[1] < errors[0] / 3


def test_certificate_sees_the_slope_inside_the_layer():
    law = make_law(laws.CorlessLeitmann, uncertainty_bound=5.0, boundary_layer=0.05, model=plants.TwoLinkArm())
    assert certificates.certify_constant_ratio(law, 1.0).verdict == "certified"
    assert (
        certificates.certify_constant_ratio(
            make_law(laws.CorlessLeitmann, uncertainty_bound=500.0, boundary_layer=0.001), 1.0
        ).verdict
        == "refuted"
    )


@pytest.mark.parametrize("gains", [{}, {"natural_frequency": None, "position_gain": [[144.0, 10.0], [10.0, 100.0]]}])
def test_the_loop_for_a_constant_ratio_is_that_without_the_model(gains):
    """Also where the gains couple the joints, so that all are linearised at once."""
    options = {"uncertainty_bound": 5.0, "boundary_layer": 0.05, **gains}
    if gains:
        options["velocity_gain"] = [24.0, 20.0]
    plain = make_law(laws.CorlessLeitmann, **options)
    law = make_law(laws.CorlessLeitmann, model=plants.TwoLinkArm(viscous=5.0), **options)
    expected = certificates.certify_constant_ratio(plain, 1.0)
    assert certificates.certify_constant_ratio(law, 1.0).margin == pytest.approx(expected.margin, rel=1e-12)


def test_one_joint_is_that_without_the_model():
    law = fast_sampled_law(uncertainty_bound=1.0, model=MASS)
    assert law.has_model
    joint = law.single_joint(25.0, 10.0)
    assert not joint.has_model
    assert joint.n_joints == 1


def test_a_robot_is_not_certified_for_a_law_with_a_model():
    """Held upright by its model, the loop is stable, though it would not be without it."""
    robot = plants.Pendulum(viscous=0.3)
    law = fast_sampled_law(natural_frequency=2.0, uncertainty_bound=0.01, boundary_layer=0.05, model=robot)
    upright = signals.Sinusoid(amplitude=0.05, frequency=1.0, offset=np.pi)
    run = simulate(robot, law, upright, 3.0, initial_torque="rest")
    assert run.metrics(start_time=1.0)["peak_error"] < 0.02
    postures = analysis.Workspace.box([3.0], [3.3])
    with pytest.raises(UnsupportedLaw, match="has a model, whose torque N̂ the robot certificate does not cover"):
        certificates.certify_robot(law, robot, postures)
    plain = fast_sampled_law(natural_frequency=2.0, uncertainty_bound=0.01, boundary_layer=0.05)
    assert certificates.certify_robot(plain, robot, postures).verdict == "refuted"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"uncertainty_bound": -1.0}, "uncertainty_bound"),
        ({"boundary_layer": 0.0}, "boundary_layer: got 0; needs a finite number above 0"),
        ({"model": "robot"}, "model: got 'robot'; needs one of tarc.plants"),
        ({"model": plants.NLinkArm()}, "model: it has 3 joints, the inertia 2"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.CorlessLeitmann, **options)
