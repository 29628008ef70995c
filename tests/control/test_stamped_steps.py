"""Samples at their own times: exact on polynomials, and the same as ever where times are even."""

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.estimators.algebraic import polynomial_weights

T = 1e-3


def controller(estimator=None, **options) -> tarc.Controller:
    law = tarc.laws.TDC(
        inertia=[0.1, 0.2],
        natural_frequency=10.0,
        period=T,
        estimator=estimator or tarc.estimators.Algebraic(window=0.010),
    )
    return tarc.Controller(law, **options)


def jittered(count: int, seed: int = 0) -> np.ndarray:
    return T * (np.arange(count) + 0.6 * np.random.default_rng(seed).random(count))


@pytest.mark.parametrize("degree", [2, 3])
def test_derivatives_are_exact_on_polynomials(degree):
    loop = controller(tarc.estimators.Algebraic(window=0.010, degree=degree))
    coefficients = np.array([[0.3, -0.2], [2.0, 1.0], [-5.0, 30.0], [90.0, 40.0]])[: degree + 1]
    times = jittered(40)
    loop.reset(coefficients[0])
    for time in times:
        position = np.polynomial.polynomial.polyval(time, coefficients)
        loop.step(position, position, np.zeros(2), np.zeros(2), time=time)
    velocity = np.polynomial.polynomial.polyval(times[-1], np.polynomial.polynomial.polyder(coefficients))
    assert loop.signals["velocity_estimate"] == pytest.approx(velocity, rel=1e-7)


def test_estimates_are_least_squares_at_the_true_times_and_samples_may_be_lost():
    loop, rng = controller(), np.random.default_rng(1)
    times, positions = jittered(60, 2), rng.standard_normal((60, 2))
    lost = [40, 52, 55]
    loop.reset(positions[0])
    for k, (time, position) in enumerate(zip(times, positions, strict=True)):
        given = np.full(2, np.nan) if k in lost else position
        loop.step(given, np.zeros(2), np.zeros(2), np.zeros(2), time=time)
    rows = [k for k in range(49, 60) if k not in lost]
    weights = polynomial_weights(times[-1] - times[rows], 2, 1)
    assert loop.signals["velocity_estimate"] == pytest.approx(weights @ positions[rows], rel=1e-8)


def test_even_times_give_the_torque_without_times():
    loops = controller(), controller()
    rng = np.random.default_rng(3)
    for loop in loops:
        loop.reset([0.1, -0.1])
    for k in range(50):
        position = 0.1 * rng.standard_normal(2)
        reference = 0.1 * rng.standard_normal((3, 2))
        plain = loops[0].step(position, *reference).copy()
        stamped = loops[1].step(position, *reference, time=5.0 + T * k)
        assert stamped == pytest.approx(plain, rel=1e-6, abs=1e-6)


def test_a_repeated_time_is_a_missing_sample_and_an_absolute_encoder_is_unwrapped():
    loop = controller(span=[2 * np.pi, np.inf])
    loop.reset([3.1, 0.0])
    times = jittered(50)
    for time in times:
        position = np.array([(3.1 + 2.0 * time + np.pi) % (2 * np.pi) - np.pi, 2.0 * time])
        loop.step(position, position, np.zeros(2), np.zeros(2), time=time)
    assert loop.signals["velocity_estimate"] == pytest.approx([2.0, 2.0], rel=1e-6)
    assert loop.missing == 0
    loop.step(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), time=times[-1])
    assert loop.missing == 1
    loop.reset([0.0, 0.0])
    loop.step(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), time=0.0)
    assert np.all(loop.signals["velocity_estimate"] == 0)


def test_refusals():
    loop = controller()
    loop.reset([0.0, 0.0])
    zeros = [np.zeros(2)] * 4
    loop.step(*zeros, time=1.0)
    with pytest.raises(InvalidParameter, match=r"time: got 0.9 s after 1 s; needs times that increase"):
        loop.step(*zeros, time=0.9)
    other = controller(tarc.estimators.HighGain(time_constant=0.005))
    other.reset([0.0, 0.0])
    with pytest.raises(InvalidParameter, match="HighGain takes even samples alone"):
        other.step(*zeros, time=1.0)
