"""Parts of a robot file that couple joints beyond the tree of its bodies: simulated, never dropped in silence."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

from collections.abc import Collection, Mapping

import mujoco
import numpy as np

from tarc.core.errors import RobotFileError
from tarc.core.types import Array
from tarc.plants.partial_tendons import refuse_unknown_lengths

KINDS = {
    mujoco.mjtEq.mjEQ_CONNECT: "connect",
    mujoco.mjtEq.mjEQ_WELD: "weld",
    mujoco.mjtEq.mjEQ_JOINT: "joint",
    mujoco.mjtEq.mjEQ_TENDON: "tendon",
}
"""Equality constraints, as an MJCF names them."""


def acting_constraints(spec: mujoco.MjSpec, moving: Collection[str], label: str) -> dict[str, str]:
    """Return what couples the joints that move, by the name in the file; it has an effect on how they move.

    Constraints that are not active and those within what moves as one have no effect. Elements without a name get one.

    Parameters
    ----------
    spec
        The file.
    moving
        Names of the driven and the passive joints.
    label
        The file's name.

    Raises
    ------
    RobotFileError
        For a constraint of parts that are not rigid. For a tendon in space over joints of which only some move, where
        its length in the file's own posture counts.
    """
    for kind, elements in (("equality", spec.equalities), ("tendon", spec.tendons)):
        for number, element in enumerate(elements):
            element.name = element.name or f"{kind}{number + 1}"
    parts = _rigid_parts(spec, moving)
    tendons = {tendon.name: tendon for tendon in spec.tendons if _moves(tendon, moving, parts)}
    acting: dict[str, str] = {}
    for equality in spec.equalities:
        text = _couples(equality, moving, parts, tendons) if equality.active else ""
        if text and equality.type not in KINDS:
            raise RobotFileError(
                f"{label}: the constraint {equality.name!r} {text}, which is not supported. Remove it from the file"
            )
        if text:
            acting[equality.name] = f"the {KINDS[equality.type]} constraint {equality.name!r}, which {text}"
    held = {
        name for equality in spec.equalities if equality.name in acting for name in (equality.name1, equality.name2)
    }
    for name, tendon in tendons.items():
        effects = _effects(tendon, spec.compiler.autolimits)
        if effects:
            acting[name] = f"the tendon {name!r}, which has {' and '.join(effects)}"
        elif name in held:
            acting[name] = f"the tendon {name!r}"
    locked = [joint.name for joint in spec.joints if joint.name not in moving]
    partial = {name: joints_of_tendon(spec, tendons[name], locked) for name in acting if name in tendons}
    refuse_unknown_lengths(spec, {name: joints for name, joints in partial.items() if joints}, held, label)
    return acting


def is_free_without(spec: mujoco.MjSpec, driven: Collection[str], label: str) -> bool:
    """Return whether nothing couples the driven joints once all others are locked."""
    try:
        return not acting_constraints(spec, driven, label)
    except RobotFileError:
        return False


def _couples(
    equality: mujoco.MjsEquality,
    moving: Collection[str],
    parts: dict[tuple[str, str], tuple[int, str]],
    tendons: Collection[str],
) -> str:
    """Return what an equality constraint does to the joints that move, in words; empty for nothing."""
    if equality.type in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
        tag = "site" if equality.objtype == mujoco.mjtObj.mjOBJ_SITE else "body"
        first, second = (parts.get((tag, end)) for end in (equality.name1, equality.name2 or "world"))
        if first is None or second is None or first[0] == second[0]:
            return ""
        return f"holds the bodies {first[1]!r} and {second[1]!r} together"
    if equality.type == mujoco.mjtEq.mjEQ_JOINT:
        if equality.name1 not in moving:
            return ""
        text = f"determines the position of {equality.name1!r}"
        return f"{text} from that of {equality.name2!r}" if equality.name2 else text
    if equality.type == mujoco.mjtEq.mjEQ_TENDON:
        is_acting = {equality.name1, equality.name2} & set(tendons)
        return f"holds the tendon {equality.name1!r}" if is_acting else ""
    return "acts on parts that are not rigid or not jointed"


def keep_anchors(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    acting: Collection[str],
    moving: Collection[str],
    posture: Mapping[str, Array],
) -> None:
    """Rewrite constraints so that they stay the same when the joints that do not move are locked in a posture.

    A file holds bodies together as they are at zero displacement of all joints, and a locked joint may be elsewhere.

    Parameters
    ----------
    spec
        The file, before joints are locked.
    model
        Its kinematics, with all joints.
    acting
        Names of the constraints that stay.
    moving
        Names of the driven and the passive joints.
    posture
        Home position of each joint.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for equality in spec.equalities:
        if equality.name not in acting:
            continue
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.name2 and equality.name2 not in moving:
            equality.data = _of_locked_leader(np.array(equality.data), model, equality.name2, posture)
            equality.name2 = ""
        elif equality.type == mujoco.mjtEq.mjEQ_CONNECT and equality.objtype == mujoco.mjtObj.mjOBJ_BODY:
            _connect_by_sites(spec, data, equality)
        elif equality.type == mujoco.mjtEq.mjEQ_WELD and equality.objtype == mujoco.mjtObj.mjOBJ_BODY:
            equality.data = _with_relative_pose(data, equality)


