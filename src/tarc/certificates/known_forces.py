"""What a Lyapunov function must tolerate of a robot whose law has M̂(q): ratios, rates and bounds on forces."""

import numpy as np

from tarc.analysis.known_inertia import lagged_force_norms, to_posture_coordinates
from tarc.analysis.operating_points import NEGLIGIBLE_STIFFNESS, SEARCH_MARGIN, UncertaintySamples
from tarc.certificates.affine_cover import ACCELERATION_SHARE, LEAD_FACTORS, POWERS
from tarc.certificates.affine_form import RatioSet
from tarc.certificates.known_inertia_evidence import KnownInertiaEvidence
from tarc.core.types import Array

LAG_SHARE = 0.5
"""Weight of what q changes since the sample of the torque, over that of θ q̇."""


def force_bounds(uncertainty: UncertaintySamples, period: float, delay: int) -> list[tuple[float, float, float]]:
    """Return powers p, lead times θ [s] and lag weights φ of the bounds ‖E^−p [H, C/θ, K/φ]‖."""
    found = []
    for power in POWERS:
        longest = uncertainty.force_lead_time(power)
        for lead_time in [factor * longest for factor in LEAD_FACTORS] if longest else [0.0]:
            found.append((power, lead_time, LAG_SHARE * (lead_time or period) / ((1 + delay) * period)))
    return found


def known_ratios(evidence: KnownInertiaEvidence, parts: tuple[Array, Array, Array, Array, Array]) -> RatioSet:
    """Return what a Lyapunov function must tolerate to cover the robot with the margin `SEARCH_MARGIN`.

    Parameters
    ----------
    evidence
        Ratios, rates and delay of the robot.
    parts
        M̂, M, D, G and the law's own stiffness of the points, each (k, n, n).
    """
    nominal, M, D, G, own = parts
    uncertainty = to_posture_coordinates(nominal, M, D, G - own)
    room, periods = 1 + 1.1 * SEARCH_MARGIN, 1 + evidence.computation_delay
    growth = float(np.exp(evidence.rate * evidence.period * periods))
    min_ratio, max_ratio = evidence.min_ratio / growth / room, evidence.max_ratio * growth * room
    relative_rate = evidence.relative_rate_point.relative_rate() * room
    bounds = force_bounds(uncertainty, evidence.period, evidence.computation_delay)
    norms = np.array(
        [
            growth * lagged_force_norms((nominal, M, D, G - own, own), lead_time, power, lag).max() * room
            for power, lead_time, lag in bounds
        ]
    )
    if not norms.max() > NEGLIGIBLE_STIFFNESS:
        bounds, norms = [], norms[:0]
    return RatioSet(
        min_ratio=min_ratio,
        max_ratio=max_ratio,
        rate=relative_rate / min_ratio,
        relative_rate=relative_rate,
        period=evidence.period,
        intersample=True,
        powers=np.array([power for power, _, _ in bounds]),
        lead_times=np.array([lead_time for _, lead_time, _ in bounds]),
        stiffness=norms,
        shares=np.full(len(bounds), ACCELERATION_SHARE),
        nominal_rate=evidence.rate * room,
        lag_weights=np.array([lag for _, _, lag in bounds]),
    )
