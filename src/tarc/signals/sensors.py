"""Sensors between the robot's position and the law."""

from collections.abc import Sequence
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

SAME_INSTANT = 1e-9
"""Fraction of a period below which a delay counts as whole periods."""


NO_AGE = np.zeros(0)


class EncoderInput(NamedTuple):
    """True position, velocity times the period, and noise of this instant, each of shape (n,).

    A NaN in the noise is a lost sample, and infinity a reading that repeats the one of the period before. ``age`` is
    that of the sample by jitter [periods], shape (1,), or (0,) without jitter.
    """

    position: Vector
    travel: Vector
    noise: Vector
    age: Vector = NO_AGE


class EncoderState(NamedTuple):
    """Past readings and the motion one period ago.

    Readings have shape (n, delay + 1), newest first. The last valid one has shape (n,), or (0,) where no reading is
    checked. Position and travel one period ago have shape (n,), or (0,) where no delay has a fraction.
    """

    delay_line: Vector
    last_valid: Vector
    past_position: Vector
    past_travel: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Encoder(Component, System):
    """Position encoder: delay within a period, noise, quantisation, wrapping, whole periods of delay, in that order.

        r(t_k) = [q(t_k − δT) + noise] to the nearest step

    Without arguments it is perfect. All randomness comes from the simulation's seed. Resolution, span,
    noise, delay and largest step are one number for all joints, or one per joint.

    Between two sampling instants the true position is the cubic (Hermite) polynomial through the positions and
    velocities at both. It is off by T⁴/384 of the largest fourth derivative. Before the start the robot is at rest.

    An absolute encoder repeats its reading after a span, whether it reads 0 … span or −span/2 … span/2. The sensor
    takes each reading in the turn that is nearest to the last valid one, so that no position jumps. At the start it
    takes the turn of the true position. A joint that moves by more than half a span between two valid samples gets a
    wrong turn, as on a real robot.

    Parameters
    ----------
    bits
        Resolution as bits over the span: steps of span / 2^bits.
    resolution
        The step itself [rad or m], instead; 0 for a joint without quantisation.
    span
        Travel that 2^bits steps cover and after which the reading repeats [rad or m], such as 2π for continuous joints.
        None or infinity for a reading that never repeats; its bits then cover 2π.
    noise
        Standard deviation of white Gaussian noise before quantisation [rad or m].
    delay
        δ, the age of a sample in periods, also a fraction such as 0.4.
    dropout
        Probability that a joint's sample is lost; it reaches the law as NaN.
    packet_loss
        Probability that the samples of all joints are lost at once.
    stale
        Probability that all joints repeat their readings of the period before.
    timing_jitter
        Largest age of a sample by the jitter of its clock [periods]. It is uniform from 0 on, the same for all joints
        of an instant, and comes on top of the delay. With the fraction of the delay it is at most one.
    max_step
        Largest distance of a sample from the last valid one [rad or m]; None for any. A sample farther away counts as
        missing. After missing samples the joint must still be that close.
    """

    bits: int | Sequence[int] | None = None
    resolution: Numbers | None = None
    span: Numbers | None = None
    noise: Numbers = 0.0
    delay: Numbers = 0.0
    dropout: float = 0.0
    packet_loss: float = 0.0
    stale: float = 0.0
    timing_jitter: float = 0.0
    max_step: Numbers | None = None

    def __post_init__(self) -> None:
        if self.bits is not None and self.resolution is not None:
            raise InvalidParameter("bits, resolution: both are given; give one of them")
        _ = self.reading_check
        for name in ("dropout", "packet_loss", "stale"):
            check.number(name, getattr(self, name), 0, high=0.99)
        if self.bits is not None:
            for bits in np.ravel(np.asarray(self.bits, dtype=object)):
                check.integer("bits", bits, 1, 52)
        for name in ("resolution", "noise", "delay"):
            if getattr(self, name) is not None:
                numbers_of_at_least_zero(name, getattr(self, name))
        check.number("timing_jitter", self.timing_jitter, 0, high=1)
        if np.max(self._fraction) + self.timing_jitter > 1 + SAME_INSTANT:
            raise InvalidParameter(
                f"timing_jitter: got {self.timing_jitter:g} with a delay of {self.delay!r} periods; needs at most one "
                "together with the fraction of the delay; add whole periods to the delay instead",
                "timing_jitter",
            )
        if self.resolution is not None and not np.any(self.step_size > 0):
            raise InvalidParameter(
                f"resolution: got {self.resolution!r}; needs a number above 0, or None for no quantisation"
            )

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
        sizes = {"resolution": self.step_size.size, "noise": np.size(self.noise), "delay": np.size(self.delay)}
        for name, size in sizes.items():
            if size not in (1, n_joints):
                raise InvalidParameter(f"sensor: its {name} has {size} numbers; the plant has {n_joints} joints")

    @property
    def step_size(self) -> np.ndarray:
        """Return the step [rad or m], one number or one per joint; 0 for none."""
        if self.bits is not None:
            spans = check.float_array("span", np.inf if self.span is None else self.span)
            return np.where(np.isfinite(spans), spans, 2 * np.pi) / 2.0 ** np.asarray(self.bits)
        return np.array(0.0 if self.resolution is None else self.resolution, dtype=float)

    @cached_property
    def _steps(self) -> np.ndarray:
        return self.step_size

    def sample_noise(self, n_joints: int, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw the noise of a whole run, shape (n, count).

        It is NaN where a sample is lost, and infinite where it repeats the reading before; the first one is neither.
        """
        noise = np.reshape(self.noise, (-1, 1)) * rng.standard_normal((n_joints, count))
        if self.dropout:
            lost = rng.random((n_joints, count)) < self.dropout
            lost[:, 0] = False
            noise[lost] = np.nan
        for probability, mark in ((self.stale, np.inf), (self.packet_loss, np.nan)):
            if probability:
                noise[:, 1:][:, rng.random(count - 1) < probability] = mark
        return noise

    def sample_age(self, count: int, rng: np.random.Generator) -> np.ndarray | None:
        """Draw the age of each sample of a run by jitter [periods], shape (count,); None without jitter."""
        return self.timing_jitter * rng.random(count) if self.timing_jitter else None

    @cached_property
    def _whole_delay(self) -> np.ndarray:
        """Whole periods of the delay, one number or one per joint."""
        return np.floor(np.asarray(self.delay, dtype=float) + SAME_INSTANT).astype(int)

    @cached_property
    def _fraction(self) -> np.ndarray:
        """Fraction of a period by which a sample is older than its whole periods, one number or one per joint."""
        return np.maximum(np.asarray(self.delay, dtype=float) - self._whole_delay, 0.0)

    @cached_property
    def _has_fraction(self) -> bool:
        return bool(np.any(self._fraction > SAME_INSTANT)) or self.timing_jitter > 0

    def quantise(self, position: Vector) -> Vector:
        """Round to the nearest step."""
        steps = self._steps
        if ops.symbolic(steps) or np.all(steps > 0):
            return steps * ops.floor(position / steps + 0.5)
        if not np.any(steps > 0):
            return position
        divisors = np.where(steps > 0, steps, 1.0)
        return ops.where(steps > 0, steps * ops.floor(position / divisors + 0.5), position)

    def init(self, position: Numbers, noise: Numbers = 0.0) -> EncoderState:
        """Return the state at rest at a position (n,), after a first reading with noise, which fills the delay line."""
        position = check.array("position", position)
        reading = self.quantise(position + check.array("noise", noise))
        nothing = np.zeros(0)
        delay_line = np.repeat(reading[:, None], int(np.max(self._whole_delay)) + 1, axis=1)
        last_valid = reading if self.reading_check.is_needed else nothing
        if self._has_fraction:
            return EncoderState(delay_line, last_valid, position, 0 * position)
        return EncoderState(delay_line, last_valid, nothing, nothing)

    def step(self, state: EncoderState, value: EncoderInput) -> tuple[EncoderState, Vector]:
        """Return the next state and the measured position, shape (n,)."""
        position = value.position
        if self._has_fraction:
            position = self._earlier(state, value)
        reading = self.quantise(position + value.noise)
        if self.stale:
            reading = ops.where(value.noise > ops.HUGE, state.delay_line[:, 0], reading)
        last_valid = state.last_valid
        if self.reading_check.is_needed:
            # the readings 0 … span, −span/2 … span/2 and without end differ by whole turns, so they unwrap to the same
            last_valid, reading = self.reading_check.step(last_valid, reading)
        delay_line = ops.shift_in(state.delay_line, reading)
        past = (value.position, value.travel) if self._has_fraction else (state.past_position, state.past_travel)
        return EncoderState(delay_line, last_valid, *past), self._delayed(delay_line)

    def _earlier(self, state: EncoderState, value: EncoderInput) -> Vector:
        """Return the true position a fraction of a period before this instant, by cubic Hermite interpolation."""
        s = 1 - self._fraction
        if value.age.shape[0]:
            s = s - value.age
        return (
            (1 + 2 * s) * (1 - s) ** 2 * state.past_position
            + s * (1 - s) ** 2 * state.past_travel
            + s**2 * (3 - 2 * s) * value.position
            - s**2 * (1 - s) * value.travel
        )

    def _delayed(self, delay_line: Vector) -> Vector:
        """Return each joint's reading after its whole periods of delay."""
        return ops.pick_columns(delay_line, np.broadcast_to(self._whole_delay, (delay_line.shape[0],)))


def numbers_of_at_least_zero(name: str, value: object) -> np.ndarray:
    """Return one number of at least 0, or one per joint."""
    result = check.array(name, value)
    if result.ndim > 1 or result.size == 0 or np.any(result < 0):
        raise InvalidParameter(f"{name}: got {value!r}; needs one number of at least 0, or one per joint", name)
    return result
