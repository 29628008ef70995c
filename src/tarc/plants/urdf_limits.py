"""Limits of velocity, acceleration, deceleration and jerk of a URDF, and limits that stand for none."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tarc.core.errors import RobotFileWarning
from tarc.core.types import Array
from tarc.plants.robot_file import parse_robot

MAX_VELOCITY = 100.0
"""Largest velocity limit [rad/s or m/s] that is taken for one; larger ones fill a place in the file."""

REMEDIES = {
    "range": "joint_range (--joint-range)",
    "effort": "torque_limits (--torque-limits)",
    "velocity": "speed (--speed)",
}
"""Requirements of a design that stand in for the limits of a file."""


def velocity_limits(file: Path, joints: Sequence[str], label: str) -> Array:
    """Return the velocity limits of joints [rad/s or m/s], shape (n,): infinite where unknown, as in MJCF.

    MuJoCo does not read them. A range from 0 to 0, an effort of 0 and a velocity of 0 or above `MAX_VELOCITY` are
    unknown limits, which programs write that have no better ones.

    Parameters
    ----------
    file
        The file.
    joints
        Names of the driven joints.
    label
        The file's name.

    Warns
    -----
    RobotFileWarning
        For limits that are taken as unknown, all in one message.
    """
    elements = _joint_elements(file)
    speeds = np.full(len(joints), np.inf)
    unknown: dict[tuple[str, str], list[str]] = {}
    for number, name in enumerate(joints):
        limit = elements[name].find("limit") if name in elements else None
        if limit is None:
            continue
        for fault in _unknown_limits(limit, elements[name].get("type", "")):
            unknown.setdefault(fault, []).append(name)
        value = _number(limit, "velocity")
        if value is not None and 0 < value <= MAX_VELOCITY:
            speeds[number] = value
    if unknown:
        listing = "; ".join(f"{what} of {', '.join(names)}" for (_, what), names in unknown.items())
        remedies = ", ".join(dict.fromkeys(REMEDIES[kind] for kind, _ in unknown))
        message = (
            f"{label}: these limits are taken as unknown: {listing}. Correct the <limit> of these joints, or give a "
            f"design {remedies}"
        )
        warnings.warn(message, RobotFileWarning, stacklevel=4)
    return speeds


def motion_limits(file: Path, joints: Sequence[str]) -> dict[str, Array]:
    """Return limits of acceleration, deceleration and jerk [rad/s² or m/s², /s³] of joints, each (n,), by name.

    They are those of a URDF 1.2, else infinite. A joint without deceleration has its acceleration for both.

    Parameters
    ----------
    file
        The file.
    joints
        Names of the driven joints.

    References
    ----------
    urdfdom, pull request 212: the attributes ``acceleration``, ``deceleration`` and ``jerk`` of ``<limit>``.
    """
    elements = _joint_elements(file)
    limits = [elements[name].find("limit") if name in elements else None for name in joints]

    def attribute(name: str) -> Array:
        values = [0.0 if limit is None else _number(limit, name) or 0.0 for limit in limits]
        return np.array([value if value > 0 else np.inf for value in values])

    acceleration, deceleration = attribute("acceleration"), attribute("deceleration")
    deceleration = np.where(np.isfinite(deceleration), deceleration, acceleration)
    return {"acceleration": acceleration, "deceleration": deceleration, "jerk": attribute("jerk")}


def _joint_elements(file: Path) -> dict[str | None, ET.Element]:
    """Return the joints of a URDF by name; none for MJCF."""
    root = parse_robot(file)
    return {joint.get("name"): joint for joint in root.findall("joint")} if root.tag == "robot" else {}


def _unknown_limits(limit: ET.Element, kind: str) -> list[tuple[str, str]]:
    """Return the limits of a joint of a kind that stand for none, each by its name and in words."""
    faults = []
    ends = [_number(limit, end) for end in ("lower", "upper")]
    if kind != "continuous" and any(end is not None for end in ends) and not any(ends):
        faults.append(("range", "range 0 to 0"))
    if _number(limit, "effort") == 0:
        faults.append(("effort", "effort 0"))
    velocity = _number(limit, "velocity")
    if velocity == 0:
        faults.append(("velocity", "velocity 0"))
    elif velocity is not None and not 0 < velocity <= MAX_VELOCITY:
        unit = "m/s" if kind == "prismatic" else "rad/s"
        faults.append(("velocity", f"velocity {velocity:g} {unit} (not within 0 and {MAX_VELOCITY:g})"))
    return faults


def _number(limit: ET.Element, name: str) -> float | None:
    """Return a number of an element; None where it is not stated."""
    try:
        return float(limit.get(name, ""))
    except ValueError:
        return None
