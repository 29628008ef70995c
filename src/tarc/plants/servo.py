"""Joints with inner loops: the law commands positions or velocities in place of torques."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array, Vector
from tarc.core.units import unit_for_joints
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.plants.delegating import DelegatingPlant
from tarc.plants.symbolic import Equations, ForwardDynamics, SymbolicPlant

UNITS = {"torque": "N m", "position": "rad", "velocity": "rad/s"}
"""Unit of the command of a joint by its kind, for a revolute joint."""


@dataclass(frozen=True, eq=False)
class Servo:
    """Inner loops of n joints: τ = gain c − stiffness q − damping q̇, for a command c; all arrays have shape (n,).

    Attributes
    ----------
    kinds
        What each joint is commanded: ``torque``, ``position`` or ``velocity``.
    gain
        Torque per unit of the command.
    stiffness, damping
        Torque per position and velocity [N m/rad, N m s/rad].
    low, high
        Range to which the command is clipped; infinite for none.
    torque_limits
        Largest torque of the joint [N m or N], to which τ is clipped; infinite for none.
    """

    kinds: tuple[str, ...]
    gain: Array
    stiffness: Array
    damping: Array
    low: Array
    high: Array
    torque_limits: Array

    def torque(self, command: Vector, position: Vector, velocity: Vector) -> Vector:
        """Return τ [N m or N] within its limits, shape (n,)."""
        if np.any(np.isfinite([*self.low, *self.high])):
            command = ops.clip(command, self.low, self.high)
        torque = self.gain * command - self.stiffness * position - self.damping * velocity
        if np.any(np.isfinite(self.torque_limits)):
            torque = ops.clip(torque, -self.torque_limits, self.torque_limits)
        return torque

    def units(self, joint_units: list[str]) -> list[str]:
        """Return the unit of the command of each joint."""
        return [unit_for_joints(UNITS[kind], [unit]) for kind, unit in zip(self.kinds, joint_units, strict=True)]

    def rows(self, matrix: Array, plant: Plant) -> Array:
        """Divide the rows (m, …) of a robot's equations by the gains of the joints that they drive."""
        gain = np.ones(plant.n_coordinates)
        gain[list(plant.driven)] = self.gain
        return matrix / (gain[:, None] if matrix.ndim == 2 else gain)

    def bias(self, bias: Array, position: Array, velocity: Array, plant: Plant) -> Array:
        """Return N with the loops, in units of the command, from that of the robot and its state, each (m,)."""
        places = list(plant.driven)
        forces = bias.copy()
        forces[places] += self.stiffness * position[places] + self.damping * velocity[places]
        return self.rows(forces, plant)

    def limits(self, plant: Plant) -> Array:
        """Return the largest magnitude of the command of each joint, shape (n,).

        It is that of the servo's range. A position without a range is commanded at most as far beyond the range of the
        joint as the torque limit is worth.
        """
        largest = np.maximum(np.abs(self.low), np.abs(self.high))
        beyond = np.max(np.abs(plant.position_limits), axis=1) + self.torque_limits / self.gain
        with_range = {"position": beyond, "torque": self.torque_limits, "velocity": plant.velocity_limits}
        rows = [with_range[kind][i] for i, kind in enumerate(self.kinds)]
        return np.where(np.isfinite(largest), largest, rows)


