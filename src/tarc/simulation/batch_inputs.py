"""Inputs of many runs of one loop: what all share is sampled once, and what a run has of its own for each run."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tarc.control.digital_controller import DigitalController
from tarc.core import validation as check
from tarc.core.errors import UnsupportedLaw
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.drive import Drive
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder
from tarc.simulation.closed_loop import ClosedLoop
from tarc.simulation.integration import Integration
from tarc.simulation.sampled_inputs import (
    Event,
    InitialConditions,
    SampledInputs,
    initial_conditions,
    sample_inputs,
)

REFERENCE = ("reference", "velocity_reference", "acceleration_reference")
FROM_SENSOR = {"noise", "age"}
"""Inputs that the sensor alone draws."""


@dataclass(frozen=True, eq=False)
class LoopCase:
    """A loop as one run has it; the parameters are those of `tarc.simulate`.

    ``plant_parameters`` replace those of the plant, by name.
    """

    plant: SymbolicPlant
    controller: DigitalController
    reference: Reference
    events: tuple[Event, ...] = ()
    drive: Drive | None = None
    jitter: float = 0.0
    initial_position: Numbers | None = None
    initial_velocity: Numbers = 0.0
    initial_torque: Numbers | str = 0.0
    plant_parameters: dict[str, Any] = field(default_factory=dict)

    def with_numbers(self, parameters: dict[str, Any], sensor: Encoder) -> "LoopCase":
        """Return the same case with other parameters of the plant, and another encoder."""
        controller = replace(self.controller, sensor=sensor)
        return replace(self, controller=controller, plant_parameters=parameters)

    @property
    def actual_plant(self) -> SymbolicPlant:
        """Return the plant with the case's own parameters."""
        return self.plant.with_parameters(self.plant_parameters) if self.plant_parameters else self.plant

    @cached_property
    def parameters(self) -> dict[str, Array]:
        """Return the plant's parameters with the case's own."""
        own = {name: np.asarray(value, dtype=float) for name, value in self.plant_parameters.items()}
        return {**self.plant.parameters, **own}

    def loop(self, integration: Integration, plant: SymbolicPlant | None = None) -> ClosedLoop:
        """Return the closed loop, by default on the plant without the case's own parameters."""
        return ClosedLoop(
            plant or self.plant, self.controller, integration.substeps, integration.integrator, self.drive
        )

    def sample(
        self, substeps: int, duration: float, seed: int, reference_samples: tuple[Array, Array, Array] | None = None
    ) -> SampledInputs:
        """Sample all inputs of a run, but for those of the reference where they are known."""
        law, sensor = self.controller.law, self.controller.sensor
        return sample_inputs(
            self.actual_plant,
            law.period,
            self.reference,
            duration,
            sensor,
            self.events,
            substeps,
            seed,
            self.jitter,
            reference_samples,
        )

    def initial(self, inputs: SampledInputs) -> InitialConditions:
        """Return the initial conditions."""
        (initial,) = initials([self], [inputs])
        return initial


def initials(cases: Sequence[LoopCase], inputs: Sequence[SampledInputs]) -> list[InitialConditions]:
    """Return the initial conditions of cases that differ in parameters; the torques at rest are computed at once."""
    plant, torque = cases[0].plant, cases[0].initial_torque
    if not isinstance(torque, str) or not _has_plain_gravity(plant):
        return [
            initial_conditions(
                case.actual_plant, one, case.initial_position, case.initial_velocity, case.initial_torque
            )
            for case, one in zip(cases, inputs, strict=True)
        ]
    check.one_of("initial_torque", torque, ["rest"])
    conditions = [
        initial_conditions(case.plant, one, case.initial_position, case.initial_velocity, 0.0)
        for case, one in zip(cases, inputs, strict=True)
    ]
    positions = np.array([one.position for one in conditions]).T
    smooth = {name: 0.0 for name in plant.dry_friction}
    parameters = {
        name: np.array([np.ravel(case.parameters[name]) * smooth.get(name, 1.0) for case in cases]).T
        for name in plant.parameters
    }
    torques = np.reshape(plant.evaluate("gravity", positions, parameters=parameters), positions.shape)
    return [replace(one, torque=torques[:, i]) for i, one in enumerate(conditions)]


def _has_plain_gravity(plant: SymbolicPlant) -> bool:
    """Return whether the torque at rest is N(q, 0) of the equations, and no coordinate depends on the parameters."""
    kind = type(plant)
    is_plain = kind.holding_torque is Plant.holding_torque and kind.gravity_torque is SymbolicPlant.gravity_torque
    return is_plain and plant.is_fully_driven


