"""The varying-ratio certificate: inertia mismatches of any direction that change at any time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, overload

import numpy as np

from tarc.analysis.linearise import (
    Channel,
    decoupled_channels,
    joints_share_loop,
    refuse_nominal_inertia,
    require_inertia,
)
from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop, scaled_system
from tarc.certificates.affine import certify_affine
from tarc.certificates.base import Certificate, Evidence, Judgement, Verdict, fastest_decay, require_held_torque
from tarc.certificates.iqc import CLOSE_RANGE, MIN_CHANGE, Multiplier, best_multiplier, iqc_matrices, satisfies_iqc
from tarc.core import validation as check
from tarc.core.errors import NoStableRatio, UnsupportedLaw
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.numerics.interval_minimum import minimise_in_interval
from tarc.numerics.matrix_tests import schur_stability
from tarc.numerics.norms import fdi_max_eigenvalue, hinf_norm, max_singular_values

NORM_TOLERANCE = 1e-6
"""Relative tolerance of the H∞ norm."""
FEW_FREQUENCIES = 150
"""Number of frequencies of the grid on which balls are compared, before the best ones are proven at all frequencies."""
RADIUS_REDUCTIONS = 0.0, 2e-5, 2e-4, 1e-3, 2e-3, 4e-3, 7e-3, 0.01, 0.03, 0.08, 0.2, 0.4
"""Shares by which a radius from a grid of frequencies is reduced until it is certified at all frequencies."""
DECAY_RADIUS_SHARE = 0.98
"""Share of the radius up to which a decay rate is proven where no range is to be contained."""
CENTRE_FACTORS = 0.94, 0.88, 0.82
"""Factors on the best centre of the grid, to try others."""
RATE_FACTORS = 1.0, 4.0, 16.0
"""Factors on the rate for which a multiplier is searched, until one is certified at all frequencies."""

RadiusProof = Multiplier | float | None
"""What proves a radius: a multiplier, the scale of the slope's block, or nothing where there is no slope."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ball:
    """Symmetric mismatches E with ‖E − ρ0 I‖ ≤ δ that a loop tolerates, and the proof.

    Attributes
    ----------
    loop
        The loop, opened at its inertia ratio.
    centre, radius
        ρ0 and δ.
    position_weight
        η, which multiplies the position beside v [1/s²]; zero without stiffness.
    stiffness
        Largest ‖[H, C/θ]‖ of the robot [1/s²].
    scale
        Scale of the slope's block; None without a slope, and with a multiplier.
    max_change
        Largest change of E⁻¹ in one period; None for any.
    multiplier
        Proof of the radius where the change is bounded.
    growth, decay_radius
        e^{αT} and the radius up to which errors decay as e^{−αt}; 1 and 0 where no decay rate α is proven.
    """

    loop: UncertainLoop
    centre: float
    radius: float
    position_weight: float = 0.0
    stiffness: float = 0.0
    scale: float | None = None
    max_change: float | None = None
    multiplier: Multiplier | None = None
    growth: float = 1.0
    decay_radius: float = 0.0

    @property
    def min_ratio(self) -> float:
        """Smallest inertia ratio in the ball."""
        return self.centre - self.radius

    @property
    def max_ratio(self) -> float:
        """Largest inertia ratio in the ball."""
        return self.centre + self.radius

    @property
    def ratio_spread(self) -> float:
        """Largest over smallest inertia ratio in the ball; infinite where the smallest is not above zero."""
        return self.max_ratio / self.min_ratio if self.min_ratio > 0 else np.inf

    def judge(self, needed_radius: float) -> Judgement:
        """Test the radius against the needed one, the loop at the centre, and the norm or the form of the ball."""
        multiplier = self.multiplier
        numbers = [self.centre, self.radius, needed_radius, self.position_weight, self.stiffness]
        numbers += [self.growth, self.decay_radius]
        numbers += [value for value in (self.scale, self.max_change) if value is not None]
        numbers += [] if multiplier is None else [multiplier.slope, multiplier.stiffness]
        if not np.all(np.isfinite(numbers)) or not self.centre > 0 or self.scale == 0:
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        margin = self.radius / self.centre
        if needed_radius:
            margin = self.radius / max(needed_radius, self.centre / 1e3) - 1
        proven = self.radius > 0 and self.radius >= needed_radius and self.is_proven(self.radius)
        if proven and self.growth != 1:
            decays = self.growth > 1 and 0 < self.decay_radius <= self.radius and needed_radius <= self.decay_radius
            proven = decays and self.is_proven(self.decay_radius, self.growth)
        return Judgement(Verdict.CERTIFIED if proven else Verdict.INCONCLUSIVE, float(margin))

    def with_decay(self, radius: float) -> "Ball":
        """Return the ball with the fastest decay that its proof shows up to a radius."""
        system = self.loop.closed_loop(self.centre, self.position_weight)
        spectral_radius = float(np.abs(np.linalg.eigvals(system[0])).max())
        if not 0 < radius <= self.radius:
            return self
        growth = fastest_decay(lambda growth: self.is_proven(radius, growth), spectral_radius)
        return replace(self, growth=growth, decay_radius=radius) if growth > 1 else self

    def is_proven(self, radius: float, growth: float = 1.0) -> bool:
        """Return whether the loop at the centre is stable, and the norm or the form shows a radius.

        With a growth g they show that errors decay as g^−k.
        """
        system = self.loop.closed_loop(self.centre, self.position_weight, growth)
        if schur_stability(system[0])[0] != "certified":
            return False
        if self.max_change is None:
            return hinf_norm(*scaled_system(system, radius, self.scale)) < 1
        if self.multiplier is None:
            return False
        return satisfies_iqc(
            self.loop,
            self.centre,
            radius,
            self.max_change,
            self.multiplier,
            self.position_weight,
            self.stiffness,
            growth,
        )

    def gains(self, angles: Array) -> Array:
        """Return what must stay below one at each angle ω [rad]: the weighted gain, or with a multiplier its form."""
        if self.max_change is not None and self.multiplier is not None:
            A, B, Q, S, R = iqc_matrices(
                self.loop,
                self.centre,
                self.radius,
                self.max_change,
                self.multiplier,
                self.position_weight,
                self.stiffness,
            )
            return 1 + fdi_max_eigenvalue(A, B, Q, S, R, angles)
        system = self.loop.closed_loop(self.centre, self.position_weight)
        return max_singular_values(*scaled_system(system, self.radius, self.scale), angles)


