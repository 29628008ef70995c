"""Inertias of the links of a robot file: checked and merged where links move as one."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from tarc.core.errors import RobotFileError, RobotFileWarning
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.plants.robot_file import rotation_matrix

ROUNDING = 1e-6
"""Share of the largest moment of inertia by which moments may violate an inequality, as numbers in a file do."""

ZERO = 1e-15
"""Moment of inertia [kg m²] below which one is zero."""


@dataclass(frozen=True)
class RigidInertia:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m²], in the axes of one frame."""

    mass: float
    centre: Array
    inertia: Array

    def seen_from(self, place: Array, rotation: Array) -> "RigidInertia":
        """Return it in a frame in which this one is at a place with a rotation."""
        return RigidInertia(self.mass, place + rotation @ self.centre, rotation @ self.inertia @ rotation.T)

    def __add__(self, other: "RigidInertia") -> "RigidInertia":
        mass = self.mass + other.mass
        weights = (self.mass, other.mass) if mass > 0 else (0.5, 0.5)
        centre = (weights[0] * self.centre + weights[1] * other.centre) / sum(weights)
        inertia = self.inertia + other.inertia
        for part in (self, other):
            offset = part.centre - centre
            inertia = inertia + part.mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
        return RigidInertia(mass, centre, inertia)


def merge_rigid_links(spec: mujoco.MjSpec, label: str, balance: bool) -> None:
    """Give each moving link the inertia of all links that are fixed to it, and what cannot move none.

    Only the sum moves, so only the sum must be that of a body: principal moments a ≤ b ≤ c with a ≥ 0 and a + b ≥ c.
    Differences that rounding explains are taken as zero.

    Parameters
    ----------
    spec
        The robot with only those joints that move.
    label
        The file's name.
    balance
        Replace the moments of an impossible inertia by their mean instead of refusing it.

    Raises
    ------
    RobotFileError
        For moving links whose inertia is that of no body, all of them in one message.

    Warns
    -----
    RobotFileWarning
        For each inertia that was replaced.
    """
    impossible: list[str] = []
    for body in spec.worldbody.bodies:
        _merge_below(body, None, impossible, balance)
    if not impossible:
        return
    listing = "; ".join(impossible)
    if balance:
        message = f"{label}: the moments of these links were replaced by their mean: {listing}"
        warnings.warn(message, RobotFileWarning, stacklevel=4)
        return
    raise RobotFileError(
        f"{label}: no body has the inertia of these links: {listing}. Principal moments about the centre of mass must "
        "not be below 0, nor one more than the sum of the others. Correct the <inertial> of these links, in kg m²; or "
        "give balance_inertia=True (--balance-inertia), which replaces the moments by their mean"
    )


def _merge_below(body: mujoco.MjsBody, root: mujoco.MjsBody | None, impossible: list[str], balance: bool) -> None:
    """Merge the links from a body on; the root is the moving link that the parent belongs to."""
    if list(body.joints):
        links = list(_fixed_links(body, np.zeros(3), np.eye(3)))
        is_placed = all(link is body or link.frame is None for link, _, _ in links)  # a frame moves what is in it
        if is_placed and all(_states_inertia(link) for link, _, _ in links):
            _merge(body, links, impossible, balance)
        root = body
    elif root is None and _states_inertia(body):
        _write(body, RigidInertia(0.0, np.zeros(3), np.zeros((3, 3))), np.zeros(3), np.eye(3))
    for child in body.bodies:
        _merge_below(child, root, impossible, balance)


def _fixed_links(body: mujoco.MjsBody, place: Array, rotation: Array) -> Iterator[tuple[mujoco.MjsBody, Array, Array]]:
    """Yield a link and all that are fixed to it, with their places and rotations in its frame."""
    yield body, place, rotation
    for child in body.bodies:
        if not list(child.joints):
            yield from _fixed_links(child, place + rotation @ child.pos, rotation @ rotation_matrix(child.quat))


def _states_inertia(body: mujoco.MjsBody) -> bool:
    """Return whether the file states the inertia of a link, or that it has none, in quaternions."""
    plain = mujoco.mjtOrientation.mjORIENTATION_QUAT
    return (bool(body.explicitinertial) or not list(body.geoms)) and body.alt.type == body.ialt.type == plain


def _merge(
    root: mujoco.MjsBody,
    links: list[tuple[mujoco.MjsBody, Array, Array]],
    impossible: list[str],
    balance: bool,
) -> None:
    stated = [(link, place, rotation) for link, place, rotation in links if link.explicitinertial]
    if not stated:
        return
    total = RigidInertia(0.0, np.zeros(3), np.zeros((3, 3)))
    for link, place, rotation in stated:
        total = total + _read(link).seen_from(place, rotation)
    moments, axes = np.linalg.eigh((total.inertia + total.inertia.T) / 2)
    largest = max(abs(moments[0]), moments[2])
    tolerance = ROUNDING * largest + ZERO
    if moments[0] < -tolerance or moments[0] + moments[1] < moments[2] - tolerance:
        names = ", ".join(link.name for link, _, _ in stated)
        impossible.append(f"{names} with {format_vector(moments, 4)} kg m²")
        if balance:
            moments = np.full(3, max(float(np.mean(moments)), 0.0))
    moments = np.maximum(moments, 0.0)
    moments[2] = min(moments[2], moments[0] + moments[1])
    as_stated = np.allclose(moments, np.linalg.eigvalsh(total.inertia), rtol=1e-12, atol=0)
    if len(stated) == 1 and stated[0][0] is root and as_stated and moments[0] > 0:
        return
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    for link, _, _ in links:
        _write(link, RigidInertia(0.0, np.zeros(3), np.zeros((3, 3))), np.zeros(3), np.eye(3))
    _write(root, total, moments, axes)


def _read(body: mujoco.MjsBody) -> RigidInertia:
    """Return the inertia that a link states, in its own frame."""
    if np.isnan(body.fullinertia[0]):
        inertia = np.diag(np.asarray(body.inertia, dtype=float))
    else:
        xx, yy, zz, xy, xz, yz = np.nan_to_num(body.fullinertia)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    rotation = rotation_matrix(body.iquat)
    return RigidInertia(float(body.mass), np.array(body.ipos), rotation @ inertia @ rotation.T)


def _write(body: mujoco.MjsBody, inertia: RigidInertia, moments: Array, axes: Array) -> None:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    body.explicitinertial = True
    body.mass = inertia.mass
    body.ipos = inertia.centre
    body.iquat = quaternion
    body.inertia = moments
    body.fullinertia = np.full(6, np.nan)
