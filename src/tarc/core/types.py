"""Types of numbers and symbols."""

from typing import Any, TypeAlias

import numpy as np

Array = np.ndarray
"""Numbers only."""

Vector: TypeAlias = Any
"""A NumPy array, or an SX or MX matrix of CasADi: what the step of a system computes with.

No union or protocol of the three: CasADi ships no types of its operators, and a type checker accepts no pair of them.
"""

Tree: TypeAlias = Any
"""A `Vector`, or a nested NamedTuple, tuple or dictionary of them: state, input or output of a system.

No protocol: each kind of system has its own, and a type checker takes no NamedTuple for a recursive union.
"""
