"""The ball for an inertia that changes slowly, against Floquet multipliers, sums and frequency grids of its own."""

import numpy as np
import pytest

from law_catalogue import make_tdc
from reference.constant_loop import frequency_response, loop_polynomials
from reference.law_parameters import PERIOD, LawParameters, draw_parameters
from reference.law_recurrence import recurrence
from reference.slow_adversaries import SlowAdversarialLoops
from reference.soundness_checks import check_slow_balls
from reference.soundness_tally import Tally
from reference.uncertain_case import UncertainCase, growth_per_period, state_matrices
from slow_cases import slow
from tampering import replaced, reread, scaled, without
from tarc import plants, signals, simulate
from tarc.analysis import Workspace, stable_interval
from tarc.analysis.inertia_rate import inertia_rates
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.operating_points import OperatingPoint, uncertainty_samples
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.certificates import certify_robot, certify_varying_ratio
from tarc.certificates.ball_radius import max_radius
from tarc.certificates.iqc import Multiplier, rate_penalty, satisfies_iqc
from tarc.core.errors import InvalidParameter
from tarc.numerics.norms import fdi_negative
from tarc.stored_certificates import certificate_from_dict

LITERAL, SYNCHRONISED = LawParameters(window=10), LawParameters(window=10, synchronised=True)
BOTH = [(LITERAL, 0.079), (SYNCHRONISED, 1.074)]
ARM, LOADED = plants.TwoLinkArm(), plants.TwoLinkArm(payload=2.0)


def ball_at_rate(design, centre, relative, **options):
    """Return the ball at a rate [1/s] times the centre."""
    return certify_varying_ratio(design.law, centre, rate=relative / centre, **options)


# How large it is


@pytest.mark.parametrize(("design", "centre"), BOTH)
@pytest.mark.parametrize("slope", [0.0, 100.0])
def test_the_faster_the_smaller_down_to_the_ball_at_any_speed(design, centre, slope):
    found = [ball_at_rate(design, centre, one, slope=slope) for one in (0.1, 3.0, 30.0, 300.0, 1e6)]
    radii = [one.evidence.radius for one in found]
    anyhow = certify_varying_ratio(design.law, centre, slope=slope).evidence.radius
    assert all(one.certified for one in found)
    assert np.all(np.diff(radii) < 0.01 * centre)
    assert radii[-1] == pytest.approx(anyhow, rel=0.01)
    assert radii[0] > 1.02 * anyhow


@pytest.mark.parametrize(("design", "centre"), BOTH)
@pytest.mark.parametrize("relative", [0.0, 0.01])
def test_nearly_at_rest_it_holds_nearly_what_constant_ratios_may_be(design, centre, relative):
    low, high = stable_interval(design.law)
    most = min(centre - low, high - centre)
    assert 0.98 * most < ball_at_rate(design, centre, relative).evidence.radius < most


def test_a_range_that_fits_at_a_rate_only():
    low, high = stable_interval(LITERAL.law)
    ends = 1.2 * low, 0.135
    assert ends[1] < high
    assert certify_varying_ratio(LITERAL.law, ratio_range=ends).verdict == "inconclusive"
    slow = certify_varying_ratio(LITERAL.law, ratio_range=ends, rate=5.0)
    assert slow.certified
    assert slow.evidence.min_ratio < ends[0] < ends[1] < slow.evidence.max_ratio
    assert "changing by at most 5 1/s" in slow.claim


# What it claims, by Floquet multipliers


def max_turning_rate(centre, radius, rate):
    """How fast axes may turn [rad a period] if E⁻¹, with eigenvalues 1/(ρ0 ± δ), is to keep within the rate."""
    apart = 1 / (centre - radius) - 1 / (centre + radius)
    return rate * PERIOD / apart


def growth_of_turning(design, centre, radius, limit):
    rates_tried = min(limit, np.pi) * np.append(np.geomspace(1e-4, 1, 120), 1.0)
    return growth_per_period(UncertainCase(recurrence(design), centre, radius), 0.0, rates_tried).max()


