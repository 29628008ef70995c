"""Real-time execution of a law, for the user's own robot loop."""

import logging
from collections.abc import Sequence
from dataclasses import fields
from html import escape
from typing import NamedTuple

import casadi as ca
import numpy as np

from tarc.control.digital_controller import checked_limits, limited_start, limited_step
from tarc.control.stamped_window import StampedWindow
from tarc.core import array_ops as ops
from tarc.core.codegen import compiled
from tarc.core.errors import ControllerNotReset, InvalidParameter
from tarc.core.tracing import CompiledStep, PeriodBuffer, trace
from tarc.core.trees import leaves, names, pack
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.estimators.oracle import TrueDerivatives
from tarc.laws.base import Law, LawInput, LawOutput, LawState
from tarc.signals.readings import ReadingCheck
from tarc.signals.torque_limits import TorqueLimits

log = logging.getLogger("tarc")

Samples = Sequence[float] | np.ndarray
"""One number per joint."""


class _CheckedState(NamedTuple):
    """Last valid position and last reference, each (n,) and unwrapped, and the state of the law."""

    position: Vector
    reference: Vector
    law: LawState


class PreparedLaw(NamedTuple):
    """A law whose step is ready to take the place of another's, as `Controller.prepare` returns it."""

    law: Law
    function: ca.Function
    step: PeriodBuffer


