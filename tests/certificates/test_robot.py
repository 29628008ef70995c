"""The verdict for a robot against simulations of it: at rest where it is refuted, in fast motion where certified."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest

import tarc
from law_catalogue import make_law, make_tdc
from tampering import replaced, reread, scaled, without
from tarc import laws, plants, signals
from tarc.analysis import Workspace, stable_interval
from tarc.analysis.inertia_ratio import inverse_ratios
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.operating_points import OperatingPoint, uncertainty_samples
from tarc.analysis.rest_stability import rest_state_matrix
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.analysis.worst_points import sample_points
from tarc.certificates import certify_robot, certify_varying_ratio
from tarc.certificates.ball import Ball
from tarc.certificates.base import Certificate
from tarc.certification import LawCertification
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.stored_certificates import certificate_from_dict

ARM, LOADED = plants.TwoLinkArm(), plants.TwoLinkArm(payload=2.0)
BOX = Workspace.box([-1.0, 0.8], [1.0, 2.2])
PATH = Workspace.box([-0.5, 1.0], [0.5, 2.0])


def ball_of(verdict: Certificate) -> Ball:
    """Return the ball of a certificate of a robot."""
    assert verdict.evidence.ball is not None
    return verdict.evidence.ball


def suggestion(law, verdict: Certificate, computation_delay: int = 0) -> str:
    """Return what a certification with this certificate of the robot suggests."""
    return LawCertification(
        law=law,
        channels=decoupled_channels(law, computation_delay),
        certificates={"robot": verdict},
        computation_delay=computation_delay,
    ).suggestion


def certify_arm(law, plant: Any = ARM, workspace: Any = PATH, **options):
    return certify_robot(law, plant, workspace, samples=100, **options)


def tdc_with_inertia_share(part, **options):
    """TDC with a part of the arm's inertia in the middle of the path."""
    return make_tdc(inertia=part * ARM.inertia([0.0, 1.5]), **options)


def distance_from_rest(plant, law, posture, offset, duration, **options):
    """Distance from a posture [rad], every period, of a robot that rests beside it."""
    posture = np.asarray(posture, dtype=float)
    still = signals.Sinusoid(amplitude=np.zeros(len(posture)), frequency=1.0, offset=posture)
    run = tarc.simulate(
        plant, law, still, duration, initial_position=posture + offset, initial_torque="rest", progress=False, **options
    )
    return np.abs(run.data["position"].values - posture).max(axis=1)


@pytest.fixture(scope="module")
def shape():
    return best_inertia_shape([ARM, LOADED], BOX, samples=300)


def law_of_widest_ball(shape, synchronised, **options):
    """Return the law whose widest ball is around the ratios of both arms."""
    X, spread = shape
    law = make_tdc(synchronised=synchronised)
    found = certify_varying_ratio(law).evidence
    assert found.ratio_spread > spread
    return make_tdc(
        synchronised=synchronised, inertia=X * found.min_ratio * np.sqrt(found.ratio_spread / spread), **options
    )


def fast_motion(seed, amplitude):
    """Random motion of the arm inside the box, of up to some 15 rad/s."""
    rng = np.random.default_rng(seed)
    return signals.Multisine(
        amplitude=amplitude * np.array([[0.3, 0.3, 0.25], [0.22, 0.22, 0.18]]),
        frequency=rng.uniform(3.0, 15.0, 3),
        phase=rng.uniform(0, 2 * np.pi, (2, 3)),
        offset=np.array([0.0, 1.5]),
    )


@pytest.mark.parametrize("synchronised", [False, True])
def test_certified_for_two_plants_survives_fast_motion(shape, synchronised):
    law = law_of_widest_ball(shape, synchronised)
    verdict = certify_arm(law, [ARM, LOADED], BOX)
    assert verdict.certified
    assert verdict.verify()
    assert suggestion(law, verdict) == ""
    numbers = verdict.evidence
    assert ball_of(verdict).min_ratio < numbers.min_ratio
    assert numbers.max_ratio < ball_of(verdict).max_ratio
    for seed in range(3):
        reference = fast_motion(seed, 0.8)
        start = reference.sample(np.zeros(1))
        events = signals.ParameterSchedule(parameter="payload", times=[0.7, 1.4], values=[2.0, 0.0])
        for plant, disturbance in ((ARM, ()), (LOADED, ()), (ARM, events)):
            run = tarc.simulate(
                plant, law, reference, 2.0, initial_velocity=start[1][:, 0], disturbance=disturbance, progress=False
            )
            assert run.status.completed
            positions = run.data["position"].values
            assert np.all(positions > BOX.low)
            assert np.all(positions < BOX.high)
            assert np.abs(run.data["velocity"].values).max() > 3.0
            assert np.abs(positions - run.data["reference"].values)[1000:].max() < 0.25


