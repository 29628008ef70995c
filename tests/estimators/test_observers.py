"""Observers and the robust differentiator against closed forms and known algorithms."""

import numpy as np
import pytest
from scipy.signal import lfilter, savgol_coeffs

from law_catalogue import PERIOD as T
from tarc import estimators, laws, plants, signals, simulate
from tarc.analysis import stable_interval
from tarc.certificates import certify_constant_ratio
from tarc.core.errors import InvalidParameter, NotLinearisable


def estimates_along(estimator, motion):
    """Velocity and acceleration estimates along sampled positions."""
    state = estimator.init(motion[:1])
    estimates = []
    for sample in motion:
        state, estimate = estimator.step(state, np.array([sample]))
        estimates.append([estimate.velocity[0], estimate.acceleration[0]])
    return np.array(estimates)


def kalman(noise, jerk):
    return estimators.Kalman(noise=noise, jerk=jerk).with_period(T)


@pytest.mark.parametrize("observer", [kalman(1e-5, 100.0), estimators.HighGain(time_constant=0.004).with_period(T)])
def test_observers_settle_on_constant_acceleration(observer):
    t = np.arange(400) * T
    estimates = estimates_along(observer, 3.0 + 2.0 * t - 5.0 * t**2)
    np.testing.assert_allclose(estimates[-1], [2.0 - 10.0 * t[-1], -10.0], rtol=1e-6)


@pytest.mark.parametrize("time_constant", [0.002, 0.004, 0.02])
def test_high_gain_has_its_poles_where_it_says(time_constant):
    observer = estimators.HighGain(time_constant=time_constant).with_period(T)
    error = (np.eye(3) - np.outer(observer.gain, [1.0, 0.0, 0.0])) @ observer.transition
    p = np.exp(-T / time_constant)
    np.testing.assert_allclose(np.poly(error), np.poly([p, p, p]), atol=1e-9)


def test_kalman_gain_is_the_limit_of_the_recursion():
    """The textbook filter, run until its covariance is steady."""
    noise, jerk = 2e-5, 300.0
    observer = kalman(noise, jerk)
    spread = np.sqrt(T) * jerk * np.array([T**2 / 6, T / 2, 1.0])
    c, P = np.array([[1.0, 0.0, 0.0]]), np.eye(3)
    gain = np.zeros(3)
    for _ in range(20000):
        P = observer.transition @ P @ observer.transition.T + np.outer(spread, spread)
        gain = (P @ c.T / (c @ P @ c.T + noise**2))[:, 0]
        P = (np.eye(3) - np.outer(gain, c)) @ P
    np.testing.assert_allclose(observer.gain, gain, rtol=1e-6)


def test_kalman_is_best_where_its_model_holds():
    """A motion and a noise as it assumes: no other gain does better in velocity."""
    rng = np.random.default_rng(0)
    noise, jerk = 1e-4, 200.0
    steps = jerk * np.sqrt(T) * rng.normal(size=20000)
    acceleration = np.cumsum(steps)
    velocity = np.cumsum(acceleration * T - steps * T / 2)
    position = np.cumsum(velocity * T - acceleration * T**2 / 2 + steps * T**2 / 6)
    measured = position + noise * rng.normal(size=position.shape)

    def error(observer):
        return np.sqrt(np.mean((estimates_along(observer, measured)[500:, 0] - velocity[500:]) ** 2))

    best = error(kalman(noise, jerk))
    for factor in (0.2, 5.0):
        assert error(kalman(noise, jerk * factor)) > 1.02 * best


@pytest.mark.parametrize("implicit", [True, False])
def test_differentiator_is_exact_after_a_finite_time(implicit):
    """|q⃛| ≤ L: the errors of velocity and acceleration are of the order of L T² and L T, and shrink like that."""
    errors = []
    for period in (1e-3, 5e-4):
        t = np.arange(int(2.0 / period)) * period
        estimates = estimates_along(
            estimators.RobustDifferentiator(lipschitz=150.0, implicit=implicit).with_period(period), np.sin(5 * t)
        )
        truth = np.column_stack([5 * np.cos(5 * t), -25 * np.sin(5 * t)])
        errors.append(np.abs(estimates - truth)[t > 1.0].max(axis=0))
    assert errors[0][0] < 20 * 150.0 * 1e-6
    assert errors[0][1] < 10 * 150.0 * 1e-3
    assert errors[0][0] / errors[1][0] == pytest.approx(4.0, rel=0.35)
    assert errors[0][1] / errors[1][1] == pytest.approx(2.0, rel=0.35)


def test_implicit_does_not_chatter_and_explicit_does():
    still = np.full(3000, 0.3)
    quiet = estimates_along(estimators.RobustDifferentiator(lipschitz=150.0).with_period(T), still + 1e-9)
    np.testing.assert_allclose(quiet[-500:], 0.0, atol=1e-9)
    loud = estimates_along(
        estimators.RobustDifferentiator(lipschitz=150.0, implicit=False).with_period(T), np.append(0.0, still)
    )
    assert np.abs(np.diff(loud[-500:, 1])).max() > 0.05


