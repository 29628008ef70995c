"""Robots to control: from energies by differentiation, or from MJCF and URDF files."""

from typing import TYPE_CHECKING

from tarc.core.lazy import lazy_attributes

if TYPE_CHECKING:
    from tarc.plants.base import Plant
    from tarc.plants.euler_lagrange import EulerLagrange
    from tarc.plants.gearbox import Gearbox
    from tarc.plants.load import load_robot
    from tarc.plants.mass_spring_damper import MassSpringDamper
    from tarc.plants.mujoco import MujocoPlant
    from tarc.plants.pendulum import Pendulum
    from tarc.plants.planar import NLinkArm, TwoLinkArm
    from tarc.plants.rigid_body import RigidBody
    from tarc.plants.robot_file import find_robot, shipped_robots
    from tarc.plants.series_elastic import SeriesElasticJoint
    from tarc.plants.servo import PositionServo, ServoedPlant
    from tarc.plants.symbolic import SymbolicPlant
    from tarc.plants.underwater_vehicle import UnderwaterVehicle
    from tarc.plants.wheeled import WheeledMobileRobot

__all__ = [
    "EulerLagrange",
    "Gearbox",
    "MassSpringDamper",
    "MujocoPlant",
    "NLinkArm",
    "Pendulum",
    "Plant",
    "PositionServo",
    "RigidBody",
    "SeriesElasticJoint",
    "ServoedPlant",
    "SymbolicPlant",
    "TwoLinkArm",
    "UnderwaterVehicle",
    "WheeledMobileRobot",
    "find_robot",
    "load_robot",
    "shipped_robots",
]

__getattr__, __dir__, _ = lazy_attributes(
    __name__,
    {
        "EulerLagrange": "tarc.plants.euler_lagrange",
        "Gearbox": "tarc.plants.gearbox",
        "MassSpringDamper": "tarc.plants.mass_spring_damper",
        "MujocoPlant": "tarc.plants.mujoco",
        "NLinkArm": "tarc.plants.planar",
        "Pendulum": "tarc.plants.pendulum",
        "Plant": "tarc.plants.base",
        "PositionServo": "tarc.plants.servo",
        "RigidBody": "tarc.plants.rigid_body",
        "SeriesElasticJoint": "tarc.plants.series_elastic",
        "ServoedPlant": "tarc.plants.servo",
        "SymbolicPlant": "tarc.plants.symbolic",
        "TwoLinkArm": "tarc.plants.planar",
        "UnderwaterVehicle": "tarc.plants.underwater_vehicle",
        "WheeledMobileRobot": "tarc.plants.wheeled",
        "find_robot": "tarc.plants.robot_file",
        "load_robot": "tarc.plants.load",
        "shipped_robots": "tarc.plants.robot_file",
    },
)