def test_the_ratios_of_any_posture_and_payload_are_inside_the_ball(shape):
    law = law_of_widest_ball(shape, True)
    numbers = certify_arm(law, [ARM, LOADED], BOX).evidence
    rng = np.random.default_rng(0)
    for _ in range(200):
        plant = plants.TwoLinkArm(payload=float(rng.uniform(0, 2)))
        ratios = 1 / inverse_ratios(plant.inertia(rng.uniform(BOX.low, BOX.high))[None], law.M)
        assert numbers.min_ratio * (1 - 1e-9) <= ratios.min()
        assert ratios.max() <= numbers.max_ratio * (1 + 1e-9)


@pytest.mark.parametrize(
    ("part", "options"), [(0.9, {}), (0.25, {}), (3.0, {"synchronised": True}), (0.1, {"window": 25})]
)
@pytest.mark.parametrize("delay", [0, 2])
def test_a_refuted_posture_is_unstable_at_rest(part, options, delay):
    law = tdc_with_inertia_share(part, **options)
    verdict = certify_arm(law, computation_delay=delay)
    assert verdict.verdict == "refuted"
    assert verdict.verify()
    assert verdict.margin < 0
    witness = verdict.witness
    assert witness is not None
    assert np.all(PATH.low <= witness.posture)
    assert np.all(witness.posture <= PATH.high)
    rate = witness.growth_rate
    away = distance_from_rest(ARM, law, witness.posture, 1e-9, 25 / rate, computation_delay=delay)
    assert away.max() > 1e-2
    # from where other modes have died to where the arm is no longer linear
    first, last = np.argmax(away > 1e-7), np.argmax(away > 1e-3)
    assert np.log(away[last] / away[first]) / ((last - first) * 1e-3) == pytest.approx(rate, rel=0.2)
    assert witness.ratio > stable_interval(law, computation_delay=delay)[1] or part < 0.2


def test_certified_is_stable_at_rest_in_both_worst_postures():
    law = tdc_with_inertia_share(0.05)
    verdict = certify_arm(law)
    assert verdict.certified
    for end in ("min_ratio", "max_ratio"):
        away = distance_from_rest(ARM, law, getattr(verdict.evidence.points, end).position, 1e-3, 3.0)
        assert away[-1] < 1e-5


def test_between_the_ball_and_the_stable_range_is_inconclusive():
    """Each posture at rest is stable, and yet the ball does not hold them all."""
    law = make_tdc(inertia=np.diag([0.22, 0.04]))
    verdict = certify_arm(law, [ARM, LOADED], BOX)
    low, high = stable_interval(law)
    assert low < verdict.evidence.min_ratio < verdict.evidence.max_ratio < high
    assert verdict.verdict == "inconclusive"
    assert verdict.margin < 0
    assert verdict.witness is None
    assert verdict.verify()
    text = suggestion(law, verdict)
    assert f"inertia ratio is {verdict.evidence.ratio_spread:.3g} times its smallest" in text
    assert "inconclusive does not mean unstable" in text
    assert "synchronised, with" in text


def test_ur5e():
    """Its spread over the whole range of its joints is near 24 with the best M̂: a synchronised loop tolerates it."""
    arm = plants.MujocoPlant.from_file("ur5e", armature=0.1)
    everywhere = Workspace.from_joint_limits(arm)
    X, spread = best_inertia_shape(arm, everywhere, samples=200)
    verdicts = {}
    for window, synchronised in ((10, False), (4, True)):
        found = certify_varying_ratio(make_tdc(window, synchronised)).evidence
        law = make_tdc(window, synchronised, inertia=X * found.min_ratio * np.sqrt(found.ratio_spread / spread))
        verdicts[synchronised] = certify_arm(law, arm, everywhere)
    assert verdicts[False].verdict == "inconclusive"
    assert verdicts[True].certified
    law = make_tdc(inertia=0.5 * np.diag(np.diag(X)))
    refuted = certify_arm(law, arm, everywhere)
    assert refuted.verdict == "refuted"
    assert refuted.witness is not None
    away = distance_from_rest(arm, law, refuted.witness.posture, 1e-9, 25 / refuted.witness.growth_rate)
    assert away.max() > 1e-4


