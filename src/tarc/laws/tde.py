"""Base of the laws with time-delay estimation, to which each adds its robust term."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Tree, Vector
from tarc.estimators.oracle import TrueDerivatives
from tarc.laws.base import ControlInput
from tarc.laws.pole_placement import PolePlacement


class TDEState(NamedTuple):
    """Past torques (delayed or averaged), past acceleration estimates (n, m), the robust term's state."""

    torque: Tree
    acceleration: Vector
    robust: Tree


@dataclass(frozen=True, kw_only=True, eq=False)
class TDE(PolePlacement):
    """Time-delay estimation with pole placement and a robust term Δu.

        τ = M̂ (u − â_h) + τ_h,     u = q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + Δu,     e1 = q − qᵈ

    The delayed torque and acceleration give an estimate of all that is not modelled: N̂ = τ_h − M̂ â_h.

    Takes the parameters of `PolePlacement` and `Law`, and those below. M̂ is a gain rather than a model. With estimated
    acceleration the loop is stable only for eigenvalues of M(q)⁻¹M̂ in an interval that the window sets, often well
    below one.

    Parameters
    ----------
    delay
        h [s], a whole multiple of the period; None for one period. Its sum with the actuation delay should be an odd
        number of periods. For an even number, a literal law never damps a torque that alternates from period to period,
        since no sampled position shows it.
    synchronised
        Average the past torques with the weights that match the estimator's window, instead of taking τ_h alone. Torque
        and acceleration then have the same delay, so that a far larger M̂ is stable.

    Raises
    ------
    InvalidParameter
        For an estimator without acceleration, and a delay that is no multiple of the period.
    """

    delay: float | None = None
    synchronised: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.uses_tde and self.estimator.max_derivative < 2:
            raise InvalidParameter(
                f"estimator: {self.estimator} gives no acceleration, which time-delay estimation needs; use degree 2 "
                "or more"
            )
        if self.delay_periods != 1 and self.synchronised:
            raise InvalidParameter(
                f"delay: got {self.delay} s with synchronised=True, whose averaged torque has the window's own delay; "
                "leave the delay out, or use synchronised=False"
            )

    @property
    def delay_periods(self) -> int:
        """Return the delay h in periods."""
        return 1 if self.delay is None else check.whole_periods("delay", self.delay, self.period)

    @property
    def uses_tde(self) -> bool:
        """Return whether N̂ is estimated; without it N̂ = 0."""
        return True

    @abstractmethod
    def robust_init(self) -> Tree:
        """Return the state of the robust term before the first step."""

    @abstractmethod
    def robust(self, state: Tree, tracking: ControlInput) -> tuple[Tree, Vector, dict[str, Vector]]:
        """Return the next state, Δu [rad/s² or m/s²], shape (n,), and the signals to record."""

    def initial_state(self, torque: np.ndarray) -> TDEState:
        """Return the state at rest: no acceleration, and the applied torque as the past ones; empty where N̂ is not
        estimated."""
        if not self.uses_tde:
            return TDEState((), (), self.robust_init())
        past = np.zeros((self.n_joints, self.delay_periods))
        if self.synchronised:
            return TDEState(self.estimator.matched_torque_filter().init(torque), past, self.robust_init())
        return TDEState(past + torque[:, None], past, self.robust_init())

    def control(self, state: TDEState, tracking: ControlInput) -> tuple[TDEState, Vector, dict[str, Vector]]:
        """Evaluate τ = M̂ (u − â_h) + τ_h, or M̂ u where N̂ is not estimated."""
        if not self.uses_tde:
            robust, correction, signals = self.robust(state.robust, tracking)
            u = self.feedback(tracking) + correction
            return state._replace(robust=robust), self.M @ u, {"auxiliary": u, **signals}
        newest = tracking.estimate.acceleration
        accelerations = ops.shift_in(state.acceleration, newest)
        if self.synchronised:
            torques, past_torque = self.estimator.matched_torque_filter().step(state.torque, tracking.past_torque)
            past_acceleration = newest
        else:
            torques = ops.shift_in(state.torque, tracking.past_torque)
            past_torque = torques[:, -1]
            # the oracle's acceleration at t_k is that of the torque before t_k, an estimate goes with the one set then
            is_oracle = isinstance(self.estimator, TrueDerivatives)
            past_acceleration = (accelerations if is_oracle else state.acceleration)[:, -1]
        robust, correction, signals = self.robust(state.robust, tracking)
        u = self.feedback(tracking) + correction
        torque = self.M @ (u - past_acceleration) + past_torque
        return TDEState(torques, accelerations, robust), torque, {"auxiliary": u, **signals}
