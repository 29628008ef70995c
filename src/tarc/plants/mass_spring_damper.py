"""A chain of masses."""

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.plants.euler_lagrange import EulerLagrange


@dataclass(frozen=True, kw_only=True, eq=False)
class MassSpringDamper(EulerLagrange):
    """Chain of masses on springs and dampers, a force on each: link i joins mass i to mass i−1, the first to a wall.

        m_i q̈_i + k_i (q_i − q_{i−1}) − k_{i+1} (q_{i+1} − q_i) + (the same with dampers) = τ_i

    Parameters
    ----------
    masses, springs, dampers
        [kg], [N/m], [N s/m], one of each per mass.
    payload
        Mass added to the last [kg].
    """

    masses: Numbers = (1.0,)
    springs: Numbers = (100.0,)
    dampers: Numbers = (1.0,)
    payload: float = 0.0

    def validate(self) -> None:
        """Check the parameters."""
        self.spread("masses", 0, strict=True)
        self.spread("springs", 0)
        self.spread("dampers", 0)
        check.number("payload", self.payload, 0)

    @property
    def n_joints(self) -> int:
        """Return the number of masses."""
        return np.size(self.masses)

    @property
    def units(self) -> list[str]:
        """Return ``m`` for each mass."""
        return ["m"] * self.n_joints

    def kinetic_energy(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return T = ½ Σ m_i q̇_i² [J]."""
        return ca.dot(p.masses, dq**2) / 2 + p.payload * dq[-1] ** 2 / 2

    def potential_energy(self, q: Vector, p: SimpleNamespace) -> Vector:
        """Return V = ½ Σ k_i (q_i − q_{i−1})² [J]."""
        stretch = q - ca.vertcat(0, q)[: self.n_joints]
        return ca.sum1(p.springs * stretch**2) / 2

    def dissipation(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return the damper forces [N]."""
        force = p.dampers * (dq - ca.vertcat(0, dq)[: self.n_joints])
        return force - ca.vertcat(force, 0)[1:]
