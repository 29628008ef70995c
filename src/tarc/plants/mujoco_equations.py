"""Equations of motion of a MuJoCo model as CasADi expressions: composite rigid bodies and recursive Newton–Euler.

Every joint has a link, with a frame whose z axis is that of the joint. Bodies without joints are part of the link that
they are fixed to. What a link has of its inertia that does not change as its joint moves is moved to its parent link.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from tarc.core.optional import require

require("robots", "tarc.plants.RigidBody")

import casadi as ca
import mujoco
import numpy as np

from tarc.core.types import Array
from tarc.plants.robot_file import rotation_matrix

WORLD = -1
"""Number of the link that does not move."""

ROUNDING = 1e-14
"""Size of what is zero or one in constant rotations and places, but for rounding."""


def rigid_body_equations(
    model: mujoco.MjModel, q: ca.SX, dq: ca.SX, masses: dict[int, ca.SX], inertias: dict[int, ca.SX]
) -> tuple[ca.SX, ca.SX]:
    """Return M(q), shape (n, n), and C(q, q̇) q̇ + g(q), shape (n, 1), of a model of hinges and slides.

    Neither has what acts on the joints alone: rotor inertia, friction, springs.

    Parameters
    ----------
    model
        The compiled model.
    q, dq
        Position and velocity, shape (n, 1).
    masses
        Mass [kg] of each body but the world, by its number.
    inertias
        Inertia of each of these bodies about its centre of mass, in the axes of its frame [kg m²], shape (3, 3).

    Raises
    ------
    ValueError
        For a joint that is neither a hinge nor a slide.

    References
    ----------
    Featherstone, Rigid Body Dynamics Algorithms, 2008: composite rigid bodies and recursive Newton–Euler.
    """
    bodies = {
        body: shifted(Inertia(mass, ca.SX.zeros(3), inertias[body]), model.body_ipos[body])
        for body, mass in masses.items()
    }
    return _equations(model, q, dq, bodies)


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
    M, bias = _equations(model, q, dq, {body: _from_parameters(part) for body, part in parts.items()})
    values = np.concatenate([_parameters_about_origin(model, body) for body in bodies])
    return ca.jacobian(M @ ddq + bias, symbols), values


class Inertia(NamedTuple):
    """Mass, first moments (3,), and inertia (3, 3) about the origin of a frame, in its axes."""

    mass: ca.SX
    moment: ca.SX
    tensor: ca.SX


NOTHING = Inertia(ca.SX(0), ca.SX.zeros(3), ca.SX.zeros(3, 3))


def total(a: Inertia, b: Inertia) -> Inertia:
    """Return the inertia of two bodies in the same frame."""
    return Inertia(a.mass + b.mass, a.moment + b.moment, a.tensor + b.tensor)


def shifted(inertia: Inertia, place: ca.SX | Array) -> Inertia:
    """Return an inertia about another origin, from which the old one is at a place (3,).

    h' = h + m p,    I' = I + 2 (p·w) E − p wᵀ − w pᵀ,    w = h + m p/2
    """
    mass, moment, tensor = inertia
    x, y, z = ca.vertsplit(ca.SX(place))
    u, v, w = ca.vertsplit(moment + mass * (ca.SX(place) / 2))
    xx, yy, zz = 2 * x * u, 2 * y * v, 2 * z * w
    added = _symmetric(yy + zz, xx + zz, xx + yy, -(x * v + y * u), -(x * w + z * u), -(y * w + z * v))
    return Inertia(mass, moment + mass * ca.SX(place), tensor + added)


def turned(inertia: Inertia, rotation: Array) -> Inertia:
    """Return an inertia in other axes, in which the old ones are the columns of a rotation (3, 3)."""
    mass, moment, tensor = inertia
    R = ca.SX(rotation)
    return Inertia(mass, R @ moment, ca.tril2symm(ca.tril(R @ tensor @ R.T)))


@dataclass(frozen=True, eq=False)
class Link:
    """What moves with a joint, which turns about or moves along the z axis of its frame.

    Attributes
    ----------
    parent
        Number of the link before, or `WORLD`.
    slides
        Whether the joint is a slide.
    rotation, origin
        Axes and origin of the frame in that of the parent at zero displacement, (3, 3) and (3,).
    inertia
        In the frame of the link.
    displacement
        Of the joint from where the frames are those above.
    rate
        Velocity of the joint.
    """

    parent: int
    slides: bool
    rotation: Array
    origin: Array
    inertia: Inertia
    displacement: ca.SX
    rate: ca.SX

    def place(self) -> ca.SX:
        """Return the origin in the axes of the parent."""
        if self.slides:
            return self.origin + self.rotation[:, 2] * self.displacement
        return ca.SX(self.origin)

    def outward(self, vector: ca.SX) -> ca.SX:
        """Return a vector (3,) of the parent's axes in those of the link."""
        return self._about_z(ca.SX(self.rotation.T) @ vector, -1)

    def inward(self, vector: ca.SX) -> ca.SX:
        """Return a vector (3,) of the link's axes in those of the parent."""
        return ca.SX(self.rotation) @ self._about_z(vector, 1)

    def inertia_at_parent(self, inertia: Inertia) -> Inertia:
        """Return an inertia of the link's frame in that of the parent."""
        about_z = Inertia(inertia.mass, self._about_z(inertia.moment, 1), self._tensor_about_z(inertia.tensor))
        return shifted(turned(about_z, self.rotation), self.place())

    def invariant(self) -> Inertia:
        """Return the part of the link's inertia that acts on the parent as if the joint were fixed, at the parent.

        For a hinge it is a body of revolution about the axis without inertia about the axis: it has the mass, the
        moment along the axis, and I_yy about both others. For a slide it is all inertia about the origin.
        """
        fixed = self._invariant_in_link()
        return shifted(turned(fixed, self.rotation), self.origin)

    def variable(self) -> Inertia:
        """Return the rest of the link's inertia, in its frame."""
        fixed = self._invariant_in_link()
        return Inertia(*(whole - part for whole, part in zip(self.inertia, fixed, strict=True)))

    def _invariant_in_link(self) -> Inertia:
        mass, moment, tensor = self.inertia
        if self.slides:
            return Inertia(ca.SX(0), ca.SX.zeros(3), tensor)
        zero = ca.SX(0)
        return Inertia(mass, ca.vertcat(0, 0, moment[2]), ca.diag(ca.vertcat(tensor[1, 1], tensor[1, 1], zero)))

    def _about_z(self, vector: ca.SX, sign: int) -> ca.SX:
        """Turn a vector by the displacement of a hinge, or back."""
        if self.slides:
            return vector
        c, s = ca.cos(self.displacement), ca.sin(self.displacement)
        x, y, z = ca.vertsplit(vector)
        return ca.vertcat(c * x - s * y, s * x + c * y, z) if sign > 0 else ca.vertcat(c * x + s * y, c * y - s * x, z)

    def _tensor_about_z(self, tensor: ca.SX) -> ca.SX:
        """Turn an inertia by the displacement of a hinge."""
        if self.slides:
            return tensor
        c, s = ca.cos(self.displacement), ca.sin(self.displacement)
        xx, yy, xy = tensor[0, 0], tensor[1, 1], tensor[0, 1]
        difference = xx - yy
        half_sine = c * s
        part = c * c * difference - 2 * half_sine * xy
        across = ca.vertcat(tensor[0, 2], tensor[1, 2], 0)
        xz, yz, _ = ca.vertsplit(self._about_z(across, 1))
        turned_xy = half_sine * difference + (c * c - s * s) * xy
        return _symmetric(yy + part, xx - part, tensor[2, 2], turned_xy, xz, yz)


