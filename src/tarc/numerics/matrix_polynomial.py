"""Symmetric matrix polynomials F(λ) = Σ_i λ^i F_i: definite on a whole interval, by their Bernstein coefficients.

On [a, b] a polynomial of degree d is a convex combination of its d + 1 Bernstein coefficients. If these are positive
definite, it is. Else the interval is halved; the coefficients approach the polynomial with the square of its length.
"""

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from math import comb
from typing import Any

import numpy as np

from tarc.core.types import Array
from tarc.numerics.ball_arithmetic import ball, is_positive_definite

MAX_PIECES = 4000
"""Largest number of pieces of an interval."""
MIN_RELATIVE_LENGTH = 1e-5
"""Length of a piece over its upper end below which it is not halved again."""
FLOAT_MARGIN = 1e-11
"""Least eigenvalue of a coefficient, its diagonal scaled to one, at which balls are expected to decide."""


def evaluate(coefficients: Sequence[Array], point: float) -> Array:
    """Return F(λ) at a point λ, from F_0 to F_d."""
    value = np.zeros_like(coefficients[0])
    for coefficient in reversed(coefficients):
        value = value * point + coefficient
    return value


def bernstein_coefficients(coefficients: Sequence[Array], low: float, high: float) -> list[Array]:
    """Return the Bernstein coefficients on [a, b], of floats or balls.

        F(a + t (b − a)) = Σ_k C(d, k) t^k (1 − t)^{d−k} B_k,   B_k = Σ_{j≤k} C(k, j)/C(d, j) (b − a)^j F^(j)(a)/j!

    Parameters
    ----------
    coefficients
        F_0 to F_d.
    low, high
        a and b.
    """
    degree = len(coefficients) - 1
    exact = coefficients[0].dtype == object
    start: Any = Fraction(low) if exact else low
    length: Any = (Fraction(high) if exact else high) - start

    def weight(value: Any) -> Any:
        return ball(value) if exact else float(value)

    zero = 0 * coefficients[0]
    shifted = [
        sum((coefficients[i] * weight(comb(i, j) * start ** (i - j) * length**j) for i in range(j, degree + 1)), zero)
        for j in range(degree + 1)
    ]
    shares = [[Fraction(comb(k, j), comb(degree, j)) for j in range(k + 1)] for k in range(degree + 1)]
    return [sum((shifted[j] * weight(share) for j, share in enumerate(row)), zero) for row in shares]


def definite_pieces(coefficients: Sequence[Array], low: float, high: float) -> Array | None:
    """Return the ends of pieces of [a, b] on each of which all Bernstein coefficients are positive definite.

    This is in floating point; `is_definite_on` proves it. None where the polynomial is not definite, or hardly.

    Parameters
    ----------
    coefficients
        F_0 to F_d, floats.
    low, high
        a and b, 0 < a ≤ b.
    """
    ends, pending = [low], [high]
    while pending:
        start, end = ends[-1], pending[-1]
        if _are_definite(bernstein_coefficients(coefficients, start, end)):
            ends.append(pending.pop())
            continue
        too_many = len(ends) + len(pending) > MAX_PIECES
        if too_many or end - start < MIN_RELATIVE_LENGTH * end or not _are_definite([evaluate(coefficients, start)]):
            return None
        pending.append((start * end) ** 0.5)
    return np.array(ends)


def is_definite_on(coefficients: Sequence[Array], ends: Array) -> bool:
    """Return whether a polynomial of balls is proven positive definite on all pieces between the ends."""
    return all(
        is_positive_definite(coefficient)
        for start, end in pairwise(ends)
        for coefficient in bernstein_coefficients(coefficients, float(start), float(end))
    )


def _are_definite(matrices: Sequence[Array]) -> bool:
    """Return whether all matrices have eigenvalues above `FLOAT_MARGIN`, their diagonals scaled to one."""
    stack = np.array(matrices)
    diagonals = np.diagonal(stack, axis1=1, axis2=2)
    if not np.all(np.isfinite(stack)) or not np.all(diagonals > 0):
        return False
    scale = diagonals**-0.5
    return bool(np.linalg.eigvalsh(stack * scale[:, :, None] * scale[:, None, :])[:, 0].min() > FLOAT_MARGIN)
