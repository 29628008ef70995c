"""The closed loop: sensor, law, actuator, plant; and `simulate`, which runs it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from tarc import check, ops
from tarc.estimators.oracle import TrueDerivatives
from tarc.laws.base import Law, LawInput
from tarc.plants.base import Plant
from tarc.plants.euler_lagrange import EulerLagrange
from tarc.run import Run
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder, EncoderInput
from tarc.system import System


class DriveInput(NamedTuple):
    """True position, reference with two derivatives, sensor noise, each of shape (n,)."""

    position: Any
    reference: Any
    velocity_reference: Any
    acceleration_reference: Any
    noise: Any


class DriveState(NamedTuple):
    """States of sensor and law, and torques under way to the joints, shape (n, delay + 1)."""

    sensor: Any
    law: Any
    queue: Any


class DriveOutput(NamedTuple):
    """Measured position and torque on the joints, each (n,), and the law's signals."""

    measured: Any
    torque: Any
    signals: Any


@dataclass(frozen=True, eq=False)
class Drive(System):
    """All that runs on the controller's side of the joint: true position in, torque out."""

    sensor: Encoder
    law: Law
    computation_delay: int = 0

    def init(self, position: Any, torque: Any = 0.0, noise: Any = 0.0) -> DriveState:
        """At rest at a position (n,), first read with this noise, with a torque (n,) applied."""
        sensor = self.sensor.init(position + noise)
        law = self.law.init(sensor[:, 0], torque)
        return DriveState(sensor, law, np.repeat(law.torque[:, :1], self.computation_delay + 1, axis=1))

    def step(self, state: DriveState, value: DriveInput) -> tuple[DriveState, DriveOutput]:
        """Measure, compute, apply."""
        sensor, measured = self.sensor.step(state.sensor, EncoderInput(value.position, value.noise))
        reference = value.reference, value.velocity_reference, value.acceleration_reference
        law, output = self.law.step(state.law, LawInput(measured, *reference))
        queue = ops.push(state.queue, output.torque)
        return DriveState(sensor, law, queue), DriveOutput(measured, queue[:, -1], output.signals)

    def tell(self, state: DriveState, velocity: Any, acceleration: Any) -> DriveState:
        """The state with the true derivatives (n,) in it, if the law's estimator is the oracle; else as it is."""
        if not isinstance(self.law.estimator, TrueDerivatives):
            return state
        told = state.law.estimator._replace(velocity=velocity, acceleration=acceleration)
        return state._replace(law=state.law._replace(estimator=told))


class LoopInput(NamedTuple):
    """What comes from outside in one period: drive inputs (n,), disturbance (n, substeps), plant parameters."""

    reference: Any
    velocity_reference: Any
    acceleration_reference: Any
    noise: Any
    disturbance: Any
    parameters: dict[str, Any]


class LoopState(NamedTuple):
    """Drive state, position and velocity of the plant."""

    drive: DriveState
    position: Any
    velocity: Any


class LoopOutput(NamedTuple):
    """True motion at the instant of sampling, the acceleration just after the torque was set, and the drive's."""

    position: Any
    velocity: Any
    acceleration: Any
    drive: DriveOutput


@dataclass(frozen=True, eq=False)
class ClosedLoop(System):
    """One control period: the drive at its start, then the plant under zero-order hold by Runge–Kutta substeps."""

    plant: EulerLagrange
    drive: Drive
    substeps: int = 2

    def init(self, position: Any, velocity: Any = 0.0, torque: Any = 0.0, noise: Any = 0.0) -> LoopState:
        """The robot at a position (n,) with a velocity, the drive at rest there."""
        drive, velocity = self.drive.init(position, torque, noise), velocity + np.zeros(np.shape(position))
        acceleration = self.plant.evaluate("acceleration", position, velocity, drive.queue[:, -1])
        return LoopState(self.drive.tell(drive, velocity, acceleration), position, velocity)

    def step(self, state: LoopState, value: LoopInput) -> tuple[LoopState, LoopOutput]:
        """Measure and compute at t_k; hold the torque and integrate to t_k + T."""
        q, dq = state.position, state.velocity
        drive, output = self.drive.step(state.drive, DriveInput(q, *value[:4]))
        dt = self.drive.law.period / self.substeps
        torque, first = output.torque, None
        for i in range(self.substeps):
            torque = output.torque + value.disturbance[:, i]
            q, dq, acceleration = runge_kutta(self.plant, q, dq, torque, dt, value.parameters)
            first = acceleration if first is None else first
        last = self.plant.evaluate("acceleration", q, dq, torque, parameters=value.parameters)
        drive = self.drive.tell(drive, dq, last)
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


