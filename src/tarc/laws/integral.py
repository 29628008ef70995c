"""An integral that does not wind up at a torque limit; what laws with one share."""

from typing import Any, NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.laws.base import Tracking
from tarc.laws.pole_placement import PolePlacement


class IntegralState(NamedTuple):
    """The integral [rad/s² or m/s²], shape (n,), and the torques asked for, newest first, shape (n, d + 1)."""

    integral: Any
    wanted: Any


def start(law: PolePlacement, torque: np.ndarray, *, bumpless: bool = True) -> IntegralState:
    """State after a torque (n,) was applied at rest, which the integral goes on giving if it is to be bumpless."""
    first = np.linalg.solve(law.M, torque) if bumpless else np.zeros(law.n_joints)
    return IntegralState(first, np.repeat(torque[:, None], law.actuation_delay + 1, axis=1))


def integrate(law: PolePlacement, state: IntegralState, tracking: Tracking, rate: Any, unwind: float) -> Any:
    """z + T (rate + unwind M̂⁻¹ (τ applied − τ asked for)): Euler's rule with back-calculation.

    Where a limit cuts the torque, z moves towards what can be applied, with the time constant 1/unwind [s]. The rate is
    held at zero once the law has given up. Without unwinding there is no integral: a sum of nothing would be a pole at
    one in the linearised loop.
    """
    if not unwind:
        return 0 * tracking.error
    refused = np.linalg.inv(law.M) @ (tracking.past_torque - state.wanted[:, -1])
    new = state.integral + law.period * (ops.only(ops.negate(tracking.fault), rate) + unwind * refused)
    return ops.where(ops.finite(new), new, state.integral)


def remember(state: IntegralState, integral: Any, torque: Any) -> IntegralState:
    """The next state, with the torque that is asked for now."""
    return IntegralState(integral, ops.push(state.wanted, ops.only(ops.finite(torque), torque)))
