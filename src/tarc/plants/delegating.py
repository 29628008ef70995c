"""A plant that has the facts of another one."""

from abc import abstractmethod
from collections.abc import Mapping

from tarc.core.types import Array, Vector
from tarc.plants.base import Plant


class DelegatingPlant(Plant):
    """A plant with the joints, names, limits and home posture of another, and equations of its own."""

    @property
    @abstractmethod
    def facts(self) -> Plant:
        """Return the other plant."""

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return self.facts.n_joints

    @property
    def n_coordinates(self) -> int:
        """Return the number of coordinates m."""
        return self.facts.n_coordinates

    @property
    def driven(self) -> tuple[int, ...]:
        """Return the coordinate on which the torque of each joint acts."""
        return self.facts.driven

    @property
    def measured(self) -> tuple[int, ...]:
        """Return the coordinate that the encoder of each joint reads."""
        return self.facts.measured

    @property
    def coordinate_names(self) -> list[str]:
        """Return one name per coordinate."""
        return self.facts.coordinate_names

    @property
    def coordinate_units(self) -> list[str]:
        """Return the unit of each coordinate, ``rad`` or ``m``."""
        return self.facts.coordinate_units

    @property
    def constraints(self) -> list[str]:
        """Return what couples the coordinates beyond a tree of bodies, in words."""
        return self.facts.constraints

    def coordinates(self, position: Vector) -> Array:
        """Return all coordinates, shape (m,), with the joints at a position (n,)."""
        return self.facts.coordinates(position)

    @property
    def constraints_hint(self) -> str:
        """Return how to do without what couples the coordinates, for messages."""
        return self.facts.constraints_hint

    @property
    def passive_hint(self) -> str:
        """Return how to do without passive coordinates, for messages."""
        return self.facts.passive_hint

    @property
    def label(self) -> str:
        """Return the name in tables, figures and messages."""
        return self.facts.label

    @property
    def joint_names(self) -> list[str]:
        """Return one name per joint."""
        return self.facts.joint_names

    @property
    def units(self) -> list[str]:
        """Return the unit of each joint's position, ``rad`` or ``m``."""
        return self.facts.units

    @property
    def torque_limits(self) -> Array:
        """Return the largest torque of each joint [N m or N], shape (n,), infinite where there is no limit."""
        return self.facts.torque_limits

    @property
    def velocity_limits(self) -> Array:
        """Return the largest speed of each joint [rad/s or m/s], shape (n,), infinite where there is no limit."""
        return self.facts.velocity_limits

    @property
    def acceleration_limits(self) -> Array:
        """Return the largest acceleration of each joint [rad/s² or m/s²], shape (n,), infinite where unknown."""
        return self.facts.acceleration_limits

    @property
    def deceleration_limits(self) -> Array:
        """Return the largest deceleration of each joint [rad/s² or m/s²], shape (n,), infinite where unknown."""
        return self.facts.deceleration_limits

    @property
    def jerk_limits(self) -> Array:
        """Return the largest jerk of each joint [rad/s³ or m/s³], shape (n,), infinite where unknown."""
        return self.facts.jerk_limits

    @property
    def position_limits(self) -> Array:
        """Return the range of each joint [rad or m], shape (n, 2), infinite where there is no limit."""
        return self.facts.position_limits

    @property
    def home(self) -> Array:
        """Return a posture to start from [rad or m], shape (n,)."""
        return self.facts.home

    @property
    def locked(self) -> dict[str, str]:
        """Return why each locked joint is locked, by the joint's name."""
        return self.facts.locked

    @property
    def file_options(self) -> Mapping[str, object]:
        """Return the arguments of `load_robot` that read this robot again; empty for no file."""
        return self.facts.file_options

    @property
    def payload_place(self) -> str:
        """Return where the payload acts, for messages."""
        return self.facts.payload_place
