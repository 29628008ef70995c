"""Operations that mean the same on NumPy arrays and on CasADi symbols.

Laws, estimators and sensors are written once with Python operators and these functions; NumPy runs them as they stand,
CasADi traces them. Vectors have shape (n,) in NumPy and n-by-1 in CasADi. A history keeps one column per sample, newest
first. Every product is then matrix times vector in both.

Python's ``if``, ``and``, ``or``, ``not``, ``min`` and ``max`` cannot decide on a symbol. Write `where`, `logical_and`,
`logical_or`, `logical_not`, `minimum` and `maximum`. Functions of the module ``math`` give NaN for one.
"""

import hashlib

import casadi as ca
import numpy as np

from tarc.core.types import Vector

WIDE = 32
"""Samples in a window from which `weighted_sum` is a call where it is traced."""

HUGE = 1e100
"""Magnitude above which a number counts as not finite: its square still is."""


def symbolic(*values: Vector) -> bool:
    """Return whether any of the values is a CasADi matrix."""
    return any(isinstance(value, ca.SX | ca.MX | ca.DM) for value in values)


def where(condition: Vector, yes: Vector, no: Vector) -> Vector:
    """Return ``yes`` where the condition holds, else ``no``, element by element; a NaN not chosen does no harm."""
    return ca.if_else(condition, yes, no) if symbolic(condition, yes, no) else np.where(condition, yes, no)


def where_or_zero(condition: Vector, x: Vector) -> Vector:
    """Return ``x`` where the condition holds, else zero, element by element; a NaN not chosen does no harm."""
    return ca.if_else(condition, x, 0) if symbolic(condition, x) else np.where(condition, x, 0.0)


def finite(x: Vector) -> Vector:
    """Return, element by element, whether x is a number of magnitude at most `HUGE` (so neither NaN nor infinite)."""
    return ca.fabs(x) <= HUGE if symbolic(x) else np.abs(x) <= HUGE


def all_finite(*vectors: Vector) -> Vector:
    """Return whether all elements are numbers and the sum of their magnitudes is at most `HUGE`."""
    return sum(ca.norm_1(x) if symbolic(x) else np.sum(np.abs(x)) for x in vectors) <= HUGE


def logical_and(x: Vector, y: Vector) -> Vector:
    """Return the logical and, element by element."""
    return ca.logic_and(x, y) if symbolic(x, y) else np.logical_and(x, y)


def logical_or(x: Vector, y: Vector) -> Vector:
    """Return the logical or, element by element."""
    return ca.logic_or(x, y) if symbolic(x, y) else np.logical_or(x, y)


def logical_not(x: Vector) -> Vector:
    """Return the logical not, element by element."""
    return ca.logic_not(x) if symbolic(x) else np.logical_not(x)


def maximum(x: Vector, y: Vector) -> Vector:
    """Return the larger of the two, element by element."""
    return ca.fmax(x, y) if symbolic(x, y) else np.maximum(x, y)


def minimum(x: Vector, y: Vector) -> Vector:
    """Return the smaller of the two, element by element."""
    return ca.fmin(x, y) if symbolic(x, y) else np.minimum(x, y)


def sign(x: Vector) -> Vector:
    """Return −1, 0 or 1, element by element."""
    return ca.sign(x) if symbolic(x) else np.sign(x)


def abs(x: Vector) -> Vector:
    """Return |x|, element by element."""
    return ca.fabs(x) if symbolic(x) else np.abs(x)


def clip(x: Vector, low: Vector, high: Vector) -> Vector:
    """Limit x to [low, high], element by element."""
    return ca.fmin(ca.fmax(x, low), high) if symbolic(x, low, high) else np.clip(x, low, high)


def floor(x: Vector) -> Vector:
    """Return the largest integer not above x."""
    return ca.floor(x) if symbolic(x) else np.floor(x)


def exp(x: Vector) -> Vector:
    """Return the exponential, element by element."""
    return ca.exp(x) if symbolic(x) else np.exp(x)


def sqrt(x: Vector) -> Vector:
    """Return the square root, element by element."""
    return ca.sqrt(x) if symbolic(x) else np.sqrt(x)


def log(x: Vector) -> Vector:
    """Return the natural logarithm, element by element."""
    return ca.log(x) if symbolic(x) else np.log(x)


def sin(x: Vector) -> Vector:
    """Return the sine [rad], element by element."""
    return ca.sin(x) if symbolic(x) else np.sin(x)


def cos(x: Vector) -> Vector:
    """Return the cosine [rad], element by element."""
    return ca.cos(x) if symbolic(x) else np.cos(x)


def tan(x: Vector) -> Vector:
    """Return the tangent [rad], element by element."""
    return ca.tan(x) if symbolic(x) else np.tan(x)


def arcsin(x: Vector) -> Vector:
    """Return the inverse sine [rad], element by element."""
    return ca.asin(x) if symbolic(x) else np.arcsin(x)


