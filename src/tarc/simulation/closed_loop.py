"""The closed loop: sensor, law, computation delay and plant, one control period per step."""

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from tarc.control.digital_controller import ControllerInput, ControllerOutput, ControllerState, DigitalController
from tarc.core.system import System
from tarc.core.types import Array, Vector
from tarc.core.validation import Numbers
from tarc.plants.symbolic import SymbolicPlant

V = TypeVar("V", np.ndarray, ca.SX, ca.MX)
"""Numbers or symbols, the same for all arguments."""


class LoopInput(NamedTuple):
    """Inputs of one period: reference and noise (n,), disturbance (n, substeps), plant parameters by name."""

    reference: Vector
    velocity_reference: Vector
    acceleration_reference: Vector
    noise: Vector
    disturbance: Vector
    parameters: dict[str, Any]


class LoopState(NamedTuple):
    """State of the controller, coordinates and velocities of the plant, each (m,)."""

    controller: ControllerState
    position: Vector
    velocity: Vector


class LoopOutput(NamedTuple):
    """True motion at the sampling instant, acceleration just after the torque was set, output of the controller.

    The motion is that of the coordinates that the encoders read. ``passive`` has position and velocity of the others,
    where there are any.
    """

    position: Vector
    velocity: Vector
    acceleration: Vector
    controller: ControllerOutput
    passive: dict[str, Vector]


@dataclass(frozen=True, eq=False)
class ClosedLoop(System):
    """One control period: the controller at its start, then the plant under zero-order hold in substeps."""

    plant: SymbolicPlant
    controller: DigitalController
    substeps: int = 2
    integrator: str = "Runge–Kutta"

    def init(
        self, position: Vector, velocity: Numbers = 0.0, torque: Numbers = 0.0, noise: Array | float = 0.0
    ) -> LoopState:
        """Return the state with the robot at its coordinates (m,) with a velocity, and the controller at rest."""
        velocity = np.asarray(velocity) + np.zeros(np.shape(position))
        controller = self.controller.init(self._measured(position), torque, noise)
        acceleration = self.plant.evaluate("acceleration", position, velocity, controller.torque_delay_line[:, -1])
        controller = self.controller.with_true_derivatives(
            controller, self._measured(velocity), self._measured(acceleration)
        )
        return LoopState(controller, position, velocity)

    def step(self, state: LoopState, value: LoopInput) -> tuple[LoopState, LoopOutput]:
        """Measure and compute at t_k; hold the torque and integrate to t_k + T."""
        q: Vector = state.position
        dq: Vector = state.velocity
        motion = self._measured(q), self._measured(dq)
        controller, output = self.controller.step(state.controller, ControllerInput(*motion, *value[:4]))
        dt = self.controller.law.period / self.substeps
        torque = output.torque
        first_acceleration: Vector = None
        for i in range(self.substeps):
            torque = output.torque + value.disturbance[:, i]
            q, dq, acceleration = INTEGRATORS[self.integrator](self.plant, q, dq, torque, dt, value.parameters)
            first_acceleration = acceleration if first_acceleration is None else first_acceleration
        last_acceleration = self.plant.evaluate("acceleration", q, dq, torque, parameters=value.parameters)
        controller = self.controller.with_true_derivatives(
            controller, self._measured(dq), self._measured(last_acceleration)
        )
        recorded = LoopOutput(*motion, self._measured(first_acceleration), output, self._passive(state))
        return LoopState(controller, q, dq), recorded

    def _measured(self, values: Vector) -> Vector:
        """Return what the encoders read of all coordinates, shape (n,)."""
        return values if self.plant.is_fully_driven else values[list(self.plant.measured)]

    def _passive(self, state: LoopState) -> dict[str, Vector]:
        """Return position and velocity of what no encoder reads; nothing where there is nothing."""
        places = list(self.plant.unmeasured)
        if not places:
            return {}
        return {"passive_position": state.position[places], "passive_velocity": state.velocity[places]}


def midpoint(
    plant: SymbolicPlant,
    q: V,
    dq: V,
    torque: Vector,
    dt: float,
    parameters: dict[str, Any] | None = None,
) -> tuple[V, V, V]:
    """Integrate by Nyström's midpoint method, of second order; return what `runge_kutta` returns.

    a₁ = f(q, q̇),    a₂ = f(q + h/2 q̇ + h²/8 a₁, q̇ + h/2 a₁)
    q⁺ = q + h q̇ + h²/6 (a₁ + 2 a₂),    q̇⁺ = q̇ + h a₂
    """
    a1 = plant.evaluate("acceleration", q, dq, torque, parameters=parameters)
    middle = q + dt / 2 * dq + dt**2 / 8 * a1
    a2 = plant.evaluate("acceleration", middle, dq + dt / 2 * a1, torque, parameters=parameters)
    return q + dt * dq + dt**2 / 6 * (a1 + 2 * a2), dq + dt * a2, a1


def runge_kutta(
    plant: SymbolicPlant,
    q: V,
    dq: V,
    torque: Vector,
    dt: float,
    parameters: dict[str, Any] | None = None,
) -> tuple[V, V, V]:
    """Integrate by the classical fourth-order method; return position and velocity after dt, acceleration before it."""

    def acceleration(q: V, dq: V) -> V:
        return plant.evaluate("acceleration", q, dq, torque, parameters=parameters)

    a1 = acceleration(q, dq)
    v2 = dq + dt / 2 * a1
    a2 = acceleration(q + dt / 2 * dq, v2)
    v3 = dq + dt / 2 * a2
    a3 = acceleration(q + dt / 2 * v2, v3)
    v4 = dq + dt * a3
    a4 = acceleration(q + dt * v3, v4)
    return q + dt / 6 * (dq + 2 * v2 + 2 * v3 + v4), dq + dt / 6 * (a1 + 2 * a2 + 2 * a3 + a4), a1


INTEGRATORS = {"midpoint": midpoint, "Runge–Kutta": runge_kutta}
"""Methods for a plant under zero-order hold, by name, the cheaper first."""
