"""Local search for a maximum inside the unit cube."""

import warnings
from collections.abc import Callable

import numpy as np

from tarc.core.types import Array


def local_maximum(
    values: Callable[[Array], Array],
    start: Array,
    *,
    step: float,
    scale: float,
    tolerance: float,
    max_iterations: int = 100,
) -> tuple[float, Array]:
    """Return a local maximum of a function on the unit cube, and its point.

    SLSQP is used, with gradients by differences towards the inside. L-BFGS-B calls threaded LAPACK for each small step
    in scipy 1.17, which takes seconds where the cores are shared.

    Parameters
    ----------
    values
        Maps points (k, d) to numbers (k,).
    start
        First point, shape (d,).
    step
        Step of the differences.
    scale
        Size of the values, positive.
    tolerance
        Change of the scaled value at which the search ends.
    max_iterations
        Largest number of iterations.
    """
    from scipy.optimize import minimize

    steps = step * np.concatenate([np.zeros((1, len(start))), np.eye(len(start))])

    def negated(point: Array) -> tuple[float, Array]:
        inward = np.where(point > 0.5, -1.0, 1.0)
        near = -values(point + steps * inward) / scale
        return float(near[0]), (near[1:] - near[0]) / (step * inward)

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
