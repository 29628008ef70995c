"""Inputs of a run, sampled beforehand: reference, noise, disturbances and schedules."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tarc.analysis.rest_stability import RobotAtRest
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.laws.base import Law
from tarc.plants.base import Plant
from tarc.signals.disturbances import Disturbance, ParameterSchedule, Payload, payload_schedule
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder

Event = Disturbance | Payload | ParameterSchedule
"""A disturbance torque, a payload that is picked up, or a parameter that changes over time."""

REST_POSTURES = 60
"""Postures of the reference in which a loop is checked at rest."""
MAX_PERIODS = 10_000_000
"""Largest number of control periods in a run."""


@dataclass(frozen=True)
class SampledInputs:
    """Inputs of a run, sampled beforehand; every array has time as its last axis.

    Attributes
    ----------
    times
        Instants t_k = k T [s], shape (k,).
    reference
        Position, velocity and acceleration reference, each of shape (n, k).
    noise
        Sensor noise [rad or m], shape (n, k).
    disturbance
        Torque [N m or N] in each substep, shape (n, k, substeps).
    schedules
        Values of the plant parameters that change, by name, shape (…, k).
    events
        Disturbances, payloads and schedules of which the arrays are samples.
    periods
        Length of each period [s], shape (k,), where they differ; None where they do not.
    age
        Age of each sample by the jitter of the sensor's clock [periods], shape (k,); None without.
    """

    times: np.ndarray
    reference: tuple[np.ndarray, np.ndarray, np.ndarray]
    noise: np.ndarray
    disturbance: np.ndarray
    schedules: dict[str, np.ndarray]
    events: tuple[Event, ...] = ()
    periods: np.ndarray | None = None
    age: np.ndarray | None = None


@dataclass(frozen=True)
class InitialConditions:
    """Coordinates and velocities (m,) and applied torque (n,) at the start."""

    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray


def check_compatible(plant: Plant, law: Law, reference: Reference, sensor: Encoder) -> None:
    """Check the types of the parts, and that all have the same number of joints.

    Raises
    ------
    InvalidParameter
        For an argument of a wrong type, and for different numbers of joints.
    """
    if not isinstance(plant, Plant):
        raise InvalidParameter(f"plant: got {plant!r}; needs one of tarc.plants")
    if not isinstance(law, Law):
        raise InvalidParameter(
            f"law: got {law!r}; needs one of tarc.laws, constructed, such as tarc.laws.TDC(inertia=…)"
        )
    if not isinstance(reference, Reference):
        raise InvalidParameter(
            f"reference: got {reference!r}; needs one of tarc.signals, such as tarc.signals.Sinusoid(…)"
        )
    if not isinstance(sensor, Encoder):
        raise InvalidParameter(f"sensor: got {sensor!r}; needs a tarc.signals.Encoder, constructed")
    sensor.check_joints(plant.n_joints)
    if not plant.n_joints == law.n_joints == reference.n_joints:
        raise InvalidParameter(
            f"joints: the plant has {plant.n_joints}, the law {law.n_joints} (the size of its inertia), the reference "
            f"{reference.n_joints}; they must be equal: give one number per joint ({', '.join(plant.joint_names)})"
        )


def sample_inputs(
    plant: Plant,
    period: float,
    reference: Reference,
    duration: float,
    sensor: Encoder,
    events: Sequence[Event],
    substeps: int,
    seed: int,
    jitter: float = 0.0,
    reference_samples: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
) -> SampledInputs:
    """Sample reference, noise, disturbances and schedules over the run.

    ``reference_samples`` are those of the reference at the same instants, where they are known.

    With jitter J the instants are t_k = (k + J U_k) T, with independent U_k of uniform distribution in [0, 1], U_0 = 0.

    Raises
    ------
    InvalidParameter
        For a duration below one period or above `MAX_PERIODS`, and for events that the plant cannot have.
    """
    n = plant.n_joints
    n_periods = round(check.number("duration", duration, period, high=MAX_PERIODS * period) / period)
    times = np.arange(n_periods) * period
    substep_times = np.arange(n_periods * substeps) * (period / substeps)
    noise_rng, *event_rngs, jitter_rng = np.random.default_rng(seed).spawn(2 + len(events))
    periods = None
    if jitter:
        late = jitter * jitter_rng.random(n_periods + 1)
        late[0] = 0.0
        periods = period * (1 + np.diff(late))
        times = times + period * late[:-1]
        substep_times = (times[:, None] + periods[:, None] * np.arange(substeps) / substeps).ravel()
    torque = np.zeros((n, n_periods * substeps))
    for event, rng in zip(events, event_rngs, strict=True):
        if isinstance(event, Disturbance):
            torque += event.sample(substep_times, n, rng)
        elif not isinstance(event, Payload | ParameterSchedule):
            raise InvalidParameter(
                f"disturbance: got {event!r}; needs a Disturbance, Payload or ParameterSchedule of tarc.signals"
            )
    schedules: dict[str, np.ndarray] = {}
    for schedule in parameter_schedules(plant, events):
        name, values = _sample_schedule(plant, schedule, times)
        if name in schedules:
            raise InvalidParameter(f"disturbance: two schedules change {name!r}; put both into one ParameterSchedule")
        schedules[name] = values
    return SampledInputs(
        times,
        reference.sample(times) if reference_samples is None else reference_samples,
        sensor.sample_noise(n, n_periods, noise_rng),
        torque.reshape(n, n_periods, substeps),
        schedules,
        tuple(events),
        periods,
        sensor.sample_age(n_periods, noise_rng),
    )


def parameter_schedules(plant: Plant, events: Sequence[Event]) -> list[ParameterSchedule]:
    """Return the schedules among the events, and one for the sum of all payloads."""
    schedules = [event for event in events if isinstance(event, ParameterSchedule)]
    payloads = [event for event in events if isinstance(event, Payload)]
    if payloads:
        schedules.append(payload_schedule(payloads, float(plant.parameters.get("payload", 0.0))))
    return schedules


def scheduled_plants(plant: Plant, events: Sequence[Event]) -> list[tuple[float, Plant]]:
    """Return the plant after each change by a payload or schedule, with the time [s] of the change."""
    schedules = parameter_schedules(plant, events)
    knots = sorted({0.0, *(float(max(time, 0.0)) for event in schedules for time in np.ravel(event.times))})
    nominal = plant.parameters
    plants: list[tuple[float, Plant]] = []
    for knot in knots:
        values = {}
        for event in schedules:
            value = event.sample(np.array([knot]), nominal[event.parameter])[:, 0]
            values[event.parameter] = np.reshape(value, np.shape(nominal[event.parameter]))
        plants.append((knot, plant.with_parameters(values) if values else plant))
    return plants


def robots_at_rest(plant: Plant, events: Sequence[Event], times: Array, positions: Array) -> list[RobotAtRest]:
    """Return the robot between two changes by `events`, in the postures of the reference then.

    Parameters
    ----------
    plant, events
        The robot, and what happens to it.
    times, positions
        Instants [s], shape (k,), and postures [rad or m], shape (n, k); `REST_POSTURES` of them are taken.
    """
    chosen = np.unique(np.linspace(0, len(times) - 1, REST_POSTURES).astype(int))
    times, positions = times[chosen], positions[:, chosen]
    robots = []
    for (start, present), (stop, _) in pairwise([*scheduled_plants(plant, events), (np.inf, plant)]):
        is_present = (times >= start) & (times < stop)
        if np.any(is_present):
            robots.append(RobotAtRest(present, positions[:, is_present]))
    return robots


def initial_conditions(
    plant: Plant, inputs: SampledInputs, position: Numbers | None, velocity: Numbers, torque: Numbers | str
) -> InitialConditions:
    """Return the initial conditions: by default the reference's first position, at rest, without torque."""
    n, m, measured = plant.n_joints, plant.n_coordinates, list(plant.measured)
    if position is not None and np.size(position) == m > n:
        q = check.vector("initial_position", position, m)
    else:
        joints = inputs.reference[0][:, 0] if position is None else check.vector("initial_position", position, n)
        q = joints.copy() if plant.is_fully_driven else plant.coordinates(joints)
    if isinstance(torque, str):
        check.one_of("initial_torque", torque, ["rest"])
        torque = plant.holding_torque(q)
    dq = np.zeros(m)
    if np.size(velocity) == m > n:
        dq = check.vector("initial_velocity", velocity, m)
    else:
        dq[measured] = check.vector("initial_velocity", velocity, n)
    return InitialConditions(q, dq, check.vector("initial_torque", torque, n))


def _sample_schedule(plant: Plant, schedule: ParameterSchedule, times: np.ndarray) -> tuple[str, np.ndarray]:
    """Return the name of the parameter that a schedule changes, and its values over time."""
    parameters = plant.parameters
    name = check.one_of("schedule parameter", schedule.parameter, parameters)
    shape = np.shape(parameters[name])
    for value in schedule.values:
        plant.with_parameters({name: np.reshape(value, shape) if np.size(value) == np.prod(shape) else value})
    return name, schedule.sample(times, parameters[name])
