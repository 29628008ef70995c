"""The certificate of a region of attraction: how large an error a law recovers from, on a robot along a reference."""

from collections.abc import Sequence

import numpy as np

from tarc.analysis.inertia_ratio import as_plants
from tarc.analysis.linearise import decoupled_channels, initial_responses, joints_share_loop
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.certificates.base import Certificate, Verdict
from tarc.certificates.constant_region import ConstantRegion
from tarc.certificates.known_region import KnownRegion
from tarc.certificates.region_evidence import SIZE_ROOM, RegionEvidence, RegionProof
from tarc.certificates.region_form import TrackingLoop
from tarc.certificates.region_search import find_region, first_scaling, scaled_by
from tarc.certificates.region_tube import MARGIN, Disturbances, RegionProblem, TubeCase, TubeSize
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.estimators.oracle import refuse_oracle
from tarc.laws.base import Law
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.references import Reference

RATE_FACTORS = 1.5, 3.0
"""Sizes of the tube in ė over ωn times its size in e, tried in turn."""
KNOWN_RATE_FACTORS = 1.5, 1.0, 0.7
"""The same for M̂(q), which changes faster in a tube of larger ė."""
DECAY_SHARES = 0.6, 0.3, 0.1
"""Decay rates, as shares of that of the slowest constant ratio, tried in turn."""
N_RATIOS = 16
"""Number of constant ratios whose decay is computed."""
ASSUMPTIONS = (
    "sampled: the inertia ratios, their rates, and the stiffness and damping over the box of the tube; a larger value "
    f"than those found is covered up to {MARGIN:.0%}",
    "sampled: the torque along the reference at quarters of a period, and what the law's derivatives of the reference "
    "lack at each period",
    "the robust term, if any, is a slope of the measured error between zero and its bound, which changes at any time",
    "the robot is one of those given throughout; it has no flexibility, and no friction besides viscous friction and "
    "the given torque",
    "the disturbing torque is zero at the start, and changes no faster than given",
    "the robot starts at rest, held by the torque that the law takes as the past one; the window is full of the first "
    "position, that of the reference of its first one",
    "no torque limit is reached and no sample is lost; the reference goes on as given until the duration ends",
)
"""What a verdict takes for granted."""
KNOWN_ASSUMPTIONS = (
    "sampled: the stiffness of the law's model, and how fast M̂ at the measured position changes, up to the same share",
    "the disturbing torque is no larger than given",
)
"""What it takes for granted in addition of a law with M̂(q)."""


