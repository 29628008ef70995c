"""Gearbox between motors and links: elasticity, backlash, Stribeck friction and torque ripple."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import casadi as ca
import numpy as np

from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array, Vector
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.plants.delegating import DelegatingPlant
from tarc.plants.servo import ServoedPlant
from tarc.plants.symbolic import Equations, SymbolicPlant

PREFIX = "gearbox_"
"""Begin of the names of the gearbox's own parameters."""
ELASTIC = ("stiffness", "twist_damping", "motor_inertia", "backlash")
"""Parameters of a gearbox that is not rigid."""
AT_MOTOR = (
    "coulomb",
    "breakaway",
    "stribeck_speed",
    "viscous",
    "friction_width",
    "ripple",
    "ripple_cycles",
    "ripple_phase",
)
"""Parameters of friction and ripple at the motors."""
POSITIVE = ("stiffness", "motor_inertia", "stribeck_speed", "friction_width")
MAX_ITERATIONS = 50
"""Iterations for the links at rest behind motors at a given position."""


def stribeck_friction(dq: Vector, p: dict[str, Any]) -> Vector:
    """Return the friction torque [N m or N] at speeds (n,), with the parameters of `Gearbox` by name.

    F(q̇) = (F_C + (F_S − F_C) exp(−(q̇/v_S)²)) tanh(q̇/w) + F_v q̇
    """
    dry = p["coulomb"] + (p["breakaway"] - p["coulomb"]) * ca.exp(-((dq / p["stribeck_speed"]) ** 2))
    return dry * ca.tanh(dq / p["friction_width"]) + p["viscous"] * dq


def torque_ripple(position: Vector, p: dict[str, Any]) -> Vector:
    """Return c sin(N_c θ + φ) [N m or N] at a position of the motors (n,)."""
    return p["ripple"] * ca.sin(p["ripple_cycles"] * position + p["ripple_phase"])


def elastic_torque(twist: Vector, twist_rate: Vector, p: dict[str, Any]) -> Vector:
    """Return the torque [N m or N] through a gearbox with play, for a twist θ − q and its rate, each (n,).

    Without play it is K x + D ẋ. With a play of width b it is zero for |x| ≤ b/2. Beyond it is
    K (|x| − b/2) + D d|x|/dt, but not below zero, with the sign of x: teeth push and do not pull.
    """
    side = ca.sign(twist)
    depth = ca.fabs(twist) - p["backlash"] / 2
    push = ca.fmax(p["stiffness"] * depth + p["twist_damping"] * side * twist_rate, 0)
    with_play = ca.if_else(depth > 0, side * push, 0)
    return ca.if_else(p["backlash"] > 0, with_play, p["stiffness"] * twist + p["twist_damping"] * twist_rate)


