"""A law as functions of packed vectors: its step, its start, and where their numbers stand."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from tarc.control.controller import Controller
from tarc.control.digital_controller import limited_start
from tarc.control.watch import Watch, WatchInput, WatchOutput
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.tracing import trace
from tarc.core.trees import leaves, pack, unpack
from tarc.core.types import Array, Tree
from tarc.laws.base import Law
from tarc.laws.tde import TDE
from tarc.signals.torque_limits import TorqueLimits

START_PROBES = 4
"""Random starts at which the affine map of a start is compared with the law's own."""
START_TOLERANCE = 1e-12


class Signal(NamedTuple):
    """A signal of a law by its name, with the place and number of its elements in the output of a step."""

    name: str
    start: int
    size: int


@dataclass(frozen=True)
class TracedLaw:
    """A law with its torque limits, traced.

    Attributes
    ----------
    law, torque_limits, watch
        The law, its limits, and what is watched.
    step
        ``[state, input] -> [next state, output]``; the input is position, reference and its two derivatives, and with a
        watch the time since the last sample.
    start
        ``[position, torque] -> [state]``, the state at rest with a torque applied.
    past_torque
        Place in the state of the torque that the step before returned.
    signals
        What the output holds after the torque, in order.
    """

    law: Law
    torque_limits: TorqueLimits | None
    watch: Watch | None
    step: ca.Function
    start: ca.Function
    past_torque: int
    signals: tuple[Signal, ...]

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return self.law.n_joints

    @property
    def n_states(self) -> int:
        """Return the number of states."""
        return self.step.nnz_in(0)

    @property
    def start_limits(self) -> Array:
        """Return the largest magnitude of the torque at the start, shape (n,)."""
        limits = self.law.torque_limits
        if self.torque_limits is not None:
            limits = np.minimum(limits, self.torque_limits.magnitudes(self.n_joints))
        return limits


def traced_law(law: Law, torque_limits: TorqueLimits | None = None, watch: Watch | None = None) -> TracedLaw:
    """Trace what `Controller` runs, its state at the start, and what is watched after it.

    Raises
    ------
    InvalidParameter
        As `Controller`, and for a watch of another number of joints.
    UnsupportedLaw
        For a law whose start is not affine in position and torque.
    """
    controller = Controller(law, torque_limits=torque_limits)
    n = law.n_joints
    signals, place = [], n
    for name, values in controller.signals.items():
        signals.append(Signal(name, place, values.size))
        place += values.size
    start, step = _start(law, torque_limits), controller.function
    if watch is not None:
        if watch.n_joints != n:
            raise InvalidParameter(f"watch: got one of {watch.n_joints} joints; needs one of the law's {n}")
        velocity = next(signal.start for signal in signals if signal.name == "velocity_estimate")
        step, start = _watched(step, start, watch, velocity)
        signals += [Signal(name, place + k, 1) for k, name in enumerate(WatchOutput._fields)]
    return TracedLaw(law, torque_limits, watch, step, start, controller.past_torque_place, tuple(signals))


def _watched(step: ca.Function, start: ca.Function, watch: Watch, velocity: int) -> tuple[ca.Function, ca.Function]:
    """Return a step and a start with the watch after them: its state, the time and its flags come last.

    Parameters
    ----------
    step, start
        As in `TracedLaw`.
    watch
        What is watched.
    velocity
        Place of the velocity estimate in the output of the step.
    """
    n, test = watch.n_joints, trace(watch.step, *watch.example(), name="watch")[0]
    state, value = ca.SX.sym("x", step.nnz_in(0)), ca.SX.sym("u", step.nnz_in(1))
    watch_state, elapsed = ca.SX.sym("w", test.nnz_in(0)), ca.SX.sym("elapsed")
    next_state, output = step(state, value)
    watched = WatchInput(value[:n], value[n : 2 * n], output[velocity : velocity + n], output[:n], elapsed)
    next_watch, flags = test(watch_state, ca.vertcat(*watched))
    inputs = [ca.vertcat(state, watch_state), ca.vertcat(value, elapsed)]
    results = [ca.vertcat(next_state, next_watch), ca.vertcat(output, flags)]
    position, torque = ca.SX.sym("q", n), ca.SX.sym("torque", n)
    first = ca.vertcat(start(position, torque), ca.SX.zeros(test.nnz_in(0)))
    return (
        ca.Function("step", inputs, results, ["x", "u"], ["x_next", "y"], {"cse": True}),
        ca.Function("start", [position, torque], [first], {"cse": True}),
    )


def _start(law: Law, limits: TorqueLimits | None) -> ca.Function:
    """Return the state at the start as a function of position and torque, which the limits allow.

    It is affine in both, and in what a model of the robot gives there, which is traced. The coefficients are those of
    the law's own start at zero and at one for each.
    """
    n = law.n_joints
    position, torque = ca.SX.sym("q", n), ca.SX.sym("torque", n)
    parts: list[Tree] = [position, torque]
    has_model = isinstance(law, TDE) and law.maps_torque
    if isinstance(law, TDE) and has_model:
        parts += law.model_at_rest(position, torque)
    symbols = ca.vertcat(*(ca.vec(part) for part in leaves(tuple(parts))))
    example = law.model_at_rest(np.zeros(n), np.zeros(n)) if isinstance(law, TDE) and has_model else ()

    def state(values: Array) -> Array:
        q, applied, *model = unpack((np.zeros(n), np.zeros(n), *example), values)
        if isinstance(law, TDE) and has_model:
            return pack(law.with_model_state(super(TDE, law).init(q, applied), *model))
        return pack(limited_start(law, limits, q, applied))

    scale = np.ones(symbols.numel())
    scale[n : 2 * n] = 0.25 * np.minimum(law.torque_limits, 4.0)
    rows = affine(state, symbols, scale, type(law).__name__)
    return ca.Function("start", [position, torque], [rows], {"cse": True})


def affine(state: Callable[[Array], Array], symbols: ca.SX, scale: Array, label: str) -> ca.SX:
    """Return a state at the start as an affine expression of symbols, from its own values at zero and at one for each.

    Parameters
    ----------
    state
        Function of the symbols' values.
    symbols
        What it depends on, a column.
    scale
        Step of each symbol.
    label
        What has the state, for messages.

    Raises
    ------
    UnsupportedLaw
        Where the state is not affine.
    """
    size = symbols.numel()
    base = state(np.zeros(size))
    columns = np.array([(state(step * unit) - base) / step for unit, step in zip(np.eye(size), scale, strict=True)])
    rng = np.random.default_rng(0)
    for values in scale * rng.uniform(-1, 1, (START_PROBES, size)):
        expected, affine_value = state(values), base + values @ columns
        if not np.all(np.abs(affine_value - expected) <= START_TOLERANCE * (1 + np.abs(expected))):
            raise UnsupportedLaw(
                f"export: the state of {label} at the start is not affine in position and torque, so that "
                "it has no C; run it by Controller, or export another law"
            )
    rows = []
    for constant, row in zip(base.tolist(), columns.T, strict=True):
        value: ca.SX | float = constant
        for k in np.flatnonzero(row):
            term = symbols[int(k)] if row[k] == 1 else float(row[k]) * symbols[int(k)]
            value = term if isinstance(value, float) and value == 0 else value + term
        rows.append(ca.SX(value))
    return ca.vertcat(*rows)
