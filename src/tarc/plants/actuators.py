"""Actuators of an MJCF: what a joint is commanded, and its inner loop."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from tarc.core.errors import RobotFileError, RobotFileWarning
from tarc.core.types import Array
from tarc.plants.robot_file import compile_model
from tarc.plants.servo import Servo

HINT = "actuators='torque' (robot.actuators in a scenario) drives the joints by torques in its place"


@dataclass(frozen=True, eq=False)
class FileServo(Servo):
    """Inner loops by the actuators of a file; arrays have one entry per joint.

    Attributes
    ----------
    names
        Name of the actuator that takes the command of each joint; empty where a torque acts on the joint directly.
    scale
        Control input of the actuator per unit of the command.
    kept
        Names of all actuators that act: those that take commands, and dampers whose command stays zero.
    dynamics
        Names of those with activation dynamics.
    """

    names: tuple[str, ...]
    scale: Array
    kept: tuple[str, ...]
    dynamics: tuple[str, ...]


@dataclass(frozen=True)
class _Actuator:
    """An actuator of one joint: τ = gain u − stiffness q − damping q̇ for the control input u, clipped to a range."""

    name: str
    kind: str
    gain: float
    stiffness: float
    damping: float
    low: float
    high: float
    has_dynamics: bool

    @property
    def has_loop(self) -> bool:
        """Return whether it does more than apply a torque."""
        return self.stiffness > 0 or self.damping > 0

    @property
    def command_gain(self) -> float:
        """Return the torque per unit of the command, which is in the units of the joint."""
        return {"position": self.stiffness, "velocity": self.damping, "torque": 1.0}[self.kind]

    @property
    def command_range(self) -> tuple[float, float]:
        """Return the ends of the range of the command; infinite for a torque, which has limits of its own."""
        if not self.has_loop:
            return -np.inf, np.inf
        factor = self.gain / self.command_gain
        return factor * self.low, factor * self.high


def read_servo(spec: mujoco.MjSpec, joints: Sequence[str], label: str) -> FileServo | None:
    """Return the inner loops of the driven joints, without torque limits; None where torques alone drive all.

    A joint is commanded by its actuator of positions, else by its motor, else by its actuator of velocities. Further
    actuators of velocities have the command zero and damp the joint.

    Parameters
    ----------
    spec
        The file.
    joints
        Names of the driven joints.
    label
        The file's name.

    Raises
    ------
    RobotFileError
        For actuators that are none of these, and for two of positions on one joint.
    """
    for number, actuator in enumerate(spec.actuators):
        actuator.name = actuator.name or f"actuator{number + 1}"
    groups = [_actuators_of(spec, joint, label) for joint in joints]
    loops = [_loop(joint, parts, label) for joint, parts in zip(joints, groups, strict=True)]
    kept = [part.name for main, dampers in loops for part in (main, *dampers) if part.has_loop]
    parts = [part for group in groups for part in group]
    _warn_of_dynamics([part.name for part in parts if part.has_dynamics and part.name not in kept], label)
    if not kept:
        return None
    commanded = [main for main, _ in loops]
    return FileServo(
        kinds=tuple(main.kind for main in commanded),
        gain=np.array([main.command_gain for main in commanded]),
        stiffness=np.array([main.stiffness for main in commanded]),
        damping=np.array([main.damping + sum(part.damping for part in dampers) for main, dampers in loops]),
        low=np.array([min(main.command_range) for main in commanded]),
        high=np.array([max(main.command_range) for main in commanded]),
        torque_limits=np.full(len(joints), np.inf),
        names=tuple(main.name if main.has_loop else "" for main in commanded),
        scale=np.array([main.command_gain / main.gain for main in commanded]),
        kept=tuple(kept),
        dynamics=tuple(part.name for part in parts if part.has_dynamics and part.name in kept),
    )


def _loop(joint: str, parts: Sequence[_Actuator], label: str) -> tuple[_Actuator, list[_Actuator]]:
    """Return the actuator that takes the command of a joint, and those that damp it."""
    positions = [part for part in parts if part.kind == "position"]
    if len(positions) > 1:
        names = " and ".join(part.name for part in positions)
        raise RobotFileError(f"{label}: the actuators {names} both command the position of joint {joint}. {HINT}")
    ordered = [part for kind in ("position", "torque", "velocity") for part in parts if part.kind == kind]
    main = ordered[0] if ordered else _Actuator("", "torque", 1.0, 0.0, 0.0, -np.inf, np.inf, False)
    return main, [part for part in ordered[1:] if part.damping > 0]


def _actuators_of(spec: mujoco.MjSpec, joint: str, label: str) -> list[_Actuator]:
    """Return the actuators of one joint, in units of the joint."""
    own = [actuator for actuator in spec.actuators if actuator.target == joint and actuator.trntype in DIRECT]
    if any(actuator.biasprm[2] > 0 or actuator.inheritrange > 0 for actuator in own):
        _complete(spec, own, label)
    return [_read(actuator, spec.compiler.autolimits, label) for actuator in own]


DIRECT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def _complete(spec: mujoco.MjSpec, actuators: Sequence[mujoco.MjsActuator], label: str) -> None:
    """Write what MuJoCo computes when it compiles: a damping that is given as a ratio, a range of the joint."""
    model = compile_model(spec.copy(), label)
    for actuator in actuators:
        number = model.actuator(actuator.name).id
        bias = np.array(actuator.biasprm)
        bias[2] = model.actuator_biasprm[number, 2]
        actuator.biasprm = bias
        actuator.inheritrange = 0
        if model.actuator_ctrllimited[number]:
            actuator.ctrlrange = model.actuator_ctrlrange[number]
            actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE


def _read(actuator: mujoco.MjsActuator, autolimits: bool, label: str) -> _Actuator:
    """Return an actuator in units of its joint, whose displacement it sees multiplied by the gear."""
    name, gear, gain = actuator.name, float(actuator.gear[0]), float(actuator.gainprm[0])
    has_dynamics = actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE
    if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE and actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED:
        return _Actuator(name, "torque", gain * gear or 1.0, 0.0, 0.0, -np.inf, np.inf, has_dynamics)
    constant, per_length, per_speed = (float(number) for number in actuator.biasprm[:3])
    is_loop = (
        actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE
        and actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
        and actuator.dyntype != mujoco.mjtDyn.mjDYN_INTEGRATOR
        and constant == 0.0
        and per_length <= 0.0
        and per_speed <= 0.0
        and gain * gear != 0.0
    )
    if not is_loop:
        raise RobotFileError(
            f"{label}: the actuator {name!r} of joint {actuator.target!r} is none of torque, position or velocity. "
            f"{HINT}"
        )
    is_velocity = per_length == 0.0 and np.isclose(gain, -per_speed)
    kind = "position" if per_length < 0 else "velocity" if is_velocity else "torque"
    is_automatic = actuator.ctrllimited == mujoco.mjtLimited.mjLIMITED_AUTO and autolimits
    is_limited = is_automatic and actuator.ctrlrange[0] < actuator.ctrlrange[1]
    is_limited = is_limited or actuator.ctrllimited == mujoco.mjtLimited.mjLIMITED_TRUE
    low, high = (float(end) for end in actuator.ctrlrange) if is_limited else (-np.inf, np.inf)
    return _Actuator(name, kind, gain * gear, -per_length * gear**2, -per_speed * gear**2, low, high, has_dynamics)


def _warn_of_dynamics(names: Sequence[str], label: str) -> None:
    """Warn of motors whose activation dynamics are left out."""
    if names:
        message = f"{label}: the torque of {', '.join(names)} acts at once: the actuator's own dynamics are left out"
        warnings.warn(message, RobotFileWarning, stacklevel=5)
