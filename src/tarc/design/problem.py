"""The requirements of a design on one robot."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.validation import Numbers
from tarc.design.candidates import Candidate
from tarc.design.noise import measurement_deviation, torque_noise
from tarc.design.requirements import DesignRequirements
from tarc.design.robot_facts import joint_workspace, velocity_limits
from tarc.plants.base import Plant


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """Requirements on one robot: the robot with each payload, its workspace and its torque limits.

    Attributes
    ----------
    requirements
        The requirements.
    plants
        The robot with its smallest and its largest payload.
    workspace
        Postures and speeds to certify.
    torque_limits
        [N m or N], shape (n,); infinite where none is known.
    torque_rates
        [N m/s or N/s], shape (n,); infinite where there is no limit.
    """

    requirements: DesignRequirements
    plants: tuple[Plant, ...]
    workspace: Workspace
    torque_limits: np.ndarray
    torque_rates: np.ndarray

    @classmethod
    def from_plant(cls, plant: Plant, requirements: DesignRequirements) -> "DesignProblem":
        """Complete the requirements by what the robot states.

        Raises
        ------
        InvalidParameter
            For a payload that the robot cannot carry, a missing torque limit, and a budget without noise or limit.
            Also for passive joints.
        """
        plant.require_fully_driven("a design")
        plants = with_payloads(plant, requirements.payload)
        workspace = _workspace(plant, requirements)
        limits = _torque_limits(plant, requirements.torque_limits)
        problem = cls(requirements, plants, workspace, limits, _torque_rates(plant, requirements.torque_rate))
        problem._check_budget()
        return problem

    @cached_property
    def sigma(self) -> np.ndarray:
        """Standard deviation of the measured position [rad or m], shape (n,)."""
        return measurement_deviation(self.requirements.sensor, self.plants[0].n_joints)

    @property
    def has_own_speed(self) -> bool:
        """Whether the speed is that of the robot's file, or unknown: nobody requires it."""
        return self.requirements.speed is None and self.requirements.workspace is None

    def noise_ratio(self, candidate: Candidate, shape: np.ndarray) -> float:
        """Return the largest RMS torque change per period by noise over the torque limit, of all joints.

        Parameters
        ----------
        candidate
            The loop.
        shape
            X [kg m² or kg], shape (n, n).
        """
        return float(np.max(torque_noise(candidate.change, shape, self.requirements.sensor) / self.torque_limits))

    def _check_budget(self) -> None:
        limited = np.isfinite(self.torque_limits)
        frequency, budget = self.requirements.natural_frequency, self.requirements.noise_budget
        if frequency is None and not limited.all():
            names = self.plants[0].joint_names
            missing = ", ".join(name for name, is_limited in zip(names, limited, strict=True) if not is_limited)
            raise InvalidParameter(
                f"torque_limits: none is known for joint {missing}, so torque noise has no budget. Give "
                "torque_limits, or a natural_frequency, for which the least noise is chosen"
            )
        if budget is not None and not limited.any():
            raise InvalidParameter(
                "noise_budget: it is a share of the torque limit, and none is known; give torque_limits too"
            )
        if frequency is None and not np.any(self.sigma):
            raise InvalidParameter(
                "sensor: without measurement noise nothing limits the natural frequency; give the encoder bits, a "
                "resolution or noise, or give a natural_frequency"
            )


def with_payloads(plant: Plant, payload: tuple[float, float]) -> tuple[Plant, ...]:
    """Return the robot with its smallest and its largest payload [kg], or as it is."""
    low, high = payload
    if not high:
        return (plant,)
    if "payload" not in plant.parameters:
        raise InvalidParameter(f"payload: {plant!r} has no such parameter; leave it out, or use a robot from a file")
    masses: Sequence[float] = [low] if low == high else [low, high]
    return tuple(plant.with_parameters({"payload": mass}) for mass in masses)


def _workspace(plant: Plant, requirements: DesignRequirements) -> Workspace:
    workspace = requirements.workspace
    if workspace is None:
        workspace = joint_workspace(plant, requirements.joint_range).with_speed_limits(velocity_limits(plant))
    workspace = workspace.for_joints(plant.joint_names)
    if requirements.speed is None and requirements.acceleration is None:
        return workspace
    speed = workspace.speed if requirements.speed is None else requirements.speed
    return workspace.with_speed_limits(speed, requirements.acceleration)


def _torque_rates(plant: Plant, given: Numbers | None) -> np.ndarray:
    """Return the largest rate of each joint's torque, shape (n,), infinite where none is given."""
    rates = check.float_array("torque_rate", np.inf if given is None else given)
    if rates.shape not in ((), (plant.n_joints,)) or not np.all(rates > 0):
        raise InvalidParameter(
            f"torque_rate: got {given!r}; needs one number above 0, or {plant.n_joints} of them, one per joint"
        )
    return np.broadcast_to(rates, (plant.n_joints,))


def _torque_limits(plant: Plant, given: Numbers | None) -> np.ndarray:
    """Return the limits given or the robot's own; a limit of zero in a file stands for none."""
    if given is not None:
        return check.vector("torque_limits", given, plant.n_joints, 0, strict=True)
    own = plant.torque_limits
    return np.where(own > 0, own, np.inf)
