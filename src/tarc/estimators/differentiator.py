"""Levant's robust exact differentiator."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, NotLinearisable
from tarc.core.types import Vector
from tarc.core.validation import Numbers, array
from tarc.estimators.base import Estimate, Estimator, TorqueAverage

LAMBDA = (1.1, 1.5 * 2.0**0.5, 2.0)
"""λ0, λ1 and λ2 that correspond to Levant's coefficients 1.1, 1.5 and 2 of the recursive form."""
NEWTON_STEPS = 8
"""Steps of Newton's method for the cubic of the implicit scheme."""


class DifferentiatorState(NamedTuple):
    """Estimates z0, z1, z2 of position, velocity and acceleration, shape (n, 3)."""

    motion: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class RobustDifferentiator(Estimator):
    """Second-order sliding-mode differentiator: exact in finite time for |q⃛| ≤ L, without noise.

        z0' = z1 − λ2 L^{1/3} |σ|^{2/3} sgn σ,     σ = z0 − q
        z1' = z2 − λ1 L^{2/3} |σ|^{1/3} sgn σ,     z2' = −λ0 L sgn σ

    Sampled explicitly, with the Taylor terms that keep the order of accuracy, or implicitly. Explicit: σ is taken
    before the step, and z2 chatters by λ0 L T even at rest. Implicit: σ is taken after the step, which makes a cubic in
    |σ|^{1/3} with one root. Where the set-valued sign can keep σ at zero it does, without chattering. The
    differentiator is nonlinear: it has no transfer function and no matching filter of the torque.

    Parameters
    ----------
    lipschitz
        L [rad/s³ or m/s³], a bound on the third derivative of the motion. With a smaller L the estimate falls behind,
        with a larger one it passes more noise.
    implicit
        Whether to use the implicit scheme.

    References
    ----------
    A. Levant, Int. J. Control 76(9/10), 2003; M. Livne and A. Levant, Automatica 50(8), 2014, for the Taylor terms;
    B. Brogliato, A. Polyakov and D. Efimov, IEEE Trans. Autom. Control 65(8), 2020, for the idea of the implicit sign.
    """

    lipschitz: float
    implicit: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("lipschitz", self.lipschitz, 0, strict=True)

    @property
    def max_derivative(self) -> int:
        """Return 2: velocity and acceleration."""
        return 2

    def transfer_function(self, derivative: int) -> tuple[np.ndarray, np.ndarray]:
        """Return 1 for derivative 0; raise `NotLinearisable` for the others, since the differentiator is nonlinear."""
        if self._order(derivative) == 0:
            return np.ones(1), np.ones(1)
        raise NotLinearisable(
            "RobustDifferentiator: it is nonlinear and has no transfer function; simulate it, or use Kalman or HighGain"
        )

    def matched_torque_filter(self) -> TorqueAverage:
        """Raise `InvalidParameter`: no linear filter has the delay of a nonlinear estimate."""
        raise InvalidParameter(
            "synchronised: RobustDifferentiator is nonlinear, so that no filter of the torque has its delay; use "
            "synchronised=False"
        )

    def init(self, position: Numbers) -> DifferentiatorState:
        """Return the state at rest at the first position, shape (n,)."""
        first = array("position", position)
        return DifferentiatorState(np.column_stack([first, 0 * first, 0 * first]))

    def step(self, state: DifferentiatorState, value: Vector) -> tuple[DifferentiatorState, Estimate]:
        """Step either scheme; a missing sample leaves the Taylor prediction."""
        valid = ops.finite(value)
        z0, z1, z2 = (state.motion[:, i] for i in range(3))
        T = self.sampling_period
        ahead = z0 + T * z1 + T**2 / 2 * z2
        if self.implicit:
            c0, c1, c2 = self._implicit(ops.where_or_zero(valid, ahead - value))
            z2 = z2 - T * c2
            z1 = z1 + T * z2 - T * c1
            motion = ops.columns(z0 + T * z1 - T**2 / 2 * z2 - T * c0, z1, z2)
            return DifferentiatorState(motion), Estimate(ops.where(valid, value, ahead), z1, z2, valid)
        # the state was reached without this sample, and what it corrects shows at the next
        c0, c1, c2 = self._explicit(ops.where_or_zero(valid, z0 - value))
        motion = ops.columns(ahead - T * c0, z1 + T * z2 - T * c1, z2 - T * c2)
        return DifferentiatorState(motion), Estimate(ops.where(valid, value, z0), z1, z2, valid)

    @property
    def _injections(self) -> tuple[float, float, float]:
        """Return λ2 L^{1/3}, λ1 L^{2/3}, λ0 L."""
        slow, middle, fast = LAMBDA
        return fast * self.lipschitz ** (1 / 3), middle * self.lipschitz ** (2 / 3), slow * self.lipschitz

    def _explicit(self, sigma: Vector) -> tuple[Any, Any, Any]:
        k0, k1, k2 = self._injections
        sign, size = ops.sign(sigma), ops.abs(sigma)
        return k0 * size ** (2 / 3) * sign, k1 * size ** (1 / 3) * sign, k2 * sign

    def _implicit(self, sigma: Vector) -> tuple[Any, Any, Any]:
        """Return the injections at σ⁺ after the step, from σ before: x³ + a2 x² + a1 x = |σ| − a0, x = |σ⁺|^{1/3}."""
        T = self.sampling_period
        k0, k1, k2 = self._injections
        a2, a1, a0 = T * k0, T**2 * k1, T**3 / 2 * k2
        excess = ops.maximum(ops.abs(sigma) - a0, 0.0)
        # each term alone bounds the root from above, and from there Newton's method falls to it
        x = ops.minimum(ops.minimum(excess ** (1 / 3), (excess / a2) ** 0.5), excess / a1)
        for _ in range(NEWTON_STEPS):
            x = x - (((x + a2) * x + a1) * x - excess) / ((3 * x + 2 * a2) * x + a1)
        sign = ops.clip(sigma / a0, -1.0, 1.0)
        return k0 * x**2 * sign, k1 * x * sign, k2 * sign
