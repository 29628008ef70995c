"""The certificate of a law with M̂(q) on a robot: small gain with a norm that follows the posture."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tarc.analysis.inertia_ratio import as_plants
from tarc.analysis.known_inertia import KnownInertia, lagged_force_norms, to_posture_coordinates, worst_points
from tarc.analysis.linearise import Channel, decoupled_channels, joints_share_loop, require_inertia
from tarc.analysis.operating_points import (
    NEGLIGIBLE_STIFFNESS,
    SEARCH_MARGIN,
    OperatingPoint,
    UncertaintySamples,
)
from tarc.analysis.rest_stability import loop_with_model
from tarc.analysis.uncertain_loop import FrequencyResponses, System, UncertainLoop, scaled_system
from tarc.analysis.workspace import Workspace
from tarc.analysis.worst_points import max_rate_point, sample_points
from tarc.certificates.affine import AffineProof, find_proof
from tarc.certificates.affine_form import RatioSet
from tarc.certificates.ball_search import tried_lead_times
from tarc.certificates.base import Certificate, LoopMatrices, Verdict
from tarc.certificates.known_inertia_evidence import (
    KnownInertiaEvidence,
    KnownPoint,
    KnownRatePoint,
    RestLoop,
    decayed_system,
    widened_radius,
)
from tarc.certificates.robot_evidence import LinearisedPoint, MaxRatePoint
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.numerics.norms import hinf_norm
from tarc.plants.base import Plant

POWERS = 0.0, 0.5, 1.0
"""Powers p of the bounds ‖E^−p [H, C/θ]‖ of the Lyapunov function."""

FORCE_LEAD_FACTORS = 0.25, 0.5, 1.0, 2.0
"""Lead times θ of these bounds, over that at which damping counts as much as stiffness."""

LAG_SHARE = 0.5
"""Weight of what q changes since the sample of the torque, over that of θ q̇."""

ACCELERATION_SHARE = 0.01
"""Share of these bounds that is left to the motion within a period."""

SCALES = 12
"""Number of scales of the robust term's block that are tried."""


class _Ball(NamedTuple):
    """Radius over the needed one, radius, centre ρ0, weight η, scale and loop."""

    quality: float
    radius: float
    centre: float
    position_weight: float
    scale: float | None
    loop: UncertainLoop


class WorstKnownPoints(NamedTuple):
    """Where a robot is worst for M̂(q) of a model, whatever its fraction ρ.

    H, C and the rate of M̂ do not depend on ρ, and E is proportional to it.

    Attributes
    ----------
    fraction
        ρ of the law for which they were found.
    points
        Operating points.
    rate_point
        Where M̂(q) changes fastest.
    relative_rate_point
        Where M changes fastest relative to itself.
    """

    fraction: float
    points: list[OperatingPoint]
    rate_point: KnownRatePoint
    relative_rate_point: MaxRatePoint

    @classmethod
    def search(
        cls, inertia: NominalInertia, plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int
    ) -> "WorstKnownPoints":
        """Search a workspace with speeds, from samples."""
        known = KnownInertia(inertia)
        return cls(
            inertia.fraction,
            _operating_points(known, plants, workspace, samples, seed),
            _rate_point(known, plants, workspace, samples, seed),
            _relative_rate_point(plants, workspace, samples, seed),
        )

    def with_fraction(self, fraction: float) -> "WorstKnownPoints":
        """Return the same for another fraction."""
        factor, rate = fraction / self.fraction, self.rate_point
        scaled = replace(rate, nominal=factor * rate.nominal, inertia_slopes=factor * rate.inertia_slopes)
        return self._replace(fraction=fraction, rate_point=scaled)


