"""Checks of user input: each returns the value as an array or number, or raises `InvalidParameter`."""

import difflib
from collections.abc import Iterable, Sequence
from typing import SupportsFloat, cast

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array

Numbers = float | Sequence[float] | np.ndarray
"""One number, or one per joint."""

Table = Sequence[Sequence[float]] | np.ndarray
"""Rows of numbers."""

Matrix = float | Sequence[float] | Sequence[Sequence[float]] | np.ndarray
"""One number (times identity), one per row (a diagonal), or the rows."""


def number(name: str, value: object, low: float = -np.inf, *, strict: bool = False, high: float = np.inf) -> float:
    """Return one finite number in [low, high], or above low if strict."""
    try:
        if isinstance(value, str | bytes):
            raise ValueError
        result = float(cast(SupportsFloat, value))
    except (TypeError, ValueError, OverflowError):
        raise InvalidParameter(f"{name}: got {value!r}; needs one number", name) from None
    above = result > low if strict else result >= low
    if not np.isfinite(result) or not above or result > high:
        bound = f" {'above' if strict else 'of at least'} {low:g}" if np.isfinite(low) else ""
        bound += f" and at most {high:g}" if np.isfinite(high) else ""
        raise InvalidParameter(f"{name}: got {result:g}; needs a finite number{bound}", name)
    return result


def integer(name: str, value: object, low: int = 0, high: int | None = None) -> int:
    """Return an integer in [low, high]."""
    limits = f"from {low} to {high}" if high is not None else f"of at least {low}"
    largest = np.inf if high is None else high
    if (
        not isinstance(value, int | float | np.integer)
        or isinstance(value, bool)
        or value % 1 != 0
        or not low <= value <= largest
    ):
        raise InvalidParameter(f"{name}: got {value!r}; needs a whole number {limits}", name)
    return int(value)


def float_array(name: str, value: object) -> Array:
    """Return numbers as a float array; infinities are allowed."""
    try:
        result = np.array(value, dtype=float)
        if not isinstance(value, str | bytes):
            return result
    except (TypeError, ValueError, OverflowError):
        pass
    raise InvalidParameter(f"{name}: got {value!r}; needs numbers", name)


def array(name: str, value: object) -> Array:
    """Return finite numbers as a float array."""
    result = float_array(name, value)
    finite = np.isfinite(result)
    if not finite.all():
        first = np.argwhere(~finite)[0]
        where = f" at {first.tolist()}" if result.ndim else ""
        raise InvalidParameter(
            f"{name}: got {result[tuple(first)]}{where}; needs finite numbers, not NaN or infinity", name
        )
    return result


def vector(name: str, value: object, size: int, low: float = -np.inf, *, strict: bool = False) -> Array:
    """Return a vector of the given size; one number stands for all its elements."""
    result = array(name, value)
    if result.ndim == 0:
        result = np.full(size, float(result))
    if result.shape != (size,):
        raise InvalidParameter(
            f"{name}: got shape {result.shape}; needs one number or {size} of them, one per joint", name
        )
    if np.any(result <= low if strict else result < low):
        raise InvalidParameter(
            f"{name}: got {result.tolist()}; each must be {'above' if strict else 'at least'} {low:g}", name
        )
    return result


def square(name: str, value: object, size: int) -> Array:
    """Return a matrix, given as one number (times identity), its diagonal, or all its rows."""
    result = array(name, value)
    if result.ndim < 2:
        result = np.diag(vector(name, result, size))
    if result.shape != (size, size):
        raise InvalidParameter(
            f"{name}: got shape {result.shape}; needs one number, {size} numbers or a {size} by {size} matrix"
        )
    return result


def positive_definite(name: str, value: object, size: int) -> Array:
    """Return a symmetric positive definite matrix, given as in `square`."""
    result = square(name, value, size)
    scale = np.max(np.abs(result))
    if not np.allclose(result, result.T, rtol=0, atol=1e-9 * scale):
        raise InvalidParameter(
            f"{name}: got {result.tolist()}, which is not symmetric; use its symmetric part (A + A.T) / 2 if it "
            "was meant to be"
        )
    result = (result + result.T) / 2
    least = float(np.linalg.eigvalsh(result)[0])
    if not least > 1e-12 * scale:
        raise InvalidParameter(
            f"{name}: its smallest eigenvalue is {least:.3g}; needs a positive definite matrix. Take the diagonal, "
            "or raise its small entries"
        )
    return result


def whole_periods(name: str, value: object, period: float) -> int:
    """Return a duration in periods, an integer of at least one."""
    duration = number(name, value, 0, strict=True)
    count = round(duration / period)
    if count < 1 or abs(duration / period - count) > 1e-6:
        nearest = max(count, 1) * period
        raise InvalidParameter(
            f"{name}: got {duration:g} s, which is no whole multiple of the period {period:g} s; "
            f"the nearest is {nearest:g} s"
        )
    return count


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """Return ' Did you mean ...?' for the closest choice, or the empty string."""
    choices = list(choices)
    lower = {choice.lower(): choice for choice in choices}
    close = difflib.get_close_matches(word.lower(), lower, n=1, cutoff=0.6)
    return f" Did you mean '{lower[close[0]]}'?" if close else ""


def one_of(name: str, value: str, choices: Iterable[str]) -> str:
    """Return a word if it is one of the choices."""
    choices = list(choices)
    if value not in choices:
        raise InvalidParameter(
            f"{name}: got {value!r}; known are {', '.join(choices)}.{did_you_mean(str(value), choices)}", name
        )
    return value
