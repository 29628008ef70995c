"""The robot certificate: the uncertainty of a robot over a workspace against what the loop tolerates."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tarc.analysis.command_units import in_torque_units
from tarc.analysis.inertia_ratio import InertiaSpread, as_plants
from tarc.analysis.linearise import (
    Channel,
    coupled_channel,
    decoupled_channels,
    joints_share_loop,
    refuse_nominal_inertia,
    require_inertia,
)
from tarc.analysis.operating_points import SEARCH_MARGIN
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.analysis.workspace import Workspace
from tarc.analysis.worst_points import SampledPoints
from tarc.certificates.affine import ORDERS, AffineProof, spectral_radii
from tarc.certificates.affine_cover import cover_robot
from tarc.certificates.ball_search import NO_CANDIDATE, BallCandidate, fit_ball
from tarc.certificates.base import Certificate, LoopMatrices, Verdict
from tarc.certificates.robot_evidence import (
    RobotEvidence,
    WorstPoints,
    linearised_point,
)
from tarc.certificates.robot_points import MAX_STIFFNESS_SAMPLES, RobotPoints
from tarc.core.errors import UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.plants.base import Plant


def certify_robot(
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    computation_delay: int = 0,
    samples: int = 2000,
    seed: int = 0,
    channels: Sequence[Channel] | None = None,
    points: RobotPoints | None = None,
    least_margin: float = -1.0,
) -> Certificate[RobotEvidence]:
    """Certify a law on a robot whose posture changes inside a workspace.

    A small error about a motion obeys, in coordinates x = M̂^½ q, ẍ = E v − H x − C ẋ with E = M̂^½ M⁻¹ M̂^½ and

        H = M̂^½ M⁻¹ (∂(M q̈ + N)/∂q) M̂^−½,    C = M̂^½ M⁻¹ (∂N/∂q̇) M̂^−½,

    the stiffness and damping of gravity, springs and the motion itself. The law is certified if every operating point
    satisfies ‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ. Here δ is the radius that the loop tolerates, together with every slope
    of the robust term. The weight η and the lead time θ maximise the margin. Samples and search may miss the worst
    point. So this must hold for 5 % more of E, E⁻¹, H, C and the rate than was found. It must hold for C + H T as well,
    because the position moves within a period, see `tarc.analysis.operating_points.UncertaintySamples`.

    With a speed in the workspace, the operating points are all motions up to that speed and its acceleration. The
    radius δ is then that for the largest ‖dE⁻¹/dt‖ at this speed, and is much larger. Without a speed E may change at
    any rate, but H and C are those at rest. So what motion adds to them is not certified.

    The loop at ρ0 is stable. The robot is reached from there along E_τ⁻¹ = (1 − τ)/ρ0 + τ E⁻¹, H_τ = F_τ H and
    C_τ = F_τ C with F_τ = ρ0 τ ((1 − τ) E + τ ρ0)⁻¹. Since E_τ − ρ0 I = F_τ (E − ρ0 I) and ‖F_τ‖ ≤ 1, all points of
    this way satisfy the condition, and E_τ⁻¹ changes no faster.

    The law is refuted if the robot, held at rest in one of the worst postures, is unstable. That test includes its
    inertia, gravity and viscous friction. Otherwise the verdict is inconclusive, as for gains that differ between the
    joints.

    Parameters
    ----------
    law
        A law with an inertia M̂.
    plant
        The robot, or several, such as one without and one with its payload. M, G and D are affine in a payload. With
        that the condition is convex in it for δ ≤ ρ0, as (I − ρ0 E⁻¹)² + (Ĝ Ĝᵀ + Ĉ Ĉᵀ/θ²)/η² ≼ δ² E⁻² shows. So both
        ends stand for each payload between. ‖[H, C/θ]‖ alone, which counts for a bounded rate, is left to the margin.
    workspace
        The postures that it takes.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Number of sampled postures, and the seed. Local searches start from the best samples.
    channels
        The loops of `tarc.analysis.linearise.decoupled_channels` for law and delay, where they exist already.
    points
        Result of `RobotPoints.from_robot` for the same robot, workspace, samples and seed, and M̂ or a multiple of it,
        where it exists already. What searches find is added to it.
    least_margin
        Margin below which an inconclusive verdict need not find the best ball, which takes longer.

    Returns
    -------
    Certificate
        Its evidence has the smallest and the largest inertia ratio, the worst points, and the ball. The margin is the
        ball's radius over the needed one, less 1. For a refutation it is 1 less the spectral radius.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia, and for one with a model N̂ or M̂(q) of the robot.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        For numbers of joints that differ, and for an inertia matrix that is singular at a posture.
    """
    law = require_inertia(law, "the robot certificate")
    _refuse_model(law)
    law, plants = in_torque_units(law, as_plants(plant))
    robot = _points(points, plants, law.M, workspace, samples, seed)
    spread, workspace = robot.spread, workspace.for_joints(plants[0].joint_names)
    is_bounded = bool(np.isfinite(law.robust_slope_bound))
    slope = law.robust_slope_bound if is_bounded else 0.0
    ball, coupled_loop, rate_point, candidate = None, None, None, NO_CANDIDATE
    if joints_share_loop(law):
        channel = (decoupled_channels(law, computation_delay) if channels is None else channels)[0]
        candidate, ball = fit_ball(channel, slope, robot, 1 + least_margin)
        rate_point = None if candidate.max_change is None else robot.max_rate_point()
    else:
        channel = coupled_channel(law, computation_delay)
        coupled_loop = LoopMatrices(*channel.closed_loop(0.0)[:3])
    evidence = RobotEvidence(
        nominal_inertia=law.M,
        period=law.period,
        robust_term_is_bounded=is_bounded,
        ball=ball,
        coupled_loop=coupled_loop,
        points=_worst_points(robot.sampled, candidate, law.period),
        max_rate_point=rate_point,
        min_ratio=spread.min_ratio,
        max_ratio=spread.max_ratio,
        stiffness=float(robot.sampled.uncertainty.stiffness_norms(candidate.lead_time).max()),
        slope=slope,
        samples=spread.samples,
    )
    verdict, margin, witness = evidence.judge()
    evidence = evidence.with_decay() if verdict == Verdict.CERTIFIED else evidence
    refuted = verdict == Verdict.REFUTED
    return Certificate(
        claim=_claim(law, workspace),
        problem=_problem(evidence),
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the spectral radius in that posture"
        if refuted
        else "radius over the one needed, less 1",
        assumptions=_assumptions(law, plants[0], spread, evidence, workspace, computation_delay),
        evidence=evidence,
        witness=witness,
        basis=f"{spread.samples} sampled postures and local search",
    )


def strengthen_robot(
    certificate: Certificate[RobotEvidence],
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    computation_delay: int = 0,
    samples: int = 2000,
    seed: int = 0,
    channels: Sequence[Channel] | None = None,
    points: RobotPoints | None = None,
    on_program: Callable[[], object] = lambda: None,
    start: AffineProof | None = None,
    orders: Sequence[int] = ORDERS,
) -> Certificate[RobotEvidence]:
    """Return the better of a robot certificate and one by a Lyapunov function affine in the inertia.

    That of `tarc.certificates.certify_affine`, with stiffness and damping as a torque k beside v, ẍ = E (v + k),

        ‖k‖² ≤ κ_θ² (‖x‖² + θ² ‖ẋ‖²),    κ_θ = sup ‖E⁻¹[H, C/θ]‖ = sup ‖M̂^−½ [G, D/θ] M̂^−½‖,

    which holds no M⁻¹. Where such norms do not suffice, a form that also knows the power of stiffness and damping takes
    their place, see `tarc.certificates.force_form`. It must cover ratios, rate and forces that are larger than all that
    were found by `SEARCH_MARGIN`.

    It takes seconds. So it is left out for a law that is refuted or certified. It is also left out for one that is
    unstable at a constant ratio of that range. It needs a workspace with a speed, and the same loop on each joint.

    Parameters
    ----------
    certificate
        Result of `certify_robot` for the same arguments.
    law, plant, workspace, computation_delay, samples, seed, channels, points
        As in `certify_robot`.
    on_program
        Called after each semidefinite program, to show progress.
    start
        A Lyapunov function with a form, for the same loop and fewer points, which is tried before others.
    orders
        Numbers of states to which the loop is reduced, tried in turn. Without the last one a search that fails takes a
        tenth of the time.
    """
    evidence = certificate.evidence
    if certificate.verdict != Verdict.INCONCLUSIVE or evidence.ball is None or workspace.speed is None:
        return certificate
    if not evidence.robust_term_is_bounded:
        return certificate
    law = require_inertia(law, "the robot certificate")
    channel = (decoupled_channels(law, computation_delay) if channels is None else channels)[0]
    law, plants = in_torque_units(law, as_plants(plant))
    robot = _points(points, plants, law.M, workspace, samples, seed)
    spread, workspace = robot.spread, workspace.for_joints(plants[0].joint_names)
    loop = UncertainLoop.from_channel(channel, evidence.slope, intersample=True)
    room = 1 + SEARCH_MARGIN
    if spectral_radii(loop, spread.min_ratio / room, spread.max_ratio * room)[1].max() >= 1:
        return certificate
    found = [robot.max_rate_point(), robot.max_relative_rate_point()]
    rate_points = tuple(point for point in found if point is not None)
    known = evidence.uncertainty()
    slope, sampled = evidence.slope, robot.sampled
    cover = cover_robot(channel, slope, spread, sampled, rate_points, known, on_program, start=start, orders=orders)
    if cover is None:
        return certificate
    evidence = replace(evidence, affine=cover)
    verdict, margin, witness = evidence.judge()
    if verdict != Verdict.CERTIFIED:
        return certificate
    return replace(
        certificate,
        evidence=evidence,
        problem="A(λ)ᵀ (P(λ) + s S) A(λ) ≺ e^{−2αT} P(λ), P(λ) = P0 + P1/λ ≻ 0, S ± P1 ⪰ 0 for all inertia ratios λ, "
        "with stiffness, damping and the slope of the robust term by the S-procedure",
        verdict=verdict,
        margin=margin,
        margin_meaning="growth of ratios, rate and forces that is covered",
        assumptions=_assumptions(law, plants[0], spread, evidence, workspace, computation_delay),
        witness=witness,
        proof_grade=True,
    )


def _claim(law: PolePlacement, workspace: Workspace) -> str:
    """Return what is claimed; without a speed nothing of fast motion."""
    motion = "in every posture of the workspace, with an inertia that changes at any rate and the stiffness at rest"
    if workspace.speed is not None:
        motion = "however it moves in the workspace, within the given speeds and accelerations of the joints"
    return f"{type(law).__name__} keeps the robot stable {motion}."


def _problem(evidence: RobotEvidence) -> str:
    """Return the tested condition as a formula."""
    condition = "‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ for all motions in the workspace"
    if evidence.rate is None:
        condition += ", δ < 1/‖[T_v; η T_q; η θ T_q̇]‖∞"
    else:
        condition += ", for a radius δ that the loop tolerates at the largest ‖dE⁻¹/dt‖"
    if evidence.slope:
        condition += f", with every slope of the robust term up to {evidence.slope:.4g} 1/s²"
    return condition


def _points(
    points: RobotPoints | None, plants: Sequence[Plant], nominal: Array, workspace: Workspace, samples: int, seed: int
) -> RobotPoints:
    """Return the points for this M̂, from those for a multiple of it where they are there."""
    if points is None:
        return RobotPoints.from_robot(plants, nominal, workspace, samples=samples, seed=seed)
    return points.for_inertia(nominal)


def _worst_points(sampled: SampledPoints, candidate: "BallCandidate", period: float) -> WorstPoints:
    """Return the first two points, and those of the largest stiffness and joint norm, at rest and moving."""
    points, uncertainty = sampled.points, sampled.uncertainty
    stiffness_norms = uncertainty.stiffness_norms(candidate.lead_time)
    is_moving = np.array([point.is_moving for point in points])

    def stiffest(included: Array) -> int:
        return int(np.argmax(np.where(included, stiffness_norms, -1.0)))

    def largest(included: Array) -> int:
        if not candidate.position_weight:
            return stiffest(included)
        ball = candidate.centre, candidate.position_weight, candidate.lead_time
        return uncertainty.place_of_largest_norm(included, *ball, SEARCH_MARGIN, period)

    has_moving = bool(is_moving.any())
    return WorstPoints(
        min_ratio=linearised_point(points[0]),
        max_ratio=linearised_point(points[1]),
        stiffest=linearised_point(points[stiffest(~is_moving)]),
        largest_norm=linearised_point(points[largest(~is_moving)]),
        stiffest_moving=linearised_point(points[stiffest(is_moving)]) if has_moving else None,
        largest_norm_moving=linearised_point(points[largest(is_moving)]) if has_moving else None,
    )


def _assumptions(
    law: PolePlacement,
    plant: Plant,
    spread: InertiaSpread,
    evidence: RobotEvidence,
    workspace: Workspace,
    computation_delay: int,
) -> tuple[str, ...]:
    """Return what the verdict takes for granted."""
    motion = "" if workspace.speed is None else ", and the motion itself,"
    lines = [
        f"the eigenvalues of M(q)⁻¹M̂ lie between {spread.min_ratio:.4g}, at q = ({format_vector(spread.min_posture)}), "
        f"and {spread.max_ratio:.4g}, at ({format_vector(spread.max_posture)}); {spread.samples} samples and local "
        "search found no others",
        f"gravity and springs{motion} have a stiffness, in these coordinates, of at most {evidence.stiffness:.3g} "
        f"1/s²; like the inertia, it is from {min(spread.samples, MAX_STIFFNESS_SAMPLES)} samples, the two postures "
        "above and local search",
        _search_assumption(),
        "the robot stays in the workspace; viscous friction is anything between none and that of the robot, and "
        "changes at any time; dry friction is only a disturbance, and may stop a mode that is refuted",
        "no torque limit is reached and no sample is lost",
        f"the torque reaches the joints {computation_delay} periods late and is held for a period",
        _motion_assumption(evidence, workspace),
    ]
    if isinstance(law, TARC) and law.max_gain is None:
        lines.append("the gain has no maximum, so nothing bounds the robust term; give max_gain to have it certified")
    elif not np.isfinite(law.robust_slope_bound):
        lines.append("left out: the robust term, whose slope over the error has no bound; without it the verdict holds")
    if not joints_share_loop(law):
        lines.append("gains that differ between the joints: only the loop at rest in the worst postures was tested")
    if plant.locked:
        names = ", ".join(f"{name} ({reason})" for name, reason in plant.locked.items())
        lines.append(f"these joints are locked and do not move: {names}")
    return tuple(lines)


def _search_assumption() -> str:
    """Return what the verdict leaves for points that samples and search have missed."""
    return (
        "samples and search may have missed the worst point, but by no more than the verdict leaves for it: "
        f"{100 * SEARCH_MARGIN:.0f} % more of ratios and their inverses, stiffness, damping and rate"
    )


def _motion_assumption(evidence: RobotEvidence, workspace: Workspace) -> str:
    """Return what is assumed of the speed of the joints."""
    if workspace.speed is None or workspace.acceleration is None:
        return (
            "Coriolis forces are only a disturbance: the stiffness and damping of fast motion are left out, which a "
            "bound on the joints' speeds would include"
        )
    changes = ""
    if evidence.rate is not None:
        changes = (
            f"; so M̂^−½ M M̂^−½ changes by at most {evidence.rate:.3g} 1/s, {100 * SEARCH_MARGIN:.0f} % more than "
            "samples and local search found"
        )
    return (
        f"no joint is faster than ({format_vector(workspace.speed)}) rad/s or m/s, or accelerates by more than "
        f"({format_vector(workspace.acceleration)}) rad/s² or m/s²{changes}; the payload stays the same, or changes so "
        "rarely that the loop settles in between"
    )


def _refuse_model(law: PolePlacement) -> None:
    """Raise `UnsupportedLaw` for a law with a model, whose N̂ changes stiffness and damping of the loop."""
    refuse_nominal_inertia(law, "the robot certificate")
    if law.has_model:
        raise UnsupportedLaw(
            f"law: {type(law).__name__} has a model, whose torque N̂ the robot certificate does not cover; certify the "
            "law without one (model=None), or its loop by tarc.certificates.certify_constant_ratio"
        )
