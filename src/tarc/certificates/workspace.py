"""The postures for which a robot is certified, and how fast they may change."""

from dataclasses import dataclass, replace

import numpy as np

from tarc import check
from tarc.check import Numbers
from tarc.errors import TarcError
from tarc.plants.base import Plant
from tarc.signals.references import Reference


@dataclass(frozen=True, kw_only=True, eq=False)
class Workspace:
    """A set of postures, and how fast they change: a box of joint positions, or what is in a tube about a reference.

    Made by `box`, `path` or `of`.

    Attributes
    ----------
    low, high
        Ends of the variables: the positions [rad or m], shape (n,); with a reference the time [s] and then an offset
        from it a joint [rad or m], shape (n + 1,).
    reference
        The trajectory at the middle of the tube, or None.
    speed
        The greatest speed of each joint [rad/s or m/s], shape (n,); None for any speed. The slower the robot, the more
        its loop bears.
    """

    low: np.ndarray
    high: np.ndarray
    reference: Reference | None = None
    speed: np.ndarray | None = None

    def __post_init__(self) -> None:
        if np.shape(self.low) != np.shape(self.high) or np.ndim(self.low) != 1:
            raise TarcError(
                f"low, high: got shapes {np.shape(self.low)} and {np.shape(self.high)}; needs one number a joint each"
            )
        wrong = np.flatnonzero(np.asarray(self.low) > np.asarray(self.high))
        if wrong.size:
            i = int(wrong[0])
            raise TarcError(
                f"low, high: number {i + 1} goes from {self.low[i]:g} to {self.high[i]:g}; needs low ≤ high"
            )
        if self.speed is not None:
            object.__setattr__(self, "speed", check.vector("speed", self.speed, self.joints, 0))

    @classmethod
    def box(cls, low: Numbers, high: Numbers, *, speed: Numbers | None = None) -> "Workspace":
        """All positions between low and high [rad or m], one number a joint; equal ones hold a joint still.

        The greatest speed [rad/s or m/s] is one number or one a joint, or None for any.
        """
        first = np.atleast_1d(check.array("low", low))
        return cls(low=first, high=np.atleast_1d(check.array("high", high)), speed=_speed(speed, len(first)))

    @classmethod
    def path(
        cls, reference: Reference, duration: float, *, tube: Numbers = 0.0, speed: Numbers | None = None
    ) -> "Workspace":
        """The positions of a reference in its first seconds, each joint off by at most ±tube [rad or m].

        The duration is in [s]; the tube and the greatest speed [rad/s or m/s] are one number or one a joint, the speed
        None for any.
        """
        if not isinstance(reference, Reference):
            raise TarcError(f"reference: got {type(reference).__name__}; needs one of tarc.signals, such as Sinusoid")
        end = check.number("duration", duration, 0)
        width = check.vector("tube", tube, reference.joints, 0)
        low, high = np.array([0.0, *-width]), np.array([end, *width])
        return cls(low=low, high=high, reference=reference, speed=_speed(speed, reference.joints))

    @classmethod
    def of(cls, plant: Plant, *, speed: Numbers | None = None) -> "Workspace":
        """All that the joints of a robot reach: their ranges in its file, and ±π for a hinge without one.

        The greatest speed [rad/s or m/s] is one number or one a joint, or None for any.

        Raises
        ------
        TarcError
            For a joint in metres without a range.
        """
        from tarc.plants.mujoco import MujocoPlant

        low, high = np.full(plant.joints, -np.pi), np.full(plant.joints, np.pi)
        limited = np.zeros(plant.joints, dtype=bool)
        if isinstance(plant, MujocoPlant):
            limited = plant.model.jnt_limited.astype(bool)
            low, high = np.where(limited[:, None], plant.model.jnt_range, np.column_stack([low, high])).T
        for name, unit, known in zip(plant.joint_names, plant.joint_units, limited, strict=True):
            if unit != "rad" and not known:
                raise TarcError(
                    f"workspace: joint {name} slides [m] and has no range; give the ranges of all joints with "
                    "Workspace.box(low, high)"
                )
        return cls(low=low, high=high, speed=_speed(speed, plant.joints))

    def within(self, speed: Numbers | None) -> "Workspace":
        """The same postures, no joint faster than its speed [rad/s or m/s], one number or one a joint.

        Any speed for None and where one is infinite.
        """
        if speed is None:
            return replace(self, speed=None)
        given = np.asarray(speed, dtype=float)
        return replace(self, speed=None if np.isposinf(given).any() else _speed(given, self.joints))

    @property
    def joints(self) -> int:
        """How many joints n."""
        return len(self.low) - (self.reference is not None)

    def sample(self, samples: int, seed: int = 0) -> np.ndarray:
        """Postures (k, n) [rad or m] evenly at random from the workspace; a single one where it is a point."""
        return self.positions(self.low + self.units(samples, seed) * (self.high - self.low))

    def units(self, samples: int, seed: int) -> np.ndarray:
        """Points (k, v) of the unit cube of its variables, evenly at random; zero for a variable that is held."""
        check.whole("samples", samples, 1)
        free = self.high > self.low
        rng = np.random.default_rng(check.whole("seed", seed))
        return rng.random((samples if free.any() else 1, len(free))) * free

    def positions(self, variables: np.ndarray) -> np.ndarray:
        """Positions (k, n) [rad or m] at the variables (k, v), a row each."""
        if self.reference is None:
            return variables
        return self.reference.sample(variables[:, 0])[0].T + variables[:, 1:]


def _speed(given: Numbers | None, joints: int) -> np.ndarray | None:
    return None if given is None else check.vector("speed", given, joints, 0)
