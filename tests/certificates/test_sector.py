"""The switching slope against polynomials written by hand and slopes that switch."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from law_catalogue import make_law, make_tdc
from reference.adversaries import AdversarialLoops, Adversary
from reference.constant_loop import loop_polynomials, most_negative_real_part, spectral_radius
from reference.law_parameters import PERIOD, LawParameters
from reference.law_recurrence import recurrence
from reference.uncertain_case import UncertainCase
from tampering import replaced, reread, scaled, without
from tarc import estimators, laws
from tarc.certificates import certify_constant_ratio, certify_sector, certify_varying_ratio
from tarc.certificates.sector import circle_limit
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.stored_certificates import certificate_from_dict

LITERAL, SYNCHRONISED = LawParameters(window=10), LawParameters(window=10, synchronised=True)


def tarc_law(design=LITERAL, **options) -> Any:
    """TARC with P2 = I and ε = 0.01, so that a gain of ĉ is a slope of 100 ĉ."""
    return replace(replace(design, slope=1.0).law, **options)


def hand_radius(ratio, kappa, window=10, natural_frequency=10.0, T=PERIOD):
    """Literal: (1 − z⁻¹) v = −[K1 + κ + K2 W1(z) + z⁻¹ W2(z)] q, q = ρ T² (z + 1) / (2 (z − 1)²) v; in powers of z."""
    age = -np.arange(window + 1) * T
    fit = np.linalg.pinv(np.vander(age, 3, increasing=True))
    side = np.zeros(window + 2)
    side[:-1] += 2 * natural_frequency * fit[1]
    side[0] += natural_frequency**2 + kappa
    side[1:] += 2 * fit[2]
    own = np.concatenate([[1.0, -1.0], np.zeros(window)])
    plant = ratio * T**2 / 2 * np.array([1.0, 1.0])
    return np.max(np.abs(np.roots(np.polyadd(np.polymul(own, [1.0, -2.0, 1.0]), np.polymul(side, plant)))))


def first_unstable_slope(grows, high, points=600):
    """Return the least slope at which a loop is unstable: a scan, then bisection."""
    trials = np.geomspace(1.0, high, points)
    first = next(i for i, trial in enumerate(trials) if grows(trial))
    low, high = trials[first - 1], trials[first]
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (low, middle) if grows(middle) else (middle, high)
    return low


# theory: circle and frozen limit. Of the frozen ones, 2800, 49,610 and 1517 were printed there, 0.1 to 0.4 % too high
KNOWN = [(LITERAL, 0.08, 692, 2797.7), (SYNCHRONISED, 1.0, 795, 49462.7), (SYNCHRONISED, 0.3, 580, 1511.7)]


@pytest.mark.parametrize(("design", "ratio", "circle", "frozen"), KNOWN)
def test_known_limits(design, ratio, circle, frozen):
    for law in (design.law, tarc_law(design)):
        numbers = certify_sector(law, ratio).evidence
        assert round(numbers.circle_limit) == circle
        assert numbers.frozen_limit == pytest.approx(frozen, abs=0.05)


@pytest.mark.parametrize(("design", "ratio"), [row[:2] for row in KNOWN])
@pytest.mark.parametrize("computation", [0, 1])
def test_both_limits_against_polynomials(design, ratio, computation):
    law = recurrence(design)._replace(delay=computation)
    known = loop_polynomials(law, ratio)
    if spectral_radius(known.closed) > 1:
        return
    numbers = certify_sector(design.law, ratio, computation_delay=computation).evidence
    expected = 1 / most_negative_real_part(known.w_to_q, known.closed)[0]
    assert expected * (1 - 1e-5) < numbers.circle_limit <= expected
    expected = first_unstable_slope(lambda kappa: spectral_radius(loop_polynomials(law, ratio, kappa).closed) > 1, 1e5)
    assert numbers.frozen_limit == pytest.approx(expected, rel=1e-6)


def test_frozen_limit_of_a_third_polynomial():
    """Written in z instead of z⁻¹, with K1 + κ in place of K1: what is printed as 2800 is 2797.7."""
    expected = first_unstable_slope(lambda kappa: hand_radius(0.08, kappa) > 1, 1e4)
    assert expected == pytest.approx(2797.71, abs=0.01)
    assert certify_sector(LITERAL.law, 0.08).evidence.frozen_limit == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("window", "ratio"), [(5, 0.15), (20, 0.03)])
def test_a_frozen_slope_is_a_frozen_gain(window, ratio):
    """The constant-ratio certificate with the gain at the limit, through the law's own Δu."""
    law = tarc_law(LawParameters(window=window))
    limit = certify_sector(law, ratio).evidence.frozen_limit * law.boundary_layer
    assert certify_constant_ratio(law, ratio, gain=0.999 * limit).certified
    assert certify_constant_ratio(law, ratio, gain=1.001 * limit).verdict == "refuted"


