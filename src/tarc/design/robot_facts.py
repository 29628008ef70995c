"""What a design takes from the robot: postures, speeds, payload and torque limits, and the load of gravity."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.core.errors import InfeasibleDesign, InvalidParameter, Relaxation
from tarc.core.formatting import format_per_joint, format_vector
from tarc.core.units import joint_units, unit_for_joints
from tarc.design.choice import DesignChoice
from tarc.design.infeasible import infeasible_design
from tarc.plants.base import Plant

LARGE_FRICTION = 0.7
"""Dry friction over the torque limit of a joint from which it is named."""
WEIGHT_SAMPLES = 200
"""Sampled postures for the load of gravity."""


def joint_workspace(plant: Plant, joint_range: float | None = None) -> Workspace:
    """Return all postures that the joints reach, or those within ±joint_range [rad or m] of the home posture.

    Raises
    ------
    InvalidParameter
        For a joint_range that is not above zero, and without one for a slide that has no range in the file.
    """
    low, high = plant.position_limits.T
    if joint_range is not None:
        joint_range = check.number("joint_range", joint_range, 0, strict=True)
        low, high = np.maximum(low, plant.home - joint_range), np.minimum(high, plant.home + joint_range)
    endless = [
        name
        for name, unit, end in zip(plant.joint_names, plant.units, high - low, strict=True)
        if unit == "m" and not np.isfinite(end)
    ]
    if endless:
        raise InvalidParameter(
            f"workspace: the slide {endless[0]} [m] has no range in the file; write one there, <limit lower= upper=> "
            "or range= in MJCF, or give joint_range, the distance from the home posture"
        )
    return Workspace.box(np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi))


def velocity_limits(plant: Plant) -> np.ndarray | None:
    """Return the velocity limits of a robot [rad/s or m/s], shape (n,); None where a joint has none.

    A joint without a limit may move at any speed, and then M(q) may change at any rate.
    """
    limits = plant.velocity_limits
    return limits if np.isfinite(limits).all() else None


@dataclass(frozen=True, kw_only=True)
class GravityLoad:
    """The largest gravity torque at rest, over the torque limit.

    Attributes
    ----------
    load
        The torque over the limit.
    joint
        Name of the joint.
    torque, limit
        Torque and limit of this joint [N m or N].
    posture
        The posture [rad or m].
    payload
        The payload [kg].
    at_home
        The largest torque over the limit in the home posture.
    share_beyond_limit
        Share of the sampled postures in which a torque is beyond its limit.
    """

    load: float
    joint: str
    torque: float
    limit: float
    posture: np.ndarray
    payload: float
    at_home: float
    share_beyond_limit: float


def gravity_load(
    plants: Sequence[Plant], workspace: Workspace, limits: np.ndarray, seed: int = 0
) -> GravityLoad | None:
    """Return the largest load of gravity over the workspace; None where no torque limit is known.

    Raises
    ------
    InfeasibleDesign
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
        raise _too_heavy(plants, home, limits)
    largest, place, count_beyond = -1.0, (0, 0, home), 0
    postures = [home, *workspace.sample(WEIGHT_SAMPLES, seed)]
    for posture in postures:
        shares = np.array([_loads(plant, posture, limits) for plant in plants])
        count_beyond += bool(np.any(shares > 1))
        if shares.max() > largest:
            largest = float(shares.max())
            place = (*np.unravel_index(int(np.argmax(shares)), shares.shape), posture)
    number, joint, posture = place
    plant = plants[int(number)]
    return GravityLoad(
        load=largest,
        joint=first.joint_names[int(joint)],
        torque=largest * float(limits[joint]),
        limit=float(limits[joint]),
        posture=posture,
        payload=_payload(plant),
        at_home=at_home,
        share_beyond_limit=count_beyond / len(postures),
    )


def _loads(plant: Plant, posture: np.ndarray, limits: np.ndarray) -> np.ndarray:
    return np.abs(np.asarray(plant.gravity_torque(posture), dtype=float)) / limits