class Controller:
    """Runs a law once per period on a real robot, or on any simulator.

    No memory is allocated after construction. `step` copies its arguments into fixed arrays, calls the traced law, and
    returns the same torque array every time. Copy that array to keep it beyond the next step.

    Parameters
    ----------
    law
        Any law of `tarc.laws`.
    native
        Compile the step to machine code, with the C compiler that is found.
    span
        Travel after which the position that you pass repeats [rad or m], one number or one per joint, such as 2π for
        continuous joints with absolute encoders. None or infinity for positions that never repeat. Each position is
        taken in the turn nearest to the last valid one, and each reference in the turn nearest to the last one. At
        `reset` both start in the turn of the initial position. No step of the reference is then above half a span.
    max_step
        Largest distance of a position from the last valid one [rad or m], one number or one per joint; None for any. A
        sample farther away counts as missing. After missing samples the joint must still be that close.
    torque_limits
        Limits of magnitude, rate and resolution that your robot's interface has. The controller keeps to them, and its
        law knows the torque that passed. None for no limits besides the law's own.

    Attributes
    ----------
    missing
        Samples missing in a row.
    is_native
        Whether the step is machine code.
    function
        The traced step, ``[state, input] -> [next state, output]``, as `tarc.core.tracing.trace` returns it.
    fault
        Whether more than ``law.max_missing`` were missing in a row; then the safe torque is applied until the next
        `reset`.
    fault_reason
        Why it gave up, in words.

    Raises
    ------
    InvalidParameter
        For something else than a law, and for a law with the oracle as its estimator. For a span or largest step that
        is not positive, or has another size than 1 or n. For limits of another number of joints, or whose rate is
        below one step of torque per period.
    MissingTool, CompilationError, UnsupportedLaw
        With ``native``: without a C compiler, where it fails, and for a law that has no C.

    Examples
    --------
    >>> import numpy as np, tarc
    >>> law = tarc.laws.TDC(inertia=[0.1, 0.1], natural_frequency=10.0, period=1e-3,
    ...                     estimator=tarc.estimators.Algebraic(window=0.010))
    >>> controller = tarc.Controller(law)
    >>> controller.reset(np.zeros(2))
    >>> controller.step(np.zeros(2), np.full(2, 0.01), np.zeros(2), np.zeros(2))
    array([0.1, 0.1])
    """

    def __init__(
        self,
        law: Law,
        native: bool = False,
        *,
        span: Numbers | None = None,
        max_step: Numbers | None = None,
        torque_limits: TorqueLimits | None = None,
    ):
        if not isinstance(law, Law):
            raise InvalidParameter(f"law: got {law!r}; needs one of tarc.laws, constructed")
        if isinstance(law.estimator, TrueDerivatives):
            raise InvalidParameter(
                "estimator: got TrueDerivatives, which exists in simulation alone; give the law one that works from "
                "positions, such as tarc.estimators.Algebraic(window=0.010)"
            )
        self.law = law
        self._check = ReadingCheck(span, max_step)
        self._check.check_joints(law.n_joints, "Controller: ")
        self._limits = checked_limits(torque_limits, law)
        state, value = law.example()
        if self._check.is_needed:
            function, example = trace(self._checked_step, self._checked_state(state), value)
        else:
            function, example = trace(self._limited_step, state, value)
        self.function = function
        self.is_native = native
        self._call = CompiledStep(compiled(function) if native else function)
        n = law.n_joints
        self._past_torque = self._place_of_past_torque(state)
        self._law_state = state
        self._stamped: StampedWindow | None = None
        self._window_places: tuple[np.ndarray, np.ndarray] | None = None
        self._applied, self._magnitudes, self._is_known = np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool)
        self._sizes = n, n, n, n
        vector = self._call.value
        self._position, self._reference = vector[:n], vector[n : 2 * n]
        self._velocity_reference, self._acceleration_reference = vector[2 * n : 3 * n], vector[3 * n :]
        output = self._call.output
        self._torque = output[:n]
        self._torque.flags.writeable = False
        places = {name: place for place, name in _places(example.signals, n)}
        self._missing, self._fault = output[places["missing"]], output[places["fault"]]
        self.signals = {name: output[place] for name, place in places.items()}
        self._fault_reason = ""
        self._ready = False

    def prepare(self, law: Law, function: ca.Function | None = None) -> PreparedLaw:
        """Return a law of the same structure, ready for `change_law`; this traces and allocates.

        Parameters
        ----------
        law
            The same kind of law with other gains. Joints, period, estimator and the shape of the state stay.
        function
            Its traced step, where another process has prepared it; None to trace it here.

        Raises
        ------
        InvalidParameter
            For a law of another structure.
        """
        _refuse_other_structure(self.law, law)
        if function is None:
            other = Controller(law, span=self._check.span, max_step=self._check.max_step, torque_limits=self._limits)
            function = compiled(other.function) if self.is_native else other.function
        return PreparedLaw(law, function, self._call.prepare(function))

    def change_law(self, prepared: PreparedLaw) -> None:
        """Run another law of the same structure from the next step on, with the state of the one before.

        Estimator, past torques and switching gain go on. So a law on time-delay estimation changes its torque at once
        by −M̂ (ΔK1 e1 + ΔK2 (v̂ − q̇ᵈ)) alone. A gain above a new ``max_gain`` acts for one more step. Nothing is traced
        or allocated.
        """
        self.law, self.function = prepared.law, prepared.function
        self._call.exchange(prepared.step)

    @staticmethod
    def _checked_state(law: LawState) -> "_CheckedState":
        """Return the state at reset: position and reference start in the turn of the initial position."""
        return _CheckedState(law.position, law.position, law)

    def _place_of_past_torque(self, state: LawState) -> slice:
        """Return where the packed state has the newest past torque."""
        marked = state._replace(torque=np.where(np.arange(state.torque.shape[1]) == 0, np.nan, state.torque))
        indices = np.flatnonzero(np.isnan(self._packed(marked)))
        return slice(int(indices[0]), int(indices[-1]) + 1)

    def _limited_step(self, state: LawState, value: LawInput) -> tuple[LawState, LawOutput]:
        """Step the law, its torque limited."""
        return limited_step(self.law, self._limits, state, value)

    def _checked_step(self, state: "_CheckedState", value: LawInput) -> tuple["_CheckedState", LawOutput]:
        """Unwrap position and reference, drop a position that jumps, and step the law."""
        last_position, position = self._check.step(state.position, value.position)
        reference = self._check.unwrap(state.reference, value.reference)
        last_reference = ops.where(ops.finite(reference), reference, state.reference)
        law, output = self._limited_step(state.law, value._replace(position=position, reference=reference))
        return _CheckedState(last_position, last_reference, law), output

    def give_up(self) -> None:
        """Apply the safe torque from the next step on, until the next `reset`, as after too many missing samples.

        Raises
        ------
        ControllerNotReset
            Before the first `reset`.
        """
        if not self._ready:
            raise ControllerNotReset("Controller.give_up: called before reset; call reset(position) first")
        marked = self._law_state._replace(fault=np.array(np.nan))
        self._call.state[np.flatnonzero(np.isnan(self._packed(marked)))] = 1.0

    def state_at_start(self, position: Numbers, torque: Numbers = 0.0) -> np.ndarray:
        """Return the packed state of `function` at rest at a position with a torque applied, each (n,)."""
        return self._packed(limited_start(self.law, self._limits, position, torque))

    @property
    def past_torque_place(self) -> int:
        """Place in the packed state of the n torques that the step before returned."""
        return self._past_torque.start

    def _packed(self, state: LawState) -> np.ndarray:
        return pack(self._checked_state(state) if self._check.is_needed else state)

    @property
    def _status(self) -> str:
        if not self._ready:
            return "not reset"
        return f"fault, {self.missing} samples missing" if self.fault else "ready"

    def __repr__(self) -> str:
        law = self.law
        return f"Controller({type(law).__name__}, n_joints={law.n_joints}, period={law.period:g} s, {self._status})"

    def _repr_html_(self) -> str:
        law = self.law
        values = {field.name: getattr(law, field.name) for field in fields(law)}
        rows = [f"<tr><td>{escape(name)}</td><td>{escape(str(value))}</td></tr>" for name, value in values.items()]
        heading = f"<b>Controller of {type(law).__name__}</b>, {law.n_joints} joints, {self._status}"
        return f"<p>{heading}</p><table>{''.join(rows)}</table>"

    def reset(self, initial_position: Numbers, initial_torque: Numbers = 0.0) -> None:
        """Start at rest at a measured position (n,) with a torque (n,) already applied.

        Raises
        ------
        InvalidParameter
            For a position that is not finite: wait for a valid sample first.
        """
        state = limited_start(self.law, self._limits, initial_position, initial_torque)
        self._call.reset(self._packed(state))
        self._call.output[:] = 0
        self._fault_reason, self._ready = "", True
        if self._stamped is not None:
            self._stamped.reset(state.position)

    def step(
        self,
        position: Samples,
        reference: Samples,
        velocity_reference: Samples,
        acceleration_reference: Samples,
        *,
        applied_torque: Samples | None = None,
        time: float | None = None,
    ) -> np.ndarray:
        """Return the torque [N m or N] for this period from the measured position and the reference, all of shape (n,).

        A position with NaN or infinity is a missing sample.

        Parameters
        ----------
        position, reference, velocity_reference, acceleration_reference
            [rad or m] and derivatives, each of shape (n,).
        applied_torque
            Torque that your robot really applied in answer to the step before [N m or N], shape (n,), where it
            reports one. The law, its anti-windup and a limit of the rate go on from there. NaN or None where it is
            unknown; then the torque that was returned counts as applied.
        time
            When the position was measured [s], on a clock of your own, for an `Algebraic` estimator. The derivatives
            are then those of the polynomial that fits the samples at their own times best. They are exact on
            polynomials up to the degree. A time that repeats marks a stale sample, which counts as missing. Give the
            time in every step or in none. None takes the samples as even. Past torques count as even in
            both cases. With a time, memory is allocated.

        Raises
        ------
        ControllerNotReset
            Before the first `reset`.
        InvalidParameter
            For other shapes than (n,), a time that decreases, and a time for another estimator.
        """
        if not self._ready:
            raise ControllerNotReset(
                "Controller.step: called before reset; call reset(position) with the first measured position"
            )
        try:
            sizes = len(position), len(reference), len(velocity_reference), len(acceleration_reference)
            if sizes != self._sizes:
                raise ValueError
            self._position[:] = position
            self._reference[:] = reference
            self._velocity_reference[:] = velocity_reference
            self._acceleration_reference[:] = acceleration_reference
        except (TypeError, ValueError, OverflowError):
            shapes = [np.shape(x) for x in (position, reference, velocity_reference, acceleration_reference)]
            raise InvalidParameter(
                f"Controller.step: got shapes {shapes} for position and references; needs ({self.law.n_joints},) each"
            ) from None
        if applied_torque is not None:
            self._note_applied(applied_torque)
        if time is not None:
            self._take_time(time)
        self._call.step()
        if self._fault[0] and not self._fault_reason:
            self._fault_reason = f"{self.missing} samples missing in a row" if self.missing else "the law gave up"
            log.error(
                "%s: the safe torque (%s) is applied until reset",
                self._fault_reason,
                getattr(self.law.safe_torque, "__name__", self.law.safe_torque),
            )
        return self._torque

    def _take_time(self, time: float) -> None:
        """Put the window that matches the time of this sample into the estimator's state."""
        if self._stamped is None:
            self._stamped = StampedWindow(self.law.estimator, self.law.n_joints)
            self._window_places = self._places_of_window()
            self._stamped.reset(self._call.state[self._window_places[0][:, 0]])
        stamped, places = self._stamped, self._window_places
        if not stamped.is_new(time):
            self._position[:] = np.nan
            return
        _, position = self._check.step(
            stamped.last_position, np.where(ops.finite(self._position), self._position, np.nan)
        )
        past, prediction = stamped.even(time, position)
        if places is not None:
            known = np.isfinite(prediction)
            self._call.state[places[0][known, :-1]] = past[known]
            self._call.state[places[1][known]] = prediction[known]

    def _places_of_window(self) -> tuple[np.ndarray, np.ndarray]:
        """Return where the packed state has the estimator's window (n, N + 1), newest first, and prediction (n,)."""
        estimator = self._law_state.estimator
        n, samples = estimator.window.shape
        marks = 1.0 + np.arange(n * (samples + 1))
        marked = estimator._replace(window=marks[: n * samples].reshape(n, samples), prediction=marks[n * samples :])
        blank = self._law_state._replace(estimator=marked)
        packed = self._packed(blank)
        empty = self._law_state._replace(
            estimator=estimator._replace(window=0 * estimator.window, prediction=0 * estimator.prediction)
        )
        differs = packed - self._packed(empty)
        order = np.array([int(np.flatnonzero(differs == mark)[0]) for mark in marks])
        return order[: n * samples].reshape(n, samples), order[n * samples :]

    def _note_applied(self, torque: Samples) -> None:
        """Replace the newest past torque where the torque is known, without allocation."""
        past = self._call.state[self._past_torque]
        try:
            self._applied[:] = torque
            if len(torque) != len(past):
                raise ValueError
        except (TypeError, ValueError, OverflowError):
            raise InvalidParameter(
                f"Controller.step: got shape {np.shape(torque)} for applied_torque; needs ({self.law.n_joints},)"
            ) from None
        np.abs(self._applied, out=self._magnitudes)
        np.less_equal(self._magnitudes, ops.HUGE, out=self._is_known)
        np.copyto(past, self._applied, where=self._is_known)

    @property
    def missing(self) -> int:
        """Return the number of samples missing in a row."""
        return int(self._missing[0])

    @property
    def fault(self) -> bool:
        """Return whether the law gave up and applies its safe torque."""
        return bool(self._fault[0])

    @property
    def fault_reason(self) -> str:
        """Return why the law gave up, also once samples come again; empty where it has not."""
        return self._fault_reason


