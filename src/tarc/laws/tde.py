"""The core that laws with time-delay estimation share; robust terms plug into it."""

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tarc import check, ops
from tarc.check import Matrix, Numbers
from tarc.errors import TarcError
from tarc.laws.base import Law, Tracking


class TDEState(NamedTuple):
    """Past torques (delayed or averaged), past acceleration estimates (n, m), the robust term's state."""

    torque: Any
    acceleration: Any
    robust: Any


@dataclass(frozen=True, kw_only=True, eq=False)
class TDE(Law):
    """Time-delay estimation with pole placement and a robust term Δu.

        τ = M̂ (u − â_h) + τ_h,     u = q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + Δu,     e1 = q − qᵈ

    The torque and the acceleration of an instant ago stand for all that is not modelled: N̂ = τ_h − M̂ â_h.

    Parameters
    ----------
    inertia
        M̂ [kg m² or kg], symmetric positive definite: a matrix, a vector for a diagonal, or one number for one joint.
        Not a model but a gain: with estimated acceleration the loop is stable only while the eigenvalues of M(q)⁻¹M̂
        stay in an interval that the window sets, often well below one.
    bandwidth, damping
        ωn [rad/s] and ζ, one number or one a joint: K1 = ωn², K2 = 2 ζ ωn.
    stiffness, viscosity
        K1 [1/s²] and K2 [1/s] themselves, instead: one number, one a joint, or a matrix; A must be Hurwitz, as it
        is whenever both are symmetric positive definite.
    delay
        h [s], a whole multiple of the period; None for one period. Where it and the actuation delay together are an
        even number of periods, a literal law never damps a torque that alternates from period to period, since no
        sampled position shows it.
    synchronised
        Average the past torques with the weights that pair with the estimator's window instead of taking τ_h alone.
        It keeps the torque and the acceleration in step, so that a far larger M̂ is stable.

    Raises
    ------
    TarcError
        For an M̂ that is not positive definite, gains that leave A = [0 I; −K1 −K2] not Hurwitz, an estimator
        without acceleration, or a delay that is no multiple of the period.
    """

    inertia: Matrix
    bandwidth: Numbers | None = None
    damping: Numbers = 1.0
    stiffness: Matrix | None = None
    viscosity: Matrix | None = None
    delay: float | None = None
    synchronised: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.M
        if self.estimator.orders < 2:
            raise TarcError(
                f"estimator: {self.estimator} gives no acceleration, which time-delay estimation needs; use degree 2 "
                "or more"
            )
        if self.delay_periods != 1 and self.synchronised:
            raise TarcError(
                f"delay: got {self.delay} s with synchronised=True, whose averaged torque has the window's own delay; "
                "leave the delay out, or use synchronised=False"
            )
        growth = float(np.max(np.linalg.eigvals(self.A).real))
        if growth >= 0:
            raise TarcError(
                f"stiffness, viscosity: A = [0 I; -K1 -K2] is not Hurwitz, an eigenvalue has real part {growth:.3g}; "
                "give a bandwidth instead, or symmetric positive definite K1 and K2"
            )

    @property
    def joints(self) -> int:
        """How many joints n it drives, told by the inertia."""
        return max((1, *np.shape(check.numbers("inertia", self.inertia))))

    @cached_property
    def M(self) -> np.ndarray:
        """M̂, shape (n, n)."""
        return check.definite("inertia", self.inertia, self.joints)

    @cached_property
    def K1(self) -> np.ndarray:
        """Stiffness [1/s²], shape (n, n)."""
        if self.stiffness is not None:
            if self.bandwidth is not None:
                raise TarcError("bandwidth, stiffness: both are given; K1 = bandwidth², so give one of them")
            return check.square("stiffness", self.stiffness, self.joints)
        return np.diag(self._omega**2)

    @cached_property
    def K2(self) -> np.ndarray:
        """Viscosity [1/s], shape (n, n)."""
        if self.viscosity is not None:
            if np.any(np.asarray(self.damping) != 1.0):
                raise TarcError("damping, viscosity: both are given; K2 = 2 damping bandwidth, so give one of them")
            return check.square("viscosity", self.viscosity, self.joints)
        zeta = check.vector("damping", self.damping, self.joints, 0, strict=True)
        return np.diag(2 * zeta * self._omega)

    @cached_property
    def _omega(self) -> np.ndarray:
        if self.bandwidth is None:
            raise TarcError("bandwidth: missing; give it [rad/s], or both stiffness and viscosity")
        return check.vector("bandwidth", self.bandwidth, self.joints, 0, strict=True)

    @property
    def A(self) -> np.ndarray:
        """Nominal error dynamics ė = A e, A = [0 I; −K1 −K2], shape (2n, 2n)."""
        n = self.joints
        return np.block([[np.zeros((n, n)), np.eye(n)], [-self.K1, -self.K2]])

    @property
    def delay_periods(self) -> int:
        """The delay h in periods."""
        return 1 if self.delay is None else check.multiple("delay", self.delay, self.period)

    @abstractmethod
    def robust_init(self) -> Any:
        """State of the robust term before the first step."""

    @abstractmethod
    def robust(self, state: Any, tracking: Tracking) -> tuple[Any, Any, dict[str, Any]]:
        """Next state, Δu [rad/s² or m/s²] of shape (n,), signals to record."""

    def memory(self, torque: np.ndarray) -> TDEState:
        """Rest: no acceleration, the torque applied all along."""
        past = np.zeros((self.joints, self.delay_periods))
        if self.synchronised:
            return TDEState(self.estimator.torque_average().init(torque), past, self.robust_init())
        return TDEState(past + torque[:, None], past, self.robust_init())

    def control(self, memory: TDEState, tracking: Tracking) -> tuple[TDEState, Any, dict[str, Any]]:
        """τ = M̂ (u − â_h) + τ_h."""
        newest = tracking.estimate.acceleration
        if self.synchronised:
            torques, past_torque = self.estimator.torque_average().step(memory.torque, tracking.past_torque)
            past_acceleration = newest
        else:
            torques = ops.push(memory.torque, tracking.past_torque)
            past_torque = torques[:, -1]
            past_acceleration = memory.acceleration[:, -1]
        robust, correction, signals = self.robust(memory.robust, tracking)
        u = tracking.acceleration_reference - self.K2 @ tracking.error_rate - self.K1 @ tracking.error + correction
        torque = self.M @ (u - past_acceleration) + past_torque
        accelerations = ops.push(memory.acceleration, newest)
        return TDEState(torques, accelerations, robust), torque, {"auxiliary": u, **signals}
