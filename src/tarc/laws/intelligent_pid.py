"""Intelligent PID: model-free control by an ultra-local model."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.estimators.algebraic import Algebraic
from tarc.estimators.base import AverageState, WindowState
from tarc.laws.base import ControlInput, LawState
from tarc.laws.integral import IntegralState, integrate, remember, start
from tarc.laws.pole_placement import PolePlacement


class UltraLocalState(NamedTuple):
    """The window of positions, that of torques, and the integral."""

    positions: WindowState
    torques: AverageState
    integral: IntegralState


@dataclass(frozen=True, kw_only=True, eq=False)
class IntelligentPID(PolePlacement):
    """Intelligent PID: the robot is locally q̈ = F + M̂⁻¹ τ, and F is estimated from a window of q and τ.

        F̂ = 60/L⁵ ∫₀ᴸ (L² − 6 L σ + 6 σ²) q(t−σ) dσ − 30/L⁵ ∫₀ᴸ σ² (L − σ)² M̂⁻¹ τ(t−σ) dσ
        τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + z − F̂),     ż = −integral_gain K1 e1

    F̂ is exact while F is constant over the window. Takes the parameters of `PolePlacement` and `Law`, and:

    Parameters
    ----------
    window
        L [s], a whole multiple of the period, two or more; None for ten periods. A longer window gives less noise and a
        later F̂.
    integral_gain
        Gain [1/s] as of `PID`. The default 0 is the iPD of the paper; F̂ already compensates a constant load.

    Notes
    -----
    The formula is the paper's method for the order ν = 2: multiply q̈ = F + M̂⁻¹τ by σ² (L − σ)²/2 and integrate by
    parts. Neither initial values nor derivatives of q remain. The first part is the second derivative of the
    least-squares parabola, and the second the matching average of the torque. The sums that replace the integrals are
    exact for a torque held over each period. A constant F is therefore estimated exactly, which the trapezoidal rule
    does not achieve. With ``integral_gain=0`` and an estimator `Algebraic` of degree 2 over the same window, the law
    equals synchronised `TDC`, term by term. It differs by a window of its own for F̂, and by the integral.

    Raises
    ------
    InvalidParameter
        For a window that is no multiple of the period, or shorter than two periods.

    References
    ----------
    M. Fliess and C. Join, Model-free control, Int. J. Control 86(12), 2013.
    """

    window: float | None = None
    integral_gain: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("integral_gain", self.integral_gain, 0)
        _ = self.differentiator

    @cached_property
    def differentiator(self) -> Algebraic:
        """Return the parabola over the window, whose second derivative is the first part of F̂."""
        window = 10 * self.period if self.window is None else self.window
        return Algebraic(window=window, degree=2, period=self.period)

    @property
    def robust_slope_bound(self) -> float:
        """Return zero: the law is linear."""
        return 0.0

    def init(self, position: Numbers, torque: Numbers = 0.0) -> LawState:
        """Return the state of every law, with the window full of the position."""
        state = super().init(position, torque)
        positions = self.differentiator.init(state.position)
        return state._replace(control=state.control._replace(positions=positions))

    def initial_state(self, torque: np.ndarray) -> UltraLocalState:
        """Return the state at rest, where F balances the applied torque."""
        return UltraLocalState(
            self.differentiator.init(np.zeros(self.n_joints)),
            self.differentiator.matched_torque_filter().init(torque),
            start(self, torque, bumpless=False),
        )

    def control(
        self, state: UltraLocalState, tracking: ControlInput
    ) -> tuple[UltraLocalState, Vector, dict[str, Vector]]:
        """Evaluate τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + z − F̂)."""
        positions, estimate = self.differentiator.step(state.positions, tracking.estimate.position)
        torques, average = self.differentiator.matched_torque_filter().step(state.torques, tracking.past_torque)
        F = estimate.acceleration - np.linalg.inv(self.M) @ average
        rate = -self.integral_gain * (self.K1 @ tracking.error)
        z = integrate(self, state.integral, tracking, rate, self.integral_gain)
        u = self.feedback(tracking) + z
        torque = self.M @ (u - F)
        next_state = UltraLocalState(positions, torques, remember(state.integral, z, torque))
        return next_state, torque, {"auxiliary": u, "disturbance_estimate": F}