@pytest.mark.slow
def test_ur5e_certified_survives_fast_motion():
    arm = plants.MujocoPlant.from_file("ur5e", armature=0.1)
    box = Workspace.box(arm.home - 0.5, arm.home + 0.5)
    X, spread = best_inertia_shape(arm, box, samples=200)
    found = certify_varying_ratio(make_tdc(10, True)).evidence
    law = make_tdc(10, True, inertia=X * found.min_ratio * np.sqrt(found.ratio_spread / spread))
    assert certify_arm(law, arm, box).certified
    rng = np.random.default_rng(1)
    reference = signals.Multisine(
        amplitude=np.full((6, 2), 0.2), frequency=[4.0, 9.0], phase=rng.uniform(0, 6, (6, 2)), offset=arm.home
    )
    run = tarc.simulate(
        arm, law, reference, 2.0, initial_velocity=reference.sample(np.zeros(1))[1][:, 0], progress=False
    )
    assert run.status.completed
    assert np.abs(run.data["position"].values - arm.home).max() < 0.5
    assert np.abs(run.data["position"].values - run.data["reference"].values)[500:].max() < 0.05


def test_gains_that_differ_between_the_joints():
    slow = tdc_with_inertia_share(0.05, natural_frequency=[10.0, 15.0])
    verdict = certify_arm(slow)
    assert verdict.verdict == "inconclusive"
    assert verdict.verify()
    assert "only the loop at rest" in verdict.assumptions[-1]
    assert (
        suggestion(slow, verdict)
        == "Give all joints the same natural frequency and damping ratio, which the varying-ratio certificate needs"
    )
    fast_law = tdc_with_inertia_share(0.9, natural_frequency=[10.0, 15.0])
    refuted = certify_arm(fast_law)
    assert refuted.verdict == "refuted"
    assert refuted.verify()
    assert refuted.witness is not None
    away = distance_from_rest(ARM, fast_law, refuted.witness.posture, 1e-9, 20 / refuted.witness.growth_rate)
    assert away.max() > 1e-4


def adaptive_law(**options):
    return make_law(laws.TARC, inertia=0.05 * ARM.inertia([0.0, 1.5]), boundary_layer=0.1, **options)


def test_a_gain_without_a_cap_is_inconclusive():
    verdict = certify_arm(adaptive_law())
    assert verdict.verdict == "inconclusive"
    assert verdict.verify()
    assert "no maximum" in verdict.assumptions[-1]
    assert (
        suggestion(adaptive_law(), verdict)
        == "Give the gain a maximum, max_gain, without which nothing bounds the robust term"
    )
    # refuted all the same where the loop without the robust term is unstable
    assert certify_arm(make_law(laws.TARC, inertia=ARM.inertia([0.0, 1.5]))).verdict == "refuted"


def test_a_cap_decides():
    small, large = adaptive_law(max_gain=1.0), adaptive_law(max_gain=1000.0)
    assert certify_arm(small).certified
    assert certify_arm(small).evidence.slope == pytest.approx(10.0)
    assert "every slope of the robust term up to 10" in certify_arm(small).problem
    assert certify_arm(large).verdict == "inconclusive"
    assert "a smaller max_gain" in suggestion(large, certify_arm(large))
    radii = [ball_of(certify_arm(adaptive_law(max_gain=max_gain))).radius for max_gain in (1.0, 5.0, 20.0)]
    assert radii[0] > radii[1] > radii[2]


@pytest.mark.parametrize(
    ("law", "delay", "message"),
    [
        (
            tdc_with_inertia_share(0.9),
            0,
            "stable from 0.00486 to 0.2616. Use a smaller inertia, a shorter window or synchronised=True",
        ),
        (tdc_with_inertia_share(1e-3), 0, "Use a larger inertia or a lower natural frequency"),
        (tdc_with_inertia_share(4.0, synchronised=True), 0, "a shorter window or a lower natural frequency"),
        (tdc_with_inertia_share(0.05, natural_frequency=200.0), 60, "No ratio is stable: lower the natural frequency"),
    ],
)
def test_advice_for_a_refuted_design(law, delay, message):
    verdict = certify_arm(law, computation_delay=delay)
    assert verdict.verdict == "refuted"
    assert message in suggestion(law, verdict, delay)
    assert "held at rest at q = (" in suggestion(law, verdict, delay)


