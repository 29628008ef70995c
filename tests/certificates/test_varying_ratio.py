"""The varying-ratio certificate against loops by hand, rotating mismatches and the norm of a finely cut period."""

from contextlib import suppress

import numpy as np
import pytest

from law_catalogue import make_law, make_tdc
from reference.adversaries import SUBSTEPS, AdversarialLoops, Adversary
from reference.constant_loop import (
    ANGLES,
    frequency_response,
    loop_polynomials,
    peak_gain,
    peak_gain_of_pair,
    spectral_radius,
)
from reference.law_parameters import PERIOD, LawParameters, draw_parameters
from reference.law_recurrence import recurrence
from reference.soundness_checks import check_balls_with_stiffness
from reference.soundness_tally import Tally
from reference.uncertain_case import UncertainCase, growth_per_period, state_matrices
from slow_cases import slow
from tampering import replaced, reread, scaled, without
from tarc import estimators, laws
from tarc.analysis import hinf_norm, stable_interval, stable_intervals
from tarc.analysis.linearise import coupled_channel, decoupled_channels
from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop, scaled_system
from tarc.certificates import certify_varying_ratio
from tarc.certificates.ball_radius import max_radius_any_rate
from tarc.core.errors import InvalidParameter, NoStableRatio, UnsupportedLaw
from tarc.numerics.matrix_tests import schur_stability
from tarc.stored_certificates import certificate_from_dict

LITERAL, SYNCHRONISED = LawParameters(window=10), LawParameters(window=10, synchronised=True)

# theory: centre and radius of the widest ball, ratio of its ends
KNOWN = [
    (LawParameters(window=10), 0.079, 0.0630, 8.6),
    (LawParameters(window=5), 0.140, 0.1218, 14.7),
    (LawParameters(window=20, synchronised=True), 0.999, 0.848, 12.2),
    (LawParameters(window=10, synchronised=True), 1.074, 0.981, 22.2),
    (LawParameters(window=5, synchronised=True), 1.110, 1.056, 39.5),
]


def hand_radius(design, centre):
    """1/‖T‖∞ by the polynomials of the recurrence, for a mismatch held over each period."""
    found = loop_polynomials(recurrence(design), centre)
    assert spectral_radius(found.closed) < 1
    return 1 / peak_gain(found.a_to_v, found.closed)[0]


@pytest.mark.parametrize(("design", "centre", "known", "ratio"), KNOWN)
def test_known_balls(design, centre, known, ratio):
    there = certify_varying_ratio(design.law, centre, intersample=False)
    assert there.certified
    # the centres are known to three digits, within which the radius moves by more than its own last digit
    assert there.evidence.radius == pytest.approx(known, rel=0.01)
    assert there.evidence.radius == pytest.approx(hand_radius(design, centre), rel=5e-6)
    assert there.evidence.radius <= hand_radius(design, centre)
    widest = certify_varying_ratio(design.law, intersample=False).evidence
    assert round(widest.ratio_spread, 1) == ratio
    assert widest.centre == pytest.approx(centre, rel=0.01)
    lifted = certify_varying_ratio(design.law).evidence
    assert widest.ratio_spread * 0.98 < lifted.ratio_spread < widest.ratio_spread
    low, high = stable_interval(design.law)
    assert low < lifted.min_ratio < lifted.max_ratio < high


@pytest.mark.parametrize("window", [5, 10])
def test_widest_is_the_widest(window):
    design = LawParameters(window=window, synchronised=True)
    found = certify_varying_ratio(design.law, intersample=False).evidence.ratio_spread
    others = [hand_radius(design, centre) / centre for centre in np.geomspace(0.2, 2.5, 60)]
    assert found == pytest.approx((1 + max(others)) / (1 - max(others)), rel=2e-3)