def _payload(plant: Plant) -> float:
    return float(np.squeeze(plant.parameters.get("payload", 0.0)))


def _too_heavy(plants: Sequence[Plant], home: np.ndarray, limits: np.ndarray) -> InfeasibleDesign:
    """Return the error for a robot that its torque limits do not hold in the home posture."""
    plant = max(plants, key=lambda robot: float(np.max(_loads(robot, home, limits))))
    torque, mass = np.abs(np.asarray(plant.gravity_torque(home), dtype=float)), _payload(plant)
    joint = int(np.argmax(torque / limits))
    relaxations = [
        Relaxation("torque_limits", float(torque[joint]), f"a torque limit above {torque[joint]:.3g}"),
        Relaxation("home", None, "another home posture (home in Python, --home, or the keyframe home of an MJCF)"),
    ]
    largest = _largest_payload(plant, home, limits) if mass else None
    if largest is not None:
        relaxations.insert(0, Relaxation("payload", largest, f"a payload of at most {largest:.3g} kg"))
    carried = f" with {mass:g} kg at the tool" if mass else ""
    return infeasible_design(
        f"torque_limits: the robot cannot hold itself in its home posture q = ({format_vector(home)}){carried}: joint "
        f"{plant.joint_names[joint]} needs {torque[joint]:.3g} and its limit is {limits[joint]:.3g} "
        f"{plant.torque_units[joint]}",
        relaxations,
    )


def _largest_payload(plant: Plant, home: np.ndarray, limits: np.ndarray) -> float | None:
    """Return the largest payload [kg] that the limits hold in the home posture, rounded down; None for none."""
    empty = np.asarray(plant.with_parameters({"payload": 0.0}).gravity_torque(home), dtype=float)
    full = np.asarray(plant.gravity_torque(home), dtype=float)
    per_mass = (full - empty) / _payload(plant)
    loaded = np.abs(per_mass) > 1e-9
    if not loaded.any() or np.any(np.abs(empty) > limits):
        return None
    masses = (limits * np.sign(per_mass) - empty)[loaded] / per_mass[loaded]
    largest = float(np.min(masses))
    return float(np.floor(100 * largest) / 100) if largest > 0 else None


def assumptions(
    plants: Sequence[Plant], workspace: Workspace, limits: np.ndarray, load: GravityLoad | None, *, own: bool
) -> list[DesignChoice]:
    """Return what is taken from the robot or its requirements rather than chosen.

    Parameters
    ----------
    plants, workspace, limits, load
        The robots, the workspace, the torque limits [N m or N] and the load of gravity.
    own
        Whether the torque limits are the robot's own.
    """
    plant = plants[0]
    choices = [_robot(plant), _workspace(plant, workspace), _speed(plant, workspace)]
    masses = [_payload(robot) for robot in plants]
    if max(masses) > 0:
        masses_text = f"{masses[0]:g} to {masses[-1]:g} kg" if len(masses) > 1 else f"{masses[0]:g} kg"
        reason = f"{plant.payload_place}; M(q) grows linearly with it, so that the two ends stand for all between"
        choices.append(DesignChoice(("disturbance",), "payload", masses_text, reason))
    if load is not None:
        choices += [_torque_limit(plant, limits, own), _weight(plant, load), *_friction(plant, limits)]
    return choices


def _robot(plant: Plant) -> DesignChoice:
    text = f"driven: {', '.join(plant.joint_names)}"
    if plant.locked:
        text += "; locked at home: " + ", ".join(f"{joint} ({reason})" for joint, reason in plant.locked.items())
    rotor = np.asarray(plant.parameters.get("armature", 1.0), dtype=float)
    if not np.all(rotor > 0):
        text += (
            "; no rotor inertia is known, and behind a gear it is most of a light link's: give armature if the motors "
            "have gears"
        )
    return DesignChoice(
        ("robot", "file"), "robot", f"{plant.label}, {plant.n_joints} joint{'s' if plant.n_joints > 1 else ''}", text
    )


