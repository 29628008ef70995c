"""Base of the estimators: derivatives of a position from its present and past samples."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.system import System
from tarc.core.types import Tree, Vector
from tarc.core.validation import Numbers

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Estimate(NamedTuple):
    """Output of an estimator for one sample.

    ``position`` is the measured one, or a prediction where the sample was missing. ``valid`` is 1 for each joint whose
    sample was a finite number, else 0.
    """

    position: Vector
    velocity: Vector
    acceleration: Vector
    valid: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimator(Component, System):
    """A causal estimator of velocity and acceleration from positions, by default linear and time invariant.

    It learns its period from the law it is given to, or by `with_period`. The analysis methods hold for any derivative
    order that the estimator has: 0 position, 1 velocity, 2 acceleration.
    """

    period: float | None = None

    def __post_init__(self) -> None:
        if self.period is not None:
            check.number("period", self.period, 0, strict=True)

    def with_period(self, period: float) -> Self:
        """Return the same estimator at this period [s]."""
        period = check.number("period", period, 0, strict=True)
        if self.period == period:
            return self
        if self.period is not None and abs(self.period - period) > 1e-9 * period:
            raise InvalidParameter(
                f"estimator: it is set to a period of {self.period:g} s, the law runs at {period:g} s; leave the "
                "estimator's period out"
            )
        return replace(self, period=period)

    @property
    def sampling_period(self) -> float:
        """Return the period [s]; raise `InvalidParameter` if it is not set."""
        if self.period is None:
            raise InvalidParameter(
                f"{type(self).__name__}: it has no period yet; use .with_period(1e-3), or a law, which sets it"
            )
        return self.period

    @property
    @abstractmethod
    def max_derivative(self) -> int:
        """Return the highest derivative that it estimates."""

    @abstractmethod
    def transfer_function(self, derivative: int) -> tuple[np.ndarray, np.ndarray]:
        """Return numerator and denominator in powers of z⁻¹ from position to the derivative."""

    @abstractmethod
    def matched_torque_filter(self) -> System:
        """Return the filter that gives past torques the delay of the acceleration estimate (synchronised TDE)."""

    @abstractmethod
    def init(self, position: Numbers) -> Tree:
        """Return the state with the window full of the first position [rad or m], shape (n,)."""

    @abstractmethod
    def step(self, state: Tree, value: Vector) -> tuple[Any, Estimate]:
        """Take the newest position, shape (n,); NaN or infinite elements are replaced by a prediction."""

    def _order(self, derivative: int) -> int:
        """Return the derivative if it is estimated, else raise `InvalidParameter`."""
        if derivative not in range(self.max_derivative + 1):
            kind = type(self).__name__
            raise InvalidParameter(
                f"derivative: got {derivative!r}; {kind} estimates orders 0 to {self.max_derivative}"
            )
        return derivative

    def frequency_response(self, frequency: Numbers, derivative: int = 1) -> np.ndarray:
        """Return the complex response H(e^{jωT}) from position to the derivative.

        Parameters
        ----------
        frequency
            ω [rad/s], any shape. The ideal is (jω)^derivative.
        """
        b, a = self.transfer_function(derivative)
        back = np.exp(-1j * np.asarray(frequency, dtype=float) * self.sampling_period)
        return np.polynomial.polynomial.polyval(back, b) / np.polynomial.polynomial.polyval(back, a)

    def group_delay(self, derivative: int = 1) -> float:
        """Return the group delay of the derivative at low frequency [s].

        With H(jω) = (jω)^j (1 − jωτ + …), τ = (−1)^j T^{j+1} Σ i^{j+1} w_i / (j+1)! for a window of weights w_i, plus
        the delay of a recursive part.
        """
        b, a = self.transfer_function(derivative)
        i = np.arange(len(b))
        gain = b / a.sum()
        delay = (-1) ** derivative * self.sampling_period ** (derivative + 1) * np.sum(i ** (derivative + 1) * gain)
        return float(delay / factorial(derivative + 1) - self.sampling_period * np.sum(np.arange(len(a)) * a) / a.sum())

    def noise_gain(self, derivative: int = 1) -> float:
        """Return the standard deviation of the derivative for white position noise of standard deviation one.

        The H2 norm (Σ w_i²)^½ of the filter's impulse response w.
        """
        from scipy.linalg import solve_discrete_lyapunov
        from scipy.signal import tf2ss

        b, a = self.transfer_function(derivative)
        width = max(len(a), len(b))
        A, B, C, D = tf2ss(np.pad(b, (0, width - len(b))), np.pad(a, (0, width - len(a))))
        energy = (C @ solve_discrete_lyapunov(A, B @ B.T) @ C.T + D @ D.T).item() if A.size else (D @ D.T).item()
        return float(np.sqrt(energy))

    def plot(self) -> "Figure":
        """Plot gain and delay of velocity and acceleration over frequency, against the ideal derivative."""
        from tarc.plotting.estimators import estimator_figure

        return estimator_figure(self)


class WindowState(NamedTuple):
    """Past positions, newest first, shape (n, samples), and their prediction of the next one, shape (n,)."""

    window: Vector
    prediction: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowedEstimator(Estimator):
    """An estimator that is a fixed weighted sum over a window of samples, newest first."""

    @abstractmethod
    def weights(self, derivative: int) -> np.ndarray:
        """Return the weights [s^−derivative] of the samples, newest first."""

    @property
    @abstractmethod
    def prediction(self) -> np.ndarray:
        """Return the weights over the past window that predict the next sample."""

    def transfer_function(self, derivative: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the weights as numerator and denominator one; derivative 0 is the measured position."""
        return (self.weights(derivative) if derivative else np.ones(1)), np.ones(1)

    def matched_torque_filter(self) -> "TorqueAverage":
        """Return the filter with the weights c_j = T² Σ_{i≤j} w_i (j − i + ½) of past torques."""
        return TorqueAverage(synchronous_weights(self.weights(2), self.sampling_period))

    def init(self, position: Numbers) -> WindowState:
        """Return the state with the window full of the first position, shape (n,)."""
        first = check.array("position", position)
        return WindowState(np.repeat(first[:, None], len(self.prediction), axis=1), first)

    def step(self, state: WindowState, value: Vector) -> tuple[WindowState, Estimate]:
        """Compute q̂^(j) = Σ_i w_i^(j) q(k − i); the window polynomial predicts a missing sample."""
        valid = ops.finite(value)
        position = ops.where(valid, value, state.prediction)
        window = ops.shift_in(state.window, position)
        sums = ops.weighted_sum(window, self.sums)
        return WindowState(window, sums[:, 0]), Estimate(position, sums[:, 1], sums[:, 2], valid)

    @cached_property
    def sums(self) -> np.ndarray:
        """Return the weights of prediction, velocity and acceleration as columns, zero where there is none."""
        acceleration = self.weights(2) if self.max_derivative > 1 else np.zeros(len(self.prediction))
        return np.stack([self.prediction, self.weights(1), acceleration], axis=1)


