"""What the browser needs to play a run of a robot in three dimensions, with the reference as a ghost."""

import base64
from typing import Any

import numpy as np

from tarc.core.types import Array
from tarc.plants.geometry import robot_geometry
from tarc.plants.shapes import RobotGeometry
from tarc.plotting.motion import drawn_coordinates, robot_of
from tarc.simulation.run import Run
from tarc.simulation.run_events import payload_mass

FRAME_RATE = 30.0
"""Postures of the run that are sent [1/s]; the browser interpolates between them."""
MAX_FRAMES = 900
MAX_VERTICES = 200_000
"""Of all meshes together; a robot with more is drawn by boxes around its meshes."""


def encoded(values: Array, kind: type) -> str:
    """Return numbers as text that the browser decodes at once."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode("ascii")


def run_geometry(run: Run) -> RobotGeometry:
    """Return the bodies and shapes of a run's robot.

    Raises
    ------
    InvalidParameter
        For a robot without bodies in space.
    """
    return robot_geometry(robot_of(run, None))


def robot_message(geometry: RobotGeometry, run: Run) -> dict[str, Any]:
    """Return what the browser needs of a robot: its bodies, their meshes, and the box that contains a run.

    Parameters
    ----------
    geometry
        Of the robot.
    run
        A run of it.
    """
    low, high = geometry.extent(drawn_coordinates(run, robot_of(run, None), "position", _times(run)[::10]))
    is_large = sum(len(shape.vertices) for shape in geometry.shapes) > MAX_VERTICES
    shapes = []
    for shape in geometry.shapes:
        vertices, faces = box_around(shape.vertices) if is_large else (shape.vertices, shape.faces)
        shapes.append(
            {
                "body": shape.body,
                "vertices": encoded(vertices, np.float32),
                "faces": encoded(faces, np.uint32),
                "colour": list(shape.colour),
            }
        )
    return {
        "names": list(geometry.names),
        "shapes": shapes,
        "payload": geometry.payload,
        "payload_radius": float(geometry.payload_radius),
        "low": low.tolist(),
        "high": high.tolist(),
    }


def run_message(geometry: RobotGeometry, run: Run) -> dict[str, Any]:
    """Return the poses of all bodies along a run and its reference, and the payload.

    Positions have the shape (k, b, 3) [m]. Quaternions have the real part last, as three.js has it, shape (k, b, 4).

    Parameters
    ----------
    geometry
        Of the robot.
    run
        A run of it.
    """
    plant = robot_of(run, None)
    times = _times(run)
    positions, quaternions = geometry.world_poses(drawn_coordinates(run, plant, "position", times))
    ghost_positions, ghost_quaternions = geometry.world_poses(drawn_coordinates(run, plant, "reference", times))
    return {
        "step": float(times[1] - times[0]) if len(times) > 1 else 1.0,
        "positions": encoded(positions, np.float32),
        "quaternions": encoded(np.roll(quaternions, -1, axis=2), np.float32),
        "ghost_positions": encoded(ghost_positions, np.float32),
        "ghost_quaternions": encoded(np.roll(ghost_quaternions, -1, axis=2), np.float32),
        "mass": encoded(payload_mass(run.data, times), np.float32),
    }


def box_around(vertices: Array) -> tuple[Array, Array]:
    """Return vertices (8, 3) and triangles (12, 3) of the box around points (v, 3), along the axes of their frame."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [triangle for a, b, c, d in squares for triangle in ((a, b, c), (a, c, d))]
    return low + corners * (high - low), np.array(triangles)


def _times(run: Run) -> Array:
    """Return the times of the postures that are sent [s], shape (k,)."""
    end = float(run.data["time"].values[-1])
    return np.linspace(0.0, end, int(np.clip(np.ceil(end * FRAME_RATE) + 1, 2, MAX_FRAMES)))
