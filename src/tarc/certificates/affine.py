"""The affine certificate: a Lyapunov function affine in the inertia, for ratios that change at a bounded rate."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tarc.analysis.linearise import (
    Channel,
    decoupled_channels,
    joints_share_loop,
    refuse_nominal_inertia,
    require_inertia,
)
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.certificates.affine_form import LyapunovMatrices, Multipliers, RatioSet, decrease
from tarc.certificates.affine_search import MAX_PROGRAMS, AffineCandidate, find_affine
from tarc.certificates.base import Certificate, Evidence, Judgement, Verdict, require_held_torque
from tarc.certificates.force_form import ForcePoints
from tarc.certificates.reduced_loop import CentredLoop, ReducedLoop, reduce_loop
from tarc.core import validation as check
from tarc.core.errors import UnsupportedLaw
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.numerics.ball_arithmetic import BALLS, decide, is_positive_definite
from tarc.numerics.matrix_polynomial import definite_pieces, is_definite_on

ORDERS = 14, 22
"""Numbers of states to which the loop is reduced, tried in turn."""
N_CENTRES = 16
"""Number of ratios among which the centre is chosen."""
DECAY_SHARES = 0.8, 0.6, 0.4, 0.25, 0.15, 0.08, 0.04, 0.02, 0.01, 1e-3, 0.0
"""Decay rates to prove, as shares of that of the slowest constant ratio."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AffineProof:
    """A Lyapunov function V = Σ xᵀ (P0⊗I + (P1 + Q1)⊗E⁻¹) x, which decays by e^{−2αT} in each period.

    Attributes
    ----------
    loop
        The loop, of few states.
    ratios
        The mismatches, stiffnesses and dampings that it tolerates.
    matrices
        P0, P1 and Q1 of the Lyapunov function, and S and R, which bound what a change of E⁻¹ adds to it.
    multipliers
        Weights of the constraints on the uncertain signals.
    growth
        e^{αT}.
    """

    loop: ReducedLoop
    ratios: RatioSet
    matrices: LyapunovMatrices
    multipliers: Multipliers
    growth: float

    @property
    def decay_rate(self) -> float:
        """α [1/s]: errors decay as e^{−αt}."""
        return float(np.log(self.growth) / self.ratios.period)

    def is_proven(self) -> bool:
        """Return whether ball arithmetic proves that V is positive and decays, at all ratios of the interval."""
        if not self._is_consistent():
            return False
        ratios = self.ratios
        arguments = self.loop, ratios, self.matrices, self.multipliers, self.growth
        ends = definite_pieces(decrease(*arguments), ratios.min_ratio, ratios.max_ratio)
        if ends is None:
            return False

        def decreases() -> bool:
            return is_definite_on(decrease(*arguments, BALLS), ends)

        return (
            decide(self._is_positive)
            and self.loop.error_is_bounded(error_growth(self.growth, ratios))
            and decide(decreases)
        )

    def extended(self, loop: UncertainLoop, ratios: RatioSet) -> "AffineProof | None":
        """Return the same Lyapunov function for a loop and other ratios, with the fastest decay that balls prove.

        None where they prove none. The loop must have as many states, and the ratios as many bounds.
        """
        radii = spectral_radii(loop, ratios.min_ratio, ratios.max_ratio)[1]
        if radii.max() >= 1:
            return None
        reduced = replace(self.loop, full=replace(self.loop.full, loop=loop))
        candidate = AffineCandidate(reduced, ratios, self.matrices, self.multipliers)
        return _fastest_decay(candidate, -float(np.log(radii.max())))

    def _is_positive(self) -> bool:
        """Return whether V, S ± P1, R ± Q1, and S0 ± P0 for M̂(q), are proven positive definite.

        P0 + (P1 + Q1)/λ is affine in 1/λ.
        """
        P0, P1, Q1, S, R, S0 = (BALLS.matrix(part) for part in self.matrices)
        ends = self.ratios.min_ratio, self.ratios.max_ratio
        forms = [P0 * BALLS.number(ratio) + P1 + Q1 for ratio in ends]
        forms += [S + P1, S - P1, R + Q1, R - Q1]
        forms += [S0 + P0, S0 - P0] if self.ratios.nominal_rate > 0 else []
        return all(is_positive_definite(form) for form in forms)

    def _is_consistent(self) -> bool:
        """Return whether all numbers are finite and in range, and the inputs of the loop are those of a held torque."""
        ratios, loop, full = self.ratios, self.loop, self.loop.full
        weights = [*self.multipliers[:1], *self.multipliers.forces, *self.multipliers[2:]]
        in_range = (
            0 < ratios.min_ratio <= ratios.max_ratio < np.inf
            and 0 <= ratios.rate < np.inf
            and 0 <= ratios.relative_rate < np.inf
            and 0 <= ratios.nominal_rate < np.inf
            and 0 < ratios.period < np.inf
            and 1 <= self.growth < np.inf
            and full.centre > 0
            and loop.error_gain > 0
            and np.all(full.scales > 0)
            and np.all(np.array(weights) >= 0)
            and np.all(np.isin(ratios.powers, (0.0, 0.5, 1.0)))
            and np.all(ratios.lead_times >= 0)
            and np.all(ratios.stiffness >= 0)
            and np.all(ratios.lag_weights >= 0)
        )
        if not in_range or not np.isfinite(ratios.condition) or not np.all(np.isfinite(ratios.force_bounds())):
            return False
        if ratios.form is not None and not _is_valid_form(ratios):
            return False
        bounds = ratios.powers, ratios.lead_times, ratios.stiffness, ratios.shares, self.multipliers.forces
        lengths = {len(bound) for bound in (*bounds, ratios.lags())}
        has_position = len(full.scales) in (3, 4) or (not ratios.has_forces and not full.has_slope)
        has_position = has_position or (len(full.scales) == 2 and not ratios.has_forces)
        n_states = len(loop.A)
        shapes = {matrix.shape for matrix in (loop.A, *self.matrices)}
        return (
            len(lengths) == 1 and has_position and shapes == {(n_states, n_states)} and _inputs_are_held(full, ratios)
        )


