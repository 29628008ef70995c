"""What a design takes from the robot: the postures it reaches, its payload and torque limits, whether it can hold
its weight.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.plants.base import Plant
from tarc.plants.mujoco import MujocoPlant

WEIGHT_SAMPLES = 200
"""Postures in which the weight is looked at."""


def joint_workspace(plant: Plant, reach: float | None = None) -> Workspace:
    """All that the joints of a robot reach, or the part of it within ±reach [rad or m] of the home posture.

    Raises
    ------
    TarcError
        For a reach that is not above zero, and without one for a slide that has no range in the file.
    """
    low, high = plant.position_limits.T
    if reach is not None:
        reach = check.number("reach", reach, 0, strict=True)
        low, high = np.maximum(low, plant.home - reach), np.minimum(high, plant.home + reach)
    endless = [
        name
        for name, unit, end in zip(plant.joint_names, plant.units, high - low, strict=True)
        if unit == "m" and not np.isfinite(end)
    ]
    if endless:
        raise TarcError(
            f"workspace: the slide {endless[0]} [m] has no range in the file; write one there, <limit lower= upper=> "
            "or range= in MJCF, or give a reach from the home posture"
        )
    return Workspace.box(np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi))


def velocity_limits(plant: Plant) -> np.ndarray | None:
    """The velocity limits of a robot's file [rad/s or m/s], shape (n,); None where a joint has none."""
    limits = plant.velocity_limits
    return limits if np.isfinite(limits).all() else None


@dataclass(frozen=True, kw_only=True)
class GravityLoad:
    """The torque that holds the robot at rest, as a share of the limit: where it is greatest.

    Attributes
    ----------
    load
        The share.
    joint
        Of which joint, by name.
    torque, limit
        There [N m or N].
    posture
        [rad or m].
    payload
        There [kg].
    at_home
        The greatest share in the home posture.
    beyond
        Share of the sampled postures in which a torque is beyond its limit.
    """

    load: float
    joint: str
    torque: float
    limit: float
    posture: np.ndarray
    payload: float
    at_home: float
    beyond: float


def gravity_load(
    plants: Sequence[Plant], workspace: Workspace, limits: np.ndarray, seed: int = 0
) -> GravityLoad | None:
    """What it takes to hold the robot over the workspace; None where no torque limit is known.

    Raises
    ------
    TarcError
        When the limits do not hold the robot in its home posture.
    """
    if not np.isfinite(limits).any():
        return None
    first = plants[0]
    home = (
        np.clip(first.home, workspace.low, workspace.high)
        if workspace.reference is None
        else workspace.reference.sample(np.zeros(1))[0][:, 0]
    )
    at_home = max(float(np.max(_loads(plant, home, limits))) for plant in plants)
    if at_home > 1:
        raise TarcError(_too_heavy(plants, home, limits))
    greatest, where, beyond = -1.0, (0, 0, home), 0
    postures = [home, *workspace.sample(WEIGHT_SAMPLES, seed)]
    for posture in postures:
        shares = np.array([_loads(plant, posture, limits) for plant in plants])
        beyond += bool(np.any(shares > 1))
        if shares.max() > greatest:
            greatest = float(shares.max())
            where = (*np.unravel_index(int(np.argmax(shares)), shares.shape), posture)
    number, joint, posture = where
    plant = plants[int(number)]
    return GravityLoad(
        load=greatest,
        joint=first.joint_names[int(joint)],
        torque=greatest * float(limits[joint]),
        limit=float(limits[joint]),
        posture=posture,
        payload=_payload(plant),
        at_home=at_home,
        beyond=beyond / len(postures),
    )


def _loads(plant: Plant, posture: np.ndarray, limits: np.ndarray) -> np.ndarray:
    return np.abs(np.asarray(plant.gravity_torque(posture), dtype=float)) / limits


def _payload(plant: Plant) -> float:
    return float(np.squeeze(plant.parameters.get("payload", 0.0)))


def _too_heavy(plants: Sequence[Plant], home: np.ndarray, limits: np.ndarray) -> str:
    """What cannot be held in the home posture, and what would be."""
    plant = max(plants, key=lambda one: float(np.max(_loads(one, home, limits))))
    held, mass = np.abs(np.asarray(plant.gravity_torque(home), dtype=float)), _payload(plant)
    joint = int(np.argmax(held / limits))
    remedies = [f"a torque limit above {held[joint]:.3g}", "another home posture in the file (MJCF, keyframe home)"]
    if mass:
        empty = np.asarray(plant.with_parameters({"payload": 0.0}).gravity_torque(home), dtype=float)
        full = np.asarray(plant.gravity_torque(home), dtype=float)
        per_mass = (full - empty) / mass
        ends = [limit * np.sign(slope) - start for limit, slope, start in zip(limits, per_mass, empty, strict=True)]
        able = min((end / slope for end, slope in zip(ends, per_mass, strict=True) if abs(slope) > 1e-9), default=0.0)
        if able > 0 and np.all(np.abs(empty) <= limits):
            remedies.insert(0, f"a payload of at most {np.floor(100 * able) / 100:.3g} kg")
    carried = f" with {mass:g} kg at the tool" if mass else ""
    return (
        f"torque_limit: the robot cannot hold itself in its home posture q = ({_listed(home)}){carried}: joint "
        f"{plant.joint_names[joint]} needs {held[joint]:.3g} and its limit is {limits[joint]:.3g} "
        f"{_torque_unit(plant, joint)}. Any one of these may do: {'; '.join(remedies)}"
    )


