"""Semidefinite programs: the solver, and searches over its candidates."""

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.core.types import Array

if TYPE_CHECKING:
    import cvxpy as cp


def symmetric(matrix: Array) -> Array:
    """(M + Mᵀ)/2, symmetric to the last bit."""
    return (matrix + matrix.T) / 2


def solve(problem: "cp.Problem", *wanted: Any) -> list[Array] | None:
    """Values of the wanted expressions, symmetric where square, or None for any failure of the solver."""
    import cvxpy as cp

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate solution is judged like any other
        try:
            problem.solve(solver=cp.CLARABEL)
        except Exception:  # whatever a solver may raise, it is no answer
            return None
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        return None
    values = [np.asarray(one.value, dtype=float) for one in wanted]
    if not all(np.all(np.isfinite(value)) for value in values):
        return None
    return [symmetric(value) if value.ndim == 2 else value for value in values]


def longest(candidate: Callable[[float], Any], reach: Callable[[Any], float], start: float) -> float:
    """The largest x for which a candidate holds, to 10⁻⁷: bisection, in which a point counts for as far as it reaches.

    The lower end is always reached by a point that was found, so that no solver's status decides; where a solver fails
    the answer is but smaller. 0.0 for none.
    """

    def tried(x: float) -> float:
        point = candidate(x)
        return 0.0 if point is None else reach(point)

    low = tried(start)
    high = 2 * low
    while low > 0 and (further := tried(high)) >= high:
        low, high = further, 2 * further
    while high - low > 1e-7 * high:
        middle = (low + high) / 2
        further = tried(middle)
        low, high = max(low, further), high if further >= middle else middle
    return low


def furthest(holds: Callable[[float], bool], low: float, high: float) -> float:
    """The largest x in [low, high], nearly, up to which a condition holds that once lost stays lost; 0.0 for none."""
    if not holds(low):
        return 0.0
    while high - low > 1e-10 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def least(form: Array) -> tuple[float, Array]:
    """Least eigenvalue of a form once its diagonal is scaled to ±1, and the direction, in the form's own units.

    Without units and the same in any unit of time; its sign is the form's.
    """
    form = symmetric(form)
    size = np.sqrt(np.abs(np.diag(form)))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(form / np.outer(size, size))
    direction = vectors[:, 0] / size
    return float(values[0]), direction / np.linalg.norm(direction)
