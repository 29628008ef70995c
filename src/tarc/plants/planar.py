"""Planar serial arms: two links, or any number."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.plants.euler_lagrange import EulerLagrange, joint_friction


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanarArm(EulerLagrange):
    """Energies of a planar serial arm in relative joint angles, the first from the horizontal.

    With absolute angles φ_i = q_1 + … + q_i, link i has its centre of mass at p_{i−1} + c_i (cos φ_i, sin φ_i) and
    its end at p_i = p_{i−1} + l_i (cos φ_i, sin φ_i):

        T = ½ Σ (m_i |ċ_i|² + I_i φ̇_i²) + ½ m_L |ṗ_n|²,   V = g (Σ m_i c_{i,y} + m_L p_{n,y})

    Friction torque: viscous q̇ + coulomb tanh(q̇ / coulomb_width).
    """

    masses: Numbers
    lengths: Numbers
    centres: Numbers
    inertias: Numbers
    viscous: Numbers = 0.0
    coulomb: Numbers = 0.0
    coulomb_width: float = 0.01
    gravity: float = 9.81
    payload: float = 0.0

    def validate(self) -> None:
        """Check the parameters."""
        for name in ("masses", "lengths"):
            self.spread(name, 0, strict=True)
        for name in ("inertias", "viscous", "coulomb"):
            self.spread(name, 0)
        self.spread("centres")
        check.number("coulomb_width", self.coulomb_width, 0, strict=True)
        check.number("gravity", self.gravity)
        check.number("payload", self.payload, 0)

    @property
    def n_joints(self) -> int:
        """Return the number of links."""
        return np.size(self.masses)

    def kinetic_energy(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return T [J].

        A point that moves with Σ_j w_j φ̇_j (−sin φ_j, cos φ_j) has the squared speed Σ_jk w_j w_k φ̇_j φ̇_k cos(φ_j −
        φ_k). In this form CasADi finds the independence of q_1.
        """
        rate = ca.cumsum(dq)

        def squared_speed(w: list[Any]) -> Vector:
            squares = sum((w[j] * rate[j]) ** 2 for j in range(len(w)))
            pairs = [(j, k) for j in range(len(w)) for k in range(j)]
            return squares + 2 * sum(
                w[j] * w[k] * rate[j] * rate[k] * ca.cos(ca.sum1(q[k + 1 : j + 1])) for j, k in pairs
            )

        energy = p.payload * squared_speed([p.lengths[j] for j in range(self.n_joints)]) / 2
        for i in range(self.n_joints):
            centre = [*(p.lengths[j] for j in range(i)), p.centres[i]]
            energy += (p.masses[i] * squared_speed(centre) + p.inertias[i] * rate[i] ** 2) / 2
        return energy

    def potential_energy(self, q: Vector, p: SimpleNamespace) -> Vector:
        """Return V [J]."""
        angle = ca.cumsum(q)
        height = moment = ca.SX(0)
        for i in range(self.n_joints):
            moment += p.masses[i] * (height + p.centres[i] * ca.sin(angle[i]))
            height += p.lengths[i] * ca.sin(angle[i])
        return p.gravity * (moment + p.payload * height)

    def dissipation(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return viscous and smoothed Coulomb friction [N m]."""
        return joint_friction(dq, p)


@dataclass(frozen=True, kw_only=True, eq=False)
class TwoLinkArm(PlanarArm):
    """Two-link planar arm in the vertical plane; by default two point masses of 1 kg on links of 1 m.

    Parameters
    ----------
    masses, lengths, centres, inertias
        Of each link: mass [kg], length [m], distance of the centre of mass from the joint [m], moment of inertia
        about it [kg m²]. Point masses at the ends are ``centres=lengths, inertias=(0, 0)``.
    viscous, coulomb, coulomb_width
        Friction torque viscous·q̇ + coulomb·tanh(q̇/coulomb_width) [N m s/rad, N m, rad/s].
    gravity
        [m/s²]; 0 for an arm in the horizontal plane.
    payload
        Point mass at the tip [kg].

    References
    ----------
    J.-J. Slotine and W. Li, Applied Nonlinear Control, 1991, Section 9.1.
    """

    masses: Numbers = (1.0, 1.0)
    lengths: Numbers = (1.0, 1.0)
    centres: Numbers = (1.0, 1.0)
    inertias: Numbers = (0.0, 0.0)

    def validate(self) -> None:
        """Check the parameters."""
        if np.size(self.masses) != 2:
            raise InvalidParameter(f"masses: got {self.masses!r}; a two-link arm has 2. For more use NLinkArm")
        super().validate()


@dataclass(frozen=True, kw_only=True, eq=False)
class NLinkArm(PlanarArm):
    """Planar arm of any number of links in the vertical plane; by default three uniform rods of 1 kg and 0.5 m.

    Parameters
    ----------
    masses, lengths, centres, inertias, viscous, coulomb, coulomb_width, gravity, payload
        As in `TwoLinkArm`, one per link.
    """

    masses: Numbers = (1.0, 1.0, 1.0)
    lengths: Numbers = (0.5, 0.5, 0.5)
    centres: Numbers = (0.25, 0.25, 0.25)
    inertias: Numbers = (1 / 48, 1 / 48, 1 / 48)
