"""Contract of a plant: joints, limits, parameters, inertia matrix and linearisation."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Self

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array, Vector
from tarc.core.units import unit_for_joints
from tarc.core.validation import Numbers, Table

POSITION_STEP = 1e-5
"""Step of differences over a joint [rad or m]."""


class Plant(ABC):
    """A robot M(q) q̈ + N(q, q̇) = B τ with n joints.

    A law sees n joints: their positions, torques, limits and names. The equations may have more coordinates than that.
    Coordinates on which no torque acts are passive. B has a one for each joint, at the coordinate that its torque
    drives; it is the identity for a robot without passive coordinates.
    """

    @property
    @abstractmethod
    def n_joints(self) -> int:
        """Return the number of joints n."""

    @property
    def n_coordinates(self) -> int:
        """Return the number of coordinates m ≥ n of the equations; by default one per joint."""
        return self.n_joints

    @property
    def driven(self) -> tuple[int, ...]:
        """Return the coordinate on which the torque of each joint acts, n numbers from 0; by default the first n."""
        return tuple(range(self.n_joints))

    @property
    def measured(self) -> tuple[int, ...]:
        """Return the coordinate that the encoder of each joint reads, n numbers from 0; by default the driven one."""
        return self.driven

    @property
    def unmeasured(self) -> tuple[int, ...]:
        """Return the coordinates that no encoder reads, m − n numbers from 0."""
        return tuple(i for i in range(self.n_coordinates) if i not in self.measured)

    @property
    def is_fully_driven(self) -> bool:
        """Return whether the joints are all coordinates, in their order."""
        return self.driven == self.measured == tuple(range(self.n_coordinates))

    @property
    def coordinate_names(self) -> list[str]:
        """Return one name per coordinate; by default those of the joints, else ``coordinate1``, ``coordinate2``, …"""
        joints = dict(zip(self.measured, self.joint_names, strict=True))
        return [joints.get(i, f"coordinate{i + 1}") for i in range(self.n_coordinates)]

    @property
    def coordinate_units(self) -> list[str]:
        """Return the unit of each coordinate, ``rad`` or ``m``; by default those of the joints, else ``rad``."""
        joints = dict(zip(self.measured, self.units, strict=True))
        return [joints.get(i, "rad") for i in range(self.n_coordinates)]

    @property
    def passive_joints(self) -> list[str]:
        """Return the names of the coordinates on which no torque acts."""
        return [name for i, name in enumerate(self.coordinate_names) if i not in self.driven]

    @property
    def constraints(self) -> list[str]:
        """Return what couples the coordinates beyond a tree of bodies, in words; by default nothing."""
        return []

    def coordinates(self, position: Vector) -> np.ndarray:
        """Return all coordinates, shape (m,), with the joints at a position (n,); by default the others are zero."""
        values = np.zeros(self.n_coordinates)
        values[list(self.measured)] = position
        return values

    def require_fully_driven(self, purpose: str) -> None:
        """Refuse passive coordinates and constraints.

        Parameters
        ----------
        purpose
            What needs a torque on every coordinate, in words.

        Raises
        ------
        InvalidParameter
            For a plant with passive coordinates or constraints, with their names and the way out.
        """
        passive = self.passive_joints
        if self.constraints:
            raise InvalidParameter(
                f"plant: {purpose} needs joints that move independently, and {self.label} has "
                f"{' and '.join(self.constraints)}. {self.constraints_hint}",
                "robot",
            )
        if passive:
            joints = f"joint{'s' if len(passive) > 1 else ''} {', '.join(passive)}"
            raise InvalidParameter(
                f"plant: no torque acts on the {joints} of {self.label}, "
                f"and {purpose} needs one on every joint. {self.passive_hint}",
                "robot",
            )

    def holding_torque(self, coordinates: Vector) -> Vector:
        """Return the torque of the joints [N m or N], shape (n,), that keeps the robot at rest at coordinates (m,)."""
        return np.asarray(self.gravity_torque(coordinates))[list(self.driven)]

    @property
    def constraints_hint(self) -> str:
        """Return how to do without what couples the coordinates, for messages."""
        return "Simulate it only, or use a copy of the file without that"

    @property
    def passive_hint(self) -> str:
        """Return how to do without passive coordinates, for messages."""
        return "Use a plant without passive coordinates, such as one in which they are fixed"

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
    def command_gain(self) -> np.ndarray:
        """Return the torque per unit of what the law outputs, shape (n,); by default 1, for a law of torques."""
        return np.ones(self.n_joints)

    def in_torque_units(self) -> "Plant":
        """Return the same robot with torques as inputs; by default itself."""
        return self

    @property
    def torque_limits(self) -> np.ndarray:
        """Return the largest torque of each joint [N m or N], shape (n,), infinite where there is no limit."""
        return np.full(self.n_joints, np.inf)

    @property
    def velocity_limits(self) -> np.ndarray:
        """Return the largest speed of each joint [rad/s or m/s], shape (n,), infinite where there is no limit."""
        return np.full(self.n_joints, np.inf)

    @property
    def acceleration_limits(self) -> np.ndarray:
        """Return the largest acceleration of each joint [rad/s² or m/s²], shape (n,), infinite where unknown."""
        return np.full(self.n_joints, np.inf)

    @property
    def deceleration_limits(self) -> np.ndarray:
        """Return the largest deceleration of each joint [rad/s² or m/s²], shape (n,); by default its acceleration."""
        return self.acceleration_limits

    @property
    def jerk_limits(self) -> np.ndarray:
        """Return the largest jerk of each joint [rad/s³ or m/s³], shape (n,), infinite where unknown."""
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
        """Return M(q) [kg m² or kg] at the coordinates (m,), shape (m, m)."""

    @abstractmethod
    def gravity_torque(self, position: Vector) -> Vector:
        """Return the torque [N m or N] that keeps the robot at rest at the coordinates (m,), shape (m,)."""

    @abstractmethod
    def with_parameters(self, values: dict[str, Any]) -> Self:
        """Return the same robot with other `parameters`, by name."""

    @abstractmethod
    def bias(self, position: Numbers, velocity: Numbers) -> np.ndarray:
        """Return N(q, q̇) without dry friction [N m or N], shape (m,)."""

    def linearised(
        self, position: Numbers, velocity: Numbers | None = None, acceleration: Numbers | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return M, D and G of M δq̈ + D δq̇ + G δq = δτ, the linearisation about a motion without dry friction.

            M = M(q),    D = ∂N/∂q̇,    G = ∂(M(q) q̈ + N)/∂q,    each (m, m)

        Velocity (m,) and acceleration (m,) are zero by default.
        """
        q, v, a = self._motion(position, velocity, acceleration)

        def torque(posture: Array) -> Array:
            return self.inertia(posture) @ a + self.bias(posture, v)

        return self.inertia(q), self.damping(q, v), _differences(torque, q).T

    def linearised_at(self, positions: Array, velocities: Array, accelerations: Array) -> tuple[Array, Array, Array]:
        """Return M, D and G of `linearised` at k motions, the columns of arrays (m, k), each of shape (k, m, m)."""
        motions = zip(positions.T, velocities.T, accelerations.T, strict=True)
        M, D, G = zip(*(self.linearised(*motion) for motion in motions), strict=True)
        return np.array(M), np.array(D), np.array(G)

    def tangent_gradient(
        self, position: Numbers, weight: Array, velocity: Numbers | None = None, acceleration: Numbers | None = None
    ) -> Array:
        """Return ∂⟨W, [M, D, G]⟩/∂q of the matrices of `linearised`, shape (n,), for a weight W (n, 3n).

        By differences, unless a plant has its derivatives.
        """
        q, v, a = self._motion(position, velocity, acceleration)

        def value(posture: Array) -> float:
            return float(np.sum(weight * np.hstack(self.linearised(posture, v, a))))

        return _differences(value, q)

    def inertia_slopes(self, position: Numbers) -> Array:
        """Return ∂M/∂q_i, shape (n, n, n), the joint i first; by differences, unless a plant has its derivatives."""
        return _differences(self.inertia, check.vector("position", position, self.n_coordinates))

    def inertia_gradient(self, position: Numbers, weight: Array) -> Array:
        """Return ∂⟨W, M⟩/∂q, shape (n,), for a weight W (n, n)."""
        return np.tensordot(self.inertia_slopes(position), weight)

    def inertia_rate_gradient(self, position: Numbers, direction: Array, weight: Array) -> Array:
        """Return ∂⟨W, Σ d_i ∂M/∂q_i⟩/∂q, shape (n,), for a direction d (n,) and a weight W (n, n).

        By differences, unless a plant has its derivatives.
        """

        def value(posture: Array) -> float:
            return float(direction @ np.tensordot(self.inertia_slopes(posture), weight))

        return _differences(value, check.vector("position", position, self.n_coordinates))

    def damping(self, position: Numbers, velocity: Numbers | None = None) -> np.ndarray:
        """Return D = ∂N/∂q̇ without dry friction [N m s/rad or N s/m], shape (m, m); by default at rest."""
        q, v, _ = self._motion(position, velocity, None)
        columns = [
            (self.bias(q, v + d) - self.bias(q, v - d)) / 2 for d in np.eye(self.n_coordinates)
        ]  # quadratic in q̇
        return np.column_stack(columns)

    def _motion(
        self, position: Numbers, velocity: Numbers | None, acceleration: Numbers | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return all three, each (m,), zero where None is given."""
        m = self.n_coordinates
        still = np.zeros(m)
        return (
            check.vector("position", position, m),
            still if velocity is None else check.vector("velocity", velocity, m),
            still if acceleration is None else check.vector("acceleration", acceleration, m),
        )

    @property
    def home(self) -> np.ndarray:
        """Return a posture to start from, shape (n,)."""
        return np.zeros(self.n_joints)

    def joint_inertia(self, position: Numbers) -> np.ndarray:
        """Return the inertia that the torques of the joints accelerate at a position (n,), shape (n, n).

            (Bᵀ M⁻¹ B)⁻¹ = M_aa − M_ap M_pp⁻¹ M_pa

        for driven coordinates a and passive ones p that move freely. Without passive coordinates it is M(q).

        Raises
        ------
        InvalidParameter
            Where encoders read coordinates that no torque acts on.
        """
        if self.is_fully_driven:
            return self.inertia(position)
        if self.measured != self.driven:
            raise InvalidParameter(
                f"inertia: the torques of {self.label} do not act on what its encoders read, so it has no inertia at "
                "its joints; give the inertia of the law as numbers",
                "law.inertia",
            )
        places = list(self.driven)
        M = self.inertia(self.coordinates(check.vector("position", position, self.n_joints)))
        return np.linalg.inv(np.linalg.inv(M)[np.ix_(places, places)])

    def mean_inertia(self, positions: Numbers | Table) -> np.ndarray:
        """Return the mean of `joint_inertia` over the columns of positions (n, k), shape (n, n): the nominal inertia
        along a path."""
        columns = check.array("positions", positions)
        if columns.ndim != 2 or columns.shape[0] != self.n_joints:
            raise InvalidParameter(
                f"positions: got shape {columns.shape}; needs ({self.n_joints}, k), one position per column"
            )
        if self.is_fully_driven:
            return self.inertia_matrices(columns).mean(axis=0)
        return np.mean([self.joint_inertia(column) for column in columns.T], axis=0)

    def inertia_matrices(self, positions: Array) -> Array:
        """Return M(q) at the columns of coordinates (m, k), shape (k, m, m)."""
        return np.array([self.inertia(position) for position in positions.T])

    def biases(self, positions: Array, velocities: Array) -> Array:
        """Return N(q, q̇) of `bias` at the columns of arrays (m, k), shape (k, m)."""
        return np.array([self.bias(*state) for state in zip(positions.T, velocities.T, strict=True)])


def _differences(function: Callable[[Array], Array | float], position: Array) -> Array:
    """Return the derivatives of a function over each joint, the joint first, by central differences."""
    steps = POSITION_STEP * np.eye(len(position))
    return np.array([(function(position + d) - function(position - d)) / (2 * POSITION_STEP) for d in steps])
