"""A robot in symbols, sampled: its motion over one period under a torque that is held."""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.system import System
from tarc.core.tracing import trace
from tarc.core.types import Vector
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant
from tarc.simulation.closed_loop import runge_kutta


class Motion(NamedTuple):
    """Position [rad or m] and velocity, each (n,)."""

    position: Vector
    velocity: Vector


@dataclass(frozen=True, eq=False)
class SampledPlant(System):
    """A robot under zero-order hold, integrated by classical Runge–Kutta steps.

    Parameters
    ----------
    plant
        A robot in symbols, with one torque for each coordinate.
    period
        T [s].
    substeps
        Runge–Kutta steps per period.

    Raises
    ------
    InvalidParameter
        For a robot in MuJoCo alone, or with coordinates that no torque drives.
    """

    plant: SymbolicPlant
    period: float
    substeps: int = 2

    def __post_init__(self) -> None:
        check.number("period", self.period, 0, strict=True)
        check.integer("substeps", self.substeps, 1)
        _symbolic(self.plant)

    @classmethod
    def from_robot(cls, plant: Plant, period: float, substeps: int = 2) -> "SampledPlant":
        """Return it for any robot, which must be one in symbols."""
        return cls(_symbolic(plant), period, substeps)

    def init(self, first: Vector) -> Motion:
        """Return the state at rest at a position (n,)."""
        position = check.vector("position", first, self.plant.n_joints)
        return Motion(position, np.zeros(self.plant.n_joints))

    def step(self, state: Motion, value: Vector) -> tuple[Motion, Vector]:
        """Return the state after a period with a torque (n,), and the position before it."""
        position, velocity = state
        torque = self.plant.joint_input(value, 0 * value)
        for _ in range(self.substeps):
            position, velocity, _ = runge_kutta(self.plant, position, velocity, torque, self.period / self.substeps, {})
        return Motion(position, velocity), state.position

    def function(self) -> ca.Function:
        """Return the traced step ``[state, torque] -> [next state, position]`` of packed vectors."""
        zero = np.zeros(self.plant.n_joints)
        function, _ = trace(self.step, self.init(zero), zero)
        return function


def _symbolic(plant: object) -> SymbolicPlant:
    """Return a robot in symbols whose joints are all driven; others are refused."""
    if not isinstance(plant, SymbolicPlant) or not plant.is_fully_driven:
        name = plant.label if isinstance(plant, Plant) else repr(plant)
        raise InvalidParameter(
            f"plant: got {name}; needs a robot in symbols whose joints are all driven, such as "
            "tarc.plants.TwoLinkArm or one of tarc.plants.load_robot"
        )
    return plant