def assumptions(
    plants: Sequence[Plant], workspace: Workspace, limits: np.ndarray, held: GravityLoad | None, *, own: bool
) -> list[tuple[str, str, str]]:
    """Name, value and reason of what was taken from the robot rather than chosen; ``own`` for its own torque limits."""
    plant = plants[0]
    found = [_robot(plant), _workspace(plant, workspace), _speed(plant, workspace)]
    masses = [_payload(one) for one in plants]
    if max(masses) > 0:
        both = f"{masses[0]:g} to {masses[-1]:g} kg" if len(masses) > 1 else f"{masses[0]:g} kg"
        found.append(
            ("payload", both, f"{plant.payload_place}; M(q) grows with it, so that the two ends stand for all between")
        )
    if held is not None:
        found += [_torque_limit(plant, limits, own), _weight(plant, held)]
    return found


def _robot(plant: Plant) -> tuple[str, str, str]:
    text = f"driven: {', '.join(plant.joint_names)}"
    if plant.locked:
        text += "; locked at zero: " + ", ".join(f"{joint} ({reason})" for joint, reason in plant.locked.items())
    rotor = np.asarray(plant.parameters.get("armature", 1.0), dtype=float)
    if not np.all(rotor > 0):
        text += (
            "; no rotor inertia is known, and behind a gear it is most of a light link's: give armature if the motors "
            "have gears"
        )
    return "robot", f"{plant.label}, {plant.n_joints} joint{'s' if plant.n_joints > 1 else ''}", text


def _workspace(plant: Plant, workspace: Workspace) -> tuple[str, str, str]:
    if workspace.reference is not None:
        return "workspace", "a tube about the reference", "certified for these postures and no others"
    low, high = plant.position_limits.T
    endless = [name for name, end in zip(plant.joint_names, high, strict=True) if not np.isfinite(end)]
    low, high = np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi)
    full = np.allclose(workspace.low, low) and np.allclose(workspace.high, high)
    ends = "; ".join(
        f"{name} {a:.4g} to {b:.4g}"
        for name, a, b in zip(plant.joint_names, workspace.low, workspace.high, strict=True)
    )
    if plant.n_joints > 1 and np.ptp(workspace.low) == 0 == np.ptp(workspace.high):
        ends = f"each joint {workspace.low[0]:.4g} to {workspace.high[0]:.4g}"
    text = f"{ends}: certified for these postures and no others"
    if endless and isinstance(plant, MujocoPlant):
        text += f"; no range in the file for {', '.join(endless)}"
        text += ", which is taken to ±π, a whole turn" if full else ""
    return "workspace", "all that the joints reach" if full else "a part of what the joints reach", text


def _speed(plant: Plant, workspace: Workspace) -> tuple[str, str, str]:
    speed, own = workspace.speed, velocity_limits(plant)
    if speed is None:
        text = "no joint's speed is bounded, so that M(q) may change at any rate; a bound makes better gains possible"
        return "speed", "any", text
    unit = "rad/s" if "m" not in plant.units else "rad/s or m/s"
    value = f"{_alike(speed)} {unit}"
    source = "the limits in the robot's file" if own is not None and np.allclose(own, speed) else "as given"
    swift = ""
    if workspace.acceleration is not None and speed.any():
        usual = workspace.with_speed_limits(speed).acceleration
        taken = usual is not None and np.allclose(usual, workspace.acceleration)
        swift = f", or accelerate by more than {_alike(workspace.acceleration)} {unit.replace('/s', '/s²')}"
        swift += ", which reaches this speed in a quarter of a second" if taken else ""
    return "speed", value, f"{source}: no joint may move faster{swift}; the slower, the more inertia the loop bears"


def _torque_limit(plant: Plant, limits: np.ndarray, own: bool) -> tuple[str, str, str]:
    equal = np.ptp(limits[np.isfinite(limits)]) == 0 and np.isfinite(limits).all()
    unit = "N m" if "m" not in plant.units else "N m or N"
    value = f"{limits[0]:.4g} {unit}" if equal else f"{_listed(limits)} {unit}"
    unknown = [name for name, one in zip(plant.joint_names, limits, strict=True) if not np.isfinite(one)]
    text = "from the robot's file" if own else "as given"
    if unknown:
        text += f"; none is known for {', '.join(unknown)}"
    return "torque limit", value, f"{text}; the measure of torque noise, and the certificate holds below it"


def _weight(plant: Plant, held: GravityLoad) -> tuple[str, str, str]:
    carried = f" with {held.payload:g} kg" if held.payload else ""
    text = (
        f"joint {held.joint} takes {held.torque:.3g} of {held.limit:.3g} {_torque_unit(plant, held.joint)} to stay at "
        f"q = ({_listed(held.posture)}){carried}; {100 * held.at_home:.3g} % in the home posture"
    )
    if held.load > 1:
        text = (
            f"WARNING: {text}. In {max(100 * held.beyond, 0.1):.2g} % of the postures a torque would be at its limit, "
            "which the certificate excludes: keep away from them"
        )
    return "weight", f"at most {100 * held.load:.3g} % of the torque limit", text


def _torque_unit(plant: Plant, joint: int | str) -> str:
    number = plant.joint_names.index(joint) if isinstance(joint, str) else joint
    return "N" if plant.units[number] == "m" else "N m"


def _alike(numbers: np.ndarray) -> str:
    """One number where they are the same."""
    return f"{numbers[0]:.4g}" if np.ptp(numbers) == 0 else _listed(numbers)


def _listed(numbers: Any) -> str:
    return ", ".join(f"{float(one):.3g}" for one in numbers)
