"""Sensors between the robot's position and the law."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.system import System
from tarc.core.types import Vector
from tarc.core.validation import Numbers


class EncoderInput(NamedTuple):
    """True position and noise of this instant, each of shape (n,); a NaN in the noise is a lost sample."""

    position: Vector
    noise: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Encoder(Component, System):
    """Position encoder: noise, quantisation to the nearest step, transport delay, lost samples, in that order.

    Without arguments it is perfect. All randomness comes from the simulation's seed.

    Parameters
    ----------
    bits
        Resolution as bits over the span: steps of span / 2^bits.
    resolution
        The step itself [rad or m], instead, one number or one per joint.
    span
        Travel that 2^bits steps cover [rad or m].
    noise
        Standard deviation of white Gaussian noise before quantisation [rad or m].
    delay
        Delay of a sample, in periods.
    dropout
        Probability that a joint's sample is lost; it reaches the law as NaN.
    """

    bits: int | None = None
    resolution: Numbers | None = None
    span: float = 2 * np.pi
    noise: float = 0.0
    delay: int = 0
    dropout: float = 0.0

    def __post_init__(self) -> None:
        if self.bits is not None and self.resolution is not None:
            raise InvalidParameter("bits, resolution: both are given; give one of them")
        check.number("noise", self.noise, 0)
        check.number("span", self.span, 0, strict=True)
        check.number("dropout", self.dropout, 0, high=0.99)
        if self.bits is not None:
            check.integer("bits", self.bits, 1, 52)
        if self.resolution is not None and np.any(check.array("resolution", self.resolution) <= 0):
            raise InvalidParameter(
                f"resolution: got {self.resolution!r}; needs numbers above 0, or None for no quantisation"
            )
        check.integer("delay", self.delay)

    @property
    def step_size(self) -> np.ndarray:
        """Return the step [rad or m], one number or one per joint; 0 for none."""
        if self.bits is not None:
            return np.array(self.span / 2.0**self.bits)
        return np.array(0.0 if self.resolution is None else self.resolution, dtype=float)

    def sample_noise(self, n_joints: int, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw the noise of a whole run, shape (n, count), NaN where a sample is lost; the first one never is."""
        noise = self.noise * rng.standard_normal((n_joints, count))
        if self.dropout:
            lost = rng.random((n_joints, count)) < self.dropout
            lost[:, 0] = False
            noise[lost] = np.nan
        return noise

    def quantise(self, position: Vector) -> Vector:
        """Round to the nearest step."""
        if not np.all(self.step_size > 0):
            return position
        return self.step_size * ops.floor(position / self.step_size + 0.5)

    def init(self, position: Numbers) -> Vector:
        """Return the delay line, shape (n, delay + 1), full of the first reading."""
        return np.repeat(self.quantise(check.array("position", position))[:, None], self.delay + 1, axis=1)

    def step(self, state: Vector, value: EncoderInput) -> tuple[Vector, Vector]:
        """Return the next delay line and the measured position, shape (n,)."""
        queue = ops.shift_in(state, self.quantise(value.position + value.noise))
        return queue, queue[:, -1]