class RunInputs(NamedTuple):
    """Inputs of one run: rows of its own (numbers, periods), its sampled inputs, and its instants [s], (periods,)."""

    own: Array
    sampled: SampledInputs
    times: Array


class BatchInputs:
    """Which inputs of a loop are zero, the same in all runs, or of each run.

    Parameters
    ----------
    cases
        Examples, of which each is sampled with a seed of its own; inputs that differ between them are of each run.
    substeps
        Steps of the plant per period.
    duration
        [s].

    Attributes
    ----------
    shapes
        Shape of each input in a period, by name; those without one are zero.
    shared, own
        Names of the inputs that are the same in all runs, and of those of each run.
    rows
        The shared ones, (periods, numbers).
    n_periods
        Number of periods.
    """

    def __init__(self, cases: Sequence[LoopCase], substeps: int, duration: float):
        self._substeps, self._duration = substeps, duration
        # an example is sampled once more, so that what is random shows even with one
        examples = [case.sample(substeps, duration, seed) for seed, case in enumerate([*cases, cases[0]], start=1)]
        blocks = [_blocks(example) for example in examples]
        if any(block.keys() != blocks[0].keys() for block in blocks):
            raise UnsupportedLaw("compiled: some of the runs have jitter or a schedule, and others have none")
        self._sensor_draws = [_is_random(case) for case in cases]
        self.shapes = {name: shape for name, (shape, _) in blocks[0].items()}
        self.shared: list[str] = []
        self.own: list[str] = []
        for name, (_, first) in blocks[0].items():
            others = [block[name][1] for block in blocks[1:]]
            if name in FROM_SENSOR:
                is_own = any(self._sensor_draws)
            else:
                is_own = not all(np.array_equal(first, other, equal_nan=True) for other in others)
            if is_own:
                self.own.append(name)
            elif np.any(first) or name.startswith("parameters.") or name == "period":
                self.shared.append(name)
            else:
                del self.shapes[name]
        self._first, self.n_periods = examples[0], len(examples[0].times)
        rows = [blocks[0][name][1] for name in self.shared]
        self.rows = np.ascontiguousarray(np.concatenate(rows).T) if rows else np.zeros((self.n_periods, 0))

    @property
    def n_own(self) -> int:
        """Return the count of numbers that each run has of its own in a period."""
        return sum(int(np.prod(self.shapes[name])) for name in self.own)

    def of_run(self, case: LoopCase, seed: int) -> RunInputs:
        """Sample the inputs of a run."""
        if set(self.own) <= FROM_SENSOR:
            sampled = self._with_noise(case, seed)
        else:
            shared = None if {*REFERENCE, "period"} & set(self.own) else self._first.reference
            sampled = case.sample(self._substeps, self._duration, seed, shared)
        blocks = _blocks(sampled, self.own)
        own = [blocks[name][1] for name in self.own]
        return RunInputs(np.concatenate(own) if own else np.zeros((0, self.n_periods)), sampled, sampled.times)

    def _with_noise(self, case: LoopCase, seed: int) -> SampledInputs:
        """Return the shared inputs with the noise of a run, as `sample_inputs` draws it."""
        first = self._first
        if not self.own:
            return first
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
        sensor = case.controller.sensor
        noise = sensor.sample_noise(len(first.noise), self.n_periods, rng)
        age = sensor.sample_age(self.n_periods, rng)
        return SampledInputs(
            first.times, first.reference, noise, first.disturbance, first.schedules, first.events, first.periods, age
        )


def _is_random(case: LoopCase) -> bool:
    """Return whether a case's sensor draws anything."""
    sensor = case.controller.sensor
    draws = sensor.noise, sensor.dropout, sensor.packet_loss, sensor.stale, sensor.timing_jitter
    return any(np.any(np.asarray(one)) for one in draws)


def _blocks(inputs: SampledInputs, names: Sequence[str] | None = None) -> dict[str, tuple[tuple[int, ...], Array]]:
    """Return shape in a period and rows (numbers, periods) of each input, by name."""
    n, n_periods, substeps = inputs.disturbance.shape
    blocks: dict[str, tuple[tuple[int, ...], Array]] = {
        name: ((n,), rows) for name, rows in zip(REFERENCE, inputs.reference, strict=True)
    }
    blocks["noise"] = (n,), inputs.noise
    if names is None or "disturbance" in names:
        rows = inputs.disturbance.transpose(2, 0, 1).reshape(n * substeps, n_periods)
        blocks["disturbance"] = (n, substeps), rows
    blocks |= {f"parameters.{name}": ((len(rows),), rows) for name, rows in inputs.schedules.items()}
    if inputs.periods is not None:
        blocks["period"] = (1,), inputs.periods[None]
    if inputs.age is not None:
        blocks["age"] = (1,), inputs.age[None]
    return blocks
