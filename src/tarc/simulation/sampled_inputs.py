"""All that a run is given from outside: reference, noise, disturbances and schedules, sampled beforehand."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.laws.base import Law
from tarc.plants.base import Plant
from tarc.plants.euler_lagrange import EulerLagrange
from tarc.plants.mujoco import MujocoPlant
from tarc.signals.disturbances import Disturbance, Payload, Schedule
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder

LONGEST = 10_000_000
"""Most periods of a run."""


@dataclass(frozen=True)
class Plan:
    """All that a run is given from outside, sampled beforehand: arrays with time last."""

    times: np.ndarray
    reference: tuple[np.ndarray, np.ndarray, np.ndarray]
    noise: np.ndarray
    disturbance: np.ndarray
    schedules: dict[str, np.ndarray]
    events: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Start:
    """Where the robot and the law begin, each of shape (n,)."""

    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray


def fit(plant: Plant, law: Law, reference: Reference, sensor: Encoder) -> None:
    """Check that all parts have the same number of joints."""
    if not isinstance(plant, EulerLagrange | MujocoPlant):
        raise TarcError(f"plant: got {plant!r}; needs one of tarc.plants")
    if not isinstance(law, Law):
        raise TarcError(f"law: got {law!r}; needs one of tarc.laws, constructed, such as tarc.laws.TDC(inertia=…)")
    if not isinstance(reference, Reference):
        raise TarcError(f"reference: got {reference!r}; needs one of tarc.signals, such as tarc.signals.Sinusoid(…)")
    if not isinstance(sensor, Encoder):
        raise TarcError(f"sensor: got {sensor!r}; needs a tarc.signals.Encoder, constructed")
    if sensor.step_size.size not in (1, plant.n_joints):
        raise TarcError(
            f"sensor: its resolution has {sensor.step_size.size} numbers; the plant has {plant.n_joints} joints"
        )
    if not plant.n_joints == law.n_joints == reference.n_joints:
        raise TarcError(
            f"joints: the plant has {plant.n_joints}, the law {law.n_joints} (told by its inertia), the reference "
            f"{reference.n_joints}; they must be the same: give one number a joint ({', '.join(plant.joint_names)})"
        )


def plan(
    plant: Plant,
    law: Law,
    reference: Reference,
    duration: float,
    sensor: Encoder,
    events: Sequence[Any],
    substeps: int,
    seed: int,
) -> Plan:
    """Sample reference, noise, disturbances and schedules over the run."""
    n, T = plant.n_joints, law.period
    count = round(check.number("duration", duration, T, high=LONGEST * T) / T)
    times = np.arange(count) * T
    noise_rng, *rngs = np.random.default_rng(seed).spawn(1 + len(events))
    torque, schedules = np.zeros((n, count * substeps)), {}
    for event, rng in zip(events, rngs, strict=True):
        if isinstance(event, Payload):
            event = event.schedule
        if isinstance(event, Disturbance):
            torque += event.sample(np.arange(count * substeps) * (T / substeps), n, rng)
        elif isinstance(event, Schedule):
            known = plant.parameters
            name = check.one_of("schedule parameter", event.parameter, known)
            _check_schedule(plant, event)
            if name in schedules:
                raise TarcError(f"disturbance: two schedules change {name!r}; put both into one Schedule")
            schedules[name] = event.sample(times, known[name])
        else:
            raise TarcError(f"disturbance: got {event!r}; needs a Disturbance, Payload or Schedule of tarc.signals")
    blocks = torque.reshape(n, count, substeps)
    return Plan(
        times, reference.sample(times), sensor.sample_noise(n, count, noise_rng), blocks, schedules, tuple(events)
    )


def variants(plant: Plant, events: Sequence[Any]) -> list[tuple[float, Plant]]:
    """The robot as it is from each instant [s] on, with what payloads and schedules have made of it by then."""
    schedules = [event.schedule if isinstance(event, Payload) else event for event in events]
    schedules = [event for event in schedules if isinstance(event, Schedule)]
    knots = sorted({0.0, *(float(max(time, 0.0)) for event in schedules for time in np.ravel(event.times))})
    known, result = plant.parameters, []
    for knot in knots:
        values = {}
        for event in schedules:
            value = event.sample(np.array([knot]), known[event.parameter])[:, 0]
            values[event.parameter] = np.reshape(value, np.shape(known[event.parameter]))
        result.append((knot, plant.with_parameters(values) if values else plant))
    return result


def start(plant: Plant, plan: Plan, position: Any, velocity: Any, torque: Any) -> Start:
    """Initial position, velocity and torque from what the user gave."""
    n = plant.n_joints
    q = plan.reference[0][:, 0] if position is None else check.vector("initial_position", position, n)
    if isinstance(torque, str):
        check.one_of("initial_torque", torque, ["rest"])
        torque = plant.gravity_torque(q)
    return Start(q.copy(), check.vector("initial_velocity", velocity, n), check.vector("initial_torque", torque, n))


def _check_schedule(plant: Plant, event: Schedule) -> None:
    """Refuse values that the plant itself would refuse."""
    shape = np.shape(plant.parameters[event.parameter])
    for value in event.values:
        value = np.reshape(value, shape) if np.size(value) == np.prod(shape) else value
        if isinstance(plant, EulerLagrange):
            replace(plant, **{event.parameter: value})
        elif np.any(check.array(f"schedule of {event.parameter!r}, values", value) < 0):
            raise TarcError(f"schedule of {event.parameter!r}: got {np.asarray(value).tolist()}; must be at least 0")