@pytest.mark.parametrize(("design", "centre"), [(LITERAL, 0.08), (LawParameters(window=5), 0.2), (SYNCHRONISED, 1.0)])
@pytest.mark.parametrize("computation", [0, 2])
def test_lifted_norm_against_a_period_cut_into_fifty(design, centre, computation):
    """A mismatched acceleration that is constant over each fiftieth, of unit mean square over the period."""
    cuts = 50
    law = recurrence(design)._replace(delay=computation)
    closed, side = loop_polynomials(law, centre).closed, np.concatenate([-law.q, [0.0]])
    power = np.zeros(len(ANGLES))
    for j in range(cuts):
        reach = (cuts - j - 0.5) / cuts
        motion = PERIOD**2 / np.sqrt(cuts) * np.array([0.0, reach, 1.0 - reach])
        power += np.abs(frequency_response(np.convolve(motion, side), closed, ANGLES)) ** 2
    expected = 1 / np.sqrt(power.max())
    found = certify_varying_ratio(design.law, centre, computation_delay=computation)
    # fifty pieces bind the adversary a little, so that its norm is the smaller one
    assert expected * (1 - 1e-4) < found.evidence.radius < expected
    assert (
        found.evidence.radius
        < certify_varying_ratio(design.law, centre, intersample=False, computation_delay=computation).evidence.radius
    )


def growth_of_rotating(design, low, high, rates):
    """Largest Floquet multiplier for a mismatch with two eigenvalues that turns by a rate [rad a period].

    In the frame that turns along, the loop of the complex q does not depend on time.
    """
    A, B, _, C = state_matrices(UncertainCase(recurrence(design), 0.0))
    gain = np.outer(B, C)
    sizes = []
    for rate in np.atleast_1d(rates):
        turn = np.exp(-1j * rate)
        same, other = turn * (A + (low + high) / 2 * gain), turn * (low - high) / 2 * gain
        both = np.block([[(same + other).real, (other - same).imag], [(same + other).imag, (same - other).real]])
        sizes.append(np.max(np.abs(np.linalg.eigvals(both))))
    return np.array(sizes)


def test_a_rotating_mismatch_inside_the_frozen_interval_diverges():
    """Both eigenvalues lie well inside the range that every constant ratio may have."""
    low, high = 0.006, 0.255
    edges = stable_interval(LITERAL.law)
    assert edges[0] < low < high < edges[1]
    rates = np.array([10.0, 11.5, 153.6, 3000.0, 3141.0]) * PERIOD
    grows = growth_of_rotating(LITERAL, low, high, rates) > 1
    assert grows.tolist() == [False, True, True, True, False]
    # fastest at 153.6 rad/s, by e in 30 ms
    fastest = np.linspace(100, 200, 101) * PERIOD
    sizes = growth_of_rotating(LITERAL, low, high, fastest)
    assert fastest[np.argmax(sizes)] / PERIOD == pytest.approx(153.6, abs=2)
    assert PERIOD / np.log(sizes.max()) == pytest.approx(0.0298, rel=0.01)
    assert certify_varying_ratio(LITERAL.law, ratio_range=(low, high)).verdict == "inconclusive"


@pytest.mark.parametrize("design", [LITERAL, LawParameters(window=5), SYNCHRONISED])
def test_sharp_in_two_dimensions(design):
    """Rotating at the peak of the norm, a mismatch diverges just outside the ball and not just inside."""
    found = certify_varying_ratio(design.law, intersample=False).evidence
    known = loop_polynomials(recurrence(design), found.centre)
    rate = peak_gain(known.a_to_v, known.closed)[1]
    inside, outside = (
        growth_of_rotating(design, found.centre - size, found.centre + size, rate)[0]
        for size in (0.999 * found.radius, 1.001 * found.radius)
    )
    assert inside < 1 < outside


def test_the_fleet_agrees_with_the_floquet_multiplier():
    """The simulation that the soundness benchmark rests on can find what there is to find."""
    found = certify_varying_ratio(LITERAL.law, intersample=False).evidence
    law = recurrence(LITERAL)
    cases = [UncertainCase(law, found.centre, share * found.radius) for share in (0.95, 1.05)]
    growth = AdversarialLoops(cases, [Adversary("rotate at the peak")]).run(8000)[0]
    known = loop_polynomials(law, found.centre)
    rate = peak_gain(known.a_to_v, known.closed)[1]
    for case, log in zip(cases, growth, strict=True):
        size = growth_of_rotating(LITERAL, case.centre - case.radius, case.centre + case.radius, rate)[0]
        assert log / 4000 == pytest.approx(np.log(size), rel=0.05)


