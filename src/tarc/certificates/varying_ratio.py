"""The robust ball: how far the inertia may be off, in any direction and changing at any time."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tarc.analysis.linearise import decoupled_channels, joints_share_loop
from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop, scaled_system
from tarc.certificates.base import Certificate, Evidence, Judgement, Verdict
from tarc.certificates.iqc import MIN_CHANGE, Multiplier, best_multiplier, iqc_matrices, satisfies_iqc
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.numerics.matrix_tests import schur_stability
from tarc.numerics.norms import fdi_max_eigenvalue, hinf_norm, max_singular_values

NORM_TOLERANCE = 1e-6


RadiusProof = Multiplier | float | None
"""What shows a radius: a multiplier, or the scale of the slope's block, or nothing where there is no slope."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ball:
    """Symmetric mismatches E with ‖E − ρ0 I‖ ≤ δ that a loop tolerates, and what shows it.

    Attributes
    ----------
    loop
        The loop, opened at its inertia ratio.
    centre, radius
        ρ0 and δ.
    weight
        η of the position beside v [1/s²]; zero without stiffness.
    stiffness
        Largest ‖[H, C/θ]‖ of the robot [1/s²].
    scale
        Scale of the slope's block; None without a slope, and with a multiplier.
    step
        Largest change of E⁻¹ in one period; None for any.
    multiplier
        What shows the radius where the change is bounded.
    """

    loop: UncertainLoop
    centre: float
    radius: float
    weight: float = 0.0
    stiffness: float = 0.0
    scale: float | None = None
    step: float | None = None
    multiplier: Multiplier | None = None

    @property
    def min_ratio(self) -> float:
        """Smallest inertia ratio in the ball."""
        return self.centre - self.radius

    @property
    def max_ratio(self) -> float:
        """Largest inertia ratio in the ball."""
        return self.centre + self.radius

    def judge(self, needed_radius: float) -> Judgement:
        """Test the radius against the one needed, the loop at the centre, and the norm or the form of the ball."""
        multiplier = self.multiplier
        numbers = [self.centre, self.radius, needed_radius, self.weight, self.stiffness]
        numbers += [value for value in (self.scale, self.step) if value is not None]
        numbers += [] if multiplier is None else [multiplier.slope, multiplier.stiffness]
        if not np.all(np.isfinite(numbers)) or not self.centre > 0 or self.scale == 0:
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        loop = self.loop.closed_loop(self.centre, self.weight)
        margin = self.radius / self.centre
        if needed_radius:
            margin = self.radius / max(needed_radius, self.centre / 1e3) - 1
        sound = self.radius > 0 and self.radius >= needed_radius and schur_stability(loop[0])[0] == "certified"
        if self.step is None:
            sound = sound and hinf_norm(*scaled_system(loop, self.radius, self.scale)) < 1
        else:
            sound = sound and multiplier is not None and self._satisfies_iqc(multiplier)
        return Judgement(Verdict.CERTIFIED if sound else Verdict.INCONCLUSIVE, float(margin))

    def _satisfies_iqc(self, multiplier: Multiplier) -> bool:
        step = 0.0 if self.step is None else self.step
        return satisfies_iqc(self.loop, self.centre, self.radius, step, multiplier, self.weight, self.stiffness)

    def gains(self, angles: Array) -> Array:
        """Return what must stay below one at each angle ω [rad]: the weighted gain, or with a multiplier its form."""
        if self.step is not None and self.multiplier is not None:
            A, B, Q, S, R = iqc_matrices(
                self.loop, self.centre, self.radius, self.step, self.multiplier, self.weight, self.stiffness
            )
            return 1 + fdi_max_eigenvalue(A, B, Q, S, R, angles)
        loop = self.loop.closed_loop(self.centre, self.weight)
        return max_singular_values(*scaled_system(loop, self.radius, self.scale), angles)


