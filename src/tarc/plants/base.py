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
