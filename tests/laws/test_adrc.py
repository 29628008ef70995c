"""ADRC: where its observer's poles lie, and what it observes."""

import numpy as np
import pytest
from scipy.linalg import expm

from law_catalogue import PERIOD, make_law
from tarc import certificates, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter
from tarc.core.trees import pack, unpack
from tarc.laws.base import ControlInput


def observer_error_matrix(law):
    """Matrix of the observer's error, found by stepping it: columns are what becomes of unit states."""
    state = law.example()[0].control
    zero = np.zeros(1)
    tracking = ControlInput(
        law.estimator.step(law.estimator.init(zero), zero)[1], zero, zero, zero, zero, 0.0, zero, zero, 1.0
    )
    columns = [pack(law.control(unpack(state, column), tracking)[0]) for column in np.eye(3)]
    return np.array(columns).T


def test_poles_of_the_observer():
    law = make_law(laws.ADRC, joints=1, observer_bandwidth=80.0)
    np.testing.assert_allclose(np.linalg.eigvals(observer_error_matrix(law)), np.exp(-80.0 * PERIOD), atol=1e-4)
    characteristic = np.poly(observer_error_matrix(law))
    np.testing.assert_allclose(characteristic, np.poly(np.full(3, np.exp(-80.0 * PERIOD))), atol=1e-12)


def test_gains_tend_to_those_in_continuous_time():
    law = make_law(laws.ADRC, period=1e-6, observer_bandwidth=100.0)
    np.testing.assert_allclose(law.correction / 1e-6, [3e2, 3e4, 1e6], rtol=1e-3)


def test_prediction_is_exact():
    """Between samples the observer is e^{At} of a triple integrator with the torque held."""
    law = make_law(laws.ADRC, joints=1, inertia=0.5)
    generator = np.zeros((4, 4))
    generator[0, 1] = generator[1, 2] = generator[1, 3] = 1.0
    x = np.array([0.3, -0.2, 5.0])
    ahead = expm(generator * PERIOD) @ [*x, 1.5 / 0.5]
    missing = law.estimator.step(law.estimator.init(np.zeros(1)), np.full(1, np.nan))[1]
    zero = np.zeros(1)
    tracking = ControlInput(missing, zero, zero, zero, np.full(1, 1.5), 0.0, zero, zero, 1.0)
    memory, _, _ = law.control(unpack(law.example()[0].control, x), tracking)
    np.testing.assert_allclose(pack(memory), ahead[:3], rtol=1e-12)


def test_constant_disturbance_leaves_no_offset_and_is_observed():
    law = make_law(laws.ADRC, joints=1, inertia=1.0, natural_frequency=10.0)
    mass = plants.MassSpringDamper(masses=(1.0,), springs=0.0, dampers=0.0)
    reference = signals.Sinusoid(amplitude=0.0, frequency=1.0, offset=0.2)
    data = simulate(mass, law, reference, 3.0, disturbance=signals.StepDisturbance(amplitude=7.0)).data
    np.testing.assert_allclose(data["position"].values[-1], 0.2, atol=1e-9)
    np.testing.assert_allclose(data["disturbance_estimate"].values[-1], 7.0, rtol=1e-6)


def test_keeps_the_torque_that_holds_it():
    law = make_law(laws.ADRC)
    state, value = law.init([0.5, -0.2], [3.0, -1.0]), law.example()[1]
    at_rest = value._replace(position=np.array([0.5, -0.2]), reference=np.array([0.5, -0.2]))
    for _ in range(20):
        state, output = law.step(state, at_rest)
        np.testing.assert_allclose(output.torque, [3.0, -1.0], rtol=1e-9)


def test_the_estimator_plays_no_part():
    value = make_law(laws.ADRC).example()[1]._replace(position=np.array([0.1, -0.2]), velocity_reference=np.ones(2))
    torques = []
    for name in ("algebraic", "difference"):
        law = make_law(laws.ADRC, estimator_name=name)
        torques.append(law.step(law.init(np.zeros(2)), value)[1].torque)
    np.testing.assert_allclose(*torques, rtol=1e-9)


def test_payload_is_survived_on_position_alone():
    law = make_law(laws.ADRC, inertia=0.8 * np.array([[3.0, 1.0], [1.0, 1.0]]), observer_bandwidth=150.0)
    reference = signals.Sinusoid(amplitude=0.6, frequency=[2.0, 2.5], phase=np.pi / 2)
    sensor, load = signals.Encoder(bits=16), signals.Payload(mass=0.5, start_time=2.0)
    run = simulate(plants.TwoLinkArm(), law, reference, 4.0, sensor=sensor, disturbance=load, initial_torque="rest")
    assert run.status.completed
    assert run.metrics(start_time=1.0)["rms_error"] < 5e-3
    assert certificates.certify_constant_ratio(law, 1.0).verdict == "certified"


def test_bad_parameters():
    with pytest.raises(InvalidParameter, match="observer_bandwidth: got 0; needs a finite number above 0"):
        make_law(laws.ADRC, observer_bandwidth=0.0)
