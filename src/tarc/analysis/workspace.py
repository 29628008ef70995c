"""The postures for which a robot is certified, and how fast they may change."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.signals.references import Reference

TIME_TO_MAX_SPEED = 0.25
"""Time in which a robot reaches its largest speed [s] where its acceleration is not given."""

REFERENCE_SPEED_FACTOR = 1.2
"""Largest speed of a joint over that of its reference, where the reference gives the speeds."""

SPEED_SAMPLES = 20_001
"""Times at which the speeds of a reference are read."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Workspace:
    """A set of postures and how fast they change: a box of joint positions, or a tube about a reference.

    Without an acceleration, the largest speed is taken to be reached in a quarter of a second. `box`, `from_reference`
    and `from_joint_limits` make workspaces.

    Attributes
    ----------
    low, high
        Ends of the variables. Without a reference these are the positions [rad or m], shape (n,). With one they are
        the time [s] and an offset from the reference per joint [rad or m], shape (n + 1,).
    reference
        The trajectory at the middle of the tube, or None.
    speed
        Largest speed of each joint [rad/s or m/s], shape (n,); None for any speed. A certificate of a slower robot
        covers more.
    acceleration
        Largest acceleration of each joint [rad/s² or m/s²], shape (n,); None without a speed.

    Raises
    ------
    InvalidParameter
        For ends of different shapes or in the wrong order, and for an acceleration without a speed.
    """

    low: Array
    high: Array
    reference: Reference | None = None
    speed: Array | None = None
    acceleration: Array | None = None

    def __post_init__(self) -> None:
        if np.shape(self.low) != np.shape(self.high) or np.ndim(self.low) != 1:
            raise InvalidParameter(
                f"low, high: got shapes {np.shape(self.low)} and {np.shape(self.high)}; needs as many numbers"
            )
        wrong = np.flatnonzero(np.asarray(self.low) > np.asarray(self.high))
        if wrong.size:
            i = int(wrong[0])
            raise InvalidParameter(
                f"low, high: number {i + 1} goes from {self.low[i]:g} to {self.high[i]:g}; needs low ≤ high"
            )
        if self.speed is not None:
            object.__setattr__(self, "speed", check.vector("speed", self.speed, self.n_joints, 0))
            given = self.speed / TIME_TO_MAX_SPEED if self.acceleration is None else self.acceleration
            object.__setattr__(self, "acceleration", check.vector("acceleration", given, self.n_joints, 0))
        elif self.acceleration is not None:
            raise InvalidParameter(
                "acceleration: it bounds nothing without a speed; give the largest speed of the joints as well"
            )

    @classmethod
    def box(
        cls, low: Numbers, high: Numbers, *, speed: Numbers | None = None, acceleration: Numbers | None = None
    ) -> "Workspace":
        """Return all positions between two ends.

        Parameters
        ----------
        low, high
            Ends [rad or m], one number per joint; equal ones hold a joint still.
        speed, acceleration
            As in `with_speed_limits`.

        Raises
        ------
        InvalidParameter
            As for `Workspace`.
        """
        lowest, highest = np.atleast_1d(check.array("low", low)), np.atleast_1d(check.array("high", high))
        return cls(low=lowest, high=highest).with_speed_limits(speed, acceleration)

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
        """Return the positions about a reference.

        Parameters
        ----------
        reference
            The trajectory.
        duration
            Time from its start [s].
        tube
            Largest offset from the reference [rad or m], one number or one per joint.
        speed, acceleration
            As in `with_speed_limits`.

        Raises
        ------
        InvalidParameter
            For another object than a reference, and for a negative duration or tube.
        """
        if not isinstance(reference, Reference):
            raise InvalidParameter(
                f"reference: got {type(reference).__name__}; needs one of tarc.signals, such as Sinusoid"
            )
        end = check.number("duration", duration, 0)
        width = check.vector("tube", tube, reference.n_joints, 0)
        low, high = np.array([0.0, *-width]), np.array([end, *width])
        return cls(low=low, high=high, reference=reference).with_speed_limits(speed, acceleration)

    @classmethod
    def from_joint_limits(
        cls, plant: Plant, *, speed: Numbers | None = None, acceleration: Numbers | None = None
    ) -> "Workspace":
        """Return all positions that the joints of a robot reach.

        Parameters
        ----------
        plant
            The robot. A hinge without a range is taken from −π to π.
        speed, acceleration
            As in `with_speed_limits`.

        Raises
        ------
        InvalidParameter
            For a joint in metres without a range.
        """
        low, high = plant.position_limits.T
        limited = np.isfinite(low) & np.isfinite(high)
        low, high = np.where(limited, low, -np.pi), np.where(limited, high, np.pi)
        for name, unit, has_range in zip(plant.joint_names, plant.units, limited, strict=True):
            if unit != "rad" and not has_range:
                raise InvalidParameter(
                    f"workspace: joint {name} slides [m] and has no range; give the ranges of all joints with "
                    "Workspace.box(low, high)"
                )
        return cls(low=low, high=high).with_speed_limits(speed, acceleration)

    def with_speed_limits(self, speed: Numbers | None, acceleration: Numbers | None = None) -> "Workspace":
        """Return the same postures with limits on the speed of the joints.

        Parameters
        ----------
        speed
            Largest speed [rad/s or m/s], one number or one per joint. None, or an infinite one, stands for any.
        acceleration
            Largest acceleration [rad/s² or m/s²], one number or one per joint. None for the one that reaches the speed
            in a quarter of a second.

        Raises
        ------
        InvalidParameter
            For negative numbers, and for an acceleration without a speed.
        """
        if speed is None or np.isposinf(np.asarray(speed, dtype=float)).any():
            speed = None
        else:
            speed = check.vector("speed", speed, self.n_joints, 0)
        if acceleration is not None:
            acceleration = check.vector("acceleration", acceleration, self.n_joints, 0)
        return replace(self, speed=speed, acceleration=acceleration)

    def with_reference_speeds(self) -> "Workspace":
        """Return the same postures with the largest speed and acceleration of each joint of the reference, times 1.2.

        For a reference at rest the speed is any.

        Raises
        ------
        InvalidParameter
            For a workspace without a reference.
        """
        if self.reference is None:
            raise InvalidParameter("reference: the workspace has none whose speeds it could take; give a speed")
        times = np.linspace(self.low[0], self.high[0], SPEED_SAMPLES)
        _, velocities, accelerations = self.reference.sample(times)
        speed, acceleration = (np.abs(rates).max(axis=1) for rates in (velocities, accelerations))
        if not np.any(speed):
            return self.with_speed_limits(None)
        return self.with_speed_limits(REFERENCE_SPEED_FACTOR * speed, REFERENCE_SPEED_FACTOR * acceleration)

    def scale_speed(self, factor: float) -> "Workspace":
        """Return the same postures with speeds and accelerations multiplied by a factor."""
        if self.speed is None or self.acceleration is None:
            return self
        return self.with_speed_limits(factor * self.speed, factor * self.acceleration)

    def for_joints(self, joint_names: Sequence[str]) -> "Workspace":
        """Return the same for a robot with these joints: the columns of a record follow them by name.

        Raises
        ------
        InvalidParameter
            For a record of other joints.
        """
        if self.reference is None:
            return self
        reference = self.reference.for_run(joint_names, max(float(self.high[0]), np.finfo(float).tiny))
        return self if reference is self.reference else replace(self, reference=reference)

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.low) - (self.reference is not None)

    def sample(self, samples: int, seed: int = 0) -> Array:
        """Return uniformly sampled postures [rad or m], shape (k, n); a single one where the workspace is a point."""
        return self.at_unit_points(self.unit_samples(samples, seed))

    def unit_samples(self, samples: int, seed: int) -> Array:
        """Return uniform samples of the variables on the unit cube, shape (k, v); zero for a fixed variable."""
        check.integer("samples", samples, 1)
        free = self.high > self.low
        rng = np.random.default_rng(check.integer("seed", seed))
        return rng.random((samples if free.any() else 1, len(free))) * free

    def at_unit_points(self, points: Array) -> Array:
        """Return the positions [rad or m], shape (k, n), at points of the unit cube of the variables (k, v)."""
        return self.positions(self.low + points * (self.high - self.low))

    def positions(self, variables: Array) -> Array:
        """Return the positions [rad or m], shape (k, n), at the variables (k, v)."""
        if self.reference is None:
            return variables
        return self.reference.sample(variables[:, 0])[0].T + variables[:, 1:]

    def unit_slopes(self, point: Array) -> Array:
        """Return the derivatives of the position over the variables of the unit cube, shape (n, v), at a point (v,)."""
        width = self.high - self.low
        if self.reference is None:
            return np.diag(width)
        _, velocity, _ = self.reference.sample(self.low[:1] + point[:1] * width[:1])
        return np.column_stack([velocity[:, 0] * width[0], np.diag(width[1:])])
