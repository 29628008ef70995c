"""Robots from MJCF or URDF files, on MuJoCo."""

from tarc.core.optional import require
from tarc.core.types import Vector

require("robots", "tarc.plants.MujocoPlant")

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, RobotFileError
from tarc.core.validation import Numbers
from tarc.plants.actuators import FileServo, read_servo
from tarc.plants.assembly import assembled, constraint_rows
from tarc.plants.base import Plant
from tarc.plants.constraints import acting_constraints, is_free_without, keep_anchors
from tarc.plants.home_posture import (
    Home,
    compile_kinematics,
    holding_posture,
    home_keyframe,
    home_posture,
    lock_joints,
)
from tarc.plants.joint_roles import JointRoles, Lock, choose_joints, lock_hint
from tarc.plants.link_inertia import merge_rigid_links
from tarc.plants.partial_tendons import shorten_tendons
from tarc.plants.robot_file import (
    check_links,
    compile_model,
    find_robot,
    read_specification,
    reduce_to_joints,
    set_joint,
    tool_body,
    without_log_file,
)
from tarc.plants.urdf_limits import motion_limits, velocity_limits

PAYLOAD_RADIUS = 0.05
"""Radius [m] of the homogeneous ball that a payload is."""


class MujocoPlant(Plant):
    """A robot whose joints are all hinges and slides, simulated by MuJoCo; `from_file` constructs it.

    Torque acts on the joints directly; actuators in the file are removed and their limits kept as
    `torque_limits`. Passive joints are coordinates beyond those. Contacts are off by default.

    Attributes
    ----------
    model
        The ``mujoco.MjModel``.
    carrier
        Body or site that carries the payload, in words.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        roles: JointRoles,
        posture: Mapping[str, float],
        tool: str,
        payload: float,
        label: str,
    ):
        body, place, self.carrier = tool_body(spec, tool, roles.driven, label)
        body.add_body(
            name="tarc_payload", pos=place, ipos=[0.0] * 3, mass=0.0, inertia=[0.0] * 3, explicitinertial=True
        )
        self._locked = roles.locked
        self._constraints: list[str] = []
        self._is_lock_enough = False
        self.servo: FileServo | None = None
        self.model: mujoco.MjModel = compile_model(spec, label)
        self._label = label
        self._file_options: dict[str, object] = {}
        names = _joint_names(self.model)
        self._driven = tuple(i for i, name in enumerate(names) if name in roles.driven)
        self._start = np.array([posture[name] for name in names])
        self._scratch = mujoco.MjData(self.model)
        self.payload_body = self.model.body("tarc_payload").id
        limited, ranges = self.model.jnt_actfrclimited.astype(bool), np.abs(self.model.jnt_actfrcrange)
        self._torque_limits = np.where(limited, ranges.min(axis=1), np.inf)[list(self._driven)]
        self._velocity_limits = np.full(self.n_joints, np.inf)
        unlimited = np.full(self.n_joints, np.inf)
        self._motion_limits = {"acceleration": unlimited, "deceleration": unlimited, "jerk": unlimited}
        self.set_parameters(self.model, {"payload": np.array(payload)})
        values, vectors = np.linalg.eigh(self.inertia(self._start))
        if not values[0] > 1e-9:
            loosest = int(np.argmax(np.abs(vectors[:, 0])))
            link = self.model.body(int(self.model.jnt_bodyid[loosest])).name
            raise RobotFileError(
                f"{label}: its inertia matrix is singular (smallest eigenvalue {values[0]:.2g}): link {link!r} has no "
                f"inertia about its joint {names[loosest]}; such links need rotor inertia: give "
                "armature=0.1, or one number per joint, or correct the link's <inertial>"
            )

    def __repr__(self) -> str:
        return f"MujocoPlant({self.label!r}, joints={self.n_joints})"

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        *,
        joints: Sequence[str] | None = None,
        lock: Lock | None = None,
        passive: Sequence[str] | None = None,
        home: Home | None = None,
        armature: Numbers | None = None,
        viscous: Numbers | None = None,
        coulomb: Numbers | None = None,
        payload: float = 0.0,
        tool: str | None = None,
        contact: bool = False,
        balance_inertia: bool = False,
        actuators: str = "file",
    ) -> "MujocoPlant":
        """Read an MJCF or URDF file, or one of the shipped robots by name (``"ur5e"``, ``"panda"``).

        Of a URDF the kinematics and inertias are read; the meshes are not needed. `load_robot` says which joints are
        driven, passive and locked.

        Parameters
        ----------
        path, joints, lock, passive, home
            The file, and which joints it drives, as in `load_robot`.
        armature, viscous, coulomb, payload, tool, contact, balance_inertia, actuators
            What is changed of it, as in `load_robot`.

        Raises
        ------
        RobotFileError
            For a file that is missing or does not read, and balls that are not locked. For constraints of parts that
            are not rigid, and some tendons in space over joints of which only some are locked. For links with an
            inertia that no body has, and for an inertia matrix that is singular.
        InvalidParameter
            For joints or a tool that the file does not have, and for negative parameters. Also for a home posture
            outside the ranges.
        """
        check.one_of("actuators", actuators, ("file", "torque"))
        file = find_robot(path)
        with without_log_file():
            spec = read_specification(file)
        check_links(spec, file.name)
        names = [joints] if isinstance(joints, str) else joints
        roles = choose_joints(spec, names, lock, passive, file.name)
        acting = acting_constraints(spec, roles.moving, file.name)
        is_lock_enough = bool(roles.passive) and is_free_without(spec, roles.driven, file.name)
        kinematics = compile_kinematics(spec, file.name)
        posture = home_posture(spec, kinematics, roles.driven, home, lock, file.name)
        is_home_free = home is None and home_keyframe(spec) is None
        roles.warn(file.name)
        if roles.locked:
            keep_anchors(spec, kinematics, acting, roles.moving, posture)
            shorten_tendons(spec, kinematics, acting, roles.moving, posture, file.name)
        in_order = [name for name in _joint_names(kinematics) if name in roles.driven]
        servo = read_servo(spec, in_order, file.name) if actuators == "file" else None
        reduce_to_joints(spec, {*acting, *(servo.kept if servo else ())})
        lock_joints(spec, kinematics, roles.moving, posture)
        merge_rigid_links(spec, file.name, balance_inertia)
        friction = {"armature": armature, "viscous": viscous, "coulomb": coulomb}
        _set_joints(spec, names or in_order, friction)
        flags = mujoco.mjtDisableBit
        spec.option.disableflags |= flags.mjDSBL_AUTORESET | (0 if contact else flags.mjDSBL_CONTACT)
        start = {name: float(posture[name][0]) for name in roles.moving}
        plant = cls(spec, roles, start, tool or "", check.number("payload", payload, 0), file.name)
        options = {"joints": names, "lock": lock, "passive": passive, "home": home, **friction, "tool": tool}
        options |= {"payload": payload or None, "contact": contact or None, "balance_inertia": balance_inertia or None}
        options |= {"actuators": None if actuators == "file" else actuators}
        plant._constraints, plant._is_lock_enough = list(acting.values()), is_lock_enough
        plant._choose_home(is_home_free)
        plant.servo = None if servo is None else replace(servo, torque_limits=plant._torque_limits)
        plant._velocity_limits = velocity_limits(file, plant.joint_names, file.name)
        plant._motion_limits = motion_limits(file, plant.joint_names)
        plant._file_options = {"file": str(path)} | _plain_options(options)
        return plant

    def _choose_home(self, is_free: bool) -> None:
        """Move a home posture that is free to where the torque limits hold a robot all of whose joints are driven."""
        if is_free and self.is_fully_driven and not self._constraints:
            limits, ranges = self._torque_limits, self.position_limits
            self._start = holding_posture(self.gravity_torque, limits, ranges, self._start)

    @property
    def file_options(self) -> Mapping[str, object]:
        """Return the arguments of `from_file` that give this robot: ``file`` and the others."""
        return self._file_options

    @property
    def n_joints(self) -> int:
        """Return the number of driven joints n."""
        return len(self._driven)

    @property
    def n_coordinates(self) -> int:
        """Return the number m of driven and passive joints."""
        return self.model.nv

    @property
    def driven(self) -> tuple[int, ...]:
        """Return the numbers of the driven joints among all that move, from 0."""
        return self._driven

    @property
    def coordinate_names(self) -> list[str]:
        """Return the names of the driven and the passive joints, in the order of the file."""
        return [self.model.joint(i).name or f"joint{i + 1}" for i in range(self.model.njnt)]

    @property
    def coordinate_units(self) -> list[str]:
        """Return ``m`` for slides and ``rad`` for hinges, of the driven and the passive joints."""
        return ["m" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "rad" for kind in self.model.jnt_type]

    def coordinates(self, position: Vector) -> np.ndarray:
        """Return all positions, shape (m,), with the driven joints at a position (n,) and the passive ones at home.

        Where constraints hold the passive joints, they are where the constraints are satisfied, next to home.

        Raises
        ------
        InvalidParameter
            Where no position of the passive joints satisfies the constraints.
        """
        values = self._start.copy()
        values[list(self._driven)] = position
        return assembled(self.model, values, list(self.unmeasured), self.label) if self.model.neq else values

    @property
    def constraints(self) -> list[str]:
        """Return the constraints and tendons of the file that couple the joints, in words."""
        return self._constraints

    def joint_inertia(self, position: Numbers) -> np.ndarray:
        """Return the inertia that the torques of the driven joints accelerate, shape (n, n).

            (Bᵀ A B)⁻¹  with  A = M⁻¹ − M⁻¹Jᵀ (J M⁻¹ Jᵀ)⁺ J M⁻¹

        for constraints with the Jacobian J.

        Raises
        ------
        InvalidParameter
            Where constraints let the driven joints move only together.
        """
        if not self.model.neq:
            return super().joint_inertia(position)
        q = self.coordinates(check.vector("position", position, self.n_joints))
        mobility, places = np.linalg.inv(self.inertia(q)) / self._row_gains, list(self._driven)
        J = constraint_rows(self.model, q)[1]
        mobility = mobility - mobility @ J.T @ np.linalg.pinv(J @ mobility @ J.T, 1e-9) @ J @ mobility
        admittance = mobility[np.ix_(places, places)]
        if np.linalg.cond(admittance) > 1e9:
            raise InvalidParameter(
                f"inertia: {' and '.join(self.constraints)} of {self.label} let the driven joints move only together; "
                "give the inertia of the law as numbers, or drive fewer joints",
                "law.inertia",
            )
        return np.linalg.inv(admittance) / self.command_gain[:, None]

    def holding_torque(self, coordinates: Vector) -> np.ndarray:
        """Return the torque of the driven joints [N m or N], shape (n,), that keeps the robot at rest, of the least
        norm with the forces of the constraints."""
        gravity = self.gravity_torque(coordinates)
        if not self.model.neq:
            return gravity[list(self._driven)]
        gravity = gravity * self._row_gains
        torques = np.eye(self.n_coordinates)[:, list(self._driven)]
        J = constraint_rows(self.model, np.asarray(coordinates))[1]
        return np.linalg.lstsq(np.hstack([torques, J.T]), gravity, rcond=None)[0][: self.n_joints] / self.command_gain

    @property
    def _row_gains(self) -> np.ndarray:
        """Gains by which the rows of the equations are divided, shape (m,)."""
        gains = np.ones(self.n_coordinates)
        gains[list(self._driven)] = self.command_gain
        return gains

    @property
    def constraints_hint(self) -> str:
        """Return how to do without what couples the joints, for messages: lock the passive ones if that is enough."""
        return lock_hint(self.passive_joints) if self._is_lock_enough else super().constraints_hint

    @property
    def passive_hint(self) -> str:
        """Return how to lock the passive joints, for messages."""
        return lock_hint(self.passive_joints)

    @property
    def label(self) -> str:
        """Return the file's name."""
        return self._label

    @property
    def torque_limits(self) -> np.ndarray:
        """Return the torque limits of the file [N m or N], shape (n,), infinite where it has none.

        Where a range is not symmetric, the smaller end counts. Joints with inner loops have limits of their commands.
        """
        return self._torque_limits if self.servo is None else self.servo.limits(self)

    @property
    def torque_units(self) -> list[str]:
        """Return the unit of each joint's torque, force, or commanded position or velocity."""
        return super().torque_units if self.servo is None else self.servo.units(self.units)

    @property
    def command_gain(self) -> np.ndarray:
        """Return the torque per unit of what the law outputs, shape (n,)."""
        return super().command_gain if self.servo is None else self.servo.gain

    def in_torque_units(self) -> "MujocoPlant":
        """Return the same robot with the command of each joint multiplied by its gain."""
        if self.servo is None:
            return self
        changed = copy.copy(self)
        gain = self.servo.gain
        changed.servo = replace(
            self.servo,
            kinds=("torque",) * self.n_joints,
            gain=np.ones(self.n_joints),
            low=self.servo.low * gain,
            high=self.servo.high * gain,
            scale=self.servo.scale / gain,
        )
        return changed

    def without_servo(self) -> "MujocoPlant":
        """Return the same robot with joints that torques drive, without their inner loops."""
        changed = copy.copy(self)
        changed.servo = None
        changed.model = self.copy_model()
        changed.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
        changed._scratch = mujoco.MjData(changed.model)
        return changed

    @property
    def velocity_limits(self) -> np.ndarray:
        """Return the velocity limits of a URDF [rad/s or m/s], shape (n,), infinite where it has none."""
        return self._velocity_limits

    @property
    def acceleration_limits(self) -> np.ndarray:
        """Return the acceleration limits of a URDF 1.2 [rad/s² or m/s²], shape (n,), infinite where it has none."""
        return self._motion_limits["acceleration"]

    @property
    def deceleration_limits(self) -> np.ndarray:
        """Return the deceleration limits of a URDF 1.2 [rad/s² or m/s²], shape (n,), else those of acceleration."""
        return self._motion_limits["deceleration"]

    @property
    def jerk_limits(self) -> np.ndarray:
        """Return the jerk limits of a URDF 1.2 [rad/s³ or m/s³], shape (n,), infinite where it has none."""
        return self._motion_limits["jerk"]

    @property
    def position_limits(self) -> np.ndarray:
        """Return the joint ranges of the file [rad or m], shape (n, 2), infinite where it has none."""
        limited = self.model.jnt_limited.astype(bool)
        return np.where(limited[:, None], self.model.jnt_range, [-np.inf, np.inf])[list(self._driven)]

    @property
    def locked(self) -> dict[str, str]:
        """Return why each locked joint of the file is locked, by the joint's name."""
        return self._locked

    @property
    def needs_mujoco(self) -> str:
        """Return what only MuJoCo simulates, in words; empty for a robot whose equations can be written down."""
        model = self.model
        dynamics = () if self.servo is None else self.servo.dynamics
        reasons = dict.fromkeys([*self.constraints, *(f"the dynamics of actuator {name}" for name in dynamics)], True)
        reasons |= {
            "contacts": not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT,
            "gravity compensation": bool(np.any(model.body_gravcomp)),
            "a fluid around it": bool(model.opt.density or model.opt.viscosity),
            "damping that is not linear": bool(np.any(model.dof_damping.reshape(self.n_coordinates, -1)[:, 1:])),
            "springs that are not linear": bool(np.any(model.jnt_stiffness.reshape(self.n_coordinates, -1)[:, 1:])),
        }
        return " and ".join(name for name, applies in reasons.items() if applies)

    def require_equations(self) -> None:
        """Refuse a robot that only MuJoCo simulates.

        Raises
        ------
        RobotFileError
            With the reason.
        """
        reason = self.needs_mujoco
        if reason:
            raise RobotFileError(f"{self.label}: it has {reason}, which only MuJoCo simulates; use backend='mujoco'")

    @property
    def payload_place(self) -> str:
        """Return the body or site that carries the payload, for messages."""
        return f"at {self.carrier}"

    @property
    def joint_names(self) -> list[str]:
        """Return the names of the file."""
        return [self.coordinate_names[i] for i in self._driven]

    @property
    def units(self) -> list[str]:
        """Return ``m`` for slides and ``rad`` for hinges."""
        return [self.coordinate_units[i] for i in self._driven]

    @property
    def home(self) -> np.ndarray:
        """Return the home posture [rad or m], shape (n,): given, the keyframe ``home``, or within the ranges."""
        return self._start[list(self._driven)]

    @property
    def parameters(self) -> dict[str, np.ndarray]:
        """Return the payload [kg], and armature, viscous and Coulomb friction of each driven or passive joint."""
        model = self.model
        return {
            "payload": np.array(model.body_mass[self.payload_body]),
            "armature": model.dof_armature.copy(),
            "viscous": model.dof_damping.copy().reshape(self.n_coordinates, -1)[:, 0],
            "coulomb": model.dof_frictionloss.copy(),
        }

    def with_parameters(self, values: dict[str, Any]) -> "MujocoPlant":
        """Return the same robot with another payload, armature or friction."""
        nominal = self.parameters
        for name, value in values.items():
            check.one_of("parameters", name, nominal)
            check.vector(name, value, nominal[name].size, 0)
        changed = copy.copy(self)
        changed._file_options = {**self._file_options, **values}
        changed.model = self.copy_model()
        changed.set_parameters(changed.model, values)
        changed._scratch = mujoco.MjData(changed.model)
        return changed

    def set_parameters(self, model: mujoco.MjModel, values: dict[str, np.ndarray]) -> None:
        """Write parameters, as `parameters` names them, into a model of this robot."""
        if "payload" in values:
            mass = float(np.squeeze(values["payload"]))
            model.body_mass[self.payload_body] = mass
            model.body_inertia[self.payload_body] = 0.4 * mass * PAYLOAD_RADIUS**2
        if "armature" in values:
            model.dof_armature[:] = values["armature"]
        if "viscous" in values:
            model.dof_damping.reshape(self.n_coordinates, -1)[:, 0] = values["viscous"]
        if "coulomb" in values:
            model.dof_frictionloss[:] = values["coulomb"]
        mujoco.mj_setConst(model, self._scratch)

    def copy_model(self) -> mujoco.MjModel:
        """Return a copy of the model, whose parameters may change without changing this plant."""
        return copy.copy(self.model)

    def _placed(self, position: Numbers) -> mujoco.MjData:
        self._scratch.qpos[:] = check.vector("position", position, self.n_coordinates)
        self._scratch.qvel[:] = 0
        mujoco.mj_fwdPosition(self.model, self._scratch)
        return self._scratch

    def inertia(self, position: Numbers) -> np.ndarray:
        """Return M(q) with rotor inertia [kg m² or kg], shape (m, m)."""
        data = self._placed(position)
        matrix = np.zeros((self.n_coordinates, self.n_coordinates))
        mujoco.mj_fullM(self.model, data, matrix)
        return matrix if self.servo is None else self.servo.rows(matrix, self)

    def bias(self, position: Numbers, velocity: Numbers) -> np.ndarray:
        """Return N(q, q̇) without dry friction [N m or N], shape (m,)."""
        data = self._placed(position)
        data.qvel[:] = check.vector("velocity", velocity, self.n_coordinates)
        mujoco.mj_fwdVelocity(self.model, data)
        bias = data.qfrc_bias - data.qfrc_passive
        return bias if self.servo is None else self.servo.bias(bias, data.qpos, data.qvel, self)

    def linearised(
        self, position: Numbers, velocity: Numbers | None = None, acceleration: Numbers | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return M, D and G of M δq̈ + D δq̇ + G δq = δτ, the linearisation about a motion without dry friction."""
        q, v, a = self._motion(position, velocity, acceleration)
        M, D, step = self.inertia(q), self.damping(q, v), 1e-5
        self._scratch.qacc[:] = a
        stiffness = []
        for d in step * np.eye(self.n_coordinates):
            self._place(q + d)
            ahead = self._inverse(v)
            self._place(q - d)
            stiffness.append((ahead - self._inverse(v)) / (2 * step))
        return M, D, np.column_stack(stiffness)

    def damping(self, position: Numbers, velocity: Numbers | None = None) -> np.ndarray:
        """Return D = ∂N/∂q̇ without dry friction [N m s/rad or N s/m], shape (m, m); by default at rest."""
        q, v, still = self._motion(position, velocity, None)
        self._scratch.qacc[:] = still
        self._place(q)
        return np.column_stack([(self._inverse(v + d) - self._inverse(v - d)) / 2 for d in np.eye(self.n_coordinates)])

    def _place(self, position: np.ndarray) -> None:
        self._scratch.qpos[:] = position
        mujoco.mj_kinematics(self.model, self._scratch)
        mujoco.mj_comPos(self.model, self._scratch)

    def _inverse(self, velocity: np.ndarray) -> np.ndarray:
        """Return M(q) q̈ + N(q, q̇) at the position and acceleration set, without rotor inertia and dry friction."""
        model, data, torque = self.model, self._scratch, np.zeros(self.n_coordinates)
        data.qvel[:] = velocity
        mujoco.mj_comVel(model, data)
        mujoco.mj_passive(model, data)
        mujoco.mj_rne(model, data, 1, torque)
        torque -= data.qfrc_passive
        return torque if self.servo is None else self.servo.bias(torque, data.qpos, data.qvel, self)

    def gravity_torque(self, position: Vector) -> np.ndarray:
        """Return the torque that keeps the robot at rest [N m or N], shape (m,)."""
        data = self._placed(position)
        mujoco.mj_fwdVelocity(self.model, data)
        gravity = data.qfrc_bias - data.qfrc_passive
        return gravity if self.servo is None else self.servo.bias(gravity, data.qpos, data.qvel, self)


def _joint_names(model: mujoco.MjModel) -> list[str]:
    return [model.joint(i).name for i in range(model.njnt)]


def _set_joints(spec: mujoco.MjSpec, names: Sequence[str], values: Mapping[str, Numbers | None]) -> None:
    """Set rotor inertia and friction of the driven joints, in the order of their names."""
    joints = {joint.name: joint for joint in spec.joints}
    for name, value in values.items():
        if value is not None:
            for joint, number in zip(names, check.vector(name, value, len(names), 0), strict=True):
                set_joint(joints[joint], name, float(number))


def _plain_options(options: Mapping[str, Any]) -> dict[str, object]:
    """Return what is given, with names in lists and positions by name in dictionaries of their own."""
    plain: dict[str, object] = {}
    for key, value in options.items():
        if isinstance(value, Mapping):
            plain[key] = dict(value)
        elif key in ("joints", "lock", "passive") and value is not None:
            plain[key] = [value] if isinstance(value, str) else list(value)
        elif value is not None:
            plain[key] = value
    return plain
