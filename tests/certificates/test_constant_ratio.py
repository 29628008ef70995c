"""The constant-ratio certificate against loops written by hand, simulations, and known limits."""

from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from law_catalogue import KNOWN_RANGES, agrees_to_digits, make_law, make_tdc
from tampering import replaced, reread, scaled, without
from tarc import estimators, laws, plants, signals
from tarc.analysis import h2_norm, hinf_norm, stable_interval, stable_intervals
from tarc.analysis.linearise import decoupled_channels
from tarc.certificates import certify_constant_ratio
from tarc.control.digital_controller import DigitalController
from tarc.core.errors import InvalidParameter, NoStableRatio, UnsupportedLaw
from tarc.simulation.closed_loop import ClosedLoop, LoopInput
from tarc.stored_certificates import certificate_from_dict, certificate_from_json


def tdc(window=10, synchronised=False, natural_frequency: Any = 10.0, joints=1, **options):
    return make_tdc(window, synchronised, natural_frequency, 0.1 * np.eye(joints), **options)


@pytest.mark.parametrize(("window", "synchronised", "low", "high"), KNOWN_RANGES)
def test_known_intervals(window, synchronised, low, high):
    found = stable_interval(tdc(window, synchronised))
    assert agrees_to_digits(found[0], low)
    assert agrees_to_digits(found[1], high)


def test_degree_three_averages_with_both_signs_and_reaches_less_far():
    """Σ|c_j| is about 2.2 for degree 3, and the upper limits lie near 1.7 for short windows; degree 2 has no signs."""
    for window in (5, 10, 20):
        estimator = estimators.Algebraic(window=window * 1e-3, degree=3)
        weights = estimator.with_period(1e-3).matched_torque_filter().weights
        assert np.sum(weights) == pytest.approx(1.0)
        assert 2.1 < np.sum(np.abs(weights)) < 2.35
        law = laws.TDC(inertia=0.1, natural_frequency=10.0, period=1e-3, estimator=estimator, synchronised=True)
        assert 1.65 < stable_interval(law)[1] < 1.85
        even = estimators.Algebraic(window=window * 1e-3, degree=2).with_period(1e-3).matched_torque_filter().weights
        assert np.all(even > 0)


def hand_poles(ratio, window, k1, k2, T=1e-3):
    """Characteristic polynomial of literal TDC on q̈ = ρ v, written out: poles in z.

    v = v/z − K1 q − K2 W1(z) q − W2(z) q / z, and q = ρ T² (z + 1) / (2 (z − 1)²) v.
    """
    age = -np.arange(window + 1) * T
    fit = np.linalg.pinv(np.vander(age, 3, increasing=True))
    w1, w2 = fit[1], 2 * fit[2]
    # times z^(window+1): v (z − 1) z^window = −[(K1 + K2 W1) z^(window+1) + W2 z^window] q
    side = np.zeros(window + 2)
    side[: window + 1] += k2 * w1
    side[0] += k1
    side[1:] += w2
    own = np.polymul([1.0, -1.0], np.eye(window + 1)[0])
    plant_top, plant_bottom = ratio * T**2 / 2 * np.array([1.0, 1.0]), np.array([1.0, -2.0, 1.0])
    return np.roots(np.polyadd(np.polymul(own, plant_bottom), np.polymul(side, plant_top)))


@pytest.mark.parametrize("ratio", [0.004, 0.02, 0.08, 0.2, 0.3])
@pytest.mark.parametrize("window", [2, 5, 10])
def test_spectral_radius_is_that_of_the_polynomial_written_by_hand(ratio, window):
    certificate = certify_constant_ratio(tdc(window), ratio)
    radius = np.max(np.abs(hand_poles(ratio, window, 100.0, 20.0)))
    # repeated poles near zero and near one make the polynomial's roots the less exact of the two
    assert certificate.evidence.findings.spectral_radius == pytest.approx(radius, rel=1e-6)


