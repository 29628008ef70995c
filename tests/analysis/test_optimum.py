"""The bound against a second computation, against laws and random controllers, and against simulated noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.optimum import (
    _filter,
    _joint,
    _regulator,
    distance_from_optimum,
    law_distances,
    least_error,
    loop_deviations,
    optimal_front,
    optimal_loop,
)
from tarc.estimators import Algebraic
from tarc.laws import ADRC, PID, TDC
from tarc.numerics.norms import h2_norm

PERIOD = 1e-3


def tdc(window=10, natural_frequency=20.0, **options):
    estimator = Algebraic(window=window * PERIOD, degree=2)
    return TDC(inertia=1.0, natural_frequency=natural_frequency, period=PERIOD, estimator=estimator, **options)


def composed(disturbance, K, gain, delay):
    """Return RMS position and change of joint, filter and feedback as one system, whatever K and the gain are."""
    A, B = _joint(delay)
    n = len(A)
    C, walk = np.eye(1, n), disturbance * np.eye(n)[:, 2:3]
    closed = np.block([[A, -B @ K], [gain @ C @ A, A - B @ K - gain @ C @ A]])
    inputs = np.block([[walk, 0 * walk], [gain @ C @ walk, gain]])
    direct = np.zeros((1, 2))
    return (
        h2_norm(closed, inputs, np.eye(1, 2 * n), direct),
        h2_norm(closed, inputs, np.hstack([np.zeros((1, n)), -K]), direct),
    )


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("disturbance", [1e-3, 0.1, 3.0])
def test_the_optimum_is_that_of_the_loop_put_together(disturbance, delay):
    for weight in (1e-3, 1.0, 1e4):
        A, B = _joint(delay)
        K, gain = _regulator(A, B, weight, np.ones(len(A))), _filter(A, disturbance)[0]
        expected = composed(disturbance, K, gain, delay)
        assert optimal_loop(disturbance, weight, delay) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("delay", [0, 2])
def test_no_other_gains_are_better(delay):
    rng, disturbance, weight = np.random.default_rng(0), 0.05, 10.0
    A, B = _joint(delay)
    K, gain = _regulator(A, B, weight, np.ones(len(A))), _filter(A, disturbance)[0]
    error, change = optimal_loop(disturbance, weight, delay)
    for size in (0.01, 0.1, 0.3) * 15:
        other_K = K * (1 + size * rng.standard_normal(K.shape))
        other_gain = gain * (1 + size * rng.standard_normal(gain.shape))
        other_error, other_change = composed(disturbance, other_K, other_gain, delay)
        assert other_error**2 + weight * other_change**2 > error**2 + weight * change**2


@given(
    window=st.integers(2, 30),
    natural_frequency=st.floats(3.0, 100.0),
    synchronised=st.booleans(),
    ratio=st.floats(0.01, 1.5),
    log_disturbance=st.floats(-2.0, 4.0),
)
@settings(max_examples=20)
def test_no_law_is_better(window, natural_frequency, synchronised, ratio, log_disturbance):
    (channel,) = decoupled_channels(tdc(window, natural_frequency, synchronised=synchronised))
    distance = distance_from_optimum(channel, ratio, disturbance=10**log_disturbance, noise=1.0)
    assert distance.ratio >= 1 - 1e-6


def test_an_observer_with_its_best_gains_is_near():
    law = ADRC(
        inertia=1.0,
        natural_frequency=25.0,
        observer_bandwidth=150.0,
        period=PERIOD,
        estimator=Algebraic(window=0.002, degree=2),
    )
    (distance,) = law_distances(law, [1.0])
    assert 1 < distance.ratio < 1.6


def test_deviations_are_those_of_simulated_noise():
    (channel,) = decoupled_channels(tdc())
    ratio, noise, disturbance, steps = 0.1, 2e-5, 5e-3, 100_000
    A, B, C, _, _ = channel.closed_loop(ratio)
    from_noise = ratio * B @ channel.D
    from_noise[2:] += channel.G
    rng = np.random.default_rng(3)
    n, d = noise * rng.standard_normal(steps), np.cumsum(disturbance * rng.standard_normal(steps))
    y, position, v = np.zeros((len(A), 1)), np.empty(steps), np.empty(steps)
    for k in range(steps):
        position[k], v[k] = y[0, 0], (C @ y + channel.D * n[k])[0, 0]
        y = A @ y + B * d[k] + from_noise * n[k]
    found = loop_deviations(channel, ratio, noise, disturbance)
    assert np.sqrt(np.mean(position**2)) == pytest.approx(found.error, rel=0.07)
    assert np.sqrt(np.mean((ratio * np.diff(v)) ** 2)) == pytest.approx(found.change, rel=0.02)


def test_less_change_costs_error_and_units_scale():
    changes, errors = optimal_front(1e-2, noise=1e-5, period=PERIOD)
    assert np.all(np.diff(changes) < 0)
    assert np.all(np.diff(errors) > 0)
    middle = len(changes) // 2
    found = least_error(changes[middle], noise=1e-5, disturbance=1e-2, period=PERIOD)
    assert found == pytest.approx(errors[middle], rel=1e-4)
    # metres for radians, and minutes for seconds
    scaled = least_error(60**2 * 7 * changes[middle], noise=7e-5, disturbance=60**2 * 7e-2, period=PERIOD / 60)
    assert scaled == pytest.approx(7 * found, rel=1e-4)


def test_a_loop_that_leaves_an_error_or_is_unstable_is_infinitely_far():
    law = PID(inertia=1.0, natural_frequency=10.0, period=PERIOD, estimator=Algebraic(window=0.010, degree=2))
    assert law_distances(law, [1.0])[0].ratio == np.inf
    assert law_distances(tdc(), [1.0])[0].ratio == np.inf