def simulate(
    plant: Plant,
    law: Law,
    reference: Reference,
    duration: float,
    *,
    sensor: Encoder | None = None,
    disturbance: Any = (),
    position: Any = None,
    velocity: Any = 0.0,
    torque: Any = 0.0,
    computation_delay: int = 0,
    substeps: int | None = None,
    divergence: float = 5.0,
    seed: int = 0,
    native: bool = False,
    progress: bool | None = None,
) -> Run:
    """Run a law on a robot along a reference.

    The law is called once a period with the measured position and the reference; its torque is held until the next
    call while the plant is integrated in substeps. Plants from energies run fused with the law in CasADi's virtual
    machine, robots from files step by step in MuJoCo; the equations are the same.

    Parameters
    ----------
    plant, law, reference
        Of the same number of joints n. A law without a torque limit gets the robot's, if it has one.
    duration
        [s].
    sensor
        What the law sees; None for the true position.
    disturbance
        One or a list of `tarc.signals` disturbances, payloads and schedules.
    position, velocity
        Start of the robot, shape (n,); None for the reference's first position, at rest.
    torque
        Torque applied before the start, shape (n,), with which the law's memory is filled; ``"rest"`` for the one
        that holds the robot, as a real arm's brakes or servo would have.
    computation_delay
        Periods between a measurement and its torque on the joints. A law that knows of it, by ``actuation_delay``,
        pairs its estimates with the torques that acted; one that does not bears only a smaller inertia.
    substeps
        Plant steps a period; None for 2 with Runge–Kutta and 1 with MuJoCo.
    divergence
        Error [rad or m] beyond which the run ends as diverged.
    seed
        Of all noise.
    native
        Compile the traced functions to machine code, which takes a second or so the first time and is kept; needs a C
        compiler. The result is the same to rounding.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    Run
        Labelled trajectories, metrics, status, figures. A run that diverges ends early and says so in its status.

    Raises
    ------
    TarcError
        When the parts do not fit together.

    Warns
    -----
    DesignWarning
        When held at rest somewhere along the reference the loop is unstable; the run goes on all the same.
    """
    from tarc import engines

    sensor = Encoder() if sensor is None else sensor
    check.whole("seed", seed, 0, 2**63 - 1)
    events = list(disturbance) if isinstance(disturbance, Sequence) else [disturbance]
    engines.fit(plant, law, reference, sensor)
    limit = getattr(plant, "torque_limit", None)
    if law.torque_limit is None and limit is not None and np.any(np.isfinite(limit)):
        law = replace(law, torque_limit=limit)
    drive = Drive(sensor, law, check.whole("computation_delay", computation_delay, 0))
    fused = isinstance(plant, EulerLagrange)
    steps = check.whole("substeps", (2 if fused else 1) if substeps is None else substeps, 1)
    plan = engines.plan(plant, law, reference, duration, sensor, events, steps, seed)
    begin = engines.start(plant, plan, position, velocity, torque)
    engines.warn_if_unstable(plant, law, plan, computation_delay)
    watch = engines.Watch(plan, divergence, progress)
    if isinstance(plant, EulerLagrange):
        record = engines.run_fused(ClosedLoop(plant, drive, steps), begin, plan, watch, native)
    else:
        record = engines.run_stepping(plant, drive, begin, plan, watch, native)
    return Run.from_record(plant, drive, reference, plan, record, watch, seed)