def make_ball(
    loop: UncertainLoop,
    centre: float,
    radius: float,
    proof: RadiusProof,
    *,
    position_weight: float = 0.0,
    stiffness: float = 0.0,
    max_change: float | None = None,
) -> Ball:
    """Return a ball with the proof that `max_radius` gave."""
    return Ball(
        loop=loop,
        centre=centre,
        radius=radius,
        position_weight=position_weight,
        stiffness=stiffness,
        scale=proof if isinstance(proof, float) else None,
        max_change=max_change,
        multiplier=proof if isinstance(proof, Multiplier) else None,
    )


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
        centre, proof, radius = _widest_ball(loop, max_change)
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
    centre, proof, radius = _widest_ball(loop, max_change)
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


def _widest_ball(loop: UncertainLoop, max_change: float | None) -> tuple[float, RadiusProof, float]:
    """Return centre, proof and radius of the ball with the largest quotient of its ends.

    The best centre on the grid of frequencies need not be the best at all frequencies, so others are tried.
    """
    centre = best_centre(loop, None, max_change)
    proof, radius = max_radius(loop, centre, max_change=max_change)
    for factor in CENTRE_FACTORS if max_change is not None else ():
        other_proof, other_radius = max_radius(loop, factor * centre, max_change=max_change)
        if other_radius > factor * radius:
            return factor * centre, other_proof, other_radius
    return centre, proof, radius


def max_radius(
    loop: UncertainLoop,
    centre: float,
    position_weight: float = 0.0,
    *,
    max_change: float | None = None,
    stiffness: float = 0.0,
) -> tuple[RadiusProof, float]:
    """Return the largest radius that is certified, zero for none, and its proof.

    Parameters
    ----------
    loop
        The loop.
    centre
        ρ0.
    position_weight
        η [1/s²].
    max_change
        Largest change of E⁻¹ in one period; None for any.
    stiffness
        Upper bound of the robot's ‖[H, C/θ]‖ [1/s²].
    """
    if max_change is None:
        return max_radius_any_rate(loop, centre, position_weight)
    best = Multiplier(np.zeros(0), np.zeros(0)), 0.0
    if schur_stability(loop.closed_loop(centre, position_weight)[0])[0] != "certified":
        return best
    responses = FrequencyResponses(loop, centre)
    for factor in RATE_FACTORS:
        searched_change = factor * max(max_change, MIN_CHANGE / centre)
        multiplier, radius, _ = best_multiplier(
            loop, centre, searched_change, position_weight=position_weight, stiffness=stiffness, responses=responses
        )
        for reduction in RADIUS_REDUCTIONS:
            trial = radius * (1 - reduction)
            if trial > best[1] and satisfies_iqc(
                loop, centre, trial, max_change, multiplier, position_weight, stiffness
            ):
                best = multiplier, trial
                break
        if best[1] > 0.998 * radius:
            break
    return best


