"""The robot certificate: the uncertainty of a robot over a workspace against what the loop tolerates."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from tarc.analysis.command_units import in_torque_units
from tarc.analysis.inertia_ratio import InertiaSpread, as_plants, inertia_spread
from tarc.analysis.linearise import (
    Channel,
    coupled_channel,
    decoupled_channels,
    joints_share_loop,
    require_inertia,
)
from tarc.analysis.operating_points import (
    NEGLIGIBLE_STIFFNESS,
    OperatingPoint,
    SampledPoints,
    UncertaintySamples,
    inertia_rates,
    linearise_point,
    max_rate_point,
    to_nominal_coordinates,
)
from tarc.analysis.rest_stability import rest_state_matrix
from tarc.analysis.stability import UnstableMode, Witness, unstable_mode
from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate, Evidence, Judgement, LoopMatrices, Verdict
from tarc.certificates.iqc import best_multiplier
from tarc.certificates.varying_ratio import Ball, RadiusProof, best_centre, make_ball, max_radius
from tarc.core.errors import UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.numerics.matrix_tests import schur_stability
from tarc.plants.base import Plant

LEAD_FACTORS = 0.5, 1.0
"""Lead times to try, over that at which damping counts as much as stiffness."""
MAX_CANDIDATES = 4
"""Largest number of balls that are tested at all frequencies."""
MAX_STIFFNESS_SAMPLES = 500
"""Largest number of postures whose stiffness is computed; it varies less than the eigenvalues of the inertia."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedPoint:
    """A robot linearised in a posture: M δq̈ + D δq̇ + G δq = δτ.

    Attributes
    ----------
    position
        Posture [rad or m], shape (n,).
    inertia, damping, stiffness
        M, D and G, shape (n, n).
    velocity, acceleration
        Of the motion, shape (n,); None at rest.
    """

    position: Array
    inertia: Array
    damping: Array
    stiffness: Array
    velocity: Array | None = None
    acceleration: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class WorstPoints:
    """The points of a workspace that limit the certificate.

    Attributes
    ----------
    min_ratio, max_ratio
        At rest, of the smallest and the largest inertia ratio.
    stiffest, largest_norm
        At rest, of the largest ‖[H, C/θ]‖ and ‖[E − ρ0 I, H/η, C/(η θ)]‖.
    stiffest_moving, largest_norm_moving
        The same in motion; None for a workspace without speeds.
    """

    min_ratio: LinearisedPoint
    max_ratio: LinearisedPoint
    stiffest: LinearisedPoint
    largest_norm: LinearisedPoint
    stiffest_moving: LinearisedPoint | None = None
    largest_norm_moving: LinearisedPoint | None = None

    def at_rest(self) -> tuple[LinearisedPoint, ...]:
        """Return the points at rest."""
        return self.min_ratio, self.max_ratio, self.stiffest, self.largest_norm

    def moving(self) -> tuple[LinearisedPoint, ...]:
        """Return the points in motion."""
        return tuple(point for point in (self.stiffest_moving, self.largest_norm_moving) if point is not None)


