"""Time-delayed adaptive robust control."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.validation import Matrix
from tarc.laws.base import ControlInput
from tarc.laws.tde import TDE

GROWTH = ("difference", "window")
"""How TARC may tell that the error grows."""


class GainState(NamedTuple):
    """The switching gain ĉ, and ‖s‖ over the past delay, newest first, shape (1, m)."""

    gain: Vector
    sliding: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class TARC(TDE):
    """Time-delayed adaptive robust control: TDC with an adaptive switching gain on estimated derivatives.

        Δu = −α ĉ s / max(‖s‖, ε),     s = P2 e1
        ĉ' = +c̄ ‖s‖  if ĉ ≤ γ or f > 0,     −c̲ ‖s‖  otherwise
        f = ‖s‖ − ‖s_h‖,     or sᵀ P2 (v̂ − q̇ᵈ)
        AᵀP + PA = −Q,     P = [P1 P2ᵀ; P2 P3]

    The gain rises while the error grows and falls otherwise. The law needs neither a bound on the uncertainty nor a
    threshold on the error. The adaptation is integrated by forward Euler, limited from below to γ like the continuous
    law. Takes the parameters of `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    rise_rate, fall_rate
        c̄ and c̲ [1/s³ per unit of s], both above zero. The default weight makes s = e1 [rad or m]; with Q = I, s is
        1/(2ωn²) of the error and both must be thousands of times larger.
    boundary_layer
        ε [unit of s], the layer in which the switching term is linear; its slope α ĉ/ε adds to K1.
    min_gain
        γ [rad/s²], least gain.
    gain_factor
        α ≥ 1.
    initial_gain
        ĉ(0) [rad/s²], above ``min_gain``; None for twice ``min_gain``.
    max_gain
        Largest gain [rad/s²]; None for none. The boundedness argument in print has a gap, and the gain can run away
        for a large rise with a small boundary.
    growth
        Which f tells that the error grows. ``"difference"`` is the paper's ‖s‖ − ‖s_h‖. With an encoder it rectifies
        noise: the gain rises whatever the error does, where the rise is not slower than the fall. ``"window"`` is half
        the derivative of ‖s‖², sᵀ P2 (v̂ − q̇ᵈ), with the velocity of the estimator.
    lyapunov_weight
        Q: one number, 2n numbers or a (2n, 2n) symmetric positive definite matrix; None for diag(K1 + K1ᵀ, 2 I), which
        gives P2 = I for scalar gains.

    Raises
    ------
    InvalidParameter
        When ĉ(0) ≤ γ, α < 1, or P3 P2ᵀ is not positive definite (condition (c2)).

    References
    ----------
    Paper, Section II-B: the control input (tarc input), (delta u), the adaptive law (ATRC), condition (c2). The paper
    leaves f to its user; ``growth="window"`` is ours.
    """

    rise_rate: float
    fall_rate: float
    boundary_layer: float = 0.01
    min_gain: float = 0.01
    gain_factor: float = 1.0
    initial_gain: float | None = None
    max_gain: float | None = None
    growth: str = "difference"
    lyapunov_weight: Matrix | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("rise_rate", "fall_rate", "boundary_layer", "min_gain"):
            check.number(name, getattr(self, name), 0, strict=True)
        check.number("gain_factor", self.gain_factor, 1.0)
        check.one_of("growth", self.growth, GROWTH)
        if not self.start_gain > self.min_gain:
            raise InvalidParameter(
                f"initial_gain: got {self.start_gain:g}, which is not above min_gain {self.min_gain:g}; the "
                "adaptive law needs ĉ(0) > γ. Raise initial_gain or lower min_gain"
            )
        if self.max_gain is not None and not check.number("max_gain", self.max_gain) >= self.start_gain:
            raise InvalidParameter(
                f"max_gain: got {self.max_gain:g}; needs at least the initial gain {self.start_gain:g}"
            )
        product = self.P3 @ self.P2.T
        if np.linalg.eigvalsh(product + product.T)[0] <= 0:
            raise InvalidParameter(
                "lyapunov_weight: P3 P2ᵀ is not positive definite, so condition (c2) fails; use a block-diagonal "
                "weight Q, "
                "such as the default"
            )

    def linearisation_constants(self, gain: float) -> dict[str, float | None]:
        """Return the constants of every law, and the states that adapt."""
        return {**super().linearisation_constants(gain), "gain": gain, "sliding": None}

    @property
    def start_gain(self) -> float:
        """Return the initial gain ĉ(0) [rad/s²]."""
        value = 2 * self.min_gain if self.initial_gain is None else self.initial_gain
        return check.number("initial_gain", value, 0)

    @cached_property
    def Q(self) -> np.ndarray:
        """Return the weight of the Lyapunov equation, shape (2n, 2n)."""
        n = self.n_joints
        if self.lyapunov_weight is None:
            zero = np.zeros((n, n))
            return check.positive_definite(
                "lyapunov_weight", np.block([[self.K1 + self.K1.T, zero], [zero, 2 * np.eye(n)]]), 2 * n
            )
        return check.positive_definite("lyapunov_weight", self.lyapunov_weight, 2 * n)

    @cached_property
    def P(self) -> np.ndarray:
        """Return the solution of AᵀP + PA = −Q, shape (2n, 2n)."""
        from scipy.linalg import solve_continuous_lyapunov

        P = solve_continuous_lyapunov(self.A.T, -self.Q)
        return (P + P.T) / 2

    @property
    def P2(self) -> np.ndarray:
        """Return the lower left block of P, shape (n, n): s = P2 e1."""
        return self.P[self.n_joints :, : self.n_joints]

    def _single_joint_parameters(self, position_gain: float, velocity_gain: float, P2: float | None) -> dict[str, Any]:
        """Return the parameters of every law, and the weight Q = diag(2 K1 P2, 2), whose solution has this P2."""
        weight = None if P2 is None else [2 * position_gain * P2, 2.0]
        return {**super()._single_joint_parameters(position_gain, velocity_gain, P2), "lyapunov_weight": weight}

    @property
    def P3(self) -> np.ndarray:
        """Return the lower right block of P, shape (n, n)."""
        return self.P[self.n_joints :, self.n_joints :]

    @property
    def robust_slope_bound(self) -> float:
        """Return α ĉ ‖P2‖/ε at ĉ = ``max_gain``; infinite without one."""
        highest = np.inf if self.max_gain is None else self.max_gain
        return self.gain_factor * highest / self.boundary_layer * float(np.linalg.norm(self.P2, 2))

    def sliding(self, error: Vector, error_rate: Vector) -> Vector:
        """Return s = P2 e1, shape (n,)."""
        return self.P2 @ error

    def robust_init(self) -> GainState:
        """Return the initial gain, and zero ‖s‖ before the start."""
        return GainState(np.array(self.start_gain), np.zeros((1, self.delay_periods)))

    def robust(self, state: GainState, tracking: ControlInput) -> tuple[GainState, Vector, dict[str, Vector]]:
        """Evaluate Δu = −α ĉ s / max(‖s‖, ε) and adapt ĉ."""
        s = self.sliding(tracking.error, tracking.error_rate)
        size = ops.norm(s)
        correction = -self.gain_factor * state.gain * s / ops.norm(s, self.boundary_layer)
        is_growing = size > state.sliding[0, -1]
        if self.growth == "window":
            is_growing = ops.dot(s, self.P2 @ tracking.error_rate) > 0
        rising = ops.logical_or(state.gain <= self.min_gain, is_growing)
        rate = ((self.rise_rate + self.fall_rate) * rising - self.fall_rate) * size
        highest = ops.HUGE if self.max_gain is None else self.max_gain
        rate = ops.where_or_zero(ops.logical_not(tracking.fault), rate)
        gain = ops.clip(state.gain + self.period * rate, self.min_gain, highest)
        next_state = GainState(gain, ops.shift_in(state.sliding, size))
        return next_state, correction, {"gain": state.gain, "rising": rising}