@settings(max_examples=20)
@given(
    window=st.integers(2, 15),
    natural_frequency=st.floats(2.0, 60.0),
    ratio=st.floats(0.003, 3.0),
    synchronised=st.booleans(),
    delay=st.integers(0, 2),
)
def test_certified_decays_and_refuted_grows(window, natural_frequency, ratio, synchronised, delay):
    """In the simulated loop itself, run until its slowest mode has shown which way it goes."""
    law = tdc(window, synchronised, natural_frequency)
    certificate = certify_constant_ratio(law, ratio, computation_delay=delay)
    assert certificate.verify()
    radius = certificate.evidence.findings.spectral_radius
    if certificate.verdict == "inconclusive" or abs(radius - 1) < 4e-3:
        return
    plant = plants.MassSpringDamper(masses=[0.1 / ratio], springs=[0.0], dampers=[0.0])
    closed = ClosedLoop(plant, DigitalController(signals.Encoder(), law, delay), 1)
    state = closed.init(np.array([1e-3]))
    zero = np.zeros(1)
    value = LoopInput(zero, zero, zero, zero, np.zeros((1, 1)), {})
    from tarc.core.tracing import CompiledStep, trace
    from tarc.core.trees import pack

    function, _ = trace(closed.step, state, value)
    run = CompiledStep(function)
    run.reset(pack(state))
    steps = int(min(40 / abs(np.log(radius)), 1e4))
    peaks = []
    for _ in range(4):
        largest = 0.0
        for _ in range(steps // 4):
            run.step()
            largest = max(largest, abs(run.output[0]))
        peaks.append(largest)
    # the last quarter against the first: some 30 time constants apart, with room for a transient
    if certificate.certified:
        assert peaks[3] < 1e-3 * peaks[0]
    else:
        assert peaks[3] > 1e3 * peaks[0] or not np.isfinite(peaks[3])


def test_many_joints_cost_and_give_what_one_does():
    one, many = certify_constant_ratio(tdc(), 0.08), certify_constant_ratio(tdc(joints=30), 0.08)
    assert many.to_dict()["evidence"] == one.to_dict()["evidence"]


@pytest.mark.parametrize("gain", [0.0, 4.0])
def test_decoupled_equals_the_full_matrices(gain):
    """Three joints with a full M̂: the eigenvalues of the coupled loop are those of one, each three times."""
    from tarc.analysis.linearise import _linearise

    mixed = 0.1 * (np.eye(3) + 0.3 * np.ones((3, 3)))
    law = make_law(laws.TARC, 3, inertia=mixed)
    full = _linearise(law, gain, (0, 1, 2)).state_matrix(0.08)
    (one,) = decoupled_channels(law, 0, gain)
    expected = np.repeat(np.linalg.eigvals(one.state_matrix(0.08)), 3)
    found = np.linalg.eigvals(full)
    # eigenvalues at zero come from delay lines, Jordan blocks whose rounding is the tenth root of the machine's
    sizes = [np.sort(np.abs(values)[np.abs(values) > 0.7]) for values in (expected, found)]
    np.testing.assert_allclose(sizes[0], sizes[1], atol=1e-4)


def test_different_bandwidths_are_different_loops():
    law = tdc(joints=3, natural_frequency=[10.0, 20.0, 10.0])
    assert [channel.joints for channel in decoupled_channels(law)] == [(0, 2), (1,)]
    slow, fast = (stable_interval(tdc(natural_frequency=natural_frequency)) for natural_frequency in (10.0, 20.0))
    both = stable_interval(law)
    assert both == pytest.approx((max(slow[0], fast[0]), min(slow[1], fast[1])), rel=1e-9)


def test_a_range_is_refuted_by_what_lies_inside_it():
    certificate = certify_constant_ratio(tdc(), (0.01, 0.5))
    assert certificate.verdict == "refuted"
    assert certificate.witness is not None
    assert 0.2616 < certificate.witness.ratio <= 0.5
    assert certify_constant_ratio(tdc(), (0.005, 0.26)).certified


def test_witness_is_the_mode_that_grows():
    certificate = certify_constant_ratio(tdc(), 1.0)
    assert certificate.verdict == "refuted"
    assert certificate.evidence.findings.spectral_radius == pytest.approx(1.152, abs=5e-4)
    assert certificate.witness is not None
    assert certificate.witness.growth_rate == pytest.approx(np.log(1.152) * 1e3, rel=5e-3)


def test_frozen_gain_limits():
    """The frozen limit on the slope αĉ/ε, literal N = 10 at ρ = 0.08: 2800 1/s²."""
    law = make_law(laws.TARC, natural_frequency=10.0, boundary_layer=0.01, estimator=estimators.Algebraic(window=0.010))
    assert certify_constant_ratio(law, 0.08, gain=0.01 * 2780).certified
    assert certify_constant_ratio(law, 0.08, gain=0.01 * 2820).verdict == "refuted"


def test_delay_margin_is_the_last_stable_delay():
    margin = certify_constant_ratio(tdc(), 0.08).evidence.findings.delay_margin
    assert margin is not None
    assert certify_constant_ratio(tdc(), 0.08, computation_delay=margin).certified
    assert not certify_constant_ratio(tdc(), 0.08, computation_delay=margin + 1).certified


def test_json_round_trip_verifies_and_tampering_shows():
    certificate = reread(certify_constant_ratio(tdc(), (0.01, 0.2)))
    assert certificate.certified
    assert certificate.verify()
    assert not scaled(certificate, "loops.0.B", 10).verify()
    assert not replaced(certificate, "loops", []).verify()
    for content in ({}, without(certificate, "loops"), without(certificate, "loops.0.B")):
        with pytest.raises(InvalidParameter, match="cannot read it"):
            certificate_from_dict(content)
    with pytest.raises(InvalidParameter, match="no JSON"):
        certificate_from_json("{")


def test_explains_itself_and_draws(tmp_path):
    text = certify_constant_ratio(tdc(), 1.0).explain()
    for part in ("Verdict: refuted", "Shown by: ratio 1, growth rate", "Assumed:", "zero"):
        assert part in text
    certify_constant_ratio(tdc(), (0.01, 0.2)).plot().savefig(tmp_path / "loop.png")


def random_system(seed, size=4, inputs=1, outputs=1):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(size, size))
    A *= 0.95 / np.max(np.abs(np.linalg.eigvals(A)))
    return A, rng.normal(size=(size, inputs)), rng.normal(size=(outputs, size)), rng.normal(size=(outputs, inputs))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (2, 2), (3, 1)])
