"""Semidefinite programs: the solver, and searches over its candidates."""

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from tarc.core.types import Array

if TYPE_CHECKING:
    import cvxpy as cp

T = TypeVar("T")


def symmetric(matrix: Array) -> Array:
    """Return (M + Mᵀ)/2, symmetric to the last bit."""
    return (matrix + matrix.T) / 2


def solve(problem: "cp.Problem", *expressions: "cp.Expression", **options: float) -> list[Array] | None:
    """Solve a semidefinite program.

    No status of the solver is a proof: the values are candidates, to be judged on their own.

    Parameters
    ----------
    problem
        The program.
    expressions
        Variables and expressions whose values are returned.
    options
        Of the solver Clarabel.

    Returns
    -------
    list or None
        One array per expression, matrices symmetric. None when the solver fails, and when the data are not finite.
    """
    import cvxpy as cp

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate solution is judged like any other
        try:
            problem.solve(solver=cp.CLARABEL, **options)
        except (cp.SolverError, ValueError):  # no convergence; data that overflow
            return None
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        return None
    values = [np.asarray(expression.value, dtype=float) for expression in expressions]
    if not all(np.all(np.isfinite(value)) for value in values):
        return None
    return [symmetric(value) if value.ndim == 2 else value for value in values]


def max_feasible(candidate: Callable[[float], T | None], max_valid: Callable[[T], float], start: float) -> float:
    """Return the largest x with a valid candidate, to a relative 10⁻⁷, by bisection.

    Each candidate counts up to the largest x for which it is valid, so that no solver's status decides. Where the
    solver fails, the result is only smaller.

    Parameters
    ----------
    candidate
        The solver's candidate at x; None for none.
    max_valid
        Largest x for which a candidate is valid.
    start
        First x to try.

    Returns
    -------
    float
        0.0 when the first candidate fails.
    """

    def reached(x: float) -> float:
        point = candidate(x)
        return 0.0 if point is None else max_valid(point)

    low = reached(start)
    high = 2 * low
    while low > 0 and (further := reached(high)) >= high:
        low, high = further, 2 * further
    while high - low > 1e-7 * high:
        middle = (low + high) / 2
        further = reached(middle)
        low, high = max(low, further), high if further >= middle else middle
    return low


def bisect(is_valid: Callable[[float], bool], low: float, high: float) -> float:
    """Return the largest x in [low, high], to a relative 10⁻¹⁰, up to which a condition holds; 0.0 for none.

    The condition must not hold again beyond the first x at which it fails.
    """
    if not is_valid(low):
        return 0.0
    while high - low > 1e-10 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if is_valid(middle) else (low, middle)
    return low


def min_scaled_eigenvalue(form: Array) -> tuple[float, Array]:
    """Return the least eigenvalue of a form with its diagonal scaled to ±1, and its direction in the form's units.

    The scaled eigenvalue has no unit, and does not depend on the unit of time. Its sign is that of the form.
    """
    form = symmetric(form)
    size = np.sqrt(np.abs(np.diag(form)))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(form / np.outer(size, size))
    direction = vectors[:, 0] / size
    return float(values[0]), direction / np.linalg.norm(direction)
