"""Ideal velocity feedback against a second writing and the poles that it should give."""

import numpy as np
import pytest

from law_catalogue import make_law
from law_runs import SMALL_INERTIA, assert_equals_tdc, simulate_arm, tracking_at
from tarc import certificates, estimators, laws
from tarc.analysis.linearise import decoupled_channels
from tarc.core.errors import InvalidParameter


def test_without_its_gain_it_is_tdc():
    assert_equals_tdc(laws.IVF, ideal_velocity_gain=0.0, max_correction=1.0)


def test_equals_second_writing():
    """The torques of a run again, from its records: the ideal velocity as one sum over all the past."""
    law = make_law(laws.IVF, inertia=SMALL_INERTIA, ideal_velocity_gain=6.0)
    data = simulate_arm(law, duration=1.0).data
    q, qd, dqd, ddqd, v = (
        data[name].values
        for name in (
            "measured_position",
            "reference",
            "velocity_reference",
            "acceleration_reference",
            "velocity_estimate",
        )
    )
    nominal = ddqd - (v - dqd) @ law.K2.T - (q - qd) @ law.K1.T
    ideal = law.period * np.concatenate([np.zeros((1, 2)), np.cumsum(nominal, axis=0)[:-1]])
    np.testing.assert_allclose(data["ideal_velocity"], ideal, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(data["auxiliary"], nominal + 6.0 * (ideal - v), rtol=1e-9, atol=1e-7)


def test_adds_a_pole_at_its_gain():
    """With all but perfect time-delay estimation the poles are −ωn, −ωn and −Γ."""
    law = laws.IVF(
        inertia=0.1,
        natural_frequency=10.0,
        damping_ratio=1.25,  # poles at -5 and -20
        ideal_velocity_gain=12.0,
        period=1e-5,
        synchronised=True,
        estimator=estimators.Algebraic(window=2e-5, degree=2),
    )
    (channel,) = decoupled_channels(law)
    values = np.asarray(np.linalg.eigvals(channel.state_matrix(1.0)), dtype=complex)
    slow = np.sort(np.real(np.log(values[np.abs(values) > 0.9]))) / law.period
    np.testing.assert_allclose(slow, [-20.0, -12.0, -5.0], rtol=2e-3)


def test_cap_limits_the_term_and_the_integral():
    law = make_law(laws.IVF, ideal_velocity_gain=4.0, max_correction=2.0)
    state, corrections = law.robust_init(), []
    for error in [0.5] * 50 + [-0.05] * 50:
        state, correction, _ = law.robust(state, tracking_at([error, 0.0], [0.0, 0.0]))
        corrections.append(correction[0])
    assert min(corrections) == -2.0
    assert corrections[52] > -2.0, "it leaves the limit as soon as the error changes sign"
    np.testing.assert_array_equal(law.robust(state, tracking_at([1.0, 1.0], [0.0, 0.0], fault=True))[0], state)


def test_tracks_better_than_tdc_under_friction():
    plain, robust = (
        simulate_arm(make_law(laws.TDC, inertia=SMALL_INERTIA)),
        simulate_arm(make_law(laws.IVF, inertia=SMALL_INERTIA)),
    )
    assert robust.status.completed
    assert robust.metrics(start_time=1.0)["rms_error"] < 0.6 * plain.metrics(start_time=1.0)["rms_error"]
    assert robust.metrics()["peak_torque"] < 60.0


def test_loop_certificate_sees_its_gain():
    verdicts = [
        certificates.certify_constant_ratio(make_law(laws.IVF, ideal_velocity_gain=gain), 0.08).verdict
        for gain in (10.0, 400.0)
    ]
    assert verdicts == ["certified", "refuted"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ideal_velocity_gain": -1.0}, "ideal_velocity_gain: got -1; needs a finite number of at least 0"),
        ({"max_correction": 0.0}, "max_correction: got 0; needs a finite number above 0"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.IVF, **options)