def _workspace(plant: Plant, workspace: Workspace) -> DesignChoice:
    if workspace.reference is not None:
        reason = "certified for these postures and no others"
        return DesignChoice(("reference",), "workspace", "a tube about the reference", reason)
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
    if endless:
        text += f"; no range is known for {', '.join(endless)}"
        text += ", which is taken to ±π, a whole turn" if full else ""
    value = "all that the joints reach" if full else "a part of what the joints reach"
    return DesignChoice(("reference",), "workspace", value, text)


def _speed(plant: Plant, workspace: Workspace) -> DesignChoice:
    speed, own = workspace.speed, velocity_limits(plant)
    if speed is None:
        text = "no joint's speed is bounded, so that M(q) may change at any rate; a bound makes better gains possible"
        return DesignChoice(("reference",), "speed", "any", text)
    unit = unit_for_joints("rad/s", plant.units)
    value = f"{format_per_joint(speed)} {unit}"
    source = "the limits in the robot's file" if own is not None and np.allclose(own, speed) else "as given"
    swift = ""
    if workspace.acceleration is not None and speed.any():
        usual = workspace.with_speed_limits(speed).acceleration
        taken = usual is not None and np.allclose(usual, workspace.acceleration)
        swift = f", or accelerate by more than {format_per_joint(workspace.acceleration)} {unit.replace('/s', '/s²')}"
        swift += ", which reaches this speed in a quarter of a second" if taken else ""
    reason = f"{source}: no joint may move faster{swift}; at a lower speed the loop tolerates more spread"
    return DesignChoice(("reference",), "speed", value, reason)


def _torque_limit(plant: Plant, limits: np.ndarray, own: bool) -> DesignChoice:
    unit = joint_units(plant.torque_units)
    value = f"{format_per_joint(limits)} {unit}"
    unknown = [name for name, limit in zip(plant.joint_names, limits, strict=True) if not np.isfinite(limit)]
    text = "from the robot's file" if own else "as given"
    if unknown:
        text += f"; none is known for {', '.join(unknown)}"
    reason = f"{text}; torque noise is compared with it, and the certificate holds below it"
    return DesignChoice(("law", "torque_limit"), "torque limit", value, reason)


def _friction(plant: Plant, limits: np.ndarray) -> list[DesignChoice]:
    """Return a warning where dry friction alone takes most of a joint's torque."""
    friction = np.broadcast_to(plant.parameters.get("coulomb", np.zeros(1)), limits.shape)
    shares = friction / limits
    joint = int(np.argmax(shares))
    if shares[joint] < LARGE_FRICTION:
        return []
    text = (
        f"WARNING: dry friction takes {friction[joint]:.3g} of {limits[joint]:.3g} {plant.torque_units[joint]} of "
        f"joint {plant.joint_names[joint]}, so that the torque is at its limit wherever the joint moves, which the "
        "certificate excludes: correct the friction of the file (coulomb), or leave the joint out (joints)"
    )
    return [DesignChoice(("law", "torque_limit"), "friction", f"{100 * shares[joint]:.3g} % of the torque limit", text)]


def _weight(plant: Plant, load: GravityLoad) -> DesignChoice:
    carried = f" with {load.payload:g} kg" if load.payload else ""
    unit = plant.torque_units[plant.joint_names.index(load.joint)]
    text = (
        f"joint {load.joint} takes {load.torque:.3g} of {load.limit:.3g} {unit} to stay at "
        f"q = ({format_vector(load.posture)}){carried}; {100 * load.at_home:.3g} % in the home posture"
    )
    if load.load > 1:
        text = (
            f"WARNING: {text}. In {max(100 * load.share_beyond_limit, 0.1):.2g} % of the postures a torque "
            "would be at its limit, which the certificate excludes: keep away from them"
        )
    return DesignChoice(("law", "torque_limit"), "weight", f"at most {100 * load.load:.3g} % of the torque limit", text)
