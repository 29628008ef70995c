"""Types that tell what a function takes."""

import casadi as ca
import numpy as np

Array = np.ndarray
"""Numbers only."""

Vector = np.ndarray | ca.SX | ca.MX
"""Numbers or symbols: what the step of a system computes with."""
