"""The certificate of a region of attraction: how large an error a law recovers from, on a robot along a reference."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product as combinations
from typing import ClassVar

import numpy as np

from tarc.analysis.inertia_ratio import as_plants
from tarc.analysis.linearise import decoupled_channels, initial_responses, joints_share_loop
from tarc.analysis.operating_points import matrix_roots
from tarc.analysis.tube import ReferenceBounds, TubeBounds, feedforward_along, reference_bounds, tube_bounds
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.analysis.workspace import Workspace
from tarc.certificates.affine_form import LyapunovMatrices, RatioSet
from tarc.certificates.base import Certificate, Evidence, Judgement, Verdict
from tarc.certificates.known_region import KnownRegion
from tarc.certificates.region_form import InputBounds, RegionWeights, TrackingLoop, region_decrease, signal_bounds
from tarc.certificates.region_search import Disturbances, TubeCase, TubeSize, find_region, first_scaling, scaled_by
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.estimators.oracle import refuse_oracle
from tarc.laws.base import Law
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.numerics.ball_arithmetic import BALLS, decide, is_positive_definite
from tarc.numerics.matrix_polynomial import definite_pieces, is_definite_on
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.references import Reference

MARGIN = 0.05
"""Growth of all that was found in the tube that the certificate covers; samples miss the worst."""
RATE_FACTORS = 1.5, 3.0
"""Sizes of the tube in ė over ωn times its size in e, tried in turn."""
KNOWN_RATE_FACTORS = 1.5, 1.0, 0.7
"""The same for M̂(q), which changes faster in a tube of larger ė."""
DECAY_SHARES = 0.6, 0.3, 0.1
"""Decay rates, as shares of that of the slowest constant ratio, tried in turn."""
FORCE_SHARE = 0.01
"""Share of the bound on the forces that is left to the motion within a period."""
N_RATIOS = 16
"""Number of constant ratios whose decay is computed."""
MAX_CORNER_JOINTS = 12
"""Number of joints up to which all combinations of signs are tried."""
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
SLACK = 1 + 2.0**-27
"""Factor by which stored sizes may miss those computed again."""
SIZE_ROOM = 1e-5
"""Share by which sizes are stored smaller or larger than computed, beyond rounding."""
BISECTIONS = 50
"""Number of steps in which the largest level within the tube is found."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RegionProof:
    """A Lyapunov function for all errors in a tube about a reference, and the levels between which it falls.

    Lengths are in coordinates M̂^½ q.

    Attributes
    ----------
    tube
        Largest ‖M̂^½ e‖ and ‖M̂^½ ė‖ of the tube.
    loop
        The loop of one joint, in the states of the Lyapunov function.
    ratios
        What the robot is in the tube, with `MARGIN`.
    bounds
        What acts on the loop, with `MARGIN`.
    matrices, weights
        Of the Lyapunov function, and of what the signals satisfy.
    decay
        ϱ: V⁺ ≤ ϱ V + g.
    level
        c: a level of V in the tube, also between samples.
    rest_stiffness
        Largest ‖M̂^−½ (∂N/∂q) M̂^−½‖ at rest in the tube [1/s²], with `MARGIN`.
    start_torque, start_velocity
        ‖M̂^−½ (N(qᵈ, 0) − τ*)‖ and ‖M̂^½ q̇ᵈ‖ at the start.
    """

    tube: TubeSize
    loop: TrackingLoop
    ratios: RatioSet
    bounds: InputBounds
    matrices: LyapunovMatrices
    weights: RegionWeights
    decay: float
    level: float
    rest_stiffness: float
    start_torque: float
    start_velocity: float

    @property
    def supply(self) -> float:
        """g, by which V may grow in a period."""
        force_squares, squares = signal_bounds(self.ratios, self.bounds)
        return float(self.weights.forces @ force_squares + np.array(self.weights[3:]) @ squares)

    @property
    def final_level(self) -> float:
        """g/(1 − ϱ), which V approaches."""
        return self.supply / (1 - self.decay)

    def with_largest_level(self) -> "RegionProof":
        """Return the same with the largest level of V that lies in the tube; the program makes it at most 1."""
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            low, high = (middle, high) if self.is_in_tube(middle) else (low, middle)
        return replace(self, level=low * (1 - SIZE_ROOM))

    def is_in_tube(self, level: float) -> bool:
        """Return whether a level of V that is not left lies in the tube, also between samples."""
        error, rate = self._largest(level)
        return error <= SLACK * self.tube.error and rate <= SLACK * self.tube.error_rate

    @property
    def start_error(self) -> float:
        """r: largest ‖M̂^½ e‖ at the start; the robot is at rest, and so held, and its window is full of q."""
        error, rate, window, torque = self.loop.starts.T
        taken = self._norm(torque) * self.start_torque + self._norm(rate) * self.start_velocity * self.ratios.period
        taken += self._norm(window) * self.bounds.noise
        needed = self._norm(error + window) + self.rest_stiffness * self._norm(torque)
        return max((self.level**0.5 - taken) / needed, 0.0)

    @property
    def final_error(self) -> float:
        """b: ‖M̂^½ e‖ in the end, between samples too; from the start it decays to it as √ϱ per period."""
        return self._largest(self.final_level)[0]

    @property
    def decay_rate(self) -> float:
        """Rate α [1/s] at which what exceeds the final level decays."""
        return float(-np.log(self.decay) / 2 / self.ratios.period)

    def margin(self) -> float:
        """Return 1 less the level that V approaches over that of the tube; −1 for numbers out of range."""
        if not self._is_consistent() or not self.is_in_tube(self.level):
            return -1.0
        return 1 - self.final_level / self.level

    def is_proven(self) -> bool:
        """Return whether ball arithmetic proves that V is positive and falls in the tube, at all ratios."""
        arguments = self.loop, self.ratios, self.matrices, self.weights, self.decay
        low, high = self.ratios.min_ratio, self.ratios.max_ratio
        ends = definite_pieces(region_decrease(*arguments), low, high)
        if ends is None:
            return False

        def is_positive() -> bool:
            P0, P1, Q1, S, R, S0 = (BALLS.matrix(part) for part in self.matrices)
            forms = [P0 * BALLS.number(ratio) + P1 + Q1 for ratio in (low, high)]
            forms += [S0 + P0, S0 - P0] if self.ratios.nominal_rate > 0 else []
            return all(is_positive_definite(form) for form in [*forms, S + P1, S - P1, R + Q1, R - Q1])

        return decide(is_positive) and decide(lambda: is_definite_on(region_decrease(*arguments, BALLS), ends))

    def _is_consistent(self) -> bool:
        """Return whether all numbers are finite and in range."""
        ratios, weights = self.ratios, [*self.weights.forces, *self.weights[1:]]
        numbers = [
            ratios.rate,
            ratios.relative_rate,
            ratios.nominal_rate,
            self.bounds.noise,
            self.bounds.residual,
            self.bounds.drift,
            self.rest_stiffness,
        ]
        numbers += [
            self.loop.half_slope,
            self.start_torque,
            self.start_velocity,
            *ratios.stiffness,
            *ratios.lead_times,
            *weights,
        ]
        return (
            0 < ratios.min_ratio <= ratios.max_ratio < np.inf
            and 0 < self.decay < 1
            and 0 < self.level < np.inf
            and bool(np.all(np.isfinite(numbers)) and np.all(np.array(numbers) >= 0))
            and bool(np.all(ratios.powers == 1) and np.isfinite(ratios.condition) and ratios.intersample)
            and bool(np.all(np.isfinite(ratios.force_bounds())))
        )

    def _ends(self) -> list[Array]:
        """Return P(λ) at the ends of the range; norms are largest there, since P is affine in 1/λ."""
        P0, P1, Q1 = self.matrices[:3]
        return [P0 + (P1 + Q1) / ratio for ratio in (self.ratios.min_ratio, self.ratios.max_ratio)]

    def _norm(self, state: Array) -> float:
        """Return the largest √(yᵀ P(λ) y)."""
        values = [float(state @ P @ state) for P in self._ends()]
        return _root(min(values), max(values))

    def _gain(self, row: Array) -> float:
        """Return the largest value of a row of the state over √V."""
        values = [float(row @ np.linalg.solve(P, row)) for P in self._ends()]
        return _root(min(values), max(values))

    def _largest(self, level: float) -> tuple[float, float]:
        """Return the largest ‖M̂^½ e‖ and ‖M̂^½ ė‖ of a level of V that is not left, between samples too.

        Between samples e differs from its chord by at most T²/8 of the largest acceleration. For ė it is at most T/2 of
        what the acceleration differs from its mean. M̂ is that of the start of the period, at its end too.
        """
        T, (position, velocity), root = self.ratios.period, self.loop.outputs, level**0.5
        end = root * (1 + self.ratios.max_nominal_change) ** 0.5
        bounds = self.bounds
        v = root * self._gain(self.loop.C[0]) + abs(self.loop.noise_gain.item()) * bounds.noise
        robust = self.loop.half_slope * (self.tube.error + bounds.noise)
        v += abs(self.loop.residual_gain.item()) * (bounds.residual + robust)
        force = bounds.held + bounds.torque
        if len(self.ratios.stiffness):
            reach = np.hypot(self.tube.error, self.ratios.lead_times * self.tube.error_rate)
            force += float((self.ratios.stiffness * reach).min())
        largest = self.ratios.max_ratio * (v + force)
        uneven = self.ratios.max_ratio * (self.ratios.swing * v + 2 * force)
        error = end * self._gain(position) + largest * T**2 / 8
        return float(error), float(end * self._gain(velocity) / T + uneven * T / 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class RegionEvidence(Evidence):
    """Errors from which a law recovers along a reference.

    Attributes
    ----------
    proof
        The Lyapunov function; None where none was found.
    nominal_inertia
        M̂ [kg m² or kg], shape (n, n); for M̂(q) a matrix at least as large as it at the start.
    error_units
        √(M̂⁻¹)_ii, shape (n,); for M̂(q) the largest in the tube.
    max_error
        R, largest error of each joint that is allowed [rad or m], shape (n,).
    start_error, final_error
        r and b: largest ‖M̂^½ e‖ at the start and in the end; zero and infinite without a proof.
    """

    kind: ClassVar[str] = "region"

    proof: RegionProof | None
    nominal_inertia: Array
    error_units: Array
    max_error: Array
    start_error: float
    final_error: float

    def judge(self) -> Judgement:
        """Prove that V is positive and falls in the tube, and compare its levels."""
        proof = self.proof
        if proof is None:
            return Judgement(Verdict.INCONCLUSIVE, -1.0)
        margin = proof.margin()
        holds = margin > 0 and 0 < self.start_error <= SLACK * proof.start_error
        holds = holds and SLACK * self.final_error >= proof.final_error
        least = np.sqrt(np.diag(np.linalg.inv(self.nominal_inertia)))
        holds = holds and bool(np.all(SLACK * self.error_units >= least))
        holds = (
            holds and bool(np.all(self.joint_errors(proof.tube.error) <= SLACK * self.max_error)) and proof.is_proven()
        )
        return Judgement(Verdict.CERTIFIED if holds else Verdict.INCONCLUSIVE, margin)

    def joint_errors(self, size: float) -> Array:
        """Return the largest |e_i| of ‖M̂^½ e‖ ≤ size [rad or m], shape (n,)."""
        return size * self.error_units

    @property
    def tube_errors(self) -> Array:
        """Largest error of each joint that ever occurs [rad or m], shape (n,)."""
        return self.joint_errors(self.proof.tube.error) if self.proof else 0 * self.max_error

    @property
    def start_errors(self) -> Array:
        """r: largest initial error of each joint if the others have none [rad or m], shape (n,)."""
        return self.start_error / np.sqrt(np.diag(self.nominal_inertia))

    @property
    def final_errors(self) -> Array:
        """b: bound on the error of each joint in the end [rad or m], shape (n,)."""
        return self.joint_errors(self.final_error)

    def start_contains(self, error: Array) -> bool:
        """Return whether an initial error of all joints (n,) is covered."""
        return float(error @ self.nominal_inertia @ error) <= self.start_error**2


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
    state, the window and the past torque included, obeys V⁺ ≤ ϱ V + g in the tube. A level of V in the tube is never
    left if g ≤ (1 − ϱ) of it.

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
        Its evidence has r, the largest initial error, and b, the bound in the end, in coordinates M̂^½ q, and
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
    given = Disturbances(
        noise=check.vector("measurement_error", measurement_error, n, 0),
        torque_rate=rate,
        max_torque=rate * duration if max_torque is None else check.vector("max_torque", max_torque, n, 0),
        friction=_checked_friction(plants, friction),
        force_share=FORCE_SHARE,
    )
    motion, sampling = (law, plants, reference, duration), (samples, seed)
    residuals = reference_residuals(law, reference, duration)
    if law.has_model:
        region = KnownRegion(*motion, limit, given, residuals, sampling, 1 + MARGIN)
    else:
        region = _ConstantRegion(*motion, limit, given, residuals, sampling)
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


class _ConstantRegion:
    """Tubes about a reference, for a law with a constant M̂; as `KnownRegion`."""

    def __init__(
        self,
        law: TDC | TARC,
        plants: Sequence[Plant],
        reference: Reference,
        duration: float,
        limits: Array,
        disturbances: Disturbances,
        residuals: Array,
        sampling: tuple[int, int],
    ):
        self._law, self._plants, self._sampling, self._given = law, plants, sampling, disturbances
        self.nominal_inertia = law.M
        self._root, self._inverse_root = matrix_roots(law.M)
        self.units = np.sqrt(np.diag(np.linalg.inv(law.M)))
        self.size = float((limits / self.units).min())
        forward, self._model_stiffness = (None, None) if law.feedforward is None else feedforward_along(law)
        self._motion = reference_bounds(plants, self._inverse_root, reference, duration, law.period, forward)
        self._residual = float(np.linalg.norm(self._root @ residuals, axis=0).max())

    def case(self, tube: TubeSize) -> TubeCase:
        """Return what the loop must tolerate in a tube of the errors `size`."""
        room, given, motion, samples, seed = 1 + MARGIN, self._given, self._motion, *self._sampling
        period, stiffness = self._law.period, self._model_stiffness
        disturbed = period * largest_norm(self._inverse_root, given.torque_rate)
        bounds = InputBounds(
            noise=largest_norm(self._root, given.noise),
            residual=room * self._residual,
            change=room * period * motion.command_rate + disturbed,
            held=room * period * motion.torque_rate + disturbed,
            torque=largest_norm(self._inverse_root, given.friction),
        )
        space = tube_workspace(motion, tube, self.units)
        options = {"samples": samples, "seed": seed}
        robot = tube_bounds(self._plants, self._law.M, space, **options, model_stiffness=stiffness)
        start_torque = motion.start_torque
        if stiffness is not None:  # the model's torque at the start is that of the measured position
            known = self._inverse_root @ stiffness(space.sample(samples, seed).T) @ self._inverse_root
            start_torque += room * float(np.linalg.norm(known, 2, axis=(1, 2)).max()) * bounds.noise
        velocity = float(np.linalg.norm(self._root @ motion.start_velocity))
        return TubeCase(tube, _ratio_set(robot, period), bounds, (room * robot.rest_stiffness, start_torque, velocity))


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


def _root(least: float, largest: float) -> float:
    """Return the root of the larger of two squares; infinite where one is negative, of a form that is not positive."""
    return float(largest) ** 0.5 if least >= 0 else float("inf")


def _supported(law: Law, computation_delay: int) -> TDC | TARC:
    """Return a law that is covered, or refuse it."""
    if not isinstance(law, TDC | TARC):
        raise UnsupportedLaw(f"law: got {type(law).__name__}; certify_region covers tarc.laws.TDC and TARC")
    if not np.isfinite(law.robust_slope_bound):
        raise UnsupportedLaw("law: nothing bounds the gain of its robust term; give max_gain")
    if law.has_model and computation_delay:
        raise UnsupportedLaw("law: certify_region does not cover M̂(q) with a computation delay; leave the delay out")
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


def largest_norm(matrix: Array, limits: Array) -> float:
    """Return the largest ‖A x‖ with |x_i| at most the limits, at a corner; for many joints a bound."""
    if len(limits) > MAX_CORNER_JOINTS:
        return float(np.linalg.norm(np.abs(matrix) @ limits))
    corners = np.array(list(combinations((-1.0, 1.0), repeat=len(limits)))) * limits
    return float(np.linalg.norm(corners @ matrix.T, axis=1).max())


def tube_workspace(motion: ReferenceBounds, tube: TubeSize, units: Array) -> Workspace:
    """Return the box of postures and speeds of a tube; ``units`` are √(M̂⁻¹)_ii (n,)."""
    return Workspace.box(
        motion.low - tube.error * units,
        motion.high + tube.error * units,
        speed=motion.speed + tube.error_rate * units,
        acceleration=motion.acceleration,
    )


def _ratio_set(robot: TubeBounds, period: float) -> RatioSet:
    """Return what the loop must tolerate, with `MARGIN`."""
    room, count = 1 + MARGIN, len(robot.stiffness)
    return RatioSet(
        min_ratio=robot.min_ratio / room,
        max_ratio=robot.max_ratio * room,
        rate=robot.rate * room,
        relative_rate=robot.relative_rate * room,
        period=period,
        intersample=True,
        powers=np.ones(count),
        lead_times=robot.lead_times,
        stiffness=robot.stiffness * room,
        shares=np.full(count, FORCE_SHARE),
    )


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
        problem="V⁺ ≤ ϱ V + g in the tube, for all inertia ratios; g ≤ (1 − ϱ) c for a level c in the tube",
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the level that V approaches over that of the tube",
        assumptions=ASSUMPTIONS + (KNOWN_ASSUMPTIONS if law.has_model else ()),
        basis=f"{samples} sampled states of the tube and local search",
    )
