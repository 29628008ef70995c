"""The ball of ratios, stiffness and damping that a loop with M̂(q) tolerates."""

from typing import NamedTuple

import numpy as np

from tarc.analysis.linearise import Channel
from tarc.analysis.operating_points import UncertaintySamples
from tarc.analysis.uncertain_loop import FrequencyResponses, System, UncertainLoop, scaled_system
from tarc.certificates.ball_search import tried_lead_times
from tarc.certificates.known_inertia_evidence import decayed_system, widened_radius
from tarc.core.types import Array
from tarc.numerics.norms import hinf_norm

SCALES = 12
"""Number of scales of the robust term's block that are tried."""


class KnownBall(NamedTuple):
    """Radius over the needed one, radius, centre ρ0, weight η, scale and loop."""

    quality: float
    radius: float
    centre: float
    position_weight: float
    scale: float | None
    loop: UncertainLoop


def best_ball(
    channel: Channel, slope: float, uncertainty: UncertaintySamples, growth: float, computation_delay: int
) -> KnownBall:
    """Return the ball of the largest radius over the needed one, with its proof."""
    ratios = np.linalg.eigvalsh(uncertainty.inertia)
    centre = float(ratios.min() + ratios.max()) / 2
    balls = []
    for lead_time in tried_lead_times(uncertainty, channel.period):
        lead_periods = lead_time / channel.period
        loop = UncertainLoop.from_channel(channel, slope, intersample=True, lead_periods=lead_periods)
        angles = FrequencyResponses(loop, centre).angles
        for weight in uncertainty.candidate_weights(centre, lead_time) or [0.0]:
            system = decayed_system(loop, centre, weight, growth)
            radius, scale = _grid_radius(system, angles, bool(slope))
            needed = widened_radius(uncertainty, (centre, weight, lead_time), growth, computation_delay, channel.period)
            balls.append(KnownBall(radius / needed, radius, centre, weight, scale, loop))
    best = max(balls, key=lambda ball: ball.quality)
    system = decayed_system(best.loop, best.centre, best.position_weight, growth)
    radius = 0.999 * best.radius
    while radius > 0.5 * best.radius and hinf_norm(*scaled_system(system, radius, best.scale)) >= 1:
        radius *= 0.98
    return best._replace(radius=radius)


def _grid_radius(system: System, angles: Array, has_slope: bool) -> tuple[float, float | None]:
    """Return the radius that the loop tolerates on a grid of frequencies, and the scale of the robust term's block."""
    A, B, C, D = system
    if np.max(np.abs(np.linalg.eigvals(A))) >= 1:
        return 0.0, 1.0 if has_slope else None
    z = np.exp(1j * angles)[:, None, None]
    G = C @ np.linalg.solve(z * np.eye(len(A)) - A, B + 0 * z) + D
    if not has_slope:
        return float(1 / np.linalg.norm(G, 2, axis=(1, 2)).max()), None
    slope_gain = float(np.abs(G[:, -1, -1]).max())
    if slope_gain >= 1:
        return 0.0, 1.0
    natural = float(np.sqrt(np.abs(G[:, -1, :-1]).max() / max(np.abs(G[:, :-1, -1]).max(), 1e-300)))
    candidates = []
    for scale in natural * np.geomspace(1e-2, 1e2, SCALES):
        low, high = 0.0, float(1 / np.linalg.norm(G[:, :-1, :-1], 2, axis=(1, 2)).max())
        for _ in range(14):
            middle = (low + high) / 2
            scaled = G.copy()
            scaled[:, :-1] *= middle
            scaled[:, -1] /= scale
            scaled[:, :, -1] *= scale
            low, high = (middle, high) if np.linalg.norm(scaled, 2, axis=(1, 2)).max() < 1 else (low, middle)
        candidates.append((low, float(scale)))
    return max(candidates)
