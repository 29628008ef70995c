"""Parts of a robot file that couple joints beyond the tree of its bodies, which are refused and not dropped."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

from collections.abc import Collection

import mujoco
import numpy as np

from tarc.core.errors import RobotFileError

KINDS = {
    mujoco.mjtEq.mjEQ_CONNECT: "connect",
    mujoco.mjtEq.mjEQ_WELD: "weld",
    mujoco.mjtEq.mjEQ_JOINT: "joint",
    mujoco.mjtEq.mjEQ_TENDON: "tendon",
}
"""Equality constraints, as an MJCF names them."""

WAY_OUT = (
    "List in joints (--joints) only joints that the constraint leaves free, the others are locked in the home posture; "
    "or remove it from the file"
)


def refuse_constraints(spec: mujoco.MjSpec, selected: Collection[str], label: str) -> None:
    """Refuse constraints and tendons that act on the driven joints.

    Constraints that are not active and those within what moves as one have no effect. A joint that mimics another is
    locked, unless it is listed.

    Parameters
    ----------
    spec
        The file.
    selected
        Names of the driven joints.
    label
        The file's name.

    Raises
    ------
    RobotFileError
        For a closed loop, a driven joint that mimics another, and a tendon with a force or a limit.
    """
    parts = _rigid_parts(spec, selected)
    acting = {tendon.name: tendon for tendon in spec.tendons if _moves(tendon, selected, parts)}
    for equality in spec.equalities:
        if not equality.active:
            continue
        name = f" {equality.name!r}" if equality.name else ""
        kind = KINDS.get(equality.type, "equality")
        if equality.type in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            tag = "site" if equality.objtype == mujoco.mjtObj.mjOBJ_SITE else "body"
            first, second = (parts.get((tag, end)) for end in (equality.name1, equality.name2 or "world"))
            if first is None or second is None or first[0] == second[0]:
                continue
            what = (
                f"holds the bodies {first[1]!r} and {second[1]!r} together, which the driven joints move relative to "
                "each other"
            )
        elif equality.type == mujoco.mjtEq.mjEQ_JOINT:
            if equality.name1 not in selected:
                continue
            what = f"determines the position of the driven joint {equality.name1!r}"
            what += f" from that of {equality.name2!r}" if equality.name2 else ""
        elif equality.type == mujoco.mjtEq.mjEQ_TENDON:
            if not {equality.name1, equality.name2} & set(acting):
                continue
            what = f"holds the tendon {equality.name1!r}, whose length the driven joints change"
        else:
            what = "acts on parts that are not rigid or not jointed"
        raise RobotFileError(f"{label}: the {kind} constraint{name} {what}. Closed loops are not supported. {WAY_OUT}")
    for name, tendon in acting.items():
        effects = _effects(tendon, spec.compiler.autolimits)
        if effects:
            raise RobotFileError(
                f"{label}: the tendon {name!r} has {' and '.join(effects)}, and the driven joints change its length. "
                f"Such tendons are not supported. {WAY_OUT}"
            )


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
