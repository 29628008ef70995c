from .base import Plant
from .euler_lagrange import EulerLagrange
from .mass_spring_damper import MassSpringDamper
from .mujoco import MujocoPlant
from .pendulum import Pendulum
from .planar import NLinkArm, TwoLinkArm
from .robot_file import find_robot, shipped_robots
from .wheeled import WheeledMobileRobot

__all__ = [
    "EulerLagrange",
    "MassSpringDamper",
    "MujocoPlant",
    "NLinkArm",
    "Pendulum",
    "Plant",
    "TwoLinkArm",
    "WheeledMobileRobot",
    "find_robot",
    "shipped_robots",
]