def test_advice_where_no_ball_is_wide_enough():
    """A loop that tolerates no ball at all is inconclusive, without an error."""
    law = adaptive_law(max_gain=1e6)
    verdict = certify_arm(law)
    assert verdict.verdict == "inconclusive"
    assert "allows none" in suggestion(law, verdict)


def test_computation_delay_counts():
    law = tdc_with_inertia_share(0.1)
    margins = [certify_arm(law, computation_delay=delay).margin for delay in (0, 1, 2)]
    assert margins[0] > margins[1] > margins[2]


def test_json_round_trip_verifies_and_tampering_shows(tmp_path):
    for law in (
        tdc_with_inertia_share(0.05),
        tdc_with_inertia_share(0.9),
        tdc_with_inertia_share(0.05, natural_frequency=[10.0, 15.0]),
        adaptive_law(max_gain=1.0),
    ):
        certificate = certify_arm(law)
        read = reread(certificate)
        assert read.verdict == certificate.verdict
        assert read.to_dict() == certificate.to_dict()
        assert read.verify()
        read.plot().savefig(tmp_path / "robot.png")
    certified = certify_arm(tdc_with_inertia_share(0.05))
    parts = ((f"ball.loop.{name}", 10.0) for name in UncertainLoop._fields[:3])
    points = (("points.min_ratio.inertia", 20.0), ("points.max_ratio.inertia", 0.1))
    for path, factor in (("nominal_inertia", 5.0), *points, *parts):
        assert not scaled(certified, path, factor).verify(), path
        with pytest.raises(InvalidParameter, match="cannot read it"):
            certificate_from_dict(without(certified, path))
    assert not scaled(certified, "ball.radius", 10).verify()
    assert not replaced(certified, "ball", None).verify()


def test_explains_itself():
    text = certify_arm(tdc_with_inertia_share(0.05)).explain()
    for part in (
        "Verdict: certified",
        "the eigenvalues of M(q)⁻¹M̂ lie between",
        "gravity and springs have a stiffness",
    ):
        assert part in text
    assert "Shown by: ratio" in certify_arm(tdc_with_inertia_share(0.9)).explain()


@dataclass(frozen=True, kw_only=True, eq=False)
class Telescope(plants.EulerLagrange):
    """A point mass that turns at a distance q2 from its axis, where nothing of it resists turning."""

    mass: float = 1.0

    @property
    def n_joints(self) -> int:
        return 2

    def kinetic_energy(self, q: Any, dq: Any, p: Any) -> Any:
        return p.mass * (q[1] ** 2 * dq[0] ** 2 + dq[1] ** 2) / 2

    def potential_energy(self, q: Any, p: Any) -> Any:
        return ca.SX(0)


def test_a_singular_inertia():
    law = make_tdc(inertia=0.05 * np.eye(2))
    for low, high in ((0.0, 0.0), (0.0, 1.0)):
        with pytest.raises(InvalidParameter, match=r"M\(q\) is singular .* rotor inertia"):
            certify_arm(law, Telescope(), Workspace.box([0.0, low], [0.0, high]))
    # with the axis inside the box no sample is on it, but the ratio grows without bound towards it
    with suppress(InvalidParameter):
        assert certify_arm(law, Telescope(), Workspace.box([0.0, -0.7], [0.0, 1.0])).verdict == "refuted"
    assert certify_arm(law, Telescope(), Workspace.box([0.0, 0.8], [0.0, 1.2])).certified


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (lambda: certify_arm(make_tdc(inertia=0.1 * np.eye(3))), "inertia", InvalidParameter),
        (
            lambda: certify_arm(tdc_with_inertia_share(0.05), workspace=Workspace.box([0.0], [1.0])),
            "workspace: it has 1 joints and the robot 2",
            InvalidParameter,
        ),
        (
            lambda: certify_arm(tdc_with_inertia_share(0.05), [ARM, plants.Pendulum()]),
            r"robots of \[2, 1\] joints",
            InvalidParameter,
        ),
        (lambda: certify_arm(tdc_with_inertia_share(0.05), []), "plant: got none", InvalidParameter),
        (
            lambda: certify_arm(tdc_with_inertia_share(0.05), workspace=ARM),
            "workspace: got TwoLinkArm",
            InvalidParameter,
        ),
        (
            lambda: certify_arm(tdc_with_inertia_share(0.05), computation_delay=-1),
            "computation_delay: got -1",
            InvalidParameter,
        ),
        (lambda: certify_arm("TDC"), "law: got str", UnsupportedLaw),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()


