"""Tubes about a reference: the motion, what disturbs it, and what a Lyapunov function must tolerate."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.analysis.tube import TubeBounds
from tarc.certificates.affine_form import RatioSet
from tarc.certificates.region_form import InputBounds, TrackingLoop
from tarc.core.types import Array
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.plants.base import Plant
from tarc.signals.references import Reference

MARGIN = 0.05
"""Growth of all that was found in the tube that the certificate covers; samples miss the worst."""
FORCE_SHARE = 0.01
"""Share of the bound on the forces that is left to the motion within a period."""


class TubeSize(NamedTuple):
    """Size of the tube in coordinates M̂^½ q.

    Attributes
    ----------
    error, error_rate
        Largest ‖e‖ [rad kg^½ m] and ‖ė‖ [rad kg^½ m/s].
    """

    error: float
    error_rate: float

    def rows(self, loop: TrackingLoop) -> Array:
        """Return the rows of e and ė T over what the tube allows."""
        return loop.outputs / np.array([[self.error], [self.error_rate * loop.period]])


class Disturbances(NamedTuple):
    """What acts on a robot and a law, each (n,).

    Attributes
    ----------
    noise
        Largest error of a measured position [rad or m].
    torque_rate, max_torque
        Largest rate of a disturbing torque [N m/s or N/s], and its largest size [N m or N].
    friction
        Largest torque that may change at any time [N m or N].
    """

    noise: Array
    torque_rate: Array
    max_torque: Array
    friction: Array


class TubeCase(NamedTuple):
    """A tube and what a Lyapunov function must tolerate in it.

    Attributes
    ----------
    tube, ratios, bounds
        Its size, the ratios and forces, and what acts on the loop.
    start
        Slope over e of the command of a robot at rest [1/s²], what it lacks of that along the reference [rad kg^½
        m/s²], and ‖M̂^½ q̇ᵈ‖ at the start.
    """

    tube: TubeSize
    ratios: RatioSet
    bounds: InputBounds
    start: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class RegionProblem:
    """What is given: a law on a robot along a reference, what disturbs them, and the errors that are allowed.

    Attributes
    ----------
    law, plants, reference, duration
        The law, the robot or several, the motion and its duration [s].
    max_error
        Largest error of each joint [rad or m], (n,).
    disturbances
        What acts on robot and law.
    residuals
        What the law's derivatives of the reference lack at each period, (n, k).
    samples, seed
        Number of sampled states of a tube, and the seed.
    """

    law: TDC | TARC
    plants: Sequence[Plant]
    reference: Reference
    duration: float
    max_error: Array
    disturbances: Disturbances
    residuals: Array
    samples: int
    seed: int


def tolerated_ratios(robot: TubeBounds, period: float) -> RatioSet:
    """Return what the loop must tolerate of a robot in a tube, with `MARGIN`; M̂ is constant."""
    room, count = 1 + MARGIN, len(robot.stiffness)
    return RatioSet(
        min_ratio=robot.min_ratio / room,
        max_ratio=robot.max_ratio * room,
        rate=robot.rate * room,
        relative_rate=robot.relative_rate * room,
        period=period,
        intersample=True,
        powers=np.ones(count),
        lead_times=robot.lead_times,
        stiffness=robot.stiffness * room,
        shares=np.full(count, FORCE_SHARE),
    )
