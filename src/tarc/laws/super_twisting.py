"""Super-twisting control: second-order sliding mode."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.integral import IntegralState, integrate, remember, start
from tarc.laws.pole_placement import PolePlacement


@dataclass(frozen=True, kw_only=True, eq=False)
class SuperTwisting(PolePlacement):
    """Super-twisting: a continuous torque that keeps s = 0 under any disturbance of bounded rate.

        s = v̂ − q̇ᵈ + Λ e1,     Λ = ½ K2
        τ = M̂ (q̈ᵈ − Λ (v̂ − q̇ᵈ) − k1 |s|^½ sgn s + z),     ż = −k2 sgn s,     k1 = a √L,  k2 = b L

    joint by joint. Takes the parameters of `PolePlacement` and `Law`, and:

    Parameters
    ----------
    disturbance_rate
        L [rad/s³ or m/s³], largest rate of the disturbing acceleration that M̂ does not explain. The law chatters where
        L is too large for its delays, and leaves the surface where L is too small.
    root_gain, switch_gain
        a and b. Levant's 1.5 and 1.1 by default, found by simulation; his sufficient condition, for the continuous
        law, is b > 1 and a² ≥ 4 (b + 1)/(b − 1).
    boundary_layer
        ε [rad/s or m/s]: |s| below it counts as ε in |s|^½ and sgn s = s/|s|, which makes both linear there, with the
        slopes k1/√ε and k2/ε.

    Notes
    -----
    On the surface the error decays with the rate Λ = ζ ωn; K1 has no effect. L exists only for a smooth disturbance and
    a smooth effect of M̂ ≠ M: a step, dry friction or quantisation moves s away for a moment. Sampled, s stays in a
    band about zero of the order of L T² for an exact velocity. The band is wider for a delayed velocity, with which a
    small boundary layer also rings. `tarc.certificates.certify_constant_ratio` decides whether the loop inside the
    layer is stable. The boundary layer, the forward Euler rule and the back-calculation at a torque limit are additions
    to the papers.

    References
    ----------
    A. Levant, Sliding order and sliding accuracy in sliding mode control, Int. J. Control 58(6), 1993; A. Levant,
    Robust exact differentiation via sliding mode technique, Automatica 34(3), 1998, for 1.5 and 1.1.
    """

    disturbance_rate: float
    root_gain: float = 1.5
    switch_gain: float = 1.1
    boundary_layer: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("disturbance_rate", "root_gain", "switch_gain", "boundary_layer"):
            check.number(name, getattr(self, name), 0, strict=True)

    @cached_property
    def slope(self) -> np.ndarray:
        """Return Λ = ½ K2 [1/s], shape (n, n)."""
        return self.K2 / 2

    @property
    def k1(self) -> float:
        """Return the gain of |s|^½ sgn s."""
        return self.root_gain * self.disturbance_rate**0.5

    @property
    def k2(self) -> float:
        """Return the gain of ∫ sgn s [rad/s³ or m/s³]."""
        return self.switch_gain * self.disturbance_rate

    @cached_property
    def anti_windup_gain(self) -> float:
        """Return the largest element of Λ, the rate at which the integral follows the applied torque [1/s]."""
        return float(np.max(np.diag(self.slope)))

    def initial_state(self, torque: np.ndarray) -> IntegralState:
        """Return the integral that gives the torque already applied."""
        return start(self, torque)

    def control(self, state: IntegralState, tracking: ControlInput) -> tuple[IntegralState, Vector, dict[str, Vector]]:
        """Evaluate τ = M̂ (q̈ᵈ − Λ (v̂ − q̇ᵈ) − k1 |s|^½ sgn s + z)."""
        s = tracking.error_rate + self.slope @ tracking.error
        size = ops.maximum(abs(s), self.boundary_layer)
        z = integrate(self, state, tracking, -self.k2 * s / size, self.anti_windup_gain)
        u = tracking.acceleration_reference - self.slope @ tracking.error_rate - self.k1 * s / size**0.5 + z
        torque = self.M @ u
        return remember(state, z, torque), torque, {"integral": z, "surface": s}
