"""Cases that `make test` leaves out, of tests whose quick cases it runs."""

from typing import Any

import pytest


def slow(*values: Any) -> Any:
    """Return one case of a parametrised test or fixture, marked slow."""
    return pytest.param(*values, marks=pytest.mark.slow)