@dataclass(frozen=True, kw_only=True, eq=False)
class GearedPlant(Component, DelegatingPlant):
    """What all robots behind gearboxes have; the parameters are those of `Gearbox`."""

    plant: Plant
    stiffness: Numbers | None = None
    twist_damping: Numbers = 0.0
    motor_inertia: Numbers | None = None
    backlash: Numbers = 0.0
    encoder: str = "motor"
    coulomb: Numbers = 0.0
    breakaway: Numbers | None = None
    stribeck_speed: Numbers = 0.1
    viscous: Numbers = 0.0
    friction_width: Numbers = 0.01
    ripple: Numbers = 0.0
    ripple_cycles: Numbers = 1.0
    ripple_phase: Numbers = 0.0

    def __post_init__(self) -> None:
        self._check_plant()
        self.plant.require_fully_driven("a gearbox")
        check.one_of("encoder", self.encoder, ["motor", "link"])
        for name in (*ELASTIC, *AT_MOTOR):
            if getattr(self, name) is not None:
                low = -np.inf if name in ("ripple", "ripple_phase") else 0
                check.vector(name, getattr(self, name), self.n_joints, low, strict=name in POSITIVE)
        for name in ("backlash", "twist_damping"):
            if self.stiffness is None and np.any(getattr(self, name)):
                raise InvalidParameter(f"{name}: given without a stiffness; a rigid gearbox has none", name)
        if self.is_elastic and self.motor_inertia is None and "armature" not in self.plant.parameters:
            raise InvalidParameter(
                f"motor_inertia: {self.plant.label} has no rotor inertia; give that of the motors, at the joints",
                "motor_inertia",
            )
        values = self._values()
        if self.is_elastic and not np.all(values["motor_inertia"] > 0):
            raise InvalidParameter(
                f"motor_inertia: the rotor inertia of {self.plant.label} is {values['motor_inertia'].tolist()}; an "
                "elastic gearbox needs one above 0 at each joint",
                "motor_inertia",
            )
        if np.any(values["breakaway"] < values["coulomb"]):
            raise InvalidParameter(
                f"breakaway: got {self.breakaway!r}; needs at least the dry friction, coulomb = {self.coulomb!r}"
            )

    def _check_plant(self) -> None:
        """Refuse a robot of another kind."""

    @property
    def is_elastic(self) -> bool:
        """Return whether motors and links move by themselves."""
        return self.stiffness is not None

    def _values(self) -> dict[str, Array]:
        """Return the gearbox's own parameters that count, each (n,), by name."""
        names = [*(ELASTIC if self.is_elastic else ("motor_inertia",)), *AT_MOTOR]
        values = {}
        for name in names:
            value = getattr(self, name)
            if name == "breakaway" and value is None:
                value = self.coulomb
            if name == "motor_inertia" and value is None:
                value = self.plant.parameters.get("armature", 0.0)
            values[name] = check.vector(name, np.squeeze(value), self.n_joints)
        return values

    @property
    def parameters(self) -> dict[str, Array]:
        """Return the parameters of the robot, and those of the gearbox with ``gearbox_`` before their names."""
        own = {f"{PREFIX}{name}": value for name, value in self._values().items()}
        return {**self.plant.parameters, **own}

    def with_parameters(self, values: dict[str, Any]) -> Self:
        """Return the same robot and gearbox with other `parameters`, by name."""
        for name in values:
            check.one_of("parameters", name, self.parameters)
        inner = {name: value for name, value in values.items() if name in self.plant.parameters}
        own = {name.removeprefix(PREFIX): value for name, value in values.items() if name not in inner}
        return replace(self, plant=self.plant.with_parameters(inner) if inner else self.plant, **own)

    def coordinates(self, position: Vector) -> Array:
        """Return links and motors at rest, shape (2n,) or (n,), with what the encoders read at a position (n,)."""
        position = check.vector("position", position, self.n_joints)
        if not self.is_elastic:
            return position
        if self.encoder == "link":
            return np.concatenate([position, position + self._static_twist(position)])
        link = position
        for _ in range(MAX_ITERATIONS):
            link = position - self._static_twist(link)
        return np.concatenate([link, position])

    def _static_twist(self, link: Array) -> Array:
        """Return θ − q (n,) under gravity, with the teeth in contact."""
        values, gravity = self._values(), self.plant.gravity_torque(link)
        return gravity / values["stiffness"] + np.sign(gravity) * values["backlash"] / 2

    @property
    def facts(self) -> Plant:
        """Return the robot without the gearboxes."""
        return self.plant

    @property
    def n_coordinates(self) -> int:
        """Return 2n, links before motors, or n for a rigid gearbox."""
        return 2 * self.n_joints if self.is_elastic else self.n_joints

    @property
    def driven(self) -> tuple[int, ...]:
        """Return the motors."""
        return tuple(range(self.n_coordinates - self.n_joints, self.n_coordinates))

    @property
    def measured(self) -> tuple[int, ...]:
        """Return the side of the encoders."""
        return tuple(range(self.n_joints)) if self.encoder == "link" else self.driven

    @property
    def coordinate_names(self) -> list[str]:
        """Return the names of the joints for the side that is measured, and others for the other side."""
        if not self.is_elastic:
            return self.joint_names
        names = self.joint_names
        if self.encoder == "link":
            return [*names, *(f"{name} motor" for name in names)]
        return [*(f"{name} link" for name in names), *names]

    @property
    def coordinate_units(self) -> list[str]:
        """Return the units of links and motors."""
        return [*self.units, *self.units] if self.is_elastic else self.units

    @property
    def passive_hint(self) -> str:
        """Return how to do without an elastic gearbox, for messages."""
        return "An elastic gearbox moves by itself: use the robot without it"

    @property
    def file_options(self) -> Mapping[str, object]:
        """Return nothing: no arguments of `load_robot` give a gearbox."""
        return {}