def arccos(x: Vector) -> Vector:
    """Return the inverse cosine [rad], element by element."""
    return ca.acos(x) if symbolic(x) else np.arccos(x)


def arctan(x: Vector) -> Vector:
    """Return the inverse tangent [rad], element by element."""
    return ca.atan(x) if symbolic(x) else np.arctan(x)


def sinh(x: Vector) -> Vector:
    """Return the hyperbolic sine, element by element."""
    return ca.sinh(x) if symbolic(x) else np.sinh(x)


def cosh(x: Vector) -> Vector:
    """Return the hyperbolic cosine, element by element."""
    return ca.cosh(x) if symbolic(x) else np.cosh(x)


def tanh(x: Vector) -> Vector:
    """Return the hyperbolic tangent, element by element."""
    return ca.tanh(x) if symbolic(x) else np.tanh(x)


def arctan2(y: Vector, x: Vector) -> Vector:
    """Return the angle of the point (x, y) [rad], element by element."""
    return ca.atan2(y, x) if symbolic(y, x) else np.arctan2(y, x)


def dot(x: Vector, y: Vector) -> Vector:
    """Return the inner product xᵀy."""
    return ca.dot(x, y) if symbolic(x, y) else x @ y


def norm(x: Vector, least: Vector | float = 0.0) -> Vector:
    """Return the Euclidean norm, not below ``least``; differentiable at x = 0 when ``least`` > 0."""
    squares = ca.sumsqr(x) if symbolic(x) else np.sum(np.square(x))
    if symbolic(least) or least > 0:
        squares = maximum(squares, least**2)
    return sqrt(squares)


def power(x: Vector, exponent: float, layer: float) -> Vector:
    """Return |x|^a sgn x for an exponent a > 0, smoothed: x (x² + ε²)^((a−1)/2), element by element.

    Within the layer ε > 0 it is close to the line x ε^(a−1), whose slope is finite for a < 1 and not zero for a > 1.
    Far outside it is the power itself.
    """
    return x * (x**2 + layer**2) ** ((exponent - 1) / 2)


def power_slope(x: Vector, exponent: float, layer: float) -> Vector:
    """Return the derivative of `power`, above zero: (x² + ε²)^((a−3)/2) (a x² + ε²)."""
    return (x**2 + layer**2) ** ((exponent - 3) / 2) * (exponent * x**2 + layer**2)


def weighted_sum(window: Vector, weights: Vector) -> Vector:
    """Multiply a window (n, N) by weights (N, j).

    A wide window is one call in the traced scalar graph instead of 2nNj operations of a nanosecond each, unless the
    weights are symbols too.
    """
    if isinstance(window, ca.SX) and window.numel() > WIDE and not isinstance(weights, ca.SX):
        samples = ca.MX.sym("samples", *window.shape)
        digest = hashlib.sha256(repr((window.shape, np.asarray(weights).tolist())).encode()).hexdigest()[:12]
        return ca.Function(f"weighted_sum_{digest}", [samples], [samples @ weights], {"never_inline": True})(window)
    return window @ weights


def solve(matrix: Vector, right: Vector) -> Vector:
    """Return A⁻¹ b for a symmetric positive definite A (n, n) and a vector b (n,)."""
    if isinstance(matrix, ca.MX) or isinstance(right, ca.MX):
        return ca.solve(ca.MX(matrix), ca.MX(right), "ldl")
    if symbolic(matrix, right):
        D, L, order = ca.ldl(ca.densify(ca.SX(matrix)))
        return ca.ldl_solve(ca.SX(right), D, L, order)
    return np.linalg.solve(matrix, right)


def columns(*vectors: Vector) -> Vector:
    """Stack vectors (n,) as columns, shape (n, k)."""
    return ca.horzcat(*vectors) if symbolic(*vectors) else np.stack(vectors, axis=1)


def append_first(history: Vector, sample: Vector) -> Vector:
    """Put a new sample before the first column of the history and keep all columns."""
    if symbolic(history, sample):
        return ca.horzcat(sample, history)
    return np.concatenate([np.reshape(sample, (-1, 1)), history], axis=1)


def pick_columns(history: Vector, numbers: np.ndarray) -> Vector:
    """Return from each row of a history the element in a column of its own, shape (n,), by the columns' numbers."""
    if np.all(numbers == numbers[0]):
        return history[:, int(numbers[0])]
    if symbolic(history):
        return ca.vertcat(*[history[row, int(number)] for row, number in enumerate(numbers)])
    return history[np.arange(len(numbers)), numbers]


def shift_in(history: Vector, sample: Vector) -> Vector:
    """Put a new sample before the first column of the history and drop the last column."""
    if symbolic(history, sample):
        return ca.horzcat(sample, history[:, :-1])
    return np.concatenate([np.reshape(sample, (-1, 1)), history[:, :-1]], axis=1)