def _is_valid_form(ratios: RatioSet) -> bool:
    """Return whether a form of the forces is in range, and bounds their torques over a period at all ratios."""
    form = ratios.form
    if form is None or not form.is_valid() or not ratios.intersample or len(ratios.stiffness):
        return False
    bounds = ratios.period_form(form)
    return form.split > 0 and min(bounds.factor(ratios.min_ratio), bounds.factor(ratios.max_ratio)) > 0


def error_growth(growth: float, ratios: RatioSet) -> float:
    """Return e^{αT + rT/2}, since the storage of the reduced loop's error has M̂, which grows by e^{rT} a period."""
    return growth * (1 + ratios.max_nominal_change) ** 0.5


def _inputs_are_held(full: CentredLoop, ratios: RatioSet) -> bool:
    """Return whether an acceleration enters as one that is held over a period, and its first moment besides."""
    n_columns = 2 if ratios.intersample or ratios.has_forces else 1
    loop = full.loop
    require_held_torque(loop.A, loop.B, ratios.period, loop.B_mismatch)
    return loop.B_mismatch.shape[1] == n_columns and np.array_equal(loop.B[:, 0], loop.B_mismatch[:, 0])


@dataclass(frozen=True, kw_only=True, eq=False)
class AffineEvidence(Evidence):
    """A Lyapunov function for a range of ratios, if one was found.

    Attributes
    ----------
    proof
        The Lyapunov function; None where none was found.
    min_ratio, max_ratio
        Ends of the range to certify.
    rate
        Largest ‖dE⁻¹/dt‖ [1/s] to certify.
    slope
        Largest slope of the robust term [1/s²].
    """

    kind: ClassVar[str] = "affine"

    proof: AffineProof | None
    min_ratio: float
    max_ratio: float
    rate: float
    slope: float

    @property
    def decay_rate(self) -> float:
        """α [1/s]; zero without a proof."""
        return 0.0 if self.proof is None else self.proof.decay_rate

    @property
    def ratio_spread(self) -> float:
        """Largest over smallest ratio of the range."""
        return self.max_ratio / self.min_ratio

    def judge(self) -> Judgement:
        """Prove the Lyapunov function, and compare what it tolerates with what is to be certified."""
        proof = self.proof
        if proof is None:
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        ratios = proof.ratios
        covers = ratios.min_ratio <= self.min_ratio <= self.max_ratio <= ratios.max_ratio
        covers = covers and self.rate <= ratios.rate and self.slope <= 2 * proof.loop.full.loop.half_slope.item()
        covers = covers and self.rate * self.max_ratio <= ratios.relative_rate * (1 + 1e-9)
        proven = covers and proof.is_proven()
        return Judgement(Verdict.CERTIFIED if proven else Verdict.INCONCLUSIVE, proof.decay_rate if proven else 0.0)