def _refuse_other_structure(law: Law, other: Law) -> None:
    """Refuse a law that cannot go on with the state of another."""
    if type(other) is not type(law) or (other.n_joints, other.period) != (law.n_joints, law.period):
        raise InvalidParameter(
            f"law: got {type(other).__name__} with {other.n_joints} joints and a period of {other.period:g} s; needs "
            f"{type(law).__name__} with {law.n_joints} joints and {law.period:g} s, as it runs",
            "law",
        )
    if repr(other.estimator) != repr(law.estimator):
        raise InvalidParameter(
            f"estimator: got {other.estimator}; needs {law.estimator}, whose state goes on", "estimator"
        )
    (state, value), (other_state, _) = law.example(), other.example()
    shapes = [
        [(name, np.shape(leaf)) for name, leaf in zip(names(tree), leaves(tree), strict=True)]
        for tree in (state, other_state, law.step(state, value)[1].signals, other.step(other_state, value)[1].signals)
    ]
    if shapes[0] != shapes[1] or shapes[2] != shapes[3]:
        differs = sorted({name for name, _ in set(shapes[0] + shapes[2]) ^ set(shapes[1] + shapes[3])})
        raise InvalidParameter(
            f"law: its state or signals have another shape ({', '.join(differs)}); the state goes on, so change gains "
            "alone: neither delay nor window",
            "law",
        )


def _places(signals: dict[str, Vector], start: int) -> list[tuple[slice, str]]:
    """Return the place of each signal in the output vector."""
    result = []
    for name, leaf in signals.items():
        result.append((slice(start, start + np.size(leaf)), name))
        start += np.size(leaf)
    return result