@pytest.mark.parametrize(("design", "centre"), BOTH)
@pytest.mark.parametrize("relative", [0.3, 3.0, 30.0, 100.0])
def test_axes_that_turn_within_the_rate_are_borne_and_no_much_larger_radius(design, centre, relative):
    size = ball_at_rate(design, centre, relative, intersample=False).evidence.radius
    rate = relative / centre
    assert growth_of_turning(design, centre, size, max_turning_rate(centre, size, rate)) < 1
    larger = min(1.2 * size, 0.999 * centre)
    assert growth_of_turning(design, centre, larger, max_turning_rate(centre, larger, rate)) > 1


def test_the_rate_matters():
    """Axes that turn some times faster than the rate make the certified loop diverge."""
    size = ball_at_rate(LITERAL, 0.079, 30.0, intersample=False).evidence.radius
    limit = max_turning_rate(0.079, size, 30.0 / 0.079)
    assert growth_of_turning(LITERAL, 0.079, size, limit) < 1 < growth_of_turning(LITERAL, 0.079, size, 6 * limit)


@pytest.mark.parametrize(("design", "centre"), BOTH)
@pytest.mark.parametrize("relative", [30.0, 300.0])
def test_a_ratio_that_swings_within_the_rate_is_borne(design, centre, relative):
    """1/E is a sinusoid over all of the ball, or half of it, held over each period."""
    size, step = ball_at_rate(design, centre, relative, intersample=False).evidence.radius, relative / centre * PERIOD
    A, B, _, C = state_matrices(UncertainCase(recurrence(design), centre))
    ends, tried = np.array([1 / (centre + size), 1 / (centre - size)]), 0
    for share in (0.3, 1.0):
        swing = share * np.diff(ends)[0] / 2
        least = max(2, int(np.ceil(np.pi / np.arcsin(min(1.0, step / 2 / swing)))))
        for periods in np.unique((least * np.array([1.0, 1.7, 3.0])).astype(int)):
            for middle in (ends[0] + swing, ends[1] - swing):
                inverse = middle + swing * np.cos(2 * np.pi * np.arange(periods) / periods)
                assert np.abs(np.diff(inverse)).max() <= step * (1 + 1e-9)
                around, log = np.eye(len(A)), 0.0
                for ratio in 1 / inverse:
                    around = (A + (ratio - centre) * np.outer(B, C)) @ around
                    log += np.log(np.abs(around).max())
                    around /= np.abs(around).max()
                assert log + np.log(np.abs(np.linalg.eigvals(around)).max()) < 0
                tried += 1
    assert tried > 7


@pytest.mark.parametrize("n_designs", [6, slow(16)])
def test_nothing_contradicts_a_slow_ball(n_designs):
    rng, tally = np.random.default_rng(5), Tally()
    check_slow_balls([draw_parameters(rng) for _ in range(n_designs)], rng, tally, 800, lambda: None)
    assert tally.violations == []
    assert tally.certified > 6 * n_designs / 16
    assert tally.undecided < 3


def test_the_slow_fleet_keeps_to_the_rate_and_the_ball_and_finds_what_is_outside():
    from reference.adversaries import SUBSTEPS, Adversary
    from reference.slow_adversaries import SLOW_MISMATCHES, invert_map

    found = ball_at_rate(LITERAL, 0.079, 30.0).evidence
    adversaries = [Adversary(kind) for kind in SLOW_MISMATCHES]
    turning = adversaries[:1]
    seen = []

    class Watched(SlowAdversarialLoops):
        def _acceleration(self, kind, i, *rest, **others):
            before = self.m[i].copy(), self.c[i].copy()
            push = super()._acceleration(kind, i, *rest, **others)
            m, c = invert_map(self.m[i], self.c[i])
            change = np.abs(self.m[i] - before[0]) + np.abs(self.c[i] - before[1])
            seen.append((change.max(), (np.abs(m - self.centre) + np.abs(c)).max()))
            return push

    case = UncertainCase(recurrence(LITERAL), 0.079, found.radius, max_rate=30.0 / 0.079)
    Watched([case], adversaries).run(200, intersample=True)
    most = np.max(seen, axis=0)
    assert 0.9 < most[0] / (case.max_rate * PERIOD / SUBSTEPS) <= 1 + 1e-9
    assert 0.9 < most[1] / case.radius <= 1 + 1e-9
    outside = case._replace(radius=1.14 * case.radius)
    inside, diverging = SlowAdversarialLoops([case, outside], turning).run(6000, intersample=True).max(axis=0)
    assert inside < 0
    assert diverging > 3


