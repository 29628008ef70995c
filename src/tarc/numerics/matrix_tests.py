"""Tests of a matrix with a verdict: positive definite, Schur stable."""

import warnings

import numpy as np

from tarc.core.optional import require


def definiteness(form: np.ndarray) -> tuple[str, float, np.ndarray]:
    """Whether a symmetric matrix is positive definite, its least eigenvalue and that one's vector.

    ``certified`` or ``refuted`` only if rounding of the eigenvalues cannot turn the sign, else ``inconclusive``;
    ``inconclusive`` for a matrix that is not finite. Rounding in the entries of the form is not known here.
    """
    if not np.all(np.isfinite(form)):
        return "inconclusive", float("nan"), np.zeros(len(form))
    values, vectors = np.linalg.eigh((form + form.T) / 2)
    room = 10 * len(form) * np.finfo(float).eps * max(float(np.max(np.abs(values))), 1e-300)
    verdict = "certified" if values[0] > room else "refuted" if values[0] < -room else "inconclusive"
    return verdict, float(values[0]), vectors[:, 0]


def schur_stability(A: np.ndarray) -> tuple[str, float, complex]:
    """Whether A is Schur stable, its spectral radius and leading eigenvalue.

    Stable if P − AᵀPA is positive definite, by more than rounding can account for, for the P > 0 of the discrete
    Lyapunov equation in balanced coordinates; unstable if an eigenvalue is outside the circle by more than its
    condition can account for. Where neither is so, ball arithmetic encloses the eigenvalues. Else inconclusive.
    """
    from scipy.linalg import matrix_balance

    balanced = np.asarray(matrix_balance(A, permute=False)[0])
    values, vectors = np.linalg.eig(balanced)
    lead = int(np.argmax(np.abs(values)))
    radius = float(np.abs(values[lead]))
    quick = _contracts(balanced) if radius < 1 else _grows(balanced, vectors, lead, radius)
    verdict = ("certified" if radius < 1 else "refuted") if quick else _verdict_by_enclosure(A)
    return verdict, radius, complex(values[lead])


def _contracts(A: np.ndarray) -> bool:
    from scipy.linalg import solve_discrete_lyapunov

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # near the edge the solver perturbs; its P is judged below, not trusted
            P = solve_discrete_lyapunov(A.T, np.eye(len(A)))
    except np.linalg.LinAlgError:
        return False
    P = (P + P.T) / 2
    drop = P - A.T @ P @ A
    rounding = 10 * len(A) * np.finfo(float).eps * np.linalg.norm(P, 2) * (1 + np.linalg.norm(A, 2) ** 2)
    return bool(np.linalg.eigvalsh(P)[0] > rounding and np.linalg.eigvalsh((drop + drop.T) / 2)[0] > rounding)


def _grows(A: np.ndarray, vectors: np.ndarray, lead: int, radius: float) -> bool:
    try:
        left = np.linalg.inv(vectors)[lead]
    except np.linalg.LinAlgError:
        return False
    condition = np.linalg.norm(left) * np.linalg.norm(vectors[:, lead])
    return bool(radius - 1 > 10 * len(A) * np.finfo(float).eps * np.linalg.norm(A, 2) * condition)


MAX_ENCLOSED_STATES = 60
"""States up to which eigenvalues are enclosed; the time grows with the cube, from some milliseconds."""


def _verdict_by_enclosure(A: np.ndarray) -> str:
    """Verdict from balls about all eigenvalues of the very A."""
    require("certify", "a proof in ball arithmetic", "flint")
    import flint

    if len(A) > MAX_ENCLOSED_STATES:
        return "inconclusive"
    before = flint.ctx.prec
    try:
        for precision in (128, 384):
            flint.ctx.prec = precision
            try:
                sizes = [abs(one) for one in flint.acb_mat(A.tolist()).eig(multiple=True)]
            except ValueError:  # not enclosed at this precision
                continue
            if all(size < 1 for size in sizes):
                return "certified"
            if any(size > 1 for size in sizes):
                return "refuted"
    finally:
        flint.ctx.prec = before
    return "inconclusive"