def test_implicit_step_solves_its_inclusion():
    """σ⁺ and its sign satisfy the scheme's own equation."""
    estimator = estimators.RobustDifferentiator(lipschitz=80.0).with_period(T)
    rng = np.random.default_rng(1)
    for scale in (1e-9, 1e-6, 1e-3, 1.0):
        sigma = scale * rng.normal(size=50)
        c0, c1, c2 = estimator._implicit(sigma)
        after = sigma - T * c0 - T**2 * c1 - T**3 / 2 * c2
        expected = np.where(np.abs(sigma) > T**3 / 2 * 1.1 * 80.0, np.sign(sigma), 0.0)
        np.testing.assert_array_equal(np.where(np.abs(after) > 1e-9 * scale, np.sign(after), 0.0), expected)
        k0 = 2.0 * 80.0 ** (1 / 3)
        np.testing.assert_allclose(c0, k0 * np.abs(after) ** (2 / 3) * np.sign(sigma), rtol=1e-5, atol=1e-7)


def test_savitzky_golay_is_algebraic():
    """The same least squares: scipy's coefficients at the newest sample are the estimator's weights."""
    for samples, degree in ((5, 2), (11, 2), (11, 3), (21, 4)):
        window = estimators.Algebraic(window=(samples - 1) * T, degree=degree).with_period(T)
        for derivative in (1, 2):
            theirs = savgol_coeffs(samples, degree, deriv=derivative, delta=T, pos=samples - 1, use="dot")[::-1]
            np.testing.assert_allclose(window.weights(derivative), theirs, rtol=1e-6, atol=1e-9 / T**derivative)


@pytest.mark.parametrize("observer", [kalman(1e-5, 100.0), estimators.HighGain(time_constant=0.004).with_period(T)])
def test_torque_filter_pairs_with_the_acceleration_estimate(observer):
    """For an acceleration held over each period, the filter of it and the estimate from positions are the same."""
    rng = np.random.default_rng(2)
    accelerations = rng.normal(size=300)
    velocity = np.concatenate([[0.0], np.cumsum(accelerations) * T])
    position = np.concatenate([[0.0], np.cumsum(velocity[:-1] * T + accelerations * T**2 / 2)])
    estimate = estimates_along(observer, position)[:, 1]
    pair = observer.matched_torque_filter()
    state, paired = pair.init(np.zeros(1)), [0.0]
    for acceleration in accelerations:
        state, output = pair.step(state, np.array([acceleration]))
        paired.append(output[0])
    np.testing.assert_allclose(paired, estimate, atol=1e-6)
    np.testing.assert_allclose(paired[1:], lfilter(pair.b, pair.a, accelerations), atol=1e-9)


def test_synchronised_with_an_observer_keeps_the_contraction():
    """The constant-ratio certificate sees the same gain in range as with a window."""
    common = {
        "inertia": 0.1,
        "natural_frequency": 10.0,
        "period": T,
        "estimator": estimators.HighGain(time_constant=0.004),
    }
    literal = stable_interval(laws.TDC(**common))
    synchronised = stable_interval(laws.TDC(synchronised=True, **common))
    assert synchronised[1] > 5 * literal[1]
    assert certify_constant_ratio(laws.TDC(synchronised=True, **common), 1.0).certified


def test_a_loop_with_a_nonlinear_estimator_has_no_certificate_but_runs():
    estimator = estimators.RobustDifferentiator(lipschitz=1000.0)
    law = laws.TDC(inertia=[0.05], natural_frequency=10.0, period=T, estimator=estimator)
    with pytest.raises(NotLinearisable, match="no linearisation at rest"):
        certify_constant_ratio(law, 0.1)
    run = simulate(plants.Pendulum(), law, signals.Sinusoid(amplitude=[0.3], frequency=2.0), 1.0)
    assert run.status.completed


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: estimators.Kalman(noise=0.0, jerk=1.0), "noise: got 0"),
        (lambda: estimators.Kalman(noise=1.0, jerk=-1.0), "jerk: got -1"),
        (lambda: estimators.HighGain(time_constant=0.0), "time_constant: got 0"),
        (lambda: estimators.RobustDifferentiator(lipschitz=0.0), "lipschitz: got 0"),
        (
            lambda: estimators.RobustDifferentiator(lipschitz=1.0).with_period(T).matched_torque_filter(),
            "use synchronised=False",
        ),
        (lambda: kalman(1.0, 1.0).transfer_function(3), "derivative: got 3"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(InvalidParameter, match=message):
        make()


def test_a_nonlinear_estimator_has_no_transfer_function():
    estimator = estimators.RobustDifferentiator(lipschitz=1.0, period=T)
    with pytest.raises(NotLinearisable, match="no transfer function"):
        estimator.transfer_function(1)