class ServoedPlant(DelegatingPlant, SymbolicPlant):
    """A robot in symbols with an inner loop at each joint, which takes the law's output as its command c.

        M(q) q̈ + N(q, q̇) + B (K q + D q̇) = B G c

    In units of the command, each row is divided by the gain of its joint: the inertia is G⁻¹ M, and so on. The joints'
    torques are clipped to their limits in a simulation, and so are the commands to their ranges. Disturbances are
    torques.

    Attributes
    ----------
    plant
        The robot without the loops.
    servo
        The loops.
    """

    def __init__(self, plant: Plant, servo: Servo):
        if not isinstance(plant, SymbolicPlant) or isinstance(plant, ServoedPlant):
            raise InvalidParameter(
                f"plant: got {plant!r}; needs a robot in symbols that takes torques, from energies or from a file"
            )
        self.plant = plant
        self.servo = servo
        self._is_from_file = False

    def from_file(self) -> Self:
        """Return it with the `file_options` of its robot, which then are those of the loops too."""
        self._is_from_file = True
        return self

    @property
    def file_options(self) -> Mapping[str, object]:
        """Return the arguments of `load_robot` that read this robot again; empty where no arguments do."""
        return self.plant.file_options if self._is_from_file else {}

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.plant!r})"

    @property
    def facts(self) -> SymbolicPlant:
        """Return the robot without the loops."""
        return self.plant

    @property
    def torque_units(self) -> list[str]:
        """Return the unit of each joint's command, such as ``rad`` for a position."""
        return self.servo.units(self.units)

    @property
    def torque_limits(self) -> Array:
        """Return the largest magnitude of the command of each joint, shape (n,), infinite where there is no limit."""
        return self.servo.limits(self.plant)

    @property
    def dry_friction(self) -> tuple[str, ...]:
        """Return the parameters that are zero without dry friction."""
        return self.plant.dry_friction

    @property
    def command_gain(self) -> Array:
        """Return the torque per unit of the command, shape (n,)."""
        return self.servo.gain

    def in_torque_units(self) -> "ServoedPlant":
        """Return the same robot with the command of each joint multiplied by its gain."""
        gain = self.servo.gain
        low, high = self.servo.low * gain, self.servo.high * gain
        kinds = ("torque",) * self.n_joints
        return ServoedPlant(
            self.plant, replace(self.servo, kinds=kinds, gain=np.ones(self.n_joints), low=low, high=high)
        )

    @property
    def parameters(self) -> dict[str, Array]:
        """Return the parameters of the robot without the loops."""
        return self.plant.parameters

    def with_parameters(self, values: dict[str, Any]) -> Self:
        """Return the same robot with other `parameters`, by name."""
        functions = self._functions  # their inputs include the parameters
        plant = copy.copy(self)
        vars(plant)["_functions"] = functions
        plant.plant = self.plant.with_parameters(values)
        return plant

    def joint_input(self, torque: Vector, disturbance: Vector) -> Vector:
        """Return commands and disturbance torques in one column, each with n rows."""
        if ops.symbolic(torque, disturbance):
            return ca.vertcat(torque, disturbance)
        return np.concatenate([torque, disturbance])

    def equations(self) -> Equations:
        """Return the equations of motion in units of the command."""
        q, dq, parameters, M, N, friction, *_ = self.plant.equations()
        n, places = self.n_joints, list(self.driven)
        inputs = ca.SX.sym("input", 2 * n)
        gain = _scatter(self.servo.gain, places, np.ones(self.n_coordinates))
        zeros = np.zeros(self.n_coordinates)
        stiffness, damping = (_scatter(x, places, zeros) for x in (self.servo.stiffness, self.servo.damping))
        force = ca.SX.zeros(self.n_coordinates)
        force[places] = self.servo.torque(inputs[:n], q[places], dq[places]) + inputs[n:]
        scaled = ca.diag(ca.DM(1 / gain)) @ M
        bias = (N + stiffness * q + damping * dq) / gain
        forward = ForwardDynamics(inputs, M, force - N)
        return Equations(q, dq, parameters, scaled, bias, friction / gain, {}, forward)


class PositionServo(ServoedPlant):
    """A robot in symbols whose joints follow commanded positions c by proportional-derivative loops.

        M(q) q̈ + N(q, q̇) + kp q + kd q̇ = kp c

    A law on it outputs position commands, in a simulation and in `tarc.Controller` alike. Its inertia M̂ is in units of
    M/kp [s²]. The torque limits of the robot clip the torques of the loops. Command limits are those with which these
    torques are still reached at the ends of the joints' ranges.

    Parameters
    ----------
    plant
        The robot that takes torques.
    kp
        Gain on the position error [N m/rad or N/m], one number or one per joint.
    kd
        Gain on the velocity [N m s/rad or N s/m], one number or one per joint.

    Raises
    ------
    InvalidParameter
        For a plant that is not in symbols, and for gains that are not positive.

    Examples
    --------
    >>> import tarc
    >>> arm = tarc.plants.PositionServo(tarc.plants.TwoLinkArm(), kp=500.0, kd=20.0)
    >>> arm.torque_units
    ['rad', 'rad']
    """

    def __init__(self, plant: Plant, kp: Numbers, kd: Numbers = 0.0):
        if not isinstance(plant, Plant):
            raise InvalidParameter(f"plant: got {plant!r}; needs one of tarc.plants")
        n = plant.n_joints
        servo = Servo(
            kinds=("position",) * n,
            gain=check.vector("kp", kp, n, 0, strict=True),
            stiffness=check.vector("kp", kp, n, 0, strict=True),
            damping=check.vector("kd", kd, n, 0),
            low=np.full(n, -np.inf),
            high=np.full(n, np.inf),
            torque_limits=np.array(plant.torque_limits, dtype=float),
        )
        super().__init__(plant, servo)


def _scatter(values: Array, places: list[int], others: Array) -> Array:
    """Return an array with some values in their places."""
    result = others.copy()
    result[places] = values
    return result
