"""A loop with what its certificate says may vary, its matrices, and its exact growth under a rotating mismatch."""

from typing import NamedTuple

import numpy as np

from reference.constant_loop import frequency_response, loop_polynomials
from reference.law_parameters import PERIOD
from reference.law_recurrence import Recurrence

Array = np.ndarray


class UncertainCase(NamedTuple):
    """A loop, the centre and radius of its mismatch, its largest slope, and the weight η of the robot's stiffness.

    The mismatch adds the acceleration (E − ρ0 I) v − H q with ‖[E − ρ0 I, H/η]‖ at most the radius, ‖dE⁻¹/dt‖ at most
    the rate [1/s] and ‖H‖ at most the stiffness [1/s²].
    """

    law: Recurrence
    centre: float
    radius: float = 0.0
    max_slope: float = 0.0
    stiffness_weight: float = 0.0
    max_rate: float = np.inf
    max_stiffness: float = np.inf


def worst_pair_direction(case: UncertainCase, rate: float | Array, slope: float = 0.0) -> tuple[Array, Array]:
    """How a pair that turns at a rate does most: shares of mismatch and stiffness as an angle, and its phase."""
    known = loop_polynomials(case.law, case.centre, slope)
    v = frequency_response(known.a_to_v, known.closed, np.asarray(rate))
    q = case.stiffness_weight * frequency_response(known.a_to_q, known.closed, np.asarray(rate))
    return np.arctan2(np.abs(q), np.abs(v)), -np.angle(q)


def state_matrices(case: UncertainCase) -> tuple[Array, Array, Array, Array]:
    """Return A, B, W, C of the loop at the centre with half the slope: x⁺ = A x + B a + W w, v = C x.

    The state is q, q̇ T, the positions before, the newest first, and likewise v, and the last w.
    """
    law, T2 = case.law, PERIOD**2
    m, n = len(law.q) - 1, max(len(law.v), law.delay)
    size = 2 + m + n + 1
    C, act, first = np.zeros(size), np.zeros(size), 2 + m
    C[0], C[2:first], C[first : first + len(law.v)], C[-1] = law.q[0], law.q[1:], law.v, law.e
    half = -case.max_slope / 2 * np.eye(1, size)[0]  # w = half x
    C = C + half
    act[:] = C if law.delay == 0 else 0
    if law.delay:
        act[first + law.delay - 1] = 1.0
    A, B, W = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    A[0, :2], A[1, 1] = 1.0, 1.0
    A[0] += case.centre * T2 / 2 * act
    A[1] += case.centre * T2 * act
    if m:
        A[2, 0] = 1.0
        A[np.arange(3, first), np.arange(2, first - 1)] = 1.0
    if n:
        A[first] = C
        A[np.arange(first + 1, first + n), np.arange(first, first + n - 1)] = 1.0
    A[-1] = half
    B[:2] = T2 / 2, T2
    if law.delay == 0:
        W[:2] = case.centre * B[:2]
    W[first] = 1.0
    W[-1] = 1.0
    return A, B, W, C


def growth_per_period(case: UncertainCase, slope: float, rates: Array) -> Array:
    """How much a period multiplies the state by, exactly, while a mismatch at the radius turns at each rate [rad].

    Its eigenvalues are the centre ± the radius. In the frame that turns along, the loop of the complex q has constant
    coefficients. The slope is constant, and so is the stiffness, which turns q by a constant angle.
    """
    A, B, W, C = state_matrices(case)
    A, C = A + np.outer(W, (case.max_slope / 2 - slope) * np.eye(1, len(A))[0]), C.copy()
    C[0] += case.max_slope / 2 - slope
    gain = case.radius * (np.outer(B, C) if case.law.delay == 0 else np.outer(B, np.eye(len(A))[_acting_index(case)]))
    found = []
    for rate in np.atleast_1d(rates):
        turn = np.exp(-1j * rate)
        share, phase = worst_pair_direction(case, rate, slope)
        spring = case.radius * case.stiffness_weight * np.sin(share) * np.exp(1j * phase)
        same, other = turn * (A + spring * np.outer(B, np.eye(1, len(A))[0])), turn * np.cos(share) * gain
        both = np.block([[(same + other).real, (other - same).imag], [(same + other).imag, (same - other).real]])
        found.append(float(np.max(np.abs(np.linalg.eigvals(both)))))
    return np.array(found)


def _acting_index(case: UncertainCase) -> int:
    """Where in the state the v is that acts now."""
    return 2 + len(case.law.q) - 1 + case.law.delay - 1