# What "gravity and friction disturb only" leaves out, near the lower end of the stable range


def test_gravity_that_the_loop_cannot_hold_is_seen():
    """An inverted pendulum at a ratio near the lower edge: stable without gravity, falls with it."""
    plant, law = plants.Pendulum(), make_tdc(inertia=0.005)
    verdict = certify_arm(law, plant, Workspace.box([3.0], [3.3]))
    assert verdict.verdict == "refuted"
    assert verdict.evidence.stiffness == pytest.approx(9.81, rel=1e-3)
    away = distance_from_rest(plant, law, [np.pi], 1e-3, 40.0)
    assert away[-10_000:].max() > 2 * away[:10_000].max()
    assert certify_arm(law, plants.Pendulum(gravity=0.0), Workspace.box([3.0], [3.3])).verdict == "inconclusive"
    higher = make_tdc(inertia=0.0055)
    assert certify_arm(higher, plant, Workspace.box([3.0], [3.3])).verdict == "inconclusive"
    assert certify_arm(higher, plants.Pendulum(gravity=0.0), Workspace.box([3.0], [3.3])).certified
    higher = make_tdc(inertia=0.009)
    assert certify_arm(higher, plant, Workspace.box([3.0], [3.3])).certified
    away = distance_from_rest(plant, higher, [np.pi], 1e-3, 20.0)
    assert away[-5_000:].max() < 0.1 * away[:5_000].max()


def test_viscous_friction_counts_where_the_robot_is_at_rest():
    """Too small an inertia grows without friction and decays with it: not refuted."""
    where, law = Workspace.box([0.0, 1.5], [0.0, 1.5]), tdc_with_inertia_share(0.004)
    assert certify_arm(law, plants.TwoLinkArm(), where).verdict == "refuted"
    plant = plants.TwoLinkArm(viscous=[5.0, 5.0])
    assert certify_arm(law, plant, where).verdict == "inconclusive"
    away = distance_from_rest(plant, law, [0.0, 1.5], 1e-2, 30.0)
    assert away[-10_000:].max() < away[:10_000].max()


def test_no_law_is_certified_without_its_robust_term():
    """A switching term of 500 rad/s² in a thin layer makes the arm chatter from a start a millionth beside rest."""
    law = make_law(laws.SlidingMode, inertia=0.05 * ARM.inertia([0.0, 1.5]), gain=500.0, boundary_layer=0.05)
    assert distance_from_rest(ARM, law, [0.0, 1.5], 1e-6, 1.0)[-200:].max() > 1e-3
    verdict = certify_arm(law)
    assert verdict.verdict == "inconclusive"
    assert "left out: the robust term" in verdict.explain()


# Mismatch and stiffness of one posture together


def joint_norms(law, verdict, instants):
    """Return what the ball must hold, of robots at rest or moving, with the verdict's own centre, weight and lead."""
    ball = ball_of(verdict)
    return uncertainty_samples(law.M, instants).joint_norms(
        ball.centre, ball.position_weight, ball.loop.lead_periods.item() * law.period
    )


@pytest.mark.parametrize(
    ("both", "low", "high"),
    [
        ([plants.NLinkArm(), plants.NLinkArm(payload=1.0)], [-np.pi, -1.5, 0.3], [np.pi, 1.5, 1.5]),
        ([ARM, LOADED], [-np.pi, 0.5], [np.pi, 2.6]),
    ],
)
def test_the_worst_posture_is_sought_and_not_only_sampled(both, low, high):
    """Inertia alone does not tell it: gravity depends on the first joint and the eigenvalues of M⁻¹M̂ do not."""
    box = Workspace.box(low, high)
    X, spread = best_inertia_shape(both, box, samples=200)
    for part in (0.5, 0.9):
        law = make_tdc(3, True, natural_frequency=3.0, inertia=part * 2.0 / (1 + spread) * X)
        verdict = certify_arm(law, both, box)
        needed = ball_of(verdict).radius / (1 + verdict.margin)
        found = joint_norms(law, verdict, sample_points(both, box, 1500, 77))
        assert found.max() <= 1.01 * needed
        assert joint_norms(
            law, verdict, [OperatingPoint.at_rest(both[0], verdict.evidence.points.largest_norm.position)]
        )[0] <= needed * (1 + 1e-9)


