"""Norms of discrete-time systems x⁺ = A x + B u, y = C x + D u."""

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array


def h2_norm(A: Array, B: Array, C: Array, D: Array) -> float:
    """Return the root mean square of y for white u of unit variance: tr(C X Cᵀ + D Dᵀ)^½ with X = A X Aᵀ + B Bᵀ.

    It is infinite for a system that is not stable.

    Raises
    ------
    InvalidParameter
        For matrices that are not finite or do not fit together.
    """
    return float(np.sqrt(np.trace(output_covariance(A, B, C, D))))


def output_covariance(A: Array, B: Array, C: Array, D: Array) -> Array:
    """Return the covariance of y for white u of unit variance: C X Cᵀ + D Dᵀ with X = A X Aᵀ + B Bᵀ.

    Its diagonal is infinite for a system that is not stable.

    Raises
    ------
    InvalidParameter
        For matrices that are not finite or do not fit together.
    """
    from scipy.linalg import solve_discrete_lyapunov

    A, B, C, D = _checked(A, B, C, D)
    if np.max(np.abs(np.linalg.eigvals(A)), initial=0.0) >= 1:
        return np.diag(np.full(len(C), np.inf))
    A, B, C = balance(A, B, C)
    X = solve_discrete_lyapunov(A, B @ B.T)
    return C @ X @ C.T + D @ D.T


def hinf_norm(A: Array, B: Array, C: Array, D: Array, tolerance: float = 1e-6) -> float:
    """Return the largest gain over frequency, to a relative tolerance, from above.

    By the method of Bruinsma and Steinbuch a level γ is an upper bound if the pencil of γ² I − G(1/z)ᵀ G(z) has no
    eigenvalue on the unit circle. Otherwise the frequencies between give a larger lower bound. The result is a level
    at which no eigenvalue near the circle belongs to a larger gain. It is infinite if none is found, as with poles
    within rounding of the circle, and for a system that is not stable.

    Raises
    ------
    InvalidParameter
        For matrices that are not finite or do not fit together.

    References
    ----------
    N. A. Bruinsma and M. Steinbuch, Systems & Control Letters 14(4), 1990.
    """
    A, B, C, D = _checked(A, B, C, D)
    A, B, C = balance(A, B, C)
    poles = np.linalg.eigvals(A)
    if np.max(np.abs(poles), initial=0.0) >= 1:
        return np.inf
    low = _peak_gain(A, B, C, D, poles)
    for _ in range(60):
        level = max((1 + 2 * tolerance) * low, 1e-300)
        better = float(np.max(max_singular_values(A, B, C, D, _critical_angles(A, B, C, D, level)), initial=0.0))
        if better <= level:
            return level
        low = better
    return np.inf


def _checked(*matrices: Array) -> tuple[Array, Array, Array, Array]:
    A, B, C, D = (check.array(name, matrix) for name, matrix in zip("ABCD", matrices, strict=True))
    fits = all(matrix.ndim == 2 for matrix in (A, B, C, D))
    fits = fits and A.shape[0] == A.shape[1] == B.shape[0] == C.shape[1] and D.shape == (C.shape[0], B.shape[1])
    if not fits:
        raise InvalidParameter(
            f"A, B, C, D: got shapes {A.shape}, {B.shape}, {C.shape}, {D.shape}; needs (m, m), (m, inputs), "
            "(outputs, m), (outputs, inputs)"
        )
    return A, B, C, D


