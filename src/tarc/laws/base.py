"""What every law does: reference and positions in, torque out, never a NaN."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tarc import check, ops
from tarc.check import Numbers
from tarc.errors import TarcError
from tarc.estimators.base import Estimate, Estimator
from tarc.parametric import Parametric
from tarc.system import System


class LawInput(NamedTuple):
    """All that a law is handed, each of shape (n,): the measured position and the reference with derivatives."""

    position: Any
    reference: Any
    velocity_reference: Any
    acceleration_reference: Any


class LawOutput(NamedTuple):
    """The torque to apply [N m or N], shape (n,), and what is worth recording, by name."""

    torque: Any
    signals: dict[str, Any]


class Tracking(NamedTuple):
    """What a law's equation reads: estimates, errors e1 and v̂ − q̇ᵈ, acceleration reference and the torque before."""

    estimate: Estimate
    error: Any
    error_rate: Any
    acceleration_reference: Any
    past_torque: Any


class LawState(NamedTuple):
    """Estimator and law memory, the last applied torque and reference, missing samples in a row, fault latch."""

    estimator: Any
    memory: Any
    torque: Any
    reference: Any
    missing: Any
    fault: Any


@dataclass(frozen=True, kw_only=True, eq=False)
class Law(Parametric, System):
    """A control law that sees positions and the reference, nothing else.

    This base estimates the derivatives, limits the torque, feeds the applied torque back to the law (which is its
    anti-windup) and rides through missing samples; a law adds its equation in `control`.

    Parameters
    ----------
    period
        Control period T [s].
    estimator
        Where velocity and acceleration come from.
    torque_limit
        Largest magnitude [N m or N], one number or one a joint, infinite for a joint without; None for no limit.
    max_missing
        How many samples in a row may be missing (NaN, infinite) before the law gives up tracking. Until then the
        estimator's own prediction stands in. After it, the safe torque is applied until the next reset.
    safe_torque
        What to apply then: ``"zero"``, ``"hold"`` (the last applied torque), or a function of the position, such as
        a gravity compensation, that accepts CasADi symbols.
    """

    period: float
    estimator: Estimator
    torque_limit: Numbers | None = None
    max_missing: int = 10
    safe_torque: str | Callable[[Any], Any] = "zero"

    def __post_init__(self) -> None:
        check.number("period", self.period, 0, strict=True)
        check.whole("max_missing", self.max_missing)
        if not isinstance(self.estimator, Estimator):
            raise TarcError(
                f"estimator: got {self.estimator!r}; needs one of tarc.estimators, such as "
                "tarc.estimators.Algebraic(window=0.010, degree=2)"
            )
        object.__setattr__(self, "estimator", self.estimator.at(self.period))
        if not callable(self.safe_torque):
            check.one_of("safe_torque", self.safe_torque, ["zero", "hold"])
        _ = self.limit

    @property
    @abstractmethod
    def joints(self) -> int:
        """How many joints n it drives."""

    @abstractmethod
    def memory(self, torque: np.ndarray) -> Any:
        """The law's own state before the first step, after the torque (n,) was applied at rest."""

    @abstractmethod
    def control(self, memory: Any, tracking: Tracking) -> tuple[Any, Any, dict[str, Any]]:
        """The law's equation: next memory, torque before limits, signals to record."""

    @cached_property
    def limit(self) -> np.ndarray:
        """Torque limit a joint, shape (n,); `tarc.ops.HUGE` where there is none."""
        given = ops.HUGE if self.torque_limit is None else self.torque_limit
        finite = [ops.HUGE if np.isposinf(one) else one for one in np.ravel(check.numbers("torque_limit", given))]
        return check.vector("torque_limit", finite if np.ndim(given) else finite[0], self.joints, 0, strict=True)

    def init(self, position: Any, torque: Any = 0.0) -> LawState:
        """State at rest at a first position [rad or m], shape (n,), with a torque already applied [N m or N]."""
        position = check.vector("position", position, self.joints)
        torque = check.vector("torque", torque, self.joints)
        torque = np.clip(torque, -self.limit, self.limit)
        zero = np.zeros(())
        return LawState(self.estimator.init(position), self.memory(torque), torque, position, zero, zero)

    def example(self) -> tuple[LawState, LawInput]:
        """A state and an input of the right shapes, all zero but valid: what tracing starts from."""
        rest = np.zeros(self.joints)
        return self.init(rest), LawInput(rest, rest, rest, rest)

    def step(self, state: LawState, value: LawInput) -> tuple[LawState, LawOutput]:
        """One control period."""
        estimator, estimate = self.estimator.step(state.estimator, value.position)
        heard = ops.all_finite(value.reference, value.velocity_reference, value.acceleration_reference)
        reference = ops.where(heard, value.reference, state.reference)
        velocity_reference = ops.only(heard, value.velocity_reference)
        acceleration_reference = ops.only(heard, value.acceleration_reference)

        complete = ops.both(heard, ops.all_finite(value.position))
        missing = ops.only(ops.negate(complete), state.missing + 1)
        fault = ops.either(state.fault, missing > self.max_missing)

        tracking = Tracking(
            estimate,
            estimate.position - reference,
            estimate.velocity - velocity_reference,
            acceleration_reference,
            state.torque,
        )
        memory, wanted, signals = self.control(state.memory, tracking)
        sound = ops.both(ops.all_finite(wanted), ops.negate(fault))
        torque = ops.where(sound, wanted, self._safe(state, estimate))
        if self.torque_limit is not None:
            torque = ops.clip(torque, -self.limit, self.limit)
        signals = {"velocity_estimate": estimate.velocity, "missing": missing, "fault": fault, **signals}
        next_state = LawState(estimator, memory, torque, reference, missing, fault)
        return next_state, LawOutput(torque, signals)

    def _safe(self, state: LawState, estimate: Estimate) -> Any:
        if callable(self.safe_torque):
            return self.safe_torque(estimate.position)
        return state.torque if self.safe_torque == "hold" else 0 * state.torque
