"""The constant-ratio certificate: stability of the law's own code around q̈ = ρ M̂⁻¹ τ, for one ρ or a range."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.analysis.stability import (
    UnstableMode,
    Witness,
    crossings,
    delay_margin,
    disturbance_to_error,
    noise_to_torque,
    open_loop_matrices,
    spectral_radius,
    unstable_mode,
)
from tarc.certificates.base import (
    Certificate,
    Evidence,
    Judgement,
    LoopMatrices,
    Verdict,
    fastest_decay,
    require_held_torque,
)
from tarc.core import validation as check
from tarc.laws.base import Law
from tarc.numerics.matrix_tests import schur_stability
from tarc.numerics.norms import h2_norm, hinf_norm


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopFindings:
    """Rates and gains of the loop at the end of the range with the larger spectral radius; not part of the proof.

    Attributes
    ----------
    spectral_radius
        Largest magnitude of an eigenvalue.
    decay_rate
        −ln |z| / T of the slowest mode [1/s].
    ringing_frequency
        |arg z| / T of the slowest mode [rad/s].
    delay_margin
        Further computation delay with which the loop is stable [periods]; None where it is not certified, like the
        attributes below.
    disturbance_to_error_hinf, disturbance_to_error_h2
        Gain from a disturbing acceleration to the error, largest and for white noise [s²].
    noise_to_torque_hinf, noise_to_torque_h2
        Gain from measurement noise to M̂⁻¹τ, largest and for white noise [1/s²].
    """

    spectral_radius: float
    decay_rate: float
    ringing_frequency: float
    delay_margin: int | None = None
    disturbance_to_error_hinf: float | None = None
    disturbance_to_error_h2: float | None = None
    noise_to_torque_hinf: float | None = None
    noise_to_torque_h2: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstantRatioEvidence(Evidence):
    """Loops of a law, stable for every constant ratio of a range.

    Attributes
    ----------
    min_ratio, max_ratio
        Ends of the range of ρ.
    period
        T [s].
    gain
        Frozen switching gain ĉ [rad/s²].
    loops
        A, B, C of each loop, closed as A + ρ B C.
    findings
        Rates and gains, which `judge` does not use.
    decay_rate
        α [1/s]: errors decay as e^{−αt} for every ratio of the range; zero where none is proven.
    """

    kind: ClassVar[str] = "constant_ratio"
    witness_type: ClassVar[type[Witness] | None] = UnstableMode

    min_ratio: float
    max_ratio: float
    period: float
    gain: float
    loops: tuple[LoopMatrices, ...]
    findings: LoopFindings
    decay_rate: float = 0.0

    def judge(self) -> Judgement:
        """Test every loop at both ends of the range and between the crossings of the unit circle in it."""
        verdict, margin = Verdict.CERTIFIED, np.inf
        for loop in self.loops:
            require_held_torque(loop.A, loop.B, self.period)
            judged = _judge_loop(loop, self.min_ratio, self.max_ratio, self.period)
            margin = min(margin, judged.margin)
            if judged.verdict == Verdict.REFUTED:
                return Judgement(Verdict.REFUTED, margin, judged.witness)
            if judged.verdict == Verdict.INCONCLUSIVE:
                verdict = Verdict.INCONCLUSIVE
        if not self.loops or not self.decay_rate >= 0:
            verdict = Verdict.INCONCLUSIVE
        if verdict == Verdict.CERTIFIED and self.decay_rate and not self.decays(np.exp(self.decay_rate * self.period)):
            verdict = Verdict.INCONCLUSIVE
        return Judgement(verdict, float(margin))

    def decays(self, growth: float) -> bool:
        """Return whether errors shrink by more than a factor in each period, for every ratio of the range."""
        grown = [LoopMatrices(growth * loop.A, growth * loop.B, loop.C) for loop in self.loops]
        judgements = [_judge_loop(loop, self.min_ratio, self.max_ratio, self.period) for loop in grown]
        return all(judgement.verdict == Verdict.CERTIFIED for judgement in judgements)


def certify_constant_ratio(
    law: Law,
    ratio: float | tuple[float, float] = 1.0,
    *,
    computation_delay: int = 0,
    gain: float = 0.0,
    channels: Sequence[Channel] | None = None,
) -> Certificate[ConstantRatioEvidence]:
    """Certify the loop of a law for a constant inertia ratio.

    The plant is q̈ = ρ M̂⁻¹ τ under zero-order hold. The controller is the Jacobian of the function that is simulated,
    with the switching gain frozen. For that linear time-invariant loop the test is exact.

    Parameters
    ----------
    law
        A law with an inertia M̂.
    ratio
        ρ, the eigenvalue of M⁻¹M̂; a pair for every constant ρ in a range.
    computation_delay
        Periods between a measurement and its torque.
    gain
        Frozen switching gain ĉ [rad/s²].
    channels
        The loops of `tarc.analysis.linearise.decoupled_channels` for these arguments, where they exist already.

    Returns
    -------
    Certificate
        Its margin is 1 less the largest spectral radius at the ends of the range. `LoopFindings` describes the loop at
        the end with the larger one.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia; for a range of ratios also where the gains couple the joints.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        For ratios that are not positive, and for a negative delay or gain.
    """
    low, high = (ratio, ratio) if np.ndim(ratio) == 0 else tuple(np.ravel(ratio))
    low = check.number("ratio", low, 0, strict=True)
    high = check.number("ratio", high, low)
    channels = decoupled_channels(law, computation_delay, gain) if channels is None else channels
    loops = tuple(LoopMatrices(*open_loop_matrices(channel)) for channel in channels)
    worst = low if low == high else max((low, high), key=lambda end: spectral_radius(channels, end))
    evidence = ConstantRatioEvidence(
        min_ratio=low,
        max_ratio=high,
        period=law.period,
        gain=gain,
        loops=loops,
        findings=_describe(channels, worst, stable=False),
    )
    verdict, margin, witness = evidence.judge()
    if verdict == Verdict.CERTIFIED:
        growth = fastest_decay(evidence.decays, spectral_radius(channels, worst))
        evidence = replace(
            evidence,
            findings=_describe(channels, worst, stable=True),
            decay_rate=float(np.log(growth) / law.period),
        )
    span = f"ρ = {low:g}" if low == high else f"every constant ρ from {low:g} to {high:g}"
    return Certificate(
        claim=f"The loop of {type(law).__name__} around q̈ = ρ M̂⁻¹τ is stable for {span}.",
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the largest spectral radius at the ends",
        assumptions=(
            "the robot's M(q)⁻¹M̂ is a constant multiple ρ of the identity; Coriolis, gravity and friction disturb only",
            "no torque limit is reached and no sample is lost",
            f"the switching gain is frozen at {gain:g} rad/s² and the error inside its boundary layer"
            if gain
            else "the switching gain is zero",
            "eigenvalues are computed in floating point, with an allowance for rounding",
            f"the torque reaches the joints {computation_delay} periods late and is held for a period",
        ),
        evidence=evidence,
        witness=witness,
    )


def _judge_loop(loop: LoopMatrices, low: float, high: float, period: float) -> Judgement:
    """Test one loop at both ends of the range and between every two crossings of the unit circle in it."""
    A, b, c = loop.A, loop.B, loop.C
    verdict, margin, trials = Verdict.CERTIFIED, np.inf, {low, high}
    if low < high:
        inner = [edge for edge in crossings(A, b, c) if low < edge < high]
        trials |= {(first + second) / 2 for first, second in pairwise([low, *inner, high])}
        trials |= set(np.geomspace(low, high, 8)[1:-1].tolist())
    for trial in sorted(trials):
        outcome, radius, mode = schur_stability(A + trial * b @ c)
        if trial in (low, high):
            margin = min(margin, 1 - radius)
        if outcome == "refuted":
            witness = replace(unstable_mode(radius, mode, period), ratio=float(trial))
            return Judgement(Verdict.REFUTED, min(margin, 1 - radius), witness)
        if outcome == "inconclusive":
            verdict = Verdict.INCONCLUSIVE
    return Judgement(verdict, margin)


def _describe(channels: Sequence[Channel], ratio: float, *, stable: bool) -> LoopFindings:
    """Return rates, delay margin and gains of the loop at one ratio."""
    values = np.concatenate([np.linalg.eigvals(channel.state_matrix(ratio)) for channel in channels])
    lead = values[np.argmax(np.abs(values))]
    period = channels[0].period
    findings = LoopFindings(
        spectral_radius=float(abs(lead)),
        decay_rate=float(-np.log(abs(lead)) / period),
        ringing_frequency=float(abs(np.angle(lead)) / period),
    )
    if not stable:
        return findings
    disturbed = [disturbance_to_error(channel, ratio) for channel in channels]
    noisy = [noise_to_torque(channel, ratio) for channel in channels]
    return replace(
        findings,
        delay_margin=min(delay_margin(channel, ratio) for channel in channels),
        disturbance_to_error_hinf=max(hinf_norm(*system) for system in disturbed),
        disturbance_to_error_h2=max(h2_norm(*system) for system in disturbed),
        noise_to_torque_hinf=max(hinf_norm(*system) for system in noisy),
        noise_to_torque_h2=max(h2_norm(*system) for system in noisy),
    )