def make_ball(
    loop: UncertainLoop,
    centre: float,
    radius: float,
    shown: RadiusProof,
    *,
    weight: float = 0.0,
    stiffness: float = 0.0,
    step: float | None = None,
) -> Ball:
    """Return a ball with what `widest` gave to show it."""
    multiplier = shown if isinstance(shown, Multiplier) else None
    scale = None if multiplier is not None or shown is None else float(shown)  # pyright: ignore[reportArgumentType]
    return Ball(
        loop=loop,
        centre=centre,
        radius=radius,
        weight=weight,
        stiffness=stiffness,
        scale=scale,
        step=step,
        multiplier=multiplier,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class VaryingRatioEvidence(Evidence):
    """A ball of inertia mismatches that a loop tolerates.

    Attributes
    ----------
    ball
        The ball, and what shows it.
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
        """Largest by smallest inertia ratio in the ball; infinite where the smallest is not above zero."""
        return self.max_ratio / self.min_ratio if self.min_ratio > 0 else np.inf

    @property
    def rate(self) -> float | None:
        """Largest ‖dE⁻¹/dt‖ [1/s]; None for any."""
        return None if self.ball.step is None else self.ball.step / self.period

    def judge(self) -> Judgement:
        """Judge the ball against the radius needed."""
        return self.ball.judge(self.needed_radius)


def certify_varying_ratio(
    law: Law,
    centre: float | None = None,
    *,
    ratio_range: tuple[float, float] | None = None,
    slope: float = 0.0,
    rate: float | None = None,
    intersample: bool = True,
    computation_delay: int = 0,
) -> Certificate[VaryingRatioEvidence]:
    """Certify the loop for every time-varying inertia ratio in a ball, in any number of joints at the cost of one.

    In coordinates M̂^½ q the joints' loops are identical and the mismatch is the symmetric E(q) = M̂^½ M(q)⁻¹ M̂^½. By
    the small-gain theorem the loop is stable for every E(t) with

        ‖E − ρ0 I‖ ≤ δ < 1/‖T‖∞,

    T the loop at ρ0 from an acceleration to v = M̂⁻¹τ. So the robot fits if the eigenvalues of M(q)⁻¹M̂ lie in
    [ρ0 − δ, ρ0 + δ]. With a slope, the robust term −κ(t) s, 0 ≤ κ(t) ‖P2‖ ≤ slope, varies at the same time: half of
    it goes into the loop, the other half into a second block of the mismatch, and a constant scaling between the two
    blocks is searched for.

    That holds however fast E changes, and no larger ball would then. The inertia of a robot changes as fast as the
    robot moves: with a rate, for ‖dE⁻¹/dt‖ up to it, E⁻¹ = M̂^−½ M M̂^−½, the ball is larger. What is added is that E
    is symmetric and slow: with b = E v and any y_m, 2 Σ_k Σ_m y_m (v_{k+m}ᵀ b_k − v_kᵀ b_{k+m}) is at least
    −2 Σ_m |y_m| m T rate Σ_k ‖b_k‖². Such y_m, a sum of exponentials, are searched for by linear programming. From the
    loop at ρ0, which is stable, E comes about along E_τ⁻¹ = (1 − τ)/ρ0 + τ E⁻¹, 0 ≤ τ ≤ 1, on which all of this holds.

    Parameters
    ----------
    law
        A law on time-delay estimation with scalar K1, K2 and P2.
    centre
        ρ0; None for the one that makes (ρ0 + δ)/(ρ0 − δ) largest.
    contains
        Instead of a centre: the range of ratios that the ball is to hold with the most room.
    slope
        Largest slope of the robust term [1/s²]; α ĉ ‖P2‖/ε for TARC.
    rate
        Greatest ‖dE⁻¹/dt‖ = ‖M̂^−½ (dM/dt) M̂^−½‖ [1/s]; None for any.
    intersample
        Let E change within a period too (the lifted norm); False holds it constant over each period.
    computation_delay
        Periods between a measurement and its torque.

    Returns
    -------
    Certificate
        Certified for every ball of a radius above zero; with ``contains`` only if the ball contains the range, and
        inconclusive if not. The margin is the radius over the one that is needed, less 1; without ``contains`` it is
        the radius over the centre.

    Raises
    ------
    TarcError
        For gains that are not scalar, numbers out of range, a loop that is stable for no ratio.

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
    channels = decoupled_channels(law, computation_delay)
    if not joints_share_loop(law):
        raise TarcError(
            "ball: the joints' gains differ or couple, and the ball needs the same on every joint; give one "
            "natural frequency "
            "and one damping for all"
        )
    parts = UncertainLoop.from_channel(channels[0], slope, intersample)
    step = None if rate is None else law.period * check.number("rate", rate, 0)
    free = centre is None and ratio_range is None and step is not None
    centre = check.number("centre", best_centre(parts, ratio_range, step) if centre is None else centre, 0, strict=True)
    shown, radius = max_radius(parts, centre, step=step)
    for factor in CENTRE_FACTORS if free else ():  # the best on the grid of frequencies need not be the best on all
        trial = max_radius(parts, factor * centre, step=step)
        if trial[1] > factor * radius:
            centre, (shown, radius) = factor * centre, trial
            break
    evidence = VaryingRatioEvidence(
        ball=make_ball(parts, centre, radius, shown, step=step),
        needed_radius=0.0 if ratio_range is None else max(ratio_range[1] - centre, centre - ratio_range[0]),
        slope=slope,
        period=law.period,
    )
    verdict, margin, _ = evidence.judge()
    ends = ratio_range or (centre - radius, centre + radius)
    name = type(law).__name__
    return Certificate(
        claim=f"The loop of {name} around q̈ = E(t) M̂⁻¹τ is stable for every symmetric E(t) with eigenvalues from "
        f"{ends[0]:.5g} to {ends[1]:.5g}" + ("." if rate is None else f", E⁻¹ changing by at most {rate:.5g} 1/s."),
        problem=_problem(bool(slope), rate is not None),
        verdict=verdict,
        margin=margin,
        margin_meaning="radius over the centre" if ratio_range is None else "radius over the one needed, less 1",
        assumptions=(
            ("E changes at any time" if intersample else "E is constant within each period")
            + ("" if rate is None else f", E⁻¹ at no more than {rate:.4g} 1/s"),
            f"the robust term is a slope between 0 and {slope:g} 1/s², which changes at any time"
            if slope
            else "there is no robust term",
            "the same gains, window, period and delay on every joint; no torque limit is reached, no sample lost",
            "Coriolis forces, gravity and friction disturb only",
            "H∞ norms are computed in floating point, to six digits from above",
            f"the torque reaches the joints {computation_delay} periods late and is held for a period",
        ),
        evidence=evidence,
    )


def _problem(sloping: bool, slow: bool) -> str:
    if slow:
        form = "δ²|T|² + 2 Σ|y_m| m T rate |1 + ρ0 T|² − 4 Σ y_m sin(mω) Im T < 1"
        return f"{form}, with the slope's inequality" if sloping else form
    return "‖[δ T_vv, d δ T_vs; T_sv k/2d, T_ss k/2]‖∞ < 1, k/2 in the loop" if sloping else "‖T‖∞ δ < 1"


RADIUS_REDUCTIONS = 0.0, 2e-5, 2e-4, 1e-3, 2e-3, 4e-3, 7e-3, 0.01, 0.03, 0.08, 0.2, 0.4
"""Shares by which a radius is made smaller until it holds at all frequencies, and not on a grid of them alone."""

CENTRE_FACTORS = 0.94, 0.88, 0.82
"""Times the best centre, where others are tried."""

RATE_FACTORS = 1.0, 4.0, 16.0
"""Times its rate for which a multiplier is searched for, until one holds between the frequencies of the grid too."""


def max_radius(
    parts: UncertainLoop, centre: float, weight: float = 0.0, *, step: float | None = None, stiffness: float = 0.0
) -> tuple[RadiusProof, float]:
    """The largest radius that is certified, zero for none, and what shows it.

    With a step E⁻¹ changes by no more than that in a period; the stiffness is the greatest ‖H‖ of a robot, or more.
    """
    if step is None:
        return max_radius_any_rate(parts, centre, weight)
    if schur_stability(parts.closed_loop(centre, weight)[0])[0] != "certified":
        return Multiplier(np.zeros(0), np.zeros(0)), 0.0
    responses = FrequencyResponses(parts, centre)
    best = Multiplier(np.zeros(0), np.zeros(0)), 0.0
    for faster in RATE_FACTORS:
        multiplier, radius, _ = best_multiplier(
            parts,
            centre,
            faster * max(step, MIN_CHANGE / centre),
            weight=weight,
            stiffness=stiffness,
            responses=responses,
        )
        for less in RADIUS_REDUCTIONS:
            trial = radius * (1 - less)
            if trial > best[1] and satisfies_iqc(parts, centre, trial, step, multiplier, weight, stiffness):
                best = multiplier, trial
                break
        if best[1] > 0.998 * radius:
            break
    return best


def max_radius_any_rate(parts: UncertainLoop, centre: float, weight: float = 0.0) -> tuple[float | None, float]:
    """Scale of the slope's block, None without a slope, and the largest radius that is certified; zero for none."""
    loop = parts.closed_loop(centre, weight)
    sloping = bool(parts.half_slope.item())
    if schur_stability(loop[0])[0] != "certified":
        return (1.0 if sloping else None), 0.0
    if not sloping:
        return None, (1 - NORM_TOLERANCE) / hinf_norm(*loop)
    scale, radius = FrequencyResponses(parts).best_scale(centre, weight)
    for less in RADIUS_REDUCTIONS[1:]:
        trial = radius * (1 - less)
        if trial > 0 and hinf_norm(*scaled_system(loop, trial, scale)) < 1:
            return scale, trial
    return scale, 0.0


def best_centre(parts: UncertainLoop, ratio_range: tuple[float, float] | None, step: float | None = None) -> float:
    """The centre whose ball has the largest ratio of its ends, or holds a range with the most room."""
    from scipy.optimize import minimize_scalar

    responses = FrequencyResponses(parts)

    def worth(log: float, slow: bool = False) -> float:
        centre = float(np.exp(log))
        spectral_radius = float(np.max(np.abs(np.linalg.eigvals(parts.closed_loop(centre)[0]))))
        if spectral_radius >= 1:
            return -spectral_radius
        if slow and step is not None:
            radius = best_multiplier(parts, centre, step, responses=responses)[1]
        else:
            radius = responses.best_scale(centre)[1]
        if ratio_range is None:
            return radius / centre
        return radius / max(ratio_range[1] - centre, centre - ratio_range[0], 1e-12)

    def refined(logs: Array, slow: bool, tolerance: float) -> float:
        values = [worth(log, slow) for log in logs]
        top = int(np.argmax(values))
        ends = logs[max(top - 1, 0)], logs[min(top + 1, len(logs) - 1)]
        if ends[0] == ends[1] or values[top] <= 1e-3:  # nothing, or what rounding leaves of a mode on the circle
            return logs[top]
        found: Any = minimize_scalar(
            lambda log: -worth(log, slow), bounds=ends, method="bounded", options={"xatol": tolerance}
        )
        return found.x if -found.fun > values[top] else logs[top]

    if ratio_range is None:
        logs = np.log(np.geomspace(1e-4, 10.0, 33))
    else:
        logs = (
            np.log(np.linspace(*ratio_range, 9))
            if ratio_range[1] > ratio_range[0]
            else np.log(np.array(ratio_range[:1]))
        )
    best = refined(logs, False, 1e-4)
    if ratio_range is None and worth(best) <= 1e-3:
        raise TarcError(
            "ball: no inertia ratio makes this loop stable; use a shorter window, a lower natural frequency, a "
            "smaller slope "
            "or less computation delay"
        )
    if step is not None and ratio_range is None:  # it is a little higher than at any speed
        best = refined(best + np.log([0.8, 1.0, 1.25, 1.5, 1.8]), True, 1e-2)
    elif step is not None and ratio_range is not None:
        best = refined(np.sort([best, np.log((ratio_range[0] + ratio_range[1]) / 2)]), True, 1e-2)
    return float(np.exp(best))
