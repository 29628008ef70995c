"""The sector certificate: the largest slope of a time-varying robust term, and the largest gain that follows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels, require_inertia
from tarc.analysis.stability import UnstableMode, Witness, crossings, unstable_mode
from tarc.certificates.base import Certificate, Evidence, Judgement, LoopMatrices, Verdict, fastest_decay
from tarc.core import validation as check
from tarc.core.errors import UnsupportedLaw
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.tarc import TARC
from tarc.numerics.matrix_tests import schur_stability
from tarc.numerics.norms import hinf_norm


@dataclass(frozen=True, kw_only=True, eq=False)
class SectorEvidence(Evidence):
    """Loops from the auxiliary input to s = P2 e, and the slope of the robust term around them.

    Attributes
    ----------
    ratio
        ρ, the eigenvalue of M⁻¹M̂.
    max_slope
        Largest κ to certify, before multiplication by P2.
    period
        T [s].
    gain_is_bounded
        Whether the adaptive gain has a maximum; without one nothing is certified.
    loops
        A, B, C of each loop, closed as A − κ B C.
    circle_limit, frozen_limit
        Largest ‖P2‖ κ [1/s²] that the circle criterion admits, and up to which every constant κ leaves a stable loop;
        infinite if there is none. Like the rest, `judge` does not use them.
    max_gain
        Largest gain ĉ to certify [rad/s²]; None for none.
    slope_at_max_gain
        ‖P2‖ κ at that gain [1/s²].
    largest_max_gain
        Largest ``max_gain`` that the circle criterion admits, ε κ/α [rad/s²].
    decay_rate
        α [1/s]: errors decay as e^{−αt}; zero where none is proven, as for the largest slope that is admitted.
    """

    kind: ClassVar[str] = "sector"
    witness_type: ClassVar[type[Witness] | None] = UnstableMode

    ratio: float
    max_slope: float
    period: float
    gain_is_bounded: bool
    loops: tuple[LoopMatrices, ...]
    circle_limit: float
    frozen_limit: float
    max_gain: float | None = None
    slope_at_max_gain: float | None = None
    largest_max_gain: float | None = None
    decay_rate: float = 0.0

    def judge(self) -> Judgement:
        """Test constant slopes up to the largest, then the circle criterion."""
        kappa = self.max_slope
        for loop in self.loops:
            A, B, C = loop.A, loop.B, loop.C
            edges = [edge for edge in crossings(A, -B, C, 1e-9, 1e12) if edge < kappa] if B.shape[1] == 1 else []
            trials = {0.0, kappa, *((low + high) / 2 for low, high in pairwise([0.0, *edges, kappa]))}
            for trial in sorted(trials):
                verdict, radius, mode = schur_stability(A - trial * B @ C)
                if verdict == "refuted":
                    witness = replace(unstable_mode(radius, mode, self.period), slope=float(trial))
                    return Judgement(Verdict.REFUTED, 0.0, witness)
        bounded = self.gain_is_bounded and bool(self.loops)
        sound = bounded and self.decay_rate >= 0 and self.is_within_circle(np.exp(self.decay_rate * self.period))
        return Judgement(Verdict.CERTIFIED if sound else Verdict.INCONCLUSIVE, 0.0)

    def is_within_circle(self, growth: float) -> bool:
        """Return whether the circle criterion holds for states that grow by a factor in each period."""
        return all(_within_circle(growth * loop.A, growth * loop.B, loop.C, self.max_slope) for loop in self.loops)

    def with_decay(self) -> "SectorEvidence":
        """Return the evidence with the fastest decay that the circle criterion proves."""
        if not np.isfinite(self.max_slope):
            return self
        middle = [loop.A - self.max_slope / 2 * loop.B @ loop.C for loop in self.loops]
        spectral_radius = max(float(np.abs(np.linalg.eigvals(A)).max()) for A in middle)
        growth = fastest_decay(self.is_within_circle, spectral_radius)
        return replace(self, decay_rate=float(np.log(growth) / self.period))


def certify_sector(
    law: Law,
    ratio: float = 1.0,
    *,
    max_gain: float | None = None,
    computation_delay: int = 0,
    channels: Sequence[Channel] | None = None,
) -> Certificate[SectorEvidence]:
    """Certify the robust term Δu = −κ(t) s of a law, for one constant inertia ratio and any time-varying slope κ.

    Inside the boundary layer κ = α ĉ/ε, and outside it κ = α ĉ/‖s‖. Because ĉ adapts, κ is not constant but in a
    sector, 0 ≤ κ(t) ≤ k. With k/2 in the loop let S lead from the auxiliary input to s. By the circle criterion the
    loop is stable for all κ(t) if ‖S‖∞ < 2/k. Necessary is that each constant κ in [0, k] leaves the loop stable.

    Parameters
    ----------
    law
        A law with an inertia M̂. Without a P2 of its own, s is the error.
    ratio
        ρ, the eigenvalue of M⁻¹M̂.
    max_gain
        Largest gain ĉ [rad/s²] to certify; None for the law's own ``max_gain``.
    computation_delay
        Periods between a measurement and its torque.
    channels
        The loops of `tarc.analysis.linearise.decoupled_channels` for law and delay, where they exist already.

    Returns
    -------
    Certificate
        For the slope at the largest gain. The margin is the circle limit over that slope, less 1. Without a largest
        gain, the verdict is inconclusive for TARC, whose gain then has no bound. A law without a robust term is
        certified for the slope that the circle criterion admits.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia, and for a P2 that couples joints with different gains.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        For numbers out of range.

    References
    ----------
    Paper, Section II-B, equation (delta u); the circle criterion: H. K. Khalil, Nonlinear Systems, 3rd ed., 7.1.1.
    """
    law = require_inertia(law, "the sector certificate")
    ratio = check.number("ratio", ratio, 0, strict=True)
    adaptive = isinstance(law, TARC)
    max_gain = law.max_gain if isinstance(law, TARC) and max_gain is None else max_gain
    max_gain = None if max_gain is None else check.number("max_gain", max_gain, 0, strict=True)
    per_gain = law.gain_factor / law.boundary_layer if isinstance(law, TARC) else 1.0
    weight = law.P2 if isinstance(law, TARC) else np.eye(law.n_joints)
    size = float(np.linalg.norm(weight, 2))
    channels = decoupled_channels(law, computation_delay) if channels is None else channels
    loops = [_input_to_sliding(channel, ratio, weight) for channel in channels]
    circle = min(circle_limit(*loop) for loop in loops)
    frozen = min(frozen_limit(*loop) for loop in loops)
    slope = circle if max_gain is None else max_gain * per_gain
    evidence = SectorEvidence(
        ratio=ratio,
        max_slope=slope,
        period=law.period,
        gain_is_bounded=max_gain is not None or not adaptive,
        loops=tuple(LoopMatrices(*loop) for loop in loops),
        circle_limit=circle * size,
        frozen_limit=frozen * size,
        max_gain=max_gain,
        slope_at_max_gain=None if max_gain is None else slope * size,
        largest_max_gain=circle / per_gain if adaptive or max_gain is not None else None,
    )
    verdict, _, witness = evidence.judge()
    evidence = evidence.with_decay() if verdict == Verdict.CERTIFIED else evidence
    if isinstance(witness, UnstableMode) and witness.slope is not None and adaptive:
        witness = replace(witness, gain=witness.slope / per_gain)
    if max_gain is not None:
        scope = f"every gain ĉ(t) up to {max_gain:g} rad/s²"
    elif adaptive:
        scope = "every gain ĉ(t), which has no maximum,"
    else:
        scope = f"every time-varying slope up to {circle * size:.4g} 1/s²"
    return Certificate(
        claim=f"The loop of {type(law).__name__} around q̈ = {ratio:g} M̂⁻¹τ is stable for {scope}.",
        problem="‖S‖∞ < 2/k with k/2 in the loop, for k = α ĉ ‖P2‖/ε" if adaptive else "‖S‖∞ < 2/k, k/2 in the loop",
        verdict=verdict,
        margin=float(circle / slope - 1) if slope and evidence.gain_is_bounded else 0.0,
        margin_meaning="circle limit over the slope at the largest gain, less 1",
        assumptions=(
            "the robot's M(q)⁻¹M̂ is a constant multiple ρ of the identity; Coriolis, gravity and friction disturb only",
            "no torque limit is reached and no sample is lost",
            "H∞ norms are computed in floating point, to six digits from above",
            f"the torque reaches the joints {computation_delay} periods late and is held for a period",
        ),
        evidence=evidence,
        witness=witness,
    )


def _input_to_sliding(channel: Channel, ratio: float, weight: Array) -> tuple[Array, Array, Array]:
    """Return A, B, C from w, added to the auxiliary input, to s = P2 e1."""
    A, _, _, W, _ = channel.closed_loop(ratio)
    joints = channel.joints[: channel.n_coupled]
    own = weight[np.ix_(joints, joints)]
    coupling = np.delete(weight[list(channel.joints)], channel.joints, axis=1)
    if np.any(np.abs(coupling) > 1e-9 * np.abs(own).max()):
        raise UnsupportedLaw("law: its P2 couples joints whose gains do not; use the default lyapunov_weight Q")
    return A, W, own @ np.eye(channel.n_coupled, len(A))


def circle_limit(A: Array, B: Array, C: Array) -> float:
    """Return the largest k such that every w = −κ(t) y, 0 ≤ κ(t) ≤ k, leaves x⁺ = A x + B w, y = C x stable.

    1/k = −min_ω λ_min(He S(e^{jω})) is found on a grid that is refined. Then k is lowered until the norm with k/2 in
    the loop, which has a guarantee, is at most 2/k. Zero for an A that is not stable; infinite where S is positive
    real.
    """
    if schur_stability(A)[0] != "certified":
        return 0.0
    angles = np.concatenate([[0.0], np.geomspace(1e-6, np.pi, 200)])
    least = np.inf
    for _ in range(5):
        z = np.exp(1j * angles)[:, None, None]
        S = C @ np.linalg.solve(z * np.eye(len(A)) - A, B + 0 * z)
        real = np.linalg.eigvalsh((S + np.conj(np.swapaxes(S, 1, 2))) / 2)[:, 0]
        low = int(np.argmin(real))
        least = min(least, float(real[low]))
        angles = np.linspace(angles[max(low - 1, 0)], angles[min(low + 1, len(angles) - 1)], 21)
    if least >= 0:
        return np.inf
    k = -1 / least
    for _ in range(60):
        k *= 1 - 2e-6
        if _within_circle(A, B, C, k):
            return k
        k *= 0.999
    return 0.0


def _within_circle(A: Array, B: Array, C: Array, k: float) -> bool:
    """Return whether ‖S‖∞ ≤ 2/k with k/2 in the loop."""
    middle = A - k / 2 * B @ C
    if k <= 0:
        return False
    if schur_stability(middle)[0] != "certified":
        return False
    return hinf_norm(middle, B, C, np.zeros((len(C), B.shape[1])), 1e-7) <= 2 / k


def frozen_limit(A: Array, B: Array, C: Array) -> float:
    """Return the largest k such that every constant κ in [0, k] leaves A − κ B C stable; zero where A itself is not."""
    if np.max(np.abs(np.linalg.eigvals(A))) >= 1:
        return 0.0
    if B.shape[1] == 1:
        edges = [0.0, *crossings(A, -B, C, 1e-9, 1e12), np.inf]
        for low, high in pairwise(edges):
            middle = (low + min(high, 2 * low + 1)) / 2
            if np.max(np.abs(np.linalg.eigvals(A - middle * B @ C))) >= 1:
                return low
        return np.inf
    for trial in np.geomspace(1e-3, 1e9, 1201):  # coupled joints have no pencil; steps of two per cent
        if np.max(np.abs(np.linalg.eigvals(A - trial * B @ C))) >= 1:
            return float(trial)
    return np.inf
