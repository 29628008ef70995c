"""Internal model control on time-delay estimation: ideal velocity feedback, but for limits and delays of the torque."""

import numpy as np
import pytest

from law_catalogue import make_law
from law_runs import SMALL_INERTIA, assert_equals_tdc, simulate_arm
from tarc import certificates, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter


def test_with_an_endless_filter_it_is_tdc():
    assert_equals_tdc(laws.TDCIM, time_constant=1e15)


@pytest.mark.parametrize("options", [{}, {"delay": 0.003}, {"synchronised": True}])
def test_without_a_limit_it_is_ideal_velocity_feedback(options):
    given = {"inertia": SMALL_INERTIA, "natural_frequency": 6.0, **options}
    model = simulate_arm(make_law(laws.TDCIM, time_constant=0.2, **given), duration=1.0)
    ideal = simulate_arm(make_law(laws.IVF, ideal_velocity_gain=5.0, **given), duration=1.0)
    assert model.status.completed
    np.testing.assert_allclose(model.data["model_velocity"], ideal.data["ideal_velocity"], rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(model.data["torque"], ideal.data["torque"], rtol=1e-6, atol=1e-6)


def overshoot(law):
    """Of the first joint, after a motion that its torque limit does not allow; and whether the run completed."""
    step = signals.Quintic(points=[[-1.5, 0.0], [0.0, 0.0]], times=[0.2, 0.5])
    data = (run := simulate(plants.TwoLinkArm(), law, step, 3.0, initial_torque="rest")).data
    assert (np.abs(data["torque"].values[:, 0]) == 45.0).any(), "the limit is reached"
    return float((data["position"] - data["reference"]).values[500:, 0].max()), run.status.completed


def test_nothing_winds_up_at_a_limit():
    """The integral of ideal velocity feedback runs off, unless it has a cap; the model sees the limit."""
    given = {"inertia": SMALL_INERTIA, "torque_limit": [45.0, 20.0]}
    far, completed = overshoot(make_law(laws.IVF, ideal_velocity_gain=10.0, **given))
    assert far > 1.0
    assert not completed
    for law in (
        make_law(laws.TDCIM, **given),
        make_law(laws.IVF, ideal_velocity_gain=10.0, max_correction=5.0, **given),
    ):
        far, completed = overshoot(law)
        assert far < 2e-3
        assert completed


def test_tracks_better_than_tdc_under_friction():
    plain, robust = (
        simulate_arm(make_law(laws.TDC, inertia=SMALL_INERTIA)),
        simulate_arm(make_law(laws.TDCIM, inertia=SMALL_INERTIA)),
    )
    assert robust.status.completed
    assert robust.metrics(start_time=1.0)["rms_error"] < 0.6 * plain.metrics(start_time=1.0)["rms_error"]
    assert robust.metrics()["peak_torque"] < 60.0


@pytest.mark.parametrize("ratio", [0.08, 0.2])
def test_loop_certificate_is_that_of_ideal_velocity_feedback(ratio):
    model = certificates.certify_constant_ratio(make_law(laws.TDCIM, time_constant=0.1), ratio)
    ideal = certificates.certify_constant_ratio(make_law(laws.IVF, ideal_velocity_gain=10.0), ratio)
    assert model.verdict == ideal.verdict
    assert model.margin == pytest.approx(ideal.margin, abs=1e-8)


def test_bad_time_constant():
    with pytest.raises(InvalidParameter, match="time_constant: got 0.0001 s; needs at least the period 0.001 s"):
        make_law(laws.TDCIM, time_constant=1e-4)