def certify_known_inertia(
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    computation_delay: int = 0,
    samples: int = 1000,
    seed: int = 0,
    quick: bool = False,
    worst: WorstKnownPoints | None = None,
    on_program: Callable[[], object] = lambda: None,
) -> Certificate[KnownInertiaEvidence]:
    """Certify a law with M̂(q) on a robot that moves within a workspace.

    A small error about a motion obeys q̈ = E v − H q − C q̇ with E = M⁻¹M̂(q), see
    `tarc.analysis.known_inertia.KnownInertia`. In coordinates M̂(q)^½ q, E is symmetric with the eigenvalues of M⁻¹M̂,
    and the loop is that of one joint for each of them. With V = xᵀ (P ⊗ M̂(q)) x the law is certified if all operating
    points satisfy

        ‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ,     ‖T(e^{−rT/2} z)‖∞ < 1/δ,     r = sup ‖M̂^−½ (dM̂/dt) M̂^−½‖

    with 5 % more of E, E⁻¹, H, C and r than was found. T is the loop at ρ0 from an acceleration to (v, η q, η θ q̇), r
    the rate of M̂. Otherwise a Lyapunov function V = xᵀ (P0 ⊗ M̂ + P1 ⊗ M) x is tried, as in `certify_affine`. Its
    P(λ) = P0 + P1/λ gains s0 S0 and s1 S1/λ in a period, S0 ± P0 ⪰ 0, S1 ± P1 ⪰ 0, s0 and s1 the relative changes of M̂
    and M. With a computation delay M̂ is that of the torque's sample, and the law's own stiffness acts at the position
    of then. The law is refuted if the loop at rest in one of the worst postures is unstable.

    Parameters
    ----------
    law
        A law on time-delay estimation with a `tarc.NominalInertia`.
    plant
        The true robot, or several for what is unknown of it, such as both ends of payload and rotor inertia.
    workspace
        The postures, with speeds.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Number of sampled postures, and the seed. Local searches start from the worst samples.
    quick
        Leave out that Lyapunov function, which takes seconds to a minute.
    worst
        Where the robot is worst for this model, from an earlier search with the same workspace and samples; None to
        search.
    on_program
        Called after each semidefinite program, to show progress.

    Returns
    -------
    Certificate
        Its margin is the radius over the needed one, less 1, for a ball; for a refutation 1 less the spectral radius.

    Raises
    ------
    UnsupportedLaw
        For a law with a constant M̂, gains that differ between the joints, and a workspace without speeds.
    InvalidParameter
        For numbers of joints that differ.
    NotLinearisable
        For a law that has no linearisation at rest.
    """
    law = require_inertia(law, "certify_known_inertia")
    inertia = _known(law)
    plants = as_plants(plant)
    workspace = workspace.for_joints(plants[0].joint_names)
    check_known_robot(law, plants, workspace)
    known = KnownInertia(inertia)
    channel = decoupled_channels(law, computation_delay)[0]
    if worst is None:
        worst = WorstKnownPoints.search(inertia, plants, workspace, samples, seed)
    rate_point = worst.with_fraction(inertia.fraction).rate_point
    is_bounded = bool(np.isfinite(law.robust_slope_bound))
    slope = law.robust_slope_bound if is_bounded else 0.0
    points = worst.points
    growth = (1 + SEARCH_MARGIN) * rate_point.rate() * law.period
    uncertainty = known.uncertainty(points)
    ball = _best_ball(channel, slope, uncertainty, growth, computation_delay)
    if ball.position_weight:
        units = workspace.unit_samples(samples, seed)
        points = _worst_for_ball((ball, law.period), known, points, workspace, units) + points
        uncertainty = known.uncertainty(points)
    ratios = np.linalg.eigvalsh(uncertainty.inertia)
    evidence = KnownInertiaEvidence(
        period=law.period,
        computation_delay=computation_delay,
        loop=ball.loop,
        centre=ball.centre,
        radius=ball.radius,
        position_weight=ball.position_weight,
        scale=ball.scale,
        points=tuple(_stored_points(known, points, uncertainty, ball, (law.period, computation_delay))),
        rate_point=rate_point,
        rest_loop=_unstable_rest(law, known, points, ratios, computation_delay),
        affine=None,
        relative_rate_point=worst.relative_rate_point,
        robust_term_is_bounded=is_bounded,
        min_ratio=float(ratios.min()),
        max_ratio=float(ratios.max()),
        samples=samples,
    )
    if not quick and is_bounded and evidence.judge().verdict == Verdict.INCONCLUSIVE:
        parts = known.inertias(points), *known.linearised_apart(points)
        proof = _affine_proof(channel, slope, evidence, parts, on_program)
        evidence = replace(evidence, affine=proof) if proof is not None else evidence
    if evidence.affine is None and evidence.judge().verdict == Verdict.CERTIFIED:
        evidence = evidence.with_decay()
    return _certificate(law, evidence, workspace)