@pytest.mark.parametrize(
    ("design", "ratio", "kappa"), [(LITERAL, 0.08, 1500), (SYNCHRONISED, 1.0, 2000), (SYNCHRONISED, 0.3, 1000)]
)
def test_slopes_that_switch_diverge_between_the_two_limits(design, ratio, kappa):
    """On while the position returns to zero, off while it leaves; in a loop that each constant slope leaves stable."""
    numbers = certify_sector(design.law, ratio).evidence
    assert numbers.circle_limit < kappa < numbers.frozen_limit
    switching = [Adversary("none", "returning"), Adversary("none", "greedy output")]
    cases = [UncertainCase(recurrence(design), ratio, 0.0, size) for size in (0.999 * numbers.circle_limit, kappa)]
    growth = AdversarialLoops(cases, switching).run(10_000).max(axis=0)
    assert growth[0] < 0 < growth[1]
    assert certify_sector(tarc_law(design), ratio, max_gain=kappa * 0.01).verdict == "inconclusive"


@pytest.mark.parametrize(("design", "ratio"), [row[:2] for row in KNOWN])
def test_the_ball_of_no_radius_is_the_circle_criterion(design, ratio):
    limit = certify_sector(design.law, ratio).evidence.circle_limit
    assert certify_varying_ratio(design.law, ratio, slope=0.995 * limit).certified
    assert not certify_varying_ratio(design.law, ratio, slope=1.005 * limit).certified


def test_verdicts_of_a_gain():
    law = tarc_law(max_gain=5.0)
    certified = certify_sector(law, 0.08)
    assert certified.certified
    assert certified.margin == pytest.approx(6.9246 / 5 - 1, rel=1e-3)
    assert certified.evidence.slope_at_max_gain == pytest.approx(500.0)
    assert certified.witness is None
    refuted = certify_sector(law, 0.08, max_gain=40.0)
    assert refuted.verdict == "refuted"
    assert refuted.witness is not None
    gain = refuted.witness.gain
    assert 27.977 < gain <= 40
    shown = certify_constant_ratio(law, 0.08, gain=gain)
    assert shown.verdict == "refuted"
    assert shown.witness is not None
    assert shown.witness.growth_rate == pytest.approx(refuted.witness.growth_rate)
    assert "Shown by: slope" in refuted.explain()
    unbounded = certify_sector(tarc_law(), 0.08)
    assert unbounded.verdict == "inconclusive"
    assert "has no maximum" in unbounded.claim
    # without a robust term of its own, a law is certified for what the criterion admits
    plain = certify_sector(LITERAL.law, 0.08)
    assert plain.certified
    assert "every time-varying slope up to 692.5" in plain.claim
    assert certify_sector(LITERAL.law, 0.3).verdict == "refuted"


@pytest.mark.parametrize(("design", "ratio"), [row[:2] for row in KNOWN])
def test_largest_cap_is_certified_and_a_bit_more_is_not(design, ratio):
    law = tarc_law(design, gain_factor=1.4, boundary_layer=0.03)
    largest = certify_sector(law, ratio).evidence.largest_max_gain
    assert largest is not None
    assert certify_sector(law, ratio, max_gain=largest).certified
    assert certify_sector(replace(law, max_gain=largest), ratio).certified
    assert certify_sector(law, ratio, max_gain=largest * (1 + 1e-4)).verdict == "inconclusive"


