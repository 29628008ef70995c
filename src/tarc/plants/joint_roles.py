"""Which joints of a robot file are driven, which are passive and which are locked."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import mujoco

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, RobotFileError, RobotFileWarning
from tarc.plants.constraints import joints_of_tendon
from tarc.plants.robot_file import actuated_joints

PLAIN = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)

Lock = Sequence[str] | Mapping[str, float]
"""Joints to lock: names, or positions [rad or m] by name."""


@dataclass(frozen=True)
class JointRoles:
    """What becomes of the joints of a file.

    Attributes
    ----------
    driven
        Names of the joints on which a law's torques act, in the order given or of the file.
    passive
        Names of those that move without a torque, in the order of the file.
    locked
        Why each of the others is locked, by name.
    notes
        Sentences on what the user did not ask for.
    """

    driven: list[str]
    passive: list[str]
    locked: dict[str, str]
    notes: tuple[str, ...] = ()

    @property
    def moving(self) -> list[str]:
        """Return the names of the driven and the passive joints."""
        return [*self.driven, *self.passive]

    def warn(self, label: str) -> None:
        """Print what the user did not ask for."""
        if self.notes:
            warnings.warn(f"{label}: {' '.join(self.notes)}", RobotFileWarning, stacklevel=4)


def choose_joints(
    spec: mujoco.MjSpec,
    selected: Sequence[str] | None = None,
    lock: Lock | None = None,
    free: Sequence[str] | None = None,
    label: str = "robot",
) -> JointRoles:
    """Return the roles of the joints; those without a name get one.

    Driven are the joints that are given, else those with an actuator, else all hinges and slides. In a file with
    actuators the joints without one are passive. Everything else is locked, and so are joints that mimic another.

    Parameters
    ----------
    spec
        The file.
    selected
        Names of the joints to drive, or None.
    lock
        Joints to lock, or None.
    free
        Joints to make passive, or None.
    label
        The file's name.

    Raises
    ------
    RobotFileError
        For a file without a joint to drive, and for a ball that is not locked.
    InvalidParameter
        For names that are no joints of the file, and for joints that are to be both driven and locked.
    """
    for number, joint in enumerate(spec.joints):
        joint.name = joint.name or f"joint{number + 1}"
    kinds = {joint.name: joint.type for joint in spec.joints}
    plain = [name for name, kind in kinds.items() if kind in PLAIN]
    leaders = {
        equality.name1: equality.name2
        for equality in spec.equalities
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.active
    }
    to_lock = _names_to_lock(lock, kinds, label)
    to_free = _names_to_free(free, plain, to_lock, label)
    actuated = actuated_joints(spec)
    if selected is None:
        driven = [name for name in plain if name not in leaders and name not in (*to_lock, *to_free)]
        driven = driven if actuated is None else [name for name in driven if name in actuated]
    else:
        driven = _checked(selected, plain, to_lock, to_free, label)
    if not driven:
        raise RobotFileError(_nothing_to_drive(plain, actuated, label))
    indirect = _driven_through_tendons(spec, plain)
    passive: list[str] = []
    locked: dict[str, str] = {}
    for name, kind in kinds.items():
        if name in driven:
            continue
        if name in to_lock:
            locked[name] = "as given"
        elif name in to_free:
            passive.append(name)
        elif kind not in PLAIN:
            locked[name] = "free or a ball"
        elif name in leaders:
            locked[name] = f"mimics {leaders[name]}" if leaders[name] else "held by the file"
        elif name in indirect:
            locked[name] = f"driven through the tendon {indirect[name]}"
        elif actuated is None or name in actuated:
            locked[name] = "not listed"
        else:
            passive.append(name)
    is_asked = selected is not None
    balls = [name for name in locked if kinds[name] == mujoco.mjtJoint.mjJNT_BALL and name not in to_lock]
    if balls and not is_asked:
        raise RobotFileError(
            f"{label}: joint {balls[0]!r} is a ball; a law drives hinges and slides. Lock it: lock={balls}, on the "
            f"command line --lock {','.join(balls)}"
        )
    floating = [name for name in locked if kinds[name] == mujoco.mjtJoint.mjJNT_FREE and name not in to_lock]
    pulled = [name for name, reason in locked.items() if reason.startswith("driven")]
    unasked = [name for name in passive if name not in to_free]
    notes = _notes(unasked) if is_asked else _notes(unasked, floating, pulled)
    _fix_inside(spec)
    return JointRoles(driven, passive, locked, notes)


def _fix_inside(spec: mujoco.MjSpec) -> None:
    """Delete free joints of bodies that are not in the world, which MuJoCo does not compile: a URDF may have them."""
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE and joint.parent.parent.name != "world":
            spec.delete(joint)


def _names_to_lock(lock: Lock | None, kinds: Mapping[str, mujoco.mjtJoint], label: str) -> Collection[str]:
    """Return the joints to lock, after a check of their names."""
    names = [lock] if isinstance(lock, str) else list(lock or ())
    for name in names:
        if name not in kinds:
            hint = check.did_you_mean(str(name), kinds)
            raise InvalidParameter(
                f"lock: {label} has no joint {name!r}; it has {', '.join(kinds)}.{hint}",
                "lock",
            )
        if isinstance(lock, Mapping) and kinds[name] not in PLAIN:
            raise InvalidParameter(
                f"lock: joint {name} of {label} is free or a ball, which a number does not place; give its name alone",
                "lock",
            )
    return names


def _names_to_free(
    free: Sequence[str] | None, plain: Sequence[str], to_lock: Collection[str], label: str
) -> Collection[str]:
    """Return the joints to make passive, after a check of their names."""
    names = [free] if isinstance(free, str) else list(free or ())
    for name in names:
        if name not in plain:
            raise InvalidParameter(
                f"passive: {label} has no hinge or slide {name!r}; it has {', '.join(plain)}."
                f"{check.did_you_mean(str(name), plain)}",
                "passive",
            )
        if name in to_lock:
            raise InvalidParameter(f"passive: joint {name} of {label} is in lock too; leave out one", "passive")
    return names


def _checked(
    selected: Sequence[str], plain: Sequence[str], to_lock: Collection[str], to_free: Collection[str], label: str
) -> list[str]:
    """Return the joints that the user lists, after a check."""
    if plain and not selected:
        raise InvalidParameter(f"joints: got none; give some of {', '.join(plain)}, or leave it out", "joints")
    for name in selected:
        if name not in plain:
            raise InvalidParameter(
                f"joints: {label} has no hinge or slide {name!r}; it has {', '.join(plain)}."
                f"{check.did_you_mean(name, plain)}",
                "joints",
            )
        if name in to_lock:
            raise InvalidParameter(f"lock: joint {name} of {label} is listed in joints too; leave out one", "lock")
        if name in to_free:
            raise InvalidParameter(
                f"passive: joint {name} of {label} is listed in joints too; leave out one", "passive"
            )
    if len(set(selected)) < len(selected):
        raise InvalidParameter(f"joints: got {list(selected)}; names a joint of {label} twice", "joints")
    return list(selected)


def _nothing_to_drive(plain: Sequence[str], actuated: Collection[str] | None, label: str) -> str:
    """Return the message for a file without a joint to drive."""
    if not plain:
        return f"{label}: it has no hinge or slide joint to control"
    if actuated is None:
        return f"{label}: all its hinges and slides mimic others or are locked; list those to drive in joints"
    return (
        f"{label}: no actuator of the file drives a hinge or slide that is not locked. List in joints (--joints) what "
        f"is to be driven; it has {', '.join(plain)}"
    )


def _driven_through_tendons(spec: mujoco.MjSpec, plain: Sequence[str]) -> dict[str, str]:
    """Return the tendon with an actuator that moves a joint, by the joint's name."""
    pulled = {actuator.target for actuator in spec.actuators if actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON}
    return {
        name: tendon.name
        for tendon in spec.tendons
        if tendon.name in pulled
        for name in joints_of_tendon(spec, tendon, plain)
    }


def _notes(passive: Sequence[str], free: Sequence[str] = (), indirect: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the sentences on what the user did not ask for."""
    notes = []
    if free:
        notes.append(
            f"What {_joints(free)} would let float is fixed, where the keyframe home or the file places it. "
            f"lock={list(free)}, or --lock {','.join(free)}, is the same without this note."
        )
    if passive:
        notes.append(
            f"No actuator drives {_joints(passive)}: simulated as passive, without a torque. {lock_hint(passive)} To "
            "drive it, list it in joints."
        )
    if indirect:
        notes.append(f"A tendon drives {_joints(indirect)}, and no law does: locked in the home posture.")
    return tuple(notes)


def lock_hint(names: Sequence[str]) -> str:
    """Return how to lock passive joints, in words."""
    text = ",".join(names)
    return (
        f"To lock {'it' if len(names) == 1 else 'them'}: lock={list(names)} in Python, --lock {text} of tarc design, "
        f"--set robot.lock=[{text}] for a scenario."
    )


def _joints(names: Sequence[str]) -> str:
    return f"joint {names[0]}" if len(names) == 1 else f"the joints {', '.join(names)}"
