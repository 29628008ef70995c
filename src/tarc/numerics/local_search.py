"""Local search for a maximum inside the unit cube."""

import warnings
from collections.abc import Callable

import numpy as np

from tarc.core.types import Array


def local_maximum(
    function: Callable[[Array], tuple[float, Array]],
    start: Array,
    *,
    scale: float,
    tolerance: float,
    max_iterations: int = 100,
) -> tuple[float, Array]:
    """Return a local maximum of a function on the unit cube, and its point.

    SLSQP is used. L-BFGS-B calls threaded LAPACK for each small step in scipy 1.17, which takes seconds where the cores
    are shared.

    Parameters
    ----------
    function
        Maps a point (d,) to its value and its gradient (d,).
    start
        First point, shape (d,).
    scale
        Size of the values, positive.
    tolerance
        Change of the scaled value at which the search ends.
    max_iterations
        Largest number of iterations.
    """
    from scipy.optimize import minimize

    def negated(point: Array) -> tuple[float, Array]:
        value, gradient = function(np.clip(point, 0, 1))
        return -value / scale, -gradient / scale

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Values in x were outside bounds")  # by rounding; they are clipped
        result = minimize(
            negated,
            start,
            jac=True,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(start),
            options={"ftol": tolerance, "maxiter": max_iterations},
        )
    return -float(result.fun) * scale, np.clip(result.x, 0, 1)
