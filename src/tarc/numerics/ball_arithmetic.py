"""Ball arithmetic: signs of forms decided with every rounding error enclosed, and the constants of the kernel exactly.

A float64 is a rational number, so stored matrices are an exact point, and a form evaluated there in balls (intervals
``midpoint ± radius``, which contain the true value whatever was rounded) has a provable sign or an undecided one.
A condition is written once, for an `Arithmetic`, and runs on floats and on balls alike.
"""

from collections.abc import Callable
from fractions import Fraction
from math import exp
from typing import Any, NamedTuple

import numpy as np

from tarc.core.types import Array

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


def is_positive_definite(form: Array) -> bool:
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


def is_negative_at(form: Array, vector: Array) -> bool:
    """Whether xᵀFx < 0 is proven at a vector of floats. False means not proven, at this precision."""
    x = balls(vector)
    return bool(x @ form @ x < 0)


def decide(question: Callable[[], bool]) -> bool:
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