def _relative_rate_point(plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int) -> MaxRatePoint:
    """Return where the robot's M changes fastest relative to itself."""
    return MaxRatePoint.from_point(max_rate_point(plants, None, workspace, samples, seed), workspace)


def _force_bounds(uncertainty: UncertaintySamples, period: float, delay: int) -> list[tuple[float, float, float]]:
    """Return powers p, lead times θ [s] and lag weights φ of the bounds ‖E^−p [H, C/θ, K/φ]‖."""
    found = []
    for power in POWERS:
        longest = uncertainty.force_lead_time(power)
        for lead_time in [factor * longest for factor in FORCE_LEAD_FACTORS] if longest else [0.0]:
            found.append((power, lead_time, LAG_SHARE * (lead_time or period) / ((1 + delay) * period)))
    return found


def known_ratios(evidence: KnownInertiaEvidence, parts: tuple[Array, Array, Array, Array, Array]) -> RatioSet:
    """Return what a Lyapunov function must tolerate to cover the robot with the margin `SEARCH_MARGIN`.

    Parameters
    ----------
    evidence
        Ratios, rates and delay of the robot.
    parts
        M̂, M, D, G and the law's own stiffness of the points, each (k, n, n).
    """
    nominal, M, D, G, own = parts
    uncertainty = to_posture_coordinates(nominal, M, D, G - own)
    room, periods = 1 + 1.1 * SEARCH_MARGIN, 1 + evidence.computation_delay
    growth = float(np.exp(evidence.rate * evidence.period * periods))
    min_ratio, max_ratio = evidence.min_ratio / growth / room, evidence.max_ratio * growth * room
    relative_rate = evidence.relative_rate_point.relative_rate() * room
    bounds = _force_bounds(uncertainty, evidence.period, evidence.computation_delay)
    norms = np.array(
        [
            growth * lagged_force_norms((nominal, M, D, G - own, own), lead_time, power, lag).max() * room
            for power, lead_time, lag in bounds
        ]
    )
    if not norms.max() > NEGLIGIBLE_STIFFNESS:
        bounds, norms = [], norms[:0]
    return RatioSet(
        min_ratio=min_ratio,
        max_ratio=max_ratio,
        rate=relative_rate / min_ratio,
        relative_rate=relative_rate,
        period=evidence.period,
        intersample=True,
        powers=np.array([power for power, _, _ in bounds]),
        lead_times=np.array([lead_time for _, lead_time, _ in bounds]),
        stiffness=norms,
        shares=np.full(len(bounds), ACCELERATION_SHARE),
        nominal_rate=evidence.rate * room,
        lag_weights=np.array([lag for _, _, lag in bounds]),
    )


def _affine_proof(
    channel: Channel,
    slope: float,
    evidence: KnownInertiaEvidence,
    parts: tuple[Array, Array, Array, Array, Array],
    on_program: Callable[[], object],
) -> AffineProof | None:
    """Return a Lyapunov function that covers the robot with the margin `SEARCH_MARGIN`; None where none was found.

    The parts are M̂, M, D, G and the law's own stiffness of the points, each (k, n, n). The law's stiffness acts at the
    position of the torque's sample, up to d + 1 periods ago, and M̂ is that of this sample.
    """
    ratios = known_ratios(evidence, parts)
    loop = UncertainLoop.from_channel(channel, slope, intersample=True)
    return find_proof(loop, ratios, on_program, computation_delay=evidence.computation_delay)


def _known(law: PolePlacement) -> NominalInertia:
    """Return M̂(q), or refuse a constant M̂."""
    if not isinstance(law.inertia, NominalInertia):
        raise UnsupportedLaw(
            f"law: {type(law).__name__} has a constant M̂; use tarc.certificates.certify_robot, or give it a "
            "tarc.NominalInertia"
        )
    return law.inertia


