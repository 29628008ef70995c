"""The robot that is drawn for a plant."""

from tarc.core.errors import InvalidParameter
from tarc.plants.base import Plant
from tarc.plants.delegating import DelegatingPlant
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.pendulum import Pendulum
from tarc.plants.planar import PlanarArm


def drawn_plant(plant: Plant) -> MujocoPlant | PlanarArm | Pendulum:
    """Return the robot that is drawn for a plant: that behind its gearbox, its inner loops and its symbols.

    Raises
    ------
    InvalidParameter
        For a robot without bodies in space.
    """
    inner = plant
    while isinstance(inner, DelegatingPlant):
        inner = inner.facts
    if not isinstance(inner, MujocoPlant | PlanarArm | Pendulum):
        raise InvalidParameter(
            f"plant: {plant.label} cannot be drawn: its equations have no bodies in space; a robot from a file "
            "(load_robot), a TwoLinkArm, an NLinkArm and a Pendulum can"
        )
    return inner
