"""The varying-ratio certificate: inertia mismatches of any direction that change at any time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, overload

import numpy as np

from tarc.analysis.linearise import (
    Channel,
    decoupled_channels,
    joints_share_loop,
    refuse_nominal_inertia,
    require_inertia,
)
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.certificates.affine import certify_affine
from tarc.certificates.ball import Ball, make_ball
from tarc.certificates.ball_centre import best_ball, best_centre
from tarc.certificates.ball_radius import max_radius
from tarc.certificates.base import Certificate, Evidence, Judgement, Verdict, require_held_torque
from tarc.core import validation as check
from tarc.core.errors import UnsupportedLaw
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement

DECAY_RADIUS_SHARE = 0.98
"""Share of the radius up to which a decay rate is proven where no range is to be contained."""


@dataclass(frozen=True, kw_only=True, eq=False)
class VaryingRatioEvidence(Evidence):
    """A ball of inertia mismatches that a loop tolerates.

    Attributes
    ----------
    ball
        The ball, with its proof.
    needed_radius
        Radius that contains the range to certify; zero where there is none.
    slope
        Largest slope of the robust term [1/s²].
    period
        T [s].
    """

    kind: ClassVar[str] = "varying_ratio"

    ball: Ball
    needed_radius: float
    slope: float
    period: float

    @property
    def centre(self) -> float:
        """ρ0."""
        return self.ball.centre

    @property
    def radius(self) -> float:
        """δ."""
        return self.ball.radius

    @property
    def min_ratio(self) -> float:
        """Smallest inertia ratio in the ball."""
        return self.ball.min_ratio

    @property
    def max_ratio(self) -> float:
        """Largest inertia ratio in the ball."""
        return self.ball.max_ratio

    @property
    def ratio_spread(self) -> float:
        """Largest over smallest inertia ratio in the ball; infinite where the smallest is not above zero."""
        return self.ball.ratio_spread

    @property
    def rate(self) -> float | None:
        """Largest ‖dE⁻¹/dt‖ [1/s]; None for any."""
        return None if self.ball.max_change is None else self.ball.max_change / self.period

    @property
    def decay_rate(self) -> float:
        """α [1/s]: errors decay as e^{−αt} for mismatches up to the ball's ``decay_radius``; zero for none."""
        return float(np.log(self.ball.growth) / self.period)

    def judge(self) -> Judgement:
        """Judge the ball against the radius needed and the slope."""
        loop = self.ball.loop
        require_held_torque(loop.A, loop.B, self.period, loop.B_mismatch)
        judgement = self.ball.judge(self.needed_radius)
        has_slope = self.slope <= 2 * self.ball.loop.half_slope.item()
        return judgement if has_slope else judgement._replace(verdict=Verdict.INCONCLUSIVE)


@overload
def certify_varying_ratio(
    law: Law,
    centre: float | None = None,
    *,
    ratio_range: None = None,
    slope: float = 0.0,
    rate: float | None = None,
    intersample: bool = True,
    computation_delay: int = 0,
    channels: Sequence[Channel] | None = None,
    affine: bool = True,
) -> Certificate[VaryingRatioEvidence]: ...


@overload
def certify_varying_ratio(
    law: Law,
    centre: float | None = None,
    *,
    ratio_range: tuple[float, float] | None,
    slope: float = 0.0,
    rate: float | None = None,
    intersample: bool = True,
    computation_delay: int = 0,
    channels: Sequence[Channel] | None = None,
    affine: bool = True,
) -> Certificate[Any]: ...


