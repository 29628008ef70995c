"""`simulate`: run a law on a robot along a reference."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tarc.analysis.rest_stability import describe_instability, fastest_at_rest
from tarc.control.digital_controller import DigitalController, checked_limits
from tarc.core import validation as check
from tarc.core.errors import DesignWarning, InvalidParameter
from tarc.core.validation import Numbers
from tarc.laws.base import Law
from tarc.plants.base import Plant
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.mujoco_gearbox import MujocoGearbox
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.drive import Drive
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder
from tarc.signals.torque_limits import TorqueLimits
from tarc.simulation.casadi_backend import run_casadi
from tarc.simulation.closed_loop import ClosedLoop
from tarc.simulation.dataset import dataset
from tarc.simulation.integration import Integration, choose_integration, integration_error, max_error
from tarc.simulation.joint_limits import warn_if_beyond_limits
from tarc.simulation.monitor import DivergenceMonitor
from tarc.simulation.mujoco_backend import run_mujoco
from tarc.simulation.record import Record
from tarc.simulation.run import Run
from tarc.simulation.sampled_inputs import (
    Event,
    InitialConditions,
    SampledInputs,
    check_compatible,
    initial_conditions,
    robots_at_rest,
    sample_inputs,
)

MAX_JITTER = 0.9
"""Largest latency of a sampling instant [periods]."""
PILOT_PERIODS = 512
"""Periods at the start of a run on which the steps of the integration are chosen."""


def simulate(
    plant: Plant,
    law: Law,
    reference: Reference,
    duration: float,
    *,
    sensor: Encoder | None = None,
    disturbance: Event | Sequence[Event] = (),
    initial_position: Numbers | None = None,
    initial_velocity: Numbers = 0.0,
    initial_torque: Numbers | str = 0.0,
    acceleration_limits: Numbers | None = None,
    computation_delay: int = 0,
    torque_limits: TorqueLimits | None = None,
    drive: Drive | None = None,
    jitter: float = 0.0,
    substeps: int | None = None,
    divergence_threshold: float = 5.0,
    seed: int = 0,
    native: bool | None = None,
    progress: bool | None = None,
) -> Run:
    """Run a law on a robot along a reference.

    The law is called once per period with the measured position and the reference. Its torque is held until the next
    call while the plant is integrated in substeps. A plant in symbols, also a robot from a file as `RigidBody`, runs
    with the law in one CasADi function. A `MujocoPlant` runs step by step in MuJoCo.

    Parameters
    ----------
    plant, law, reference
        With the same number of joints n. A law without torque limits gets those of the robot, if it has any.
    duration
        Simulated time [s].
    sensor
        Sensor between the true position and the law; None for the true position.
    disturbance
        One or a list of `tarc.signals` disturbances, payloads and schedules.
    initial_position
        Position [rad or m] at the start, shape (n,); None for the reference's first position.
    initial_velocity
        Velocity [rad/s or m/s] at the start, shape (n,).
    initial_torque
        Torque [N m or N] applied before the start, shape (n,), which initialises the law's past torques. ``"rest"`` is
        the torque that keeps the robot at rest, as the brakes or the servo of a real arm do.
    acceleration_limits
        Largest acceleration and deceleration of each joint [rad/s² or m/s²], one number or one per joint, to check the
        reference. None for those of the robot's file.
    computation_delay
        Periods between a measurement and its torque on the joints. A law that models the delay, by
        ``actuation_delay``, pairs its estimates with the torques that acted. A law that does not model it is stable
        only for a smaller M̂.
    torque_limits
        Limits of magnitude, rate and resolution between law and robot. The law knows the torque that passes. None for
        no limits besides the law's own.
    drive
        Lag and delay between the torque that is set and the torque on the joints; None for neither.
    jitter
        Largest latency of a sampling instant, in periods, below one. Instant k is at (k + jitter U_k) T, with
        independent U_k of uniform distribution from 0 to 1. The law counts on T. The reference is that of the instant.
    substeps
        Runge–Kutta steps of the plant per period, or steps of MuJoCo. None is one step with MuJoCo, or as many as an
        elastic gearbox needs. In symbols it is the cheapest method whose error per period is small, tried on the
        first 512 periods. Small is a fiftieth of the encoder's step, or 1e-9 rad or m without one. The run's
        attributes have method, steps and error.
    divergence_threshold
        Error [rad or m] beyond which the run ends as diverged.
    seed
        Seed of all noise.
    native
        Compile the traced functions to machine code with a C compiler. The first run compiles for about one second;
        later ones reuse the result. The numbers are the same. None compiles long runs of robots in symbols, where a
        compiler is found.
    progress
        Show a progress bar when the run takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    Run
        Labelled trajectories, metrics, status, figures. A run that diverges ends early and says so in its status.

    Raises
    ------
    InvalidParameter
        When the parts do not fit together.
    MissingTool, CompilationError, UnsupportedLaw
        With ``native``: without a C compiler, where it fails, and for a law that has no C.

    Warns
    -----
    DesignWarning
        When the loop is unstable at rest in a posture of the reference; the run goes on all the same.
    JointLimitWarning
        When the reference exceeds a limit of position, velocity, acceleration or jerk of a joint, or the initial
        position its range. The run goes on all the same. Robots in symbols do not simulate the stops at the ends of the
        ranges.
    """
    events = list(disturbance) if isinstance(disturbance, Sequence) else [disturbance]
    plant = simulable(plant)
    if substeps is not None:
        check.integer("substeps", substeps, 1)
    simulation = prepare_simulation(
        plant,
        law,
        reference,
        duration,
        sensor=sensor,
        events=events,
        computation_delay=computation_delay,
        torque_limits=torque_limits,
        drive=drive,
        jitter=jitter,
        divergence_threshold=divergence_threshold,
        seed=seed,
        native=native,
    )
    controller = simulation.controller
    inputs = simulation.sample(substeps or min_substeps(plant, law.period), duration)
    initial = initial_conditions(plant, inputs, initial_position, initial_velocity, initial_torque)
    warn_if_beyond_limits(plant, inputs, initial, isinstance(plant, MujocoPlant | MujocoGearbox), acceleration_limits)
    instability = describe_instability_at_rest(plant, controller.law, inputs, computation_delay)
    if instability:
        warnings.warn(instability, DesignWarning, stacklevel=2)
    if isinstance(plant, MujocoPlant | MujocoGearbox):
        return simulation.run_in_mujoco(plant, initial, inputs, progress).with_attributes(unstable_at_rest=instability)
    method = Integration("Runge–Kutta", substeps or 1)
    if substeps is None:
        method = simulation.choose_method(plant, initial, min(duration, PILOT_PERIODS * law.period))
    run, _ = simulation.run(plant, initial, method, duration, progress)
    return run.with_attributes(unstable_at_rest=instability)


def prepare_simulation(
    plant: Plant,
    law: Law,
    reference: Reference,
    duration: float,
    *,
    sensor: Encoder | None = None,
    events: Sequence[Event] = (),
    computation_delay: int = 0,
    torque_limits: TorqueLimits | None = None,
    drive: Drive | None = None,
    jitter: float = 0.0,
    divergence_threshold: float = 5.0,
    seed: int = 0,
    native: bool | None = None,
) -> "Simulation":
    """Check that the parts of a loop fit together, and join them; the parameters are those of `simulate`.

    Raises
    ------
    InvalidParameter
        When they do not fit together.
    """
    sensor = Encoder() if sensor is None else sensor
    check.integer("seed", seed, 0, 2**63 - 1)
    check_compatible(plant, law, reference, sensor)
    plant = simulable(plant)
    reference = reference.for_run(plant.joint_names, check.number("duration", duration))
    controller = DigitalController(
        sensor,
        with_limits(law, plant),
        check.integer("computation_delay", computation_delay, 0),
        checked_limits(torque_limits, law),
    )
    return Simulation(
        plant,
        controller,
        reference,
        tuple(events),
        seed,
        divergence_threshold,
        native,
        _checked_drive(drive, plant),
        check.number("jitter", jitter, 0, high=MAX_JITTER),
    )


@dataclass(frozen=True, eq=False)
class Simulation:
    """What a run and its pilots have in common; made by `prepare_simulation`."""

    plant: Plant
    controller: DigitalController
    reference: Reference
    events: tuple[Event, ...]
    seed: int
    divergence_threshold: float
    native: bool | None
    drive: Drive | None
    jitter: float

    def sample(self, substeps: int, duration: float) -> SampledInputs:
        """Sample the inputs of a run."""
        period, sensor = self.controller.law.period, self.controller.sensor
        return sample_inputs(
            self.plant, period, self.reference, duration, sensor, self.events, substeps, self.seed, self.jitter
        )

    def run_in_mujoco(
        self,
        plant: MujocoPlant | MujocoGearbox,
        initial: InitialConditions,
        inputs: SampledInputs,
        show_progress: bool | None,
    ) -> Run:
        """Simulate step by step in MuJoCo."""
        monitor = DivergenceMonitor(inputs, self.divergence_threshold, show_progress)
        record = run_mujoco(plant, self.controller, initial, inputs, monitor, bool(self.native), self.drive)
        return self.label(inputs, record, monitor, "MuJoCo", np.nan)

    def run(
        self,
        plant: SymbolicPlant,
        initial: InitialConditions,
        method: Integration,
        duration: float,
        show_progress: bool | None,
    ) -> tuple[Run, float]:
        """Simulate in one CasADi function; return the run, and the error that a period adds [rad or m]."""
        inputs = self.sample(method.substeps, duration)
        monitor = DivergenceMonitor(inputs, self.divergence_threshold, show_progress)
        loop = ClosedLoop(plant, self.controller, method.substeps, method.integrator, self.drive)
        record = run_casadi(loop, initial, inputs, monitor, self.native)
        period = self.controller.law.period
        error = integration_error(plant, record, inputs.disturbance[:, :, 0], period, method)
        return self.label(inputs, record, monitor, method.integrator, error), error

    def choose_method(self, plant: SymbolicPlant, initial: InitialConditions, duration: float) -> Integration:
        """Return the method and steps that integrate a run of this duration to `max_error`."""

        def trial(method: Integration) -> tuple[float, bool]:
            run, error = self.run(plant, initial, method, duration, False)
            return error, not run.status.completed

        return choose_integration(trial, max_error(self.controller.sensor))

    def label(
        self, inputs: SampledInputs, record: Record, monitor: DivergenceMonitor, integrator: str, error: float
    ) -> Run:
        """Return a record as a run."""
        index = monitor.divergence_index
        data = dataset(self.plant, self.controller, self.reference, inputs, record, index, self.seed, self.drive)
        attributes = {"integrator": integrator, "integration_error": error, "jitter": self.jitter}
        return Run(data.assign_attrs(attributes), self.plant)


def describe_instability_at_rest(plant: Plant, law: Law, inputs: SampledInputs, computation_delay: int) -> str:
    """Return in words the posture of the reference in which a loop is unstable at rest, and the remedy; empty for none.

    Empty also for a law that `fastest_at_rest` does not decide.
    """
    robots = robots_at_rest(plant, inputs.events, inputs.times, inputs.reference[0])
    worst = fastest_at_rest(law, robots, computation_delay)
    return describe_instability(law, worst, computation_delay) if worst else ""


def min_substeps(plant: Plant, period: float) -> int:
    """Return the steps per period [s] that a robot in MuJoCo needs; one but for elastic gearboxes."""
    return plant.min_substeps(period) if isinstance(plant, MujocoGearbox) else 1


def simulable(plant: Plant) -> SymbolicPlant | MujocoPlant | MujocoGearbox:
    """Return the plant itself, or refuse one that cannot be simulated."""
    if not isinstance(plant, SymbolicPlant | MujocoPlant | MujocoGearbox):
        raise InvalidParameter(
            f"plant: got {plant!r}; only a robot from energies (tarc.plants.EulerLagrange) or from a file "
            "(tarc.plants.load_robot) can be simulated"
        )
    return plant


def _checked_drive(drive: Drive | None, plant: Plant) -> Drive | None:
    """Return the drive itself, or refuse one of another number of joints."""
    if drive is None:
        return None
    if not isinstance(drive, Drive):
        raise InvalidParameter(f"drive: got {drive!r}; needs a tarc.signals.Drive, constructed")
    drive.check_joints(plant.n_joints)
    return drive


def with_limits(law: Law, plant: Plant) -> Law:
    """Return the law itself, or with the robot's torque limits where it has none."""
    if law.torque_limit is None and np.any(np.isfinite(plant.torque_limits)):
        return replace(law, torque_limit=plant.torque_limits)
    return law
