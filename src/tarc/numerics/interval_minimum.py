"""The least value of a function of one number in an interval."""

from collections.abc import Callable
from typing import Any


def minimise_in_interval(
    function: Callable[[float], float], low: float, high: float, tolerance: float = 1e-5
) -> tuple[float, float]:
    """Return where a function is least between two numbers, and its value there; a local minimum where it has several.

    Parameters
    ----------
    function
        The function.
    low, high
        Ends of the interval.
    tolerance
        Largest error of the place.

    References
    ----------
    R. P. Brent, Algorithms for Minimization Without Derivatives, Prentice-Hall, 1973; `scipy.optimize.minimize_scalar`.
    """
    from scipy.optimize import minimize_scalar

    result: Any = minimize_scalar(function, bounds=(low, high), method="bounded", options={"xatol": tolerance})
    return float(result.x), float(result.fun)