def follower_position(coefficients: Array, displacement: float) -> float:
    """Return how far a joint is displaced whose equality constraint has a polynomial of another's displacement."""
    return float(np.polynomial.polynomial.polyval(displacement, coefficients[:5]))


def _of_locked_leader(values: Array, model: mujoco.MjModel, leader: str, posture: Mapping[str, Array]) -> Array:
    """Return the polynomial of a joint constraint whose other joint is locked: a constant."""
    zero = float(model.qpos0[int(model.joint(leader).qposadr[0])])
    values[0] = follower_position(values, float(posture[leader][0]) - zero)
    values[1:5] = 0
    return values


def _connect_by_sites(spec: mujoco.MjSpec, data: mujoco.MjData, equality: mujoco.MjsEquality) -> None:
    """Connect two sites in place of two bodies."""
    names = [equality.name1, equality.name2 or "world"]
    first, second = (data.body(name) for name in names)
    anchor = np.array(equality.data[:3])
    place = first.xpos + first.xmat.reshape(3, 3) @ anchor
    places = [anchor, second.xmat.reshape(3, 3).T @ (place - second.xpos)]
    sites = [f"{equality.name}_{end}" for end in ("first", "second")]
    for name, body, position in zip(sites, names, places, strict=True):
        spec.body(body).add_site(name=name, pos=position)
    equality.objtype = mujoco.mjtObj.mjOBJ_SITE
    equality.name1, equality.name2 = sites


def _with_relative_pose(data: mujoco.MjData, equality: mujoco.MjsEquality) -> Array:
    """Return the numbers of a weld, with the relative pose that MuJoCo would compute."""
    values = np.array(equality.data)
    if np.any(values[6:10]):
        return values
    first, second = data.body(equality.name1), data.body(equality.name2 or "world")
    anchor = second.xpos + second.xmat.reshape(3, 3) @ values[:3]
    values[3:6] = first.xmat.reshape(3, 3).T @ (anchor - first.xpos)
    inverse, relative = np.zeros(4), np.zeros(4)
    mujoco.mju_negQuat(inverse, first.xquat)
    mujoco.mju_mulQuat(relative, inverse, second.xquat)
    values[6:10] = relative
    return values


def joints_of_tendon(spec: mujoco.MjSpec, tendon: mujoco.MjsTendon, names: Collection[str]) -> list[str]:
    """Return those of some joints that change the length of a tendon."""
    return [name for name in names if _moves(tendon, [name], _rigid_parts(spec, [name]))]


def _rigid_parts(spec: mujoco.MjSpec, selected: Collection[str]) -> dict[tuple[str, str], tuple[int, str]]:
    """Return the number of the rigid part and the body of each body, site and geom, by kind and name."""
    parts: dict[tuple[str, str], tuple[int, str]] = {}
    count = 0

    def walk(body: mujoco.MjsBody, part: int) -> None:
        nonlocal count
        if any(joint.name in selected for joint in body.joints):
            count += 1
            part = count
        for kind, elements in (("body", [body]), ("site", body.sites), ("geom", body.geoms)):
            for element in elements:
                parts[kind, element.name] = part, body.name
        for child in body.bodies:
            walk(child, part)

    walk(spec.worldbody, 0)
    return parts


def _moves(tendon: mujoco.MjsTendon, selected: Collection[str], parts: dict[tuple[str, str], tuple[int, str]]) -> bool:
    """Return whether the driven joints change the length of a tendon."""
    tags = {mujoco.mjtWrap.mjWRAP_SITE: "site", mujoco.mjtWrap.mjWRAP_SPHERE: "geom"}
    tags[mujoco.mjtWrap.mjWRAP_CYLINDER] = "geom"
    touched = set()
    for wrap in tendon.path:
        if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT and wrap.target.name in selected:
            return True
        if wrap.type in tags:
            touched.add(parts[tags[wrap.type], wrap.target.name][0])
    return len(touched) > 1


def _effects(tendon: mujoco.MjsTendon, autolimits: bool) -> list[str]:
    """Return the forces and limits of a tendon, in words."""
    is_automatic = tendon.limited == mujoco.mjtLimited.mjLIMITED_AUTO and autolimits
    has_range = is_automatic and tendon.range[0] < tendon.range[1]
    effects = {
        "stiffness": np.any(tendon.stiffness),
        "damping": np.any(tendon.damping),
        "friction": np.any(tendon.frictionloss),
        "inertia": np.any(tendon.armature),
        "limits": tendon.limited == mujoco.mjtLimited.mjLIMITED_TRUE or has_range,
    }
    return [name for name, applies in effects.items() if applies]
