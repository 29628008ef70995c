"""Integral with anti-windup at a torque limit, for the laws that have one."""

from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.pole_placement import PolePlacement


class IntegralState(NamedTuple):
    """The integral [rad/s² or m/s²], shape (n,), and the torques commanded, newest first, shape (n, d + 1)."""

    integral: Vector
    torque_command: Vector


def start(law: PolePlacement, torque: np.ndarray, *, bumpless: bool = True) -> IntegralState:
    """Return the state after a torque (n,) was applied at rest; if bumpless, the integral equals that torque."""
    first = np.linalg.solve(law.M, torque) if bumpless else np.zeros(law.n_joints)
    return IntegralState(first, np.repeat(torque[:, None], law.actuation_delay + 1, axis=1))


def integrate(
    law: PolePlacement, state: IntegralState, tracking: ControlInput, rate: Vector, anti_windup_gain: float
) -> Vector:
    """Return the next integral: Euler's rule with back-calculation.

        z⁺ = z + T (rate + g M̂⁻¹ (τ applied − τ commanded)),     g = anti_windup_gain [1/s]

    Where a limit cuts the torque, z approaches the applied torque with the time constant 1/g. The rate is zero once the
    law has given up. With g = 0 there is no integral: an unused sum would add a pole at one to the linearised loop.
    """
    if not ops.symbolic(anti_windup_gain) and not anti_windup_gain:
        return 0 * tracking.error
    limited = law.M_inverse @ (tracking.past_torque - state.torque_command[:, -1])
    new = state.integral + law.period * (
        ops.where_or_zero(ops.logical_not(tracking.fault), rate) + anti_windup_gain * limited
    )
    return ops.where(ops.finite(new), new, state.integral)


def remember(state: IntegralState, integral: Vector, torque: Vector) -> IntegralState:
    """Return the next state, with the torque commanded now."""
    return IntegralState(integral, ops.shift_in(state.torque_command, ops.where_or_zero(ops.finite(torque), torque)))
