"""Smoothing of recorded positions."""

from collections.abc import Callable

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array


def smoothing_curve(times: Array, positions: Array, cutoff: float) -> Callable[..., Array]:
    """Return the cubic smoothing spline through samples (k, n) whose gain at the cut-off is 1/√2.

    The spline f minimises Σ w (y − f)² + λ ∫ f″² dt. With θ = ω h and samples every h seconds, far from the ends, it
    is a filter without delay, of the gain

        |F/Y| = 1 / (1 + λ c(θ)/h³),    c(θ) = 6 (2 − 2 cos θ)² / (4 + 2 cos θ),    λ = (√2 − 1) h³ / c(2π cutoff h)

    It falls with ω⁻⁴ beyond. Uneven samples have the weights w of their spacing.

    Parameters
    ----------
    times
        [s], increasing, shape (k,), five or more.
    positions
        [rad or m], shape (k, n).
    cutoff
        [Hz], below half the sampling frequency.

    Returns
    -------
    A function of times and the order of a derivative; values of shape (k, n).

    Raises
    ------
    InvalidParameter
        For a cut-off that is not between 0 and half the sampling frequency.

    References
    ----------
    B. W. Silverman, Annals of Statistics 12(3), 1984, for the equivalent kernel; C. Reinsch, Numerische Mathematik
    10, 1967, for the equations of the samples, of which c(θ) is the symbol.
    """
    from scipy.interpolate import make_smoothing_spline

    h = float(np.mean(np.diff(times)))
    if not 0 < check.number("cutoff", cutoff) < 0.5 / h:
        raise InvalidParameter(
            f"cutoff: got {cutoff:g} Hz; the record has a sample every {h:.4g} s, so that a number above 0 and below "
            f"{0.5 / h:.4g} Hz is needed",
            "cutoff",
        )
    smoothness = (np.sqrt(2) - 1) * h**3 / _penalty(2 * np.pi * cutoff * h)
    weights = np.gradient(times) / h
    splines = [make_smoothing_spline(times, column, weights, smoothness) for column in positions.T]

    def curve(at: Array, order: int = 0) -> Array:
        return np.stack([spline(at, order) for spline in splines], axis=-1)

    return curve


def _penalty(theta: float) -> float:
    """Return c(θ)."""
    cosine = np.cos(theta)
    return float(6 * (2 - 2 * cosine) ** 2 / (4 + 2 * cosine))
