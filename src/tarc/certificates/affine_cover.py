"""The Lyapunov function affine in the inertia that covers a robot, with stiffness and damping as torques."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread
from tarc.analysis.linearise import Channel
from tarc.analysis.operating_points import NEGLIGIBLE_STIFFNESS, SEARCH_MARGIN, UncertaintySamples
from tarc.analysis.point_functions import ForceNorm
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.analysis.worst_points import SampledPoints
from tarc.certificates.affine import ORDERS, AffineProof, find_proof
from tarc.certificates.affine_form import RatioSet
from tarc.certificates.force_form import ForceForm, ForcePoints, FormValue
from tarc.certificates.robot_evidence import AffineCover, MaxRatePoint, linearised_point
from tarc.core.types import Array

POWERS = 0.0, 0.5, 1.0
"""Powers p of the bounds ‖E^−p [H, C/θ]‖."""
LEAD_FACTORS = 0.25, 0.5, 1.0, 2.0
"""Lead times θ over that at which damping counts as much as stiffness."""
SEARCHED_FACTORS = 0.5, 1.0
"""Those for which local searches look for the worst point."""
ROUNDING_ROOM = 1.001
"""Factor on the margin, so that rounding leaves enough of it."""
N_FORM_POINTS = 3
"""Number of points with the largest values of a form that are stored."""
MAX_FORM_ROUNDS = 3
"""Largest number of forms of the forces that are found, each with the worst points of the one before."""
ACCELERATION_SHARE = 0.01
"""Share of the bound on the forces that is left to the motion within a period."""


def robot_ratios(
    spread: InertiaSpread,
    sampled: SampledPoints,
    rate_points: tuple[MaxRatePoint, ...],
    period: float,
    known: UncertaintySamples | None = None,
) -> tuple[RatioSet, Array, SampledPoints]:
    """Return what a Lyapunov function must tolerate to cover a robot with the margin `SEARCH_MARGIN`.

    Parameters
    ----------
    spread, sampled, rate_points, known
        As in `cover_robot`.
    period
        T [s].

    Returns
    -------
    RatioSet
        The mismatches, stiffnesses and dampings.
    Array
        ‖E^−p [H, C/θ]‖ of each of its bounds at each point, shape (k, m).
    SampledPoints
        The m operating points, with those that local and global searches found; points of ``known`` come after them.
    """
    for factor in SEARCHED_FACTORS:
        sampled = sampled.add_largest_force(factor * sampled.uncertainty.force_lead_time())
        sampled = sampled.add_stiffest(factor * sampled.uncertainty.lead_time())
    longest = sampled.uncertainty.force_lead_time()
    sampled = sampled.search_globally(ForceNorm(sampled.nominal, longest))
    points = sampled.uncertainty if known is None else sampled.uncertainty | known
    uncertainty = points.with_friction()
    room = 1 + ROUNDING_ROOM * SEARCH_MARGIN
    bounds = [
        (power, factor * lead_time)
        for power in POWERS
        for lead_time in [uncertainty.force_lead_time(power)]
        for factor in (LEAD_FACTORS if lead_time else (0.0,))
    ]
    norms = np.array([uncertainty.force_norms(lead_time, power) for power, lead_time in bounds])
    norms = norms.reshape(len(bounds), -1, len(points.inertia)).max(axis=1)
    if not norms.max() > NEGLIGIBLE_STIFFNESS:
        bounds, norms = [], norms[:0]
    values = np.linalg.eigvalsh(uncertainty.inertia)
    ratios = RatioSet(
        min_ratio=min(spread.min_ratio, float(values.min())) / room,
        max_ratio=max(spread.max_ratio, float(values.max())) * room,
        rate=max(point.rate(sampled.nominal) for point in rate_points) * room,
        relative_rate=max(point.relative_rate() for point in rate_points) * room,
        period=period,
        intersample=True,
        powers=np.array([power for power, _ in bounds]),
        lead_times=np.array([lead_time for _, lead_time in bounds]),
        stiffness=np.array([row.max() * room for row in norms]),
        shares=np.full(len(bounds), ACCELERATION_SHARE),
    )
    return ratios, norms, sampled


def cover_robot(
    channel: Channel,
    slope: float,
    spread: InertiaSpread,
    sampled: SampledPoints,
    rate_points: tuple[MaxRatePoint, ...],
    known: UncertaintySamples,
    on_program: Callable[[], object] = lambda: None,
    *,
    start: AffineProof | None = None,
    orders: Sequence[int] = ORDERS,
) -> AffineCover | None:
    """Return a Lyapunov function that covers a robot with the margin `SEARCH_MARGIN`; None where none was found.

    Norms bound stiffness and damping first, then a `ForceForm`, which knows their power as well.

    Parameters
    ----------
    channel
        The loop of each joint.
    slope
        Largest slope of the robust term [1/s²].
    spread
        Inertia ratios of the robot.
    sampled
        Its operating points.
    rate_points
        Where its inertia changes fastest, in units of M̂ and relative to itself.
    known
        Uncertainty at further points that must be covered.
    on_program
        Called after each semidefinite program, to show progress.
    start
        A Lyapunov function with a form, for the same loop and fewer points, which is tried before others.
    orders
        As in `tarc.certificates.affine.find_proof`.
    """
    ratios, norms, sampled = robot_ratios(spread, sampled, rate_points, channel.period, known)
    loop = UncertainLoop.from_channel(channel, slope, intersample=True)
    proof = find_proof(loop, ratios, on_program, orders=orders) if start is None else None
    if proof is not None:
        worst = list(dict.fromkeys(int(np.argmax(row[: len(sampled.points)])) for row in norms))
    else:
        found = _prove_form(loop, ratios, sampled, known, on_program, start, orders) if len(norms) else None
        if found is None:
            return None
        proof, form, sampled = found
        worst = np.argsort(_form_values(form, sampled.uncertainty))[::-1][:N_FORM_POINTS].tolist()
    points = tuple(linearised_point(sampled.points[i]) for i in worst)
    return AffineCover(proof=proof, force_points=points, rate_points=rate_points)


def _prove_form(
    loop: UncertainLoop,
    ratios: RatioSet,
    sampled: SampledPoints,
    known: UncertaintySamples,
    on_program: Callable[[], object],
    start: AffineProof | None,
    orders: Sequence[int],
) -> tuple[AffineProof, ForceForm, SampledPoints] | None:
    """Return a Lyapunov function with a form that no search breaks, that form less the margin, and the points."""
    ratios, share = ratios.without_norms(), ROUNDING_ROOM * SEARCH_MARGIN
    proof = None if start is None else start.extended(loop, replace(ratios, form=start.ratios.form))
    for _ in range(MAX_FORM_ROUNDS):
        if proof is None:
            points = force_points(sampled.uncertainty | known)
            proof = find_proof(loop, ratios, on_program, forces=points, orders=orders)
        if proof is None or proof.ratios.form is None:
            return None
        form = proof.ratios.form.grown(share)
        sampled = sampled.search_globally(FormValue(sampled.nominal, form))
        largest = float(_form_values(form, sampled.uncertainty | known).max())
        if largest > 1:
            looser = proof.ratios.form.loosened(largest * ROUNDING_ROOM)
            proof, form = proof.extended(loop, replace(ratios, form=looser)), looser.grown(share)
        if proof is not None:
            return proof, form, sampled
    return None


def force_points(samples: UncertaintySamples) -> ForcePoints:
    """Return the points that a form must cover with the margin `SEARCH_MARGIN`, without and with viscous friction."""
    return ForcePoints(samples.with_friction(), ROUNDING_ROOM * SEARCH_MARGIN)


def _form_values(form: ForceForm, samples: UncertaintySamples) -> Array:
    """Return the larger value of each point without and with viscous friction, shape (k,)."""
    return form.values(samples.with_friction()).reshape(-1, len(samples.inertia)).max(axis=0)


def with_fewest_bounds(cover: AffineCover) -> AffineCover:
    """Return a cover whose proof needs fewer bounds on the forces, those of the largest multipliers."""
    ratios, multipliers = cover.proof.ratios, cover.proof.multipliers
    order = np.argsort(multipliers.forces)[::-1]
    for count in range(1, len(order)):
        kept = np.sort(order[:count])
        bounds = {name: getattr(ratios, name)[kept] for name in ("powers", "lead_times", "stiffness", "shares")}
        proof: AffineProof = replace(
            cover.proof,
            ratios=replace(ratios, **bounds),
            multipliers=multipliers._replace(forces=multipliers.forces[kept]),
        )
        if proof.is_proven():
            return replace(cover, proof=proof)
    return cover
