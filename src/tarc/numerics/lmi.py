"""Linear matrix inequalities whose matrices are written as functions of their unknowns, solved by Clarabel."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from tarc.core.types import Array


class Inequalities(NamedTuple):
    """What the unknowns must satisfy, each an affine function of them.

    Attributes
    ----------
    objective
        Number to be maximised.
    positive
        Matrices whose symmetric parts must be positive semidefinite.
    zero
        Numbers that must be zero.
    """

    objective: float | Array
    positive: Sequence[Array]
    zero: Sequence[float | Array] = ()


def solve_lmi(sizes: Sequence[int], at: Callable[..., Inequalities]) -> list[Array] | None:
    """Return the unknowns that maximise an objective subject to linear matrix inequalities.

    The coefficients are the differences of what `at` returns at zero and at each unit unknown. No status of the solver
    is a proof: the values are candidates, to be judged on their own.

    Parameters
    ----------
    sizes
        Rows of each symmetric unknown; zero for a number.
    at
        Returns the inequalities at values of the unknowns, one argument for each.

    Returns
    -------
    list or None
        One array for each unknown, symmetric matrices and arrays of shape (). None when the solver fails, and when the
        data are not finite.
    """
    import clarabel
    from scipy.sparse import csc_matrix

    counts = [size * (size + 1) // 2 if size else 1 for size in sizes]
    ends = np.cumsum(counts)

    def values(unknowns: Array) -> list[Array]:
        parts = np.split(unknowns, ends[:-1])
        return [_from_triangle(part, size) if size else part[0] for part, size in zip(parts, sizes, strict=True)]

    def row(unknowns: Array) -> Array:
        objective, positive, zero = at(*values(unknowns))
        return np.concatenate(
            [np.array([objective, *zero]), *(_to_triangle((matrix + matrix.T) / 2) for matrix in positive)]
        )

    constant = row(np.zeros(ends[-1]))
    slopes = np.array([row(unit) - constant for unit in np.eye(ends[-1])])
    if not np.all(np.isfinite(slopes)) or not np.all(np.isfinite(constant)):
        return None
    _, positive, zero = at(*values(np.zeros(ends[-1])))
    cones = [clarabel.ZeroConeT(len(zero))] if len(zero) else []
    cones += [clarabel.PSDTriangleConeT(len(matrix)) for matrix in positive]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    quadratic = csc_matrix((ends[-1], ends[-1]))
    solver = clarabel.DefaultSolver(
        quadratic, -slopes[:, 0], csc_matrix(-slopes[:, 1:].T), constant[1:], cones, settings
    )
    solution = solver.solve()
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        return None
    return values(np.array(solution.x))


def _to_triangle(matrix: Array) -> Array:
    """Return the upper triangle by columns, off the diagonal times √2, as the solver takes it."""
    columns, rows = np.tril_indices(len(matrix))
    return matrix[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2))


def _from_triangle(entries: Array, size: int) -> Array:
    """Return the symmetric matrix with this upper triangle by columns."""
    columns, rows = np.tril_indices(size)
    matrix = np.zeros((size, size))
    matrix[rows, columns] = entries
    matrix[columns, rows] = entries
    return matrix
