"""Nonsingular terminal sliding mode: linear as a special case, finite at zero, finite time in closed form."""

import casadi as ca
import numpy as np
import pytest

from law_catalogue import make_law
from law_runs import SMALL_INERTIA, assert_equals_tdc, simulate_arm, simulate_double_integrator, tracking_at
from tarc import certificates, laws
from tarc.core.errors import InvalidParameter
from tarc.core.tracing import trace
from tarc.core.trees import pack


def test_linear_and_without_gain_it_is_tdc():
    assert_equals_tdc(laws.NonsingularTerminal, reaching_gain=0.0, exponent=1.0)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 1.9])
def test_torque_and_its_slopes_are_finite_at_zero(exponent):
    law = make_law(laws.NonsingularTerminal, exponent=exponent, reaching_exponent=0.1)
    state, value = law.example()
    np.testing.assert_array_equal(law.step(state, value)[1].torque, 0.0)
    function, _ = trace(law.step, state, value)
    x, u = ca.SX.sym("x", function.size1_in(0)), ca.SX.sym("u", function.size1_in(1))
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(ca.vertcat(*function(x, u)), ca.vertcat(x, u))])
    assert np.all(np.isfinite(np.array(slopes(pack(state), pack(value)))))


@pytest.mark.parametrize("exponent", [1.0, 1.3, 1.9])
def test_slope_is_the_derivative(exponent):
    law = make_law(laws.NonsingularTerminal, exponent=exponent)
    rate, step = np.array([-3.0, -0.1, -1e-4, 0.0, 0.011, 0.5]), 1e-6
    difference = (law.terminal_map(rate + step) - law.terminal_map(rate - step)) / (2 * step)
    np.testing.assert_allclose(law.slope(rate), difference, rtol=1e-6)


def test_power_far_from_the_layer():
    law = make_law(laws.NonsingularTerminal, exponent=1.4, velocity_scale=2.0, boundary_layer=1e-9)
    np.testing.assert_allclose(law.terminal_map(np.array([6.0, -1.0])), [2 * 3**1.4, -2 * 0.5**1.4], rtol=1e-9)


def test_the_surface_is_invariant():
    """Started on s = 0 it stays there, layer included: Λ ė cancels against ψ' Λ ė/ψ'."""
    law = make_law(laws.NonsingularTerminal, exponent=1.5, boundary_layer=0.05, natural_frequency=4.0, period=1e-4)
    rate = np.array([0.6, -0.4])
    start = -law.terminal_map(rate) / 4.0
    _, q, v = simulate_double_integrator(law, start, rate, 2.0)
    assert np.abs(4.0 * q + law.terminal_map(v)).max() < 1e-3
    assert np.abs(q[-1]).max() < 1e-3


def test_reaches_zero_in_finite_time():
    """On s = 0, |ė| = v0 (Λ|e|/v0)^(1/a): from e0 to e in a/(a−1) v0^(1/a−1) Λ^(−1/a) (e0^(1−1/a) − e^(1−1/a))."""
    law = make_law(
        laws.NonsingularTerminal,
        joints=1,
        reaching_gain=0.0,
        exponent=1.5,
        velocity_scale=2.0,
        boundary_layer=1e-3,
        natural_frequency=4.0,
        period=1e-4,
    )
    start, v0 = 0.3, 2.0
    rate = -v0 * (4.0 * start / v0) ** (1 / 1.5)
    times, q, _ = simulate_double_integrator(law, [start], [rate], 1.5)
    expected = 3.0 * v0 ** (1 / 1.5 - 1) * 4.0 ** (-1 / 1.5) * (start ** (1 / 3) - 1e-4 ** (1 / 3))
    reached = np.argmax(q[:, 0] < 1e-4)
    assert times[reached] == pytest.approx(expected, rel=5e-3)
    assert start * np.exp(-4.0 * expected) > 3e-3, "a linear law is far from there yet"
    assert np.abs(q[reached:]).max() < 1e-4


def test_reaching_law_bounds_the_distance_from_the_surface():
    """Under a constant disturbance c, s ends where Λ s + k s^ρ = c, below (c/k)^(1/ρ)."""
    law = make_law(
        laws.NonsingularTerminal, joints=1, reaching_gain=15.0, exponent=1.0, boundary_layer=0.01, natural_frequency=3.0
    )
    _, q, v = simulate_double_integrator(law, [0.0], [0.0], 6.0, disturbance=9.0)
    s = float((3.0 * q + v)[-1, 0])
    assert 3.0 * s + 15.0 * np.sqrt(s) == pytest.approx(9.0, rel=1e-2)
    assert s < (9.0 / 15.0) ** 2


def test_tracks_better_than_tdc_under_friction():
    plain, robust = (
        simulate_arm(make_law(laws.TDC, inertia=SMALL_INERTIA)),
        simulate_arm(make_law(laws.NonsingularTerminal, inertia=SMALL_INERTIA)),
    )
    assert robust.status.completed
    assert robust.metrics(start_time=1.0)["rms_error"] < 0.6 * plain.metrics(start_time=1.0)["rms_error"]
    assert robust.metrics()["peak_torque"] < 60.0


def test_loop_certificate_sees_the_slopes_at_zero():
    """It is that of TDC with K1 + r Λ and Λ/ψ' + (Λ + r) ψ', where r = k ε^(ρ−1) and ψ' = (ε/v0)^(a−1)."""
    law = make_law(laws.NonsingularTerminal, reaching_gain=2.0)
    r, slope = 2.0 * 0.1**-0.5, 0.1**0.2
    stiffness, velocity_gain = 144.0 + r * 12.0, 12.0 / slope + (12.0 + r) * slope
    plain = make_law(laws.TDC, natural_frequency=None, position_gain=stiffness, velocity_gain=velocity_gain)
    tracking = tracking_at([1e-9, 0.0], [0.0, 1e-9])
    u = law.feedback(tracking) + law.robust((), tracking)[1]
    np.testing.assert_allclose(u, plain.feedback(tracking), rtol=1e-9)
    certificate, expected = (certificates.certify_constant_ratio(candidate, 0.08) for candidate in (law, plain))
    assert (certificate.verdict, certificate.margin) == (expected.verdict, pytest.approx(expected.margin, abs=1e-8))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reaching_gain": -1.0}, "reaching_gain: got -1; needs a finite number of at least 0"),
        ({"exponent": 0.9}, "exponent: got 0.9; needs a finite number of at least 1"),
        ({"exponent": 2.0}, "exponent: got 2"),
        ({"reaching_exponent": 0.0}, "reaching_exponent: got 0; needs a finite number above 0"),
        ({"reaching_exponent": 1.5}, "reaching_exponent: got 1.5"),
        ({"velocity_scale": 0.0}, "velocity_scale: got 0"),
        ({"boundary_layer": 0.0}, "boundary_layer: got 0"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.NonsingularTerminal, **options)
