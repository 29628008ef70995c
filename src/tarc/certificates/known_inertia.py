"""The certificate of a law with M̂(q) on a robot: small gain with a norm that follows the posture."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tarc.analysis.inertia_ratio import as_plants
from tarc.analysis.known_inertia import KnownInertia
from tarc.analysis.linearise import Channel, decoupled_channels, joints_share_loop, require_inertia
from tarc.analysis.operating_points import SEARCH_MARGIN, OperatingPoint
from tarc.analysis.rest_stability import loop_with_model
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.analysis.workspace import Workspace
from tarc.certificates.affine import AffineProof, find_proof
from tarc.certificates.base import Certificate, LoopMatrices, Verdict
from tarc.certificates.known_ball import best_ball
from tarc.certificates.known_forces import known_ratios
from tarc.certificates.known_inertia_evidence import KnownInertiaEvidence, RestLoop
from tarc.certificates.known_points import WorstKnownPoints, stored_points, worst_for_ball
from tarc.certificates.robot_evidence import LinearisedPoint
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.plants.base import Plant


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
    ball = best_ball(channel, slope, uncertainty, growth, computation_delay)
    if ball.position_weight:
        units = workspace.unit_samples(samples, seed)
        points = worst_for_ball((ball, law.period), known, points, workspace, units) + points
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
        points=tuple(stored_points(known, points, uncertainty, ball, (law.period, computation_delay))),
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