def check_known_robot(law: PolePlacement, plants: Sequence[Plant], workspace: Workspace) -> None:
    """Refuse what `certify_known_inertia` does not cover, before anything is searched.

    Raises
    ------
    UnsupportedLaw
        For gains that differ between the joints, and a workspace without speeds.
    InvalidParameter
        For numbers of joints that differ.
    """
    if not joints_share_loop(law):
        raise UnsupportedLaw(
            "law: its gains differ between the joints, which certify_known_inertia does not cover; give one natural "
            "frequency and damping ratio for all"
        )
    for plant in plants:
        plant.require_fully_driven("certify_known_inertia")
        if plant.n_joints != law.n_joints:
            raise InvalidParameter(f"plant: it has {plant.n_joints} joints, the law {law.n_joints}")
    if workspace.speed is None or not np.all(np.isfinite(workspace.speed)):
        raise UnsupportedLaw(
            "law: it has M̂(q) and the workspace has no speeds, so nothing bounds how fast M̂(q) changes; give the "
            "largest speed of the joints, by --speed or with_speed_limits"
        )


def _rate_point(
    known: KnownInertia, plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int
) -> KnownRatePoint:
    """Return where M̂(q) changes fastest."""
    speed = np.asarray(workspace.speed)
    resting = [OperatingPoint.at_rest(plants[0], posture) for posture in workspace.sample(samples, seed)]

    def rates(points: Sequence[OperatingPoint]) -> Array:
        return known.rates(points, speed)

    found = worst_points(resting, rates, workspace, workspace.unit_samples(samples, seed))
    worst = found[int(np.argmax(rates(found)))]
    slopes = known.inertia.fraction * known.inertia.robot.inertia_slopes(worst.position)
    return KnownRatePoint(nominal=known.inertias([worst])[0], inertia_slopes=slopes, velocity_limits=speed)


def _operating_points(
    known: KnownInertia, plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int
) -> list[OperatingPoint]:
    """Return sampled points, with those of the smallest and largest ratio and of the largest stiffness before them."""
    points = sample_points(plants, workspace, samples, seed)
    resting = [point for point in points if not point.is_moving]
    units = workspace.unit_samples(samples, seed)
    sampled = known.uncertainty(points)
    is_resting = np.array([not point.is_moving for point in points])
    ratios = np.linalg.eigvalsh(sampled.inertia[is_resting])
    smallest = worst_points(resting, lambda some: -_ratios(known, some)[:, 0], workspace, units, -ratios[:, 0])
    largest = worst_points(resting, lambda some: _ratios(known, some)[:, -1], workspace, units, ratios[:, -1])
    lead_time = sampled.lead_time()
    stiffest = worst_points(
        points,
        lambda some: known.uncertainty(some).stiffness_norms(lead_time),
        workspace,
        units,
        sampled.stiffness_norms(lead_time),
    )
    force_lead_time = sampled.force_lead_time()
    forced = worst_points(
        points,
        lambda some: known.uncertainty(some).force_norms(force_lead_time),
        workspace,
        units,
        sampled.force_norms(force_lead_time),
    )
    return [*smallest, *largest, *stiffest, *forced, *points]


def _worst_for_ball(
    ball_and_period: tuple[_Ball, float],
    known: KnownInertia,
    points: list[OperatingPoint],
    workspace: Workspace,
    units: Array,
) -> list[OperatingPoint]:
    """Return the points of the largest joint norm for a ball."""
    ball, period = ball_and_period
    lead_time = ball.loop.lead_periods.item() * period

    def norms(some: Sequence[OperatingPoint]) -> Array:
        return known.uncertainty(some).joint_norms(ball.centre, ball.position_weight, lead_time)

    return worst_points(points, norms, workspace, units)


def _ratios(known: KnownInertia, points: Sequence[OperatingPoint]) -> Array:
    """Return the eigenvalues of M⁻¹M̂ at k points, ascending, shape (k, n)."""
    return np.linalg.eigvalsh(known.uncertainty(points).inertia)


