"""The certificate of a law with M̂(q) on a robot: small gain with a norm that follows the posture."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from tarc.analysis.inertia_ratio import as_plants
from tarc.analysis.known_inertia import KnownInertia, to_posture_coordinates, worst_points
from tarc.analysis.linearise import Channel, decoupled_channels, joints_share_loop, require_inertia
from tarc.analysis.operating_points import NEGLIGIBLE_STIFFNESS, OperatingPoint, UncertaintySamples
from tarc.analysis.rest_stability import loop_with_model, rest_state_matrix
from tarc.analysis.stability import UnstableMode, Witness, unstable_mode
from tarc.analysis.uncertain_loop import FrequencyResponses, System, UncertainLoop, scaled_system
from tarc.analysis.workspace import Workspace
from tarc.analysis.worst_points import inertia_rates, sample_points
from tarc.certificates.base import Certificate, Evidence, Judgement, LoopMatrices, Verdict
from tarc.certificates.robot_evidence import LinearisedPoint
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.numerics.matrix_tests import schur_stability
from tarc.numerics.norms import hinf_norm
from tarc.plants.base import Plant

MIN_MARGIN = 0.05
"""Share by which the radius must exceed the needed one, since the worst points come from samples and search."""

LEAD_FACTORS = 0.5, 1.0
"""Lead times to try, over that at which damping counts as much as stiffness."""

SCALES = 12
"""Number of scales of the robust term's block that are tried."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownPoint:
    """A robot linearised in a posture, with the law's M̂(q) there.

    Attributes
    ----------
    nominal
        M̂(q), shape (n, n).
    robot
        M, D and G of the robot; G less the stiffness of the law's model, D without viscous friction.
    """

    nominal: Array
    robot: LinearisedPoint


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownRatePoint:
    """The posture in which M̂(q) changes fastest.

    Attributes
    ----------
    nominal, inertia_slopes
        M̂ (n, n) and ∂M̂/∂q_i (n, n, n), the joint i first.
    velocity_limits
        Largest speed of each joint [rad/s or m/s], shape (n,).
    """

    nominal: Array
    inertia_slopes: Array
    velocity_limits: Array

    def rate(self) -> float:
        """Return the largest ‖M̂^−½ (dM̂/dt) M̂^−½‖ [1/s] there."""
        return float(inertia_rates(self.nominal, self.inertia_slopes[None], self.velocity_limits)[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class RestLoop:
    """The loop of all joints about a robot at rest, opened at its inertia ratio, and the robot.

    Attributes
    ----------
    loop
        The loop, with the stiffness of the law's model.
    nominal
        M̂(q), shape (n, n).
    robot
        M, D and G with viscous friction.
    """

    loop: LoopMatrices
    nominal: Array
    robot: LinearisedPoint

    def state_matrix(self, period: float) -> Array:
        """Return the state matrix of the closed loop."""
        loop = self.loop.A, self.loop.B, self.loop.C
        matrices = self.robot.inertia, self.robot.damping, self.robot.stiffness
        return rest_state_matrix(loop, self.nominal, matrices, period)


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownInertiaEvidence(Evidence):
    """Worst points of a robot under a law with M̂(q), and the ball that must contain them.

    Attributes
    ----------
    period
        T [s].
    computation_delay
        Periods between a measurement and its torque.
    loop
        The loop of one joint, opened at its inertia ratio.
    centre, radius, position_weight
        ρ0, δ and η [1/s²] of the ball.
    scale
        Scale of the robust term's block; None without one.
    points
        The robot linearised at its worst points, those of the extreme ratios first.
    rate_point
        Where M̂(q) changes fastest.
    rest_loop
        The loop at rest in a posture where it is unstable; None for none.
    robust_term_is_bounded
        Whether the slope of the robust term has a bound.
    min_ratio, max_ratio
        Smallest and largest eigenvalue of M(q)⁻¹M̂(q) at the points. `judge` does not use them.
    samples
        Number of sampled postures.
    """

    kind: ClassVar[str] = "known_inertia"
    witness_type: ClassVar[type[Witness] | None] = UnstableMode

    period: float
    computation_delay: int
    loop: UncertainLoop
    centre: float
    radius: float
    position_weight: float
    scale: float | None
    points: tuple[KnownPoint, ...]
    rate_point: KnownRatePoint
    rest_loop: RestLoop | None
    robust_term_is_bounded: bool
    min_ratio: float
    max_ratio: float
    samples: int

    @property
    def ratio_spread(self) -> float:
        """Largest by smallest inertia ratio."""
        return self.max_ratio / self.min_ratio

    @property
    def rate(self) -> float:
        """Largest ‖M̂^−½ (dM̂/dt) M̂^−½‖ [1/s]."""
        return self.rate_point.rate()

    def uncertainty(self) -> UncertaintySamples:
        """Return E, H and C of the points in coordinates M̂(q)^½ q."""
        nominal = np.array([point.nominal for point in self.points])
        robots = [point.robot for point in self.points]
        M, D, G = (np.array([getattr(robot, name) for robot in robots]) for name in ("inertia", "damping", "stiffness"))
        return to_posture_coordinates(nominal, M, D, G)

    def needed_radius(self) -> float:
        """Return the radius of the points, with what M̂(q) changes until the torque has acted."""
        return widened_radius(
            self.uncertainty(),
            (self.centre, self.position_weight, self.loop.lead_periods.item() * self.period),
            self.rate * self.period,
            self.computation_delay,
        )

    def judge(self) -> Judgement:
        """Test the loop at rest for a mode that grows, then the radius and the decayed norm of the loop."""
        if self.rest_loop is not None:
            verdict, radius, mode = schur_stability(self.rest_loop.state_matrix(self.period))
            if verdict == "refuted":
                witness = unstable_mode(radius, mode, self.period)
                return Judgement(
                    Verdict.REFUTED, float(1 - radius), replace(witness, posture=self.rest_loop.robot.position)
                )
        uncertainty = self.uncertainty()
        lead_time = self.loop.lead_periods.item() * self.period
        has_stiffness = float(uncertainty.stiffness_norms(lead_time).max()) > NEGLIGIBLE_STIFFNESS
        has_damping = float(np.abs(uncertainty.damping).max()) > NEGLIGIBLE_STIFFNESS
        numbers = self.centre, self.radius, self.position_weight, lead_time, self.rate
        is_complete = np.all(np.isfinite(numbers)) and self.radius > 0 and self.centre > 0
        is_complete &= not has_stiffness or self.position_weight > 0
        is_complete &= not has_damping or lead_time > 0
        if not is_complete:
            return Judgement(Verdict.INCONCLUSIVE, -1.0)
        margin = self.radius / max(self.needed_radius(), self.centre / 1e3) - 1
        certified = margin >= MIN_MARGIN and self.robust_term_is_bounded and self._is_proven()
        return Judgement(Verdict.CERTIFIED if certified else Verdict.INCONCLUSIVE, float(margin))

    def _is_proven(self) -> bool:
        """Return whether the decayed loop is stable, and its norm shows the radius."""
        system = decayed_system(self.loop, self.centre, self.position_weight, self.rate * self.period)
        if schur_stability(system[0])[0] != "certified":
            return False
        return hinf_norm(*scaled_system(system, self.radius, self.scale)) < 1


class _Ball(NamedTuple):
    """Radius over the needed one, radius, centre ρ0, weight η, scale and loop."""

    quality: float
    radius: float
    centre: float
    position_weight: float
    scale: float | None
    loop: UncertainLoop


def decayed_system(loop: UncertainLoop, centre: float, position_weight: float, growth: float) -> System:
    """Return the loop with states that grow by e^{growth/2} in each period, as A, B, C, D.

    If its norm is below 1/δ, a P exists with e^{growth} V(x⁺) < V(x) for all mismatches up to δ, V = xᵀ (P ⊗ M̂) x. Then
    V decreases although M̂ grows by e^{growth} in a period.
    """
    A, B, C, D = loop.closed_loop(centre, position_weight)
    factor = np.exp(growth / 2)
    return factor * A, factor * B, C, D


def widened_radius(
    uncertainty: UncertaintySamples, ball: tuple[float, float, float], growth: float, computation_delay: int
) -> float:
    """Return the radius that contains points, and what M̂(q) changes until the torque has acted.

    At the end of the period M̂ is e^{(1 + d) growth} times that of the torque at most, and the coordinates are those of
    its start.

    Parameters
    ----------
    uncertainty
        The points.
    ball
        Centre ρ0, weight η [1/s²], lead time θ [s].
    growth
        Relative change of M̂ in one period.
    computation_delay
        d, periods between a measurement and its torque.
    """
    centre, weight, lead_time = ball
    needed = uncertainty.needed_radius(centre, weight or np.inf, lead_time if weight else 0.0)
    largest_ratio = float(np.linalg.eigvalsh(uncertainty.inertia).max())
    return float(np.exp(growth) * (needed + largest_ratio * np.expm1((1 + computation_delay) * growth)))


def certify_known_inertia(
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    computation_delay: int = 0,
    samples: int = 1000,
    seed: int = 0,
) -> Certificate[KnownInertiaEvidence]:
    """Certify a law with M̂(q) on a robot that moves within a workspace.

    A small error about a motion obeys q̈ = E v − H q − C q̇ with E = M⁻¹M̂(q), see
    `tarc.analysis.known_inertia.KnownInertia`. In coordinates M̂(q)^½ q, E is symmetric with the eigenvalues of M⁻¹M̂,
    and the loop is that of one joint for each of them. With V = xᵀ (P ⊗ M̂(q)) x the law is certified if all operating
    points satisfy

        ‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ,     ‖T(e^{−rT/2} z)‖∞ < 1/δ,     r = sup ‖M̂^−½ (dM̂/dt) M̂^−½‖

    with a margin of 5 %. T is the loop at ρ0 from an acceleration to (v, η q, η θ q̇), r the rate of M̂. The law is
    refuted if the loop at rest in one of the worst postures is unstable.

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

    Returns
    -------
    Certificate
        Its margin is the radius over the needed one, less 1; for a refutation 1 less the spectral radius.

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
    _check_robot(law, plants, workspace)
    known = KnownInertia(inertia)
    channel = decoupled_channels(law, computation_delay)[0]
    rate_point = _rate_point(known, plants, workspace, samples, seed)
    is_bounded = bool(np.isfinite(law.robust_slope_bound))
    slope = law.robust_slope_bound if is_bounded else 0.0
    points = _operating_points(known, plants, workspace, samples, seed)
    growth = rate_point.rate() * law.period
    uncertainty = known.uncertainty(points)
    ball = _best_ball(channel, slope, uncertainty, growth, computation_delay)
    lead_time = ball.loop.lead_periods.item() * law.period
    if ball.position_weight:  # once more, for this ball
        units = workspace.unit_samples(samples, seed)

        def norms(some: Sequence[OperatingPoint]) -> Array:
            return known.uncertainty(some).joint_norms(ball.centre, ball.position_weight, lead_time)

        points = worst_points(points, norms, workspace, units) + points
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
        points=tuple(_stored_points(known, points, uncertainty, ball, lead_time)),
        rate_point=rate_point,
        rest_loop=_unstable_rest(law, known, points, ratios, computation_delay),
        robust_term_is_bounded=is_bounded,
        min_ratio=float(ratios.min()),
        max_ratio=float(ratios.max()),
        samples=samples,
    )
    return _certificate(law, evidence, workspace)


def _known(law: PolePlacement) -> NominalInertia:
    """Return M̂(q), or refuse a constant M̂."""
    if not isinstance(law.inertia, NominalInertia):
        raise UnsupportedLaw(
            f"law: {type(law).__name__} has a constant M̂; use tarc.certificates.certify_robot, or give it a "
            "tarc.NominalInertia"
        )
    return law.inertia


def _check_robot(law: PolePlacement, plants: Sequence[Plant], workspace: Workspace) -> None:
    """Refuse gains that differ between the joints, other joints, and a workspace without speeds."""
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
    units = workspace.unit_samples(samples, seed)
    resting = [point for point in points if not point.is_moving]
    smallest = worst_points(resting, lambda some: -_ratios(known, some)[:, 0], workspace, units)
    largest = worst_points(resting, lambda some: _ratios(known, some)[:, -1], workspace, units)
    lead_time = known.uncertainty(points).lead_time()
    stiffest = worst_points(points, lambda some: known.uncertainty(some).stiffness_norms(lead_time), workspace, units)
    return [*smallest, *largest, *stiffest, *points]


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
    for lead_time in dict.fromkeys(factor * uncertainty.lead_time() for factor in LEAD_FACTORS):
        lead_periods = lead_time / channel.period
        loop = UncertainLoop.from_channel(channel, slope, intersample=True, lead_periods=lead_periods)
        angles = FrequencyResponses(loop, centre).angles
        for weight in uncertainty.candidate_weights(centre, lead_time) or [0.0]:
            system = decayed_system(loop, centre, weight, growth)
            radius, scale = _grid_radius(system, angles, bool(slope))
            needed = widened_radius(uncertainty, (centre, weight, lead_time), growth, computation_delay)
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
    lead_time: float,
) -> list[KnownPoint]:
    """Return the points of the extreme ratios, of the largest stiffness and of the largest norm."""
    ratios = np.linalg.eigvalsh(uncertainty.inertia)
    stiffness = uncertainty.stiffness_norms(lead_time)
    chosen = [int(np.argmin(ratios[:, 0])), int(np.argmax(ratios[:, -1])), int(np.argmax(stiffness))]
    if ball.position_weight:
        norms = uncertainty.joint_norms(ball.centre, ball.position_weight, lead_time)
        chosen.append(int(np.argmax(norms)))
    worst = [points[i] for i in dict.fromkeys(chosen)]
    nominal, (M, D, G) = known.inertias(worst), known.linearised(worst)
    return [
        KnownPoint(
            nominal=nominal[i],
            robot=LinearisedPoint(
                position=point.position,
                inertia=M[i],
                damping=D[i],
                stiffness=G[i],
                velocity=point.velocity if point.is_moving else None,
                acceleration=point.acceleration if point.is_moving else None,
            ),
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
        f"changes by at most {evidence.rate:.3g} 1/s; samples and local search found no others",
        f"no joint is faster than ({format_vector(speed)}) rad/s or m/s, or accelerates by more than "
        f"({format_vector(acceleration)}) rad/s² or m/s²",
        "the robot is one of those given and stays in the workspace; its parameters do not change, or so rarely that "
        "the loop settles in between; between two payloads or rotor inertias the ratios lie between theirs, but the "
        "stiffness was not searched",
        "dry friction and disturbances are left out of the acceleration that the law holds along the motion; friction "
        "is only a disturbance",
        "no torque limit is reached and no sample is lost",
        f"the torque reaches the joints {evidence.computation_delay} periods late and is held for a period; the effect "
        "of stiffness and damping over a period follows from the position and the mean velocity",
    ]
    if not evidence.robust_term_is_bounded:
        assumptions.append("left out: the robust term, whose slope over the error has no bound; give max_gain")
    return Certificate(
        claim=f"{type(law).__name__} with M̂(q) keeps the robot stable on every motion within the given speeds and "
        "accelerations.",
        problem="‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ for all motions in the workspace, ‖T(e^{−rT/2} z)‖∞ < 1/δ",
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the spectral radius in that posture"
        if verdict == Verdict.REFUTED
        else "radius over the one needed, less 1",
        assumptions=tuple(assumptions),
        evidence=evidence,
        witness=witness,
        basis=f"{evidence.samples} sampled postures and local search",
    )
