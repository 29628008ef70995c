"""Digital controller: sensor, law and computation delay."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core.system import System
from tarc.core.types import Array, Vector
from tarc.core.validation import Numbers
from tarc.estimators.oracle import TrueDerivatives
from tarc.laws.base import Law, LawInput, LawState
from tarc.signals.sensors import Encoder, EncoderInput, EncoderState


class ControllerInput(NamedTuple):
    """True position and velocity, reference with two derivatives, sensor noise, each of shape (n,)."""

    position: Vector
    velocity: Vector
    reference: Vector
    velocity_reference: Vector
    acceleration_reference: Vector
    noise: Vector


class ControllerState(NamedTuple):
    """States of sensor and law, and delayed torques, shape (n, delay + 1)."""

    sensor: EncoderState
    law: LawState
    torque_delay_line: Vector


class ControllerOutput(NamedTuple):
    """Measured position and torque on the joints, each (n,), and the law's signals."""

    measured_position: Vector
    torque: Vector
    signals: dict[str, Vector]


@dataclass(frozen=True, eq=False)
class DigitalController(System):
    """Sensor, law and computation delay in series: true position in, torque out."""

    sensor: Encoder
    law: Law
    computation_delay: int = 0

    def init(self, position: Array, torque: Numbers = 0.0, noise: Array | float = 0.0) -> ControllerState:
        """Return the state at rest at a position (n,), first read with this noise, with a torque (n,) applied."""
        sensor = self.sensor.init(position, noise)
        law = self.law.init(sensor.delay_line[:, 0], torque)
        return ControllerState(sensor, law, np.repeat(law.torque[:, :1], self.computation_delay + 1, axis=1))

    def step(self, state: ControllerState, value: ControllerInput) -> tuple[ControllerState, ControllerOutput]:
        """Measure, compute, apply."""
        travel = self.law.period * value.velocity
        sensor, measured = self.sensor.step(state.sensor, EncoderInput(value.position, travel, value.noise))
        reference = value.reference, value.velocity_reference, value.acceleration_reference
        law, output = self.law.step(state.law, LawInput(measured, *reference))
        delay_line = ops.shift_in(state.torque_delay_line, output.torque)
        return ControllerState(sensor, law, delay_line), ControllerOutput(measured, delay_line[:, -1], output.signals)

    def with_true_derivatives(self, state: ControllerState, velocity: Vector, acceleration: Vector) -> ControllerState:
        """Return the state with the true derivatives (n,) for an oracle, else the state itself."""
        if not isinstance(self.law.estimator, TrueDerivatives):
            return state
        estimator = state.law.estimator._replace(velocity=velocity, acceleration=acceleration)
        return state._replace(law=state.law._replace(estimator=estimator))
