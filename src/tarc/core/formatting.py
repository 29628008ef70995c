"""Numbers in messages and tables."""

from collections.abc import Iterable
from typing import SupportsFloat


def format_vector(values: Iterable[SupportsFloat], digits: int = 3) -> str:
    """Return numbers separated by commas, each rounded to a number of significant digits.

    Examples
    --------
    >>> format_vector([1.0, 0.25, 1234.5])
    '1, 0.25, 1.23e+03'
    """
    return ", ".join(f"{float(value):.{digits}g}" for value in values)


def format_per_joint(values: Iterable[SupportsFloat], digits: int = 4) -> str:
    """Return one number where all joints have the same, else as `format_vector`.

    Examples
    --------
    >>> format_per_joint([3.0, 3.0]), format_per_joint([3.0, 1.0])
    ('3', '3, 1')
    """
    numbers = [float(value) for value in values]
    return format_vector(numbers[:1] if len(set(numbers)) == 1 else numbers, digits)
