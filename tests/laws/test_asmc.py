"""Adaptive sliding mode with a threshold, against the printed law of its gain."""

import numpy as np
import pytest

from law_catalogue import make_law
from law_runs import SMALL_INERTIA, simulate_arm, tracking_at
from tarc import laws
from tarc.core.errors import InvalidParameter


def gains_after_steps(law, sizes, start):
    """Return the gain before each of the steps at which ‖s‖ has these sizes, and after the last."""
    state, result = law.robust_init()._replace(gain=np.array(start)), [start]
    for size in sizes:
        state = law.robust(state, tracking_at([0.0, 0.0], [0.0, size]))[0]
        result.append(float(state.gain))
    return np.array(result)


def test_slope_is_the_speed_up_and_down():
    law = make_law(laws.ASMC, adaptation_rate=30.0, threshold=0.2, min_gain=0.5)
    slopes = np.diff(gains_after_steps(law, [0.3, 5.0, 0.2, 0.19, 0.0, 0.3], 4.0)) / law.period
    np.testing.assert_allclose(slopes, [30.0, 30.0, 30.0, -30.0, -30.0, 30.0], rtol=1e-9)


def test_slope_of_the_origin_is_scaled_by_the_distance():
    law = make_law(laws.ASMC, adaptation_rate=30.0, threshold=0.2, min_gain=0.5, scale_by_error=True)
    slopes = np.diff(gains_after_steps(law, [0.3, 5.0, 0.1], 4.0)) / law.period
    np.testing.assert_allclose(slopes, [9.0, 150.0, -3.0], rtol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_below_the_floor_it_rises_at_the_rate_printed(size):
    law = make_law(laws.ASMC, adaptation_rate=30.0, threshold=0.2, min_gain=0.5)
    slopes = np.diff(gains_after_steps(law, [size] * 5, 0.1)) / law.period
    np.testing.assert_allclose(slopes, 0.5, rtol=1e-9)


def test_falls_to_the_floor_and_not_below():
    law = make_law(laws.ASMC, adaptation_rate=30.0, threshold=0.2, min_gain=0.5)
    gains = gains_after_steps(law, [0.0] * 100, 1.0)
    assert gains.min() == 0.5
    assert gains[20:].max() == pytest.approx(0.5 * (1 + law.period)), "lifted by T γ̄ and taken back"


def test_cap():
    law = make_law(laws.ASMC, adaptation_rate=30.0, threshold=0.2, max_gain=2.0)
    assert gains_after_steps(law, [1.0] * 100, 1.9)[-1] == 2.0


def test_rises_although_the_error_shrinks():
    """What the paper holds against it, and TARC does not do."""
    asmc, tarc = (
        make_law(laws.ASMC, threshold=0.01),
        make_law(laws.TARC, initial_gain=5.0, rise_rate=10.0, fall_rate=10.0),
    )
    adaptive, tarc_state = asmc.robust_init(), tarc.robust_init()
    for size in np.linspace(1.0, 0.1, 20):
        tracking = tracking_at([0.0, size], [0.0, 0.0])
        before, adaptive = adaptive.gain, asmc.robust(adaptive, tracking)[0]
        assert adaptive.gain > before
        before, tarc_state = tarc_state.gain, tarc.robust(tarc_state, tracking)[0]
        assert tarc_state.gain < before or size == 1.0


@pytest.mark.parametrize("scale_by_error", [False, True])
def test_tracks_better_than_tdc_under_friction(scale_by_error):
    """Alike where the gain moves; how much it gives hangs on the threshold."""
    adaptive = make_law(
        laws.ASMC,
        inertia=SMALL_INERTIA,
        threshold=0.03,
        adaptation_rate=200.0 if scale_by_error else 20.0,
        scale_by_error=scale_by_error,
    )
    plain, robust = simulate_arm(make_law(laws.TDC, inertia=SMALL_INERTIA)), simulate_arm(adaptive)
    assert robust.status.completed
    assert robust.metrics(start_time=1.0)["rms_error"] < 0.95 * plain.metrics(start_time=1.0)["rms_error"]
    assert robust.metrics()["peak_torque"] < 60.0
    assert robust.data["gain"].values.min() >= adaptive.min_gain


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"adaptation_rate": 0.0}, "adaptation_rate: got 0; needs a finite number above 0"),
        ({"threshold": 0.0}, "threshold: got 0; needs a finite number above 0"),
        ({"min_gain": 0.0}, "min_gain: got 0; needs a finite number above 0"),
        ({"initial_gain": -1.0}, "initial_gain: got -1"),
        ({"max_gain": 0.001}, "max_gain: got 0.001; needs at least the initial gain 0.02"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.ASMC, **options)
