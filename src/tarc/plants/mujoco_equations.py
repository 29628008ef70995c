"""Equations of motion of a MuJoCo model as CasADi expressions: composite rigid bodies and recursive Newton–Euler.

Every joint has a link, with a frame whose z axis is that of the joint. Bodies without joints are part of the link that
they are fixed to. What a link has of its inertia that does not change as its joint moves is moved to its parent link.
"""

from collections.abc import Sequence
from dataclasses import replace

from tarc.core.optional import require

require("robots", "tarc.plants.RigidBody")

import casadi as ca
import mujoco
import numpy as np

from tarc.core.types import Array
from tarc.plants.robot_file import rotation_matrix
from tarc.plants.tree_dynamics import (
    NOTHING,
    WORLD,
    Inertia,
    Link,
    inertia_matrix,
    joint_torques,
    shifted,
    symmetric,
    total,
    turned,
)

ROUNDING = 1e-14
"""Size of what is zero or one in constant rotations and places, but for rounding."""


def rigid_body_equations(
    model: mujoco.MjModel,
    motion: tuple[ca.SX, ca.SX, ca.SX],
    masses: dict[int, ca.SX],
    inertias: dict[int, ca.SX],
    lengths: Sequence[ca.SX],
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return M(q) (n, n), N = C(q, q̇) q̇ + g(q) (n, 1) and M q̈ + N (n, 1) of a model of hinges and slides.

    None has what acts on the joints alone: rotor inertia, friction, springs.

    Parameters
    ----------
    model
        The compiled model.
    motion
        Position q, velocity q̇ and acceleration q̈, each (n, 1).
    masses
        Mass [kg] of each body but the world, by its number.
    inertias
        Inertia of each of these bodies about its centre of mass, in the axes of its frame [kg m²], shape (3, 3).
    lengths
        Factor of the link of each joint. By it the joints after that joint, and the centres of mass, are farther from
        it.

    Raises
    ------
    ValueError
        For a joint that is neither a hinge nor a slide.

    References
    ----------
    Featherstone, Rigid Body Dynamics Algorithms, 2008: composite rigid bodies and recursive Newton–Euler.
    """
    links = _links(model, motion, _scaled_bodies(model, masses, inertias, lengths), lengths)
    unaccelerated = [replace(link, acceleration=ca.SX(0)) for link in links]
    return inertia_matrix(links), _torques(model, unaccelerated), _torques(model, links)


def rigid_body_regressor(
    model: mujoco.MjModel, q: ca.SX, dq: ca.SX, ddq: ca.SX, bodies: Sequence[int]
) -> tuple[ca.SX, Array]:
    """Return Y(q, q̇, q̈), shape (n, 10 b), and the parameters p, shape (10 b,), of the torque Y p of moving bodies.

    The torque is linear in them. Each body has its mass m, its first moments m c_x, m c_y, m c_z, and its inertia I_xx,
    I_yy, I_zz, I_xy, I_xz, I_yz about the origin of its frame. All are in the axes of that frame.

    Parameters
    ----------
    model
        The compiled model.
    q, dq, ddq
        Position, velocity and acceleration, shape (n, 1).
    bodies
        Numbers of the b bodies; the others have no part in the torque.

    References
    ----------
    Khalil and Dombre, Modeling, Identification and Control of Robots, 2002, chapter 12.
    """
    symbols = ca.SX.sym("p", 10 * len(bodies))
    parts = dict(zip(bodies, ca.vertsplit(symbols, 10), strict=True))
    links = _links(model, (q, dq, ddq), {body: _from_parameters(part) for body, part in parts.items()})
    values = np.concatenate([_parameters_about_origin(model, body) for body in bodies])
    return ca.jacobian(_torques(model, links), symbols), values


def _scaled_bodies(
    model: mujoco.MjModel, masses: dict[int, ca.SX], inertias: dict[int, ca.SX], lengths: Sequence[ca.SX]
) -> dict[int, Inertia]:
    """Return the inertias of bodies about the origins of their frames, with links of other lengths."""
    bodies, joints = {}, {0: WORLD}
    for body in range(1, model.nbody):
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints[body] = first + count - 1 if count else joints[int(model.body_parentid[body])]
        centre = _length(lengths, joints[body]) * model.body_ipos[body]
        bodies[body] = shifted(Inertia(masses[body], ca.SX.zeros(3), inertias[body]), centre)
    return bodies


def _length(lengths: Sequence[ca.SX], link: int) -> ca.SX:
    """Return the factor of a link; one for the world."""
    return ca.SX(1) if link == WORLD or not lengths else lengths[link]


def _torques(model: mujoco.MjModel, links: list[Link]) -> ca.SX:
    """Return M q̈ + C q̇ + g of links under the gravity of the model."""
    return joint_torques(links, ca.SX(-model.opt.gravity))


def _links(
    model: mujoco.MjModel,
    motion: tuple[ca.SX, ca.SX, ca.SX],
    bodies: dict[int, Inertia],
    lengths: Sequence[ca.SX] = (),
) -> list[Link]:
    """Return a link for each joint, parents first, with inertia moved towards the world as far as that goes.

    The motion is position, velocity and acceleration. The inertia of a body is about the origin of its frame. Without
    lengths all factors are one.
    """
    q, dq, ddq = motion
    links: list[Link] = []
    frames = {0: (WORLD, np.eye(3), np.zeros(3))}
    owned: dict[int, Inertia] = {}
    for body in range(1, model.nbody):
        link, axes, origin = frames[int(model.body_parentid[body])]
        origin = origin + axes @ model.body_pos[body]
        axes = axes @ rotation_matrix(model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            along, anchor = _axes_along(model.jnt_axis[joint]), model.jnt_pos[joint]
            displacement = q[joint] - float(model.qpos0[model.jnt_qposadr[joint]])
            pose = _rounded(axes @ along), _length(lengths, link) * _rounded(origin + axes @ anchor)
            links.append(Link(link, _slides(model, joint), *pose, NOTHING, displacement, dq[joint], ddq[joint]))
            link, axes, origin = joint, along.T, -along.T @ anchor
        frames[body] = link, axes, origin
        place = _length(lengths, link) * _rounded(origin)
        at_link = shifted(turned(bodies.get(body, NOTHING), _rounded(axes)), place)
        owned[link] = total(owned.get(link, NOTHING), at_link)
    return _regrouped(links, owned)


def _slides(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a joint is a slide and not a hinge."""
    kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
    if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        raise ValueError(f"joint {joint} is neither a hinge nor a slide")
    return kind == mujoco.mjtJoint.mjJNT_SLIDE


def _regrouped(links: list[Link], owned: dict[int, Inertia]) -> list[Link]:
    """Return links that have the inertia that varies with their joint, and what the links after them leave to them.

    Khalil and Dombre, Modeling, Identification and Control of Robots, 2002, section 9.4.2.
    """
    inertias = [owned.get(number, NOTHING) for number in range(len(links))]
    regrouped: list[Link] = []
    for number in reversed(range(len(links))):
        link = replace(links[number], inertia=inertias[number])
        if link.parent != WORLD:
            inertias[link.parent] = total(inertias[link.parent], link.invariant())
        regrouped.append(replace(link, inertia=link.variable()))
    return regrouped[::-1]


def _axes_along(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is an axis, a permutation where the axis is one of the frame."""
    largest = int(np.argmax(np.abs(axis)))
    axis = _rounded(axis / np.linalg.norm(axis))
    second = np.eye(3)[(largest + 1) % 3]
    first = second - axis * (axis @ second)
    first = first / np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def _rounded(values: Array) -> Array:
    """Return constants of which those that are zero or one but for rounding are exact."""
    nearest = np.where(np.abs(values) < 0.5, 0.0, np.sign(values))
    return np.where(np.abs(values - nearest) < ROUNDING, nearest, values)


def _from_parameters(p: ca.SX) -> Inertia:
    """Return the inertia of a body from its ten parameters."""
    return Inertia(p[0], p[1:4], symmetric(*ca.vertsplit(p[4:])))


def _parameters_about_origin(model: mujoco.MjModel, body: int) -> Array:
    """Return the ten parameters of a body of the model."""
    mass, centre = model.body_mass[body], model.body_ipos[body]
    axes = rotation_matrix(model.body_iquat[body])
    about_centre = axes @ np.diag(model.body_inertia[body]) @ axes.T
    inertia = about_centre + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return np.concatenate([[mass], mass * centre, inertia[rows, columns]])
