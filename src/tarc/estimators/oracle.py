"""True derivatives in place of estimates, to measure the cost of estimation in simulation."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, NotLinearisable
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.estimators.base import Estimate, Estimator, TorqueAverage


class OracleState(NamedTuple):
    """Last position measured, true velocity and acceleration, each of shape (n,)."""

    position: Vector
    velocity: Vector
    acceleration: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueDerivatives(Estimator):
    """Oracle with the true velocity and acceleration of the simulation; it cannot run on a robot.

    It measures the cost of estimating derivatives, and works in `tarc.simulate` and scenarios alone. The position is
    the measured one, as for every estimator. The acceleration is that just before the torque changes, caused by the
    torque of the period before. Literal time-delay estimation pairs the two.

    Raises
    ------
    InvalidParameter
        By `tarc.Controller`, and with ``synchronised=True``.
    NotLinearisable
        By the certificates of a loop, and by the methods that need a transfer function.
    """

    @property
    def max_derivative(self) -> int:
        """Return 2: velocity and acceleration."""
        return 2

    def transfer_function(self, derivative: int) -> tuple[np.ndarray, np.ndarray]:
        """Return 1 for derivative 0; raise `NotLinearisable` for the others, which do not come from positions."""
        if self._order(derivative) == 0:
            return np.ones(1), np.ones(1)
        raise NotLinearisable(
            "TrueDerivatives: it exists in simulation alone, makes nothing from positions and has no transfer function"
        )

    def matched_torque_filter(self) -> TorqueAverage:
        """Raise `InvalidParameter`: the true acceleration has no delay that past torques could be given."""
        raise InvalidParameter(
            "synchronised: TrueDerivatives has no delay that past torques could be given; use synchronised=False"
        )

    def init(self, position: Numbers) -> OracleState:
        """Return the state at a first position, shape (n,); derivatives are NaN until the simulation sets them."""
        first = check.array("position", position)
        return OracleState(first, np.full(first.shape, np.nan), np.full(first.shape, np.nan))

    def step(self, state: OracleState, value: Vector) -> tuple[OracleState, Estimate]:
        """Return the true derivatives; a missing sample is extrapolated with the true velocity."""
        valid = ops.finite(value)
        position = ops.where(valid, value, state.position + self.sampling_period * state.velocity)
        return state._replace(position=position), Estimate(position, state.velocity, state.acceleration, valid)


def refuse_oracle(estimator: Estimator) -> None:
    """Raise `NotLinearisable` for the oracle, whose estimates do not come from positions."""
    if isinstance(estimator, TrueDerivatives):
        raise NotLinearisable(
            "estimator: TrueDerivatives exists in simulation alone, where tarc.simulate hands it the truth; give the "
            "law one that works from positions, such as tarc.estimators.Algebraic(window=0.010)"
        )