@dataclass(frozen=True, kw_only=True, eq=False)
class Gearbox(GearedPlant, SymbolicPlant):
    """A robot behind gearboxes: motors at θ drive the links at q.

        J θ̈ + F(θ̇) + c sin(N_c θ + φ) + τ_g = τ,     M(q) q̈ + N(q, q̇) = τ_g
        τ_g = K (θ − q) + D (θ̇ − q̇),  zero within the backlash

    All is counted at the joint, after the gear ratio. Without a stiffness the gearbox is rigid, θ = q, and adds only
    friction and ripple. M is then the robot's own; else it is without rotor inertia. The robot's own friction stays at
    the links. Every number is one for all joints or one per joint. As a parameter of the plant, which a schedule may
    change, it has ``gearbox_`` before its name.

    The law sees what the encoder reads. The other side is recorded as ``passive_position`` and ``passive_velocity``.
    Certificates refuse an elastic gearbox.

    Parameters
    ----------
    plant
        The robot, with a torque on every joint. Beside one in MuJoCo, the motors are integrated in MuJoCo's steps. An
        elastic gearbox then has as many steps per period as its fastest mode needs, unless ``substeps`` says else.
    stiffness
        K [N m/rad or N/m]; None for a rigid gearbox.
    twist_damping
        D [N m s/rad or N s/m].
    motor_inertia
        J [kg m² or kg]; None for the rotor inertia of the robot's file, its parameter ``armature``.
    backlash
        Width b of the play, from one tooth to the other [rad or m].
    encoder
        Side that the encoders read: ``motor`` or ``link``.
    coulomb
        Dry friction F_C at the motor [N m or N].
    breakaway
        Friction F_S about rest [N m or N], at least F_C; None for F_C.
    stribeck_speed
        v_S [rad/s or m/s], at which friction has fallen to F_C + (F_S − F_C)/e.
    viscous
        F_v [N m s/rad or N s/m].
    friction_width
        w [rad/s or m/s]: smoothed dry friction has 76 % of its size at this speed.
    ripple
        Amplitude c of the torque ripple, or cogging [N m or N].
    ripple_cycles
        Cycles N_c of the ripple per rad or m: pole pairs times gear ratio per rad of the joint, for instance.
    ripple_phase
        φ [rad].

    Raises
    ------
    InvalidParameter
        For a plant with passive coordinates or with inner loops. For an elastic gearbox without motor inertia, for
        backlash or damping without a stiffness, and for numbers out of their range.

    References
    ----------
    M. W. Spong, Modeling and Control of Elastic Joint Robots, ASME J. Dyn. Syst. Meas. Control 109(4), 1987;
    B. Armstrong-Hélouvry, P. Dupont and C. Canudas de Wit, A Survey of Models, Analysis Tools and Compensation Methods
    for the Control of Machines with Friction, Automatica 30(7), 1994; M. Nordin and P.-O. Gutman, Controlling
    Mechanical Systems with Backlash, Automatica 38(10), 2002.
    """

    def __new__(cls, plant: Plant | None = None, **options: Any) -> Self:
        """Return a `MujocoGearbox` for a robot in MuJoCo."""
        if isinstance(plant, Plant) and not isinstance(plant, SymbolicPlant):
            from tarc.plants.mujoco_gearbox import MujocoGearbox

            # no subclass of this one, but a `GearedPlant` with the same parameters; it refuses other kinds of robots
            return MujocoGearbox(plant=plant, **options)  # pyright: ignore[reportArgumentType, reportReturnType]
        return super().__new__(cls)

    def _check_plant(self) -> None:
        if isinstance(self.plant, ServoedPlant):
            raise InvalidParameter(
                "gearbox: got a robot with inner loops at its joints; give the loops the robot with its gearbox, as in "
                "PositionServo(Gearbox(plant=robot, …), kp, kd)"
            )
        if not isinstance(self.plant, SymbolicPlant):
            raise InvalidParameter(
                f"gearbox: got {self.plant!r}; needs a robot of tarc.plants, from energies or by load_robot"
            )

    @property
    def dry_friction(self) -> tuple[str, ...]:
        """Return the parameters that are zero without dry friction."""
        return (*super().dry_friction, f"{PREFIX}coulomb", f"{PREFIX}breakaway")

    def with_parameters(self, values: dict[str, Any]) -> Self:
        """Return the same robot and gearbox with other `parameters`, by name."""
        changed = super().with_parameters(values)
        vars(changed)["_functions"] = self._functions  # their inputs include the parameters
        return changed

    def equations(self) -> Equations:
        """Return the equations of the links and the motors, or of the joints of a rigid gearbox."""
        assert isinstance(self.plant, SymbolicPlant)
        inner = self.plant.equations()
        n = self.n_joints
        p = {name: ca.SX.sym(f"{PREFIX}{name}", n) for name in self._values()}
        parameters = {**inner.parameters, **{f"{PREFIX}{name}": symbol for name, symbol in p.items()}}
        M = inner.inertia
        if "armature" in inner.parameters:
            M = ca.substitute(M, inner.parameters["armature"], ca.SX.zeros(n))
        if not self.is_elastic:
            friction = stribeck_friction(inner.dq, p)
            bias = inner.bias + friction + torque_ripple(inner.q, p)
            return Equations(
                inner.q, inner.dq, parameters, M + ca.diag(p["motor_inertia"]), bias, inner.friction + friction, {}
            )
        motor, motor_rate = ca.SX.sym("motor", n), ca.SX.sym("motor_rate", n)
        torque = elastic_torque(motor - inner.q, motor_rate - inner.dq, p)
        friction = stribeck_friction(motor_rate, p)
        return Equations(
            ca.vertcat(inner.q, motor),
            ca.vertcat(inner.dq, motor_rate),
            parameters,
            ca.diagcat(M, ca.diag(p["motor_inertia"])),
            ca.vertcat(inner.bias - torque, friction + torque_ripple(motor, p) + torque),
            ca.vertcat(inner.friction, friction),
            {},
        )