def certify_region(
    law: Law,
    plant: Plant | Sequence[Plant],
    reference: Reference,
    duration: float,
    *,
    max_error: Numbers,
    measurement_error: Numbers = 0.0,
    torque_rate: Numbers = 0.0,
    max_torque: Numbers | None = None,
    friction: Numbers = 0.0,
    computation_delay: int = 0,
    samples: int = 500,
    seed: int = 0,
) -> Certificate[RegionEvidence]:
    """Certify how large an error a law recovers from, on the nonlinear robot along a reference.

    With e = q − qᵈ and τ* = M(qᵈ) q̈ᵈ + N(qᵈ, q̇ᵈ) the error obeys, without any linearisation,

        M(q) ë = (τ − τ*) − G̃ e − D̃ ė,

    where G̃ and D̃ are means of ∂(M q̈ᵈ + N)/∂q and ∂N/∂q̇ between (qᵈ, q̇ᵈ) and (q, q̇). As long as (e, ė) stays in a
    tube, their norms are at most those found over the tube. The law is linear in positions and torques, and its memory
    in errors is that of τ − τ*, both without feed-forward. So V = Σ xᵀ (P0⊗I + P1⊗M̂^−½ M(q) M̂^−½) x of the whole
    state, the window and the past torque included, obeys V⁺ ≤ ϱ V + g in the tube. A level V0 of V in the tube is
    never left if g ≤ (1 − ϱ) V0.

    With M̂(q) the memory is in accelerations, less c* = M̂(qᵈ)⁻¹ (τ* − ĥ − f), and V = Σ xᵀ (P0⊗M̂(q̂) + P1⊗M(q)) x with
    M̂ at the measured position q̂. It gains s0 S0, S0 ± P0 ⪰ 0, with s0 the relative change of M̂(q̂) in a period. The
    stiffness ∂(M̂ c* + ĥ)/∂q of the law acts at the position of the sample, and is taken from G̃.

    Parameters
    ----------
    law
        A `tarc.laws.TDC` or `TARC` with gains that all joints share. The robust term of TARC, whose
        ``max_gain`` must be given, may have any slope up to its bound at any time. Feed-forward takes what it knows
        from the torque that the reference needs.
    plant
        The robot in symbols, or several, one of which it is throughout.
    reference, duration
        The motion, and its duration [s]. It should start at rest.
    max_error
        R, largest error that may ever occur [rad or m], one number or one per joint. It sets the tube.
    measurement_error
        Largest error of a measured position [rad or m], one number or one per joint: half a step of an encoder.
    torque_rate
        Largest rate of a disturbing torque [N m/s or N/s], one number or one per joint; it is part of τ*.
    max_torque
        For M̂(q): largest disturbing torque [N m or N], one number or one per joint. In each posture it takes another
        command. Default: ``torque_rate`` times the duration.
    friction
        Largest torque that may change at any time [N m or N], one number or one per joint; at least the dry friction of
        the robot.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Number of sampled states of the tube, and the seed.

    Returns
    -------
    Certificate
        Its evidence has R0, the largest initial error, and R∞, the bound in the end, in coordinates M̂^½ q, and
        `RegionEvidence.joint_errors` turns them into those of joints. The margin is 1 less the level that V approaches
        over the level that fits the tube.

    Raises
    ------
    UnsupportedLaw
        For another law, M̂(q) with a computation delay, a torque limit, and gains that differ between the joints.
    InvalidParameter
        For numbers out of range or of joints that differ, and a robot that is not in symbols.
    NotLinearisable
        For an estimator without a linearisation.
    """
    law = _supported(law, computation_delay)
    plants = as_plants(plant)
    n = law.n_joints
    _check_joints(plants, reference, n)
    duration = check.number("duration", duration, 0, strict=True)
    limit = check.vector("max_error", max_error, n, 0, strict=True)
    rate = check.vector("torque_rate", torque_rate, n, 0)
    problem = RegionProblem(
        law=law,
        plants=plants,
        reference=reference,
        duration=duration,
        max_error=limit,
        disturbances=Disturbances(
            noise=check.vector("measurement_error", measurement_error, n, 0),
            torque_rate=rate,
            max_torque=rate * duration if max_torque is None else check.vector("max_torque", max_torque, n, 0),
            friction=_checked_friction(plants, friction),
        ),
        residuals=reference_residuals(law, reference, duration),
        samples=samples,
        seed=seed,
    )
    region = KnownRegion(problem) if law.has_model else ConstantRegion(problem)
    loop = tracking_loop(law, computation_delay)
    best = None
    for factor in KNOWN_RATE_FACTORS if law.has_model else RATE_FACTORS:
        tube = TubeSize(region.size, factor * float(law.K1[0, 0]) ** 0.5 * region.size)
        proofs = [proof for proof in _proofs(loop, region.case(tube)) if proof.margin() > 0]
        if proofs:
            best = max(proofs, key=lambda proof: proof.start_error)
            break
    evidence = RegionEvidence(
        proof=best,
        nominal_inertia=region.nominal_inertia,
        error_units=region.units,
        max_error=limit,
        start_error=best.start_error * (1 - SIZE_ROOM) if best else 0.0,
        final_error=best.final_error * (1 + SIZE_ROOM) if best else float("inf"),
    )
    return _certificate(law, evidence, samples)


