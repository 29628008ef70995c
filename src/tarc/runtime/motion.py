"""The reference of a run: rest, a ramp to the reference, the reference, and a stop."""

from dataclasses import dataclass

import numpy as np

from tarc.core import validation as check
from tarc.core.types import Array
from tarc.signals.references import Reference

PEAK_OF_RAMP = 1.875
"""Largest speed of a ramp between two points of rest, per mean speed."""
MIN_RAMP_TIME = 0.5
"""Shortest ramp [s]."""


@dataclass(frozen=True)
class Motion:
    """Position, velocity and acceleration reference by period, each of shape (k, n)."""

    position: Array
    velocity: Array
    acceleration: Array

    def __len__(self) -> int:
        return len(self.position)

    def shifted(self, offset: Array) -> "Motion":
        """Return the motion with an offset of its positions (n,)."""
        return Motion(self.position + offset, self.velocity, self.acceleration)

    def at(self, k: int) -> tuple[Array, Array, Array]:
        """Return the rows of a period, each (n,)."""
        return self.position[k], self.velocity[k], self.acceleration[k]


def sampled(reference: Reference, duration: float, period: float) -> Motion:
    """Return a reference in every period of a duration [s]."""
    count = max(1, round(duration / period))
    rows = reference.sample(np.arange(count) * period)
    return Motion(*(np.ascontiguousarray(row.T) for row in rows))


def rest(position: Array, periods: int) -> Motion:
    """Return rest at a position (n,)."""
    place = np.tile(position, (periods, 1))
    return Motion(place, np.zeros_like(place), np.zeros_like(place))


def ramp(start: Array, target: Motion, period: float, *, time: float | None, speed: float) -> Motion:
    """Return the motion from rest at a position (n,) to the first row of a motion.

    It is the polynomial of fifth degree with the position, velocity and acceleration at both ends:

        q(s) = q₀ + Σ_{i=3}^{5} c_i s^i,    s = t / T_r

    Parameters
    ----------
    start
        [rad or m].
    target
        Whose first row is reached one period after the last one of the ramp.
    period
        [s].
    time
        T_r [s]; None for a mean speed of ``speed`` / 1.875 over the longest way, which is the peak speed between two
        points of rest, and 0.5 s at least.
    speed
        [rad/s or m/s].
    """
    way = target.position[0] - start
    if time is None:
        time = max(
            MIN_RAMP_TIME, PEAK_OF_RAMP * float(np.max(np.abs(way))) / check.number("speed", speed, 0, strict=True)
        )
    periods = max(1, round(time / period))
    total = periods * period
    s = np.arange(periods)[:, None] / periods
    velocity, acceleration = total * target.velocity[0], total**2 * target.acceleration[0]
    c3 = 10 * way - 4 * velocity + acceleration / 2
    c4 = -15 * way + 7 * velocity - acceleration
    c5 = 6 * way - 3 * velocity + acceleration / 2
    return Motion(
        start + s**3 * (c3 + s * (c4 + s * c5)),
        s**2 * (3 * c3 + s * (4 * c4 + s * 5 * c5)) / total,
        s * (6 * c3 + s * (12 * c4 + s * 20 * c5)) / total**2,
    )


def stop(position: Array, velocity: Array, acceleration: Array, period: float, time: float) -> Motion:
    """Return the motion that comes to rest from a point of the reference, each (n,), in a time [s].

    Its velocity is the cubic with v₀ and a₀ at the start, and zero with its slope at the end. The last row is at rest:

        v(s) = (1 − s)² (v₀ (1 + 2s) + T a₀ s),    q(T) = q₀ + T v₀/2 + T² a₀/12
    """
    periods = max(2, round(time / period))
    total = periods * period
    s = np.arange(1, periods + 1)[:, None] / periods
    slope = total * acceleration
    # v = v₀ + b s + (−3 v₀ − 2 b) s² + (2 v₀ + b) s³
    c2, c3 = -3 * velocity - 2 * slope, 2 * velocity + slope
    return Motion(
        position + total * s * (velocity + s * (slope / 2 + s * (c2 / 3 + s * c3 / 4))),
        velocity + s * (slope + s * (c2 + s * c3)),
        (slope + s * (2 * c2 + s * 3 * c3)) / total,
    )