@dataclass(frozen=True, kw_only=True, eq=False)
class MaxRatePoint:
    """The posture in which the inertia changes fastest.

    Attributes
    ----------
    position
        Posture [rad or m], shape (n,).
    inertia_slopes
        ∂M/∂q_i, shape (n, n, n), the joint i first.
    velocity_limits
        Largest speed of each joint [rad/s or m/s], shape (n,).
    """

    position: Array
    inertia_slopes: Array
    velocity_limits: Array

    def rate(self, nominal: Array) -> float:
        """Return the largest ‖dE⁻¹/dt‖ [1/s] there, for M̂ (n, n)."""
        return float(inertia_rates(nominal, self.inertia_slopes[None], self.velocity_limits)[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotEvidence(Evidence):
    """The worst points of a robot in a workspace, and the ball that must contain them.

    Attributes
    ----------
    nominal_inertia
        M̂ [kg m² or kg], shape (n, n).
    period
        T [s].
    robust_term_is_bounded
        Whether the slope of the robust term has a bound.
    ball
        The ball that the loop tolerates; None for gains that differ between the joints.
    coupled_loop
        The loop of all joints where there is no ball.
    points
        The robot linearised at its worst points.
    max_rate_point
        Where the inertia changes fastest; None where the rate is not bounded.
    min_ratio, max_ratio
        Smallest and largest eigenvalue of M(q)⁻¹M̂ over the workspace. Like the rest, `judge` does not use them.
    stiffness
        Largest ‖[H, C/θ]‖ [1/s²].
    slope
        Largest slope of the robust term [1/s²].
    samples
        Number of sampled postures.
    """

    kind: ClassVar[str] = "robot"
    witness_type: ClassVar[type[Witness] | None] = UnstableMode

    nominal_inertia: Array
    period: float
    robust_term_is_bounded: bool
    ball: Ball | None
    coupled_loop: LoopMatrices | None
    points: WorstPoints
    max_rate_point: MaxRatePoint | None
    min_ratio: float
    max_ratio: float
    stiffness: float
    slope: float
    samples: int

    @property
    def ratio_spread(self) -> float:
        """Largest by smallest inertia ratio over the workspace."""
        return self.max_ratio / self.min_ratio

    @property
    def rate(self) -> float | None:
        """Largest ‖dE⁻¹/dt‖ [1/s] that the ball allows; None for any."""
        return None if self.ball is None or self.ball.max_change is None else self.ball.max_change / self.period

    def judge(self) -> Judgement:
        """Test the worst points at rest for a mode that grows, then whether the ball contains all points."""
        smallest, largest = np.inf, 0.0
        worst_radius, witness = 1.0, None
        loop = self._open_loop()
        for point in self.points.at_rest():
            ratios = np.linalg.eigvals(np.linalg.solve(point.inertia, self.nominal_inertia)).real
            smallest, largest = min(smallest, ratios.min()), max(largest, ratios.max())
            matrices = point.inertia, point.damping, point.stiffness
            state_matrix = rest_state_matrix(loop, self.nominal_inertia, matrices, self.period)
            verdict, radius, mode = schur_stability(state_matrix)
            if verdict == "refuted" and radius > worst_radius:
                ratio = ratios.max() if point is self.points.max_ratio else ratios.min()
                worst_radius, witness = radius, unstable_mode(radius, mode, self.period)
                witness = replace(witness, ratio=float(ratio), posture=point.position)
        if witness:
            return Judgement(Verdict.REFUTED, float(1 - worst_radius), witness)
        if self.ball is None:
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        return self._judge_ball(self.ball, float(smallest), float(largest))

    def _open_loop(self) -> tuple[Array, Array, Array]:
        """Return A, B, C of the loop opened at its inertia ratio."""
        if self.ball is not None:
            return self.ball.loop.A, self.ball.loop.B, self.ball.loop.C
        if self.coupled_loop is None:
            raise ValueError("evidence: it has neither a ball nor a loop of all joints")
        return self.coupled_loop.A, self.coupled_loop.B, self.coupled_loop.C

    def _judge_ball(self, ball: Ball, smallest: float, largest: float) -> Judgement:
        """Test whether the ball contains the ratios, the stiffness and the rate of all points."""
        lead_time = ball.loop.lead_periods.item() * self.period
        uncertainty = self._uncertainty()
        stiffness = float(uncertainty.stiffness_norms(lead_time).max())
        undecided = Judgement(Verdict.INCONCLUSIVE, 0.0)
        has_damping = float(np.abs(uncertainty.damping).max()) > NEGLIGIBLE_STIFFNESS
        if not np.isfinite(lead_time) or (lead_time <= 0 and has_damping):
            return undecided
        needed_radius = max(largest - ball.centre, ball.centre - smallest)
        if ball.position_weight > 0:
            joint_norms = uncertainty.joint_norms(ball.centre, ball.position_weight, lead_time)
            needed_radius = max(needed_radius, float(joint_norms.max()))
        elif not stiffness <= NEGLIGIBLE_STIFFNESS:  # without a weight the ball leaves the stiffness out
            return undecided
        if ball.max_change is not None:
            if self.max_rate_point is None or not stiffness <= (1 + 1e-9) * ball.stiffness:
                return undecided
            if self.max_rate_point.rate(self.nominal_inertia) * self.period / (1 + 1e-9) > ball.max_change:
                return undecided
        judgement = ball.judge(needed_radius)
        return judgement if self.robust_term_is_bounded else judgement._replace(verdict=Verdict.INCONCLUSIVE)

    def _uncertainty(self) -> UncertaintySamples:
        """Return the uncertainty at all points, without the viscous friction of those at rest."""
        points = [*self.points.at_rest(), *self.points.moving()]
        M, D, G = (np.array([getattr(point, name) for point in points]) for name in ("inertia", "damping", "stiffness"))
        D[: len(self.points.at_rest())] = 0
        return to_nominal_coordinates(self.nominal_inertia, M, D, G)


def certify_robot(
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    computation_delay: int = 0,
    samples: int = 2000,
    seed: int = 0,
    channels: Sequence[Channel] | None = None,
    spread: InertiaSpread | None = None,
) -> Certificate[RobotEvidence]:
    """Certify a law on a robot whose posture changes in any way inside a workspace.

    A small error about a motion obeys, in coordinates x = M̂^½ q, ẍ = E v − H x − C ẋ with E = M̂^½ M⁻¹ M̂^½ and

        H = M̂^½ M⁻¹ (∂(M q̈ + N)/∂q) M̂^−½,    C = M̂^½ M⁻¹ (∂N/∂q̇) M̂^−½,

    the stiffness and damping of gravity, springs and the motion itself. The law is certified if every operating point
    satisfies ‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ. Here δ is the radius that the loop tolerates, together with every slope
    of the robust term. The weight η and the lead time θ maximise the margin.

    With a speed in the workspace, the operating points are all motions up to that speed and its acceleration. The
    radius δ is then that for the largest ‖dE⁻¹/dt‖ at this speed, and is much larger. Without a speed E may change at
    any rate, and H and C are those at rest.

    The law is refuted if the robot, held at rest in one of the worst postures, is unstable. That test includes its
    inertia, gravity and viscous friction. Otherwise the verdict is inconclusive, as for gains that differ between the
    joints.

    Parameters
    ----------
    law
        A law with an inertia M̂.
    plant
        The robot, or several, such as one without and one with its payload.
    workspace
        The postures that it takes.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Number of sampled postures, and the seed. Local searches start from the best samples.
    channels
        The loops of `tarc.analysis.linearise.decoupled_channels` for law and delay, where they exist already.
    spread
        Result of `tarc.analysis.inertia_spread` for the same robot, M̂, workspace, samples and seed, where it exists
        already.

    Returns
    -------
    Certificate
        Its evidence has the smallest and the largest inertia ratio, the worst points, and the ball. The margin is the
        ball's radius over the needed one, less 1. For a refutation it is 1 less the spectral radius.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia, and for one with a model N̂ of the robot.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        For numbers of joints that differ, and for an inertia matrix that is singular at a posture.
    """
    law = require_inertia(law, "the robot certificate")
    _refuse_model(law)
    law, plants = in_torque_units(law, as_plants(plant))
    if spread is None:
        spread = inertia_spread(plants, law.M, workspace, samples=samples, seed=seed)
    workspace = workspace.for_joints(plants[0].joint_names)
    n_points = min(samples, MAX_STIFFNESS_SAMPLES)
    sampled = SampledPoints.from_robot(plants, spread, law.M, workspace, n_points, seed)
    is_bounded = bool(np.isfinite(law.robust_slope_bound))
    slope = law.robust_slope_bound if is_bounded else 0.0
    ball, coupled_loop, rate_point, candidate = None, None, None, NO_CANDIDATE
    if joints_share_loop(law):
        channel = (decoupled_channels(law, computation_delay) if channels is None else channels)[0]
        rate_point = _max_rate_point(plants, law.M, workspace, n_points, seed)
        sampled, candidate, ball = _fit_ball(channel, slope, spread, sampled, rate_point)
        rate_point = None if candidate.max_change is None else rate_point
    else:
        channel = coupled_channel(law, computation_delay)
        coupled_loop = LoopMatrices(*channel.closed_loop(0.0)[:3])
    evidence = RobotEvidence(
        nominal_inertia=law.M,
        period=law.period,
        robust_term_is_bounded=is_bounded,
        ball=ball,
        coupled_loop=coupled_loop,
        points=_worst_points(sampled, candidate),
        max_rate_point=rate_point,
        min_ratio=spread.min_ratio,
        max_ratio=spread.max_ratio,
        stiffness=float(sampled.uncertainty.stiffness_norms(candidate.lead_time).max()),
        slope=slope,
        samples=spread.samples,
    )
    verdict, margin, witness = evidence.judge()
    refuted = verdict == Verdict.REFUTED
    limits = "." if workspace.speed is None else ", within the given speeds and accelerations of the joints."
    return Certificate(
        claim=f"{type(law).__name__} keeps the robot stable however it moves in the workspace{limits}",
        problem=_problem(evidence),
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the spectral radius in that posture"
        if refuted
        else "radius over the one needed, less 1",
        assumptions=_assumptions(law, spread, evidence, workspace, computation_delay),
        evidence=evidence,
        witness=witness,
        basis=f"{spread.samples} sampled postures and local search",
    )


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


def _max_rate_point(
    plants: Sequence[Plant], nominal: Array, workspace: Workspace, samples: int, seed: int
) -> MaxRatePoint | None:
    """Return where the inertia changes fastest; None without a speed."""
    if workspace.speed is None:
        return None
    point = max_rate_point(plants, nominal, workspace, samples, seed)
    return MaxRatePoint(
        position=point.position,
        inertia_slopes=point.plant.inertia_slopes(point.position),
        velocity_limits=np.asarray(workspace.speed),
    )


def _linearised_point(point: OperatingPoint) -> LinearisedPoint:
    """Return the robot linearised about a point; at rest with viscous friction, moving without."""
    M, D, G = linearise_point(point) if point.is_moving else point.plant.linearised(point.position)
    return LinearisedPoint(
        position=point.position,
        inertia=M,
        damping=D,
        stiffness=G,
        velocity=point.velocity if point.is_moving else None,
        acceleration=point.acceleration if point.is_moving else None,
    )


def _worst_points(sampled: SampledPoints, candidate: "BallCandidate") -> WorstPoints:
    """Return the first two points, and those of the largest stiffness and joint norm, at rest and moving."""
    points, uncertainty = sampled.points, sampled.uncertainty
    stiffness_norms = uncertainty.stiffness_norms(candidate.lead_time)
    joint_norms = stiffness_norms
    if candidate.position_weight:
        joint_norms = uncertainty.joint_norms(candidate.centre, candidate.position_weight, candidate.lead_time)
    is_moving = np.array([point.is_moving for point in points])

    def worst(is_included: Array, values: Array) -> LinearisedPoint:
        return _linearised_point(points[int(np.argmax(np.where(is_included, values, -1.0)))])

    return WorstPoints(
        min_ratio=_linearised_point(points[0]),
        max_ratio=_linearised_point(points[1]),
        stiffest=worst(~is_moving, stiffness_norms),
        largest_norm=worst(~is_moving, joint_norms),
        stiffest_moving=worst(is_moving, stiffness_norms) if is_moving.any() else None,
        largest_norm_moving=worst(is_moving, joint_norms) if is_moving.any() else None,
    )


def _assumptions(
    law: PolePlacement, spread: InertiaSpread, evidence: RobotEvidence, workspace: Workspace, computation_delay: int
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
        "the robot stays in the workspace; friction is only a disturbance, except viscous friction of the robot at "
        "rest; dry friction may stop a mode that is refuted",
        "no torque limit is reached and no sample is lost",
        f"the torque reaches the joints {computation_delay} periods late and is held for a period; the effect of "
        "stiffness and damping over a period follows from the position and the mean velocity",
        _motion_assumption(evidence, workspace),
    ]
    if isinstance(law, TARC) and law.max_gain is None:
        lines.append("the gain has no maximum, so nothing bounds the robust term; give max_gain to have it certified")
    elif not np.isfinite(law.robust_slope_bound):
        lines.append("left out: the robust term, whose slope over the error has no bound; without it the verdict holds")
    if not joints_share_loop(law):
        lines.append("gains that differ between the joints: only the loop at rest in the worst postures was tested")
    return tuple(lines)


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
            f"; so M̂^−½ M M̂^−½ changes by at most {evidence.rate:.3g} 1/s, the largest that samples and local search "
            "found"
        )
    return (
        f"no joint is faster than ({format_vector(workspace.speed)}) rad/s or m/s, or accelerates by more than "
        f"({format_vector(workspace.acceleration)}) rad/s² or m/s²{changes}; the payload stays the same, or changes so "
        "rarely that the loop settles in between"
    )


class BallCandidate(NamedTuple):
    """A ball that may contain the robot, by the responses on a grid of frequencies.

    Attributes
    ----------
    radius_over_needed
        Tolerated radius over the needed one.
    needed_radius
        Radius that contains all operating points.
    position_weight, lead_time, centre
        η [1/s²], θ [s] and ρ0.
    max_change
        Largest change of E⁻¹ in one period; None for any.
    """

    radius_over_needed: float
    needed_radius: float
    position_weight: float
    lead_time: float
    centre: float
    max_change: float | None


NO_CANDIDATE = BallCandidate(0.0, 0.0, 0.0, 0.0, 1.0, None)
"""Stands for the ball of a law whose joints do not share a loop."""


def _refuse_model(law: PolePlacement) -> None:
    """Raise `UnsupportedLaw` for a law with a model, whose N̂ changes stiffness and damping of the loop."""
    if law.has_model:
        raise UnsupportedLaw(
            f"law: {type(law).__name__} has a model, whose torque N̂ the robot certificate does not cover; certify the "
            "law without one (model=None), or its loop by tarc.certificates.certify_constant_ratio"
        )


def _fit_ball(
    channel: Channel, slope: float, spread: InertiaSpread, sampled: SampledPoints, rate_point: MaxRatePoint | None
) -> tuple[SampledPoints, BallCandidate, Ball]:
    """Return the points with the worst ones added, the best candidate, and its ball."""
    ratios = spread.min_ratio, spread.max_ratio
    max_change = None if rate_point is None else channel.period * rate_point.rate(sampled.nominal)
    centres = {
        best_centre(UncertainLoop.from_channel(channel, slope, intersample=True), ratios, max_change),
        sum(ratios) / 2,
    }
    sampled = worst_case_points(min(centres), sampled)
    best, proof, radius = best_ball(channel, slope, centres, sampled.uncertainty, max_change)
    if best.position_weight:  # once more, for this ball
        sampled = sampled.refine_worst(best.centre, best.position_weight, best.lead_time)
    loop = UncertainLoop.from_channel(channel, slope, intersample=True, lead_periods=best.lead_time / channel.period)
    stiffness = float(sampled.uncertainty.stiffness_norms(best.lead_time).max())
    ball = make_ball(
        loop,
        best.centre,
        radius,
        proof,
        position_weight=best.position_weight,
        stiffness=stiffness,
        max_change=best.max_change,
    )
    return sampled, best, ball


def worst_case_points(centre: float, sampled: SampledPoints) -> SampledPoints:
    """Return the points with those that local searches add; the worst one depends on weight and lead time."""
    uncertainty = sampled.uncertainty
    has_stiffness = float(uncertainty.stiffness_norms(0.0).max()) > NEGLIGIBLE_STIFFNESS
    if has_stiffness or uncertainty.lead_time():
        for factor in LEAD_FACTORS:
            sampled = sampled.add_stiffest(factor * sampled.uncertainty.lead_time())
    lead_time = sampled.uncertainty.lead_time()
    for weight in sampled.uncertainty.candidate_weights(centre, lead_time)[::2]:
        sampled = sampled.refine_worst(centre, weight, lead_time)
    return sampled


def best_ball(
    channel: Channel,
    slope: float,
    centres: Collection[float],
    uncertainty: UncertaintySamples,
    max_change: float | None,
) -> tuple[BallCandidate, RadiusProof, float]:
    """Return the best ball, what proves its radius, and its radius.

    Several are tested, because what holds on a grid of frequencies may fail between them. A ball for any rate may be
    better than that for a bounded rate.
    """
    lead_times = dict.fromkeys(factor * uncertainty.lead_time() for factor in LEAD_FACTORS)
    loops = {
        lead_time: UncertainLoop.from_channel(channel, slope, intersample=True, lead_periods=lead_time / channel.period)
        for lead_time in lead_times
    }
    candidates = [
        candidate
        for centre in centres
        for lead_time, loop in loops.items()
        for change_limit in {max_change, None}
        for candidate in best_weights(loop, centre, uncertainty, lead_time, change_limit)
    ]
    candidates.sort(reverse=True, key=lambda candidate: candidate.radius_over_needed)
    best, proof, radius = candidates[0], None, -1.0
    for candidate in candidates[:MAX_CANDIDATES]:
        if candidate.radius_over_needed > radius / best.needed_radius:
            loop, stiffness = loops[candidate.lead_time], float(uncertainty.stiffness_norms(candidate.lead_time).max())
            candidate_proof, candidate_radius = max_radius(
                loop, candidate.centre, candidate.position_weight, max_change=candidate.max_change, stiffness=stiffness
            )
            if candidate_radius / candidate.needed_radius > radius / best.needed_radius:
                best, proof, radius = candidate, candidate_proof, candidate_radius
    return best, proof, radius


def best_weights(
    loop: UncertainLoop,
    centre: float,
    uncertainty: UncertaintySamples,
    lead_time: float,
    max_change: float | None = None,
) -> list[BallCandidate]:
    """Return the two best weights η, the best first; zero where there is no stiffness.

    With a `max_change` E⁻¹ changes by no more than that in one period.
    """
    responses, stiffness = FrequencyResponses(loop), float(uncertainty.stiffness_norms(lead_time).max())

    def tolerated_radius(weight: float) -> float:
        if max_change is None:
            return responses.best_scale(centre, weight)[1]
        return best_multiplier(
            loop, centre, max_change, position_weight=weight, stiffness=stiffness, responses=responses
        )[1]

    candidates = []
    for weight in uncertainty.candidate_weights(centre, lead_time) or [0.0]:
        if weight:
            needed = uncertainty.needed_radius(centre, weight, lead_time)
        else:
            needed = max(uncertainty.needed_radius(centre, np.inf), 0.1 * centre)
        candidates.append(
            BallCandidate(tolerated_radius(weight) / needed, needed, weight, lead_time, centre, max_change)
        )
    return sorted(candidates, reverse=True, key=lambda candidate: candidate.radius_over_needed)[:2]