def _check_joints(plants: Sequence[Plant], reference: Reference, n: int) -> None:
    """Refuse robots and a reference of other joints than the law's."""
    for robot in plants:
        robot.require_fully_driven("certify_region")
        if robot.n_joints != n or reference.n_joints != n:
            raise InvalidParameter(
                f"plant, reference: they have {robot.n_joints} and {reference.n_joints} joints, the law {n}"
            )


def dry_friction(plant: Plant) -> Array:
    """Return the dry friction of a robot [N m or N], shape (n,); zero for one that is not in symbols."""
    n = plant.n_joints
    names = plant.dry_friction if isinstance(plant, SymbolicPlant) else ()
    values = [np.broadcast_to(np.abs(np.asarray(plant.parameters[name], dtype=float)), n) for name in names]
    return np.sum(values, axis=0) if values else np.zeros(n)


def _checked_friction(plants: Sequence[Plant], friction: Numbers) -> Array:
    """Return the friction (n,), or refuse one below the dry friction of the robots."""
    limits = check.vector("friction", friction, plants[0].n_joints, 0)
    for plant in plants:
        dry = dry_friction(plant)
        if np.any(dry > limits * (1 + 1e-9)):
            raise InvalidParameter(
                f"friction: got {limits.tolist()}; {plant.label} has dry friction of {dry.tolist()} N m or N, which "
                "may change at any time; give at least as much"
            )
    return limits


def _supported(law: Law, computation_delay: int) -> TDC | TARC:
    """Return a law that is covered, or refuse it."""
    if not isinstance(law, TDC | TARC):
        raise UnsupportedLaw(f"law: got {type(law).__name__}; certify_region covers tarc.laws.TDC and TARC")
    if not np.isfinite(law.robust_slope_bound):
        raise UnsupportedLaw("law: nothing bounds the gain of its robust term; give max_gain")
    if law.has_model and computation_delay:
        raise UnsupportedLaw(
            f"law: M̂(q) with a computation delay of {computation_delay} periods; certify_region covers M̂(q) without "
            "one, and a constant M̂ with any. Use a constant M̂, or a loop that applies its torque at once with "
            "computation_delay=0; certify_known_inertia certifies this law near its motion, without a region"
        )
    refuse_oracle(law.estimator)
    if law.torque_limit is not None or law.actuation_delay:
        raise UnsupportedLaw("law: certify_region does not cover a torque limit and an actuation delay; leave them out")
    if not joints_share_loop(law):
        raise UnsupportedLaw(
            "law: its gains differ between the joints; certify_region needs one natural frequency and damping ratio"
        )
    return law


def tracking_loop(law: TDC | TARC, computation_delay: int) -> TrackingLoop:
    """Return the loop of one joint of a law in errors from the reference, with half of its robust slope."""
    channel = decoupled_channels(law, computation_delay)[0]
    loop = UncertainLoop.from_channel(channel, 0.0, intersample=True)
    window, torque = (np.concatenate([[0, 0], x]) for x in initial_responses(law, computation_delay))
    unit = np.eye(len(loop.A))
    if not np.allclose(channel.F @ torque[2:], torque[2:]) or not np.allclose(channel.C @ torque[2:], 1):
        raise UnsupportedLaw("law: a constant torque is no equilibrium of its memory, which certify_region needs")

    half, none = law.robust_slope_bound / 2, np.zeros((2, 1))
    auxiliary = np.concatenate([none, channel.H])
    return TrackingLoop(
        A=loop.A - half * auxiliary @ unit[:1],
        B=loop.B_mismatch,
        C=loop.C - half * channel.E @ unit[:1],
        noise=np.concatenate([none, channel.G]) - half * auxiliary,
        residual=auxiliary,
        change=-torque[:, None],
        noise_gain=channel.D - half * channel.E,
        residual_gain=channel.E,
        outputs=unit[:2],
        starts=np.column_stack([unit[0], unit[1], window, torque]),
        half_slope=half,
        period=law.period,
    )


