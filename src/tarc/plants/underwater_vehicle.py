"""An underwater vehicle with thrusters, upright in the water."""

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.plants.euler_lagrange import EulerLagrange

YAW_SHARE = 0.2
"""Share of each horizontal thruster that is kept for yaw, and of each vertical one for roll and pitch."""

YAW_ARM = 0.19
"""Lever of the horizontal thrusters about the vertical axis [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class UnderwaterVehicle(EulerLagrange):
    """Underwater vehicle, q = (x, y, z, ψ): position in the world [m], z down, and yaw [rad].

    With ν = R(ψ)ᵀ q̇ (surge, sway, heave, yaw), the velocity νr relative to the water, and the load m_l:

        T = ½ νᵀ (diag(m + m_l, m + m_l, m + m_l, I) + A) ν,    V = (ρ g Vol − (m + m_l) g) z
        F = R (D1 νr + D2 |νr| νr)

    These are Fossen's M_RB, M_A = A, C(ν), D(ν) and g(η) without roll and pitch, which buoyancy keeps at zero. Eight
    thrusters give forces along x, y, z and a torque about z. The defaults are those of a BlueROV2 Heavy.

    Parameters
    ----------
    mass, yaw_inertia
        [kg], and moment of inertia about the vertical [kg m²].
    added_mass
        In surge, sway, heave [kg] and yaw [kg m²], positive.
    linear_drag, quadratic_drag
        In surge, sway, heave and yaw [N s/m, N m s/rad; N s²/m², N m s²/rad²].
    volume, water_density, gravity
        Displaced volume [m³], [kg/m³], [m/s²].
    current
        Velocity of the water in the world [m/s], (3,). It acts through the drag; that of the added mass is neglected.
    payload
        Mass of a compact load at the centre [kg].
    heading
        Yaw that an autopilot of its own holds [rad]. The vehicle then has the three joints x, y and z. None for yaw
        as the fourth joint. A schedule that turns it neglects the Coriolis forces of the turn.
    thrust
        Largest force of each thruster [N], for the limits: ``torque_limits`` can be had in every direction at once.

    References
    ----------
    T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2011, Chapters 6 and 8. Parameters: M. von
    Benzon et al., J. Marine Science and Engineering 10(12), 1898, 2022.
    """

    mass: float = 13.5
    yaw_inertia: float = 0.37
    added_mass: Numbers = (6.36, 7.12, 18.68, 0.222)
    linear_drag: Numbers = (13.7, 0.0, 33.0, 0.0)
    quadratic_drag: Numbers = (141.0, 217.0, 190.0, 1.5)
    volume: float = 0.0134
    water_density: float = 1000.0
    gravity: float = 9.82
    current: Numbers = (0.0, 0.0, 0.0)
    payload: float = 0.0
    heading: float | None = None
    thrust: float = 40.0

    def validate(self) -> None:
        """Check the parameters."""
        for name in ("mass", "yaw_inertia", "thrust"):
            check.number(name, getattr(self, name), 0, strict=True)
        for name in ("volume", "water_density", "payload"):
            check.number(name, getattr(self, name), 0)
        check.number("gravity", self.gravity)
        for name in ("added_mass", "linear_drag", "quadratic_drag"):
            values = check.vector(name, getattr(self, name), 4, 0)
            object.__setattr__(self, name, tuple(values.tolist()))
        object.__setattr__(self, "current", tuple(check.vector("current", self.current, 3).tolist()))
        if self.heading is not None:
            check.number("heading", self.heading)

    @property
    def n_joints(self) -> int:
        """Return 4, or 3 where the heading is held."""
        return 4 if self.heading is None else 3

    @property
    def joint_names(self) -> list[str]:
        """Return the names of the coordinates."""
        return ["x", "y", "z", "yaw"][: self.n_joints]

    @property
    def units(self) -> list[str]:
        """Return metres, and radians for yaw."""
        return ["m", "m", "m", "rad"][: self.n_joints]

    @property
    def parameters(self) -> dict[str, np.ndarray]:
        """Return the physical parameters, with the heading where it is held."""
        left_out = {"thrust"} | ({"heading"} if self.heading is None else set())
        return {name: value for name, value in super().parameters.items() if name not in left_out}

    @property
    def torque_limits(self) -> np.ndarray:
        """Return the largest forces [N] and the torque about z [N m] that can be had at once, whatever the heading.

        Of the four horizontal thrusters at 45°, a share s is kept for yaw: √2 (1 − s) f along x and y, and 4 s f l
        about z. The four vertical ones give 4 (1 − s) f.
        """
        planar = np.sqrt(2) * (1 - YAW_SHARE) * self.thrust
        vertical = 4 * (1 - YAW_SHARE) * self.thrust
        yaw = 4 * YAW_SHARE * self.thrust * YAW_ARM
        return np.array([planar, planar, vertical, yaw])[: self.n_joints]

    def _rotation(self, q: Vector, p: SimpleNamespace) -> Vector:
        """Return R(ψ) from the vehicle to the world, (n, n)."""
        yaw = q[3] if self.heading is None else p.heading
        rotation = ca.SX.eye(self.n_joints)
        rotation[0, 0] = rotation[1, 1] = ca.cos(yaw)
        rotation[1, 0] = ca.sin(yaw)
        rotation[0, 1] = -ca.sin(yaw)
        return rotation

    def kinetic_energy(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return T of the vehicle and of the water that it carries along [J]."""
        n = self.n_joints
        velocity = self._rotation(q, p).T @ dq
        mass = p.mass + p.payload
        inertia = ca.vertcat(mass, mass, mass, p.yaw_inertia)[:n] + p.added_mass[:n]
        return ca.dot(inertia * velocity, velocity) / 2

    def potential_energy(self, q: Vector, p: SimpleNamespace) -> Vector:
        """Return V of buoyancy and weight, with z down [J]."""
        return (p.water_density * p.volume - p.mass - p.payload) * p.gravity * q[2]

    def dissipation(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return linear and quadratic drag [N, N m] of the velocity relative to the water."""
        n = self.n_joints
        rotation = self._rotation(q, p)
        relative = rotation.T @ (dq - ca.vertcat(p.current, 0)[:n])
        return rotation @ (p.linear_drag[:n] * relative + p.quadratic_drag[:n] * ca.fabs(relative) * relative)