@pytest.mark.parametrize("intersample", [False, True])
def test_nothing_inside_a_ball_diverges(intersample):
    """With a varying slope at the same time, of adversaries that know the loop."""
    cases = []
    for design, centre in ((LITERAL, 0.08), (SYNCHRONISED, 1.0), (SYNCHRONISED, 0.4)):
        for slope in (100.0, 300.0):
            found = certify_varying_ratio(design.law, centre, slope=slope, intersample=intersample)
            assert found.certified
            cases.append(UncertainCase(recurrence(design), centre, found.evidence.radius, slope))
    adversaries = [
        Adversary(mismatch, slope)
        for mismatch in ("rotate at the peak", "greedy output", "switch")
        for slope in ("returning", "greedy output")
    ]
    assert SUBSTEPS > 1
    assert np.all(AdversarialLoops(cases, adversaries).run(6000, intersample=intersample) < 0)


def test_a_slope_costs_radius_and_none_costs_nothing():
    radii = [
        certify_varying_ratio(LITERAL.law, 0.08, slope=slope).evidence.radius
        for slope in (0.0, 1e-6, 100.0, 300.0, 600.0)
    ]
    assert radii[0] == pytest.approx(radii[1], rel=1e-3)
    assert np.all(np.diff(radii[1:]) < 0)
    # with no mismatch at all there remains the circle criterion, at 692
    assert certify_varying_ratio(LITERAL.law, 0.08, slope=680.0).certified
    assert certify_varying_ratio(LITERAL.law, 0.08, slope=700.0).verdict == "inconclusive"


def test_ratio_range():
    verdict = certify_varying_ratio(LITERAL.law, ratio_range=(0.03, 0.12))
    assert verdict.certified
    numbers = verdict.evidence
    assert numbers.min_ratio < 0.03
    assert numbers.max_ratio > 0.12
    assert verdict.margin == pytest.approx(numbers.radius / max(0.12 - numbers.centre, numbers.centre - 0.03) - 1)
    assert "from 0.03 to 0.12" in verdict.claim
    assert certify_varying_ratio(LITERAL.law, ratio_range=(0.05, 0.05)).certified
    # a spread below that of the widest ball, but not around its centre
    assert certify_varying_ratio(LITERAL.law, ratio_range=(0.1, 0.8)).verdict == "inconclusive"
    assert certify_varying_ratio(LITERAL.law, ratio_range=(0.01, 0.2)).verdict == "inconclusive"
    given = certify_varying_ratio(LITERAL.law, 0.08, ratio_range=(0.03, 0.12))
    assert given.certified
    assert given.evidence.centre == 0.08


def test_many_joints_cost_and_give_what_one_does():
    one = certify_varying_ratio(make_law(laws.TDC, 1), slope=50.0)
    many = certify_varying_ratio(make_law(laws.TDC, 30), slope=50.0)
    assert many.to_dict()["evidence"] == one.to_dict()["evidence"]


def test_one_joint_stands_for_three_with_a_full_inertia():
    """In coordinates M̂^½ q; the mismatch of the full matrices is any symmetric E within the ball."""
    mixed = np.array([[0.3, 0.1, 0.02], [0.1, 0.2, 0.05], [0.02, 0.05, 0.08]])
    law = make_law(laws.TDC, 3, inertia=mixed)
    found = certify_varying_ratio(law, intersample=False).evidence
    values, vectors = np.linalg.eigh(mixed)
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    A, B, C, _, _ = coupled_channel(law).closed_loop(found.centre)
    norm = hinf_norm(A, B @ np.linalg.inv(root), root @ C, np.zeros((3, 3)))
    assert 1 / norm == pytest.approx(found.radius, rel=5e-6)
    rng = np.random.default_rng(0)
    for _ in range(5):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        E = turn @ np.diag(rng.uniform(found.min_ratio, found.max_ratio, 3)) @ turn.T
        assert schur_stability(coupled_channel(law).state_matrix(np.linalg.inv(root) @ E @ root))[0] == "certified"
    beyond = np.diag([stable_interval(law)[1] * 1.01, 0.05, 0.05])
    assert schur_stability(coupled_channel(law).state_matrix(np.linalg.inv(root) @ beyond @ root))[0] == "refuted"


