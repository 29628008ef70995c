"""Base of the linear observers: a model of constant acceleration, corrected by the newest position."""

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core.system import System
from tarc.core.types import Vector
from tarc.core.validation import Numbers, array
from tarc.estimators.base import Estimate, Estimator


class ObserverState(NamedTuple):
    """Position, velocity and acceleration after the last sample, shape (n, 3)."""

    motion: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Observer(Estimator):
    """A steady observer of constant acceleration.

        x⁻ = Φ x,     x = x⁻ + L (q − x⁻_1),     Φ = [1 T T²/2; 0 1 T; 0 0 1]

    with x = (q, q̇, q̈). A missing sample leaves the prediction as it is. A subclass gives the gain L.
    """

    @property
    @abstractmethod
    def gain(self) -> np.ndarray:
        """Return L [1, 1/s, 1/s²], shape (3,)."""

    @property
    def max_derivative(self) -> int:
        """Return 2: velocity and acceleration."""
        return 2

    @property
    def transition(self) -> np.ndarray:
        """Return Φ, shape (3, 3)."""
        T = self.sampling_period
        return np.array([[1.0, T, T**2 / 2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])

    @cached_property
    def _gain(self) -> np.ndarray:
        return self.gain

    def transfer_function(self, derivative: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a row of (I − (I − L c) Φ z⁻¹)⁻¹ L; the position is passed on as measured."""
        from scipy.signal import ss2tf

        if self._order(derivative) == 0:
            return np.ones(1), np.ones(1)
        A = (np.eye(3) - np.outer(self._gain, [1.0, 0.0, 0.0])) @ self.transition
        B, C = A @ self._gain[:, None], np.eye(3)[derivative][None]
        numerator, denominator = ss2tf(A, B, C, C @ self._gain[:, None])
        return np.asarray(numerator)[0], np.asarray(denominator)

    def matched_torque_filter(self) -> "TorqueFilter":
        """Return the response of the acceleration estimate to past torques, as a filter.

        It is z H(z) T² (z + 1)/(2 (z − 1)²) for the H of the acceleration, whose two zeros at z = 1 cancel. The factor
        z is there since the newest torque acted in the period before this instant.
        """
        numerator, denominator = self.transfer_function(2)
        quotient, _ = np.polydiv(numerator, [1.0, -2.0, 1.0])
        response = self.sampling_period**2 / 2 * np.polymul(quotient, [1.0, 1.0])
        return TorqueFilter(np.append(response, np.zeros(len(denominator) - len(response))), denominator)

    def init(self, position: Numbers) -> ObserverState:
        """Return the state at rest at the first position, shape (n,)."""
        first = array("position", position)
        return ObserverState(np.column_stack([first, 0 * first, 0 * first]))

    def step(self, state: ObserverState, value: Vector) -> tuple[ObserverState, Estimate]:
        """Predict, and correct where the sample is valid."""
        valid = ops.finite(value)
        predicted = state.motion @ self.transition.T
        innovation = ops.where_or_zero(valid, value - predicted[:, 0])
        columns = [predicted[:, i] + self._gain[i] * innovation for i in range(3)]
        position = ops.where(valid, value, predicted[:, 0])
        return ObserverState(ops.columns(*columns)), Estimate(position, columns[1], columns[2], valid)


class FilterState(NamedTuple):
    """Delay elements of a linear filter in transposed direct form, shape (n, order)."""

    delays: Vector


class TorqueFilter(System):
    """Linear filter b/a of past torques, both in falling powers of z and of the same length."""

    def __init__(self, numerator: np.ndarray, denominator: np.ndarray):
        self.b, self.a = numerator / denominator[0], denominator / denominator[0]

    def init(self, torque: Vector) -> FilterState:
        """Return the state as if this torque, shape (n,), had always been applied."""
        from scipy.signal import lfilter_zi

        return FilterState(np.outer(array("torque", torque), lfilter_zi(self.b, self.a)))

    def step(self, state: FilterState, value: Vector) -> tuple[FilterState, Vector]:
        """Take the newest past torque; return the filtered one."""
        delays = state.delays
        output = self.b[0] * value + delays[:, 0]
        order = len(self.a) - 1
        columns = [
            self.b[i + 1] * value - self.a[i + 1] * output + (delays[:, i + 1] if i + 1 < order else 0.0)
            for i in range(order)
        ]
        return FilterState(ops.columns(*columns)), output
