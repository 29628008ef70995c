"""The postures for which a robot is certified, and how fast they may change."""

from dataclasses import dataclass, replace

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.signals.references import Reference

TIME_TO_MAX_SPEED = 0.25
"""Time in which a robot reaches its greatest speed [s], where its acceleration is not given."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Workspace:
    """A set of postures, and how fast they change: a box of joint positions, or what is in a tube about a reference.

    A speed comes with an acceleration; without one it is taken to be reached in a quarter of a second.

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
    acceleration
        The greatest acceleration of each joint [rad/s² or m/s²], shape (n,); None without a speed.
    """

    low: np.ndarray
    high: np.ndarray
    reference: Reference | None = None
    speed: np.ndarray | None = None
    acceleration: np.ndarray | None = None

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
            object.__setattr__(self, "speed", check.vector("speed", self.speed, self.n_joints, 0))
            given = self.speed / TIME_TO_MAX_SPEED if self.acceleration is None else self.acceleration
            object.__setattr__(self, "acceleration", check.vector("acceleration", given, self.n_joints, 0))
        elif self.acceleration is not None:
            raise TarcError(
                "acceleration: it bounds nothing without a speed; give the greatest speed of the joints too"
            )

    @classmethod
    def box(
        cls, low: Numbers, high: Numbers, *, speed: Numbers | None = None, acceleration: Numbers | None = None
    ) -> "Workspace":
        """All positions between low and high [rad or m], one number a joint; equal ones hold a joint still.

        The greatest speed [rad/s or m/s] is one number or one a joint, or None for any; the acceleration alike.
        """
        first, last = (np.atleast_1d(check.array(name, one)) for name, one in (("low", low), ("high", high)))
        return cls(low=first, high=last).with_speed_limits(speed, acceleration)

    @classmethod
    def from_reference(
        cls,
        reference: Reference,
        duration: float,
        *,
        tube: Numbers = 0.0,
        speed: Numbers | None = None,
        acceleration: Numbers | None = None,
    ) -> "Workspace":
        """The positions of a reference in its first seconds, each joint off by at most ±tube [rad or m].

        The duration is in [s]; the tube and the greatest speed [rad/s or m/s] are one number or one a joint, the speed
        None for any; the acceleration alike.
        """
        if not isinstance(reference, Reference):
            raise TarcError(f"reference: got {type(reference).__name__}; needs one of tarc.signals, such as Sinusoid")
        end = check.number("duration", duration, 0)
        width = check.vector("tube", tube, reference.n_joints, 0)
        low, high = np.array([0.0, *-width]), np.array([end, *width])
        return cls(low=low, high=high, reference=reference).with_speed_limits(speed, acceleration)

    @classmethod
    def from_joint_limits(
        cls, plant: Plant, *, speed: Numbers | None = None, acceleration: Numbers | None = None
    ) -> "Workspace":
        """All that the joints of a robot reach: their ranges in its file, and ±π for a hinge without one.

        The greatest speed [rad/s or m/s] is one number or one a joint, or None for any; the acceleration alike.

        Raises
        ------
        TarcError
            For a joint in metres without a range.
        """
        low, high = plant.position_limits.T
        limited = np.isfinite(low) & np.isfinite(high)
        low, high = np.where(limited, low, -np.pi), np.where(limited, high, np.pi)
        for name, unit, has_range in zip(plant.joint_names, plant.units, limited, strict=True):
            if unit != "rad" and not has_range:
                raise TarcError(
                    f"workspace: joint {name} slides [m] and has no range; give the ranges of all joints with "
                    "Workspace.box(low, high)"
                )
        return cls(low=low, high=high).with_speed_limits(speed, acceleration)

    def with_speed_limits(self, speed: Numbers | None, acceleration: Numbers | None = None) -> "Workspace":
        """The same postures, no joint faster than its speed [rad/s or m/s], one number or one a joint.

        Any speed for None and where one is infinite. The acceleration [rad/s² or m/s²] likewise; None for that which
        reaches the speed in a quarter of a second.
        """
        if speed is None or np.isposinf(np.asarray(speed, dtype=float)).any():
            speed = None
        else:
            speed = check.vector("speed", speed, self.n_joints, 0)
        if acceleration is not None:
            acceleration = check.vector("acceleration", acceleration, self.n_joints, 0)
        return replace(self, speed=speed, acceleration=acceleration)

    def scale_speed(self, factor: float) -> "Workspace":
        """The same postures, speeds and accelerations times a factor."""
        if self.speed is None or self.acceleration is None:
            return self
        return self.with_speed_limits(factor * self.speed, factor * self.acceleration)

    @property
    def n_joints(self) -> int:
        """How many joints n."""
        return len(self.low) - (self.reference is not None)

    def sample(self, samples: int, seed: int = 0) -> np.ndarray:
        """Postures (k, n) [rad or m] evenly at random from the workspace; a single one where it is a point."""
        return self.positions(self.low + self.unit_samples(samples, seed) * (self.high - self.low))

    def unit_samples(self, samples: int, seed: int) -> np.ndarray:
        """Points (k, v) of the unit cube of its variables, evenly at random; zero for a variable that is held."""
        check.integer("samples", samples, 1)
        free = self.high > self.low
        rng = np.random.default_rng(check.integer("seed", seed))
        return rng.random((samples if free.any() else 1, len(free))) * free

    def positions(self, variables: np.ndarray) -> np.ndarray:
        """Positions (k, n) [rad or m] at the variables (k, v), a row each."""
        if self.reference is None:
            return variables
        return self.reference.sample(variables[:, 0])[0].T + variables[:, 1:]