# Its parts


@pytest.mark.parametrize("step", [1e-4, 0.01, 0.3])
def test_cost_against_the_sum(step):
    """Within a period E is E⁻¹'s inverse mean only nearly, so that it costs a little more than the plain sum."""
    decays, most = np.array([0.05, 0.5, 0.9, 0.999]), 1.5
    m = np.arange(1, 40_000)[:, None]
    plain = 2 * np.sum(decays**m * m * step, axis=0)
    found = rate_penalty(decays, step, most)
    rest = step * most / 2
    worst = ((1 + rest / (1 - rest)) / (1 - rest / (1 - rest))) ** 2
    np.testing.assert_allclose(found, worst * plain, rtol=1e-9)
    assert np.all(found >= plain)


def test_a_mean_over_a_period_changes_no_more_than_what_it_costs():
    """Random W(t) = E⁻¹ of a bounded rate: the inverse of E's mean from period to period, against D_1 = cost/2p."""
    rng, worst = np.random.default_rng(0), 0.0
    for step in (0.02, 0.1, 0.25):
        for _ in range(40):
            turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            W = turn @ np.diag(rng.uniform(0.8, 2.0, 3)) @ turn.T
            pieces, way = [], rng.normal(size=(3, 3))
            for _ in range(40):  # two periods of twenty pieces each
                way = rng.normal(size=(3, 3)) if rng.random() < 0.1 else way
                W = W + step / 20 * (way + way.T) / np.linalg.norm(way + way.T, 2)
                pieces.append(W)
            E = np.linalg.inv(np.array(pieces))
            most = np.linalg.norm(E, 2, axis=(1, 2)).max()
            one, two = (np.linalg.inv(E[i : i + 20].mean(axis=0)) for i in (0, 20))
            change, p = np.linalg.norm(one - two, 2), np.array([1e-9])
            assert change <= rate_penalty(p, step, most)[0] / 2 / p[0]
            worst = max(worst, change / step)
    assert worst > 0.9


def test_no_multiplier_for_what_changes_by_most_of_itself_in_a_period():
    assert np.all(np.isinf(rate_penalty(np.array([0.5]), 1.0, 1.0)))
    assert np.isfinite(rate_penalty(np.array([0.5]), 0.1, 1.0)).all()


def hand_form(design, centre, radius, step, evidence, angles):
    """Return the form on a dense grid, for E held over each period: T from a to v by the recurrence's polynomials."""
    known = loop_polynomials(recurrence(design), centre)
    T = frequency_response(known.a_to_v, known.closed, angles)
    m = np.arange(1, 3000)
    powers = evidence.decays[:, None] ** m
    swing = step * (centre + radius) / 2
    paid = 2 * np.abs(evidence.coefficients) @ powers @ (m * step) / (1 - 2 * swing) ** 2
    # 2 Σ y_m Re(conj(v e^{jmω}) b − conj(v) b e^{jmω}) with b = ρ0 v + a, v = T a
    cross = -4 * np.sin(np.outer(angles, m)) @ (evidence.coefficients @ powers) * np.imag(T)
    return radius**2 * np.abs(T) ** 2 + paid * np.abs(1 + centre * T) ** 2 + cross - 1


