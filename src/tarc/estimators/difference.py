"""Backward differences, plain and with a first-order low-pass filter."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.estimators.base import Estimate, Estimator, TorqueAverage, WindowedEstimator, WindowState, synchronous_weights


@dataclass(frozen=True, kw_only=True, eq=False)
class BackwardDifference(WindowedEstimator):
    """Euler's backward differences: q̇ ≈ (q_k − q_{k−1})/T, q̈ ≈ (q_k − 2q_{k−1} + q_{k−2})/T².

    The classical estimates of time-delay control. Velocity is exact at constant velocity, and acceleration at constant
    acceleration. Noise grows with 1/T and 1/T². A missing sample is extrapolated linearly.

    References
    ----------
    K. Youcef-Toumi and O. Ito, ASME J. Dyn. Syst. Meas. Control 112(1), 1990; paper, Section II-B.
    """

    @property
    def max_derivative(self) -> int:
        """Return 2: velocity and acceleration."""
        return 2

    def weights(self, derivative: int) -> np.ndarray:
        """Return the weights [s^−j] of the three newest samples, newest first."""
        return (
            np.array([[1.0, 0, 0], [1.0, -1, 0], [1.0, -2, 1]])[self._order(derivative)]
            / self.sampling_period**derivative
        )

    @property
    def prediction(self) -> np.ndarray:
        """Return the weights of the linear extrapolation 2 q_{k−1} − q_{k−2}."""
        return np.array([2.0, -1.0, 0.0])


class FilteredState(NamedTuple):
    """State of the differences, and the filtered derivatives, shape (n,)."""

    raw: WindowState
    velocity: Vector
    acceleration: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class FilteredDifference(Estimator):
    """Backward differences behind a first-order low-pass: y_k = p y_{k−1} + (1−p) x_k, p = exp(−ω_c T).

    The usual remedy for encoder noise in time-delay control; it adds a delay of about 1/ω_c.

    Parameters
    ----------
    cutoff
        ω_c [rad/s].

    References
    ----------
    G. R. Cho et al., IEEE Trans. Control Syst. Technol. 17(6), 2009, on what the filter does to M̂; paper,
    Section II-B.
    """

    cutoff: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("cutoff", self.cutoff, 0, strict=True)

    @property
    def max_derivative(self) -> int:
        """Return 2: velocity and acceleration."""
        return 2

    @cached_property
    def pole(self) -> float:
        """Return the filter's pole p = exp(−ω_c T)."""
        return float(np.exp(-self.cutoff * self.sampling_period))

    @property
    def difference(self) -> BackwardDifference:
        """Return the differences before the filter."""
        return BackwardDifference(period=self.sampling_period)

    def transfer_function(self, derivative: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the difference times (1 − p)/(1 − p z⁻¹); the position is passed as it is."""
        weights = self.difference.weights(derivative)
        if derivative == 0:
            return weights, np.ones(1)
        return (1 - self.pole) * weights, np.array([1.0, -self.pole])

    def matched_torque_filter(self) -> TorqueAverage:
        """Return the weights (½, ½) of the second difference, behind the same low-pass."""
        return TorqueAverage(synchronous_weights(self.difference.weights(2), self.sampling_period), self.pole)

    def init(self, position: Numbers) -> FilteredState:
        """Return the state at rest at the first position, shape (n,)."""
        raw = self.difference.init(position)
        zero = np.zeros(raw.window.shape[0])
        return FilteredState(raw, zero, zero)

    def step(self, state: FilteredState, value: Vector) -> tuple[FilteredState, Estimate]:
        """Filter the differences of the newest samples."""
        raw_state, raw = self.difference.step(state.raw, value)
        velocity = self.pole * state.velocity + (1 - self.pole) * raw.velocity
        acceleration = self.pole * state.acceleration + (1 - self.pole) * raw.acceleration
        estimate = Estimate(raw.position, velocity, acceleration, raw.valid)
        return FilteredState(raw_state, velocity, acceleration), estimate
