"""The largest radius of a ball that a loop tolerates about a centre."""

import numpy as np

from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop, scaled_system
from tarc.certificates.ball import RadiusProof
from tarc.certificates.iqc import MIN_CHANGE, Multiplier, best_multiplier, satisfies_iqc
from tarc.numerics.matrix_tests import schur_stability
from tarc.numerics.norms import hinf_norm

NORM_TOLERANCE = 1e-6
"""Relative tolerance of the H∞ norm."""
RADIUS_REDUCTIONS = 0.0, 2e-5, 2e-4, 1e-3, 2e-3, 4e-3, 7e-3, 0.01, 0.03, 0.08, 0.2, 0.4
"""Shares by which a radius from a grid of frequencies is reduced until it is certified at all frequencies."""
RATE_FACTORS = 1.0, 4.0, 16.0
"""Factors on the rate for which a multiplier is searched, until one is certified at all frequencies."""


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
