"""Motions that show the inertia of a robot."""

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.signals.references import Multisine


def excitation_reference(
    home: Numbers,
    *,
    duration: float = 20.0,
    amplitude: Numbers = 0.2,
    speed: Numbers = 1.0,
    low: Numbers = -np.inf,
    high: Numbers = np.inf,
    band: tuple[float, float] = (2.0, 30.0),
    tones: int = 4,
) -> Multisine:
    """Return a motion that shows the inertia: sines about a posture, with different frequencies for each joint.

        qᵈ_i = home_i + a_i Σ_m (−1)^m sin(ω_im t)/ω_im

    It starts at home, at rest and without acceleration; a_i is the largest that the bounds allow. All frequencies are
    odd multiples of 2π/duration. Coriolis torque and the change of M(q) are products of two of them. Their
    frequencies are even multiples, so that they are not mistaken for an acceleration.

    Parameters
    ----------
    home
        Posture in the middle [rad or m], shape (n,).
    duration
        Period of repetition [s].
    amplitude, speed
        Largest distance from home [rad or m] and largest velocity [rad/s or m/s], one number or one per joint.
    low, high
        Ends of the joints' ranges [rad or m], which are not passed; infinite for none.
    band
        Lowest and highest frequency [rad/s].
    tones
        Number of sines per joint, even.

    Raises
    ------
    InvalidParameter
        For a home at the end of a range, an odd number of tones, and a band with too few multiples for all joints.
    """
    middle = np.atleast_1d(check.array("home", home))
    n = len(middle)
    base = 2 * np.pi / check.number("duration", duration, 0, strict=True)
    frequency = base * _odd_multiples(base, duration, band, n, check.integer("tones", tones, 2))
    amplitudes = _joint_amplitudes(frequency, n, tones)
    shape = Multisine(amplitude=amplitudes, frequency=frequency, phase=0 * amplitudes)
    q, v, _ = shape.sample(np.linspace(0, duration, 40 * round(frequency[-1] / base)))
    distance = _largest_distance(middle, amplitude, low, high)
    max_speed = check.vector("speed", speed, n, 0, strict=True)
    scale = 0.99 * np.minimum(distance / np.abs(q).max(axis=1), max_speed / np.abs(v).max(axis=1))
    return Multisine(amplitude=scale[:, None] * amplitudes, frequency=frequency, phase=0 * amplitudes, offset=middle)


def _odd_multiples(base: float, duration: float, band: tuple[float, float], n: int, tones: int) -> Array:
    """Return different odd numbers for all sines, evenly spaced in the band on a logarithmic scale."""
    if tones % 2:
        raise InvalidParameter(f"tones: got {tones}; needs an even number, so that the motion starts at rest")
    first, last = check.number("band", band[0], 0, strict=True) / base, check.number("band", band[1], band[0]) / base
    count = n * tones
    if count > (last - first) / 2:
        raise InvalidParameter(
            f"band: {band} has {(last - first) / 2:.0f} odd multiples of 2π/{duration:g} s, for {count} sines; needs a "
            "longer duration, a wider band or fewer tones"
        )
    multiples = 2 * (np.geomspace(first, last, count) // 2) + 1
    for k in range(1, count):
        multiples[k] = max(multiples[k], multiples[k - 1] + 2)
    return multiples


def _joint_amplitudes(frequency: Array, n: int, tones: int) -> Array:
    """Return the amplitude of each sine per joint, shape (n, n tones), with unit velocity and alternating sign.

    The joints take turns in both directions, so that none has the lowest frequency in every round.
    """
    amplitudes = np.zeros((n, n * tones))
    for tone in range(tones):
        columns = tone * n + (np.arange(n) if tone % 2 else np.arange(n)[::-1])
        amplitudes[np.arange(n), columns] = (-1.0) ** tone / frequency[columns]
    return amplitudes


def _largest_distance(middle: Array, amplitude: Numbers, low: Numbers, high: Numbers) -> Array:
    """Return the largest distance from the middle that the amplitude and the ranges allow, shape (n,)."""
    n = len(middle)
    low, high = check.float_array("low", low), check.float_array("high", high)
    if any(end.shape not in ((), (n,)) for end in (low, high)):
        raise InvalidParameter(
            f"low, high: got shapes {[low.shape, high.shape]}; needs one number or {n}, one per joint"
        )
    distance = check.vector("amplitude", amplitude, n, 0, strict=True)
    distance = np.minimum(distance, np.minimum(middle - low, high - middle))
    if not np.all(distance > 0):
        i = int(np.argmin(distance))
        raise InvalidParameter(f"home: joint {i + 1} at {middle[i]:g} is not inside its range; choose another posture")
    return distance
