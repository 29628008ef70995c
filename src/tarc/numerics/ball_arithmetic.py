"""Ball arithmetic: signs of quadratic forms decided with every rounding error enclosed.

A float64 is a rational number, so stored matrices are exact. A form is evaluated there in balls, intervals
``midpoint ± radius`` that contain the true value. Its sign is then proven or undecided. A condition is written once for
an `Arithmetic`, and runs on floats as well as on balls.
"""

from collections.abc import Callable
from fractions import Fraction
from math import exp
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from tarc.core.types import Array

if TYPE_CHECKING:
    import flint

Number: TypeAlias = "float | int | Fraction | flint.arb"
"""A float, an integer, a fraction or a ball."""

PRECISIONS = (160, 640)
"""Precisions to try in turn [bits]; the second only where balls of the first are too wide."""


class Arithmetic(NamedTuple):
    """The number type in which a condition is evaluated.

    Attributes
    ----------
    number, matrix
        Convert a number and a matrix of floats.
    inverse, exp
        Inverse of a square matrix, and exponential of a number.
    """

    number: Callable[[Number], Any]
    matrix: Callable[[Array], Array]
    inverse: Callable[[Array], Array]
    exp: Callable[[Number], Any]


def ball(value: Number) -> "flint.arb":
    """Return a float, integer, `Fraction` or ball as a ball; floats and integers become exact balls."""
    import flint

    if isinstance(value, Fraction):
        return flint.arb(flint.fmpq(value.numerator, value.denominator))
    return value if isinstance(value, flint.arb) else flint.arb(float(value))


def balls(matrix: Array) -> Array:
    """Return a matrix of floats as an object array of balls, for ``@``, ``+`` and `numpy.block`."""
    values = np.asarray(matrix)
    result = np.empty(values.shape, dtype=object)
    for index, value in np.ndenumerate(values):
        result[index] = ball(value)
    return result


def inverse(matrix: Array) -> Array:
    """Return the inverse of a square matrix of balls.

    Raises
    ------
    ZeroDivisionError
        When the balls are too wide to prove that it is regular.
    """
    import flint

    result = flint.arb_mat(len(matrix), len(matrix), list(np.ravel(matrix))).inv()
    return np.array(result.entries(), dtype=object).reshape(matrix.shape)


FLOATS = Arithmetic(float, np.array, np.linalg.inv, exp)
BALLS = Arithmetic(ball, balls, inverse, lambda value: ball(value).exp())


def is_positive_definite(form: Array) -> bool:
    """Return whether xᵀFx is proven positive definite: all pivots of an LDLᵀ factorisation are above zero.

    False means not proven at this precision.
    """
    remaining = (form + form.T) / 2
    while len(remaining):
        pivot, column = remaining[0, 0], remaining[1:, 0]
        if not pivot > 0:
            return False
        remaining = remaining[1:, 1:] - np.outer(column, column) / pivot
    return True


def is_negative_at(form: Array, vector: Array) -> bool:
    """Return whether xᵀFx < 0 is proven at a vector of floats; False means not proven at this precision."""
    x = balls(vector)
    return bool(x @ form @ x < 0)


def decide(is_proven: Callable[[], bool]) -> bool:
    """Return whether a proof in ball arithmetic succeeds at one of the `PRECISIONS`.

    Parameters
    ----------
    is_proven
        Returns true only where the balls prove the statement, at the precision that is set.
    """
    import flint

    for bits in PRECISIONS:
        with flint.ctx.workprec(bits):
            try:
                if is_proven():
                    return True
            except ZeroDivisionError:  # an inverse of balls that may be singular
                continue
    return False
