"""What the laws with a switching term share: surface, layer, gain zero, life without time-delay estimation."""

from typing import Any

import numpy as np
import pytest

from law_catalogue import concrete_laws, make_law
from law_runs import SMALL_INERTIA, assert_equals_tdc, simulate_arm, tracking_at
from tarc import certificates, estimators, laws
from tarc.core.errors import InvalidParameter

NO_GAIN: dict[Any, dict[str, Any]] = {
    laws.SlidingMode: {"gain": 0.0},
    laws.ASMC: {"initial_gain": 0.0, "max_gain": 0.0},
    laws.MonotoneASMC: {"initial_gain": 0.0, "max_gain": 0.0},
}
every_switching_law = pytest.mark.parametrize("kind", NO_GAIN, ids=lambda kind: kind.__name__)


def test_all_are_here():
    assert set(NO_GAIN) == {kind for kind in concrete_laws() if issubclass(kind, laws.Switching)}


@every_switching_law
def test_without_gain_it_is_tdc(kind):
    assert_equals_tdc(kind, **NO_GAIN[kind])


@every_switching_law
def test_without_gain_and_estimation_it_is_pole_placement(kind):
    law = make_law(kind, time_delay=False, **NO_GAIN[kind])
    state, value = law.example()
    _, output = law.step(state, value._replace(reference=np.array([0.1, -0.2]), acceleration_reference=np.ones(2)))
    np.testing.assert_allclose(output.torque, law.M @ (np.ones(2) + law.K1 @ [0.1, -0.2]), rtol=1e-12)


@every_switching_law
def test_switching_term(kind):
    """Of the size of the gain outside the layer, against s; inside it proportional to s."""
    law = make_law(kind, boundary_layer=0.1, surface_slope=3.0)
    state = law.robust_init()._replace(gain=np.array(7.0))
    far, near = tracking_at([0.1, -0.2], [1.0, 0.5]), tracking_at([0.01, 0.0], [0.0, 0.02])
    s = np.array([1.3, -0.1])
    np.testing.assert_allclose(law.robust(state, far)[1], -7.0 * s / np.linalg.norm(s), rtol=1e-12)
    np.testing.assert_allclose(law.robust(state, near)[1], -7.0 * np.array([0.03, 0.02]) / 0.1, rtol=1e-12)


@every_switching_law
def test_default_surface_is_the_double_pole(kind):
    np.testing.assert_allclose(make_law(kind, natural_frequency=[7.0, 9.0]).Lambda, np.diag([7.0, 9.0]))


@every_switching_law
def test_gain_rests_after_a_fault(kind):
    law = make_law(kind)
    state = law.robust_init()._replace(gain=np.array(3.0))
    np.testing.assert_array_equal(law.robust(state, tracking_at([1.0, 1.0], [1.0, 1.0], fault=True))[0].gain, 3.0)


@every_switching_law
def test_needs_no_acceleration_alone(kind):
    make_law(kind, time_delay=False, estimator=estimators.Algebraic(window=0.008, degree=1))


@every_switching_law
@pytest.mark.parametrize("time_delay", [True, False])
def test_loop_certificate_has_a_verdict(kind, time_delay):
    certificate = certificates.certify_constant_ratio(make_law(kind, time_delay=time_delay), 0.08)
    assert certificate.verdict == "certified"
    plain = certificates.certify_constant_ratio(make_law(laws.TDC), 0.08)
    assert not time_delay or certificate.margin == pytest.approx(plain.margin, abs=1e-9)


def test_inside_the_layer_it_is_tdc_with_larger_gains():
    """With ϱ/ε on K2 and λ ϱ/ε on K1."""
    law = make_law(laws.SlidingMode, gain=0.0, boundary_layer=0.25, surface_slope=8.0)
    state = law.robust_init()._replace(gain=np.array(5.0))
    stiff = make_law(laws.TDC, natural_frequency=None, position_gain=144.0 + 8.0 * 20.0, velocity_gain=24.0 + 20.0)
    tracking = tracking_at([0.002, -0.001], [0.03, 0.05])
    u = law.feedback(tracking) + law.robust(state, tracking)[1]
    np.testing.assert_allclose(u, stiff.feedback(tracking), rtol=1e-12)


@every_switching_law
def test_holds_the_arm_against_gravity_alone(kind):
    """Without time-delay estimation and without gravity compensation the switching term alone brings the arm down to a
    fraction of the error that pole placement leaves.
    """
    enough: dict[Any, dict[str, Any]] = {
        laws.SlidingMode: {"gain": 60.0},
        laws.ASMC: {"adaptation_rate": 100.0, "threshold": 0.3},
        laws.MonotoneASMC: {"adaptation_rate": 100.0, "dead_zone": 0.3},
    }
    common: dict[str, Any] = {
        "inertia": 6 * SMALL_INERTIA,
        "natural_frequency": 10.0,
        "boundary_layer": 2.0,
        "time_delay": False,
    }
    runs = [simulate_arm(make_law(kind, **common, **options)) for options in (NO_GAIN[kind], enough[kind])]
    assert all(run.status.completed for run in runs)
    errors = [run.metrics(start_time=2.0)["rms_error"] for run in runs]
    assert errors[1] < errors[0] / 3
    assert runs[1].metrics()["peak_torque"] < 100.0


@every_switching_law
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"boundary_layer": 0.0}, "boundary_layer: got 0; needs a finite number above 0"),
        ({"surface_slope": -1.0}, "surface_slope: got -1; needs a finite number above 0"),
    ],
)
def test_bad_parameters(kind, options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(kind, **options)