def reference_residuals(law: TDC | TARC, reference: Reference, duration: float) -> Array:
    """Return r = a − â_h + K2 (v − v̂) at each period, (n, k), with v̂ and â the law's estimates of the reference.

    The feedback takes v and a from the same window, or as the true q̇ᵈ and q̈ᵈ. The window is full of the first position
    at the start. A literal law takes â one delay before, a synchronised one at once.
    """
    steps = np.arange(round(duration / law.period) + 1)
    q, v, a = reference.sample(steps * law.period)
    state, velocity, acceleration = law.estimator.init(q[:, 0]), np.empty_like(q), np.empty_like(q)
    for k in steps:
        state, estimate = law.estimator.step(state, q[:, k])
        velocity[:, k], acceleration[:, k] = estimate.velocity, estimate.acceleration
    if law.estimates_reference:
        v, a = velocity, acceleration
    past = acceleration
    if not law.synchronised:
        delay = law.delay_periods
        past = np.concatenate([np.zeros((len(q), delay)), acceleration[:, :-delay]], axis=1)
    return a - past + law.K2 @ (v - velocity)


def _proofs(loop: TrackingLoop, case: TubeCase) -> list[RegionProof]:
    """Return Lyapunov functions of some decay rates; none for a tube in which a constant ratio is unstable."""
    tube, ratios, bounds, start = case
    points = np.geomspace(ratios.min_ratio, ratios.max_ratio, N_RATIOS)
    radius = max(float(np.abs(np.linalg.eigvals(loop.A + x * loop.B[:, :1] @ loop.C)).max()) for x in points)
    if radius >= 1 or not np.all(np.isfinite(ratios.force_bounds())):
        return []
    scaled = first_scaling(loop, bounds, tube, float(np.sqrt(ratios.min_ratio * ratios.max_ratio)))
    proofs: list[RegionProof] = []
    for share in DECAY_SHARES:
        decay = radius ** (2 * share)
        found = find_region(scaled, ratios, bounds, tube, decay, rounds=1 if proofs else 2)
        if found is None:
            continue
        scaled = scaled_by(found, ratios)
        proof = RegionProof(
            tube=tube,
            loop=found.loop,
            ratios=ratios,
            bounds=bounds,
            matrices=found.matrices,
            weights=found.weights,
            decay=decay,
            level=1.0,
            rest_stiffness=start[0],
            start_torque=start[1],
            start_velocity=start[2],
        ).with_largest_level()
        is_worse = bool(proofs) and proof.start_error < proofs[-1].start_error
        proofs.append(proof)
        if is_worse:
            break
    return proofs


def _certificate(law: TDC | TARC, evidence: RegionEvidence, samples: int) -> Certificate[RegionEvidence]:
    """Return the certificate of the evidence, with what it assumes."""
    verdict, margin, _ = evidence.judge()
    sizes = [
        f"({format_vector(errors, digits=3)})"
        for errors in (evidence.start_errors, evidence.tube_errors, evidence.final_errors)
    ]
    claim = f"{type(law).__name__} keeps the error of the joints below ({format_vector(evidence.max_error)}) rad or m."
    if verdict == Verdict.CERTIFIED:
        claim = (
            f"{type(law).__name__} recovers from initial errors up to {sizes[0]} rad or m of single joints. The errors "
            f"never exceed {sizes[1]} and end below {sizes[2]} rad or m."
        )
    return Certificate(
        evidence=evidence,
        claim=claim,
        problem="V⁺ ≤ ϱ V + g in the tube, for all inertia ratios; g ≤ (1 − ϱ) V0 for a level V0 in the tube",
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the level that V approaches over that of the tube",
        assumptions=ASSUMPTIONS + (KNOWN_ASSUMPTIONS if law.has_model else ()),
        basis=f"{samples} sampled states of the tube and local search",
    )
