"""Lyapunov equation of the laws with s = BᵀP e."""

import numpy as np

from tarc.laws.pole_placement import PolePlacement


def solution(law: PolePlacement) -> np.ndarray:
    """Return P, shape (2n, 2n), of AᵀP + PA = −diag(K1 + K1ᵀ, 2 I).

    With scalar gains BᵀP = [I, I/(ζ ωn)], so that s = e1 + (v̂ − q̇ᵈ)/(ζ ωn) has the unit of e1.
    """
    from scipy.linalg import block_diag, solve_continuous_lyapunov

    P = solve_continuous_lyapunov(law.A.T, -block_diag(law.K1 + law.K1.T, 2 * np.eye(law.n_joints)))
    return (P + P.T) / 2
