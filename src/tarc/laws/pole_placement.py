"""Pole placement scaled by an inertia: the base of most laws."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.types import Vector
from tarc.core.validation import Matrix, Numbers
from tarc.laws.base import ControlInput, Law
from tarc.laws.nominal_inertia import NominalInertia


@dataclass(frozen=True, kw_only=True, eq=False)
class PolePlacement(Law):
    """A law that commands the acceleration which places the poles of the error, times an inertia.

        u = q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + …,     τ = M̂ u + …,     e1 = q − qᵈ

    Parameters
    ----------
    inertia
        M̂ [kg m² or kg], symmetric positive definite: a matrix, a vector for a diagonal, or one number for one joint. A
        law on time-delay estimation also takes a `NominalInertia`, the M̂(q) of a model.
    natural_frequency, damping_ratio
        ωn [rad/s] and ζ, one number or one per joint: K1 = ωn², K2 = 2 ζ ωn.
    position_gain, velocity_gain
        K1 [1/s²] and K2 [1/s] themselves, instead: one number, one per joint, or a matrix; A must be Hurwitz, as it
        is whenever both are symmetric positive definite.

    Raises
    ------
    InvalidParameter
        For an M̂ that is not positive definite, and gains that leave A = [0 I; −K1 −K2] not Hurwitz.
    """

    inertia: Matrix | NominalInertia
    natural_frequency: Numbers | None = None
    damping_ratio: Numbers = 1.0
    position_gain: Matrix | None = None
    velocity_gain: Matrix | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.inertia, NominalInertia) and not self.accepts_nominal_inertia:
            raise InvalidParameter(
                f"inertia: got a NominalInertia; {type(self).__name__} takes a constant M̂. M̂(q) is for laws on "
                "time-delay estimation, such as tarc.laws.TDC",
                "inertia",
            )
        _ = self.command_inertia
        growth = float(np.max(np.linalg.eigvals(self.A).real))
        if growth >= 0:
            raise InvalidParameter(
                f"position_gain, velocity_gain: A = [0 I; -K1 -K2] is not Hurwitz, an eigenvalue has real part "
                f"{growth:.3g}; "
                "give a natural frequency instead, or symmetric positive definite K1 and K2"
            )

    @property
    def n_joints(self) -> int:
        """Return the number of joints n, the size of the inertia."""
        if isinstance(self.inertia, NominalInertia):
            return self.inertia.model.n_joints
        return max((1, *np.shape(check.float_array("inertia", self.inertia))))

    @cached_property
    def M(self) -> np.ndarray:
        """Return the constant M̂, shape (n, n).

        Raises
        ------
        UnsupportedLaw
            For M̂(q), which changes with the posture.
        """
        if isinstance(self.inertia, NominalInertia):
            raise UnsupportedLaw(
                f"inertia: {type(self).__name__} has M̂(q) from a model, and a constant M̂ is needed here; give the "
                "inertia as numbers, or as a fraction without a model"
            )
        return check.positive_definite("inertia", self.inertia, self.n_joints)

    @cached_property
    def M_inverse(self) -> np.ndarray:
        """Return the inverse of the constant M̂, shape (n, n).

        Raises
        ------
        UnsupportedLaw
            For M̂(q), which changes with the posture.
        """
        return np.linalg.inv(self.M)

    @property
    def accepts_nominal_inertia(self) -> bool:
        """Return whether the inertia may be a `NominalInertia`."""
        return False

    @property
    def command_inertia(self) -> np.ndarray:
        """Return what multiplies the auxiliary input in `control`, shape (n, n): M̂, or I for M̂(q).

        With M̂(q) the equation of a law gives an acceleration, from which follows the torque.
        """
        return np.eye(self.n_joints) if isinstance(self.inertia, NominalInertia) else self.M

    def inertia_at(self, position: Vector) -> Vector:
        """Return M̂ at a posture (n,), shape (n, n)."""
        return self.inertia.at(position) if isinstance(self.inertia, NominalInertia) else self.M

    @cached_property
    def K1(self) -> np.ndarray:
        """Return the position gain K1 [1/s²], shape (n, n)."""
        if self.position_gain is not None:
            if self.natural_frequency is not None:
                raise InvalidParameter(
                    "natural_frequency, position_gain: both are given; K1 = natural_frequency², so give one of them"
                )
            return check.square("position_gain", self.position_gain, self.n_joints)
        return np.diag(self._omega**2)

    @cached_property
    def K2(self) -> np.ndarray:
        """Return the velocity gain K2 [1/s], shape (n, n)."""
        if self.velocity_gain is not None:
            if np.any(np.asarray(self.damping_ratio) != 1.0):
                raise InvalidParameter(
                    "damping_ratio, velocity_gain: both are given; K2 = 2 damping_ratio natural_frequency, so give "
                    "one of them"
                )
            return check.square("velocity_gain", self.velocity_gain, self.n_joints)
        zeta = check.vector("damping_ratio", self.damping_ratio, self.n_joints, 0, strict=True)
        return np.diag(2 * zeta * self._omega)

    @cached_property
    def _omega(self) -> np.ndarray:
        if self.natural_frequency is None:
            raise InvalidParameter(
                "natural_frequency: missing; give it [rad/s], or both position_gain and velocity_gain"
            )
        return check.vector("natural_frequency", self.natural_frequency, self.n_joints, 0, strict=True)

    @property
    def A(self) -> np.ndarray:
        """Return the nominal error dynamics ė = A e, A = [0 I; −K1 −K2], shape (2n, 2n)."""
        n = self.n_joints
        return np.block([[np.zeros((n, n)), np.eye(n)], [-self.K1, -self.K2]])

    @property
    def P2(self) -> np.ndarray | None:
        """Return the weight of the error in the robust term, s = P2 e1, shape (n, n); None for a law without one."""
        return None

    @property
    def has_model(self) -> bool:
        """Return whether the torque has a term N̂(q, v̂) of a model beside M̂ u."""
        return False

    def without_model(self) -> Self:
        """Return this law with N̂ = 0."""
        return self

    def single_joint(self, position_gain: float, velocity_gain: float, P2: float | None = None) -> Self:
        """Return this law for one joint with M̂ = 1 kg m², N̂ = 0 and no torque limit.

        Parameters
        ----------
        position_gain, velocity_gain
            K1 [1/s²] and K2 [1/s] of the joint.
        P2
            Weight of the error in the robust term, s = P2 e1, for a law that has one; None for its default.
        """
        return replace(self.without_model(), **self._single_joint_parameters(position_gain, velocity_gain, P2))

    def _single_joint_parameters(self, position_gain: float, velocity_gain: float, P2: float | None) -> dict[str, Any]:
        """Return the parameters in which `single_joint` differs from this law."""
        return {
            "inertia": 1.0,
            "natural_frequency": None,
            "damping_ratio": 1.0,
            "position_gain": position_gain,
            "velocity_gain": velocity_gain,
            "torque_limit": None,
            "safe_torque": "zero",
        }

    def feedback(self, tracking: ControlInput) -> Vector:
        """Return q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 [rad/s² or m/s²], shape (n,)."""
        return tracking.acceleration_reference - self.K2 @ tracking.error_rate - self.K1 @ tracking.error
