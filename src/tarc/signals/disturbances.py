"""Disturbances: external torques, and parameters that change during a run."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.validation import Numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbance(Component):
    """External torque on the joints [N m or N]."""

    amplitude: Numbers

    def __post_init__(self) -> None:
        check.array("amplitude", self.amplitude)
        for field in fields(self):
            if field.name not in ("amplitude", "stop_time"):
                check.number(field.name, getattr(self, field.name))

    def sample(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        """Return the torque at evenly spaced times (k,), each held until the next, shape (n, k)."""
        amplitude = check.vector("disturbance amplitude", self.amplitude, n_joints)[:, None]
        return amplitude * self.profile(times, n_joints, rng)

    @abstractmethod
    def profile(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        """Return the torque for an amplitude of one, shape (k,) or (n, k)."""


def _check_order(start_time: float, stop_time: object) -> None:
    """Refuse a stop that is not after the start."""
    if not isinstance(stop_time, int | float) or not stop_time > start_time:
        raise InvalidParameter(
            f"stop_time: got {stop_time!r}; needs a time after start_time = {start_time:g}", "stop_time"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class StepDisturbance(Disturbance):
    """Constant torque from ``start_time`` on, until ``stop_time`` if given [s]; amplitude [N m or N]."""

    start_time: float = 0.0
    stop_time: float = np.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_order(self.start_time, self.stop_time)

    def profile(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        """Return one inside the interval, else zero."""
        return ((times >= self.start_time - 1e-9) & (times < self.stop_time - 1e-9)).astype(float)


@dataclass(frozen=True, kw_only=True, eq=False)
class SineDisturbance(Disturbance):
    """Amplitude sin(frequency t + phase) from ``start_time`` on; amplitude [N m or N], frequency [rad/s]."""

    frequency: float
    phase: float = 0.0
    start_time: float = 0.0

    def profile(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        """Return the sine."""
        return np.where(times >= self.start_time - 1e-9, np.sin(self.frequency * times + self.phase), 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpulseDisturbance(Disturbance):
    """Impulse at one instant; amplitude is its integral [N m s or N s], spread over one plant step."""

    start_time: float

    def profile(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        """Return 1/step in the plant step that contains the instant, so that the integral is one."""
        step = times[1] - times[0] if len(times) > 1 else 1.0
        inside = (times <= self.start_time + 1e-9) & (self.start_time + 1e-9 < times + step)
        return inside / step


@dataclass(frozen=True, kw_only=True, eq=False)
class BandLimitedNoise(Disturbance):
    """Gaussian noise between two frequencies; amplitude is its standard deviation [N m or N].

    Parameters
    ----------
    min_frequency, max_frequency
        Pass band [rad/s]; a fourth-order Butterworth band-pass, or low-pass if min_frequency is 0.
    """

    min_frequency: float = 0.0
    max_frequency: float = 100.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if (
            not 0
            <= check.number("min_frequency", self.min_frequency)
            < check.number("max_frequency", self.max_frequency)
        ):
            raise InvalidParameter(
                f"min_frequency, max_frequency: got {self.min_frequency:g} and {self.max_frequency:g}; needs "
                "0 ≤ min_frequency < max_frequency"
            )

    def profile(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        """Return filtered white noise of unit standard deviation."""
        from scipy.signal import butter, sosfiltfilt

        step = times[1] - times[0] if len(times) > 1 else 1.0
        nyquist = np.pi / step
        if self.max_frequency >= nyquist:
            raise InvalidParameter(
                f"max_frequency: got {self.max_frequency:g} rad/s; the plant step {step:g} s allows up to {nyquist:.4g}"
            )
        kind, edges = (
            ("lowpass", self.max_frequency)
            if self.min_frequency == 0
            else ("bandpass", [self.min_frequency, self.max_frequency])
        )
        sections = butter(4, np.asarray(edges) / nyquist, kind, output="sos")
        settle = int(np.ceil(20 / ((self.max_frequency - self.min_frequency) * step)))
        pulse = np.zeros(4 * settle + 1)
        pulse[2 * settle] = 1.0
        spread = np.linalg.norm(sosfiltfilt(sections, pulse))
        noise = sosfiltfilt(sections, rng.standard_normal((n_joints, len(times) + 2 * settle)), axis=1)
        return noise[:, settle : settle + len(times)] / spread


@dataclass(frozen=True, kw_only=True, eq=False)
class ParameterSchedule(Component):
    """A plant parameter that changes during a run: stepwise, or linearly between the times.

    Parameters
    ----------
    parameter
        Name, one of the plant's ``parameters``, such as ``payload`` or ``viscous``.
    times
        [s], increasing; before the first, the plant has its own value.
    values
        One number or one list in the parameter's shape per time.
    interpolate
        Whether to interpolate between the times (from the first on) instead of stepping.
    """

    parameter: str
    times: Sequence[float]
    values: Sequence[Any]
    interpolate: bool = False

    def __post_init__(self) -> None:
        times = np.atleast_1d(check.array("times", self.times))
        count = len(self.values) if isinstance(self.values, Sequence | np.ndarray) else -1
        if times.size == 0 or np.any(np.diff(times) <= 0) or times.size != count:
            raise InvalidParameter(
                f"schedule of {self.parameter!r}: got times {self.times!r} and values {self.values!r}; needs "
                "increasing times, and a list of one value each"
            )

    def sample(self, times: np.ndarray, initial: np.ndarray) -> np.ndarray:
        """Return the values at the times (k,), shape (size, k), starting from the plant's own."""
        size = max(np.size(initial), 1)
        label = f"schedule of {self.parameter!r}, values"
        values = np.array([check.vector(label, value, size) for value in self.values])
        knots = np.atleast_1d(np.asarray(self.times, dtype=float)) - 1e-9
        after = np.searchsorted(knots, times, side="right")
        steps = np.vstack([np.broadcast_to(np.ravel(initial), (size,)), values])[after].T
        if not self.interpolate:
            return steps
        ramp = np.array([np.interp(times, knots, column) for column in values.T])
        return np.where(after > 0, ramp, steps)


@dataclass(frozen=True, kw_only=True, eq=False)
class Payload(Component):
    """The plant's ``payload`` becomes this mass from ``start_time`` on, until ``stop_time`` if given.

    The masses of payloads that are present at the same time add. While none is, the plant has its own.

    Parameters
    ----------
    mass
        [kg].
    start_time, stop_time
        When it is picked up and put down [s].
    """

    mass: float
    start_time: float = 0.0
    stop_time: float = np.inf

    def __post_init__(self) -> None:
        check.number("mass", self.mass, 0)
        check.number("start_time", self.start_time)
        _check_order(self.start_time, self.stop_time)


def payload_schedule(payloads: Sequence[Payload], own: float) -> ParameterSchedule:
    """Return the sum of payloads over time, as a schedule for a plant with a payload of its own [kg]."""
    ends = {time for payload in payloads for time in (payload.start_time, payload.stop_time)}
    times = sorted(float(time) for time in ends if np.isfinite(time))
    present = [[payload.mass for payload in payloads if payload.start_time <= t < payload.stop_time] for t in times]
    return ParameterSchedule(parameter="payload", times=times, values=[sum(m) if m else own for m in present])
