"""A differential-drive mobile robot, reduced to its two wheels."""

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.plants.euler_lagrange import EulerLagrange, joint_friction


@dataclass(frozen=True, kw_only=True, eq=False)
class WheeledMobileRobot(EulerLagrange):
    """Nonholonomic mobile robot with two driven wheels, q = (θ_right, θ_left), rolling without slip.

    With forward speed v = r (θ̇_r + θ̇_l)/2 and turning rate ω = r (θ̇_r − θ̇_l)/(2b), the centre of mass a distance d
    ahead of the axle, the reduced equations are

        m v̇ − m d ω² = F,     (I + m d²) ω̇ + m d v ω = torque

    mapped to the wheels. The terms in m d do no work; they come from the rolling constraint and not from the
    kinetic energy, hence a gyroscopic matrix.

    Parameters
    ----------
    mass, inertia_body
        Of the body [kg], and its moment of inertia about its centre of mass [kg m²].
    wheel_radius, half_track, offset
        r, b and d [m].
    wheel_inertia
        Of each wheel with its rotor, about its axle [kg m²].
    viscous, coulomb, coulomb_width
        Friction of each wheel, rolling resistance included [N m s/rad, N m, rad/s].
    payload
        Mass carried over the axle [kg].

    References
    ----------
    R. Fierro and F. L. Lewis, J. Robotic Systems 14(3), 1997, for the reduction; the platform is the kind that
    S. Roy et al., Int. J. Control Autom. Syst. 13(4), 2015, ran, with the parameters of a Pioneer 3-DX sized robot.
    """

    mass: float = 17.0
    inertia_body: float = 0.54
    wheel_radius: float = 0.095
    half_track: float = 0.165
    offset: float = 0.05
    wheel_inertia: float = 0.01
    viscous: Numbers = (0.02, 0.02)
    coulomb: Numbers = (0.2, 0.2)
    coulomb_width: float = 0.05
    payload: float = 0.0

    def validate(self) -> None:
        """Check the parameters."""
        for name in ("mass", "inertia_body", "wheel_radius", "half_track", "wheel_inertia", "coulomb_width"):
            check.number(name, getattr(self, name), 0, strict=True)
        check.number("offset", self.offset)
        self.spread("viscous", 0)
        self.spread("coulomb", 0)
        check.number("payload", self.payload, 0)

    @property
    def n_joints(self) -> int:
        """Return 2, the wheels."""
        return 2

    @property
    def joint_names(self) -> list[str]:
        """Return the names, right before left."""
        return ["right_wheel", "left_wheel"]

    def _twist(self, p: SimpleNamespace) -> Vector:
        """Return S with (v, ω) = S θ̇, shape (2, 2)."""
        r, b = p.wheel_radius, p.half_track
        return ca.vertcat(ca.horzcat(r / 2, r / 2), ca.horzcat(r / (2 * b), -r / (2 * b)))

    def kinetic_energy(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return T = ½ m v² + ½ (I + m d²) ω² + ½ J (θ̇_r² + θ̇_l²) [J]."""
        v, w = ca.vertsplit(self._twist(p) @ dq)
        body = (p.mass + p.payload) * v**2 + (p.inertia_body + p.mass * p.offset**2) * w**2
        return (body + p.wheel_inertia * ca.sumsqr(dq)) / 2

    def potential_energy(self, q: Vector, p: SimpleNamespace) -> Vector:
        """Return zero, since the floor is level."""
        return 0 * q[0]

    def gyroscopic(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return Sᵀ [0 −m d ω; m d ω 0] S."""
        S = self._twist(p)
        w = (S @ dq)[1]
        turn = p.mass * p.offset * w
        return S.T @ ca.vertcat(ca.horzcat(0, -turn), ca.horzcat(turn, 0)) @ S

    def dissipation(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return viscous and smoothed Coulomb friction [N m]."""
        return joint_friction(dq, p)
