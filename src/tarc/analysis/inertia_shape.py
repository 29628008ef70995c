"""The shape of M̂ with the least spread of the eigenvalues of M(q)⁻¹M̂ over a workspace."""

from collections.abc import Sequence

import numpy as np

from tarc.analysis.inertia_ratio import (
    PostureSamples,
    as_plants,
    extreme_ratio_functions,
    inverse_ratios,
    largest_maximum,
    local_maxima,
)
from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.core.errors import NotConverged
from tarc.core.optional import require
from tarc.core.types import Array
from tarc.plants.base import Plant

MAX_ROUNDS = 30
"""Largest number of rounds in which `best_inertia_shape` adds postures."""
DROPPING_ROUNDS = 6
"""Number of rounds after which no posture is dropped."""
N_SEARCHES = 8
"""Number of samples from which a local search starts in each round, for each end."""
SAME_TOLERANCE = 1e-5
"""Relative distance of two inertia matrices below which one stands for both."""
ACTIVE_FACTOR = 1.2
"""Factor from the outermost eigenvalue beyond which `best_inertia_shape` drops an added posture."""


def best_inertia_shape(
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    samples: int = 2000,
    diagonal: bool = False,
    tolerance: float = 0.01,
    seed: int = 0,
) -> tuple[Array, float]:
    """Return the M̂ with the least spread of the eigenvalues of M(q)⁻¹M̂ over a workspace.

        minimise t  subject to  M(q) ≼ X ≼ t M(q) for all q

    Cutting planes solve it. Each round solves it for a few postures, and adds those that violate it most. For these
    postures the solver's dual gives a lower bound for every X, see `lower_bound`. The spread of the present X is an
    upper bound, and the two must meet. Both are recomputed from matrices; no status of the solver counts.

    Parameters
    ----------
    plant, workspace, samples, seed
        As in `inertia_spread`.
    diagonal
        Whether X is diagonal.
    tolerance
        Share by which the spread may exceed the lower bound.

    Returns
    -------
    X, t
        X [kg m² or kg], shape (n, n), scaled so that the eigenvalues of M(q)⁻¹X over the workspace lie between 1 and
        t. Multiply it by a ratio that the loop tolerates.

    Raises
    ------
    InvalidParameter
        As in `inertia_spread`.
    NotConverged
        When the solver fails, and when the bounds do not meet.
    """
    plants = as_plants(plant)
    check.number("tolerance", tolerance, 1e-4, high=1.0)
    postures = PostureSamples(workspace, plants, samples, seed)
    pool = np.concatenate(postures.inertias)
    mean = pool.mean(axis=0)
    X, bound = np.diag(np.diag(mean)) if diagonal else mean, 1.0
    best, ratio = X, np.inf
    below = above = pool[:0]
    for count in range(MAX_ROUNDS):
        lows, highs = local_maxima(extreme_ratio_functions(X), plants, postures, N_SEARCHES)
        low, high = 1 / largest_maximum(lows).value, -1 / largest_maximum(highs).value
        if high / low < ratio:
            best, ratio = X / low, high / low
        if ratio <= (1 + tolerance) * bound:
            return best, ratio
        added_below, added_above = (
            [plants[maximum.plant].inertia(maximum.posture) for maximum in maxima] for maxima in (lows, highs)
        )
        if count < DROPPING_ROUNDS:  # later none is dropped, so that the rounds do not cycle
            below, above = _active(below, X, -1), _active(above, X, 0)
        below, above = _add_distinct(below, added_below), _add_distinct(above, added_above)
        X, lower = _solve(below, above, mean, diagonal)
        bound = max(bound, lower)
    raise NotConverged(
        f"best_inertia_shape: after {MAX_ROUNDS} rounds the spread {ratio:.4g} exceeds its lower bound {bound:.4g} by "
        f"more than {tolerance:.2g}; raise the tolerance or the number of samples"
    )


def _active(matrices: Array, X: Array, end: int) -> Array:
    """Return the matrices whose eigenvalue of M⁻¹X at this end is near the outermost one; the others do not bind."""
    if not len(matrices):
        return matrices
    values = inverse_ratios(matrices, X)[:, end]
    outermost = values.max() if end == -1 else values.min()
    return matrices[np.abs(np.log(values / outermost)) < np.log(ACTIVE_FACTOR)]


