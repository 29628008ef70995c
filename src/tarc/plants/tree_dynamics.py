"""Equations of motion of a tree of links in link frames: composite rigid bodies and recursive Newton–Euler.

Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6, for hinges and slides along z axes.
"""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from tarc.core.types import Array

WORLD = -1
"""Number of the link that does not move."""


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
    added = symmetric(yy + zz, xx + zz, xx + yy, -(x * v + y * u), -(x * w + z * u), -(y * w + z * v))
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
    rate, acceleration
        Velocity and acceleration of the joint.
    """

    parent: int
    slides: bool
    rotation: Array
    origin: ca.SX
    inertia: Inertia
    displacement: ca.SX
    rate: ca.SX
    acceleration: ca.SX

    def place(self) -> ca.SX:
        """Return the origin in the axes of the parent."""
        if self.slides:
            return self.origin + ca.SX(self.rotation[:, 2]) * self.displacement
        return self.origin

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

        For a hinge it is a body of revolution without inertia about the axis. It has the mass, the moment along the
        axis, and I_yy about x and y. For a slide it is all inertia about the origin.
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
        return symmetric(yy + part, xx - part, tensor[2, 2], turned_xy, xz, yz)


def inertia_matrix(links: list[Link]) -> ca.SX:
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
    x, y, _ = ca.vertsplit(inertia.moment)
    if link.slides:
        return ca.vertcat(0, 0, inertia.mass), ca.vertcat(y, -x, 0)
    return ca.vertcat(-y, x, 0), inertia.tensor[:, 2]


def _at_parent(link: Link, force: ca.SX, torque: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return a force and a torque about the link's origin in the frame of the parent."""
    force = link.inward(force)
    return force, link.inward(torque) + ca.cross(link.place(), force)


def joint_torques(links: list[Link], acceleration_of_world: ca.SX) -> ca.SX:
    """Return M q̈ + C q̇ + g (n,) by recursive Newton–Euler; the world accelerates upward by gravity."""
    motions = [_Motion(ca.SX.zeros(3), ca.SX.zeros(3), acceleration_of_world, ca.SX.zeros(3, 3))]
    for link in links:
        motions.append(_move(link, motions[link.parent + 1]))
    wrenches = [_wrench(link.inertia, motion) for link, motion in zip(links, motions[1:], strict=True)]
    torques = ca.SX.zeros(len(links))
    for number in reversed(range(len(links))):
        link = links[number]
        force, torque = wrenches[number]
        torques[number] = force[2] if link.slides else torque[2]
        if link.parent != WORLD:
            added_force, added_torque = _at_parent(link, force, torque)
            force, torque = wrenches[link.parent]
            wrenches[link.parent] = force + added_force, torque + added_torque
    return torques


class _Motion(NamedTuple):
    """Motion of a link in its axes.

    Attributes
    ----------
    angular_velocity, angular_acceleration
        ω and α, each (3,).
    acceleration
        Of the origin, shape (3,).
    field
        U = [α]ₓ + [ω]ₓ², so that the point r accelerates by U r more than the origin, shape (3, 3).
    """

    angular_velocity: ca.SX
    angular_acceleration: ca.SX
    acceleration: ca.SX
    field: ca.SX


def _move(link: Link, parent: _Motion) -> _Motion:
    """Return the motion of a link from that of its parent."""
    acceleration = link.outward(parent.acceleration + parent.field @ link.place())
    angular_acceleration = link.outward(parent.angular_acceleration)
    x, y, z = ca.vertsplit(link.outward(parent.angular_velocity))
    across = link.rate * ca.vertcat(y, -x, 0)
    along = ca.vertcat(0, 0, link.acceleration)
    if link.slides:
        acceleration += 2 * across + along
    else:
        angular_acceleration += across + along
        z = z + link.rate
    a, b, c = ca.vertsplit(angular_acceleration)
    field = ca.blockcat(
        [
            [-(y * y + z * z), x * y - c, x * z + b],
            [x * y + c, -(x * x + z * z), y * z - a],
            [x * z - b, y * z + a, -(x * x + y * y)],
        ]
    )
    return _Motion(ca.vertcat(x, y, z), angular_acceleration, acceleration, field)


def _wrench(inertia: Inertia, motion: _Motion) -> tuple[ca.SX, ca.SX]:
    """Return the force m a + U h and the torque I α + ω × I ω + h × a about the origin that move an inertia.

    The torque is written in the elements of U, which has the products of ω.
    """
    mass, moment, tensor = inertia
    x, y, z = ca.vertsplit(motion.angular_velocity)
    xx, yy, zz = tensor[0, 0], tensor[1, 1], tensor[2, 2]
    xy, xz, yz = tensor[0, 1], tensor[0, 2], tensor[1, 2]
    U = motion.field
    torque = ca.vertcat(
        (zz - yy) * (y * z) + xz * U[1, 0] - xy * U[2, 0] + yz * (U[1, 1] - U[2, 2]),
        (xx - zz) * (x * z) + xy * U[2, 1] - yz * U[0, 1] + xz * (U[2, 2] - U[0, 0]),
        (yy - xx) * (x * y) + yz * U[0, 2] - xz * U[1, 2] + xy * (U[0, 0] - U[1, 1]),
    )
    torque += ca.diag(tensor) * motion.angular_acceleration + ca.cross(moment, motion.acceleration)
    return mass * motion.acceleration + U @ moment, torque


def symmetric(xx: ca.SX, yy: ca.SX, zz: ca.SX, xy: ca.SX, xz: ca.SX, yz: ca.SX) -> ca.SX:
    """Return a symmetric matrix (3, 3) from its elements."""
    return ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
