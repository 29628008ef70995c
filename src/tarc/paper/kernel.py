"""Constants of the estimator's kernel, exactly."""

from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import factorial
from typing import Any

import numpy as np

from tarc.numerics.ball_arithmetic import ball


def kernel(degree: int, derivative: int = 1) -> list[Fraction]:
    """Coefficients, lowest first, of Ω_j on [−1, 0]: the kernel of `tarc.estimators.Algebraic` for ς = 1, exactly."""
    n, j = degree, derivative
    scale = Fraction(factorial(n + 1 + j), factorial(j) * factorial(n - j))
    return [
        scale * Fraction(factorial(n + 1 + k), (j + k + 1) * factorial(n - k) * factorial(k) ** 2) for k in range(n + 1)
    ]


def kernel_energy(degree: int) -> Fraction:
    """ς³ ∫Ω_1², exactly: 12, 192, 1200 for the degrees 1, 2, 3."""
    square = [Fraction(0)] * (2 * degree + 1)
    coefficients = kernel(degree)
    for i, a in enumerate(coefficients):
        for k, b in enumerate(coefficients):
            square[i + k] += a * b
    # ∫_{−1}^0 ψ^k = (−1)^k / (k+1)
    return sum((Fraction((-1) ** k, k + 1) * value for k, value in enumerate(square)), Fraction(0))


def lag(degree: int) -> list[Fraction]:
    """Coefficients of g(θ) = ∫_{−1}^θ w with w = −∫_{−1} Ω_1, ς = 1: how much of the velocity is older than −θ.

    The window's velocity is ∫w(ψ) q̇(t+ψ) dψ, by parts, and ∫w = 1.
    """
    weight = [-value for value in _primitive(kernel(degree))]
    return _primitive(weight)


def lag_area(degree: int) -> Any:
    """∫_{−1}^0 |g| of `lag` as a ball: 1/2, 32/81, 0.3879 for the degrees 1, 2, 3.

    The primitive of g is monotone between the sign changes of g, so the area is the sum of its steps from one root to
    the next; roots are isolated in balls, and a point too many makes the sum no smaller.
    """
    import flint

    return _lag_area(degree, flint.ctx.prec)


@cache
def _lag_area(degree: int, bits: int) -> Any:
    """`lag_area` at the precision that is set, which the cache must know."""
    import flint

    del bits
    coefficients = lag(degree)
    scale = np.lcm.reduce([value.denominator for value in coefficients])
    roots: Any = flint.fmpz_poly([int(value * int(scale)) for value in coefficients]).complex_roots()
    inside = [root.real for root, _ in roots if root.imag.contains(0) and not root.real < -1 and not root.real > 0]
    edges = [ball(-1), *sorted(inside, key=float), ball(0)]
    heights = [_at(_primitive(coefficients), edge) for edge in edges]
    return sum((abs(high - low) for low, high in pairwise(heights)), ball(0))


def _primitive(coefficients: list[Fraction]) -> list[Fraction]:
    """The polynomial's integral from −1."""
    raised = [value / (k + 1) for k, value in enumerate(coefficients)]
    start = -sum(((-1) ** (k + 1) * value for k, value in enumerate(raised)), Fraction(0))
    return [start, *raised]


def _at(coefficients: list[Fraction], point: Any) -> Any:
    value = ball(0)
    for coefficient in reversed(coefficients):
        value = value * point + ball(coefficient)
    return value
