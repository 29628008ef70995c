"""Gearboxes of a robot in MuJoCo: its links there, and the motors beside it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array, Vector
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.plants.gearbox import PREFIX, GearedPlant, elastic_torque, stribeck_friction, torque_ripple
from tarc.plants.mujoco import MujocoPlant

STEPS_PER_RADIAN = 4
"""Steps of MuJoCo in which the fastest mode of an elastic gearbox advances by a radian."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MujocoGearbox(GearedPlant):
    """A `MujocoPlant` behind gearboxes, made by `Gearbox`; the equations and parameters are those there.

    MuJoCo moves the links under the torque τ_g of the gears. The motors are integrated beside it, in the same steps:

        θ̇⁺ = θ̇ + h (τ − F(θ̇) − c sin(N_c θ + φ) − τ_g)/(J + h F'(θ̇)),    θ⁺ = θ + h θ̇⁺

    F' is the slope of friction where it is positive. In a rigid gearbox it is damping of the joint in MuJoCo. The
    method is of first order, as MuJoCo's own.
    """

    plant: MujocoPlant

    def _check_plant(self) -> None:
        if not isinstance(self.plant, MujocoPlant):
            raise InvalidParameter(f"gearbox: got {self.plant!r}; needs a robot in MuJoCo")
        if self.plant.servo is not None:
            raise InvalidParameter(
                f"gearbox: {self.plant.label} has actuators with inner loops, which act on the links; read the file "
                "with actuators='torque'"
            )

    @cached_property
    def links(self) -> MujocoPlant:
        """The robot with the rotor inertia that its joints keep: none behind an elastic gearbox."""
        rotors = np.zeros(self.n_joints) if self.is_elastic else self._values()["motor_inertia"]
        return self.plant.with_parameters({"armature": rotors})

    @property
    def model(self) -> mujoco.MjModel:
        """Return the model of the links."""
        return self.links.model

    @property
    def servo(self) -> None:
        """Return nothing: the law commands torques."""
        return

    def copy_model(self) -> mujoco.MjModel:
        """Return a copy of the model of the links."""
        return self.links.copy_model()

    def set_parameters(self, model: mujoco.MjModel, values: dict[str, Array]) -> None:
        """Write the robot's own parameters into a model of the links; their rotors stay as they are."""
        own = {name: value for name, value in values.items() if not name.startswith(PREFIX) and name != "armature"}
        self.links.set_parameters(model, own)

    def min_substeps(self, period: float) -> int:
        """Return the steps of MuJoCo in a period [s] that resolve an elastic gearbox at the home posture.

        Each advances the fastest mode, ω² = max eig K (M⁻¹ + J⁻¹), by a quarter of a radian at most.
        """
        if not self.is_elastic:
            return 1
        values = self._values()
        mobility = np.linalg.inv(self.links.inertia(self.plant.home)) + np.diag(1 / values["motor_inertia"])

        def fastest(gains: Array) -> float:
            return float(np.max(np.abs(np.linalg.eigvals(np.diag(gains) @ mobility))))

        rate = max(STEPS_PER_RADIAN * np.sqrt(fastest(values["stiffness"])), fastest(values["twist_damping"]))
        return max(1, int(np.ceil(rate * period)))

    @cached_property
    def step_function(self) -> ca.Function:
        """The function of coordinates, velocities, torques and step, and of the gearbox's parameters.

        The result is one column. For an elastic gearbox it has τ_g and the accelerations of the motors. For a rigid one
        it has the torque of friction and ripple, and the damping of the joints.
        """
        n, m = self.n_joints, self.n_coordinates
        q, dq, torque, step = ca.SX.sym("q", m), ca.SX.sym("dq", m), ca.SX.sym("torque", n), ca.SX.sym("step")
        p = {name: ca.SX.sym(name, n) for name in self._values()}
        position, velocity = q[m - n :], dq[m - n :]
        friction = stribeck_friction(velocity, p)
        slope = ca.fmax(ca.jtimes(friction, velocity, ca.SX.ones(n)), 0)
        own = friction + torque_ripple(position, p)
        if self.is_elastic:
            gear = elastic_torque(position - q[:n], velocity - dq[:n], p)
            result = ca.vertcat(gear, (torque - own - gear) / (p["motor_inertia"] + step * slope))
        else:
            result = ca.vertcat(slope * velocity - own, slope)
        return ca.Function("gear", [q, dq, torque, step, *p.values()], [result], {"cse": True})

    def gear_parameters(self) -> dict[str, Array]:
        """Return the parameters of `step_function`, each (n,), as a schedule names them."""
        return {f"{PREFIX}{name}": value for name, value in self._values().items()}

    def inertia(self, position: Numbers) -> Array:
        """Return M(q) of links and motors [kg m² or kg], shape (m, m)."""
        q, n = check.vector("position", position, self.n_coordinates), self.n_joints
        if not self.is_elastic:
            return self.links.inertia(q)
        M = np.zeros((2 * n, 2 * n))
        M[:n, :n] = self.links.inertia(q[:n])
        M[n:, n:] = np.diag(self._values()["motor_inertia"])
        return M

    def bias(self, position: Numbers, velocity: Numbers) -> Array:
        """Return N(q, q̇) without dry friction [N m or N], shape (m,)."""
        m, n = self.n_coordinates, self.n_joints
        q, v = check.vector("position", position, m), check.vector("velocity", velocity, m)
        smooth = {"coulomb": np.zeros(n), "breakaway": np.zeros(n)}
        p: dict[str, Any] = {name: ca.DM(value) for name, value in {**self._values(), **smooth}.items()}
        at_motor = stribeck_friction(ca.DM(v[m - n :]), p) + torque_ripple(ca.DM(q[m - n :]), p)
        own = np.array(at_motor).ravel()
        inner = self.links.bias(q[:n], v[:n])
        if not self.is_elastic:
            return inner + own
        gear = np.array(elastic_torque(ca.DM(q[n:] - q[:n]), ca.DM(v[n:] - v[:n]), p)).ravel()
        return np.concatenate([inner - gear, own + gear])

    def gravity_torque(self, position: Vector) -> Array:
        """Return N(q, 0) [N m or N], shape (m,)."""
        return self.bias(position, np.zeros(self.n_coordinates))

    @property
    def facts(self) -> Plant:
        """Return the robot without the gearboxes."""
        return self.plant
