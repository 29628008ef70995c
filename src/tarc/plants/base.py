"""Contract of a plant: joints, limits, parameters, inertia matrix and linearisation."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.units import unit_for_joints
from tarc.core.validation import Numbers, Table


class Plant(ABC):
    """A robot M(q) q̈ + N(q, q̇) = τ with n joints."""

    @property
    @abstractmethod
    def n_joints(self) -> int:
        """Return the number of joints n."""

    @property
    def label(self) -> str:
        """Return the name in tables, figures and messages; by default that of the class."""
        return type(self).__name__

    @property
    def joint_names(self) -> list[str]:
        """Return one name per joint; by default ``joint1``, ``joint2``, …"""
        return [f"joint{i + 1}" for i in range(self.n_joints)]

    @property
    def units(self) -> list[str]:
        """Return the unit of each joint's position, ``rad`` or ``m``; by default all ``rad``."""
        return ["rad"] * self.n_joints

    @property
    def torque_units(self) -> list[str]:
        """Return the unit of each joint's torque or force, ``N m`` or ``N``."""
        return [unit_for_joints("N m", [unit]) for unit in self.units]

    @property
    def torque_limits(self) -> np.ndarray:
        """Return the largest torque of each joint [N m or N], shape (n,), infinite where there is no limit."""
        return np.full(self.n_joints, np.inf)

    @property
    def velocity_limits(self) -> np.ndarray:
        """Return the largest speed of each joint [rad/s or m/s], shape (n,), infinite where there is no limit."""
        return np.full(self.n_joints, np.inf)

    @property
    def position_limits(self) -> np.ndarray:
        """Return the range of each joint [rad or m], shape (n, 2), infinite where there is no limit."""
        return np.tile([-np.inf, np.inf], (self.n_joints, 1))

    @property
    def locked(self) -> dict[str, str]:
        """Return why each locked joint is locked, by the joint's name; by default no joint is locked."""
        return {}

    @property
    def file_options(self) -> Mapping[str, object]:
        """Return the arguments of `load_robot` that read this robot again; empty for no file."""
        return {}

    @property
    def payload_place(self) -> str:
        """Return where the payload acts, for messages."""
        return "as the robot's parameter"

    @property
    @abstractmethod
    def parameters(self) -> dict[str, np.ndarray]:
        """Return the physical parameters that a schedule may change during a run, with their present values."""

    @abstractmethod
    def inertia(self, position: Numbers) -> np.ndarray:
        """Return M(q) [kg m² or kg] at a position (n,), shape (n, n)."""

    @abstractmethod
    def gravity_torque(self, position: Vector) -> Vector:
        """Return the torque [N m or N] that keeps the robot at rest at a position (n,), shape (n,)."""

    @abstractmethod
    def with_parameters(self, values: dict[str, Any]) -> Self:
        """Return the same robot with other `parameters`, by name."""

    @abstractmethod
    def bias(self, position: Numbers, velocity: Numbers) -> np.ndarray:
        """Return N(q, q̇) without dry friction [N m or N], shape (n,)."""

    def linearised(
        self, position: Numbers, velocity: Numbers | None = None, acceleration: Numbers | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return M, D and G of M δq̈ + D δq̇ + G δq = δτ, the linearisation about a motion without dry friction.

            M = M(q),    D = ∂N/∂q̇,    G = ∂(M(q) q̈ + N)/∂q,    each (n, n)

        Velocity (n,) and acceleration (n,) are zero by default.
        """
        q, v, a = self._motion(position, velocity, acceleration)
        step, units = 1e-5, np.eye(self.n_joints)

        def torque(posture: np.ndarray) -> np.ndarray:
            return self.inertia(posture) @ a + self.bias(posture, v)

        stiffness = [(torque(q + step * d) - torque(q - step * d)) / (2 * step) for d in units]
        return self.inertia(q), self.damping(q, v), np.column_stack(stiffness)

    def damping(self, position: Numbers, velocity: Numbers | None = None) -> np.ndarray:
        """Return D = ∂N/∂q̇ without dry friction [N m s/rad or N s/m], shape (n, n); by default at rest."""
        q, v, _ = self._motion(position, velocity, None)
        columns = [(self.bias(q, v + d) - self.bias(q, v - d)) / 2 for d in np.eye(self.n_joints)]  # quadratic in q̇
        return np.column_stack(columns)

    def _motion(
        self, position: Numbers, velocity: Numbers | None, acceleration: Numbers | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return all three, each (n,), zero where None is given."""
        still = np.zeros(self.n_joints)
        return (
            check.vector("position", position, self.n_joints),
            still if velocity is None else check.vector("velocity", velocity, self.n_joints),
            still if acceleration is None else check.vector("acceleration", acceleration, self.n_joints),
        )

    @property
    def home(self) -> np.ndarray:
        """Return a posture to start from, shape (n,)."""
        return np.zeros(self.n_joints)

    def mean_inertia(self, positions: Numbers | Table) -> np.ndarray:
        """Return the mean of M(q) over the columns of positions (n, k): the nominal inertia along a path, shape (n,
        n)."""
        columns = check.array("positions", positions)
        if columns.ndim != 2 or columns.shape[0] != self.n_joints:
            raise InvalidParameter(
                f"positions: got shape {columns.shape}; needs ({self.n_joints}, k), one position per column"
            )
        return np.mean([self.inertia(column) for column in columns.T], axis=0)
