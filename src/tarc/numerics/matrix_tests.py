"""Tests of a matrix with a verdict: positive definite, Schur stable."""

import warnings

import numpy as np

from tarc.core.optional import require
from tarc.core.types import Array


def definiteness(form: Array) -> tuple[str, float, Array]:
    """Return whether a symmetric matrix is positive definite, its least eigenvalue, and its eigenvector.

    The verdict is ``certified`` or ``refuted`` if rounding of the eigenvalues cannot change the sign. Otherwise, and
    for a matrix that is not finite, it is ``inconclusive``. Rounding in the entries of the matrix is not covered.
    """
    if not np.all(np.isfinite(form)):
        return "inconclusive", float("nan"), np.zeros(len(form))
    values, vectors = np.linalg.eigh((form + form.T) / 2)
    rounding = 10 * len(form) * np.finfo(float).eps * max(float(np.max(np.abs(values))), 1e-300)
    verdict = "certified" if values[0] > rounding else "refuted" if values[0] < -rounding else "inconclusive"
    return verdict, float(values[0]), vectors[:, 0]


MAX_SQUARINGS = 16
"""Squarings after which a matrix is left to its eigenvalues."""
SMALL, LARGE = 0.5, 1e6
"""Norms of a power that end the squarings: below, its eigenvalues are small; above, its rounding is not."""


def powers_vanish(A: Array) -> bool:
    """Return whether a power A^(2^k) is small, which puts the eigenvalues of A inside the unit circle; no proof.

    It is false also for some A with all of them inside. For a large A this is quicker than its eigenvalues.
    """
    for _ in range(MAX_SQUARINGS):
        A = A @ A
        norm = float(np.linalg.norm(A))
        if not SMALL <= norm <= LARGE:
            return norm < SMALL
    return False


def schur_stability(A: Array) -> tuple[str, float, complex]:
    """Return whether A is Schur stable, its spectral radius and its leading eigenvalue.

    It is certified if P − AᵀPA is positive definite beyond rounding, for the P > 0 of the discrete Lyapunov equation in
    balanced coordinates. It is refuted if an eigenvalue is outside the unit circle by more than its condition number
    explains. If neither holds, ball arithmetic encloses the eigenvalues. If that fails, it is inconclusive.
    """
    from scipy.linalg import matrix_balance

    balanced = np.asarray(matrix_balance(A, permute=False)[0])
    values, vectors = np.linalg.eig(balanced)
    leading = int(np.argmax(np.abs(values)))
    radius = float(np.abs(values[leading]))
    decided = _contracts(balanced) if radius < 1 else _grows(balanced, vectors, leading, radius)
    verdict = ("certified" if radius < 1 else "refuted") if decided else _verdict_by_enclosure(A)
    return verdict, radius, complex(values[leading])


def _contracts(A: Array) -> bool:
    """Return whether a Lyapunov function proves A stable beyond rounding."""
    from scipy.linalg import solve_discrete_lyapunov

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # near the edge the solver perturbs; its P is tested below
            P = solve_discrete_lyapunov(A.T, np.eye(len(A)))
    except np.linalg.LinAlgError:
        return False
    P = (P + P.T) / 2
    drop = P - A.T @ P @ A
    rounding = 10 * len(A) * np.finfo(float).eps * np.linalg.norm(P, 2) * (1 + np.linalg.norm(A, 2) ** 2)
    return bool(np.linalg.eigvalsh(P)[0] > rounding and np.linalg.eigvalsh((drop + drop.T) / 2)[0] > rounding)


def _grows(A: Array, vectors: Array, leading: int, radius: float) -> bool:
    """Return whether the leading eigenvalue is outside the unit circle beyond rounding."""
    try:
        left = np.linalg.inv(vectors)[leading]
    except np.linalg.LinAlgError:
        return False
    condition = np.linalg.norm(left) * np.linalg.norm(vectors[:, leading])
    return bool(radius - 1 > 10 * len(A) * np.finfo(float).eps * np.linalg.norm(A, 2) * condition)


MAX_ENCLOSED_STATES = 60
"""Number of states up to which eigenvalues are enclosed; the time grows with its cube."""


def _verdict_by_enclosure(A: Array) -> str:
    """Return the verdict from balls that enclose the eigenvalues of exactly this A."""
    require("certify", "a proof in ball arithmetic", "flint")
    import flint

    if len(A) > MAX_ENCLOSED_STATES:
        return "inconclusive"
    before = flint.ctx.prec
    try:
        for precision in (128, 384):
            flint.ctx.prec = precision
            try:
                magnitudes = [abs(value) for value in flint.acb_mat(A.tolist()).eig(multiple=True)]
            except ValueError:  # not enclosed at this precision
                continue
            if all(magnitude < 1 for magnitude in magnitudes):
                return "certified"
            if any(magnitude > 1 for magnitude in magnitudes):
                return "refuted"
    finally:
        flint.ctx.prec = before
    return "inconclusive"
