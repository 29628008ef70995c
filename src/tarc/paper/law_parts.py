"""What the certificates by semidefinite programming share: parts that decouple, the solver, and a search upward.

No solver's word is proof: all that comes from here is a candidate, to be judged from its matrices.
"""

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic
from tarc.laws.base import Law
from tarc.laws.tde import TDE
from tarc.numerics.sdp import symmetric


def delayed(law: Law) -> TDE:
    """The law, which must be one on time-delay estimation.

    Raises
    ------
    TarcError
        For any other.
    """
    if not isinstance(law, TDE):
        raise TarcError(f"law: got {type(law).__name__}; needs a law on time-delay estimation, such as tarc.laws.TDC")
    return law


def delay_of(law: TDE, delay: float | None) -> float:
    """h [s]: the one given, else the law's own."""
    return law.delay_periods * law.period if delay is None else check.number("delay", delay, 0, strict=True)


def gains(law: TDE, *weights: Array) -> list[tuple[Array, ...]]:
    """The parts (K1, K2, *weights) of a law that do not touch each other, equal ones once.

    Joints belong together where an entry of K1, K2 or a weight couples them; weights are (2n, 2n), for (e1, ė1).
    That the rest may be taken apart loses nothing: a matrix inequality that is linear in its unknowns and invariant
    under a group of rotations holds for the average over the group if it holds at all. Diagonal gains are invariant
    under a change of any joint's sign, so that the average has no block between different joints. Scalar gains are
    invariant under every rotation of the joints, so that it is p ⊗ I with one p for all.
    """
    from scipy.sparse.csgraph import connected_components

    n = law.n_joints
    linked = (law.K1 != 0) | (law.K2 != 0)
    for weight in weights:
        linked |= np.any(weight.reshape(2, n, 2, n) != 0, axis=(0, 2))
    count, owner = connected_components(linked)
    parts: dict[bytes, tuple[Array, ...]] = {}
    for i in range(count):
        joints = np.flatnonzero(owner == i)
        both = np.concatenate([joints, n + joints])
        part = (
            *(K[np.ix_(joints, joints)] for K in (law.K1, law.K2)),
            *(weight[np.ix_(both, both)] for weight in weights),
        )
        parts.setdefault(b"".join(block.tobytes() for block in part), part)
    return list(parts.values())


def windowed(law: TDE) -> Algebraic:
    """The law's estimator, which must be the one with a kernel.

    Raises
    ------
    TarcError
        For any other, to which the theorems on Ω_j do not apply.
    """
    estimator = law.estimator
    if not isinstance(estimator, Algebraic):
        raise TarcError(
            f"law: its estimator is {type(estimator).__name__}; this certificate is about the kernel of "
            "tarc.estimators.Algebraic, so give the law that one"
        )
    return estimator


def rate(K1: Array) -> float:
    """A natural frequency [1/s] to measure time in: det(K1)^(1/2n), so that the solver sees numbers around one."""
    return float(np.exp(np.linalg.slogdet(K1)[1] / (2 * len(K1))))


def stretch(n: int, omega: float) -> Array:
    """The matrix T of e = T e′ from e1 and de1/d(ωt) to e1 and ė1, shape (2n, 2n)."""
    return np.diag(np.concatenate([np.ones(n), np.full(n, omega)]))


def companion(K1: Array, K2: Array) -> tuple[Array, Array]:
    """A1 = [0 I; 0 0] and B1 = [0 0; −K1 −K2], of floats or of balls."""
    none = np.zeros_like(K1)
    return np.block([[none, none + np.eye(len(K1), dtype=int)], [none, none]]), np.block([[none, none], [-K1, -K2]])


def lyapunov(K1: Array, K2: Array, Q: Array) -> Array:
    """P of AᵀP + PA = −Q, A = A1 + B1."""
    from scipy.linalg import solve_continuous_lyapunov

    A1, B1 = companion(K1, K2)
    return symmetric(solve_continuous_lyapunov((A1 + B1).T, -Q))


def gather(matrices: dict[str, Array], shapes: dict[str, tuple[int, int]]) -> list[tuple[Array, ...]]:
    """The stored matrices part by part, in the order of the names: (K1_0, K2_0, P_0, …), (K1_1, …).

    Shapes are in units of the part's number of joints. Empty when a matrix is missing, of another shape, or not
    symmetric though no gain: then nothing is proven.
    """
    count = sum(name.startswith("K1_") for name in matrices)
    parts = []
    for i in range(count):
        part = tuple(np.asarray(matrices.get(f"{name}_{i}", np.zeros(0))) for name in shapes)
        n = len(part[0])
        for block, (name, shape) in zip(part, shapes.items(), strict=True):
            if block.shape != (shape[0] * n, shape[1] * n):
                return []
            if not name.startswith("K") and not np.array_equal(block, block.T):
                return []
        parts.append(part)
    return parts


def store(parts: list[tuple[Array, ...]], names: tuple[str, ...]) -> dict[str, Array]:
    """The matrices of `gather`, named."""
    return {f"{name}_{i}": block for i, part in enumerate(parts) for name, block in zip(names, part, strict=False)}
