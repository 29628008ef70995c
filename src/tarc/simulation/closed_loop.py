"""The closed loop: sensor, law, computation delay and plant, one control period per step."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from tarc.control.digital_controller import ControllerInput, ControllerOutput, ControllerState, DigitalController
from tarc.core.system import System
from tarc.core.types import Array, Tree, Vector
from tarc.core.validation import Numbers
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.drive import Drive, Segment

V = TypeVar("V", np.ndarray, ca.SX, ca.MX)
"""Numbers or symbols, the same for all arguments."""

NO_NUMBERS = np.zeros(0)


class LoopInput(NamedTuple):
    """Inputs of one period: reference and noise (n,), disturbance (n, substeps), plant parameters by name.

    ``period`` is the length of this period [s], shape (1,), where periods differ; else it has shape (0,). ``age`` is
    that of the sample [periods], shape (1,), where it differs; else it has shape (0,).
    """

    reference: Vector
    velocity_reference: Vector
    acceleration_reference: Vector
    noise: Vector
    disturbance: Vector
    parameters: dict[str, Any]
    period: Vector = NO_NUMBERS
    age: Vector = NO_NUMBERS


class LoopState(NamedTuple):
    """State of the controller, coordinates and velocities of the plant, each (m,), and state of a drive."""

    controller: ControllerState
    position: Vector
    velocity: Vector
    drive: Tree = ()


class LoopOutput(NamedTuple):
    """True motion at the sampling instant, acceleration just after the torque was set, output of the controller.

    The motion is that of the coordinates that the encoders read. ``more`` has position and velocity of the others,
    where there are any, and the mean torque of a drive.
    """

    position: Vector
    velocity: Vector
    acceleration: Vector
    controller: ControllerOutput
    more: dict[str, Vector]


@dataclass(frozen=True, eq=False)
class ClosedLoop(System):
    """One control period: the controller at its start, then the plant under zero-order hold in substeps.

    With a drive, the torque changes within the period too.
    """

    plant: SymbolicPlant
    controller: DigitalController
    substeps: int = 2
    integrator: str = "Runge–Kutta"
    drive: Drive | None = None

    @cached_property
    def _segments(self) -> list[Segment]:
        """Parts of a period in which the torque is held."""
        return (self.drive or Drive()).segments(self.substeps, self.controller.law.period)

    def init(
        self, position: Vector, velocity: Numbers = 0.0, torque: Numbers = 0.0, noise: Array | float = 0.0
    ) -> LoopState:
        """Return the state with the robot at its coordinates (m,) with a velocity, and the controller at rest."""
        velocity = np.asarray(velocity) + np.zeros(np.shape(position))
        controller = self.controller.init(self._measured(position), torque, noise)
        if self.controller.needs_true_derivatives:
            applied = controller.torque_delay_line[:, -1]
            joint_input = self.plant.joint_input(applied, np.zeros(np.shape(applied)))
            acceleration = self.plant.evaluate("acceleration", position, velocity, joint_input)
            controller = self.controller.with_true_derivatives(
                controller, self._measured(velocity), self._measured(acceleration)
            )
        drive = () if self.drive is None else self.drive.init(controller.torque_delay_line[:, -1])
        return LoopState(controller, position, velocity, drive)

    def step(self, state: LoopState, value: LoopInput) -> tuple[LoopState, LoopOutput]:
        """Measure and compute at t_k; hold the torque and integrate to t_k + T."""
        q: Vector = state.position
        dq: Vector = state.velocity
        motion = self._measured(q), self._measured(dq)
        controller, output = self.controller.step(state.controller, ControllerInput(*motion, *value[:4], value.age))
        period = value.period if value.period.shape[0] else self.controller.law.period
        drive, torques = self._drive(state.drive, output.torque, period)
        torque = output.torque
        first_acceleration: Vector = None
        for segment, held in zip(self._segments, torques, strict=True):
            torque = self.plant.joint_input(held, value.disturbance[:, segment.substep])
            # the same number as ever where the steps are equal
            dt = period / self.substeps if self.drive is None else (segment.stop - segment.start) * period
            q, dq, acceleration = INTEGRATORS[self.integrator](self.plant, q, dq, torque, dt, value.parameters)
            first_acceleration = acceleration if first_acceleration is None else first_acceleration
        last_acceleration = self.plant.evaluate("acceleration", q, dq, torque, parameters=value.parameters)
        controller = self.controller.with_true_derivatives(
            controller, self._measured(dq), self._measured(last_acceleration)
        )
        more = {**self._passive(state), **self._drive_torque(torques)}
        return LoopState(controller, q, dq, drive), LoopOutput(
            *motion, self._measured(first_acceleration), output, more
        )

    def _drive(self, state: Tree, command: Vector, period: Vector) -> tuple[Tree, list[Vector]]:
        """Return the next state of the drive and the torque in each segment: the command itself without one."""
        if self.drive is None:
            return state, [command] * len(self._segments)
        return self.drive.step(state, command, period, self._segments)

    def _drive_torque(self, torques: list[Vector]) -> dict[str, Vector]:
        """Return the mean torque of a drive over the period; nothing without one."""
        if self.drive is None:
            return {}
        parts = zip(self._segments, torques, strict=True)
        return {"drive_torque": sum((segment.stop - segment.start) * torque for segment, torque in parts)}

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

    a₁ = f(q, q̇),    (q_m, q̇_m) = (q + h/2 q̇ + h²/8 a₁, q̇ + h/2 a₁),    a₂ = a₁ + M(q)⁻¹ r(q_m, q̇_m, a₁)
    q⁺ = q + h q̇ + h²/6 (a₁ + 2 a₂),    q̇⁺ = q̇ + h a₂

    The force r = B τ − N − M a₁ is what a₁ leaves at the midpoint. With M there in place of M(q), a₂ would be
    f(q_m, q̇_m). The difference is of second order in h, and M(q) is factorised already.
    """
    n = q.shape[0]
    accelerations = plant.evaluate("midpoint", q, dq, torque, dt, parameters=parameters)
    a1, a2 = accelerations[:n], accelerations[n:]
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