def test_a_weight_scales_the_slope():
    """s = P2 e1: with P2 three times as large the cap is a third, the slope the same."""
    one, three = tarc_law(), tarc_law(lyapunov_weight=[600.0, 2.0])
    assert pytest.approx(3.0) == three.P2
    first, second = certify_sector(one, 0.08).evidence, certify_sector(three, 0.08).evidence
    assert second.circle_limit == pytest.approx(first.circle_limit)
    assert second.frozen_limit == pytest.approx(first.frozen_limit)
    assert first.largest_max_gain is not None
    assert second.largest_max_gain == pytest.approx(first.largest_max_gain / 3)


def test_the_least_of_different_joints():
    both = make_tdc(natural_frequency=[10.0, 20.0], inertia=0.1 * np.eye(2))
    limits = [
        certify_sector(make_tdc(natural_frequency=natural_frequency), 0.08).evidence.circle_limit
        for natural_frequency in (10.0, 20.0)
    ]
    assert certify_sector(both, 0.08).evidence.circle_limit == pytest.approx(min(limits))


def test_many_joints_cost_and_give_what_one_does():
    one, many = (certify_sector(make_law(laws.TARC, joints, max_gain=1.0), 0.05) for joints in (1, 30))
    assert many.verdict == one.verdict
    assert many.evidence.circle_limit == pytest.approx(one.evidence.circle_limit)
    assert many.evidence.frozen_limit == pytest.approx(one.evidence.frozen_limit)
    assert len(many.evidence.loops) == len(one.evidence.loops)


def test_coupled_gains_against_the_decoupled_ones_in_turned_coordinates():
    """K1 and P2 that turning diagonalises: the limits are those of the diagonal loops, frozen within a step."""
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    K1, K2 = np.diag([100.0, 400.0]), np.diag([20.0, 40.0])
    options = {"natural_frequency": None, "period": PERIOD, "estimator": estimators.Algebraic(window=0.010)}
    apart, coupled = (
        laws.TDC(inertia=0.1 * np.eye(2), position_gain=R @ K1 @ R.T, velocity_gain=R @ K2 @ R.T, **options)
        for R in (np.eye(2), turn)
    )
    first, second = certify_sector(apart, 0.08).evidence, certify_sector(coupled, 0.08).evidence
    assert second.circle_limit == pytest.approx(first.circle_limit, rel=1e-4)
    assert second.frozen_limit == pytest.approx(first.frozen_limit, rel=0.025)


def test_a_loop_that_every_slope_leaves_stable_has_no_limit():
    """Nothing is infinite in what is stored, and JSON holds no infinity."""
    A, B, C = 0.5 * np.eye(1), np.eye(1), np.eye(1)
    assert circle_limit(A, B, -C) == pytest.approx(0.5, rel=1e-4)  # Re 1/(z − ½) is at most 2, at z = 1
    assert circle_limit(np.zeros((1, 1)), np.zeros((1, 1)), C) == np.inf
    infinite = replaced(certify_sector(LITERAL.law, 0.08), "circle_limit", np.inf)
    assert "Infinity" not in infinite.to_json()
    assert reread(infinite).evidence.circle_limit == np.inf


def test_an_unstable_loop_has_no_slope():
    """No division by the limit, which is zero."""
    for law in (LITERAL.law, tarc_law(), tarc_law(max_gain=1.0)):
        verdict = certify_sector(law, 0.5)
        assert verdict.verdict == "refuted"
        assert verdict.evidence.circle_limit == 0
        assert verdict.evidence.frozen_limit == 0
        assert verdict.verify()


@pytest.mark.parametrize(("periods", "actuation"), [(2, 0), (1, 1), (3, 1)])
def test_a_torque_that_alternates_undamped_is_not_certified(periods, actuation):
    law = LawParameters(delay_periods=periods, actuation_delay=actuation).law
    for ratio in (0.02, 0.05, 0.1):
        verdict = certify_sector(law, ratio)
        assert verdict.verdict != "certified"
        assert verdict.verify()


