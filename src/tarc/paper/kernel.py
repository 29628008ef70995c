"""Exact constants of the estimator's kernel Ω_j."""

from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import factorial
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.numerics.ball_arithmetic import ball

if TYPE_CHECKING:
    import flint


def kernel_coefficients(degree: int, derivative: int = 1) -> list[Fraction]:
    """Return the coefficients of Ω_j on [−1, 0], lowest power first, exactly.

    Ω_j is the kernel of `tarc.estimators.Algebraic` for the window ς = 1.
    """
    n, j = degree, derivative
    scale = Fraction(factorial(n + 1 + j), factorial(j) * factorial(n - j))
    return [
        scale * Fraction(factorial(n + 1 + k), (j + k + 1) * factorial(n - k) * factorial(k) ** 2) for k in range(n + 1)
    ]


def kernel_energy(degree: int) -> Fraction:
    """Return ς³ ∫Ω_1² exactly: 12, 192, 1200 for the degrees 1, 2, 3."""
    square = [Fraction(0)] * (2 * degree + 1)
    coefficients = kernel_coefficients(degree)
    for i, a in enumerate(coefficients):
        for k, b in enumerate(coefficients):
            square[i + k] += a * b
    # ∫_{−1}^0 ψ^k = (−1)^k / (k+1)
    return sum((Fraction((-1) ** k, k + 1) * value for k, value in enumerate(square)), Fraction(0))


def lag_coefficients(degree: int) -> list[Fraction]:
    """Return the coefficients of g(θ) = ∫_{−1}^θ w with w = −∫_{−1} Ω_1 and ς = 1, lowest power first.

    The window's velocity is ∫w(ψ) q̇(t+ψ) dψ with ∫w = 1, by parts. So g(θ) is the share of it older than −θ.
    """
    weight = [-value for value in _integral(kernel_coefficients(degree))]
    return _integral(weight)


def lag_area(degree: int) -> "flint.arb":
    """Return ∫_{−1}^0 |g| of `lag_coefficients` as a ball: 1/2, 32/81, 0.3879 for the degrees 1, 2, 3.

    The integral of g is monotone between the sign changes of g, so the area is the sum of its steps from root to
    root. The roots are isolated in balls. An additional point makes the sum no smaller.
    """
    import flint

    return _lag_area(degree, flint.ctx.prec)


@cache
def _lag_area(degree: int, precision: int) -> "flint.arb":
    """Return `lag_area` at the precision [bits] that is set, which is a key of the cache."""
    import flint

    del precision
    coefficients = lag_coefficients(degree)
    scale = np.lcm.reduce([value.denominator for value in coefficients])
    roots: Any = flint.fmpz_poly([int(value * int(scale)) for value in coefficients]).complex_roots()
    inside = [root.real for root, _ in roots if root.imag.contains(0) and not root.real < -1 and not root.real > 0]
    edges = [ball(-1), *sorted(inside, key=float), ball(0)]
    heights = [_evaluate(_integral(coefficients), edge) for edge in edges]
    return sum((abs(high - low) for low, high in pairwise(heights)), ball(0))


def _integral(coefficients: list[Fraction]) -> list[Fraction]:
    """Return the coefficients of a polynomial's integral from −1."""
    raised = [value / (k + 1) for k, value in enumerate(coefficients)]
    constant = -sum(((-1) ** (k + 1) * value for k, value in enumerate(raised)), Fraction(0))
    return [constant, *raised]


def _evaluate(coefficients: list[Fraction], point: "flint.arb") -> "flint.arb":
    """Return a polynomial's value at a ball."""
    value = ball(0)
    for coefficient in reversed(coefficients):
        value = value * point + ball(coefficient)
    return value
