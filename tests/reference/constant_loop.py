"""Polynomials of a constant loop in z⁻¹: its roots, frequency responses with their peaks, and the growth of a kick."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from reference.law_parameters import PERIOD
from reference.law_recurrence import Recurrence, add_polynomials

Array = np.ndarray


class LoopPolynomials(NamedTuple):
    """In powers of z⁻¹, constant first: of the closed loop, and of the numerators from a to v and q, and w to q."""

    closed: Array
    a_to_v: Array
    a_to_q: Array
    w_to_q: Array


def loop_polynomials(law: Recurrence, ratio: float, slope: float = 0.0, stiffness: float = 0.0) -> LoopPolynomials:
    """Of the loop around q̈ = ρ v − h q, v held for a period, with a constant slope in it."""
    multiply = np.polynomial.polynomial.polymul
    own, side = np.concatenate([[1.0], -law.v]), add_polynomials(-law.q, slope * np.array([1.0, law.e]))
    swing = np.emath.sqrt(stiffness) * PERIOD
    # q = motion / (1 − 2 cos(√h T) z⁻¹ + z⁻²) of an acceleration
    reach = np.real(np.sinc(swing / 2 / np.pi) ** 2)
    motion = PERIOD**2 / 2 * reach * np.array([0.0, 1.0, 1.0])
    late = np.concatenate([np.zeros(law.delay), motion])
    free = multiply(own, [1.0, -2.0 * np.real(np.cos(swing)), 1.0])
    closed = add_polynomials(free, ratio * multiply(late, side))
    return LoopPolynomials(closed, -multiply(motion, side), multiply(motion, own), ratio * multiply(late, [1.0, law.e]))


def spectral_radius(closed: Array) -> float:
    """Largest root of a closed loop's polynomial."""
    return float(np.max(np.abs(np.roots(closed))))


def root_uncertainty(closed: Array) -> float:
    """How far rounding of the coefficients may move the largest root, with room."""
    roots = np.roots(closed)
    lead = roots[np.argmax(np.abs(roots))]
    size = np.abs(lead) ** np.arange(len(closed) - 1, -1, -1)
    steep = np.abs(np.polyval(np.polyder(closed), lead))
    return float(1e4 * np.finfo(float).eps * (size @ np.abs(closed)) / max(steep, 1e-300)) + 1e-10


def frequency_response(top: Array, bottom: Array, angles: Array) -> Array:
    """Frequency response at angles [rad a period]."""
    back = np.exp(-1j * angles)
    value = np.polynomial.polynomial.polyval
    return value(back, top) / value(back, bottom)


ANGLES = np.concatenate([np.geomspace(1e-5, 0.3, 1500), np.linspace(0.3, np.pi, 1500)])


def peak_gain(top: Array, bottom: Array) -> tuple[float, float]:
    """Largest gain on a grid, drawn closer three times around its best point, and where [rad a period]."""
    return _maximise_over_frequency(lambda angles: np.abs(frequency_response(top, bottom, angles)))


def peak_gain_of_pair(known: LoopPolynomials, weight: float) -> tuple[float, float]:
    """Largest gain from a to (v, weight q) of one loop, and where [rad a period]."""

    def size(angles: Array) -> Array:
        q = weight * frequency_response(known.a_to_q, known.closed, angles)
        return np.hypot(np.abs(frequency_response(known.a_to_v, known.closed, angles)), np.abs(q))

    return _maximise_over_frequency(size)


def most_negative_real_part(top: Array, bottom: Array) -> tuple[float, float]:
    """How far the response reaches to the left of zero, and where [rad a period]."""
    return _maximise_over_frequency(lambda angles: -np.real(frequency_response(top, bottom, angles)))


def _maximise_over_frequency(function: Callable[[Array], Array]) -> tuple[float, float]:
    angles, best, where = ANGLES, -np.inf, 0.0
    for _ in range(4):
        values = function(angles)
        top = int(np.argmax(values))
        if values[top] > best:
            best, where = float(values[top]), float(angles[top])
        angles = np.linspace(angles[max(top - 1, 0)], angles[min(top + 1, len(angles) - 1)], 41)
    return best, where


def log_growth_after_kick(closed: Array, guess: float, most: int = 400_000) -> float:
    """Simulate a constant loop after a kick: the logarithm of its last quarter's peak over its second's.

    Long enough to show which way a mode of the guessed radius goes; NaN if that takes more steps than allowed: then
    the roots must decide.
    """
    from scipy.signal import lfilter

    steps = int(40 / max(abs(np.log(guess)), 1e-12)) + 40 * len(closed)
    if steps > most:
        return np.nan
    kick = np.zeros(steps)
    kick[0] = 1.0
    size = np.abs(np.asarray(lfilter([1.0], closed, kick)))
    if not np.all(np.isfinite(size)):
        return np.inf
    quarter = steps // 4
    late, early = size[3 * quarter :].max(), size[quarter : 2 * quarter].max()
    return float(np.log(max(late, 1e-300) / max(early, 1e-300)))