@pytest.mark.parametrize(("design", "centre"), BOTH)
@pytest.mark.parametrize("relative", [3.0, 30.0])
def test_tolerates_against_a_dense_grid(design, centre, relative):
    (channel,) = decoupled_channels(design.law)
    parts, step = UncertainLoop.from_channel(channel, 0.0, intersample=False), relative / centre * PERIOD
    evidence, size = max_radius(parts, centre, max_change=step)
    assert isinstance(evidence, Multiplier)
    assert len(evidence.coefficients) > 0
    angles = np.unique(np.concatenate([np.geomspace(1e-5, np.pi, 600), np.linspace(1e-3, np.pi, 600)]))
    for share in (0.5, 0.9, 0.99, 0.999, 1.01, 1.05, 1.2):
        value = hand_form(design, centre, share * size, step, evidence, angles).max()
        assert abs(value) > 1e-5
        assert satisfies_iqc(parts, centre, share * size, step, evidence) == (value < 0)


@pytest.mark.parametrize("slope", [0.0, 100.0])
@pytest.mark.parametrize("weight", [0.0, 3000.0])
def test_tolerates_nothing_that_was_changed(slope, weight):
    (channel,) = decoupled_channels(LITERAL.law)
    parts, centre, step, stiffness = UncertainLoop.from_channel(channel, slope, intersample=True), 0.08, 0.1, 20.0
    evidence, size = max_radius(parts, centre, weight, max_change=step, stiffness=stiffness)
    rest = weight, stiffness
    assert isinstance(evidence, Multiplier)
    assert size > 0
    assert satisfies_iqc(parts, centre, size, step, evidence, *rest)
    wrong = [
        evidence._replace(coefficients=-evidence.coefficients),
        evidence._replace(coefficients=100 * evidence.coefficients),
        evidence._replace(decays=1 / evidence.decays),
        evidence._replace(decays=-evidence.decays),
        evidence._replace(slope=-1.0),
        evidence._replace(stiffness=0.0),
    ]
    for one in wrong:
        assert not satisfies_iqc(parts, centre, size, step, one, *rest)
    assert not satisfies_iqc(parts, centre, 1.1 * size, step, evidence, *rest)
    assert not satisfies_iqc(parts, centre, 1.01 * centre, step, evidence, *rest)
    for other in (30 * step, -step, np.nan):
        assert not satisfies_iqc(parts, centre, size, other, evidence, *rest)


@pytest.mark.parametrize("slope", [0.0, 100.0])
def test_without_exponentials_it_is_the_ball_at_any_speed(slope):
    parts = UncertainLoop.from_channel(decoupled_channels(LITERAL.law)[0], slope, intersample=True)
    anyhow = certify_varying_ratio(LITERAL.law, 0.08, slope=slope).evidence
    plain = Multiplier(np.zeros(0), np.zeros(0), (anyhow.ball.scale or 1.0) ** -2.0)
    assert satisfies_iqc(parts, 0.08, 0.999 * anyhow.radius, 1e9, plain)
    assert not satisfies_iqc(parts, 0.08, 1.02 * anyhow.radius, 0.0, plain)


def test_negative_against_a_dense_grid():
    """Random systems beside the level at which the form changes its sign."""
    rng, both = np.random.default_rng(2), [0, 0]
    angles = np.concatenate([[0.0], np.geomspace(1e-5, np.pi, 4000), np.linspace(1e-3, np.pi, 6000)])
    z = np.exp(1j * angles)[:, None, None]
    for _ in range(40):
        n, inputs = int(rng.integers(1, 7)), int(rng.integers(1, 4))
        A = rng.normal(size=(n, n))
        A *= rng.uniform(0.3, 0.99) / np.abs(np.linalg.eigvals(A)).max()
        B, S, whole = rng.normal(size=(n, inputs)), rng.normal(size=(n, inputs)), rng.normal(size=(n, n))
        Q = whole + whole.T
        x = np.linalg.solve(z * np.eye(n) - A, B + 0 * z)
        mixed = x.conj().transpose(0, 2, 1) @ S
        form = x.conj().transpose(0, 2, 1) @ Q @ x + mixed + mixed.conj().transpose(0, 2, 1)
        top = np.linalg.eigvalsh(form).max()
        for share, answer in ((1e-2, True), (-1e-6, False)):
            R = -(top + share * max(abs(top), 1.0)) * np.eye(inputs)
            assert fdi_negative(A, B, Q, S, R) == answer
            both[answer] += 1
        assert not fdi_negative(1.5 / np.abs(np.linalg.eigvals(A)).max() * A, B, Q, S, -1e9 * np.eye(inputs))
    assert min(both) == 40


