"""The ball of operating points that suits a robot and a loop, and the worst points that it must contain."""

from collections.abc import Collection
from itertools import product
from typing import NamedTuple

import numpy as np

from tarc.analysis.linearise import Channel
from tarc.analysis.operating_points import NEGLIGIBLE_STIFFNESS, SEARCH_MARGIN, UncertaintySamples
from tarc.analysis.point_functions import GrownNorm
from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop
from tarc.analysis.worst_points import SampledPoints
from tarc.certificates.ball import Ball, RadiusProof, make_ball
from tarc.certificates.ball_centre import FEW_FREQUENCIES, best_centre
from tarc.certificates.ball_radius import max_radius
from tarc.certificates.iqc import CLOSE_RANGE, best_multiplier
from tarc.certificates.robot_points import RobotPoints

LEAD_FACTORS = 0.5, 1.0
"""Lead times to try, over that at which damping counts as much as stiffness."""
ROOM = 1 + SEARCH_MARGIN
"""Factor on the largest ratio and rate that were found, and on the inverse of the smallest ratio."""
MIN_LEAD_PERIODS = 4.0
"""Least lead time of a robot with stiffness [periods], since its position moves within a period."""
MAX_SEARCHES = 3
"""Most searches of the whole workspace, each for another ball."""
MAX_CANDIDATES = 4
"""Largest number of balls that are tested at all frequencies."""
SAME_CENTRE = 1e-3
"""Relative difference up to which two centres count as one."""
CLOSE_TO_BEST = 0.97
"""Share of the best radius over the needed one that a ball must be able to reach to be searched further."""
NEAR_MISS = 0.96
"""Proven radius over the needed one from which all weights are tried."""
CLEARLY = 1.01
"""Factor on the least radius over the needed one at which the search for a ball may end."""
FAR_FROM_BEST = 0.8
"""Share below which no other weight is tried."""


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


def fit_ball(channel: Channel, slope: float, robot: RobotPoints, least: float = 0.0) -> tuple[BallCandidate, Ball]:
    """Return the best candidate, and its ball for more rate and stiffness; the robot's points gain the worst ones.

    The whole workspace is searched for the norm that decides, unless the points that there are exclude the ball. The
    search for one may end where its radius over the needed one cannot become the ``least``.
    """
    spread, rate_point = robot.spread, robot.max_rate_point()
    ratios = spread.min_ratio / ROOM, spread.max_ratio * ROOM
    max_change = None if rate_point is None else ROOM * channel.period * rate_point.rate(robot.nominal)
    middle = sum(ratios) / 2
    centre = best_centre(UncertainLoop.from_channel(channel, slope, intersample=True), ratios, max_change)
    centres = [middle] if abs(centre / middle - 1) < SAME_CENTRE else [centre, middle]
    if not robot.is_searched:
        robot.sampled = worst_case_points(min(centres), robot.sampled)
        robot.is_searched = True
    options = max_change, least
    best, proof, radius, tested = best_ball(channel, slope, centres, robot.sampled.uncertainty, *options)
    for _ in range(MAX_SEARCHES):
        if not best.position_weight or radius < best.needed_radius:
            break
        place = best.centre, best.position_weight, best.lead_time
        robot.search_globally(GrownNorm(robot.nominal, *place, SEARCH_MARGIN))
        deciding = robot.sampled.uncertainty.decisive([best.centre], [best.lead_time], SEARCH_MARGIN, channel.period)
        if radius >= deciding.grown(SEARCH_MARGIN, channel.period).needed_radius(*place, channel.period):
            break  # else another ball may suit the points that the search has found
        best, proof, radius, tested = best_ball(channel, slope, centres, robot.sampled.uncertainty, *options)
    loop = UncertainLoop.from_channel(channel, slope, intersample=True, lead_periods=best.lead_time / channel.period)
    stiffness = robot.sampled.uncertainty.max_grown_stiffness(best.lead_time, SEARCH_MARGIN, channel.period)
    if best.max_change is not None and stiffness > tested:  # the proof of the radius counts it
        proof, radius = max_radius(
            loop, best.centre, best.position_weight, max_change=best.max_change, stiffness=stiffness
        )
    ball = make_ball(
        loop,
        best.centre,
        radius,
        proof,
        position_weight=best.position_weight,
        stiffness=stiffness,
        max_change=best.max_change,
    )
    return best, ball


