"""A law as a recurrence, by hand from its equation, with weights from a least-squares fit of its own."""

from typing import NamedTuple

import numpy as np

from reference.law_parameters import PERIOD, LawParameters

Array = np.ndarray


class Recurrence(NamedTuple):
    """v_k = Σ_{i≥1} v_i v_{k−i} + Σ_{i≥0} q_i q_{k−i} + w_k + e w_{k−1}, which acts ``delay`` periods later."""

    v: Array
    q: Array
    e: float
    delay: int


def derivative_weights(window: int, degree: int, derivative: int) -> Array:
    """Weights of the window's samples, newest first, by fitting a polynomial to each sample's own unit."""
    if not window:  # backward differences
        return np.array([[1.0, -1.0, 0.0], [1.0, -2.0, 1.0]])[derivative - 1] / PERIOD**derivative
    age = -np.arange(window + 1) * PERIOD
    fit = np.polynomial.polynomial.polyfit(age / PERIOD, np.eye(window + 1), degree)
    return fit[derivative] * derivative / PERIOD**derivative  # j! is j for the first two derivatives


def recurrence(design: LawParameters) -> Recurrence:
    """Return the law as a recurrence.

    Literal: v = u − z⁻ᵐ â + z⁻ᵐ⁻ᵃ v; synchronised: v = u − â + z⁻¹⁻ᵃ c(z) v; with u = −K1 q − K2 v̂ + w, and behind a
    low-pass both times its 1 − p z⁻¹.
    """
    pole = np.exp(-design.cutoff * PERIOD) if design.cutoff else 0.0
    lag = np.array([1.0, -pole])
    rate, second = ((1 - pole) * derivative_weights(design.window, design.degree, j) for j in (1, 2))
    K1, K2 = design.natural_frequency**2, 2 * design.damping_ratio * design.natural_frequency

    def later(polynomial: Array, periods: int) -> Array:
        return np.concatenate([np.zeros(periods), polynomial])

    if design.synchronised:
        # the second difference estimate of a motion whose acceleration is one in a single period, then zero
        since = np.arange(len(second))
        pulse = PERIOD**2 * np.where(since > 0, since - 0.5, 0.0)
        average = np.array([second[: k + 1] @ pulse[k::-1] for k in range(1, len(second))])
        past, estimate = later(average, 1 + design.actuation_delay), second
    else:
        past = later(lag, design.delay_periods + design.actuation_delay)
        estimate = later(second, design.delay_periods)
    v = add_polynomials(past, later(-lag[1:], 1))
    q = -add_polynomials(add_polynomials(K1 * lag, K2 * rate), estimate)
    return Recurrence(v[1:], q, float(lag[1]), design.computation_delay)


def add_polynomials(one: Array, two: Array) -> Array:
    """Of two polynomials, constant first."""
    return np.polynomial.polynomial.polyadd(one, two)