# As certificates


@pytest.mark.parametrize("options", [{}, {"slope": 100.0}, {"ratio_range": (0.02, 0.13)}])
def test_json_round_trip_verifies_and_tampering_shows(options):
    certificate = certify_varying_ratio(LITERAL.law, rate=20.0, **options)
    assert certificate.certified
    read = reread(certificate)
    assert read.verify()
    assert read.to_dict() == certificate.to_dict()
    changes = {
        "radius": [1.02, np.inf, np.nan, 0.0],
        "centre": [0.5, np.nan],
        "max_change": [50.0, -1.0, np.nan, np.inf],
        "multiplier.slope": [-1.0, np.nan, np.inf],
        "multiplier.stiffness": [np.nan, np.inf],
    }
    for name, factors in changes.items():
        for factor in factors:
            assert not scaled(certificate, f"ball.{name}", factor).verify()
    for name, factor in (("multiplier.coefficients", -1.0), ("multiplier.decays", 1.5), ("loop.B", 3.0)):
        assert not scaled(certificate, f"ball.{name}", factor).verify()
        with pytest.raises(InvalidParameter, match="cannot read it"):
            certificate_from_dict(without(certificate, f"ball.{name}"))
    assert not replaced(certificate, "ball.multiplier", None).verify()


def test_without_a_rate_nothing_of_it_is_written():
    plain = certify_varying_ratio(LITERAL.law)
    assert plain.evidence.ball.max_change is None
    assert plain.evidence.ball.multiplier is None


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (lambda: certify_varying_ratio(LITERAL.law, rate=-1.0), "rate: got -1", InvalidParameter),
        (lambda: certify_varying_ratio(LITERAL.law, rate=np.nan), "rate: got nan", InvalidParameter),
        (lambda: certify_varying_ratio(LITERAL.law, rate=np.inf), "rate: got inf", InvalidParameter),
        (lambda: certify_varying_ratio(LITERAL.law, rate="fast"), "rate", InvalidParameter),  # type: ignore[arg-type]
        (lambda: Workspace.from_joint_limits(ARM, speed=[1.0, 1.0, 1.0]), "speed", InvalidParameter),
        (lambda: Workspace.from_joint_limits(ARM, speed=-1.0), "speed", InvalidParameter),
        (lambda: Workspace.box([0.0, 0.0], [1.0, 1.0], speed=[1.0, np.nan]), "speed", InvalidParameter),
        (lambda: Workspace.from_joint_limits(ARM, speed=1.0, acceleration=-1.0), "acceleration: got", InvalidParameter),
        (
            lambda: Workspace.from_joint_limits(ARM, acceleration=1.0),
            "acceleration: it bounds nothing without a speed",
            InvalidParameter,
        ),
        (
            lambda: Workspace.from_joint_limits(ARM, speed=np.inf, acceleration=1.0),
            "acceleration: it bounds nothing without a speed",
            InvalidParameter,
        ),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()


# Robots


def inverse_mismatch(plant, nominal, posture):
    values, vectors = np.linalg.eigh(nominal)
    root = vectors @ np.diag(values**-0.5) @ vectors.T
    return root @ plant.inertia(posture) @ root