def _add_distinct(matrices: Array, added: list[Array]) -> Array:
    """Return the matrices with those added that differ from all, because several searches may end in one posture."""
    distinct = list(matrices)
    for matrix in added:
        tolerance = SAME_TOLERANCE * np.linalg.norm(matrix)
        if all(np.linalg.norm(matrix - present) > tolerance for present in distinct):
            distinct.append(matrix)
    return np.array(distinct)


def _solve(below: Array, above: Array, mean: Array, diagonal: bool) -> tuple[Array, float]:
    """Return X and a lower bound on the least t with M_i ≼ X for those below and X ≼ t M_j for those above.

    The program is in coordinates in which the mean of M is the identity, or has ones on its diagonal.
    """
    import warnings

    require("certify", "best_inertia_shape", "cvxpy", "clarabel")
    import cvxpy as cp

    n = len(mean)
    scale = np.diag(np.sqrt(np.diag(mean))) if diagonal else np.linalg.cholesky(mean)
    whiten = np.linalg.inv(scale)
    t = cp.Variable()
    shape = cp.diag(cp.Variable(n)) if diagonal else cp.Variable((n, n), symmetric=True)
    below, above = ((M + M.transpose(0, 2, 1)) / 2 for M in (whiten @ below @ whiten.T, whiten @ above @ whiten.T))
    constraints = [*(shape - M >> 0 for M in below), *(t * M - shape >> 0 for M in above)]
    problem = cp.Problem(cp.Minimize(t), constraints)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(solver=cp.CLARABEL)
    except cp.SolverError as error:
        raise NotConverged(
            f"best_inertia_shape: the solver failed ({error}); try other samples, or more armature"
        ) from None
    if shape.value is None or t.value is None:
        raise NotConverged(
            f"best_inertia_shape: the solver ended {problem.status}; try other samples, or more armature"
        )
    X = scale @ np.asarray(shape.value) @ scale.T
    duals = np.array([constraint.dual_value for constraint in constraints])
    bound = lower_bound(below, above, duals[: len(below)], duals[len(below) :], diagonal)
    return check.positive_definite("best_inertia_shape", (X + X.T) / 2, n), bound


def lower_bound(below: Array, above: Array, duals_below: Array, duals_above: Array, diagonal: bool = False) -> float:
    """Return a t below which no X satisfies M_i ≼ X and X ≼ t M_j; it is valid for any duals.

    With Z_i and W_j the positive parts of the duals, and λ the least for which Σ Z_i ≼ λ Σ W_j,

        Σ tr(Z_i M_i) ≤ tr(Σ Z_i X) ≤ λ tr(Σ W_j X) ≤ λ t Σ tr(W_j M_j).

    Because Σ W_j may be singular, a multiple of the identity is added to the W_j with which the bound is largest. For
    diagonal X only the diagonals of the sums count. The result is zero for duals without information.

    Parameters
    ----------
    below, above
        M_i and M_j, each (k, n, n).
    duals_below, duals_above
        Duals of their constraints from a solver, each (k, n, n).
    diagonal
        Whether X is diagonal.
    """
    if not (np.isfinite(duals_below).all() and np.isfinite(duals_above).all()):
        return 0.0
    Z, W = _positive_part(duals_below), _positive_part(duals_above)
    numerator, denominator = np.sum(Z * below), np.sum(W * above)
    Z_sum, W_sum = Z.sum(axis=0), W.sum(axis=0)
    if diagonal:
        Z_sum, W_sum = np.diag(np.diag(Z_sum)), np.diag(np.diag(W_sum))
    if not (np.trace(Z_sum) > 0 and np.trace(W_sum) > 0):
        return 0.0
    least_trace = float(np.trace(above, axis1=1, axis2=2).min())
    bounds = [0.0]
    for added in np.trace(W_sum) * np.geomspace(1e-12, 1e-2, 21):
        root = np.linalg.inv(np.linalg.cholesky(W_sum + added * np.eye(below.shape[1])))
        scale = float(np.linalg.eigvalsh(root @ Z_sum @ root.T)[-1])
        bounds.append(float(numerator / (scale * (denominator + added * least_trace))))
    return max(bounds)


def _positive_part(matrices: Array) -> Array:
    """Return the nearest positive semidefinite matrices."""
    values, vectors = np.linalg.eigh((matrices + matrices.transpose(0, 2, 1)) / 2)
    return (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
