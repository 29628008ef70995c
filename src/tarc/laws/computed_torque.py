"""Computed torque: inverse dynamics by a model."""

from dataclasses import dataclass

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.laws.base import ControlInput
from tarc.laws.integral import IntegralState, remember
from tarc.laws.model_based import ModelBased, inertia_and_bias
from tarc.plants.symbolic import SymbolicPlant

MAX_TORQUE_DIFFERENCE = 1e-9
"""Relative difference of the applied torque from the commanded one above which a limit has cut it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ComputedTorque(ModelBased):
    """Computed torque: a model of the robot cancels its dynamics, and the error has the chosen poles.

        τ = M(q) (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + z) + N(q, v̂),     K1 = ωn²,  K2 = 2 ζ ωn
        ż = −K_i e1,     K_i = integral_gain K1

    Takes the parameters of `Law`, and:

    Parameters
    ----------
    model
        Robot of `tarc.plants` that gives M and N, such as the true one with another payload. In a scenario, ``robot``
        is the scenario's own.
    natural_frequency, damping_ratio
        ωn [rad/s] and ζ, one number or one per joint.
    integral_gain
        K_i K1⁻¹ [1/s], the inverse of the reset time; 0 for no integral. A tenth of the natural frequency to a third of
        it is usual.
    friction_at_reference
        Take the model's friction at q̇ᵈ instead of v̂. It is then free of noise, and right where a joint stands still.

    Notes
    -----
    It shows the value of a model. With the true robot as the model, its error is a lower bound for laws without one.
    Without an integral, a load that the model lacks leaves an offset. The integral is a sum by Euler's rule from zero,
    and is held for a joint whose torque a limit cuts. A robot in symbols becomes part of the law and
    is compiled with it. A `tarc.plants.MujocoPlant` is called, in some 30 µs per period and without dry friction; such
    a law cannot be compiled. No certificate covers the law, since it has no constant M̂.

    Raises
    ------
    InvalidParameter
        For a model that is no robot of `tarc.plants`, and friction at q̇ᵈ of one that is not in symbols.

    References
    ----------
    J.-J. Slotine and W. Li, Applied Nonlinear Control, 1991, Section 9.1; J. Y. S. Luh, M. W. Walker and R. P. C. Paul,
    Resolved-acceleration control of mechanical manipulators, IEEE Trans. Autom. Control 25(3), 1980.
    """

    damping_ratio: Numbers = 1.0
    integral_gain: float = 0.0
    friction_at_reference: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check.vector("damping_ratio", self.damping_ratio, self.n_joints, 0, strict=True)
        check.number("integral_gain", self.integral_gain, 0)
        if self.friction_at_reference and not isinstance(self.model, SymbolicPlant):
            raise InvalidParameter(
                f"friction_at_reference: got a model {type(self.model).__name__}, whose friction is not known by "
                "itself; use a robot in symbols, such as load_robot gives, or friction_at_reference=False"
            )

    def initial_state(self, torque: np.ndarray) -> IntegralState | tuple[()]:
        """Return an integral of zero, and the applied torque as the commanded one; no state without an integral."""
        if not self.integral_gain:
            return ()
        return IntegralState(np.zeros(self.n_joints), np.repeat(torque[:, None], self.actuation_delay + 1, axis=1))

    def control(
        self, state: IntegralState | tuple[()], tracking: ControlInput
    ) -> tuple[IntegralState | tuple[()], Vector, dict[str, Vector]]:
        """Evaluate τ = M(q) u + N(q, v̂)."""
        estimate, zeta = tracking.estimate, np.asarray(self.damping_ratio)
        M, N = inertia_and_bias(self.model, estimate.position, estimate.velocity)
        if self.friction_at_reference and isinstance(self.model, SymbolicPlant):
            N = N + _friction_change(self.model, tracking)
        proportional, derivative = self.omega**2, 2 * zeta * self.omega
        u = tracking.acceleration_reference - derivative * tracking.error_rate - proportional * tracking.error
        if not isinstance(state, IntegralState):
            return state, M @ u + N, {"auxiliary": u}
        z = self._integrate(state, tracking)
        torque = M @ (u + z) + N
        return remember(state, z, torque), torque, {"auxiliary": u + z, "integral": z}

    def _integrate(self, state: IntegralState, tracking: ControlInput) -> Vector:
        """Return the next integral; it is held where a limit has cut the torque, and after the law has given up."""
        commanded = state.torque_command[:, -1]
        is_cut = ops.abs(tracking.past_torque - commanded) > MAX_TORQUE_DIFFERENCE * (1 + ops.abs(commanded))
        held = ops.logical_or(is_cut, tracking.fault)
        rate = -self.integral_gain * self.omega**2 * tracking.error
        z = state.integral + self.period * ops.where_or_zero(ops.logical_not(held), rate)
        return ops.where(ops.finite(z), z, state.integral)


def _friction_change(model: SymbolicPlant, tracking: ControlInput) -> Vector:
    """Return the model's friction at q̇ᵈ less that at v̂ [N m or N], shape (n,)."""
    position, velocity = tracking.estimate.position, tracking.estimate.velocity
    wanted = model.evaluate("friction", position, velocity - tracking.error_rate)
    return wanted - model.evaluate("friction", position, velocity)
