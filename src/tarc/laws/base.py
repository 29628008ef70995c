"""Base of the laws: reference and positions in, torque out, never a NaN."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.symbol_errors import explain_symbol_error
from tarc.core.system import System
from tarc.core.types import Tree, Vector
from tarc.core.validation import Numbers
from tarc.estimators.base import Estimate, Estimator


class LawInput(NamedTuple):
    """Input of a law, each of shape (n,): the measured position and the reference with derivatives."""

    position: Vector
    reference: Vector
    velocity_reference: Vector
    acceleration_reference: Vector


class LawOutput(NamedTuple):
    """The torque to apply [N m or N], shape (n,), and the signals to record, by name."""

    torque: Vector
    signals: dict[str, Vector]


class ControlInput(NamedTuple):
    """Input of a law's equation: estimates, errors e1 and v̂ − q̇ᵈ, acceleration reference, torque that acted in the
    period before, and whether the law has given up. Then the reference, its velocity, and whether it came with this
    sample. A reference that did not come is the last one, and the position before the first.
    """

    estimate: Estimate
    error: Vector
    error_rate: Vector
    acceleration_reference: Vector
    past_torque: Vector
    fault: Vector
    reference: Vector
    velocity_reference: Vector
    reference_ok: Vector


class LawState(NamedTuple):
    """States of the estimator and of the law's equation, past torques, last valid position, last reference, number of
    missing samples, fault latch. Past torques come newest first, shape (n, d + 1).
    """

    estimator: Tree
    control: Tree
    torque: Vector
    position: Vector
    reference: Vector
    missing: Vector
    fault: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Law(Component, System):
    """A control law whose only inputs are positions and the reference.

    This base estimates the derivatives, limits the torque and bridges missing samples. It feeds the applied torque back
    to the law, which is its anti-windup. A law adds its equation in `control`.

    Parameters
    ----------
    period
        Control period T [s].
    estimator
        Estimator of velocity and acceleration.
    torque_limit
        Largest magnitude [N m or N], one number or one per joint, infinite for a joint without; None for no limit.
    max_missing
        Number of samples in a row that may be missing (NaN, infinite) before the law gives up tracking. Until then the
        estimator's prediction replaces them. Afterwards the safe torque is applied until the next reset.
    safe_torque
        Torque after giving up: ``"zero"``, ``"hold"`` (the last torque), or a function of the last valid position. The
        function, such as a gravity compensation, must accept CasADi symbols.
    actuation_delay
        Known number of periods until a torque acts on the joints. The law then pairs its estimates with the torques
        that acted. With literal time-delay estimation take an even number. With an odd number, a torque that alternates
        from period to period is never damped, since no sampled position shows it.
    """

    period: float
    estimator: Estimator
    torque_limit: Numbers | None = None
    max_missing: int = 10
    safe_torque: str | Callable[[Any], Any] = "zero"
    actuation_delay: int = 0

    def __post_init__(self) -> None:
        check.number("period", self.period, 0, strict=True)
        check.integer("max_missing", self.max_missing)
        if not isinstance(self.estimator, Estimator):
            raise InvalidParameter(
                f"estimator: got {self.estimator!r}; needs one of tarc.estimators, such as "
                "tarc.estimators.Algebraic(window=0.010, degree=2)"
            )
        object.__setattr__(self, "estimator", self.estimator.with_period(self.period))
        check.integer("actuation_delay", self.actuation_delay)
        _ = self.torque_limits
        if callable(self.safe_torque):
            self._try_safe_torque(self.safe_torque)
        else:
            check.one_of("safe_torque", self.safe_torque, ["zero", "hold"])

    def linearisation_constants(self, gain: float) -> dict[str, float | None]:
        """Return the states that a linearisation at rest holds constant, by name, with their values.

        These are the states that count, latch or adapt. None stands for the value before the first step.

        Parameters
        ----------
        gain
            Value of the switching gain ĉ or ϱ [rad/s²], for a law that has one.
        """
        return {"missing": None, "fault": None}

    @property
    def robust_slope_bound(self) -> float:
        """Return a bound on the slope of the robust term over the error [1/s²], if all else in the law is linear.

        Infinite by default, so that no certificate leaves out the robust term of a law that states no bound.
        """
        return np.inf

    def sliding(self, error: Vector, error_rate: Vector) -> Vector | None:
        """Return the sliding variable s, shape (n,) or (n, k), or None for a law without one."""
        return None

    @property
    @abstractmethod
    def n_joints(self) -> int:
        """Return the number of joints n."""

    @abstractmethod
    def initial_state(self, torque: np.ndarray) -> Tree:
        """Return the law's own state before the first step, after the torque (n,) was applied at rest."""

    @abstractmethod
    def control(self, state: Tree, tracking: ControlInput) -> tuple[Tree, Vector, dict[str, Vector]]:
        """Evaluate the law's equation: next state, torque before limits, signals to record."""

    def torque_command(self, state: Tree, tracking: ControlInput) -> tuple[Tree, Vector, dict[str, Vector]]:
        """Return next state, torque before limits and signals: `control`, unless a law maps its result to torques."""
        return self.control(state, tracking)

    @cached_property
    def torque_limits(self) -> np.ndarray:
        """Return the torque limit of each joint, shape (n,); `HUGE` of `array_ops` where there is none."""
        limits = check.float_array("torque_limit", np.inf if self.torque_limit is None else self.torque_limit)
        finite = np.where(np.isposinf(limits), ops.HUGE, limits)
        return check.vector("torque_limit", finite, self.n_joints, 0, strict=True)

    def init(self, position: Numbers, torque: Numbers = 0.0) -> LawState:
        """Return the state at rest at a position [rad or m] with a torque applied [N m or N], each (n,)."""
        position = check.vector("position", position, self.n_joints)
        torque = check.vector("torque", torque, self.n_joints)
        torque = np.clip(torque, -self.torque_limits, self.torque_limits)
        zero = np.zeros(())
        past = np.repeat(torque[:, None], self.actuation_delay + 1, axis=1)
        return LawState(self.estimator.init(position), self.initial_state(torque), past, position, position, zero, zero)

    def example(self) -> tuple[LawState, LawInput]:
        """Return a state and an input with the shapes to trace, at zero."""
        zero = np.zeros(self.n_joints)
        return self.init(zero), LawInput(zero, zero, zero, zero)

    def step(self, state: LawState, value: LawInput) -> tuple[LawState, LawOutput]:
        """Run one control period."""
        estimator, estimate = self.estimator.step(state.estimator, value.position)
        reference_ok = ops.all_finite(value.reference, value.velocity_reference, value.acceleration_reference)
        reference = ops.where(reference_ok, value.reference, state.reference)
        velocity_reference = ops.where_or_zero(reference_ok, value.velocity_reference)
        acceleration_reference = ops.where_or_zero(reference_ok, value.acceleration_reference)

        complete = ops.logical_and(reference_ok, ops.all_finite(value.position))
        missing = ops.where_or_zero(ops.logical_not(complete), state.missing + 1)
        fault = ops.logical_or(state.fault, missing > self.max_missing)

        tracking = ControlInput(
            estimate,
            estimate.position - reference,
            estimate.velocity - velocity_reference,
            acceleration_reference,
            state.torque[:, -1],
            fault,
            reference,
            velocity_reference,
            reference_ok,
        )
        control_state, torque_command, signals = self._control(state.control, tracking)
        torque_ok = ops.logical_and(ops.all_finite(torque_command), ops.logical_not(fault))
        position = ops.where(estimate.valid, value.position, state.position)
        safe = self._safe(position, state.torque[:, 0])
        torque = ops.where(torque_ok, torque_command, ops.where_or_zero(ops.all_finite(safe), safe))
        if self.torque_limit is not None:
            torque = ops.clip(torque, -self.torque_limits, self.torque_limits)
        signals = {"velocity_estimate": estimate.velocity, "missing": missing, "fault": fault, **signals}
        past = ops.shift_in(state.torque, torque)
        next_state = LawState(estimator, control_state, past, position, reference, missing, fault)
        return next_state, LawOutput(torque, signals)

    def _control(self, state: Tree, tracking: ControlInput) -> tuple[Tree, Vector, dict[str, Vector]]:
        """Evaluate `torque_command`; say what to write instead where it decides by the value of a symbol."""
        try:
            return self.torque_command(state, tracking)
        except (RuntimeError, ValueError, TypeError) as error:
            reason = explain_symbol_error(error)
            if not reason:
                raise
            raise UnsupportedLaw(f"law: {type(self).__name__} cannot be traced: {reason}") from error

    def _safe(self, position: Vector, torque: Vector) -> Vector:
        if callable(self.safe_torque):
            return self.safe_torque(position)
        return torque if self.safe_torque == "hold" else 0 * torque

    def _try_safe_torque(self, function: Callable[[Any], Any]) -> None:
        """Refuse a function that does not give n torques, from numbers and from symbols."""
        needs = (
            f"needs a function of a position ({self.n_joints},) that gives as many torques, also from CasADi symbols"
        )
        try:
            numbers, symbols = function(np.zeros(self.n_joints)), function(ca.SX.sym("q", self.n_joints))
            fits = np.shape(numbers) == (self.n_joints,) and ca.SX(symbols).shape == (self.n_joints, 1)
        except Exception as error:  # whatever a user's function may raise
            message, _, _ = str(error).partition("\n")
            reason = f"{type(error).__name__}: {message}"
            raise InvalidParameter(f"safe_torque: it fails with {reason}; {needs}") from error
        if not fits:
            raise InvalidParameter(f"safe_torque: it gives {numbers!r} at zero; {needs}")
