"""Adaptive gains under a state-dependent bound: by hand, against TDC and a fixed gain, with M̂(q)."""

from typing import Any

import numpy as np
import pytest

from law_catalogue import make_law
from law_runs import SMALL_INERTIA, assert_equals_tdc, simulate_arm, tracking_at
from tarc import Controller, NominalInertia, certificates, laws, plants
from tarc.core.errors import InvalidParameter

RATES: dict[str, Any] = {"rise_rate": 40.0, "fall_rate": 10.0, "state_rise_rate": 8.0, "state_fall_rate": 2.0}


def at(error, rate, acceleration):
    """Return what the law reads at this error, rate and acceleration of one joint."""
    tracking = tracking_at([error], [rate])
    return tracking._replace(estimate=tracking.estimate._replace(acceleration=np.array([acceleration])))


def test_without_gains_it_is_tdc():
    rates = dict.fromkeys(RATES, 1e-30)
    assert_equals_tdc(laws.TDARC, min_gain=1e-30, **rates)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_gains_move_by_hand(sign):
    """Λ = 12: e = 0.01, ė = 0.05 give s = 0.17, ‖ξ‖ = 0.13, and ŝ' = a + 12 · 0.05."""
    law = make_law(laws.TDARC, joints=1, initial_gain=1.0, **RATES)
    state = law.robust_init()._replace(state_gain=np.array(0.5))
    rising, _, signals = law.robust(state, at(sign * 0.01, sign * 0.05, sign * -0.5))
    falling, _, _ = law.robust(state, at(sign * 0.01, sign * 0.05, sign * -0.7))
    assert signals["gain"] == pytest.approx(1.0 + 0.5 * 0.13)
    assert rising.constant_gain == pytest.approx(1.0 + 1e-3 * 40.0 * 0.17)
    assert rising.state_gain == pytest.approx(0.5 + 1e-3 * 8.0 * 0.17 * 0.13)
    assert falling.constant_gain == pytest.approx(1.0 - 1e-3 * 10.0 * 0.17)
    assert falling.state_gain == pytest.approx(0.5 - 1e-3 * 2.0 * 0.17 * 0.13)


def test_gains_stop_at_their_limits_and_rise_from_the_least():
    law = make_law(laws.TDARC, joints=1, max_gain=1.0, max_state_gain=0.2, **RATES)
    lowest = law.robust_init()._replace(constant_gain=np.array(0.01))
    state, _, _ = law.robust(lowest, at(0.01, 0.05, -0.7))
    assert state.constant_gain > 0.01
    assert state.state_gain > 0.0
    correction = None
    for _ in range(1200):
        state, correction, signals = law.robust(state, at(0.1, 0.5, 1.0))
        assert signals["gain"] <= 1.0
    assert (state.constant_gain, state.state_gain) == (1.0, 0.2)
    assert correction == pytest.approx(-1.0)
    for _ in range(500):
        state, _, _ = law.robust(state, at(0.1, 0.5, -30.0))
    assert state.constant_gain == pytest.approx(0.01, abs=0.1)


def test_a_fault_holds_the_gains():
    law = make_law(laws.TDARC, joints=1, **RATES)
    state = law.robust_init()
    assert law.robust(state, at(0.1, 0.5, 1.0)._replace(fault=np.array(1.0)))[0] == state


def test_tracks_better_than_tdc_under_friction():
    plain = simulate_arm(make_law(laws.TDC, inertia=SMALL_INERTIA))
    robust = simulate_arm(make_law(laws.TDARC, inertia=SMALL_INERTIA, rise_rate=400.0, fall_rate=200.0, max_gain=20.0))
    assert robust.status.completed
    assert robust.metrics(start_time=1.0)["rms_error"] < 0.3 * plain.metrics(start_time=1.0)["rms_error"]
    assert robust.metrics()["peak_torque"] < 60.0


@pytest.mark.parametrize("kind", [laws.TDARC, laws.BarrierTDARC])
def test_runs_with_a_model_alike_in_simulation_and_controller(kind):
    arm = plants.TwoLinkArm()
    law = make_law(kind, inertia=NominalInertia(arm, 0.05, gravity=True, coriolis=True))
    run = simulate_arm(law, duration=0.4)
    assert run.status.completed
    columns = ("measured_position", "reference", "velocity_reference", "acceleration_reference")
    samples = zip(*(run.data[name].values for name in columns), strict=True)
    controller = Controller(law)
    controller.reset(run.data["measured_position"].values[0], arm.gravity_torque(run.data["reference"].values[0]))
    torques = np.array([controller.step(*row).copy() for row in samples])
    np.testing.assert_allclose(torques, run.data["torque"].values, rtol=1e-7, atol=1e-7)


def test_loop_in_the_layer_is_that_of_a_fixed_gain():
    """It is that of `SlidingMode`: ĉ/ε adds to K2, and Λ ĉ/ε to K1, whatever K̂1 is."""
    law = make_law(laws.TDARC, boundary_layer=0.4)
    fixed = make_law(laws.SlidingMode, boundary_layer=0.4, gain=1.5)
    adaptive, expected = (certificates.certify_constant_ratio(candidate, 0.08, gain=1.5) for candidate in (law, fixed))
    assert adaptive.verdict == expected.verdict == "certified"
    assert adaptive.margin == pytest.approx(expected.margin, abs=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rise_rate": 0.0}, "rise_rate: got 0; needs a finite number above 0"),
        ({"state_fall_rate": -1.0}, "state_fall_rate: got -1"),
        ({"boundary_layer": 0.0}, "boundary_layer: got 0"),
        ({"min_gain": 0.0}, "min_gain: got 0"),
        ({"initial_gain": 2.0, "max_gain": 1.0}, "max_gain: got 1; needs at least the initial gain 2"),
        ({"max_state_gain": -1.0}, "max_state_gain: got -1"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.TDARC, **options)
