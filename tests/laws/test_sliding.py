"""Sliding mode: when it reaches the layer, and what it gains on friction."""

import numpy as np
import pytest

from law_catalogue import make_law
from law_runs import SMALL_INERTIA, simulate_arm, simulate_double_integrator
from tarc import laws
from tarc.core.errors import InvalidParameter


def test_reaches_the_layer_in_closed_form():
    """ṡ = −λ s − ϱ s/‖s‖ on an ideal double integrator with damping 1."""
    law = make_law(laws.SlidingMode, gain=8.0, boundary_layer=0.05, natural_frequency=3.0, period=1e-4)
    times, q, v = simulate_double_integrator(law, [0.4, -0.3], [1.0, 0.5], 0.5)
    size = np.linalg.norm(v + 3.0 * q, axis=1)
    reached = times[np.argmax(size <= law.boundary_layer)]
    assert reached == pytest.approx(np.log((3.0 * size[0] + 8.0) / (3.0 * law.boundary_layer + 8.0)) / 3.0, rel=2e-3)
    assert 0 < reached < size[0] / law.gain
    assert np.all(np.diff(size[size > law.boundary_layer]) < 0)


def test_stays_in_the_layer_under_any_disturbance_below_the_gain():
    law = make_law(laws.SlidingMode, gain=8.0, boundary_layer=0.05, natural_frequency=3.0, period=1e-4)
    _, q, v = simulate_double_integrator(law, [0.0, 0.0], [0.0, 0.0], 1.0, disturbance=5.0)  # ‖(5, 5)‖ < 8
    assert np.linalg.norm(v + 3.0 * q, axis=1).max() < law.boundary_layer


def test_tracks_better_than_tdc_under_friction():
    plain, robust = (
        simulate_arm(make_law(laws.TDC, inertia=SMALL_INERTIA)),
        simulate_arm(make_law(laws.SlidingMode, inertia=SMALL_INERTIA)),
    )
    assert robust.status.completed
    assert robust.metrics(start_time=1.0)["rms_error"] < 0.6 * plain.metrics(start_time=1.0)["rms_error"]
    assert robust.metrics()["peak_torque"] < 60.0
    np.testing.assert_array_equal(robust.data["gain"], 5.0)


def test_bad_gain():
    with pytest.raises(InvalidParameter, match="gain: got -1; needs a finite number of at least 0"):
        make_law(laws.SlidingMode, gain=-1.0)