def certify_varying_ratio(
    law: Law,
    centre: float | None = None,
    *,
    ratio_range: tuple[float, float] | None = None,
    slope: float = 0.0,
    rate: float | None = None,
    intersample: bool = True,
    computation_delay: int = 0,
    channels: Sequence[Channel] | None = None,
    affine: bool = True,
) -> Certificate[Any]:
    """Certify the loop for every time-varying inertia ratio in a ball, in any number of joints at the cost of one.

    In coordinates M̂^½ q the joints' loops are identical and the mismatch is the symmetric E(q) = M̂^½ M(q)⁻¹ M̂^½. By
    the small-gain theorem the loop is stable for every E(t) with

        ‖E − ρ0 I‖ ≤ δ < 1/‖T‖∞,

    T the loop at ρ0 from an acceleration to v = M̂⁻¹τ. So a robot is covered if the eigenvalues of M(q)⁻¹M̂ lie in
    [ρ0 − δ, ρ0 + δ]. With a slope, the robust term −κ(t) s, 0 ≤ κ(t) ‖P2‖ ≤ slope, varies as well. Half of it is then
    in the loop, and half in a second block of the mismatch. A constant scale between the two blocks is searched for.

    This holds for any rate of E, and no larger ball does. With a rate it holds for ‖dE⁻¹/dt‖ up to it, and the ball is
    larger; E⁻¹ = M̂^−½ M M̂^−½. The proof adds that E is symmetric and slow. With b = E v and any y_m,

        2 Σ_k Σ_m y_m (v_{k+m}ᵀ b_k − v_kᵀ b_{k+m}) ≥ −2 Σ_m |y_m| m T rate Σ_k ‖b_k‖².

    Such y_m, a sum of exponentials, are searched for by linear programming. The loop at ρ0 is stable, and E is reached
    from there along E_τ⁻¹ = (1 − τ)/ρ0 + τ E⁻¹, 0 ≤ τ ≤ 1, on which the inequalities hold.

    Parameters
    ----------
    law
        A law with an inertia M̂ and with scalar K1, K2 and P2.
    centre
        ρ0; None for the one that makes (ρ0 + δ)/(ρ0 − δ) largest.
    ratio_range
        Instead of a centre: the range of ratios that the ball must contain with the largest margin.
    slope
        Largest slope of the robust term [1/s²]; α ĉ ‖P2‖/ε for TARC.
    rate
        Largest ‖dE⁻¹/dt‖ = ‖M̂^−½ (dM/dt) M̂^−½‖ [1/s]; None for any.
    intersample
        Whether E may change within a period (the lifted norm); else it is constant over each period.
    computation_delay
        Periods between a measurement and its torque.
    channels
        The loops of `tarc.analysis.linearise.decoupled_channels` for law and delay, where they exist already.
    affine
        Where no ball contains a range at a rate, try `tarc.certificates.certify_affine`, which takes seconds.

    Returns
    -------
    Certificate
        That of `certify_affine`, kind ``affine``, where it alone holds. Otherwise certified for every ball of a radius
        above zero. With ``ratio_range`` it is certified only if the ball contains the range, else inconclusive. The
        margin is the radius over the needed one, less 1; without ``ratio_range`` it is the radius over the centre.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia, and for gains that are not scalar.
    NoStableRatio
        For a loop that is stable for no ratio, where neither centre nor range are given.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        For numbers out of range.

    References
    ----------
    The small-gain theorem: G. Zames, IEEE Trans. Autom. Control 11(2), 1966. Lifting: B. Bamieh and J. B. Pearson,
    IEEE Trans. Autom. Control 37(4), 1992. Integral quadratic constraints, by which the two inequalities may be added:
    A. Megretski and A. Rantzer, IEEE Trans. Autom. Control 42(6), 1997.
    """
    slope = check.number("slope", slope, 0)
    if ratio_range is not None:
        low = check.number("ratio_range", ratio_range[0], 0, strict=True)
        ratio_range = low, check.number("ratio_range", ratio_range[1], low)
    law, channels = _shared_loop(law, computation_delay, channels)
    loop = UncertainLoop.from_channel(channels[0], slope, intersample)
    max_change = None if rate is None else law.period * check.number("rate", rate, 0)
    if centre is None and ratio_range is None:
        centre, proof, radius = best_ball(loop, max_change)
    else:
        centre = best_centre(loop, ratio_range, max_change) if centre is None else centre
        centre = check.number("centre", centre, 0, strict=True)
        proof, radius = max_radius(loop, centre, max_change=max_change)
    needed_radius = 0.0 if ratio_range is None else max(ratio_range[1] - centre, centre - ratio_range[0])
    ball = make_ball(loop, centre, radius, proof, max_change=max_change)
    ball = ball.with_decay(needed_radius or DECAY_RADIUS_SHARE * radius)
    evidence = VaryingRatioEvidence(
        ball=ball,
        needed_radius=needed_radius,
        slope=slope,
        period=law.period,
    )
    verdict, margin, _ = evidence.judge()
    if affine and ratio_range is not None and rate is not None and verdict != Verdict.CERTIFIED:
        options = {"slope": slope, "intersample": intersample, "computation_delay": computation_delay}
        by_lyapunov = certify_affine(law, ratio_range, rate, channels=channels, **options)
        if by_lyapunov.certified:
            return by_lyapunov
    low, high = ratio_range or (centre - radius, centre + radius)
    limit = "" if rate is None else f", E⁻¹ changing by at most {rate:.5g} 1/s"
    return Certificate(
        claim=f"The loop of {type(law).__name__} around q̈ = E(t) M̂⁻¹τ is stable for every symmetric E(t) with "
        f"eigenvalues from {low:.5g} to {high:.5g}{limit}.",
        problem=_problem(bool(slope), rate is not None),
        verdict=verdict,
        margin=margin,
        margin_meaning="radius over the centre" if ratio_range is None else "radius over the one needed, less 1",
        assumptions=_assumptions(ball, slope, rate, intersample, computation_delay),
        evidence=evidence,
    )


