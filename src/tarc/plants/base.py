"""What every plant offers: joints, parameters, and the inertia matrix for the certificates."""

from abc import ABC, abstractmethod
from typing import Any, Self

import numpy as np

from tarc import check
from tarc.errors import TarcError


class Plant(ABC):
    """A robot M(q) q̈ + N(q, q̇) = τ with n joints."""

    @property
    @abstractmethod
    def joints(self) -> int:
        """How many joints n."""

    @property
    @abstractmethod
    def joint_names(self) -> list[str]:
        """A name a joint."""

    @property
    def joint_units(self) -> list[str]:
        """``rad`` or ``m``, one a joint."""
        return ["rad"] * self.joints

    @property
    @abstractmethod
    def parameters(self) -> dict[str, np.ndarray]:
        """Physical parameters that a schedule may change while the robot runs, with their present values."""

    @abstractmethod
    def inertia(self, position: Any) -> np.ndarray:
        """M(q) [kg m² or kg] at a position (n,), shape (n, n)."""

    @abstractmethod
    def gravity_torque(self, position: Any) -> Any:
        """Torque [N m or N] that holds the robot at rest at a position (n,), shape (n,)."""

    @abstractmethod
    def with_parameters(self, values: dict[str, Any]) -> Self:
        """The same robot with other `parameters`, by name."""

    @abstractmethod
    def bias(self, position: Any, velocity: Any) -> np.ndarray:
        """N(q, q̇) without dry friction [N m or N], shape (n,)."""

    def at_rest(self, position: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """M, D and G of M δq̈ + D δq̇ + G δq = δτ, the robot linearised at rest without dry friction, each (n, n)."""
        q = check.vector("position", position, self.joints)
        still, step = np.zeros(self.joints), 1e-5
        nudges = step * np.eye(self.joints)
        stiffness = [(self.bias(q + d, still) - self.bias(q - d, still)) / (2 * step) for d in nudges]
        damping = [(self.bias(q, d) - self.bias(q, -d)) / (2 * step) for d in nudges]
        return self.inertia(q), np.column_stack(damping), np.column_stack(stiffness)

    @property
    def home(self) -> np.ndarray:
        """A posture to start from, shape (n,)."""
        return np.zeros(self.joints)

    def mean_inertia(self, positions: Any) -> np.ndarray:
        """Mean of M(q) over the columns of positions (n, k): the nominal inertia along a path, shape (n, n)."""
        columns = check.array("positions", positions)
        if columns.ndim != 2 or columns.shape[0] != self.joints:
            raise TarcError(f"positions: got shape {columns.shape}; needs ({self.joints}, k), a position a column")
        return np.mean([self.inertia(column) for column in columns.T], axis=0)