def test_every_payload_between_needs_no_more_than_the_ends():
    """M and ∂g/∂q grow evenly with it, and what a ball holds is convex in them."""
    law = make_tdc(5, True, natural_frequency=3.0, inertia=0.1 * ARM.inertia([0.0, 1.5]))
    verdict = certify_arm(law, [ARM, LOADED], BOX)
    rng = np.random.default_rng(0)
    for _ in range(100):
        posture = rng.uniform(BOX.low, BOX.high)
        ends = joint_norms(
            law, verdict, [OperatingPoint.at_rest(ARM, posture), OperatingPoint.at_rest(LOADED, posture)]
        ).max()
        between = [
            OperatingPoint.at_rest(plants.TwoLinkArm(payload=float(mass)), posture) for mass in rng.uniform(0, 2, 3)
        ]
        assert joint_norms(law, verdict, between).max() <= ends * (1 + 1e-9)


def barely_certified_law(law_of, both, box, sound, unsound):
    """Return a certified law close to the last that is."""
    for _ in range(7):
        middle = np.sqrt(sound * unsound)
        sound, unsound = (middle, unsound) if certify_arm(law_of(middle), both, box).certified else (sound, middle)
    assert 0 <= certify_arm(law_of(sound), both, box).margin < 0.15
    return law_of(sound)


@pytest.mark.parametrize("natural_frequency", [2.0, 5.0])
def test_certified_with_the_least_inertia_holds_against_gravity_anywhere(natural_frequency):
    """Where gravity takes most of the ball: hung, upright and in the worst postures, empty and loaded."""
    box = Workspace.box([-np.pi, 0.8], [np.pi, 2.2])
    X, _ = best_inertia_shape([ARM, LOADED], box, samples=200)

    def law_of(scale):
        return make_tdc(3, True, natural_frequency=natural_frequency, inertia=scale * X)

    law = barely_certified_law(law_of, [ARM, LOADED], box, 0.2, 1e-3)
    verdict = certify_arm(law, [ARM, LOADED], box)
    assert ball_of(verdict).position_weight > 0
    loop = decoupled_channels(law)[0].closed_loop(0.0)[:3]
    for plant, posture, *_ in sample_points([ARM, LOADED], box, 300, 5):
        assert (
            np.abs(np.linalg.eigvals(rest_state_matrix(loop, law.M, plant.linearised(posture), law.period))).max() < 1
        )
    worst = [point.position for point in (verdict.evidence.points.largest_norm, verdict.evidence.points.min_ratio)]
    for posture in ([np.pi / 2, 0.8], [-np.pi / 2, 0.8], *worst):
        for plant in (ARM, LOADED):
            away = distance_from_rest(plant, law, posture, np.array([1e-3, -1e-3]), 15 / natural_frequency)
            quarter = len(away) // 4
            assert away[3 * quarter :].max() < 0.2 * away[:quarter].max()


def test_stiffness_left_out_certifies_nothing():
    """Neither with the weight taken away nor with more stiffness, another weight, or numbers that are none."""
    box = Workspace.box([-np.pi, 0.8], [np.pi, 2.2])
    X, _ = best_inertia_shape([ARM, LOADED], box, samples=200)
    law = barely_certified_law(
        lambda scale: make_tdc(3, True, natural_frequency=3.0, inertia=scale * X), [ARM, LOADED], box, 0.2, 1e-3
    )
    certified = certify_arm(law, [ARM, LOADED], box)
    for name, factors in (
        ("position_weight", (0.0, -1.0, 1e-3, 0.1, 3.0, 10.0, np.inf, np.nan)),
        ("radius", (0.0, -1.0, 1.01, 2.0, np.inf, np.nan)),
        ("centre", (0.0, -1.0, 0.5, 2.0, np.nan)),
    ):
        for factor in factors:
            assert not scaled(certified, f"ball.{name}", factor).verify(), (name, factor)
    for name in ("min_ratio", "max_ratio", "stiffest", "largest_norm"):
        for factor in (30.0, 1e6):
            assert not scaled(certified, f"points.{name}.stiffness", factor).verify(), (name, factor)
    assert not scaled(certified, "points.largest_norm.stiffness", 1.3).verify()