def test_json_round_trip_verifies_and_tampering_shows():
    for certificate in (
        certify_sector(LITERAL.law, 0.08),
        certify_sector(tarc_law(max_gain=5.0), 0.08),
        certify_sector(tarc_law(max_gain=40.0), 0.08),
    ):
        read = reread(certificate)
        assert read.verdict == certificate.verdict
        assert read.to_dict() == certificate.to_dict()
        assert read.verify()
        assert not replaced(certificate, "max_slope", 1000.0).verify()
    assert not scaled(certify_sector(tarc_law(max_gain=5.0), 0.08), "loops.0.B", 10).verify()


def test_a_certificate_without_its_matrices_does_not_verify():
    certificate = certify_sector(tarc_law(max_gain=5.0), 0.08)
    assert not replaced(certificate, "loops", []).verify()
    with pytest.raises(InvalidParameter, match="cannot read it"):
        certificate_from_dict(without(certificate, "loops.0.C"))


def test_explains_itself_and_draws(tmp_path):
    certificate = certify_sector(tarc_law(max_gain=5.0), 0.08)
    for part in (
        "every gain ĉ(t) up to 5 rad/s²",
        "Verdict: certified",
        "circle limit over the slope at the largest gain",
    ):
        assert part in certificate.explain()
    certificate.plot().savefig(tmp_path / "slope.png")


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (lambda: certify_sector(LITERAL.law, 0.0), "ratio: got 0", InvalidParameter),
        (lambda: certify_sector(LITERAL.law, -1.0), "ratio: got -1", InvalidParameter),
        (lambda: certify_sector(LITERAL.law, np.nan), "ratio: got nan", InvalidParameter),
        (lambda: certify_sector(tarc_law(), 0.08, max_gain=0.0), "max_gain: got 0", InvalidParameter),
        (lambda: certify_sector(tarc_law(), 0.08, max_gain=-1.0), "max_gain: got -1", InvalidParameter),
        (
            lambda: certify_sector(LITERAL.law, 0.08, computation_delay=-1),
            "computation_delay: got -1",
            InvalidParameter,
        ),
        (lambda: certify_sector("TDC", 0.08), "law: got str", UnsupportedLaw),  # type: ignore[arg-type]
        (
            lambda: certify_sector(
                make_law(laws.TARC, natural_frequency=[10.0, 20.0], lyapunov_weight=mixed_weight()), 0.05
            ),
            "law: its P2 couples joints whose gains do not",
            UnsupportedLaw,
        ),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()


def mixed_weight():
    weight = np.diag([200.0, 800.0, 2.0, 2.0])
    weight[0, 1] = weight[1, 0] = 100.0
    return weight


# What rounding once made wrong


@pytest.mark.parametrize("seed", range(6))
def test_frozen_limits_of_random_designs(seed):
    """Against a scan of the polynomials: no crossing is missed, and none that only touches the circle counts."""
    rng = np.random.default_rng(seed)
    checked = 0
    for _ in range(12):
        synchronised, window = bool(rng.random() < 0.5), int(rng.choice([0, 2, 3, 6, 12]))
        design = LawParameters(
            natural_frequency=float(rng.uniform(3, 50)),
            damping_ratio=float(rng.uniform(0.5, 2)),
            window=window,
            cutoff=float(rng.uniform(100, 2000)) if not window and rng.random() < 0.5 else 0.0,
            synchronised=synchronised,
            computation_delay=int(rng.integers(0, 3)),
        )
        ratio, law = float(rng.uniform(0.3, 1.5) if synchronised else rng.uniform(0.01, 0.2)), recurrence(design)
        if spectral_radius(loop_polynomials(law, ratio).closed) > 1 - 1e-5:
            continue
        limit = certify_sector(design.law, ratio, computation_delay=design.computation_delay).evidence.frozen_limit
        trials = np.geomspace(0.01, 1.0, 60) * limit
        radii = np.array([spectral_radius(loop_polynomials(law, ratio, trial).closed) for trial in trials[:-1]])
        assert np.all(radii < 1 + 1e-9)
        assert spectral_radius(loop_polynomials(law, ratio, 1.001 * limit).closed) > 1
        checked += 1
    assert checked > 3
