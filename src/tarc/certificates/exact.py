"""Ball arithmetic: signs of forms decided with every rounding error enclosed, and the constants of the kernel exactly.

A float64 is a rational number, so stored matrices are an exact point, and a form evaluated there in balls (intervals
``midpoint ± radius``, which contain the true value whatever was rounded) has a provable sign or an undecided one.
A condition is written once, for an `Arithmetic`, and runs on floats and on balls alike.
"""

from collections.abc import Callable
from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import exp, factorial
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray

PRECISIONS = (160, 640)
"""Bits to try, in turn; the second only where balls of the first are too wide."""


class Arithmetic(NamedTuple):
    """What a condition is evaluated in: how numbers and matrices are taken in, inverses and exponentials."""

    number: Callable[[Any], Any]
    matrix: Callable[[Any], Array]
    inverse: Callable[[Array], Array]
    exp: Callable[[Any], Any]


def ball(value: Any) -> Any:
    """A float, whole number, `Fraction` or ball as a ball; floats and whole numbers without any width."""
    import flint

    if isinstance(value, Fraction):
        return flint.arb(flint.fmpq(value.numerator, value.denominator))
    return value if isinstance(value, flint.arb) else flint.arb(float(value))


def balls(matrix: Any) -> Array:
    """A matrix of floats as an object array of balls, which ``@``, ``+`` and `numpy.block` work on."""
    values = np.asarray(matrix)
    result = np.empty(values.shape, dtype=object)
    for place in np.ndindex(values.shape):
        result[place] = ball(values[place])
    return result


def inverse(matrix: Array) -> Array:
    """Inverse of a square matrix of balls.

    Raises
    ------
    ZeroDivisionError
        When the balls are too wide to show that it is regular.
    """
    import flint

    found = flint.arb_mat(len(matrix), len(matrix), list(np.ravel(matrix))).inv()
    return np.array(found.entries(), dtype=object).reshape(matrix.shape)


FLOATS = Arithmetic(float, np.array, np.linalg.inv, exp)
BALLS = Arithmetic(ball, balls, inverse, lambda value: ball(value).exp())


def positive(form: Array) -> bool:
    """Whether the form xᵀFx is proven positive definite: all pivots of an LDLᵀ factorisation are above zero.

    False means not proven, at this precision.
    """
    rest = (form + form.T) / 2
    while len(rest):
        pivot, column = rest[0, 0], rest[1:, 0]
        if not pivot > 0:
            return False
        rest = rest[1:, 1:] - np.outer(column, column) / pivot
    return True


def negative_at(form: Array, vector: Array) -> bool:
    """Whether xᵀFx < 0 is proven at a vector of floats. False means not proven, at this precision."""
    x = balls(vector)
    return bool(x @ form @ x < 0)


def prove(question: Callable[[], bool]) -> bool:
    """Ask in ball arithmetic, again with more bits where the answer is no; whether it was ever yes.

    The question must answer yes only where the balls prove it.
    """
    import flint

    for bits in PRECISIONS:
        with flint.ctx.workprec(bits):
            try:
                if question():
                    return True
            except ZeroDivisionError:  # an inverse of balls that may be singular
                continue
    return False


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
