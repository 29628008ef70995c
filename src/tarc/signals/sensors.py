"""Sensors between the robot's position and the law."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.system import System
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.signals.readings import ReadingCheck


class EncoderInput(NamedTuple):
    """True position and noise of this instant, each of shape (n,); a NaN in the noise is a lost sample."""

    position: Vector
    noise: Vector


class EncoderState(NamedTuple):
    """Delayed readings, shape (n, delay + 1), and the last valid one, (n,), or (0,) where no reading is checked."""

    delay_line: Vector
    last_valid: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Encoder(Component, System):
    """Position encoder: noise, quantisation to the nearest step, wrapping, delay, lost samples, in that order.

    Without arguments it is perfect. All randomness comes from the simulation's seed.

    An absolute encoder repeats its reading after a span, whether it reads 0 … span or −span/2 … span/2. The sensor
    takes each reading in the turn that is nearest to the last valid one, so that no position jumps. At the start it
    takes the turn of the true position. A joint that moves by more than half a span between two valid samples gets a
    wrong turn, as on a real robot.

    Parameters
    ----------
    bits
        Resolution as bits over the span: steps of span / 2^bits.
    resolution
        The step itself [rad or m], instead, one number or one per joint.
    span
        Travel that 2^bits steps cover and after which the reading repeats [rad or m], one number or one per joint, such
        as 2π for continuous joints. None or infinity for a reading that never repeats; its bits then cover 2π.
    noise
        Standard deviation of white Gaussian noise before quantisation [rad or m].
    delay
        Delay of a sample, in periods.
    dropout
        Probability that a joint's sample is lost; it reaches the law as NaN.
    max_step
        Largest distance of a sample from the last valid one [rad or m], one number or one per joint; None for any. A
        sample farther away counts as missing. After missing samples the joint must still be that close.
    """

    bits: int | None = None
    resolution: Numbers | None = None
    span: Numbers | None = None
    noise: float = 0.0
    delay: int = 0
    dropout: float = 0.0
    max_step: Numbers | None = None

    def __post_init__(self) -> None:
        if self.bits is not None and self.resolution is not None:
            raise InvalidParameter("bits, resolution: both are given; give one of them")
        check.number("noise", self.noise, 0)
        _ = self.reading_check
        check.number("dropout", self.dropout, 0, high=0.99)
        if self.bits is not None:
            check.integer("bits", self.bits, 1, 52)
        if self.resolution is not None and np.any(check.array("resolution", self.resolution) <= 0):
            raise InvalidParameter(
                f"resolution: got {self.resolution!r}; needs numbers above 0, or None for no quantisation"
            )
        check.integer("delay", self.delay)

    @cached_property
    def reading_check(self) -> ReadingCheck:
        """Return what unwraps a reading and drops one that jumps."""
        return ReadingCheck(self.span, self.max_step)

    def check_joints(self, n_joints: int) -> None:
        """Refuse one number per joint for another number of joints.

        Raises
        ------
        InvalidParameter
            For a resolution, a span or a largest step of another size than 1 or n.
        """
        self.reading_check.check_joints(n_joints, "sensor.")
        if self.step_size.size not in (1, n_joints):
            raise InvalidParameter(
                f"sensor: its resolution has {self.step_size.size} numbers; the plant has {n_joints} joints"
            )

    @property
    def step_size(self) -> np.ndarray:
        """Return the step [rad or m], one number or one per joint; 0 for none."""
        if self.bits is not None:
            spans = check.float_array("span", np.inf if self.span is None else self.span)
            return np.where(np.isfinite(spans), spans, 2 * np.pi) / 2.0**self.bits
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

    def init(self, position: Numbers) -> EncoderState:
        """Return the state after the first reading, which fills the delay line."""
        reading = self.quantise(check.array("position", position))
        last_valid = reading if self.reading_check.is_needed else np.zeros(0)
        return EncoderState(np.repeat(reading[:, None], self.delay + 1, axis=1), last_valid)

    def step(self, state: EncoderState, value: EncoderInput) -> tuple[EncoderState, Vector]:
        """Return the next state and the measured position, shape (n,)."""
        reading = self.quantise(value.position + value.noise)
        last_valid = state.last_valid
        if self.reading_check.is_needed:
            # the readings 0 … span, −span/2 … span/2 and without end differ by whole turns, so they unwrap to the same
            last_valid, reading = self.reading_check.step(last_valid, reading)
        delay_line = ops.shift_in(state.delay_line, reading)
        return EncoderState(delay_line, last_valid), delay_line[:, -1]
