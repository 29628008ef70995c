"""Motors and gears beside a robot in MuJoCo."""

import mujoco
import numpy as np

from tarc.core.tracing import FixedCall
from tarc.core.types import Array
from tarc.plants.mujoco_gearbox import MujocoGearbox


class Gears:
    """State of links and motors, which a step of MuJoCo and of the motors advances.

    Attributes
    ----------
    position, velocity, acceleration
        Of all coordinates, each (m,), links before motors.
    torque
        Torque on the motors [N m or N], (n,), to be written before a step.
    """

    def __init__(self, plant: MujocoGearbox, model: mujoco.MjModel, data: mujoco.MjData, start: Array, rates: Array):
        n, m = plant.n_joints, plant.n_coordinates
        self._model, self._data, self._is_elastic, self._n = model, data, plant.is_elastic, n
        self._call = FixedCall(plant.step_function)
        self.position, self.velocity = (self._call.inputs[i] for i in range(2))
        self.torque, self._step_size = self._call.inputs[2], self._call.inputs[3]
        self._parameters = dict(zip(plant.gear_parameters(), self._call.inputs[4:], strict=True))
        self.acceleration = np.zeros(m)
        self.set_parameters(plant.gear_parameters())
        self.position[:] = start
        self.velocity[:] = rates
        data.qpos[:] = start[:n]
        data.qvel[:] = rates[:n]

    def set_parameters(self, values: dict[str, Array]) -> None:
        """Set those of some parameters that are the gearbox's, and read the joints' damping anew."""
        for name in values.keys() & self._parameters:
            self._parameters[name][:] = values[name]
        self._damping = self._model.dof_damping.reshape(self._n, -1)[:, 0].copy()

    def step(self) -> None:
        """Advance links and motors by the time step of the model."""
        n, step_size = self._n, self._model.opt.timestep
        motor_acceleration = self._apply(step_size)
        mujoco.mj_step(self._model, self._data)
        if self._is_elastic:
            self.velocity[n:] += step_size * motor_acceleration
            self.position[n:] += step_size * self.velocity[n:]
        self.position[:n] = self._data.qpos
        self.velocity[:n] = self._data.qvel
        self.acceleration[:n] = self._data.qacc
        self.acceleration[n:] = motor_acceleration

    def update_acceleration(self) -> None:
        """Compute the accelerations at the present state and torque."""
        self.acceleration[self._n :] = self._apply(0.0)
        mujoco.mj_forward(self._model, self._data)
        self.acceleration[: self._n] = self._data.qacc

    def _apply(self, step_size: float) -> Array:
        """Let the gears act on the links; return the accelerations of the motors."""
        n = self._n
        self._step_size[:] = step_size
        result = self._call()[:, 0]
        if self._is_elastic:
            self._data.qfrc_applied[:] = result[:n]
            return result[n:]
        self._data.qfrc_applied[:] = self.torque + result[:n]
        self._model.dof_damping.reshape(n, -1)[:, 0] = self._damping + result[n:]
        return np.zeros(0)