def test_infinity_norm_is_the_peak_of_a_dense_sweep(seed, inputs, outputs):
    A, B, C, D = system = random_system(seed, inputs=inputs, outputs=outputs)
    z = np.exp(1j * np.linspace(0, np.pi, 20001))[:, None, None]
    sweep = np.linalg.norm(C @ np.linalg.solve(z * np.eye(4) - A, B + 0 * z) + D, 2, axis=(1, 2)).max()
    assert sweep <= hinf_norm(*system) <= sweep * (1 + 1e-4)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_norms_against_python_control(seed):
    system = random_system(seed, inputs=2, outputs=2)
    sampled = control.ss(*system, True)
    theirs = control.system_norm(sampled, p="inf", tol=1e-8)  # type: ignore[arg-type] - its stub knows numbers alone
    assert hinf_norm(*system) == pytest.approx(theirs, rel=1e-5)
    assert h2_norm(*system) == pytest.approx(control.system_norm(sampled, p=2), rel=1e-9)


def test_infinity_norm_finds_a_peak_between_grid_points():
    """A lightly damped mode that a coarse grid steps over."""
    r, angle = 1 - 1e-4, 1.2345678
    A = r * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    B, C, D = np.array([[1.0], [0.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))
    fine = angle + np.linspace(-1e-3, 1e-3, 20001)
    peak = max(abs((C @ np.linalg.solve(np.exp(1j * w) * np.eye(2) - A, B)).item()) for w in fine)
    assert hinf_norm(A, B, C, D) == pytest.approx(peak, rel=1e-5)


def test_norms_of_what_is_not_stable_are_infinite():
    grows = np.array([[1.01]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1))
    assert hinf_norm(*grows) == np.inf
    assert h2_norm(*grows) == np.inf


@pytest.mark.parametrize("norm", [hinf_norm, h2_norm])
def test_norms_refuse_what_is_no_system(norm):
    one = np.ones((1, 1))
    with pytest.raises(InvalidParameter, match=r"A: got nan at \[0, 0\]; needs finite numbers"):
        norm(np.nan * one, one, one, one)
    with pytest.raises(InvalidParameter, match=r"got shapes \(1, 1\), \(1, 1\), \(1, 2\)"):
        norm(one / 2, one, np.ones((1, 2)), one)


def test_a_certificate_that_holds_no_numbers_does_not_verify():
    certificate = certify_constant_ratio(tdc(), 0.08)
    certificate.evidence.loops[0].A[0, 0] = np.nan
    assert not certificate.verify()
    assert not reread(certificate).verify()


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (lambda: certify_constant_ratio(tdc(), 0.0), "ratio: got 0", InvalidParameter),
        (
            lambda: certify_constant_ratio(tdc(), (0.2, 0.1)),
            "ratio: got 0.1; needs a finite number of at least 0.2",
            InvalidParameter,
        ),
        (lambda: certify_constant_ratio(tdc(), np.nan), "ratio: got nan", InvalidParameter),
        (lambda: certify_constant_ratio(tdc(), 0.1, gain=-1.0), "gain: got -1", InvalidParameter),
        (
            lambda: certify_constant_ratio(tdc(), 0.1, computation_delay=-1),
            "computation_delay: got -1",
            InvalidParameter,
        ),
        (lambda: certify_constant_ratio("TDC", 0.1), "law: got str", UnsupportedLaw),  # type: ignore[arg-type]
        (
            lambda: stable_interval(tdc(natural_frequency=200.0), computation_delay=60),
            "no inertia ratio makes this loop stable",
            NoStableRatio,
        ),
        (
            lambda: stable_intervals(
                tdc(joints=2, natural_frequency=None, position_gain=[[100.0, 20.0], [20.0, 100.0]], velocity_gain=20.0)
            ),
            "the gains couple the joints",
            UnsupportedLaw,
        ),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()
