"""Weighted least squares over the joints of a record, with intervals from the scatter between its parts."""

from dataclasses import dataclass

import numpy as np

from tarc.core.types import Array

N_BLOCKS = 20
"""Parts of a record that count as independent, for the intervals."""
Z = 1.96
"""Standard errors of a 95 % interval."""
N_WEIGHTINGS = 4
"""Rounds in which the residual of each joint becomes its weight."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Interval:
    """A value with its 95 % interval.

    Attributes
    ----------
    value, low, high
        Each of shape (n,), or a number.
    """

    value: Array
    low: Array
    high: Array

    @classmethod
    def about(cls, value: Array, error: Array) -> "Interval":
        """Return value ± 1.96 standard errors."""
        return cls(value=value, low=value - Z * error, high=value + Z * error)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Least squares y = X p + r over k instants and n joints.

    Attributes
    ----------
    parameters
        p, shape (m,).
    errors
        Standard errors, shape (m,), from the scatter between parts of the record.
    deviations
        Standard deviation of r, shape (n,).
    """

    parameters: Array
    errors: Array
    deviations: Array


def fit(X: Array, y: Array, prior: Array, rows: Array) -> Fit:
    """Fit parameters by least squares, each joint weighted by the inverse of its residual.

        min Σ_i ‖y_i − X_i p‖²/σ_i² + K Σ_j (p_j / π_j)²

    Parameters
    ----------
    X, y
        Shapes (k, n, m) and (k, n), in the order of time.
    prior
        π √(n k / K): deviation of each parameter from zero, shape (m,); infinite where nothing is known.
    rows
        Instants to use, a mask of shape (k,).
    """
    X, y = X[rows], y[rows]
    k, n, m = X.shape
    block = np.arange(k) * N_BLOCKS // k
    penalty = k * n / prior**2
    deviations, parameters, errors = np.std(y, axis=0), np.zeros(m), np.zeros(m)
    for _ in range(N_WEIGHTINGS):
        weights = 1 / np.maximum(deviations, 1e-12) ** 2
        weighted = X * weights[None, :, None]
        normal = np.einsum("knm,knl->ml", weighted, X) + np.diag(penalty)
        size = np.sqrt(np.diag(normal))
        size[size == 0] = 1.0
        inverse = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
        parameters = inverse @ np.einsum("knm,kn->m", weighted, y)
        residual = y - X @ parameters
        scores = np.einsum("knm,kn->km", weighted, residual)
        sums = np.array([scores[block == part].sum(axis=0) for part in range(N_BLOCKS)])
        errors = np.sqrt(np.sum((sums @ inverse) ** 2, axis=0) * N_BLOCKS / (N_BLOCKS - 1))
        deviations = np.std(residual, axis=0)
    return Fit(parameters=parameters, errors=errors, deviations=deviations)
