"""The verdict for a robot: the spread of its inertia over a workspace against what the loop bears."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread, inertia_spread
from tarc.analysis.linearise import Channel, coupled_channel, decoupled_channels, joints_share_loop
from tarc.analysis.operating_points import (
    NEGLIGIBLE_STIFFNESS,
    OperatingPoint,
    UncertaintySamples,
    add_stiffest,
    inertia_rates,
    inertia_slopes,
    linearise_point,
    max_rate_point,
    refine_worst,
    sample_points,
    to_nominal_coordinates,
    uncertainty_samples,
)
from tarc.analysis.rest_stability import rest_state_matrix
from tarc.analysis.stability import UnstableMode, Witness, unstable_mode
from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate, Evidence, Judgement, LoopMatrices, Verdict
from tarc.certificates.iqc import best_multiplier
from tarc.certificates.varying_ratio import Ball, RadiusProof, best_centre, make_ball, max_radius
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.numerics.matrix_tests import schur_stability
from tarc.plants.base import Plant


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
        return None if self.ball is None or self.ball.step is None else self.ball.step / self.period

    def judge(self) -> Judgement:
        """Test the worst points at rest for a mode that grows, then whether the ball contains all points."""
        least, largest = np.inf, 0.0
        worst, witness = 1.0, None
        for point in self.points.at_rest():
            ratios = np.linalg.eigvals(np.linalg.solve(point.inertia, self.nominal_inertia)).real
            least, largest = min(least, ratios.min()), max(largest, ratios.max())
            matrices = point.inertia, point.damping, point.stiffness
            answer, radius, mode = schur_stability(
                rest_state_matrix(self._loop(), self.nominal_inertia, matrices, self.period)
            )
            if answer == "refuted" and radius > worst:
                ratio = ratios.max() if point is self.points.max_ratio else ratios.min()
                worst, witness = radius, unstable_mode(radius, mode, self.period)
                witness = replace(witness, ratio=float(ratio), posture=point.position)
        if witness:
            return Judgement(Verdict.REFUTED, float(1 - worst), witness)
        if self.ball is None:
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        return self._judge_ball(self.ball, float(least), float(largest))

    def _loop(self) -> tuple[Array, Array, Array]:
        """Return A, B, C of the loop opened at its inertia ratio."""
        if self.ball is not None:
            return self.ball.loop.A, self.ball.loop.B, self.ball.loop.C
        if self.coupled_loop is None:
            raise ValueError("evidence: it has neither a ball nor a loop of all joints")
        return self.coupled_loop.A, self.coupled_loop.B, self.coupled_loop.C

    def _judge_ball(self, ball: Ball, least: float, largest: float) -> Judgement:
        """Test whether the ball contains the ratios, the stiffness and the rate of all points."""
        lead = ball.loop.lead_periods.item() * self.period
        mismatch = self._uncertainty_samples()
        stiffest = float(mismatch.stiffness_norms(lead).max())
        undecided = Judgement(Verdict.INCONCLUSIVE, 0.0)
        if not np.isfinite(lead) or (lead <= 0 and float(np.abs(mismatch.damping).max()) > NEGLIGIBLE_STIFFNESS):
            return undecided
        needed = max(largest - ball.centre, ball.centre - least)
        if ball.weight > 0:
            needed = max(needed, float(mismatch.joint_norms(ball.centre, ball.weight, lead).max()))
        elif not stiffest <= NEGLIGIBLE_STIFFNESS:  # the loop without its weight leaves the stiffness out
            return undecided
        if ball.step is not None:
            if self.max_rate_point is None or not stiffest <= (1 + 1e-9) * ball.stiffness:
                return undecided
            slopes, limits = self.max_rate_point.inertia_slopes, self.max_rate_point.velocity_limits
            rate = float(inertia_rates(self.nominal_inertia, slopes[None], limits)[0])
            if rate * self.period / (1 + 1e-9) > ball.step:
                return undecided
        judged = ball.judge(needed)
        return judged if self.robust_term_is_bounded else judged._replace(verdict=Verdict.INCONCLUSIVE)

    def _uncertainty_samples(self) -> UncertaintySamples:
        """Return the mismatches of all points, without the viscous friction of those at rest."""
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
) -> Certificate[RobotEvidence]:
    """Certify a law on a robot: however its posture changes inside a workspace, and however fast, or within a speed.

    A small error about a motion obeys, in coordinates x = M̂^½ q, ẍ = E v − H x − C ẋ with E = M̂^½ M⁻¹ M̂^½ and

        H = M̂^½ M⁻¹ (∂(M q̈ + N)/∂q) M̂^−½,    C = M̂^½ M⁻¹ (∂N/∂q̇) M̂^−½,

    the stiffness and damping that gravity, springs and the motion itself make. Certified if the robust ball, of all
    ‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ with the weight η and the lead θ that leave it the most room, holds those of all
    postures of the workspace, together with every slope of the robust term up to that at its cap. Where the workspace
    has a speed, they are those of all motions up to it and its acceleration, and the ball is that for ‖dE⁻¹/dt‖ up to
    the greatest at this speed, which holds far more. Without a speed E may change at any rate, and of H and C there is
    only what is there at rest. Refuted if in one of the worst postures the robot held at rest, linearised with its
    inertia, gravity and viscous friction, is unstable. Inconclusive between the two, and for gains that differ between
    the joints, which the ball does not cover.

    Parameters
    ----------
    law
        A law on time-delay estimation.
    plant
        The robot, or several, such as one without and one with its payload.
    workspace
        The postures that it takes.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Of the workspace; local searches start from the best samples.

    Returns
    -------
    Certificate
        Its evidence has the smallest and the largest inertia ratio, the worst points, and the ball. The margin is the
        ball's radius over the one that is needed, less 1; where refuted, 1 less the spectral radius.

    Raises
    ------
    TarcError
        For joints that do not match, a singular inertia matrix, a law without an inertia.
    """
    if not isinstance(law, PolePlacement):
        raise TarcError(f"law: got {type(law).__name__}; the robot certificate needs a law with an inertia M̂")
    plants = [plant] if isinstance(plant, Plant) else list(plant)
    found = inertia_spread(plants, law.M, workspace, samples=samples, seed=seed)
    ends = (plants[found.min_plant], found.min_posture), (plants[found.max_plant], found.max_posture)
    units = workspace.unit_samples(min(samples, MAX_STIFFNESS_SAMPLES), seed)
    instants = [OperatingPoint.at_rest(*one) for one in ends]
    instants += sample_points(plants, workspace, min(samples, MAX_STIFFNESS_SAMPLES), seed)
    mismatch = uncertainty_samples(law.M, instants)
    bounded = bool(np.isfinite(law.robust_slope_bound))
    slope = law.robust_slope_bound if bounded else 0.0
    ball, loop, rate_point, weight, centre, lead = None, None, None, 0.0, 1.0, 0.0
    if joints_share_loop(law):
        channel, step = decoupled_channels(law, computation_delay)[0], None
        if workspace.speed is not None:
            fast = max_rate_point(plants, law.M, workspace, min(samples, MAX_STIFFNESS_SAMPLES), seed)
            slopes = inertia_slopes(fast.plant, fast.position)
            rate_point = MaxRatePoint(
                position=fast.position, inertia_slopes=slopes, velocity_limits=np.asarray(workspace.speed)
            )
            step = law.period * float(inertia_rates(law.M, slopes[None], workspace.speed)[0])
        plain = UncertainLoop.from_channel(channel, slope, intersample=True)
        tries = {best_centre(plain, (found.min_ratio, found.max_ratio), step), (found.min_ratio + found.max_ratio) / 2}
        instants, mismatch = worst_case_points(min(tries), instants, mismatch, law.M, workspace, units)
        best, shown, radius = best_ball(channel, slope, tries, mismatch, step)
        step, lead, weight, centre = best.step, best.lead, best.weight, best.centre
        if weight:  # once more, for the very ball
            instants, mismatch = refine_worst(instants, mismatch, workspace, units, law.M, centre, weight, lead)
        parts = UncertainLoop.from_channel(channel, slope, intersample=True, lead_periods=lead / law.period)
        rate_point = None if step is None else rate_point
        stiffness = float(mismatch.stiffness_norms(lead).max())
        ball = make_ball(parts, centre, radius, shown, weight=weight, stiffness=stiffness, step=step)
    else:
        loop = LoopMatrices(*coupled_channel(law, computation_delay).closed_loop(0.0)[:3])
    evidence = RobotEvidence(
        nominal_inertia=law.M,
        period=law.period,
        robust_term_is_bounded=bounded,
        ball=ball,
        coupled_loop=loop,
        points=_worst_points(instants, mismatch, centre, weight, lead),
        max_rate_point=rate_point,
        min_ratio=found.min_ratio,
        max_ratio=found.max_ratio,
        stiffness=float(mismatch.stiffness_norms(lead).max()),
        slope=slope,
        samples=found.samples,
    )
    verdict, margin, witness = evidence.judge()
    return Certificate(
        claim=f"{type(law).__name__} keeps the robot stable however it moves in the workspace"
        + ("." if workspace.speed is None else ", at the joints' speeds and accelerations given or less."),
        problem=(
            "‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ for all motions in the workspace, ‖dE⁻¹/dt‖ within a rate, and a ball of "
            "radius δ that the loop bears at this rate"
            if evidence.rate is not None
            else "‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ < 1/‖[T_v; η T_q; η θ T_q̇]‖∞ for all motions in the workspace"
        )
        + (f", with every slope of the robust term up to {slope:.4g} 1/s²" if slope else ""),
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the spectral radius in that posture"
        if verdict == "refuted"
        else "radius of the ball over the one needed, less 1",
        assumptions=_assumptions(law, found, evidence, workspace, computation_delay),
        evidence=evidence,
        witness=witness,
        basis=f"{found.samples} sampled postures and local search",
    )


def _linearised_point(instant: OperatingPoint) -> LinearisedPoint:
    """Return the robot linearised about an instant; at rest with viscous friction, moving without."""
    M, D, G = linearise_point(instant) if instant.is_moving else instant.plant.linearised(instant.position)
    return LinearisedPoint(
        position=instant.position,
        inertia=M,
        damping=D,
        stiffness=G,
        velocity=instant.velocity if instant.is_moving else None,
        acceleration=instant.acceleration if instant.is_moving else None,
    )


def _worst_points(
    instants: list[OperatingPoint], mismatch: UncertaintySamples, centre: float, weight: float, lead: float
) -> WorstPoints:
    """Return the first two instants, and those of the largest stiffness and joint norm, at rest and moving."""
    sizes = mismatch.stiffness_norms(lead)
    norms = mismatch.joint_norms(centre, weight, lead) if weight else sizes
    moving = np.array([instant.is_moving for instant in instants])

    def worst(which: Array, values: Array) -> LinearisedPoint:
        return _linearised_point(instants[int(np.argmax(np.where(which, values, -1.0)))])

    return WorstPoints(
        min_ratio=_linearised_point(instants[0]),
        max_ratio=_linearised_point(instants[1]),
        stiffest=worst(~moving, sizes),
        largest_norm=worst(~moving, norms),
        stiffest_moving=worst(moving, sizes) if moving.any() else None,
        largest_norm_moving=worst(moving, norms) if moving.any() else None,
    )


def _assumptions(
    law: PolePlacement, found: InertiaSpread, evidence: RobotEvidence, workspace: Workspace, computation_delay: int
) -> tuple[str, ...]:
    def listed(values: Array) -> str:
        return "(" + ", ".join(f"{one:.3g}" for one in values) + ")"

    speed, acceleration = workspace.speed, workspace.acceleration
    lines = [
        f"the eigenvalues of M(q)⁻¹M̂ lie between {found.min_ratio:.4g}, found at q = {listed(found.min_posture)}, and "
        f"{found.max_ratio:.4g}, at {listed(found.max_posture)}; {found.samples} samples and local search found "
        f"no others",
        f"gravity and springs{'' if speed is None else ', and the motion itself,'} have a stiffness, in these "
        f"coordinates, of at most {evidence.stiffness:.3g} 1/s², which with the inertia is taken from "
        f"{min(found.samples, MAX_STIFFNESS_SAMPLES)} samples, the two postures above and local search",
        "the robot stays in the workspace; friction disturbs only, viscous friction apart where the robot is at rest; "
        "dry friction may hold back what is refuted",
        "no torque limit is reached and no sample is lost",
        f"the torque reaches the joints {computation_delay} periods late and is held for a period; over a period what "
        "stiffness and damping do is taken from the position and the mean velocity",
    ]
    if speed is None or acceleration is None:
        lines.append(
            "Coriolis forces disturb only: what stiffness and damping fast motion makes is left out, which a bound on "
            "the joints' speeds would count"
        )
    else:
        rate = evidence.rate
        changes = (
            ""
            if rate is None
            else (
                f"; so M̂^−½ M M̂^−½ changes by at most {rate:.3g} 1/s, the greatest that samples and local search found"
            )
        )
        lines.append(
            f"no joint is faster than {listed(speed)} rad/s or m/s, or accelerates by more than {listed(acceleration)} "
            f"rad/s² or m/s²{changes}; the payload stays the same, or changes so seldom that the loop has settled in "
            "between"
        )
    if isinstance(law, TARC) and law.max_gain is None:
        lines.append("the gain has no cap, so that nothing bounds the robust term; give one to have it certified")
    elif not np.isfinite(law.robust_slope_bound):
        lines.append("left out: the robust term, which is no bounded slope over the error; without it the rest holds")
    if not joints_share_loop(law):
        lines.append("gains that differ between the joints: only the loop at rest in the worst postures was tested")
    return tuple(lines)


LEAD_FACTORS = 0.5, 1.0
"""Leads that are tried, over that for which damping counts as much as stiffness."""
MAX_CANDIDATES = 4
"""Most balls that are tried on all frequencies."""
MAX_STIFFNESS_SAMPLES = 500
"""Postures whose stiffness is computed; it changes little beside the inertia's eigenvalues."""


