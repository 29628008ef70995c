"""One joint under gravity."""

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.plants.euler_lagrange import EulerLagrange, joint_friction


@dataclass(frozen=True, kw_only=True, eq=False)
class Pendulum(EulerLagrange):
    """Actuated pendulum, q from hanging down: (m l² + J) q̈ + viscous q̇ + coulomb tanh(q̇/width) + m g l sin q = τ.

    Parameters
    ----------
    mass, length, rotor
        Point mass [kg] at the length [m], and the rotor's inertia [kg m²].
    viscous, coulomb, coulomb_width
        Friction [N m s/rad, N m, rad/s].
    gravity
        [m/s²].
    payload
        Mass added at the length [kg].
    """

    mass: float = 1.0
    length: float = 1.0
    rotor: float = 0.0
    viscous: float = 0.0
    coulomb: float = 0.0
    coulomb_width: float = 0.01
    gravity: float = 9.81
    payload: float = 0.0

    def validate(self) -> None:
        """Check the parameters."""
        for name in ("mass", "length", "coulomb_width"):
            check.number(name, getattr(self, name), 0, strict=True)
        for name in ("rotor", "viscous", "coulomb", "payload"):
            check.number(name, getattr(self, name), 0)
        check.number("gravity", self.gravity)

    @property
    def n_joints(self) -> int:
        """Return 1."""
        return 1

    def kinetic_energy(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return T = ½ (m l² + J) q̇² [J]."""
        return ((p.mass + p.payload) * p.length**2 + p.rotor) * dq**2 / 2

    def potential_energy(self, q: Vector, p: SimpleNamespace) -> Vector:
        """Return V = −m g l cos q [J]."""
        return -(p.mass + p.payload) * p.gravity * p.length * ca.cos(q)

    def dissipation(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return viscous and smoothed Coulomb friction [N m]."""
        return joint_friction(dq, p)