def test_json_round_trip_verifies_and_tampering_shows():
    for certificate in (
        certify_varying_ratio(LITERAL.law),
        certify_varying_ratio(SYNCHRONISED.law, ratio_range=(0.5, 1.5), slope=50.0),
    ):
        read = reread(certificate)
        assert read.certified
        assert read.verify()
        assert read.to_dict() == certificate.to_dict()
        for name, factor in (("radius", 1.01), ("centre", 0.5)):
            assert not scaled(certificate, f"ball.{name}", factor).verify()
        assert not replaced(certificate, "slope", 60.0).verify()
        for name in UncertainLoop._fields[:3]:
            assert not scaled(certificate, f"ball.loop.{name}", 10).verify()
            with pytest.raises(InvalidParameter, match="cannot read it"):
                certificate_from_dict(without(certificate, f"ball.loop.{name}"))


def test_explains_itself_and_draws(tmp_path):
    certificate = certify_varying_ratio(LITERAL.law, slope=100.0)
    for part in (
        "Verdict: certified",
        "radius over the centre",
        "slope between 0 and 100 1/s²",
        "E changes at any time",
    ):
        assert part in certificate.explain()
    assert "E is constant within each period" in certify_varying_ratio(LITERAL.law, intersample=False).explain()
    certificate.plot().savefig(tmp_path / "ball.png")


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (
            lambda: certify_varying_ratio(make_law(laws.TDC, natural_frequency=[10.0, 20.0])),
            "law: the joints' gains differ or are coupled",
            UnsupportedLaw,
        ),
        (
            lambda: certify_varying_ratio(
                make_law(
                    laws.TDC, natural_frequency=None, position_gain=[[100.0, 5.0], [5.0, 100.0]], velocity_gain=20.0
                )
            ),
            "gains differ or are coupled",
            UnsupportedLaw,
        ),
        (
            lambda: certify_varying_ratio(make_law(laws.TARC, lyapunov_weight=[1.0, 2.0, 1.0, 1.0])),
            "gains differ or are coupled",
            UnsupportedLaw,
        ),
        (lambda: certify_varying_ratio(LITERAL.law, 0.0), "centre: got 0", InvalidParameter),
        (lambda: certify_varying_ratio(LITERAL.law, np.inf), "centre: got inf", InvalidParameter),
        (lambda: certify_varying_ratio(LITERAL.law, slope=-1.0), "slope: got -1", InvalidParameter),
        (
            lambda: certify_varying_ratio(LITERAL.law, ratio_range=(0.2, 0.1)),
            "ratio_range: got 0.1; needs a finite number of at least 0.2",
            InvalidParameter,
        ),
        (lambda: certify_varying_ratio(LITERAL.law, ratio_range=(0.0, 0.1)), "ratio_range: got 0", InvalidParameter),
        (
            lambda: certify_varying_ratio(LITERAL.law, computation_delay=-1),
            "computation_delay: got -1",
            InvalidParameter,
        ),
        (lambda: certify_varying_ratio("TDC"), "law: got str", UnsupportedLaw),  # type: ignore[arg-type]
        (
            lambda: certify_varying_ratio(LawParameters(natural_frequency=200.0).law, computation_delay=60),
            "no inertia ratio makes this loop stable",
            NoStableRatio,
        ),
        (lambda: certify_varying_ratio(LITERAL.law, slope=1e6), "a smaller slope", NoStableRatio),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()


# What rounding once made wrong


def test_a_norm_that_the_grid_of_frequencies_hides_is_not_too_low():
    """Synchronised, windows of two periods: a narrow peak beside a lightly damped mode at half the sampling rate."""
    checked = 0
    for window in (0, 2):
        for natural_frequency in (2.0, 5.260581486313681, 20.0, 60.0):
            design = LawParameters(
                natural_frequency=natural_frequency, damping_ratio=1.0805602401238095, window=window, synchronised=True
            )
            for centre in (1.5, 2.2, 2.6, 2.8651634841107407, 2.95):
                if spectral_radius(loop_polynomials(recurrence(design), centre).closed) > 1 - 1e-9:
                    continue
                found = certify_varying_ratio(design.law, centre, intersample=False)
                assert found.certified
                # the polynomials themselves carry rounding beside such a pole
                assert found.evidence.radius <= hand_radius(design, centre) * (1 + 1e-6)
                assert found.evidence.radius >= hand_radius(design, centre) * (1 - 1e-4)
                checked += 1
    assert checked > 20