@dataclass(frozen=True, kw_only=True, eq=False)
class Sprung(plants.EulerLagrange):
    """Masses on springs of their own, which may be negative, or one whose energy is no number left of zero."""

    count: int = 1
    spring: float = 0.0
    root: float = 0.0

    @property
    def n_joints(self) -> int:
        return int(self.count)

    def kinetic_energy(self, q: Any, dq: Any, p: Any) -> Any:
        return ca.dot(dq, dq) / 2

    def potential_energy(self, q: Any, p: Any) -> Any:
        return p.spring * ca.dot(q, q) / 2 + (ca.sqrt(q[0]) ** 3 if self.root else 0.0)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("spring", [0.0, 1e-12, 1e-6, 1.0, 1e3, 1e5, 1e6, 1e8, -1.0, -1e3])
def test_one_posture_and_any_stiffness(count, spring):
    """No spread at all, so that stiffness alone decides; certified only where the loop at rest is stable."""
    law, plant = make_tdc(5, True, inertia=0.5 * np.eye(count)), Sprung(count=count, spring=spring)
    for width in (0.0, 1.0):
        verdict = certify_arm(law, plant, Workspace.box([0.0] * count, [width] * count))
        assert verdict.verify()
        assert (ball_of(verdict).position_weight > 0) == (abs(spring) > 1e-9)
        loop = decoupled_channels(law)[0].closed_loop(0.0)[:3]
        size = np.abs(
            np.linalg.eigvals(rest_state_matrix(loop, law.M, plant.linearised([0.0] * count), law.period))
        ).max()
        expected = "refuted" if size > 1 else "certified" if abs(spring) < 2e3 else "inconclusive"
        assert verdict.verdict == expected


def test_no_gravity_no_weight():
    flat = plants.TwoLinkArm(gravity=0.0)
    verdict = certify_arm(tdc_with_inertia_share(0.05), flat)
    assert verdict.certified
    assert ball_of(verdict).position_weight == verdict.evidence.stiffness == 0.0
    assert verdict.margin > certify_arm(tdc_with_inertia_share(0.05)).margin


def test_a_stiffness_that_is_not_a_number():
    law = make_tdc(5, True, inertia=0.5)
    with pytest.raises(InvalidParameter, match="stiffness: that of gravity and springs is not finite at q = "):
        certify_arm(law, Sprung(root=1.0), Workspace.box([-1.0], [1.0]))


def test_a_tube_about_a_path_is_searched_too():
    tube = Workspace.from_reference(
        signals.Sinusoid(amplitude=[0.3, 0.3], frequency=1.0, offset=[0.0, 1.5]), 2.0, tube=0.1
    )
    law = tdc_with_inertia_share(0.05)
    verdict = certify_arm(law, [ARM, LOADED], tube)
    needed = ball_of(verdict).radius / (1 + verdict.margin)
    assert joint_norms(law, verdict, sample_points([ARM, LOADED], tube, 1000, 3)).max() <= 1.01 * needed


def test_what_fast_motion_adds_is_not_covered_and_said_so():
    """At constant speed an arm without gravity has a stiffness of its own, which a certified loop need not tolerate."""
    arm, box = plants.TwoLinkArm(gravity=0.0), Workspace.box([-3.0, 0.8], [3.0, 2.2])
    X, _ = best_inertia_shape(arm, box, samples=200)
    law = make_tdc(3, True, natural_frequency=2.0, inertia=0.006 * X)
    verdict = certify_arm(law, arm, box)
    assert verdict.certified
    assert any("the stiffness and damping of fast motion are left out" in line for line in verdict.assumptions)
    loop, q, nudges = decoupled_channels(law)[0].closed_loop(0.0)[:3], np.array([0.0, 2.2]), 1e-5 * np.eye(2)
    sizes = []
    for speed in (0.0, 1.0, 6.0):
        dq = np.array([speed, 0.0])
        stiffness = np.column_stack([(arm.bias(q + d, dq) - arm.bias(q - d, dq)) / 2e-5 for d in nudges])
        damping = np.column_stack([(arm.bias(q, dq + d) - arm.bias(q, dq - d)) / 2e-5 for d in nudges])
        A = rest_state_matrix(loop, law.M, (arm.inertia(q), damping, stiffness), law.period)
        sizes.append(np.abs(np.linalg.eigvals(A)).max())
    assert sizes[0] < 1
    assert sizes[1] < 1
    assert sizes[2] > 1