def _equations(model: mujoco.MjModel, q: ca.SX, dq: ca.SX, bodies: dict[int, Inertia]) -> tuple[ca.SX, ca.SX]:
    """Return M(q) and C(q, q̇) q̇ + g(q) for bodies with an inertia about the origin of their frame."""
    links = _links(model, q, dq, bodies)
    return _inertia_matrix(links), _bias(links, ca.SX(-model.opt.gravity))


def _links(model: mujoco.MjModel, q: ca.SX, dq: ca.SX, bodies: dict[int, Inertia]) -> list[Link]:
    """Return a link for each joint, parents first, with inertia moved towards the world as far as that goes."""
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
            pose = _rounded(axes @ along), _rounded(origin + axes @ anchor)
            links.append(Link(link, _slides(model, joint), *pose, NOTHING, displacement, dq[joint]))
            link, axes, origin = joint, along.T, -along.T @ anchor
        frames[body] = link, axes, origin
        at_link = shifted(turned(bodies.get(body, NOTHING), _rounded(axes)), _rounded(origin))
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
        link = _with_inertia(links[number], inertias[number])
        if link.parent != WORLD:
            inertias[link.parent] = total(inertias[link.parent], link.invariant())
        regrouped.append(_with_inertia(link, link.variable()))
    return regrouped[::-1]


def _with_inertia(link: Link, inertia: Inertia) -> Link:
    return Link(link.parent, link.slides, link.rotation, link.origin, inertia, link.displacement, link.rate)


def _inertia_matrix(links: list[Link]) -> ca.SX:
    """Return M(q) by composite rigid bodies, sparse where two joints are on different branches."""
    composite = [link.inertia for link in links]
    for number in reversed(range(len(links))):
        link = links[number]
        if link.parent != WORLD:
            composite[link.parent] = total(composite[link.parent], link.inertia_at_parent(composite[number]))
    M = ca.SX(len(links), len(links))
    for number, link in enumerate(links):
        force, torque = _momentum(link, composite[number])
        M[number, number] = force[2] if link.slides else torque[2]
        while link.parent != WORLD:
            force, torque = _at_parent(link, force, torque)
            before = link.parent
            link = links[before]
            M[number, before] = M[before, number] = force[2] if link.slides else torque[2]
    return M


