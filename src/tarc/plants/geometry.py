"""Bodies and shapes of any robot that can be drawn."""

import numpy as np

from tarc.core.types import Array
from tarc.plants.base import Plant
from tarc.plants.drawn import drawn_plant
from tarc.plants.file_shapes import file_geometry
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.pendulum import Pendulum
from tarc.plants.shapes import RADIUS_SHARE, RobotGeometry, capsule


def robot_geometry(plant: Plant) -> RobotGeometry:
    """Return the bodies of a robot with their shapes, and their poses at its coordinates.

    Parameters
    ----------
    plant
        A robot from a file, a planar arm or a pendulum, also with a gearbox or inner loops.

    Raises
    ------
    InvalidParameter
        For a robot without bodies in space.
    """
    drawn = drawn_plant(plant)
    if isinstance(drawn, MujocoPlant):
        return file_geometry(drawn)
    if isinstance(drawn, Pendulum):
        return _chain(np.array([float(drawn.length)]), -np.pi / 2)
    return _chain(np.broadcast_to(np.asarray(drawn.lengths, dtype=float), drawn.n_joints), 0.0)


def _chain(lengths: Array, start_angle: float) -> RobotGeometry:
    """Return a serial chain of rods in the vertical plane of x and z, its angles counted from x towards z [rad].

        φ_i = φ_0 + q_1 + … + q_i,    x_i = x_{i−1} + l_{i−1} (cos φ_{i−1}, 0, sin φ_{i−1})

    Parameters
    ----------
    lengths
        Of the links [m], shape (n,).
    start_angle
        φ_0 [rad].
    """
    n = len(lengths)
    radius = RADIUS_SHARE * float(np.sum(lengths))
    ends = np.array([[length, 0.0, 0.0] for length in lengths])
    shapes = [capsule(i, np.zeros(3), ends[i], radius) for i in range(n)]

    def world_poses(coordinates: Array) -> tuple[Array, Array]:
        angles = start_angle + np.cumsum(coordinates, axis=1)
        steps = lengths[:, None] * np.stack([np.cos(angles), np.zeros_like(angles), np.sin(angles)], axis=2)
        positions = np.concatenate([np.zeros((len(angles), 1, 3)), np.cumsum(steps, axis=1)], axis=1)
        last = np.concatenate([angles, angles[:, -1:]], axis=1)
        zero = np.zeros_like(last)
        return positions, np.stack([np.cos(last / 2), zero, -np.sin(last / 2), zero], axis=2)  # about −y

    names = (*(f"link{i + 1}" for i in range(n)), "tip")
    return RobotGeometry(names, tuple(range(-1, n)), tuple(shapes), n, 1.6 * radius, world_poses)
