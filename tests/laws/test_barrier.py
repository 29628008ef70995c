"""Barriers at limits of the errors: the Lyapunov function falls, the limits hold, and outside the law saturates."""

from typing import Any

import numpy as np
import pytest

from law_catalogue import make_law
from law_runs import SMALL_INERTIA, assert_equals_tdc, simulate_arm, simulate_double_integrator, tracking_at
from tarc import certificates, laws
from tarc.core.errors import InvalidParameter

WIDE: dict[str, Any] = {"position_limit": [0.05, 0.08], "velocity_limit": [1.5, 2.0], "max_amplification": 1e9}

LIMITS: dict[str, Any] = {"position_limit": 0.03, "velocity_limit": 1.0}


def barrier(law, error, rate, time):
    """Return V = ½ Σ κ d1² log β1 + ½ Σ d2² log β2, from its definition."""
    scale = law.limit_scale(np.exp(-time / law.decay_time))
    s = law.sliding(error, rate)
    position_limit, surface_limit = scale * law.position_limits, scale * law.surface_limits
    terms = -law.barrier_gain * position_limit**2 * np.log(1 - (error / position_limit) ** 2)
    return 0.5 * np.sum(terms - surface_limit**2 * np.log(1 - (s / surface_limit) ** 2))


def test_without_gains_it_is_tdc():
    assert_equals_tdc(laws.BarrierTDARC)


def test_the_barrier_falls_at_least_as_fast_as_its_terms():
    """V' ≤ −(Λ − δ) (Σ κ β1 e² + Σ β2 s²) inside the limits, δ the rate at which these shrink."""
    law = make_law(laws.BarrierTDARC, barrier_gain=300.0, initial_scale=2.0, decay_time=0.2, **WIDE)
    rng, step = np.random.default_rng(0), 1e-7
    for _ in range(200):
        time = rng.uniform(0.0, 1.0)
        share = law.limit_scale(np.exp(-time / 0.2))
        error = rng.uniform(-0.97, 0.97, 2) * share * law.position_limits
        rate = rng.uniform(-0.97, 0.97, 2) * share * law.surface_limits - law.Lambda @ error
        state = law.robust_init()._replace(widening=np.exp(-time / 0.2))
        tracking = tracking_at(error, rate)
        acceleration = law.feedback(tracking) + law.robust(state, tracking)[1]
        forward, back = (
            barrier(law, error + h * rate + h**2 / 2 * acceleration, rate + h * acceleration, time + h)
            for h in (step, -step)
        )
        s = law.sliding(error, rate)
        terms = 300.0 * law.amplification(error, share * law.position_limits) @ error**2
        terms += law.amplification(s, share * law.surface_limits) @ s**2
        shrinking = (share - 1) / share / 0.2
        slope = (forward - back) / (2 * step)
        assert slope <= -(12.0 - shrinking) * terms * (1 - 1e-3) + 1e-4


def test_limits_hold_where_tdc_leaves_them():
    """A constant disturbance of 8 rad/s² takes TDC's error to 8/144; the barrier ends where its own force balances."""
    options: dict[str, Any] = {
        "position_limit": 0.03,
        "velocity_limit": 1.0,
        "max_amplification": 1e6,
        "barrier_gain": 200.0,
    }
    law = make_law(laws.BarrierTDARC, joints=1, **options)
    _, plain, _ = simulate_double_integrator(make_law(laws.TDC, joints=1), [0.0], [0.0], 2.0, disturbance=8.0)
    _, q, v = simulate_double_integrator(law, [0.0], [0.0], 2.0, disturbance=8.0)
    assert plain[-1, 0] == pytest.approx(8.0 / 144.0, rel=1e-3)
    assert np.abs(q).max() < 0.03
    assert np.abs(v).max() < 1.0
    e = q[-1, 0]
    beta1, beta2 = 1 / (1 - (e / 0.03) ** 2), 1 / (1 - (12.0 * e / (1.0 - 12.0 * 0.03)) ** 2)
    assert 144.0 * e + 200.0 * beta1 / beta2 * e == pytest.approx(8.0, rel=1e-3)


def test_limits_shrink_and_the_error_with_them():
    options: dict[str, Any] = {"position_limit": 0.01, "velocity_limit": 0.5, "initial_scale": 10.0, "decay_time": 0.3}
    law = make_law(laws.BarrierTDARC, joints=1, barrier_gain=100.0, **options)
    times, q, _ = simulate_double_integrator(law, [0.09], [0.0], 2.0)
    limits = 0.01 * (1 + 9.0 * np.exp(-times / 0.3))
    assert np.all(np.abs(q[:, 0]) < limits)
    state, signals = law.robust_init(), {}
    for _ in range(300):
        state, _, signals = law.robust(state, tracking_at([0.009], [0.0]))
    assert state.widening == pytest.approx(np.exp(-1.0), rel=1e-9)
    assert signals["outside_limits"] == 0


