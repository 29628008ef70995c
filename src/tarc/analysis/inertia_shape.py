"""The shape of M̂ that spreads the eigenvalues of M(q)⁻¹M̂ over a workspace least."""

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
from tarc.plants.base import Plant

MAX_ROUNDS = 30
"""Most rounds in which `best_inertia_shape` adds postures."""
DROPPING_ROUNDS = 6
"""Rounds after which no posture is dropped any more."""
N_SEARCHES = 8
"""Of the local search in each round, for each end."""
SAME_TOLERANCE = 1e-5
"""Distance of two inertia matrices, of their size, below which one stands for both."""
ACTIVE_FACTOR = 1.2
"""Factor from the outermost eigenvalue beyond which `best_inertia_shape` drops a posture that it had added."""


def best_inertia_shape(
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    samples: int = 2000,
    diagonal: bool = False,
    tolerance: float = 0.01,
    seed: int = 0,
) -> tuple[np.ndarray, float]:
    """The M̂ whose eigenvalues of M(q)⁻¹M̂ spread least over a workspace: min t, M(q) ≼ X ≼ t M(q).

    Cutting planes: solve for a few postures, look for those that violate it most with `spread`, add them, repeat. For
    the postures at hand the solver's dual gives a lower bound for every X, and the spread of the X at hand is an upper
    one; the two must meet. Both are recomputed from matrices, and neither is the solver's word: see `lower_bound`.

    Parameters
    ----------
    plant, workspace, samples, seed
        As in `spread`.
    diagonal
        Of all diagonal matrices only.
    tolerance
        By which share the spread may exceed the lower bound.

    Returns
    -------
    X, t
        X [kg m² or kg], shape (n, n), scaled so that the eigenvalues of M(q)⁻¹X found over the workspace lie between
        1 and t; multiply it by a ratio that the loop tolerates.

    Raises
    ------
    TarcError
        As `spread`; when the solver fails or the bounds do not meet.
    """
    plants = as_plants(plant)
    check.number("tolerance", tolerance, 1e-4, high=1.0)
    grid = PostureSamples(workspace, plants, samples, seed)
    pool = np.concatenate(grid.inertias)
    mean = pool.mean(axis=0)
    X, bound = np.diag(np.diag(mean)) if diagonal else mean, 1.0
    best, ratio = X, np.inf
    below = above = pool[:0]
    for count in range(MAX_ROUNDS):
        lows, highs = local_maxima(extreme_ratio_functions(X), plants, grid, N_SEARCHES)
        low, high = 1 / largest_maximum(lows).value, -1 / largest_maximum(highs).value
        if high / low < ratio:
            best, ratio = X / low, high / low
        if ratio <= (1 + tolerance) * bound:
            return best, ratio
        fresh_low, fresh_high = ([plants[one.plant].inertia(one.posture) for one in ends] for ends in (lows, highs))
        if count < DROPPING_ROUNDS:  # and from then on none is dropped, so that none comes and goes for ever
            below, above = _active(below, X, -1), _active(above, X, 0)
        below, above = _add_distinct(below, fresh_low), _add_distinct(above, fresh_high)
        X, lower = _solve(below, above, mean, diagonal)
        bound = max(bound, lower)
    raise NotConverged(
        f"best_inertia_shape: after {MAX_ROUNDS} rounds the spread {ratio:.4g} exceeds its lower bound {bound:.4g} by "
        f"more than {tolerance:.2g}; raise the tolerance or the number of samples"
    )


def _active(matrices: np.ndarray, X: np.ndarray, end: int) -> np.ndarray:
    """Those whose eigenvalue of M⁻¹X at this end is within a factor of the outermost one; the others do not bind."""
    if not len(matrices):
        return matrices
    values = inverse_ratios(matrices, X)[:, end]
    outermost = values.max() if end == -1 else values.min()
    return matrices[np.abs(np.log(values / outermost)) < np.log(ACTIVE_FACTOR)]


def _add_distinct(matrices: np.ndarray, fresh: list[np.ndarray]) -> np.ndarray:
    """With those that are not nearly there already, as several searches end in the same posture."""
    kept = list(matrices)
    for one in fresh:
        size = SAME_TOLERANCE * np.linalg.norm(one)
        if all(np.linalg.norm(one - other) > size for other in kept):
            kept.append(one)
    return np.array(kept)


def _solve(below: np.ndarray, above: np.ndarray, mean: np.ndarray, diagonal: bool) -> tuple[np.ndarray, float]:
    """X and the least t with M_i ≼ X for those below and X ≼ t M_i for those above.

    In coordinates in which the mean of M is the identity, or has ones on its diagonal.
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
    duals = np.array([one.dual_value for one in constraints])
    bound = lower_bound(below, above, duals[: len(below)], duals[len(below) :], diagonal)
    return check.positive_definite("best_inertia_shape", (X + X.T) / 2, n), bound


def lower_bound(
    below: np.ndarray, above: np.ndarray, less: np.ndarray, more: np.ndarray, diagonal: bool = False
) -> float:
    """A t below which no X fulfils M_i ≼ X for those below and X ≼ t M_j for those above; valid for any duals.

    With Z_i and W_j the positive parts of the duals, and λ the least for which Σ Z_i ≼ λ Σ W_j,

        Σ tr(Z_i M_i) ≤ tr(Σ Z_i X) ≤ λ tr(Σ W_j X) ≤ λ t Σ tr(W_j M_j).

    A multiple of the identity is added to one of the W_j, the one that raises the bound most, since Σ W_j may be
    singular. For diagonal X only the diagonals of the sums count. Zero for duals that say nothing.

    Parameters
    ----------
    below, above
        M_i and M_j, each (k, n, n).
    less, more
        The duals of their constraints, as a solver gives them.
    """
    if not (np.isfinite(less).all() and np.isfinite(more).all()):
        return 0.0
    Z, W = _positive_part(less), _positive_part(more)
    gained, spent = np.sum(Z * below), np.sum(W * above)
    both = np.stack([Z.sum(axis=0), W.sum(axis=0)])
    if diagonal:
        both = np.array([np.diag(np.diag(one)) for one in both])
    unit = np.eye(below.shape[1])
    least = float(np.trace(above, axis1=1, axis2=2).min())  # what the identity costs, where it costs least
    best = 0.0
    if not (np.trace(both[0]) > 0 and np.trace(both[1]) > 0):
        return best
    for extra in np.trace(both[1]) * np.geomspace(1e-12, 1e-2, 21):
        root = np.linalg.inv(np.linalg.cholesky(both[1] + extra * unit))
        scale = float(np.linalg.eigvalsh(root @ both[0] @ root.T)[-1])
        best = max(best, float(gained / (scale * (spent + extra * least))))
    return best


def _positive_part(matrices: np.ndarray) -> np.ndarray:
    """The nearest positive semidefinite matrices."""
    values, vectors = np.linalg.eigh((matrices + matrices.transpose(0, 2, 1)) / 2)
    return (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