def _momentum(link: Link, inertia: Inertia) -> tuple[ca.SX, ca.SX]:
    """Return momentum and angular momentum about the origin at a unit velocity of the joint."""
    x, y, z = ca.vertsplit(inertia.moment)
    if link.slides:
        return ca.vertcat(0, 0, inertia.mass), ca.vertcat(y, -x, 0)
    return ca.vertcat(-y, x, 0), inertia.tensor[:, 2]


def _at_parent(link: Link, force: ca.SX, torque: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return a force and a torque about the link's origin in the frame of the parent."""
    force = link.inward(force)
    return force, link.inward(torque) + ca.cross(link.place(), force)


def _bias(links: list[Link], acceleration_of_world: ca.SX) -> ca.SX:
    """Return C(q, q̇) q̇ + g(q) by recursive Newton–Euler; the world accelerates upward by gravity."""
    motions = [_Motion(ca.SX.zeros(3), acceleration_of_world, ca.SX.zeros(3, 3), ca.SX.zeros(3))]
    for link in links:
        motions.append(_move(link, motions[link.parent + 1]))
    wrenches = [_wrench(link.inertia, motion) for link, motion in zip(links, motions[1:], strict=True)]
    bias = ca.SX.zeros(len(links))
    for number in reversed(range(len(links))):
        link = links[number]
        force, torque = wrenches[number]
        bias[number] = force[2] if link.slides else torque[2]
        if link.parent != WORLD:
            added_force, added_torque = _at_parent(link, force, torque)
            force, torque = wrenches[link.parent]
            wrenches[link.parent] = force + added_force, torque + added_torque
    return bias


class _Motion(NamedTuple):
    """Motion of a link at joint accelerations of zero, in its axes.

    Attributes
    ----------
    velocity, spin
        Angular velocity ω, shape (3,), and angular acceleration α, shape (3,), in ``spin``.
    acceleration
        Of the origin, shape (3,).
    field
        U = [α]ₓ + [ω]ₓ², so that the point r accelerates by U r more than the origin, shape (3, 3).
    """

    velocity: ca.SX
    acceleration: ca.SX
    field: ca.SX
    spin: ca.SX


def _move(link: Link, parent: _Motion) -> _Motion:
    """Return the motion of a link from that of its parent."""
    acceleration = link.outward(parent.acceleration + parent.field @ link.place())
    spin = link.outward(parent.spin)
    velocity = link.outward(parent.velocity)
    x, y, z = ca.vertsplit(velocity)
    if link.slides:
        acceleration += 2 * link.rate * ca.vertcat(y, -x, 0)
    else:
        spin += link.rate * ca.vertcat(y, -x, 0)
        z = z + link.rate
    a, b, c = ca.vertsplit(spin)
    field = ca.blockcat(
        [
            [-(y * y + z * z), x * y - c, x * z + b],
            [x * y + c, -(x * x + z * z), y * z - a],
            [x * z - b, y * z + a, -(x * x + y * y)],
        ]
    )
    return _Motion(ca.vertcat(x, y, z), acceleration, field, spin)


def _wrench(inertia: Inertia, motion: _Motion) -> tuple[ca.SX, ca.SX]:
    """Return the force m a + U h and the torque I α + ω × I ω + h × a about the origin that move an inertia.

    The torque is written in the elements of U, which has the products of ω.
    """
    mass, moment, I = inertia
    x, y, z = ca.vertsplit(motion.velocity)
    U = motion.field
    torque = ca.vertcat(
        (I[2, 2] - I[1, 1]) * (y * z) + I[0, 2] * U[1, 0] - I[0, 1] * U[2, 0] + I[1, 2] * (U[1, 1] - U[2, 2]),
        (I[0, 0] - I[2, 2]) * (x * z) + I[0, 1] * U[2, 1] - I[1, 2] * U[0, 1] + I[0, 2] * (U[2, 2] - U[0, 0]),
        (I[1, 1] - I[0, 0]) * (x * y) + I[1, 2] * U[0, 2] - I[0, 2] * U[1, 2] + I[0, 1] * (U[0, 0] - U[1, 1]),
    )
    torque += ca.diag(I) * motion.spin + ca.cross(moment, motion.acceleration)
    return mass * motion.acceleration + U @ moment, torque


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


def _symmetric(xx: ca.SX, yy: ca.SX, zz: ca.SX, xy: ca.SX, xz: ca.SX, yz: ca.SX) -> ca.SX:
    return ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _from_parameters(p: ca.SX) -> Inertia:
    """Return the inertia of a body from its ten parameters."""
    return Inertia(p[0], p[1:4], _symmetric(*ca.vertsplit(p[4:])))


def _parameters_about_origin(model: mujoco.MjModel, body: int) -> Array:
    """Return the ten parameters of a body of the model."""
    mass, centre = model.body_mass[body], model.body_ipos[body]
    axes = rotation_matrix(model.body_iquat[body])
    about_centre = axes @ np.diag(model.body_inertia[body]) @ axes.T
    inertia = about_centre + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return np.concatenate([[mass], mass * centre, inertia[rows, columns]])
