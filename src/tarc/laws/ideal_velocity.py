"""Time-delayed control with ideal velocity feedback."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.tde import TDE


class IdealVelocityState(NamedTuple):
    """Velocity of the robot without the error of time-delay estimation, shape (n,)."""

    ideal_velocity: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class IVF(TDE):
    """TDC with ideal velocity feedback: a correction towards the velocity of the nominal error dynamics.

        Δu = Γ (v* − v̂),     v* = ∫ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1) dt

    The error of time-delay estimation under hard friction appears as a difference of both velocities. Takes the
    parameters of `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    ideal_velocity_gain
        Γ [1/s], a third pole of the nominal loop at −Γ; zero is TDC. Half to twice the natural frequency is usual. It
        adds Γ to K2 and acts as an integral of the error. The longer the estimator's window, the smaller is the largest
        stable Γ; `tarc.certificates.certify_constant_ratio` tests it.
    max_correction
        Largest magnitude [rad/s² or m/s²] of each element of Δu, at which the integral stops too; None for none. Give
        one under a torque limit, or use `TDCIM`. Otherwise the integral winds up while the torque is limited.

    Raises
    ------
    InvalidParameter
        For a Γ below zero, and a ``max_correction`` that is not above zero.

    Notes
    -----
    Use it against Coulomb friction and stiction, where TDC stops and slips. It has no sliding surface, switching gain
    or threshold. It is linear, so that the constant-ratio certificate covers all of it.

    With perfect time-delay estimation v* = q̇ and Δu = 0. The integral starts from rest and is integrated by forward
    Euler. It stops once the law has given up. The estimate v̂ replaces the measured or differenced velocity of the
    sources.

    References
    ----------
    M. Jin, S. H. Kang and P. H. Chang, IEEE Trans. Ind. Electron. 55(1), 2008; J. Lee, P. H. Chang and R. S. Jamisola,
    IEEE Trans. Ind. Electron. 61(7), 2014, both with an impedance where here are K1 and K2. The cap is an addition.
    """

    ideal_velocity_gain: float
    max_correction: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("ideal_velocity_gain", self.ideal_velocity_gain, 0)
        if self.max_correction is not None:
            check.number("max_correction", self.max_correction, 0, strict=True)

    @property
    def robust_slope_bound(self) -> float:
        """Return zero: the robust term is linear, with a state of its own."""
        return 0.0

    def robust_init(self) -> IdealVelocityState:
        """Return the ideal velocity at rest."""
        return IdealVelocityState(np.zeros(self.n_joints))

    def robust(
        self, state: IdealVelocityState, tracking: ControlInput
    ) -> tuple[IdealVelocityState, Vector, dict[str, Vector]]:
        """Return the next integral and Δu = Γ (v* − v̂)."""
        velocity, ideal = tracking.estimate.velocity, state.ideal_velocity
        gap = ideal - velocity
        if self.max_correction is not None and self.ideal_velocity_gain > 0:
            reach = self.max_correction / self.ideal_velocity_gain
            gap = ops.clip(gap, -reach, reach)
            ideal = velocity + gap
        rate = ops.where_or_zero(ops.logical_not(tracking.fault), self.feedback(tracking))
        return IdealVelocityState(ideal + self.period * rate), self.ideal_velocity_gain * gap, {"ideal_velocity": ideal}