def certify_affine(
    law: Law,
    ratio_range: tuple[float, float],
    rate: float,
    *,
    slope: float = 0.0,
    intersample: bool = True,
    computation_delay: int = 0,
    channels: Sequence[Channel] | None = None,
    on_program: Callable[[], object] = lambda: None,
) -> Certificate[AffineEvidence]:
    """Certify the loop for inertia ratios in a range that change at a bounded rate, in any number of joints.

    With A(λ) the loop of one joint at a ratio λ, and J = E⁻¹, the Lyapunov function is affine in the inertia:

        V = xᵀ (P0⊗I + P1⊗J) x,    P(λ) = P0 + P1/λ ≻ 0,    S ± P1 ⪰ 0,
        A(λ)ᵀ (P(λ) + s S) A(λ) ≺ e^{−2αT} P(λ)    for all λ of the range.

    Here s bounds the change of J in a period. For a fixed E everything decouples into the eigenvalues λ of E, and a
    change of J adds P1⊗ΔJ ⪯ s S⊗I. So V decays for every symmetric E(t) with that range and rate.

    A solver finds P0, P1 and S at a few ratios. The condition, times λ a cubic polynomial, is then proven on the whole
    range in ball arithmetic.

    Parameters
    ----------
    law
        A law with an inertia M̂ and with scalar K1, K2 and P2.
    ratio_range
        Smallest and largest eigenvalue of E.
    rate
        Largest ‖dE⁻¹/dt‖ = ‖M̂^−½ (dM/dt) M̂^−½‖ [1/s].
    slope
        Largest slope of the robust term [1/s²]; α ĉ ‖P2‖/ε for TARC.
    intersample
        Whether E may change within a period; else it is constant over each period.
    computation_delay
        Periods between a measurement and its torque.
    channels
        The loops of `tarc.analysis.linearise.decoupled_channels` for law and delay, where they exist already.
    on_program
        Called after each semidefinite program, to show progress.

    Returns
    -------
    Certificate
        Certified or inconclusive. The margin is the decay rate α [1/s] that is proven.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia, and for gains that are not scalar.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        For numbers out of range.
    """
    low = check.number("ratio_range", ratio_range[0], 0, strict=True)
    high = check.number("ratio_range", ratio_range[1], low)
    rate, slope = check.number("rate", rate, 0), check.number("slope", slope, 0)
    law = require_inertia(law, "the affine certificate")
    refuse_nominal_inertia(law, "the affine certificate")
    channels = decoupled_channels(law, computation_delay) if channels is None else channels
    if not joints_share_loop(law):
        raise UnsupportedLaw(
            "law: the joints' gains differ or are coupled, and the affine certificate needs the same on every joint; "
            "give one natural frequency and one damping ratio for all"
        )
    ratios = RatioSet(
        min_ratio=low,
        max_ratio=high,
        rate=rate,
        relative_rate=rate * high,
        period=law.period,
        intersample=intersample,
        powers=np.zeros(0),
        lead_times=np.zeros(0),
        stiffness=np.zeros(0),
        shares=np.zeros(0),
    )
    proof = find_proof(UncertainLoop.from_channel(channels[0], slope, intersample), ratios, on_program)
    evidence = AffineEvidence(proof=proof, min_ratio=low, max_ratio=high, rate=rate, slope=slope)
    verdict, margin, _ = evidence.judge()
    return Certificate(
        claim=f"The loop of {type(law).__name__} around q̈ = E(t) M̂⁻¹τ is stable for every symmetric E(t) with "
        f"eigenvalues from {low:.5g} to {high:.5g}, E⁻¹ changing by at most {rate:.5g} 1/s.",
        problem="A(λ)ᵀ (P(λ) + s S) A(λ) ≺ e^{−2αT} P(λ), P(λ) = P0 + P1/λ ≻ 0, S ± P1 ⪰ 0 for all λ of the range",
        verdict=verdict,
        margin=margin,
        margin_meaning="decay rate [1/s]",
        assumptions=_assumptions(slope, rate, intersample, computation_delay),
        evidence=evidence,
        proof_grade=verdict == Verdict.CERTIFIED,
    )


def _assumptions(slope: float, rate: float, intersample: bool, computation_delay: int) -> tuple[str, ...]:
    """Return what the verdict takes for granted."""
    changes = "E changes at any time" if intersample else "E is constant within each period"
    robust_term = "there is no robust term"
    if slope:
        robust_term = f"the robust term is a slope between 0 and {slope:g} 1/s², which changes at any time"
    return (
        f"{changes}, E⁻¹ at no more than {rate:.4g} 1/s",
        robust_term,
        "the same gains, window, period and delay on every joint; no torque limit is reached, no sample is lost",
        "Coriolis forces, gravity and friction are only disturbances",
        f"the torque reaches the joints {computation_delay} periods late and is held for a period",
    )