def widest_ball(
    law: Law,
    *,
    slope: float = 0.0,
    rate: float | None = None,
    computation_delay: int = 0,
    channels: Sequence[Channel] | None = None,
) -> Ball:
    """Return the ball of `certify_varying_ratio` without a range, with neither a decay rate nor a verdict.

    Parameters
    ----------
    law, slope, rate, computation_delay, channels
        As for `certify_varying_ratio`.

    Raises
    ------
    UnsupportedLaw, NoStableRatio, NotLinearisable, InvalidParameter
        As `certify_varying_ratio` does.
    """
    law, channels = _shared_loop(law, computation_delay, channels)
    loop = UncertainLoop.from_channel(channels[0], check.number("slope", slope, 0), intersample=True)
    max_change = None if rate is None else law.period * check.number("rate", rate, 0)
    centre, proof, radius = best_ball(loop, max_change)
    return make_ball(loop, centre, radius, proof, max_change=max_change)


def _shared_loop(
    law: Law, computation_delay: int, channels: Sequence[Channel] | None
) -> tuple[PolePlacement, Sequence[Channel]]:
    """Return a law with its M̂ and its loops, or refuse one whose joints do not share a loop."""
    checked = require_inertia(law, "the varying-ratio certificate")
    refuse_nominal_inertia(checked, "the varying-ratio certificate")
    channels = decoupled_channels(checked, computation_delay) if channels is None else channels
    if not joints_share_loop(checked):
        raise UnsupportedLaw(
            "law: the joints' gains differ or are coupled, and the varying-ratio certificate needs the same on every "
            "joint; give one natural frequency and one damping ratio for all"
        )
    return checked, channels


def _assumptions(
    ball: Ball, slope: float, rate: float | None, intersample: bool, computation_delay: int
) -> tuple[str, ...]:
    """Return what the verdict takes for granted."""
    low, high = ball.centre - ball.decay_radius, ball.centre + ball.decay_radius
    changes = "E changes at any time" if intersample else "E is constant within each period"
    robust_term = "there is no robust term"
    if slope:
        robust_term = f"the robust term is a slope between 0 and {slope:g} 1/s², which changes at any time"
    return (
        changes if rate is None else f"{changes}, E⁻¹ at no more than {rate:.4g} 1/s",
        robust_term,
        "the same gains, window, period and delay on every joint; no torque limit is reached, no sample is lost",
        "Coriolis forces, gravity and friction are only disturbances",
        "H∞ norms are computed in floating point, to six digits from above",
        f"the decay rate is that of eigenvalues from {low:.5g} to {high:.5g}"
        if ball.decay_radius
        else "no decay rate is proven",
        f"the torque reaches the joints {computation_delay} periods late and is held for a period",
    )


def _problem(has_slope: bool, has_rate: bool) -> str:
    """Return the tested condition as a formula."""
    if has_rate:
        form = "δ²|T|² + 2 Σ|y_m| m T rate |1 + ρ0 T|² − 4 Σ y_m sin(mω) Im T < 1"
        return f"{form}, with the slope's inequality" if has_slope else form
    return "‖[δ T_vv, d δ T_vs; T_sv k/2d, T_ss k/2]‖∞ < 1, k/2 in the loop" if has_slope else "‖T‖∞ δ < 1"
