"""Switching gain from a bound of the time-delay estimation error that grows with the tracking error."""

from typing import NamedTuple

from tarc.core import array_ops as ops
from tarc.core.types import Vector

MIN_SQUARE = 1e-24
"""Least ‖ξ‖², which keeps the norm differentiable at zero error."""


class BoundGains(NamedTuple):
    """Gains K̂0 and K̂1 of the bound K̂0 + K̂1 ‖ξ‖."""

    constant_gain: Vector
    state_gain: Vector


def state_norm(slope: Vector, error: Vector, error_rate: Vector) -> Vector:
    """Return ‖ξ‖ [rad/s or m/s] of the error state ξ = [Λ e1; v̂ − q̇ᵈ], with both parts in one unit."""
    scaled = slope @ error
    return ops.sqrt(ops.maximum(ops.dot(scaled, scaled) + ops.dot(error_rate, error_rate), MIN_SQUARE))


def switching_gain(gains: BoundGains, norm: Vector, highest: float | None) -> Vector:
    """Return ĉ = K̂0 + K̂1 ‖ξ‖ [rad/s² or m/s²], at most ``highest``."""
    return ops.clip(gains.constant_gain + gains.state_gain * norm, 0.0, ops.HUGE if highest is None else highest)
