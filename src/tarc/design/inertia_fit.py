"""Least squares of the inertia matrix over one filter window."""

from dataclasses import dataclass

import numpy as np

from tarc.core.errors import NotIdentifiable
from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic
from tarc.estimators.base import synchronous_weights

N_BLOCKS = 20
"""Parts of a record that count as independent, for the standard error."""
MAX_CONDITION = 100.0
"""Largest condition number of the correlation of the joints' accelerations."""
MIN_EXPLAINED = 0.5
"""Least share of M q̈ in the torque that friction and gravity do not explain."""
MIN_TORQUE_SHARE = 0.15
"""Least RMS of M q̈ over that of the torque; a joint that dry friction locks has less."""
MIN_ROWS = 5 * N_BLOCKS
"""Fewest instants."""
MAX_RELATIVE_ERROR = 0.25
"""Largest standard error over the inertia itself."""
MIN_DIRECTION = 0.01
"""Least size of a direction of the motion, over the largest."""
TINY = 1e-300
"""Smallest divisor."""


@dataclass(frozen=True, eq=False)
class InertiaFit:
    """Least squares with one window.

    Attributes
    ----------
    window
        [s].
    n_rows
        Number of instants used.
    inertia, error
        M and its standard errors [kg m² or kg], shape (n, n).
    explained, torque_share
        As in `tarc.design.IdentifiedInertia`, shape (n,).
    condition
        Condition number of the correlation of the joints' accelerations.
    directions
        Number of independent directions, above 1 % of the largest, in which positions and accelerations move.
    """

    window: float
    n_rows: int
    inertia: Array
    error: Array
    explained: Array
    torque_share: Array
    condition: float
    directions: int

    @classmethod
    def from_record(cls, q: Array, tau: Array, period: float, n_periods: int, degree: int) -> "InertiaFit | None":
        """Fit positions and torques, (k, n) both; None where too few windows are without a gap."""
        rows = _regression_rows(q, tau, period, n_periods, degree)
        complete = np.flatnonzero(np.isfinite(rows.sum(axis=1)))
        n = q.shape[1]
        if len(complete) < MIN_ROWS:
            return None
        acceleration, torque, place, rate, sign = np.split(rows[complete], 5, axis=1)
        block = N_BLOCKS * complete // len(rows)
        M, error, explained, condition = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), 1.0
        for i in range(n):
            known = np.column_stack([np.ones(len(complete)), place, rate[:, i], sign[:, i]])
            X, y = residual(known, acceleration), residual(known, torque[:, i])
            M[i], error[i], explained[i], one_condition = _fit_row(X, y, block)
            condition = max(condition, one_condition)
        torque_share = np.std(acceleration @ M.T, axis=0) / np.maximum(np.std(torque, axis=0), TINY)
        return cls(
            n_periods * period,
            len(complete),
            M,
            error,
            explained,
            torque_share,
            condition,
            _directions(place, acceleration),
        )

    def check_identifiable(self) -> None:
        """Check that the motion determines M.

        Raises
        ------
        NotIdentifiable
            For joints that accelerate together, and for one whose inertia is hidden by other torques or uncertain.
        """
        if self.condition > MAX_CONDITION:
            raise NotIdentifiable(
                f"position: the joints accelerate together: their condition number is {self.condition:.3g} and may be "
                f"at most {MAX_CONDITION:g}. Positions and accelerations move in {self.directions} directions, and "
                f"{2 * len(self.inertia)} would tell inertia from gravity. Give each joint frequencies of its own, as "
                "excitation_reference(…) does"
            )
        inertia, error = np.diag(self.inertia), np.diag(self.error)
        is_weak = (self.explained < MIN_EXPLAINED) | (self.torque_share < MIN_TORQUE_SHARE)
        bad = np.flatnonzero(is_weak | (inertia <= 0) | (error > MAX_RELATIVE_ERROR * inertia))
        if bad.size:
            i = int(bad[0])
            raise NotIdentifiable(
                f"torque: joint {i + 1} does not show its inertia, found as {inertia[i]:.3g} ± {error[i]:.2g}. M q̈ is "
                f"{self.torque_share[i]:.0%} of the torque and explains {self.explained[i]:.0%} of what friction and "
                f"gravity leave; needs {MIN_TORQUE_SHARE:.0%}, {MIN_EXPLAINED:.0%} and an error within "
                f"{MAX_RELATIVE_ERROR:.0%}: move it faster, farther and for longer"
            )