def find_proof(
    loop: UncertainLoop,
    ratios: RatioSet,
    on_program: Callable[[], object] = lambda: None,
    *,
    computation_delay: int = 0,
    orders: Sequence[int] = ORDERS,
    max_programs: int = MAX_PROGRAMS,
    forces: ForcePoints | None = None,
    first: bool = False,
) -> AffineProof | None:
    """Return a Lyapunov function with the fastest decay that is proven; None where none was found.

    Parameters
    ----------
    loop
        The loop, opened at its inertia ratio.
    ratios
        What it must tolerate.
    on_program
        Called after each semidefinite program, to show progress.
    computation_delay
        Periods since the sample of the torque, for ratios with a lag; the loop has this delay already.
    orders
        Numbers of states to which the loop is reduced, tried in turn.
    max_programs
        Largest number of semidefinite programs per order.
    forces
        Points that a form of the forces must cover, in place of bounds on their norms in the ratios.
    first
        Return the first Lyapunov function that is proven, of programs that are solved roughly. Further programs and
        more digits may give one that decays faster.
    """
    lag_periods = computation_delay if len(ratios.lag_weights) else 0
    loop = loop.with_past_position(lag_periods)
    centres, radii = spectral_radii(loop, ratios.min_ratio, ratios.max_ratio)
    if radii.max() >= 1:
        return None
    full = CentredLoop(
        loop=loop, centre=float(centres[radii.argmin()]), scales=_output_scales(loop, ratios, lag_periods, forces)
    )
    slowest = -float(np.log(radii.max()))

    def is_proven(candidate: AffineCandidate) -> bool:
        return _fastest_decay(candidate, slowest) is not None

    is_enough = is_proven if first else None
    tried = 0
    for order in orders:
        reduced = reduce_loop(full, order)
        if reduced is None or len(reduced.A) == tried:
            break
        tried = len(reduced.A)
        candidate = find_affine(reduced, ratios, on_program, max_programs, forces, is_enough=is_enough)
        proof = None if candidate is None else _fastest_decay(candidate, slowest)
        if proof is not None:
            return proof
    return None


def spectral_radii(loop: UncertainLoop, min_ratio: float, max_ratio: float) -> tuple[Array, Array]:
    """Return some ratios of a range and the spectral radius of the loop at each, both (k,).

    No proof exists for a range with a ratio that is unstable while constant.
    """
    ratios = np.geomspace(min_ratio, max_ratio, N_CENTRES)
    return ratios, np.array([np.max(np.abs(np.linalg.eigvals(loop.closed_loop(ratio)[0]))) for ratio in ratios])


def _output_scales(loop: UncertainLoop, ratios: RatioSet, lag_periods: int, forces: ForcePoints | None = None) -> Array:
    """Return factors on v, q, q̇ T and a lag, by which errors count as the accelerations they cause."""
    scales = [1.0]
    stiffness = max([loop.half_slope.item(), *ratios.stiffness.tolist()])
    if forces is not None:
        stiffness, damping = max(stiffness, forces.units.stiffness), forces.units.damping / ratios.period
        return np.array([1.0, max(stiffness, 1.0), max(stiffness, damping, 1.0)])
    if stiffness > 0:
        scales.append(stiffness)
    if len(ratios.stiffness):
        damping = float(np.max(ratios.stiffness * ratios.lead_times)) / ratios.period
        scales = [1.0, max(stiffness, 1.0), max(stiffness, damping, 1.0)]
        scales += [max(float(np.max(ratios.stiffness * ratios.lags())), 1.0)] if lag_periods else []
    return np.array(scales)


def _fastest_decay(candidate: AffineCandidate, slowest: float) -> AffineProof | None:
    """Return the proof with the largest decay rate; None where balls do not prove any."""
    loop, ratios, matrices, multipliers = candidate
    for share in DECAY_SHARES:
        growth = float(np.exp(share * slowest))
        forms = decrease(loop, ratios, matrices, multipliers, growth)
        if definite_pieces(forms, ratios.min_ratio, ratios.max_ratio) is None:
            continue
        stored = loop.with_storage(error_growth(growth, ratios))
        if stored is None:
            continue
        proof = AffineProof(loop=stored, ratios=ratios, matrices=matrices, multipliers=multipliers, growth=growth)
        if proof.is_proven():
            return proof
    return None
