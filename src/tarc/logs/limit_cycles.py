"""Sustained oscillations of a loop that neither its reference nor its noise explains."""

from dataclasses import dataclass

import numpy as np

from tarc.core.types import Array
from tarc.logs.loop_log import LoopLog

HARMONICS = 6.0
"""Multiple of the reference's frequency up to which gravity and friction make harmonics of the motion."""
LEAST_CYCLES = 24
"""Fewest cycles in a log."""
CYCLES_PER_PART = 2
"""Cycles over which one amplitude and phase are measured."""
PARTS = 5
"""Parts in a row that must be one oscillation."""
MIN_COHERENCE = 0.85
"""Least coherence of amplitude and phase from part to part. A transient that decays has less."""
MIN_CYCLES = 16
"""Fewest cycles in which an oscillation must be steady."""
WIDTH = 0.04
"""Half the width over its frequency over which a spectrum is averaged, since a line drifts with the posture."""
NEAR, FAR = 1.25, 1.8
"""Frequencies beside a line, over its own, from which it must stand out."""
MIN_LINE = 10.0
"""Least power of a line over that beside it."""
MIN_OVER_NOISE = 3.0
"""Least amplitude of the position over the deviation of the encoder's noise."""
MIN_OVER_MOTION = 0.01
"""Least amplitude of the torque over the standard deviation of the whole torque."""


@dataclass(frozen=True, kw_only=True)
class LimitCycle:
    """An oscillation that sustains itself, in all of a log or in postures where the loop is unstable.

    Attributes
    ----------
    joint
        Index of the joint.
    frequency
        [Hz].
    amplitude
        Of the measured position [rad or m].
    torque_amplitude
        Of the torque [N m or N].
    start_time, stop_time
        When it was there first and last [s].
    share
        Share of the log in which it was there.
    """

    joint: int
    frequency: float
    amplitude: float
    torque_amplitude: float
    start_time: float
    stop_time: float
    share: float


def find_limit_cycles(log: LoopLog, noise: Array) -> tuple[LimitCycle, ...]:
    """Return the strongest limit cycle of each joint that has one.

    Torque and position are demodulated at the strongest line above the motion, in parts of two cycles. Five parts z in
    a row are one oscillation where their coherence is high, and its position amplitude is well above the noise:

        |Σ z_{m+1} z_m*| / (½ |z_1|² + |z_2|² + … + ½ |z_5|²)

    Parameters
    ----------
    log
        The log.
    noise
        Standard deviation of the encoders [rad or m], shape (n,).
    """
    cycles = (_limit_cycle(log, joint, float(noise[joint])) for joint in range(log.n_joints))
    return tuple(cycle for cycle in cycles if cycle is not None)


def torque_spectrum(log: LoopLog, joint: int) -> tuple[Array, Array]:
    """Return frequencies [Hz] above the motion and the power of a joint's torque there, of one shape."""
    torque = log.torque[:, joint] - np.mean(log.torque[:, joint])
    power = np.abs(np.fft.rfft(np.hanning(len(torque)) * torque)) ** 2
    frequencies = np.fft.rfftfreq(len(torque), log.period)
    least = max(HARMONICS * log.motion_frequency, LEAST_CYCLES / (len(torque) * log.period))
    above = (frequencies > least) & (frequencies < 0.4 / log.period)
    return frequencies[above], power[above]


def _limit_cycle(log: LoopLog, joint: int, noise: float) -> LimitCycle | None:
    line = _line(*torque_spectrum(log, joint))
    if line is None:
        return None
    length = max(round(CYCLES_PER_PART / line / log.period), 4)
    torque = _phasors(log.torque[:, joint], line, log.period, length)
    position = _phasors(log.position[:, joint] - log.reference[0][:, joint], line, log.period, length)
    if len(torque) < PARTS:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(torque, PARTS)
    steps = np.sum(windows[:, 1:] * np.conj(windows[:, :-1]), axis=1)
    weights = np.r_[0.5, np.ones(PARTS - 2), 0.5]
    size = np.abs(windows) ** 2 @ weights
    amplitudes = np.lib.stride_tricks.sliding_window_view(np.abs(position), PARTS).mean(axis=1)
    steady = np.abs(steps) > MIN_COHERENCE * size
    steady &= amplitudes > MIN_OVER_NOISE * noise
    steady &= np.abs(windows).mean(axis=1) > MIN_OVER_MOTION * np.std(log.torque[:, joint])
    inside = np.convolve(steady, np.ones(PARTS)) > 0
    if CYCLES_PER_PART * np.count_nonzero(inside) < MIN_CYCLES:
        return None
    turn = float(np.angle(np.sum(steps[steady])))
    parts = np.flatnonzero(inside)
    return LimitCycle(
        joint=joint,
        frequency=line + turn / (2 * np.pi * length * log.period),
        amplitude=float(np.mean(np.abs(position[inside]))),
        torque_amplitude=float(np.mean(np.abs(torque[inside]))),
        start_time=float(log.times[parts[0] * length]),
        stop_time=float(log.times[(parts[-1] + 1) * length - 1]),
        share=float(np.mean(inside)),
    )


def _line(frequencies: Array, power: Array) -> float | None:
    """Return the frequency of the strongest line [Hz]; None where none stands out from both sides of it."""
    if not np.sum(power) > 0:
        return None
    first = np.searchsorted(frequencies, frequencies * (1 - WIDTH))
    last = np.searchsorted(frequencies, frequencies * (1 + WIDTH), "right")
    total = np.concatenate([[0.0], np.cumsum(power)])
    smooth = (total[last] - total[first]) / (last - first)
    line = float(frequencies[int(np.argmax(smooth))])
    below = smooth[(frequencies < line / NEAR) & (frequencies > line / FAR)]
    above = smooth[(frequencies > line * NEAR) & (frequencies < line * FAR)]
    if not len(below) or not len(above):
        return None
    return line if np.max(smooth) > MIN_LINE * max(np.median(below), np.median(above)) else None


def _phasors(signal: Array, frequency: float, period: float, length: int) -> Array:
    """Return the complex amplitude of a signal at a frequency in parts of equal length, without its slow motion."""
    count = len(signal) // length
    parts = signal[: count * length].reshape(count, length)
    ramp = np.linspace(-1, 1, length)
    angle = 2 * np.pi * frequency * period * np.arange(length)
    columns = np.column_stack([np.cos(angle), np.sin(angle), np.ones(length), ramp, ramp**2])
    cosine, sine, *_ = np.linalg.lstsq(columns, parts.T, rcond=None)[0]
    start = 2 * np.pi * frequency * period * length * np.arange(count)
    return (cosine - 1j * sine) * np.exp(-1j * start)
