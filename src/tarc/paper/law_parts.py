"""Parts of a law that the conditions of the paper share: its gains, delay and window, split where joints decouple."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import UnsupportedLaw
from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic
from tarc.laws.base import Law
from tarc.laws.tde import TDE
from tarc.numerics.sdp import symmetric


@dataclass(frozen=True, kw_only=True, eq=False)
class GainPart:
    """Gains of joints that are independent of all others.

    Attributes
    ----------
    K1, K2
        Position and velocity gain, each (n, n) [1/s², 1/s].
    """

    K1: Array
    K2: Array

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(np.atleast_1d(self.K1))

    def has_gain_shapes(self) -> bool:
        """Return whether K1 and K2 are (n, n)."""
        n = self.n_joints
        return self.K1.shape == self.K2.shape == (n, n)


def are_symmetric(size: int, *matrices: Array) -> bool:
    """Return whether all matrices are (size, size) and symmetric to the last bit."""
    return all(matrix.shape == (size, size) and np.array_equal(matrix, matrix.T) for matrix in matrices)


def require_tde(law: Law) -> TDE:
    """Return the law, which must use time-delay estimation.

    Raises
    ------
    UnsupportedLaw
        For any other law.
    """
    if not isinstance(law, TDE):
        raise UnsupportedLaw(
            f"law: got {type(law).__name__}; needs a law on time-delay estimation, such as tarc.laws.TDC"
        )
    return law


def require_algebraic(law: TDE) -> Algebraic:
    """Return the law's estimator, which must have a kernel Ω_j.

    Raises
    ------
    UnsupportedLaw
        For a law with any other estimator.
    """
    estimator = law.estimator
    if not isinstance(estimator, Algebraic):
        raise UnsupportedLaw(
            f"law: its estimator is {type(estimator).__name__}; this certificate is about the kernel of "
            "tarc.estimators.Algebraic, so give the law that one"
        )
    return estimator


def delay_or_default(law: TDE, delay: float | None) -> float:
    """Return the delay h [s], by default that of the law.

    Raises
    ------
    InvalidParameter
        For a delay that is not positive.
    """
    return law.delay_periods * law.period if delay is None else check.number("delay", delay, 0, strict=True)


def window_or_default(estimator: Algebraic, window: float | None) -> float:
    """Return the window ς [s], by default that of the estimator.

    Raises
    ------
    InvalidParameter
        For a window that is not positive.
    """
    return estimator.window if window is None else check.number("window", window, 0, strict=True)


def independent_parts(law: TDE, *weights: Array) -> list[tuple[Array, ...]]:
    """Split gains and weights into parts without any coupling, equal parts once.

    Two joints belong to one part where an entry of K1, K2 or a weight couples them. To split loses nothing. Take a
    matrix inequality that is linear in its unknowns and invariant under a group of rotations. If it holds at all, it
    holds for the group's average. Diagonal gains are invariant under a change of any joint's sign, so the average has
    no block between different joints. Scalar gains are invariant under every rotation of the joints, so it is p ⊗ I.

    Parameters
    ----------
    law
        The law with K1 and K2.
    weights
        Each (2n, 2n), for (e1, ė1).

    Returns
    -------
    list
        Per part the tuple (K1, K2, *weights), each restricted to the part's joints.
    """
    from scipy.sparse.csgraph import connected_components

    n = law.n_joints
    coupled = (law.K1 != 0) | (law.K2 != 0)
    for weight in weights:
        coupled |= np.any(weight.reshape(2, n, 2, n) != 0, axis=(0, 2))
    count, owner = connected_components(coupled)
    parts: dict[bytes, tuple[Array, ...]] = {}
    for i in range(count):
        joints = np.flatnonzero(owner == i)
        states = np.concatenate([joints, n + joints])
        part = (
            *(gain[np.ix_(joints, joints)] for gain in (law.K1, law.K2)),
            *(weight[np.ix_(states, states)] for weight in weights),
        )
        parts.setdefault(b"".join(block.tobytes() for block in part), part)
    return list(parts.values())


def time_scale(K1: Array) -> float:
    """Return det(K1)^(1/2n) [1/s], a natural frequency to scale time by, so that the solver's numbers are near one."""
    return float(np.exp(np.linalg.slogdet(K1)[1] / (2 * len(K1))))


def time_transformation(n: int, omega: float) -> Array:
    """Return T of e = T e′, (2n, 2n), from the error in scaled time, e1 and de1/d(ωt), to e1 and ė1."""
    return np.diag(np.concatenate([np.ones(n), np.full(n, omega)]))


def companion(K1: Array, K2: Array) -> tuple[Array, Array]:
    """Return A1 = [0 I; 0 0] and B1 = [0 0; −K1 −K2], of floats or of balls."""
    zero = np.zeros_like(K1)
    identity = zero + np.eye(len(K1), dtype=int)
    return np.block([[zero, identity], [zero, zero]]), np.block([[zero, zero], [-K1, -K2]])


def lyapunov(K1: Array, K2: Array, Q: Array) -> Array:
    """Return the P of AᵀP + PA = −Q with A = A1 + B1."""
    from scipy.linalg import solve_continuous_lyapunov

    A1, B1 = companion(K1, K2)
    return symmetric(solve_continuous_lyapunov((A1 + B1).T, -Q))


def largest_certified(limit: float, is_certified: Callable[[float], bool]) -> float:
    """Return the largest value slightly below a limit that is certified in ball arithmetic; 0.0 for none.

    Parameters
    ----------
    limit
        Limit that floating point found.
    is_certified
        Whether a value is certified.
    """
    for reduction in (1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
        value = limit * (1 - reduction)
        if value > 0 and is_certified(value):
            return float(value)
    return 0.0