def worst_case_points(centre: float, sampled: SampledPoints) -> SampledPoints:
    """Return the points with those that local searches add; the worst one depends on weight and lead time."""
    uncertainty = sampled.uncertainty
    has_stiffness = float(uncertainty.stiffness_norms(0.0).max()) > NEGLIGIBLE_STIFFNESS
    if has_stiffness or uncertainty.lead_time():
        for factor in LEAD_FACTORS:
            sampled = sampled.add_stiffest(factor * sampled.uncertainty.lead_time())
    lead_time = sampled.uncertainty.lead_time()
    weights = sampled.uncertainty.candidate_weights(centre, lead_time)
    return sampled.refine_worst(centre, weights[len(weights) // 2], lead_time) if weights else sampled


def tried_lead_times(uncertainty: UncertaintySamples, period: float) -> list[float]:
    """Return lead times θ to try [s]; zero for a robot without stiffness and damping."""
    longest = uncertainty.lead_time(friction=True)
    if not longest and not float(uncertainty.stiffness_norms(0.0).max()) > NEGLIGIBLE_STIFFNESS:
        return [0.0]
    return list(dict.fromkeys(max(factor * longest, MIN_LEAD_PERIODS * period) for factor in LEAD_FACTORS))


def best_ball(
    channel: Channel,
    slope: float,
    centres: Collection[float],
    uncertainty: UncertaintySamples,
    max_change: float | None,
    least: float = 0.0,
) -> tuple[BallCandidate, RadiusProof, float, float]:
    """Return the best ball, what proves its radius, its radius, and the stiffness that it counts.

    Several are tested, because what holds on a grid of frequencies may fail between them. A ball for any rate may be
    better than that for a bounded rate.
    """
    period = channel.period
    lead_times = tried_lead_times(uncertainty, period)
    loops = {
        lead_time: UncertainLoop.from_channel(channel, slope, intersample=True, lead_periods=lead_time / period)
        for lead_time in lead_times
    }
    stiffness = {
        lead_time: uncertainty.max_grown_stiffness(lead_time, SEARCH_MARGIN, period) for lead_time in lead_times
    }
    grown = uncertainty.decisive(centres, lead_times, SEARCH_MARGIN, period).grown(SEARCH_MARGIN, period)
    candidates: list[BallCandidate] = []
    for centre, (lead_time, loop), limit in product(centres, loops.items(), dict.fromkeys([max_change, None])):
        if least and candidates and candidates[0].radius_over_needed > CLEARLY * least:
            break
        reached = max((candidate.radius_over_needed for candidate in candidates), default=least)
        candidates += best_weights(loop, centre, grown, lead_time, stiffness[lead_time], limit, reached)
        candidates.sort(reverse=True, key=lambda candidate: candidate.radius_over_needed)
    best, proof, radius = candidates[0], None, -1.0

    def prove(candidate: BallCandidate) -> None:
        nonlocal best, proof, radius
        proven_radius = max_radius(
            loops[candidate.lead_time],
            candidate.centre,
            candidate.position_weight,
            max_change=candidate.max_change,
            stiffness=stiffness[candidate.lead_time],
        )
        if proven_radius[1] / candidate.needed_radius > radius / best.needed_radius:
            best, (proof, radius) = candidate, proven_radius

    for candidate in candidates[:MAX_CANDIDATES]:
        if candidate is best or candidate.radius_over_needed > max(radius / best.needed_radius, least):
            prove(candidate)
            if least and radius >= max(least, 1.0) * best.needed_radius:
                break
    if not least and NEAR_MISS < radius / best.needed_radius < 1:  # the grid's order of the weights is not exact
        for lead_time in lead_times:
            for weight in grown.candidate_weights(best.centre, lead_time):
                needed = grown.needed_radius(best.centre, weight, lead_time, period)
                prove(BallCandidate(0.0, needed, weight, lead_time, best.centre, max_change))
                if radius >= best.needed_radius:
                    return best, proof, radius, stiffness[best.lead_time]
    return best, proof, radius, stiffness[best.lead_time]


def best_weights(
    loop: UncertainLoop,
    centre: float,
    grown: UncertaintySamples,
    lead_time: float,
    stiffness: float,
    max_change: float | None = None,
    reached: float = 0.0,
) -> list[BallCandidate]:
    """Return the two best weights η, the best first; zero where there is no stiffness.

    With a `max_change` E⁻¹ changes by no more than that in one period. The radius over the needed one has one maximum
    over the weight, so the search goes uphill from the middle. The search at a weight ends where it cannot come close
    to the best, or to what other balls `reached`.
    """
    responses = FrequencyResponses(loop, count=FEW_FREQUENCIES)
    period = loop.B[1, 0] ** 0.5
    weights = grown.candidate_weights(centre, lead_time) or [0.0]

    def candidate(weight: float, reached: float) -> BallCandidate:
        needed = grown.needed_radius(centre, weight or np.inf, lead_time, period)
        needed = needed if weight else max(needed, 0.1 * centre)
        if max_change is None:
            radius = responses.best_scale(centre, weight)[1]
        else:
            radius = best_multiplier(
                loop,
                centre,
                max_change,
                position_weight=weight,
                stiffness=stiffness,
                responses=responses,
                least=CLOSE_TO_BEST * reached * needed,
                close=CLOSE_RANGE,
            )[1]
        return BallCandidate(radius / needed, needed, weight, lead_time, centre, max_change)

    top = len(weights) // 2
    tested = {top: candidate(weights[top], reached)}
    if tested[top].radius_over_needed < FAR_FROM_BEST * reached:
        return [tested[top]]
    for step in (1, -1):
        while 0 <= top + step < len(weights):
            if top + step not in tested:
                best = max(tested[top].radius_over_needed, reached)
                tested[top + step] = candidate(weights[top + step], best)
            if tested[top + step].radius_over_needed <= tested[top].radius_over_needed:
                break
            top += step
    return sorted(tested.values(), reverse=True, key=lambda candidate: candidate.radius_over_needed)[:2]