def test_rates_bound_what_motions_do_and_are_reached():
    nominal, rng = 0.1 * ARM.inertia([0.0, 1.5]), np.random.default_rng(4)
    speed, dt, shares = np.array([2.0, 3.0]), 1e-6, []
    for _ in range(60):
        q, way = rng.uniform(-3, 3, 2), rng.uniform(-1, 1, 2)
        bound = inertia_rates(nominal, LOADED.inertia_slopes(q)[None], speed)[0]
        fastest = 0.0
        for share in (way, np.sign(way)):
            ends = [inverse_mismatch(LOADED, nominal, q + sign * share * speed * dt / 2) for sign in (-1, 1)]
            seen = np.linalg.norm(ends[1] - ends[0], 2) / dt
            assert seen <= bound * (1 + 1e-5) + 1e-6
            fastest = max(fastest, seen)
        shares.append(fastest / bound)
    assert max(shares) == pytest.approx(1.0, abs=1e-4)
    assert np.all(inertia_rates(nominal, ARM.inertia_slopes([0.3, 1.0])[None], np.zeros(2)) == 0)


@pytest.fixture(scope="module")
def verdicts():
    law = make_tdc(synchronised=True, inertia=INERTIA)
    speeds = (None, 0.4)
    return [
        certify_robot(law, [ARM, LOADED], Workspace.from_joint_limits(ARM, speed=speed), samples=100)
        for speed in speeds
    ]


INERTIA = 0.5 * ARM.inertia([0.0, 2.0])


def test_a_robot_that_is_certified_within_a_speed_only(verdicts):
    anyhow, slow = verdicts
    assert anyhow.verdict == "inconclusive"
    assert slow.certified
    assert slow.margin > anyhow.margin
    # the second joint alone changes the inertia: the rate by differences at a fine grid of its angle
    grid, dt = np.linspace(-np.pi, np.pi, 721), 1e-6
    seen = max(
        np.linalg.norm(
            inverse_mismatch(LOADED, INERTIA, [0.0, angle + dt]) - inverse_mismatch(LOADED, INERTIA, [0.0, angle - dt]),
            2,
        )
        / (2 * dt)
        for angle in grid
    )
    assert slow.evidence.rate == pytest.approx(1.05 * 0.4 * seen, rel=1e-3)  # with the margin of a search


def test_a_robot_verifies_and_tampering_shows(verdicts):
    slow = verdicts[1]
    assert reread(slow).verify()
    changes = [
        ("max_rate_point.velocity_limits", 1.5),
        ("max_rate_point.inertia_slopes", 1.5),
        ("ball.multiplier.coefficients", -1.0),
        ("ball.loop.lead_periods", 3.0),
        ("ball.loop.lead_periods", 0.0),
        ("ball.loop.lead_periods", -1.0),
        ("points.stiffest_moving.damping", 30.0),
        ("points.stiffest_moving.stiffness", 30.0),
        ("points.largest_norm_moving.stiffness", 30.0),
        ("ball.max_change", 0.9),
        ("ball.stiffness", 0.9),
        ("ball.radius", 1.1),
        ("ball.radius", 0.5),
        ("ball.position_weight", np.nan),
    ]
    for name, factor in changes:
        assert not scaled(slow, name, factor).verify(), name
    assert not replaced(slow, "ball.max_change", None).verify()  # claims any speed


def test_an_acceleration_goes_with_a_speed():
    """One that is not given reaches the speed in a quarter of a second, and both are slowed together."""
    space = Workspace.from_joint_limits(ARM, speed=[1.0, 2.0])
    assert space.acceleration == pytest.approx([4.0, 8.0])
    given = Workspace.box([0.0, 0.0], [1.0, 1.0], speed=1.0, acceleration=[2.0, 3.0])
    assert given.acceleration == pytest.approx([2.0, 3.0])
    half = given.scale_speed(0.5)
    assert half.speed == pytest.approx([0.5, 0.5])
    assert half.acceleration == pytest.approx([1.0, 1.5])
    assert given.with_speed_limits(None).acceleration is None
    assert given.with_speed_limits(None).scale_speed(0.5).speed is None


