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
