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
    """The velocity that the robot would have had without error of time-delay estimation, shape (n,)."""

    ideal_velocity: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class IVF(TDE):
    """TDC with ideal velocity feedback: it pulls the velocity to the one that the error dynamics would have made.

        Δu = Γ (v* − v̂),     v* = ∫ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1) dt

    What time-delay estimation leaves of hard friction shows as a gap between both velocities. Takes the parameters of
    `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    ideal_velocity_gain
        Γ [1/s], a third pole of the nominal loop at −Γ; zero is TDC. From half the natural frequency to twice that;
        it adds
        Γ to K2 and works as an integral of the error, so that the loop bears less of it the longer the estimator's
        window: ask `tarc.certificates.certify_constant_ratio`.
    max_correction
        Largest magnitude [rad/s² or m/s²] of each element of Δu, where the integral stops as well; None for none.
        Under a torque limit give one, or use `TDCIM`: otherwise the integral winds up while the torque is limited.

    Raises
    ------
    InvalidParameter
        For a Γ below zero, and a cap that is not above zero.

    Notes
    -----
    Use it against Coulomb friction and stiction, where TDC stops and slips. It knows no surface, gain or threshold; it
    is linear, and the loop certificate covers it whole.

    With perfect time-delay estimation v* = q̇ and Δu = 0. The integral starts from rest, runs as forward Euler and
    halts for good once the law has given up. v̂ is estimated where the sources have it measured or differenced.

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
        """Zero: the robust term is linear, with a state of its own."""
        return 0.0

    def robust_init(self) -> IdealVelocityState:
        """Rest."""
        return IdealVelocityState(np.zeros(self.n_joints))

    def robust(
        self, state: IdealVelocityState, tracking: ControlInput
    ) -> tuple[IdealVelocityState, Vector, dict[str, Vector]]:
        """Δu = Γ (v* − v̂), and the integral."""
        velocity, ideal = tracking.estimate.velocity, state.ideal_velocity
        gap = ideal - velocity
        if self.max_correction is not None and self.ideal_velocity_gain > 0:
            reach = self.max_correction / self.ideal_velocity_gain
            gap = ops.clip(gap, -reach, reach)
            ideal = velocity + gap
        rate = ops.where_or_zero(ops.logical_not(tracking.fault), self.feedback(tracking))
        return IdealVelocityState(ideal + self.period * rate), self.ideal_velocity_gain * gap, {"ideal_velocity": ideal}
