"""Steady-state Kalman filter with constant acceleration."""

from dataclasses import dataclass

import numpy as np

from tarc.core import validation as check
from tarc.estimators.observer import Observer


@dataclass(frozen=True, kw_only=True, eq=False)
class Kalman(Observer):
    """Steady-state Kalman filter for white measurement noise and an acceleration that walks at random.

        x⁺ = Φ x + w,     q = x_1 + v,     cov w = jerk² T [T²/6; T/2; 1][·]ᵀ per period,     cov v = noise²
        L = P⁻ cᵀ / (c P⁻ cᵀ + noise²)

    with P⁻ the solution of the discrete Riccati equation. Only jerk/noise matters: the larger, the faster and the
    noisier.

    Parameters
    ----------
    noise
        Standard deviation of the measurement [rad or m]; for an encoder its step over √12.
    jerk
        Standard deviation of the change of acceleration over one second [rad/s³ or m/s³].

    References
    ----------
    Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to Tracking and Navigation, Wiley, 2001,
    the discrete Wiener process acceleration model.
    """

    noise: float
    jerk: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("noise", self.noise, 0, strict=True)
        check.number("jerk", self.jerk, 0, strict=True)

    @property
    def gain(self) -> np.ndarray:
        """Return L, shape (3,); the Riccati equation is solved with the period as the unit of time, which scales it
        well."""
        from scipy.linalg import solve_discrete_are

        step = np.array([1 / 6, 1 / 2, 1.0])
        transition = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
        c = np.array([[1.0, 0.0, 0.0]])
        walk = (self.jerk * self.sampling_period**2.5 / self.noise) ** 2 * np.outer(step, step)
        P = solve_discrete_are(transition.T, c.T, walk, np.eye(1))
        return (P @ c.T / (c @ P @ c.T + 1))[:, 0] / self.sampling_period ** np.arange(3)
