"""The window of an estimator at the true times of its samples."""

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic, polynomial_weights
from tarc.estimators.base import Estimator


class StampedWindow:
    """Past samples as an even window would have them, from samples at uneven times.

    The polynomial p of degree Λ fits the newest N + 1 samples at their own times best. The even window gets p(−iT) for
    i = 1 … N, less c_i (q − p(0)) with the newest sample q. The c_i make up for the weight w_0 that q itself has:

        Σ_{i≥1} w_i c_i = w_0    for prediction, velocity and acceleration

    So its sums are exactly those of `polynomial_weights` at the true times, and exact on polynomials of degree Λ.
    """

    def __init__(self, estimator: Estimator, n_joints: int):
        if not isinstance(estimator, Algebraic):
            raise InvalidParameter(
                f"time: {type(estimator).__name__} takes even samples alone; leave the time out, or give the law an "
                "Algebraic estimator",
                "time",
            )
        self._degree = estimator.degree
        self._period = estimator.sampling_period
        weights = estimator.sums
        self._correction = np.linalg.pinv(weights[1:].T) @ weights[0]
        self._places = -self._period * np.arange(1, estimator.samples)
        self._shape = n_joints, estimator.samples
        self._times = np.zeros(0)
        self._positions = np.zeros((0, n_joints))
        self._rest = np.zeros(n_joints)

    def reset(self, position: Array) -> None:
        """Start at rest at a position (n,); the next time is the first one."""
        self._times = np.zeros(0)
        self._rest = np.array(position, dtype=float)

    @property
    def last_position(self) -> Array:
        """Return the newest valid position of each joint, shape (n,)."""
        return self._rest

    def is_new(self, time: float) -> bool:
        """Return whether a time [s] is later than that of the last sample.

        Raises
        ------
        InvalidParameter
            For a time that is no finite number, or earlier than the last one.
        """
        time = check.number("time", time)
        if self._times.size and time < self._times[0]:
            raise InvalidParameter(f"time: got {time:.9g} s after {self._times[0]:.9g} s; needs times that increase")
        return not self._times.size or time > self._times[0]

    def even(self, time: float, position: Array) -> tuple[Array, Array]:
        """Take a sample at a later time [s]; return the even window before it (n, N) and the prediction of it (n,).

        A joint whose position is NaN is predicted. A joint with too few samples has NaN in its row.
        """
        n, samples = self._shape
        if not self._times.size:
            self._times = time - self._period * np.arange(1, samples)
            self._positions = np.tile(self._rest, (samples - 1, 1))
        self._times = np.concatenate([[time], self._times])[:samples]
        self._positions = np.concatenate([[position], self._positions])[:samples]
        is_valid = np.isfinite(self._positions)
        self._rest = np.where(is_valid[0], position, self._rest)
        ages = time - self._times
        past, prediction = np.full((n, samples - 1), np.nan), np.full(n, np.nan)
        for i in range(n):
            rows = is_valid[:, i]
            if np.count_nonzero(rows) <= self._degree:
                continue
            coefficients = self._coefficients(ages[rows]) @ self._positions[rows, i]
            past[i] = np.polynomial.polynomial.polyval(self._places, coefficients)
            prediction[i] = coefficients[0]
            if rows[0]:
                past[i] -= self._correction * (position[i] - prediction[i])
        return past, prediction

    def _coefficients(self, ages: Array) -> Array:
        """Return the weights of the coefficients of p, shape (Λ + 1, samples)."""
        rows = [polynomial_weights(ages, self._degree, order) for order in range(self._degree + 1)]
        factorials = np.cumprod([1.0, *range(1, self._degree + 1)])
        return np.array(rows) / factorials[:, None]