def test_no_motion_within_the_speed_needs_a_wider_ball(verdicts):
    """At any share of the greatest speeds and accelerations, in any posture, empty and loaded."""
    slow = verdicts[1]
    ball = slow.evidence.ball
    lead = ball.loop.lead_periods.item() * PERIOD
    needed, rng = ball.radius / (1 + slow.margin), np.random.default_rng(8)
    instants = [
        OperatingPoint(plant, rng.uniform(-np.pi, np.pi, 2), rng.uniform(-0.4, 0.4, 2), rng.uniform(-1.6, 1.6, 2))
        for plant in (ARM, LOADED)
        for _ in range(1500)
    ]
    found = uncertainty_samples(INERTIA, instants)
    assert found.joint_norms(ball.centre, ball.position_weight, lead).max() <= needed * (1 + 1e-3)
    assert 0.7 * ball.stiffness < found.stiffness_norms(lead).max() <= ball.stiffness
    assert np.abs(slow.evidence.points.stiffest_moving.velocity).max() == pytest.approx(0.4)
    assert np.abs(slow.evidence.points.largest_norm_moving.acceleration).max() == pytest.approx(1.6)


def test_motions_at_the_greatest_speed_draw_together(verdicts):
    """Two runs along one motion, from starts that differ a little, and loaded: what differs between them dies out."""
    assert verdicts[1].certified
    law = make_tdc(synchronised=True, inertia=INERTIA)
    for plant, amplitude in ((ARM, [0.25, 0.2]), (LOADED, [0.3, 0.3]), (LOADED, [1.0, 0.5])):
        frequency = 0.5 / np.array(amplitude)
        sines = signals.Sinusoid(amplitude=amplitude, frequency=frequency, phase=[0.0, 1.0], offset=[0.3, 1.2])
        q, v, _ = (one[:, 0] for one in sines.sample(np.zeros(1)))
        runs = [
            simulate(
                plant,
                law,
                sines,
                4.0,
                initial_position=q + offset,
                initial_velocity=v,
                initial_torque="rest",
                progress=False,
            )
            for offset in (0.0, np.array([1e-3, -1e-3]))
        ]
        apart = np.abs(runs[0].data["position"].values - runs[1].data["position"].values).max(axis=1)
        assert apart[-500:].max() < 0.01 * apart[:200].max()


@pytest.mark.parametrize("lead", [3.0, 40.0])
def test_damping_counts_beside_the_stiffness(lead):
    """Damping of either sign that takes the whole ball does not make the loop diverge; far more does."""
    (channel,) = decoupled_channels(SYNCHRONISED.law)
    parts, centre, weight = UncertainLoop.from_channel(channel, 0.0, intersample=False, lead_periods=lead), 1.0, 300.0
    step = 10.0 / centre * PERIOD
    _, plain = max_radius(
        UncertainLoop.from_channel(channel, 0.0, intersample=False), centre, weight, max_change=step, stiffness=300.0
    )
    evidence, size = max_radius(parts, centre, weight, max_change=step, stiffness=300.0)
    assert isinstance(evidence, Multiplier)
    assert 0 < size < plain
    assert satisfies_iqc(parts, centre, size, step, evidence, weight, 300.0)
    assert not satisfies_iqc(parts, centre, 1.3 * size, step, evidence, weight, 300.0)
    assert growth_with_damping(parts, centre, 0.999 * size * weight, lead) < 1
    assert growth_with_damping(parts, centre, 300 * size * weight, lead) > 1


def growth_with_damping(parts, centre, size, lead):
    """Growth of the loop with damping of either sign that takes all of ‖[H, C/lead]‖, by the mean velocity."""
    free, into, out = parts[:3]
    closed, worst = free + centre * into @ out, 0.0
    wide = parts.B_mismatch[:, :1]
    for sign in (-1.0, 1.0):  # a = ∓ size lead (q⁺ − q), and q⁺ has a in it
        share = sign * size * lead
        row = share * (closed[:1] - np.eye(1, len(free))) / (1 - share * wide[0, 0])
        worst = max(worst, float(np.abs(np.linalg.eigvals(closed + wide @ row)).max()))
    return worst
