"""The gain that only grows."""

import numpy as np
import pytest

from law_catalogue import make_law
from law_runs import SMALL_INERTIA, simulate_arm, tracking_at
from tarc import laws
from tarc.core.errors import InvalidParameter


def test_gain_is_the_integral_of_the_distance():
    law = make_law(laws.MonotoneASMC, adaptation_rate=40.0, dead_zone=0.1, initial_gain=1.0)
    sizes = np.array([0.3, 0.1, 0.05, 0.4, 0.11])
    state = law.robust_init()
    for size in sizes:
        state = law.robust(state, tracking_at([0.0, 0.0], [size, 0.0]))[0]
    assert state.gain == pytest.approx(1.0 + law.period * 40.0 * (0.3 + 0.4 + 0.11), rel=1e-12)


@pytest.mark.parametrize("max_gain", [None, 0.8])
def test_never_falls_and_beats_tdc_under_friction(max_gain):
    law = make_law(laws.MonotoneASMC, inertia=SMALL_INERTIA, max_gain=max_gain)
    plain, robust = simulate_arm(make_law(laws.TDC, inertia=SMALL_INERTIA)), simulate_arm(law)
    gain = robust.data["gain"].values
    assert robust.status.completed
    assert np.all(np.diff(gain) >= 0)
    assert gain[-1] == 0.8 if max_gain else gain[-1] > 0.8
    assert robust.metrics(start_time=1.0)["rms_error"] < 0.9 * plain.metrics(start_time=1.0)["rms_error"]
    assert robust.metrics()["peak_torque"] < 60.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"adaptation_rate": 0.0}, "adaptation_rate: got 0; needs a finite number above 0"),
        ({"dead_zone": -1.0}, "dead_zone: got -1; needs a finite number of at least 0"),
        ({"initial_gain": -1.0}, "initial_gain: got -1"),
        ({"initial_gain": 2.0, "max_gain": 1.0}, "max_gain: got 1; needs at least the initial gain 2"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.MonotoneASMC, **options)
