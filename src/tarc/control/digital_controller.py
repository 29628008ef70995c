"""Digital controller: sensor, law, torque limits and computation delay."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.system import System
from tarc.core.types import Array, Vector
from tarc.core.validation import Numbers
from tarc.estimators.oracle import TrueDerivatives
from tarc.laws.base import Law, LawInput, LawOutput, LawState
from tarc.signals.sensors import NO_AGE, Encoder, EncoderInput, EncoderState
from tarc.signals.torque_limits import TorqueLimits


class ControllerInput(NamedTuple):
    """True position and velocity, reference with two derivatives, sensor noise, each of shape (n,).

    ``age`` is that of the sample, as in `EncoderInput`.
    """

    position: Vector
    velocity: Vector
    reference: Vector
    velocity_reference: Vector
    acceleration_reference: Vector
    noise: Vector
    age: Vector = NO_AGE


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


def checked_limits(limits: TorqueLimits | None, law: Law) -> TorqueLimits | None:
    """Return the limits themselves, or refuse those that do not fit the law's joints and period."""
    if limits is None:
        return None
    if not isinstance(limits, TorqueLimits):
        raise InvalidParameter(f"torque_limits: got {limits!r}; needs a tarc.signals.TorqueLimits, constructed")
    limits.check_fits(law.n_joints, law.period)
    return limits


def limited_step(law: Law, limits: TorqueLimits | None, state: LawState, value: LawInput) -> tuple[LawState, LawOutput]:
    """Step a law whose torque passes through limits, and whose past torques are those that passed."""
    next_state, output = law.step(state, value)
    if limits is None:
        return next_state, output
    torque = limits.apply(output.torque, state.torque[:, 0], law.period)
    past = ops.shift_in(state.torque, torque)
    return next_state._replace(torque=past), output._replace(torque=torque)


def limited_start(law: Law, limits: TorqueLimits | None, position: Numbers, torque: Numbers) -> LawState:
    """Return a law's state at rest at a position, with the nearest torque to a given one that the limits allow."""
    if limits is None:
        return law.init(position, torque)
    return law.init(position, limits.initial_torque(check.vector("torque", torque, law.n_joints)))


@dataclass(frozen=True, eq=False)
class DigitalController(System):
    """Sensor, law, torque limits and computation delay in series: true position in, torque out."""

    sensor: Encoder
    law: Law
    computation_delay: int = 0
    torque_limits: TorqueLimits | None = None

    def init(self, position: Array, torque: Numbers = 0.0, noise: Array | float = 0.0) -> ControllerState:
        """Return the state at rest at a position (n,), first read with this noise, with a torque (n,) applied."""
        sensor = self.sensor.init(position, noise)
        law = limited_start(self.law, self.torque_limits, sensor.delay_line[:, 0], torque)
        return ControllerState(sensor, law, np.repeat(law.torque[:, :1], self.computation_delay + 1, axis=1))

    def step(self, state: ControllerState, value: ControllerInput) -> tuple[ControllerState, ControllerOutput]:
        """Measure, compute, apply."""
        travel = self.law.period * value.velocity
        sensor, measured = self.sensor.step(state.sensor, EncoderInput(value.position, travel, value.noise, value.age))
        reference = value.reference, value.velocity_reference, value.acceleration_reference
        law, output = limited_step(self.law, self.torque_limits, state.law, LawInput(measured, *reference))
        delay_line = ops.shift_in(state.torque_delay_line, output.torque)
        return ControllerState(sensor, law, delay_line), ControllerOutput(measured, delay_line[:, -1], output.signals)

    @property
    def needs_true_derivatives(self) -> bool:
        """Return whether the law's estimator is an oracle, which is handed the true derivatives."""
        return isinstance(self.law.estimator, TrueDerivatives)

    def with_true_derivatives(self, state: ControllerState, velocity: Vector, acceleration: Vector) -> ControllerState:
        """Return the state with the true derivatives (n,) for an oracle, else the state itself."""
        if not self.needs_true_derivatives:
            return state
        estimator = state.law.estimator._replace(velocity=velocity, acceleration=acceleration)
        return state._replace(law=state.law._replace(estimator=estimator))