def test_outside_it_saturates_continuously_and_says_so():
    options: dict[str, Any] = {
        "position_limit": 0.03,
        "velocity_limit": 1.0,
        "barrier_gain": 200.0,
        "max_amplification": 4.0,
    }
    law = make_law(laws.BarrierTDARC, joints=1, **options)
    errors = np.linspace(-0.2, 0.2, 801)
    outputs = [law.robust(law.robust_init(), tracking_at([e], [-12.0 * e]))[1:] for e in errors]
    correction = np.array([value[0] for value, _ in outputs])
    assert np.abs(np.diff(correction)).max() < 4.0 * 200.0 * 5e-4 * 10
    np.testing.assert_allclose(correction[[0, -1]], [4 * 200 * 0.2, -4 * 200 * 0.2])
    counts = np.array([signals["outside_limits"] for _, signals in outputs])
    np.testing.assert_array_equal(counts > 0, np.abs(errors) >= 0.03)
    far = law.robust(law.robust_init(), tracking_at([1e6], [-1e6]))
    assert np.all(np.isfinite(far[1]))
    assert far[2]["outside_limits"] == 1


def test_gains_reach_their_balance():
    """At constant ‖η‖ and ‖ξ‖ the gains end at a0 ‖η‖/μ and a1 ‖η‖ ‖ξ‖/μ."""
    rates: dict[str, Any] = {"adaptation_rate": 30.0, "state_adaptation_rate": 50.0, "leakage": 10.0}
    law = make_law(laws.BarrierTDARC, joints=1, **rates)
    state = law.robust_init()
    correction = None
    for _ in range(1000):
        state, correction, _ = law.robust(state, tracking_at([0.01], [0.05]))
    surface = law.surface_limits[0]
    eta = 0.17 / (1 - (0.17 / surface) ** 2)
    assert state.constant_gain == pytest.approx(30.0 * eta / 10.0, rel=1e-4)
    assert state.state_gain == pytest.approx(50.0 * eta * 0.13 / 10.0, rel=1e-4)
    gain = state.constant_gain + 0.13 * state.state_gain
    assert correction == pytest.approx(-gain * eta / 0.2)


def test_tracks_better_than_tdc_under_friction():
    gains: dict[str, Any] = {
        "barrier_gain": 50.0,
        "adaptation_rate": 200.0,
        "position_limit": 0.01,
        "velocity_limit": 0.5,
    }
    plain = simulate_arm(make_law(laws.TDC, inertia=SMALL_INERTIA))
    robust = simulate_arm(make_law(laws.BarrierTDARC, inertia=SMALL_INERTIA, **gains))
    assert robust.status.completed
    assert robust.metrics(start_time=1.0)["rms_error"] < 0.8 * plain.metrics(start_time=1.0)["rms_error"]
    assert robust.metrics()["peak_torque"] < 60.0


def test_loop_at_zero_error():
    """It is that of TDC with K1 + κ + Λ ĉ/ε and K2 + ĉ/ε, at the final limits."""
    law = make_law(laws.BarrierTDARC, barrier_gain=60.0, initial_scale=3.0, boundary_layer=0.4)
    plain = make_law(
        laws.TDC,
        natural_frequency=None,
        position_gain=144.0 + 60.0 + 12.0 * 1.5 / 0.4,
        velocity_gain=24.0 + 1.5 / 0.4,
    )
    adaptive, expected = (certificates.certify_constant_ratio(candidate, 0.08, gain=1.5) for candidate in (law, plain))
    assert (adaptive.verdict, adaptive.margin) == (expected.verdict, pytest.approx(expected.margin, abs=1e-9))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"position_limit": 0.0}, r"position_limit: got \[0.0, 0.0\]; each must be above 0"),
        ({"position_limit": 0.3}, r"velocity_limit: got 3.0; needs more than \|½ K2\| position_limit, 3.6"),
        ({"barrier_gain": -1.0}, "barrier_gain: got -1"),
        ({"leakage": 0.0}, "leakage: got 0"),
        ({"leakage": 1000.0}, "leakage: got 1000 1/s; needs less than one over the period, 1000 1/s"),
        ({"initial_scale": 0.5}, "initial_scale: got 0.5"),
        ({"max_amplification": 1.0}, "max_amplification: got 1"),
        ({"initial_scale": 10.0, "decay_time": 0.05}, "decay_time: got 0.05 s, with which the limits shrink at 18 1/s"),
        ({"max_gain": -1.0}, "max_gain: got -1"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.BarrierTDARC, **options)