def test_a_rotating_mismatch_within_the_ball_of_that_design_decays():
    design = LawParameters(
        natural_frequency=5.260581486313681, damping_ratio=1.0805602401238095, window=2, synchronised=True
    )
    found = certify_varying_ratio(design.law, 2.8651634841107407, intersample=False).evidence
    inside = growth_of_rotating(design, found.centre - found.radius, found.centre + found.radius, 2.0765797453418324)
    assert inside[0] < 1


@pytest.mark.parametrize(("periods", "actuation"), [(2, 0), (1, 1), (1, 3), (3, 1), (4, 0)])
def test_a_torque_that_alternates_undamped_is_not_certified(periods, actuation):
    """Literal, with an even number of periods in all: a mode on the circle that no sampled position shows."""
    law = LawParameters(delay_periods=periods, actuation_delay=actuation).law
    assert stable_intervals(law) == []
    for centre in (0.02, 0.05, 0.1):
        assert certify_varying_ratio(law, centre).verdict == "inconclusive"
    # rounding decides whether the search for a centre finds eigenvalues on the circle or just inside
    with suppress(NoStableRatio):
        assert certify_varying_ratio(law).verdict == "inconclusive"


@pytest.mark.parametrize("damping_ratio", [0.5, 0.7, 2.0])
def test_any_damping(damping_ratio):
    estimator = estimators.Algebraic(window=0.010)
    law = laws.TDC(inertia=0.1, natural_frequency=10.0, damping_ratio=damping_ratio, period=PERIOD, estimator=estimator)
    found = certify_varying_ratio(law, 0.08, intersample=False)
    assert found.evidence.radius == pytest.approx(
        hand_radius(LawParameters(damping_ratio=damping_ratio), 0.08), rel=5e-6
    )


def test_schur_judges_what_has_no_basis_of_eigenvectors():
    block = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    assert schur_stability(block + 0.5 * np.eye(3))[0] == "certified"
    assert schur_stability(block + 2.0 * np.eye(3))[0] == "refuted"
    assert schur_stability(block + np.eye(3))[0] == "inconclusive"
    assert schur_stability(np.diag([1.0, -1.0]))[0] == "inconclusive"
    assert schur_stability(np.diag([1.0 - 1e-15, 0.5]))[0] == "certified"
    assert schur_stability(np.diag([1.0 + 1e-15, 0.5]))[0] == "refuted"