def _best_ball(
    channel: Channel, slope: float, uncertainty: UncertaintySamples, growth: float, computation_delay: int
) -> _Ball:
    """Return the ball of the largest radius over the needed one, with its proof."""
    ratios = np.linalg.eigvalsh(uncertainty.inertia)
    centre = float(ratios.min() + ratios.max()) / 2
    balls = []
    for lead_time in tried_lead_times(uncertainty, channel.period):
        lead_periods = lead_time / channel.period
        loop = UncertainLoop.from_channel(channel, slope, intersample=True, lead_periods=lead_periods)
        angles = FrequencyResponses(loop, centre).angles
        for weight in uncertainty.candidate_weights(centre, lead_time) or [0.0]:
            system = decayed_system(loop, centre, weight, growth)
            radius, scale = _grid_radius(system, angles, bool(slope))
            needed = widened_radius(uncertainty, (centre, weight, lead_time), growth, computation_delay, channel.period)
            balls.append(_Ball(radius / needed, radius, centre, weight, scale, loop))
    best = max(balls, key=lambda ball: ball.quality)
    system = decayed_system(best.loop, best.centre, best.position_weight, growth)
    radius = 0.999 * best.radius
    while radius > 0.5 * best.radius and hinf_norm(*scaled_system(system, radius, best.scale)) >= 1:
        radius *= 0.98
    return best._replace(radius=radius)


def _grid_radius(system: System, angles: Array, has_slope: bool) -> tuple[float, float | None]:
    """Return the radius that the loop tolerates on a grid of frequencies, and the scale of the robust term's block."""
    A, B, C, D = system
    if np.max(np.abs(np.linalg.eigvals(A))) >= 1:
        return 0.0, 1.0 if has_slope else None
    z = np.exp(1j * angles)[:, None, None]
    G = C @ np.linalg.solve(z * np.eye(len(A)) - A, B + 0 * z) + D
    if not has_slope:
        return float(1 / np.linalg.norm(G, 2, axis=(1, 2)).max()), None
    slope_gain = float(np.abs(G[:, -1, -1]).max())
    if slope_gain >= 1:
        return 0.0, 1.0
    natural = float(np.sqrt(np.abs(G[:, -1, :-1]).max() / max(np.abs(G[:, :-1, -1]).max(), 1e-300)))
    candidates = []
    for scale in natural * np.geomspace(1e-2, 1e2, SCALES):
        low, high = 0.0, float(1 / np.linalg.norm(G[:, :-1, :-1], 2, axis=(1, 2)).max())
        for _ in range(14):
            middle = (low + high) / 2
            scaled = G.copy()
            scaled[:, :-1] *= middle
            scaled[:, -1] /= scale
            scaled[:, :, -1] *= scale
            low, high = (middle, high) if np.linalg.norm(scaled, 2, axis=(1, 2)).max() < 1 else (low, middle)
        candidates.append((low, float(scale)))
    return max(candidates)


def _stored_points(
    known: KnownInertia,
    points: Sequence[OperatingPoint],
    uncertainty: UncertaintySamples,
    ball: _Ball,
    periods: tuple[float, int],
) -> list[KnownPoint]:
    """Return the points of the extreme ratios, of the largest stiffness, norm and forces, for a period and a delay."""
    lead_time = ball.loop.lead_periods.item() * periods[0]
    ratios = np.linalg.eigvalsh(uncertainty.inertia)
    stiffness = uncertainty.stiffness_norms(lead_time)
    chosen = [int(np.argmin(ratios[:, 0])), int(np.argmax(ratios[:, -1])), int(np.argmax(stiffness))]
    if ball.position_weight:
        norms = uncertainty.joint_norms(ball.centre, ball.position_weight, lead_time)
        chosen.append(int(np.argmax(norms)))
    nominal, (M, D, G, own) = known.inertias(points), known.linearised_apart(points)
    parts = nominal, M, D, G - own, own
    for power, lead, lag in _force_bounds(uncertainty, *periods):
        chosen.append(int(np.argmax(lagged_force_norms(parts, lead, power, lag))))
    indices = list(dict.fromkeys(chosen))
    worst = [points[i] for i in indices]
    nominal, M, D, G, own = (part[indices] for part in (nominal, M, D, G, own))
    return [
        KnownPoint(
            nominal=nominal[i],
            robot=LinearisedPoint(
                position=point.position,
                inertia=M[i],
                damping=D[i],
                stiffness=G[i] - own[i],
                velocity=point.velocity if point.is_moving else None,
                acceleration=point.acceleration if point.is_moving else None,
            ),
            model_stiffness=own[i],
        )
        for i, point in enumerate(worst)
    ]