def synchronous_weights(acceleration_weights: np.ndarray, period: float) -> np.ndarray:
    """Return the torque weights c_j, newest first, that pair with acceleration weights w_i under zero-order hold.

    For q̈ held over each period, Σ_i w_i q(k−i) = Σ_j c_j q̈(k−1−j) with c_j = T² Σ_{i≤j} w_i (j − i + ½),
    j = 0 … N−1; Σ c_j = 1.
    """
    w = np.asarray(acceleration_weights, dtype=float)
    lag = np.arange(len(w) - 1)[:, None] - np.arange(len(w))[None, :]
    return period**2 * np.where(lag >= 0, lag + 0.5, 0.0) @ w


class AverageState(NamedTuple):
    """Past values, newest first, shape (n, samples), and the filtered average, shape (n,)."""

    history: Vector
    average: Vector


class TorqueAverage(System):
    """Weighted average of past torques: the counterpart of an acceleration estimate in synchronised TDE."""

    def __init__(self, weights: Numbers, pole: float = 0.0):
        self.weights = check.array("weights", weights)
        self.pole = pole

    def init(self, torque: Vector) -> AverageState:
        """Return the state as if this torque, shape (n,), had always been applied."""
        torque = check.array("torque", torque)
        return AverageState(np.repeat(torque[:, None], len(self.weights), axis=1), torque * self.weights.sum())

    def step(self, state: AverageState, value: Vector) -> tuple[AverageState, Any]:
        """Take the newest past torque; the output is Σ_j c_j τ(k−1−j), low-passed where the estimate is."""
        history = ops.shift_in(state.history, value)
        average = self.pole * state.average + (1 - self.pole) * (history @ self.weights)
        return AverageState(history, average), average
