"""Types of numbers and symbols."""

from typing import Any, TypeAlias

import numpy as np

Array = np.ndarray
"""Numbers only."""

Vector: TypeAlias = Any
"""A NumPy array, or an SX or MX matrix of CasADi: what the step of a system computes with.

No union or protocol of the three: CasADi ships no types of its operators, and a type checker accepts no pair of them.
"""