def max_radius_any_rate(loop: UncertainLoop, centre: float, position_weight: float = 0.0) -> tuple[float | None, float]:
    """Return the scale of the slope's block, None without a slope, and the largest radius that is certified."""
    system = loop.closed_loop(centre, position_weight)
    has_slope = bool(loop.half_slope.item())
    if schur_stability(system[0])[0] != "certified":
        return (1.0 if has_slope else None), 0.0
    if not has_slope:
        return None, (1 - NORM_TOLERANCE) / hinf_norm(*system)
    scale, radius = FrequencyResponses(loop).best_scale(centre, position_weight)
    for reduction in RADIUS_REDUCTIONS[1:]:
        trial = radius * (1 - reduction)
        if trial > 0 and hinf_norm(*scaled_system(system, trial, scale)) < 1:
            return scale, trial
    return scale, 0.0


def best_centre(loop: UncertainLoop, ratio_range: tuple[float, float] | None, max_change: float | None = None) -> float:
    """Return the centre whose ball has the largest quotient of its ends, or contains a range with the largest margin.

    Raises
    ------
    NoStableRatio
        For a loop that is stable for no ratio, without a range.
    """
    responses = FrequencyResponses(loop) if max_change is None else FrequencyResponses(loop, count=FEW_FREQUENCIES)
    search = _CentreSearch(loop, responses, ratio_range)
    if ratio_range is None:
        best = search.refine(np.log(np.geomspace(1e-4, 10.0, 33)), None, 1e-4 if max_change is None else 2e-2)
        if search.value(best, None) <= NO_BALL:
            raise NoStableRatio(
                "varying ratio: no inertia ratio makes this loop stable; use a shorter window, a lower natural "
                "frequency, a smaller slope or less computation delay"
            )
        if max_change is not None:  # with a rate the best centre is a little higher
            best = search.refine(best + np.log([0.8, 1.0, 1.25, 1.5, 1.8]), max_change, 1e-2)
        return float(np.exp(best))
    low, high = ratio_range
    tolerance = 1e-4 if max_change is None else 2e-2
    best = search.refine(np.log(np.linspace(low, high, 9) if high > low else np.array([low])), None, tolerance)
    if max_change is not None:
        best = search.refine(np.sort([best, np.log((low + high) / 2)]), max_change, 1e-2)
    return float(np.exp(best))


NO_BALL = 1e-3
"""Radius over centre up to which a ball counts as none, such as rounding leaves for a mode on the unit circle."""


class _CentreSearch(NamedTuple):
    """Search for the best centre, over its logarithm."""

    loop: UncertainLoop
    responses: FrequencyResponses
    ratio_range: tuple[float, float] | None

    def value(self, log_centre: float, max_change: float | None, least: float = 0.0) -> float:
        """Return the radius over the centre, or over the radius that contains the range; negative if unstable.

        The search for it ends where it cannot become the ``least``.
        """
        centre = float(np.exp(log_centre))
        spectral_radius = float(np.max(np.abs(np.linalg.eigvals(self.loop.closed_loop(centre)[0]))))
        if spectral_radius >= 1:
            return -spectral_radius
        needed = centre if self.ratio_range is None else self._needed_radius(centre, *self.ratio_range)
        if max_change is None:
            return self.responses.best_scale(centre)[1] / needed
        options = {"responses": self.responses, "least": least * needed, "close": CLOSE_RANGE}
        return best_multiplier(self.loop, centre, max_change, **options)[1] / needed

    @staticmethod
    def _needed_radius(centre: float, low: float, high: float) -> float:
        return max(high - centre, centre - low, 1e-12)

    def refine(self, log_centres: Array, max_change: float | None, tolerance: float) -> float:
        """Return the best of some log centres, refined between its neighbours."""
        values: list[float] = []
        for log_centre in log_centres:
            values.append(self.value(log_centre, max_change, least=max(values, default=0.0)))
        top = int(np.argmax(values))
        ends = log_centres[max(top - 1, 0)], log_centres[min(top + 1, len(log_centres) - 1)]
        if ends[0] == ends[1] or values[top] <= NO_BALL:
            return log_centres[top]
        refined, negative = minimise_in_interval(
            lambda log_centre: -self.value(log_centre, max_change), *ends, tolerance
        )
        return refined if -negative > values[top] else log_centres[top]
