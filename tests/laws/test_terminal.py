"""Terminal sliding mode: linear as a special case, finite time in closed form, the bound of the nonlinear damping."""

import numpy as np
import pytest

from law_catalogue import make_law
from law_runs import SMALL_INERTIA, assert_equals_tdc, simulate_arm, simulate_double_integrator, tracking_at
from tarc import certificates, laws
from tarc.core.errors import InvalidParameter


def test_linear_and_undamped_it_is_tdc():
    assert_equals_tdc(laws.TerminalSliding, nonlinear_damping=0.0, exponent=1.0)


@pytest.mark.parametrize("exponent", [0.5, 0.7, 1.0])
def test_slope_is_the_derivative(exponent):
    law = make_law(laws.TerminalSliding, exponent=exponent, boundary_layer=0.02)
    error, step = np.array([-0.3, -0.02, -1e-4, 0.0, 0.011, 0.5]), 1e-6
    difference = (law.terminal_map(error + step) - law.terminal_map(error - step)) / (2 * step)
    np.testing.assert_allclose(law.slope(error), difference, rtol=1e-6)


def test_power_far_from_the_layer():
    law = make_law(laws.TerminalSliding, exponent=0.7, error_scale=0.1, boundary_layer=1e-9)
    np.testing.assert_allclose(law.terminal_map(np.array([0.4, -0.02])), [0.1 * 4**0.7, -0.1 * 0.2**0.7], rtol=1e-9)


def test_the_surface_decays_by_itself():
    """ṡ = −Λ s with damping 1, whatever the power: s(t) = s(0) e^{−ωn t}."""
    law = make_law(laws.TerminalSliding, nonlinear_damping=0.0, exponent=0.7, natural_frequency=4.0, period=1e-4)
    times, q, v = simulate_double_integrator(law, [0.4, -0.3], [0.5, 0.0], 0.5)
    s = v + 4.0 * law.terminal_map(q)
    np.testing.assert_allclose(s, s[0] * np.exp(-4.0 * times)[:, None], atol=1e-3)


def test_reaches_zero_in_finite_time():
    """ė = −Λ ℓ sig(e/ℓ)^p goes from e0 to e in ℓ^(p−1) (e0^(1−p) − e^(1−p))/(Λ (1 − p))."""
    law = make_law(
        laws.TerminalSliding,
        joints=1,
        nonlinear_damping=0.0,
        exponent=0.6,
        boundary_layer=1e-5,
        natural_frequency=4.0,
        period=1e-4,
    )
    start = np.array([0.3])
    times, q, _ = simulate_double_integrator(law, start, -4.0 * law.terminal_map(start), 1.2)
    expected = 0.1**-0.4 * (0.3**0.4 - 1e-4**0.4) / (4.0 * 0.4)
    reached = np.argmax(q[:, 0] < 1e-4)
    assert times[reached] == pytest.approx(expected, rel=5e-3)
    assert 0.3 * np.exp(-4.0 * expected) > 5e-3, "a linear law is far from there yet"
    assert np.abs(q[reached:]).max() < 1e-4


def test_damping_bounds_the_distance_from_the_surface():
    """Under a constant disturbance c, s ends where Λ s + κ s² = c, below √(c/κ)."""
    law = make_law(laws.TerminalSliding, joints=1, nonlinear_damping=6.0, exponent=1.0, natural_frequency=3.0)
    _, q, v = simulate_double_integrator(law, [0.0], [0.0], 6.0, disturbance=20.0)
    s = (v + 3.0 * q)[:, 0]
    root = (-3.0 + np.sqrt(9.0 + 4 * 6.0 * 20.0)) / (2 * 6.0)
    assert s[-1] == pytest.approx(root, rel=1e-2)
    assert s.max() < np.sqrt(20.0 / 6.0)


def test_cap_of_the_damping():
    law = make_law(laws.TerminalSliding, nonlinear_damping=6.0, max_gain=2.0)
    s = law.sliding(np.array([0.5, 0.0]), np.array([0.0, 4.0]))
    np.testing.assert_allclose(law.robust((), tracking_at([0.5, 0.0], [0.0, 4.0]))[1], -2.0 * s, rtol=1e-12)


def test_tracks_better_than_tdc_under_friction():
    plain, robust = (
        simulate_arm(make_law(laws.TDC, inertia=SMALL_INERTIA)),
        simulate_arm(make_law(laws.TerminalSliding, inertia=SMALL_INERTIA)),
    )
    assert robust.status.completed
    assert robust.metrics(start_time=1.0)["rms_error"] < 0.8 * plain.metrics(start_time=1.0)["rms_error"]
    assert robust.metrics()["peak_torque"] < 60.0


def test_loop_certificate_sees_the_slope_at_zero():
    """It is that of TDC with φ'(0) K1 and (1 + φ'(0)) K2/2."""
    law = make_law(laws.TerminalSliding, exponent=0.6)
    steep = 0.1**-0.4
    plain = make_law(laws.TDC, natural_frequency=None, position_gain=steep * 144.0, velocity_gain=(1 + steep) * 12.0)
    certificate, expected = (certificates.certify_constant_ratio(candidate, 0.08) for candidate in (law, plain))
    assert (certificate.verdict, certificate.margin) == (expected.verdict, pytest.approx(expected.margin, abs=1e-8))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"nonlinear_damping": -1.0}, "nonlinear_damping: got -1; needs a finite number of at least 0"),
        ({"exponent": 0.4}, "exponent: got 0.4; needs a finite number of at least 0.5 and at most 1"),
        ({"exponent": 1.2}, "exponent: got 1.2"),
        ({"error_scale": 0.0}, "error_scale: got 0"),
        ({"boundary_layer": 0.0}, "boundary_layer: got 0"),
        ({"max_gain": 0.0}, "max_gain: got 0"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.TerminalSliding, **options)