def reflection(angle, size):
    """Return a reflection of norm ``size`` along an axis at an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return size * np.array([[c, s], [s, -c]])


@pytest.mark.parametrize(
    ("window", "synchronised", "ratio", "slope", "stiffness"),
    [
        (10, False, 0.08, 0.0, 60.0),
        (10, False, 0.08, 200.0, 30.0),
        (5, True, 1.0, 100.0, 200.0),
        (10, True, 0.5, 0.0, 500.0),
    ],
)
def test_stiffness_of_the_robot_within_the_ball_does_not_diverge(window, synchronised, ratio, slope, stiffness):
    """Pairs of mismatch and stiffness at the edge of what is certified, turning, and a slope that switches."""
    (channel,) = decoupled_channels(make_tdc(window, synchronised))
    parts = UncertainLoop.from_channel(channel, slope, intersample=False)
    weight = stiffness / (0.6 * ratio)
    scale, radius = max_radius_any_rate(parts, ratio, weight)
    assert radius > 0
    assert hinf_norm(*scaled_system(parts.closed_loop(ratio, weight), radius, scale)) < 1
    assert radius < max_radius_any_rate(parts, ratio)[1]
    free, into, out, robust, through = parts[:5]
    A, W = free + ratio * into @ out, robust + ratio * into @ through
    rng = np.random.default_rng(0)
    worst = -np.inf
    for turn in (0.0, 0.003, 0.03, 0.15, 0.5):
        x = rng.normal(size=(len(A), 2)) * 1e-6
        sizes = []
        for k in range(6000):
            q = x[0]
            # the slope is on while the motion leaves zero slowly, off while it returns: either may do the harm
            w = -slope * q * ((k // 40) % 2)
            v = out @ x + through * w
            lean = 0.5 + 0.5 * np.sin(k * turn / 7)  # from all mismatch to all stiffness: [E − ρ0, H/η] of norm radius
            share, rest = np.cos(lean * np.pi / 2), np.sin(lean * np.pi / 2)
            a = reflection(k * turn, share * radius) @ v[0] - reflection(k * turn, rest * radius * weight) @ q
            x = A @ x + into * a + W * w
            sizes.append(np.abs(x).max())
        worst = max(worst, sizes[-1] / sizes[1500])
    assert worst < 0.9


def test_stiffness_beyond_what_is_certified_can_diverge():
    """A constant negative stiffness that the loop at its least ratio cannot hold is outside every ball."""
    (channel,) = decoupled_channels(make_tdc(10, False))
    parts = UncertainLoop.from_channel(channel, 0.0, intersample=False)
    least = 0.006
    assert max_radius_any_rate(parts, least)[1] > 0
    for weight in np.geomspace(1.0, 1e6, 25):
        assert max_radius_any_rate(parts, least, weight)[1] * weight < 60.0
    free, into, out = parts[:3]
    falling = free + least * into @ out + 60.0 * into @ np.eye(1, len(free))
    assert np.abs(np.linalg.eigvals(falling)).max() > 1


# Pairs of the mismatch and the robot's own stiffness

PAIRS = [
    (LITERAL, 0.08, 3000.0),
    (LITERAL, 0.02, 3000.0),
    (SYNCHRONISED, 1.0, 800.0),
    (LawParameters(window=5, synchronised=True, natural_frequency=3.0), 0.05, 900.0),
    (LawParameters(window=8, degree=3, synchronised=True, computation_delay=2, actuation_delay=2), 0.4, 2000.0),
]


def largest_singular_values(first, second):
    """Return those of matrices with two columns, in closed form."""
    a, d = np.sum(np.abs(first) ** 2, axis=1), np.sum(np.abs(second) ** 2, axis=1)
    b = np.abs(np.sum(first.conj() * second, axis=1))
    return np.sqrt((a + d) / 2 + np.hypot((a - d) / 2, b))


def hand_pair_radius(design, centre, weight, slope=0.0):
    """Return the radius by the recurrence's polynomials: responses to (a, w) of (v, η q) and of the slope's block."""
    law, half = recurrence(design), slope / 2
    known = loop_polynomials(law, centre, half)
    angles = np.unique(np.concatenate([np.geomspace(1e-4, np.pi, 4000), np.linspace(1e-3, np.pi, 4000)]))
    w_to_v = np.convolve([1.0, -2.0, 1.0], [1.0, law.e])
    tops = [[known.a_to_v, weight * known.a_to_q, half * known.a_to_q]]
    tops += [[w_to_v, weight * known.w_to_q, half * known.w_to_q]] if slope else []
    G = np.array([[frequency_response(top, known.closed, angles) for top in column] for column in tops]).transpose(
        2, 1, 0
    )
    if not slope:
        return 1 / np.linalg.norm(G, 2, axis=(1, 2)).max()

    def fits(radius, scale):
        first, second = np.moveaxis(G * np.array([[radius], [radius], [1 / scale]]) * [1.0, scale], 2, 0)
        return largest_singular_values(first, second).max() < 1

    best = 0.0
    for scale in np.geomspace(1e-3, 1e3, 121):
        low, high = best, 100 * centre
        while high / max(low, 1e-9) > 1.0005 and fits(max(low, 1e-9) * 1.0005, scale):
            middle = np.sqrt(max(low, 1e-9) * high)
            low, high = (middle, high) if fits(middle, scale) else (low, middle)
        best = low
    return best


@pytest.mark.parametrize(("design", "centre", "weight"), PAIRS)
@pytest.mark.parametrize("slope", [0.0, 60.0])
def test_radius_of_pairs_by_hand(design, centre, weight, slope):
    parts = UncertainLoop.from_channel(
        decoupled_channels(design.law, design.computation_delay)[0], slope, intersample=False
    )
    scale, found = max_radius_any_rate(parts, centre, weight)
    expected = hand_pair_radius(design, centre, weight, slope)
    assert (scale is None) == (not slope)
    # scales by hand are on a grid
    assert found == pytest.approx(expected, rel=0.01 if slope else 1e-3)
    assert found <= expected * (1 + (3e-3 if slope else 1e-6))


@pytest.mark.parametrize(("design", "centre", "weight"), PAIRS)
def test_pairs_are_sharp_in_two_dimensions(design, centre, weight):
    """A mismatch that rotates at the peak beside a stiffness that turns: diverges just outside, not just inside."""
    parts = UncertainLoop.from_channel(
        decoupled_channels(design.law, design.computation_delay)[0], 0.0, intersample=False
    )
    found = max_radius_any_rate(parts, centre, weight)[1]
    assert found < 0.999 * max_radius_any_rate(parts, centre)[1]  # the stiffness does take part
    case = UncertainCase(recurrence(design), centre, found, 0.0, weight)
    rate = peak_gain_of_pair(loop_polynomials(case.law, centre), weight)[1]
    inside, outside = (
        growth_per_period(case._replace(radius=size), 0.0, np.array([rate]))[0]
        for size in (0.999 * found, 1.001 * found)
    )
    assert inside < 1 < outside


def test_the_fleet_finds_pairs_outside():
    law = recurrence(LITERAL)
    parts = UncertainLoop.from_channel(decoupled_channels(LITERAL.law)[0], 0.0, intersample=True)
    found = max_radius_any_rate(parts, 0.08, 300.0)[1]
    cases = [UncertainCase(law, 0.08, share * found, 0.0, 300.0) for share in (0.95, 1.1)]
    inside, outside = AdversarialLoops(cases, [Adversary("rotate at the peak")]).run(8000, intersample=True)[0]
    assert inside < -1
    assert outside > 3


@pytest.mark.parametrize(("n_designs", "steps"), [(12, 800), slow(40, 1500)])
def test_nothing_contradicts_a_ball_of_pairs(n_designs, steps):
    rng, tally = np.random.default_rng(3), Tally()
    check_balls_with_stiffness([draw_parameters(rng) for _ in range(n_designs)], rng, tally, steps, lambda: None)
    assert tally.violations == []
    assert tally.certified > n_designs / 2
    assert tally.undecided < 3


@pytest.mark.parametrize(("design", "centre"), [(LITERAL, 0.08), (SYNCHRONISED, 1.0), (LawParameters(window=5), 0.2)])
@pytest.mark.parametrize("weight", [100.0, 1e4, 1e5])
def test_stiffness_acts_between_the_samples_as_at_them(design, centre, weight):
    """The period cut into pieces, the position weighed in each of them, against the one that is sampled."""
    cuts = 24
    parts = UncertainLoop.from_channel(decoupled_channels(design.law)[0], 0.0, intersample=True)
    free, into, out = parts[:3]
    A = free + centre * into @ out
    B, C, D = np.zeros((len(A), cuts)), np.zeros((cuts + 1, len(A))), np.zeros((cuts + 1, cuts))
    moments = (np.arange(cuts) + 0.5) / cuts
    B[0], B[1] = PERIOD**2 * (1 - moments) / np.sqrt(cuts), PERIOD**2 / np.sqrt(cuts)
    C[0] = out
    C[1:] = centre * (moments[:, None] * PERIOD) ** 2 / 2 * out
    C[1:, 0] += 1.0
    C[1:, 1] += moments
    D[1:] = PERIOD**2 * np.tril(moments[:, None] - moments, -1) / np.sqrt(cuts)
    C[1:], D[1:] = C[1:] * weight / np.sqrt(cuts), D[1:] * weight / np.sqrt(cuts)
    assert max_radius_any_rate(parts, centre, weight)[1] == pytest.approx(1 / hinf_norm(A, B, C, D), rel=1e-3)


@pytest.mark.parametrize(("design", "centre"), [(LITERAL, 0.08), (SYNCHRONISED, 1.0), (LawParameters(window=5), 0.2)])
@pytest.mark.parametrize("lead", [3.0, 30.0, 300.0])
def test_damping_acts_between_the_samples_as_their_mean_velocity(design, centre, lead):
    """The period cut into pieces, position and velocity weighed in each, against position and mean velocity."""
    cuts, weight = 24, 1e3
    parts = UncertainLoop.from_channel(decoupled_channels(design.law)[0], 0.0, intersample=True, lead_periods=lead)
    free, into, out = parts[:3]
    A = free + centre * into @ out
    B, C, D = np.zeros((len(A), cuts)), np.zeros((2 * cuts + 1, len(A))), np.zeros((2 * cuts + 1, cuts))
    moments = (np.arange(cuts) + 0.5) / cuts
    B[0], B[1] = PERIOD**2 * (1 - moments) / np.sqrt(cuts), PERIOD**2 / np.sqrt(cuts)
    C[0] = out
    position, velocity = slice(1, cuts + 1), slice(cuts + 1, None)
    C[position] = centre * (moments[:, None] * PERIOD) ** 2 / 2 * out
    C[position, 0] += 1.0
    C[position, 1] += moments
    D[position] = PERIOD**2 * np.tril(moments[:, None] - moments, -1) / np.sqrt(cuts)
    C[velocity] = centre * moments[:, None] * PERIOD**2 * out
    C[velocity, 1] += 1.0
    D[velocity] = PERIOD**2 * np.tril(np.ones((cuts, cuts)), -1) / np.sqrt(cuts)
    C[velocity], D[velocity] = lead * C[velocity], lead * D[velocity]
    C[1:], D[1:] = C[1:] * weight / np.sqrt(cuts), D[1:] * weight / np.sqrt(cuts)
    assert max_radius_any_rate(parts, centre, weight)[1] == pytest.approx(1 / hinf_norm(A, B, C, D), rel=5e-3)


@pytest.mark.parametrize(
    ("window", "degree", "natural_frequency", "late"), [(10, 2, 5.0, 1), (12, 3, 10.0, 2), (10, 2, 2.0, 1)]
)
def test_a_narrow_peak_at_a_third_of_the_rate_is_not_missed(window, degree, natural_frequency, late):
    """A literal law whose torque comes back after three periods rings there, barely damped."""
    design = LawParameters(
        window=window,
        degree=degree,
        natural_frequency=natural_frequency,
        delay_periods=3 - late,
        computation_delay=late,
        actuation_delay=late,
    )
    parts = UncertainLoop.from_channel(decoupled_channels(design.law, late)[0], 0.0, intersample=True)
    checked = 0
    for centre in np.geomspace(0.005, 0.3, 12):
        if spectral_radius(loop_polynomials(recurrence(design), centre).closed) < 1 - 1e-5:
            checked += 1
            assert FrequencyResponses(parts).best_scale(centre)[1] == pytest.approx(
                max_radius_any_rate(parts, centre)[1], rel=0.02
            )
    assert checked > 3


def test_numbers_that_are_none_certify_nothing():
    for certificate in (
        certify_varying_ratio(LITERAL.law),
        certify_varying_ratio(SYNCHRONISED.law, ratio_range=(0.5, 1.5), slope=50.0),
    ):
        for name in ("ball.radius", "ball.centre", "needed_radius", "ball.scale"):
            for value in (0.0, np.nan, np.inf, -np.inf):
                changed = replaced(certificate, name, value)
                if certificate.evidence.ball.scale is None and name == "ball.scale" and value not in (0.0, np.inf):
                    continue
                assert not changed.verify() or (name == "needed_radius" and value == 0.0)


def test_where_no_ball_contains_the_range_the_affine_certificate_is_tried():
    law = laws.TDC(
        inertia=1.0,
        natural_frequency=10.0,
        period=1e-3,
        synchronised=True,
        estimator=estimators.Algebraic(window=0.005, degree=2),
    )
    low, high = stable_interval(law)
    ratio_range = 1.3 * low, high / 1.3
    ball = certify_varying_ratio(law, ratio_range=ratio_range, rate=10.0, intersample=False, affine=False)
    best = certify_varying_ratio(law, ratio_range=ratio_range, rate=10.0, intersample=False)
    assert (ball.kind, ball.verdict) == ("varying_ratio", "inconclusive")
    assert best.kind == "affine"
    assert best.certified
    assert best.verify()
    narrow = certify_varying_ratio(law, ratio_range=(0.5, 1.0), rate=10.0, intersample=False)
    assert (narrow.kind, narrow.verdict) == ("varying_ratio", "certified")
