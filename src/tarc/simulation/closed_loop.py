"""The closed loop: sensor, law, actuator, plant; and `simulate`, which runs it."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tarc.control.digital_controller import ControllerInput, ControllerOutput, ControllerState, DigitalController
from tarc.core.system import System
from tarc.plants.euler_lagrange import EulerLagrange


class LoopInput(NamedTuple):
    """What comes from outside in one period: drive inputs (n,), disturbance (n, substeps), plant parameters."""

    reference: Any
    velocity_reference: Any
    acceleration_reference: Any
    noise: Any
    disturbance: Any
    parameters: dict[str, Any]


class LoopState(NamedTuple):
    """Controller state, position and velocity of the plant."""

    drive: ControllerState
    position: Any
    velocity: Any


class LoopOutput(NamedTuple):
    """True motion at the instant of sampling, the acceleration just after the torque was set, and the drive's."""

    position: Any
    velocity: Any
    acceleration: Any
    drive: ControllerOutput


@dataclass(frozen=True, eq=False)
class ClosedLoop(System):
    """One control period: the drive at its start, then the plant under zero-order hold by Runge–Kutta substeps."""

    plant: EulerLagrange
    drive: DigitalController
    substeps: int = 2

    def init(self, position: Any, velocity: Any = 0.0, torque: Any = 0.0, noise: Any = 0.0) -> LoopState:
        """The robot at a position (n,) with a velocity, the drive at rest there."""
        drive, velocity = self.drive.init(position, torque, noise), velocity + np.zeros(np.shape(position))
        acceleration = self.plant.evaluate("acceleration", position, velocity, drive.torque_delay_line[:, -1])
        return LoopState(self.drive.with_true_derivatives(drive, velocity, acceleration), position, velocity)

    def step(self, state: LoopState, value: LoopInput) -> tuple[LoopState, LoopOutput]:
        """Measure and compute at t_k; hold the torque and integrate to t_k + T."""
        q, dq = state.position, state.velocity
        drive, output = self.drive.step(state.drive, ControllerInput(q, *value[:4]))
        dt = self.drive.law.period / self.substeps
        torque, first = output.torque, None
        for i in range(self.substeps):
            torque = output.torque + value.disturbance[:, i]
            q, dq, acceleration = runge_kutta(self.plant, q, dq, torque, dt, value.parameters)
            first = acceleration if first is None else first
        last = self.plant.evaluate("acceleration", q, dq, torque, parameters=value.parameters)
        drive = self.drive.with_true_derivatives(drive, dq, last)
        return LoopState(drive, q, dq), LoopOutput(state.position, state.velocity, first, output)


def runge_kutta(
    plant: EulerLagrange, q: Any, dq: Any, torque: Any, dt: float, parameters: dict[str, Any] | None = None
) -> tuple[Any, Any, Any]:
    """Position and velocity after dt by the classical fourth-order method, and the acceleration at its start."""

    def slope(q: Any, dq: Any) -> Any:
        return plant.evaluate("acceleration", q, dq, torque, parameters=parameters)

    a1 = slope(q, dq)
    v2 = dq + dt / 2 * a1
    a2 = slope(q + dt / 2 * dq, v2)
    v3 = dq + dt / 2 * a2
    a3 = slope(q + dt / 2 * v2, v3)
    v4 = dq + dt * a3
    a4 = slope(q + dt * v3, v4)
    return q + dt / 6 * (dq + 2 * v2 + 2 * v3 + v4), dq + dt / 6 * (a1 + 2 * a2 + 2 * a3 + a4), a1
