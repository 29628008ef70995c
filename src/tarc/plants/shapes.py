"""Shapes of a robot's bodies and where they are, to draw it."""

from collections.abc import Callable
from dataclasses import dataclass

from tarc.core.optional import require
from tarc.core.types import Array

require("view", "drawing a robot", "trimesh")

import numpy as np
import trimesh

LINK_COLOUR = (199, 204, 209)
"""Red, green and blue, 0 to 255, of a body without a colour of its own."""
RADIUS_SHARE = 0.035
"""Radius of a capsule that stands for a link, as a share of the robot's reach."""


@dataclass(frozen=True, eq=False)
class BodyShape:
    """A triangle mesh that is fixed to a body.

    Attributes
    ----------
    body
        Number of the body, from 0.
    vertices
        In the frame of the body [m], shape (v, 3).
    faces
        Numbers of the vertices of each triangle, shape (f, 3).
    colour
        Red, green and blue, 0 to 255.
    """

    body: int
    vertices: Array
    faces: Array
    colour: tuple[int, int, int] = LINK_COLOUR


@dataclass(frozen=True, eq=False)
class RobotGeometry:
    """Bodies of a robot, their shapes, and their poses at coordinates.

    Attributes
    ----------
    names
        One name per body, shape (b,).
    parents
        Number of the body that carries each body, smaller than its own; −1 for the world.
    shapes
        Meshes of the bodies; a body may have several, or none.
    payload
        Body at whose origin the payload is; None where it is not known.
    payload_radius
        Radius of the ball that stands for the payload [m].
    world_poses
        Function of coordinates (k, m) that returns positions [m], shape (k, b, 3), and quaternions with the real part
        first, shape (k, b, 4), in the world.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    shapes: tuple[BodyShape, ...]
    payload: int | None
    payload_radius: float
    world_poses: Callable[[Array], tuple[Array, Array]]

    def poses(self, coordinates: Array) -> tuple[Array, Array]:
        """Return the poses of the bodies in the frames of their parents, as `world_poses` returns those in the world.

        p = R_pᵀ (x − x_p),    R = R_pᵀ R_b
        """
        from scipy.spatial.transform import Rotation

        positions, quaternions = self.world_poses(coordinates)
        relative_positions, relative_quaternions = positions.copy(), quaternions.copy()
        for body, parent in enumerate(self.parents):
            if parent < 0:
                continue
            to_parent = Rotation.from_quat(quaternions[:, parent], scalar_first=True).inv()
            relative_positions[:, body] = to_parent.apply(positions[:, body] - positions[:, parent])
            turn = to_parent * Rotation.from_quat(quaternions[:, body], scalar_first=True)
            relative_quaternions[:, body] = turn.as_quat(canonical=True, scalar_first=True)
        return relative_positions, relative_quaternions

    def extent(self, coordinates: Array) -> Array:
        """Return the box that contains all shapes at coordinates (k, m): lower and upper corner [m], shape (2, 3)."""
        from scipy.spatial.transform import Rotation

        positions, quaternions = self.world_poses(coordinates)
        corners = [positions.reshape(-1, 3)]
        for shape in self.shapes:
            turn = Rotation.from_quat(quaternions[:, shape.body], scalar_first=True)
            low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
            for corner in np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T:
                corners.append(positions[:, shape.body] + turn.apply(corner))
        points = np.concatenate(corners)
        return np.array([points.min(axis=0), points.max(axis=0)])


def mesh_shape(body: int, mesh: trimesh.Trimesh, colour: tuple[int, int, int] = LINK_COLOUR) -> BodyShape:
    """Return a mesh in the frame of a body as a shape."""
    return BodyShape(body, np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32), colour)


def capsule(
    body: int, start: Array, end: Array, radius: float, colour: tuple[int, int, int] = LINK_COLOUR
) -> BodyShape:
    """Return a capsule between two points in the frame of a body [m], or a ball where they coincide."""
    if np.linalg.norm(end - start) < 1e-6:
        ball = trimesh.creation.icosphere(subdivisions=2, radius=radius)
        ball.apply_translation(start)
        return mesh_shape(body, ball, colour)
    axis = end - start
    rod = trimesh.creation.capsule(height=float(np.linalg.norm(axis)), radius=radius, count=[12, 16])
    rod.apply_translation(-rod.bounds.mean(axis=0))
    rod.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], axis))
    rod.apply_translation((start + end) / 2)
    return mesh_shape(body, rod, colour)