class BallCandidate(NamedTuple):
    """A ball: its room, radius over the one needed, as a grid of frequencies has it; and what makes it."""

    radius_over_needed: float
    needed_radius: float
    weight: float
    lead: float
    centre: float
    step: float | None


def worst_case_points(
    centre: float,
    instants: list[OperatingPoint],
    found: UncertaintySamples,
    nominal: Array,
    workspace: Workspace,
    units: Array,
) -> tuple[list[OperatingPoint], UncertaintySamples]:
    """Instants with their `mismatches`, and those that local searches add; the worst one moves with the weight."""
    for factor in (
        LEAD_FACTORS if float(found.stiffness_norms(0.0).max()) > NEGLIGIBLE_STIFFNESS or found.lead_time() else ()
    ):
        lead = factor * found.lead_time()
        instants, found = add_stiffest(instants, found, workspace, units, nominal, lead)
    lead = found.lead_time()
    for weight in found.candidate_weights(centre, lead)[::2]:
        instants, found = refine_worst(instants, found, workspace, units, nominal, centre, weight, lead)
    return instants, found


def best_ball(
    channel: Channel, slope: float, tries: Collection[float], found: UncertaintySamples, step: float | None
) -> tuple[BallCandidate, RadiusProof, float]:
    """The ball with the most room, what shows it, and its radius.

    Several are looked at: what holds on a grid of frequencies need not hold on all, and a ball for any speed may do
    better than one for a bounded speed.
    """
    leads = dict.fromkeys(factor * found.lead_time() for factor in LEAD_FACTORS)
    kinds = {
        lead: UncertainLoop.from_channel(channel, slope, intersample=True, lead_periods=lead / channel.period)
        for lead in leads
    }
    trials = [
        one
        for centre in tries
        for lead, parts in kinds.items()
        for kind in {step, None}
        for one in best_weights(parts, centre, found, lead, kind)
    ]
    trials.sort(reverse=True, key=lambda one: one.radius_over_needed)
    best, evidence, radius = trials[0], None, -1.0
    for one in trials[:MAX_CANDIDATES]:
        if one.radius_over_needed > radius / best.needed_radius:
            stiffness = float(found.stiffness_norms(one.lead).max())
            shown, reach = max_radius(kinds[one.lead], one.centre, one.weight, step=one.step, stiffness=stiffness)
            if reach / one.needed_radius > radius / best.needed_radius:
                best, evidence, radius = one, shown, reach
    return best, evidence, radius


def best_weights(
    parts: UncertainLoop, centre: float, found: UncertaintySamples, lead: float, step: float | None = None
) -> list[BallCandidate]:
    """The weights η of the position beside v with the most room, the best first; zero where there is no stiffness.

    With a step E⁻¹ changes by no more than that in a period.
    """
    responses, stiffness = FrequencyResponses(parts), float(found.stiffness_norms(lead).max())

    def radius(weight: float) -> float:
        if step is None:
            return responses.best_scale(centre, weight)[1]
        return best_multiplier(parts, centre, step, weight=weight, stiffness=stiffness, responses=responses)[1]

    trials = []
    for weight in found.candidate_weights(centre, lead) or [0.0]:
        needed = (
            found.needed_radius(centre, weight, lead)
            if weight
            else max(found.needed_radius(centre, np.inf), 0.1 * centre)
        )
        trials.append(BallCandidate(radius(weight) / needed, needed, weight, lead, centre, step))
    return sorted(trials, reverse=True, key=lambda one: one.radius_over_needed)[:2]