def balance(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """Return the system in states scaled so that rows and columns of A have similar norms."""
    from scipy.linalg import matrix_balance

    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    return np.asarray(balanced), B / scale[:, None], C * scale


def max_singular_values(A: Array, B: Array, C: Array, D: Array, angles: Array) -> Array:
    """Return the largest singular value of G(e^{jω}) at each angle ω [rad]."""
    z = np.exp(1j * np.asarray(angles))[:, None, None]
    response = C @ np.linalg.solve(z * np.eye(len(A)) - A, B + 0 * z) + D
    return np.abs(response[:, 0, 0]) if response.shape[1:] == (1, 1) else np.linalg.norm(response, 2, axis=(1, 2))


def _peak_gain(A: Array, B: Array, C: Array, D: Array, poles: Array) -> float:
    """Return the largest gain on a grid of frequencies and at the poles, refined around its maximum."""
    angles = np.concatenate([[0.0], np.geomspace(1e-6, np.pi, 50), np.abs(np.angle(poles[np.abs(poles) > 0.5]))])
    angles = np.unique(angles)
    best = 0.0
    for _ in range(4):
        gains = max_singular_values(A, B, C, D, angles)
        top = int(np.argmax(gains))
        best = max(best, float(gains[top]))
        angles = np.linspace(angles[max(top - 1, 0)], angles[min(top + 1, len(angles) - 1)], 13)
    return best


def _critical_angles(A: Array, B: Array, C: Array, D: Array, level: float) -> Array:
    """Return angles in [0, π] at which the gain may exceed a level: where it crosses the level, and between.

    To keep rounding small the level is scaled to one.
    """
    root = np.sqrt(level)
    B, C, D = B / root, C / root, D / level
    return _crossings(A, B, C.T @ C, C.T @ D, D.T @ D - np.eye(B.shape[1]))


def _crossings(A: Array, B: Array, Q: Array, S: Array, R: Array) -> Array:
    """Return angles at which the form of `fdi_negative` is singular, and between.

    They are eigenvalues of a pencil on the unit circle. Those that rounding may have moved off it are kept: one too
    many costs time, one too few gives a wrong bound.
    """
    from scipy.linalg import eigvals

    m, n = B.shape
    # (zI − A) x = B u;  (I − z Aᵀ) p = z (Q x + S u);  0 = Bᵀ p + Sᵀ x + R u
    x, p, u = slice(m), slice(m, 2 * m), slice(2 * m, 2 * m + n)
    left, right = np.zeros((2 * m + n,) * 2), np.zeros((2 * m + n,) * 2)
    left[x, x], left[p, x], left[p, p], left[p, u] = np.eye(m), Q, A.T, S
    right[x, x], right[x, u], right[p, p] = A, B, np.eye(m)
    right[u, x], right[u, p], right[u, u] = S.T, B.T, R
    z = np.asarray(eigvals(right, left))
    angles = np.unique(np.abs(np.angle(z[np.isfinite(z) & (np.abs(np.abs(z) - 1) < 1e-2)])))
    return np.concatenate([angles, (angles[1:] + angles[:-1]) / 2])


def fdi_negative(A: Array, B: Array, Q: Array, S: Array, R: Array) -> bool:
    """Return whether the frequency-domain inequality of a quadratic form holds.

        [x; u]ᴴ [Q S; Sᵀ R] [x; u] < 0  for all x = (e^{jω} I − A)⁻¹ B u, u ≠ 0, and all ω

    By the lemma of Kalman, Yakubovich and Popov that is dissipativity. The form can change its sign only where it is
    singular. So it is evaluated there, between, at the poles, and on a grid. False for an A that is not stable.

    Raises
    ------
    InvalidParameter
        For matrices that are not finite.

    References
    ----------
    A. Rantzer, Systems & Control Letters 28(1), 1996.
    """
    A, B, Q, S, R = (check.array(name, matrix) for name, matrix in zip("ABQSR", (A, B, Q, S, R), strict=True))
    poles = np.linalg.eigvals(A)
    if np.max(np.abs(poles), initial=0.0) >= 1:
        return False
    from scipy.linalg import matrix_balance

    A, (scale, _) = matrix_balance(A, permute=False, separate=True)
    B, Q, S = B / scale[:, None], Q * scale * scale[:, None], S * scale[:, None]
    grid = np.concatenate([[0.0], np.geomspace(1e-6, np.pi, 50), np.abs(np.angle(poles[np.abs(poles) > 0.5]))])
    return bool(np.max(fdi_max_eigenvalue(A, B, Q, S, R, np.concatenate([grid, _crossings(A, B, Q, S, R)]))) < 0)


def fdi_max_eigenvalue(A: Array, B: Array, Q: Array, S: Array, R: Array, angles: Array) -> Array:
    """Return the largest eigenvalue of the form of `fdi_negative` at each angle ω [rad]."""
    z = np.exp(1j * np.asarray(angles))[:, None, None]
    x = np.linalg.solve(z * np.eye(len(A)) - A, B + 0 * z)
    adjoint = x.conj().transpose(0, 2, 1)
    mixed = adjoint @ S
    return np.linalg.eigvalsh(adjoint @ Q @ x + mixed + mixed.conj().transpose(0, 2, 1) + R)[:, -1]
