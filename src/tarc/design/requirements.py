"""What a design must meet, and the same on one robot."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.validation import Numbers
from tarc.design.candidates import Candidate
from tarc.design.noise import measurement_deviation, torque_noise
from tarc.design.robot_facts import joint_workspace, velocity_limits
from tarc.plants.base import Plant
from tarc.signals.sensors import Encoder

LAWS = ("TARC", "TDC")
"""Laws that can be designed."""
DEFAULT_NOISE_BUDGET = 0.01
"""Torque noise over the torque limit, where neither a budget nor a natural frequency is given."""
SLOPE_RATIO = {"TARC": 1.0, "TDC": 0.0}
"""Largest slope of the robust term over the position gain K1. It costs up to a quarter of the tolerated spread."""


def default_encoder() -> Encoder:
    """Return an encoder of 17 bits per turn."""
    return Encoder(bits=17)


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignRequirements:
    """Requirements on a controller. All defaults of a design are here.

    Parameters
    ----------
    period
        Control period [s].
    sensor
        The encoder.
    payload
        Smallest and largest payload at the tool [kg].
    workspace
        Postures to certify; None for all that the joints reach, within the robot's velocity limits.
    joint_range
        Without a workspace: half the width of the postures about home [rad or m]; None for all that the joints reach.
    speed
        Largest joint speed [rad/s or m/s], one number or one per joint; infinite for any. None for that of the
        workspace. A lower speed admits better gains.
    acceleration
        Largest joint acceleration [rad/s² or m/s²], likewise. None for that of the workspace, or for a speed that is
        reached in 0.25 s.
    natural_frequency
        ωn [rad/s]; None to have it chosen.
    damping_ratio
        ζ.
    noise_budget
        Largest RMS torque noise over the torque limit of each joint. None for 0.01, exceeded where no certified loop
        meets it or where the error falls faster than the square of the noise. With a given natural frequency, None
        sets no budget.
    torque_limits
        [N m or N], one number or one per joint; None for the robot's own.
    law
        ``TARC`` or ``TDC``.
    diagonal
        Restrict M̂ to diagonal matrices.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Number of sampled postures, and the seed of their choice.

    Raises
    ------
    InvalidParameter
        For a number out of its range.
    """

    period: float = 1e-3
    sensor: Encoder = field(default_factory=default_encoder)
    payload: tuple[float, float] = (0.0, 0.0)
    workspace: Workspace | None = None
    joint_range: float | None = None
    speed: Numbers | None = None
    acceleration: Numbers | None = None
    natural_frequency: float | None = None
    damping_ratio: float = 1.0
    noise_budget: float | None = None
    torque_limits: Numbers | None = None
    law: str = "TARC"
    diagonal: bool = False
    computation_delay: int = 0
    samples: int = 500
    seed: int = 0

    def __post_init__(self) -> None:
        check.one_of("law", self.law, LAWS)
        check.number("period", self.period, 0, strict=True)
        low, high = (check.number("payload", mass, 0) for mass in self.payload)
        if high < low:
            raise InvalidParameter(f"payload: got {low:g} to {high:g} kg; needs the smallest first")
        object.__setattr__(self, "payload", (low, high))
        check.number("damping_ratio", self.damping_ratio, 0, strict=True)
        for name in ("natural_frequency", "noise_budget", "joint_range"):
            if getattr(self, name) is not None:
                check.number(name, getattr(self, name), 0, strict=True)
        check.integer("computation_delay", self.computation_delay)
        check.integer("samples", self.samples, 1)
        check.integer("seed", self.seed)
        if self.workspace is not None and self.joint_range is not None:
            raise InvalidParameter("workspace, joint_range: both are given; give one of them")

    @property
    def slope_ratio(self) -> float:
        """Largest slope of the robust term over K1."""
        return SLOPE_RATIO[self.law]

    @property
    def has_budget(self) -> bool:
        """Whether torque noise is compared with a budget."""
        return self.natural_frequency is None or self.noise_budget is not None

    @property
    def noise_target(self) -> float:
        """The noise budget, or its default."""
        return DEFAULT_NOISE_BUDGET if self.noise_budget is None else self.noise_budget


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
    """

    requirements: DesignRequirements
    plants: tuple[Plant, ...]
    workspace: Workspace
    torque_limits: np.ndarray

    @classmethod
    def from_plant(cls, plant: Plant, requirements: DesignRequirements) -> "DesignProblem":
        """Complete the requirements by what the robot states.

        Raises
        ------
        InvalidParameter
            For a payload that the robot cannot carry, a missing torque limit, and a budget without noise or limit.
        """
        plants = _with_payloads(plant, requirements.payload)
        workspace = _workspace(plant, requirements)
        problem = cls(requirements, plants, workspace, _torque_limits(plant, requirements.torque_limits))
        problem._check_budget()
        return problem

    @cached_property
    def sigma(self) -> np.ndarray:
        """Standard deviation of the measured position [rad or m], shape (n,)."""
        return np.broadcast_to(measurement_deviation(self.requirements.sensor), (self.plants[0].n_joints,))

    def noise_ratio(self, candidate: Candidate, shape: np.ndarray) -> float:
        """Return the largest torque noise over the torque limit, of all joints, for M̂ of a shape X [kg m² or kg]."""
        return float(np.max(torque_noise(candidate.noise, shape, self.requirements.sensor) / self.torque_limits))

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


def _with_payloads(plant: Plant, payload: tuple[float, float]) -> tuple[Plant, ...]:
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
    if requirements.speed is None and requirements.acceleration is None:
        return workspace
    speed = workspace.speed if requirements.speed is None else requirements.speed
    return workspace.with_speed_limits(speed, requirements.acceleration)


def _torque_limits(plant: Plant, given: Numbers | None) -> np.ndarray:
    """Return the limits given or the robot's own; a limit of zero in a file stands for none."""
    if given is not None:
        return check.vector("torque_limits", given, plant.n_joints, 0, strict=True)
    own = plant.torque_limits
    return np.where(own > 0, own, np.inf)
