"""A joint with a spring between motor and link."""

from dataclasses import dataclass, fields
from types import SimpleNamespace

import casadi as ca
import numpy as np

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.plants.euler_lagrange import EulerLagrange, joint_friction

SIDES = ("motor", "link")
"""Coordinates of the joint: the motor's angle behind the gear, and the link's from hanging down."""


NEWTON_STEPS = 30
"""Steps to the equilibrium of the link; a spring that holds its link needs five."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeriesElasticJoint(EulerLagrange):
    """Motor, spring and link under gravity, with the encoder on either side; θ of the motor, q of the link.

        J θ̈ + viscous θ̇ + coulomb tanh(θ̇/width) + d (θ̇ − q̇) + k (θ − q) = τ
        (I + m l²) q̈ + m g l sin q − d (θ̇ − q̇) − k (θ − q) = 0,    m = mass + payload

    The link is a passive coordinate. Gear and efficiency are included in J and τ.

    Parameters
    ----------
    motor_inertia
        J, of rotor and gear, on the side of the link [kg m²].
    spring_stiffness, spring_damping
        k and d of the spring [N m/rad, N m s/rad].
    mass, length, link_inertia
        Mass [kg] at the length l [m], and further moment of inertia I about the joint [kg m²].
    viscous, coulomb, coulomb_width
        Friction of motor and gear [N m s/rad, N m, rad/s].
    gravity
        [m/s²].
    payload
        Mass added at the length [kg].
    encoder
        The side that the encoder measures, ``motor`` or ``link``.

    References
    ----------
    G. A. Pratt and M. M. Williamson, Series elastic actuators, IROS 1995; M. W. Spong, J. Dynamic Systems,
    Measurement and Control 109(4), 1987, for the equations.
    """

    motor_inertia: float = 0.15
    spring_stiffness: float = 400.0
    spring_damping: float = 0.5
    mass: float = 1.5
    length: float = 0.3
    link_inertia: float = 0.02
    viscous: float = 0.5
    coulomb: float = 0.5
    coulomb_width: float = 0.05
    gravity: float = 9.81
    payload: float = 0.0
    encoder: str = "motor"

    def validate(self) -> None:
        """Check the parameters."""
        for name in ("motor_inertia", "spring_stiffness", "length", "coulomb_width"):
            check.number(name, getattr(self, name), 0, strict=True)
        for name in ("spring_damping", "mass", "link_inertia", "viscous", "coulomb", "payload"):
            check.number(name, getattr(self, name), 0)
        check.number("gravity", self.gravity)
        check.one_of("encoder", self.encoder, SIDES)

    @property
    def n_joints(self) -> int:
        """Return 1, the motor."""
        return 1

    @property
    def n_coordinates(self) -> int:
        """Return 2, motor and link."""
        return 2

    @property
    def measured(self) -> tuple[int, ...]:
        """Return the coordinate that the encoder reads."""
        return (SIDES.index(self.encoder),)

    @property
    def joint_names(self) -> list[str]:
        """Return the side that the encoder reads."""
        return [self.encoder]

    @property
    def coordinate_names(self) -> list[str]:
        """Return both sides."""
        return list(SIDES)

    @property
    def parameters(self) -> dict[str, np.ndarray]:
        """Return the physical parameters."""
        names = [field.name for field in fields(self) if field.name != "encoder"]
        return {name: np.array(getattr(self, name), dtype=float) for name in names}

    def coordinates(self, position: Vector) -> np.ndarray:
        """Return motor and link in equilibrium, where the encoder's side is at a position (1,)."""
        measured = float(np.ravel(position)[0])
        weight = (self.mass + self.payload) * self.gravity * self.length / self.spring_stiffness
        if self.encoder == "link":
            return np.array([measured + weight * np.sin(measured), measured])
        link = measured
        for _ in range(NEWTON_STEPS):
            link -= (link - measured + weight * np.sin(link)) / (1 + weight * np.cos(link))
        return np.array([measured, link])

    def kinetic_energy(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return T = ½ J θ̇² + ½ (I + m l²) q̇² [J]."""
        link = p.link_inertia + (p.mass + p.payload) * p.length**2
        return (p.motor_inertia * dq[0] ** 2 + link * dq[1] ** 2) / 2

    def potential_energy(self, q: Vector, p: SimpleNamespace) -> Vector:
        """Return V = ½ k (θ − q)² − m g l cos q [J]."""
        weight = (p.mass + p.payload) * p.gravity * p.length
        return p.spring_stiffness * (q[0] - q[1]) ** 2 / 2 - weight * ca.cos(q[1])

    def dissipation(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return friction of the motor, and damping of the spring on both sides [N m]."""
        spring = p.spring_damping * (dq[0] - dq[1])
        return ca.vertcat(joint_friction(dq[0], p) + spring, -spring)