def _regression_rows(q: Array, tau: Array, period: float, n_periods: int, degree: int) -> Array:
    """Return filtered acceleration, torque, position, velocity and its sign, (k, 5 n), four times per window."""
    w = Algebraic(window=n_periods * period, degree=degree).with_period(period).weights(2)
    c = synchronous_weights(w, period)
    velocity, half = np.diff(q, axis=0) / period, max(n_periods // 2, 2)
    smooth = _filter(np.pad(velocity, ((half, half), (0, 0)), mode="edge"), np.ones(2 * half + 1))
    inputs = tau[:-1], (q[1:] + q[:-1]) / 2, velocity, np.sign(smooth)
    parts = _filter(q, w), *(_filter(values, c) for values in inputs)
    return np.hstack(parts)[:: max(1, n_periods // 4)]


def _directions(place: Array, acceleration: Array) -> int:
    """Return the number of singular values above 1 % of the largest, of columns of unit deviation."""
    columns = np.hstack([place, acceleration])
    columns = (columns - columns.mean(axis=0)) / np.maximum(np.std(columns, axis=0), TINY)
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(columns.T @ columns), 0.0))
    return int(np.count_nonzero(values > MIN_DIRECTION * values[-1]))


def _fit_row(X: Array, y: Array, block: Array) -> tuple[Array, Array, float, float]:
    """Return a row of M, its standard errors, the explained share, and the condition number.

    The standard errors come from the scatter between blocks of the record.
    """
    size = np.maximum(np.sqrt(np.sum(X**2, axis=0)), TINY)
    X = X / size
    values, vectors = np.linalg.eigh(X.T @ X)
    inverse = (vectors / np.maximum(values, 1e-12)) @ vectors.T
    m = inverse @ (X.T @ y)
    left = y - X @ m
    scores = np.array([X[block == b].T @ left[block == b] for b in range(N_BLOCKS)])
    error = np.sqrt(np.sum((scores @ inverse) ** 2, axis=0) * N_BLOCKS / (N_BLOCKS - 1)) / size
    explained = 1 - left @ left / max(y @ y, TINY)
    return m / size, error, float(explained), float(values[-1] / max(values[0], TINY))


def _filter(values: Array, weights: Array) -> Array:
    """Return weighted sums of each column over the newest samples, newest first, wherever the window is full."""
    return np.column_stack([np.convolve(column, weights, "valid") for column in values.T])


def residual(known: Array, values: Array) -> Array:
    """Return the part of values that the known columns do not explain.

    It is projected twice, against rounding. Normal equations are used since a threaded LAPACK is far slower for tall
    matrices where the cores are shared.
    """
    known = known / np.maximum(np.sqrt(np.sum(known**2, axis=0)), TINY)
    inverse = np.linalg.pinv(known.T @ known, hermitian=True)
    for _ in range(2):
        values = values - known @ (inverse @ (known.T @ values))
    return values


def nearest_positive_definite(M: Array) -> Array:
    """Return M with its diagonal unchanged and the eigenvalues of its correlation raised to 0.01."""
    root = np.sqrt(np.diag(M))
    values, vectors = np.linalg.eigh(M / np.outer(root, root))
    near = (vectors * np.maximum(values, 0.01)) @ vectors.T
    size = root / np.sqrt(np.diag(near))
    return (near + near.T) / 2 * np.outer(size, size)