def _unstable_rest(
    law: PolePlacement,
    known: KnownInertia,
    points: Sequence[OperatingPoint],
    ratios: Array,
    computation_delay: int,
) -> RestLoop | None:
    """Return the loop at rest at the extreme ratios and at the first points where it is unstable; None for none."""
    worst, worst_radius = None, 1.0
    for index in dict.fromkeys([int(np.argmin(ratios[:, 0])), int(np.argmax(ratios[:, -1])), 0]):
        plant, posture = points[index].plant, points[index].position
        loop = loop_with_model(law, posture, plant.holding_torque(posture), computation_delay)
        M, D, G = plant.linearised(posture)
        rest = RestLoop(
            loop=LoopMatrices(*loop),
            nominal=known.inertias([points[index]])[0],
            robot=LinearisedPoint(position=posture, inertia=M, damping=D, stiffness=G),
        )
        radius = float(np.abs(np.linalg.eigvals(rest.state_matrix(law.period))).max())
        if radius > worst_radius:
            worst, worst_radius = rest, radius
    return worst


def _certificate(
    law: PolePlacement, evidence: KnownInertiaEvidence, workspace: Workspace
) -> Certificate[KnownInertiaEvidence]:
    """Return the certificate of the evidence, with what it assumes."""
    verdict, margin, witness = evidence.judge()
    speed, acceleration = np.asarray(workspace.speed), np.asarray(workspace.acceleration)
    assumptions = [
        f"the eigenvalues of M(q)⁻¹M̂(q) lie between {evidence.min_ratio:.4g} and {evidence.max_ratio:.4g}, and M̂(q) "
        f"changes by at most {evidence.rate:.3g} 1/s; samples and local search found no others, and the verdict leaves "
        f"{100 * SEARCH_MARGIN:.0f} % for worse ones",
        f"no joint is faster than ({format_vector(speed)}) rad/s or m/s, or accelerates by more than "
        f"({format_vector(acceleration)}) rad/s² or m/s²",
        "the robot is one of those given and stays in the workspace; its parameters do not change, or so rarely that "
        "the loop settles in between; between two payloads or rotor inertias the ratios lie between theirs, but the "
        "stiffness was not searched",
        "dry friction and disturbances are left out of the acceleration that the law holds along the motion; friction "
        "is only a disturbance",
        "no torque limit is reached and no sample is lost",
        f"the torque reaches the joints {evidence.computation_delay} periods late and is held for a period",
        _stiffness_note(evidence),
    ]
    if not evidence.robust_term_is_bounded:
        assumptions.append("left out: the robust term, whose slope over the error has no bound; give max_gain")
    return Certificate(
        claim=f"{type(law).__name__} with M̂(q) keeps the robot stable on every motion within the given speeds and "
        "accelerations.",
        problem="A(λ)ᵀ (P(λ) + s0 S0 + s1 S1/λ) A(λ) ≺ e^{−2αT} P(λ), P(λ) = P0 + P1/λ ≻ 0, for all ratios λ, with "
        "stiffness and damping by the S-procedure"
        if evidence.affine is not None
        else "‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ for all motions in the workspace, ‖T(e^{−rT/2} z)‖∞ < 1/δ",
        verdict=verdict,
        margin=margin,
        margin_meaning=_margin_meaning(evidence, verdict),
        assumptions=tuple(assumptions),
        evidence=evidence,
        witness=witness,
        basis=f"{evidence.samples} sampled postures and local search",
    )


def _stiffness_note(evidence: KnownInertiaEvidence) -> str:
    """Return what is assumed of the stiffness between samples."""
    if evidence.affine is not None:
        return (
            "the stiffness of the law's model acts at the position of the torque's sample, and its matrix is that of "
            "the posture now; what it changes since that sample is left to the margin"
        )
    if evidence.computation_delay:
        return "the stiffness of the law's model acts as if the posture of the torque's sample were the present one"
    return "the stiffness of the law's model acts at the position of the sample, for a period"


def _margin_meaning(evidence: KnownInertiaEvidence, verdict: Verdict) -> str:
    """Return what the margin is."""
    if verdict == Verdict.REFUTED:
        return "1 less the spectral radius in that posture"
    if evidence.affine is not None:
        return "growth of ratios, rates and forces that is covered"
    return "radius over the one needed, less 1"
