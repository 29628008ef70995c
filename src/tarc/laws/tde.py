"""Base of the laws with time-delay estimation, to which each adds its robust term."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Tree, Vector
from tarc.core.validation import Numbers
from tarc.estimators.oracle import TrueDerivatives
from tarc.laws.base import ControlInput, LawState
from tarc.laws.nominal_inertia import Feedforward, NominalInertia
from tarc.laws.pole_placement import PolePlacement


class TDEState(NamedTuple):
    """Past torques (delayed or averaged), past acceleration estimates (n, m), the robust term's state."""

    torque: Tree
    acceleration: Vector
    robust: Tree


class ReferenceState(NamedTuple):
    """State of the estimator of qᵈ less the first one, the first qᵈ (n,), and whether it has come."""

    estimator: Tree
    first_reference: Vector
    has_reference: Vector


class ModelState(NamedTuple):
    """M̂(q), shape (n, n), and the model's torque (n,) of the period before, and the state of the law's own equation.

    Then a `ReferenceState`, empty where q̇ᵈ and q̈ᵈ are not estimated. M̂ is empty where it is constant.
    """

    inertia: Tree
    model_torque: Vector
    control: TDEState
    reference: Tree


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
    feedforward
        Torque of a model along the reference, a `Feedforward`; None for none.

    Raises
    ------
    InvalidParameter
        For an estimator without acceleration, and a delay that is no multiple of the period. For feed-forward with
        other joints, and with a term that M̂(q) has too.
    """

    delay: float | None = None
    synchronised: bool = False
    feedforward: Feedforward | None = None

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
        if self.feedforward is not None:
            self._check_feedforward(self.feedforward)

    def _check_feedforward(self, feedforward: Feedforward) -> None:
        """Refuse a model of other joints, and a term that M̂(q) has too."""
        if not isinstance(feedforward, Feedforward):
            raise InvalidParameter(f"feedforward: got {feedforward!r}; needs a tarc.Feedforward or None")
        n = feedforward.model.n_joints
        if n != self.n_joints:
            raise InvalidParameter(
                f"feedforward.model: it has {n} joints, the law {self.n_joints}; they must be the same"
            )
        own = self.inertia.terms if isinstance(self.inertia, NominalInertia) else set()
        for name in sorted(own & feedforward.terms):
            raise InvalidParameter(
                f"feedforward.{name}: the inertia's model gives this torque already; switch one of them off"
            )

    @property
    def delay_periods(self) -> int:
        """Return the delay h in periods."""
        return 1 if self.delay is None else check.whole_periods("delay", self.delay, self.period)

    @property
    def accepts_nominal_inertia(self) -> bool:
        """Return true."""
        return True

    @property
    def has_model(self) -> bool:
        """Return whether M̂(q) comes from a model; feed-forward leaves the loop as it is."""
        return isinstance(self.inertia, NominalInertia)

    @property
    def maps_torque(self) -> bool:
        """Whether the torque differs from what `control` returns."""
        return self.has_model or self.feedforward is not None

    @property
    def estimates_reference(self) -> bool:
        """Whether the feedback takes q̇ᵈ and q̈ᵈ from the law's estimator; the oracle has no delay to match."""
        forward = self.feedforward
        return forward is not None and forward.same_window and not isinstance(self.estimator, TrueDerivatives)

    def without_model(self) -> Self:
        """Return the law of the loop without a model: no feed-forward, and for M̂(q) its acceleration as the torque."""
        if not self.maps_torque:
            return self
        inertia = self.command_inertia if self.has_model else self.inertia
        return replace(self, inertia=inertia, feedforward=None)

    @property
    def uses_tde(self) -> bool:
        """Return whether N̂ is estimated; without it N̂ = 0."""
        return True

    def linearisation_constants(self, gain: float) -> dict[str, float | None]:
        """Return, in addition, that the first reference has come."""
        return {**super().linearisation_constants(gain), "first_reference": None, "has_reference": 1.0}

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
            return state._replace(robust=robust), self.command_inertia @ u, {"auxiliary": u, **signals}
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
        torque = self.command_inertia @ (u - past_acceleration) + past_torque
        return TDEState(torques, accelerations, robust), torque, {"auxiliary": u, **signals}

    def init(self, position: Numbers, torque: Numbers = 0.0) -> LawState:
        """Return the state at rest at a position [rad or m] with a torque applied [N m or N], each (n,)."""
        state = super().init(position, torque)
        if not self.maps_torque:
            return state
        return self.with_model_state(state, *self.model_at_rest(state.position, state.torque[:, 0]))

    def model_at_rest(self, position: Vector, torque: Vector) -> tuple[Tree, Vector, Vector]:
        """Return M̂(q), empty where it is constant, ĥ + f at rest, and the command that gives a torque there."""
        inertia, model_torque = self.model_terms(position, position, 0 * position, 0 * position)
        return inertia, model_torque, self._command(inertia, torque - model_torque)

    def with_model_state(self, state: LawState, inertia: Tree, model_torque: Vector, command: np.ndarray) -> LawState:
        """Return a state at rest with what `model_at_rest` gave as the model's part of it."""
        reference = ()
        if self.estimates_reference:
            reference = ReferenceState(self.estimator.init(0 * state.position), state.position, np.zeros(()))
        return state._replace(control=ModelState(inertia, model_torque, self.initial_state(command), reference))

    def torque_command(self, state: Tree, tracking: ControlInput) -> tuple[Tree, Vector, dict[str, Vector]]:
        """Return next state, torque before limits and signals.

        With a model, `control` sees the command c = M̂(q)⁻¹ (τ − ĥ − f) of the period before in place of the torque τ
        that acted then. Its result is mapped back, τ = M̂(q) c + ĥ + f. For a constant M̂ the command is τ − f.
        """
        if not self.maps_torque:
            return self.control(state, tracking)
        command = self._command(state.inertia, tracking.past_torque - state.model_torque)
        references = tracking.reference, tracking.velocity_reference, tracking.acceleration_reference
        inertia, model_torque = self.model_terms(tracking.estimate.position, *references)
        estimator, tracking = self._windowed(state.reference, tracking)
        control, command, signals = self.control(state.control, tracking._replace(past_torque=command))
        torque = (inertia @ command if self.has_model else command) + model_torque
        is_finite = ops.all_finite(model_torque)
        kept = ops.where(is_finite, model_torque, state.model_torque)
        next_state = ModelState(inertia, kept, control, estimator)
        return next_state, torque, {**signals, "model_torque": model_torque}

    def _command(self, inertia: Tree, torque: Vector) -> Vector:
        """Return M̂(q)⁻¹ τ, or τ for a constant M̂; zero where it is not finite."""
        command = ops.solve(inertia, torque) if self.has_model else torque
        return ops.where_or_zero(ops.all_finite(command), command)

    def model_terms(
        self, position: Vector, reference: Vector, velocity_reference: Vector, acceleration_reference: Vector
    ) -> tuple[Tree, Vector]:
        """Return M̂(q), empty where it is constant, and ĥ(q, q̇ᵈ) + f."""
        inertia, torque = (), 0 * reference
        if isinstance(self.inertia, NominalInertia):
            inertia = self.inertia.at(position)
            torque = torque + self.inertia.forces(position, velocity_reference)
        forward = self.feedforward
        if forward is None:
            return inertia, torque
        torque = torque + forward.forces(reference, velocity_reference)
        if forward.inertia:
            torque = torque + forward.robot.evaluate("inertia", reference) @ acceleration_reference
            if not self.estimates_reference:  # else the feedback's own M̂ q̈ᵈ cancels with M̂ â_h
                torque = torque - self.inertia_at(reference) @ acceleration_reference
        return inertia, torque

    def _windowed(self, state: Tree, tracking: ControlInput) -> tuple[Tree, ControlInput]:
        """Return the tracking with q̇ᵈ and q̈ᵈ as the law's estimator sees them, where that is chosen.

        Its window starts full of the first qᵈ, as that of the positions starts full of the first position.
        """
        if not self.estimates_reference:
            return state, tracking
        first = ops.where(state.has_reference, state.first_reference, tracking.reference)
        estimator, estimate = self.estimator.step(state.estimator, tracking.reference - first)
        has_reference = ops.logical_or(state.has_reference, tracking.reference_ok)
        return ReferenceState(estimator, first, has_reference), tracking._replace(
            error_rate=tracking.estimate.velocity - estimate.velocity,
            velocity_reference=estimate.velocity,
            acceleration_reference=estimate.acceleration,
        )
