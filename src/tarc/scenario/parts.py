"""The parts of a scenario: as sections with their keys checked, and as the objects that they build."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.plants.base import Plant
from tarc.scenario.schema import Component
from tarc.signals.drive import Drive
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder
from tarc.signals.torque_limits import TorqueLimits
from tarc.simulation.sampled_inputs import Event

POSTURES_OF_MEAN_INERTIA = 200
"""Number of postures along the reference over which the inertia is averaged."""


@dataclass(frozen=True)
class Sections:
    """The parts of a scenario, with their keys and types checked.

    Attributes
    ----------
    robot, reference, sensor
        Each as a component.
    gearbox, torque_limits, drive
        As components; None for none.
    laws
        Law and its estimator, by the law's name.
    disturbances
        Disturbances, payloads and schedules.
    """

    robot: Component
    reference: Component
    sensor: Component
    gearbox: Component | None
    torque_limits: Component | None
    drive: Component | None
    laws: dict[str, tuple[Component, Component]]
    disturbances: list[Component]


@dataclass(frozen=True, eq=False)
class Setup:
    """The constructed parts of a scenario, with the laws by name.

    The plant is the robot that certificates count on. The simulated one is behind its gearbox, where it has one.
    Further laws are made with its mean inertia by `Scenario.build_law`.
    """

    plant: Plant
    simulated: Plant
    reference: Reference
    sensor: Encoder
    torque_limits: TorqueLimits | None
    drive: Drive | None
    events: list[Event]
    laws: dict[str, Any]
    mean_inertia: "MeanInertia"


class MeanInertia:
    """The robot's mean inertia along the reference, computed once where a law needs it."""

    def __init__(self, plant: Plant, reference: Reference, duration: float):
        self._plant, self._reference, self._duration = plant, reference, duration

    @cached_property
    def matrix(self) -> Array:
        """Return the mean inertia [kg m² or kg], shape (n, n).

        Raises
        ------
        InvalidParameter
            For a reference of another number of joints.
        """
        plant, reference = self._plant, self._reference
        if reference.n_joints != plant.n_joints:
            raise InvalidParameter(
                f"reference: it has {reference.n_joints} joints, the robot {plant.n_joints} "
                f"({', '.join(plant.joint_names)}); give one number per joint",
                "reference",
            )
        postures = reference.sample(np.linspace(0, self._duration, POSTURES_OF_MEAN_INERTIA))[0]
        return plant.mean_inertia(postures)
