"""Adaptive fuzzy control: what its rules learn, and that they stay bounded."""

import numpy as np
import pytest

from law_catalogue import make_law
from tarc import analysis, certificates, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter


def test_learns_a_known_function():
    """Gravity of a pendulum, f = −(g/l) sin q, over the positions that it visits slowly."""
    pendulum = plants.Pendulum()
    law = make_law(
        laws.AdaptiveFuzzy,
        joints=1,
        inertia=pendulum.inertia(np.zeros(1)),
        adaptation_rate=2000.0,
        max_consequent=30.0,
        position_span=2.0,
        velocity_span=3.0,
        natural_frequency=20.0,
        memberships=5,
    )
    reference = signals.Sinusoid(amplitude=1.6, frequency=1.0)
    run = simulate(pendulum, law, reference, 40.0)
    last_round = run.data["time"].values > 40 - 2 * np.pi
    position, velocity = run.data["position"].values[last_round, 0], run.data["velocity"].values[last_round]
    truth = np.array([-pendulum.evaluate("bias", [q], v)[0] for q, v in zip(position, velocity, strict=True)])
    truth /= pendulum.inertia(np.zeros(1))[0, 0]
    learnt = run.data["disturbance_estimate"].values[last_round, 0]
    assert np.ptp(truth) > 10
    assert np.sqrt(np.mean((learnt - truth) ** 2)) < 0.05 * np.ptp(truth)


def test_learning_pays():
    reference = signals.Sinusoid(amplitude=0.6, frequency=[2.0, 2.5], phase=np.pi / 2)
    law = make_law(
        laws.AdaptiveFuzzy, inertia=np.array([[3.0, 1.0], [1.0, 1.0]]), adaptation_rate=500.0, position_span=1.0
    )
    run = simulate(plants.TwoLinkArm(), law, reference, 10.0, sensor=signals.Encoder(bits=16), initial_torque="rest")
    assert run.status.completed
    plain = make_law(laws.PID, inertia=law.M)
    plain_run = simulate(plants.TwoLinkArm(), plain, reference, 10.0, sensor=signals.Encoder(bits=16))
    assert run.metrics(start_time=5.0)["rms_error"] < plain_run.metrics(start_time=5.0)["rms_error"] / 3


def test_consequents_stay_bounded():
    law = make_law(laws.AdaptiveFuzzy, max_consequent=3.0, adaptation_rate=5000.0)
    state, value = law.example()
    rng = np.random.default_rng(0)
    for _ in range(300):
        state, output = law.step(state, value._replace(position=np.cumsum(rng.normal(size=2))))
        assert np.abs(state.control.consequents).max() <= 3.0
        assert np.abs(output.signals["disturbance_estimate"]).max() <= 3.0 + 1e-12
    assert np.abs(state.control.consequents).max() == 3.0


def test_rules_are_a_partition():
    law = make_law(laws.AdaptiveFuzzy, memberships=4, position_span=1.5, velocity_span=2.0)
    rng = np.random.default_rng(0)
    for scale in (0.5, 3.0, 1e6):
        rules = np.array(law.rules(scale * rng.normal(size=2), scale * rng.normal(size=2)))
        assert rules.shape == (16, 2)
        assert np.all(rules >= 0)
        np.testing.assert_allclose(rules.sum(axis=0), 1.0, rtol=1e-12)
    corner = np.array(law.rules(np.full(2, 1.5), np.full(2, -2.0)))
    assert np.all(corner.argmax(axis=0) == 3 * 4 + 0)


def test_adapts_by_the_equation():
    law = make_law(
        laws.AdaptiveFuzzy,
        natural_frequency=10.0,
        damping_ratio=1.0,
        adaptation_rate=700.0,
        estimator_name="difference",
    )
    state, value = law.init(np.zeros(2)), law.example()[1]
    position = np.array([1e-4, -2e-4])
    after, _ = law.step(state, value._replace(position=position))
    s = position + position / 1e-3 / 10.0
    rules = np.array(law.rules(position, position / 1e-3))
    np.testing.assert_allclose(after.control.consequents, (1e-3 * 700.0 * s * rules).T, rtol=1e-9)


def test_holds_the_torque_applied_before_and_stops_with_the_fault():
    law = make_law(laws.AdaptiveFuzzy, max_missing=0, inertia=[1.0, 1.0])
    state, value = law.init(np.zeros(2), [3.0, -1.0]), law.example()[1]
    _, output = law.step(state, value)
    np.testing.assert_allclose(output.torque, [3.0, -1.0], rtol=1e-9)
    lost, _ = law.step(state, value._replace(position=np.full(2, np.nan), reference=np.ones(2)))
    np.testing.assert_array_equal(lost.control.consequents, state.control.consequents)


def test_certificate_freezes_the_consequents():
    fuzzy, plain = make_law(laws.AdaptiveFuzzy), make_law(laws.PID)
    assert certificates.certify_constant_ratio(fuzzy, 1.0).verdict == "certified"
    ranges = [analysis.stable_interval(law)[1] for law in (fuzzy, plain)]
    np.testing.assert_allclose(*ranges, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"adaptation_rate": 0.0}, "adaptation_rate: got 0; needs a finite number above 0"),
        ({"max_consequent": -1.0}, "max_consequent"),
        ({"memberships": 1}, "memberships: got 1; needs a whole number from 2 to 20"),
        ({"position_span": 0.0}, "position_span"),
        ({"velocity_span": 0.0}, "velocity_span"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.AdaptiveFuzzy, **options)
