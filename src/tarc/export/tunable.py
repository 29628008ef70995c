"""Parameters of a law that stay changeable in its C, where the law allows it."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tarc.control.controller import Controller
from tarc.control.digital_controller import limited_step
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.tracing import TRACE_ERRORS, CompiledStep, expressions
from tarc.core.types import Array
from tarc.export.traced_law import TracedLaw
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.signals.torque_limits import TorqueLimits

RANGE = 10.0
"""A parameter may be tuned by this factor up and down, where the law allows both."""
SCALE = "inertia_scale"
"""Factor on an M̂ that is a matrix, whose elements cannot change one by one."""
DOWN_ONLY = ("torque_limit", "inertia", SCALE)
"""Parameters that may only be made smaller: the torque limit protects the robot, and M̂ has a stable upper bound."""
FIXED = ("period", "max_missing", "actuation_delay", "delay")
"""Numbers that set the size of the law's memory or its weights."""
TRIAL_SIZES = (1e-4, 3e-3, 0.1, 1.0)
"""Sizes of the random inputs with which steps are compared [rad and derivatives]."""
TRIAL_STEPS = 30
TOLERANCE = 1e-9
"""Largest difference of a step with a changed parameter from that of the law built with it, over one more than the
number. At the exported values no bit may differ."""


class Tunable(NamedTuple):
    """A parameter that stays changeable: its name, the elements' values, and the range of each."""

    name: str
    values: tuple[float, ...]
    least: tuple[float, ...]
    greatest: tuple[float, ...]


@dataclass(frozen=True)
class TunableLaw:
    """A traced law with changeable parameters at the end of its state.

    Attributes
    ----------
    traced
        The law. The last states are the parameters, which a step leaves as they are.
    tunables
        The parameters, in their order in the state.
    refused
        Why the others are not among them, by name.
    """

    traced: TracedLaw
    tunables: tuple[Tunable, ...]
    refused: dict[str, str]


def tunable_law(law: Law, traced: TracedLaw, names: Sequence[str] | None = None) -> TunableLaw:
    """Trace a law once more, with every parameter as a symbol that enters its step as a plain number.

    A parameter is taken where two things hold. At the exported values the step gives the same bits as before. At others
    it gives what the law gives that is built with them, to rounding.

    Parameters
    ----------
    law
        The law.
    traced
        The law as `traced_law` returns it.
    names
        Parameters to take; None for all that can be.

    Raises
    ------
    InvalidParameter
        For a name that is no parameter with numbers.
    UnsupportedLaw
        For a parameter in ``names`` that cannot be taken.
    """
    candidates = _candidates(law)
    for name in names or ():
        if name not in candidates and not _is_matrix(getattr(law, name, None)):
            raise InvalidParameter(
                f"tunable: got {name!r}; {type(law).__name__} has the numbers {', '.join(candidates) or 'none'}"
            )
    chosen: list[Tunable] = []
    refused = {
        field.name: "it is a matrix, which inertia_scale may scale"
        for field in fields(law)
        if _is_matrix(getattr(law, field.name))
    }
    if names is not None:
        refused = {name: reason for name, reason in refused.items() if name in names}
    result = TunableLaw(traced, (), refused)
    for name in candidates if names is None else [name for name in names if name in candidates]:
        extended, reason = _extended(law, traced, [*chosen, candidates[name]])
        if extended is None:
            refused[name] = reason
        else:
            chosen.append(candidates[name])
            result = TunableLaw(extended, tuple(chosen), refused)
    if names is not None and refused:
        name, reason = next(iter(refused.items()))
        raise UnsupportedLaw(f"tunable: {name} of {type(law).__name__} cannot stay changeable: {reason}")
    return result


def _candidates(law: Law) -> dict[str, Tunable]:
    """Return the law's parameters that are numbers, with the range in which the law can be built."""
    candidates = {}
    numbers = {field.name: getattr(law, field.name) for field in fields(law) if field.name not in FIXED}
    if isinstance(law, PolePlacement) and _is_matrix(law.inertia):
        numbers[SCALE] = 1.0
    for name, value in numbers.items():
        if not _is_numbers(value):
            continue
        values = tuple(float(number) for number in np.atleast_1d(np.asarray(value, dtype=float)))
        down, up = 1 / RANGE, 1.0 if name in DOWN_ONLY else RANGE
        least = values if _build(law, name, np.multiply(values, down)) is None else _times(values, down)
        greatest = values if _build(law, name, np.multiply(values, up)) is None else _times(values, up)
        if least != greatest:
            candidates[name] = Tunable(name, values, least, greatest)
    return candidates


def _is_numbers(value: Any) -> bool:
    """Whether a value is one number or a vector of them, positive and finite."""
    if isinstance(value, bool | int) or not isinstance(value, float | np.ndarray | list | tuple):
        return False
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return False
    return numbers.ndim < 2 and numbers.size > 0 and bool(np.all(np.isfinite(numbers)) and np.all(numbers > 0))


def _is_matrix(value: Any) -> bool:
    """Whether a value is a matrix of numbers."""
    return isinstance(value, np.ndarray | list | tuple) and np.ndim(value) == 2


def _times(values: tuple[float, ...], factor: float) -> tuple[float, ...]:
    return tuple(factor * value for value in values)


def _build(law: Law, name: str, values: Array) -> Law | None:
    """Return the law with other values of a parameter, or None where it refuses them."""
    if name == SCALE and isinstance(law, PolePlacement):
        name, value = "inertia", values[0] * np.asarray(law.inertia, dtype=float)
    else:
        value = values if np.ndim(getattr(law, name)) else float(values[0])
    try:
        return replace(law, **{name: value})
    except InvalidParameter:
        return None


def _with_symbols(law: Law, symbols: dict[str, ca.SX]) -> Law:
    """Return a copy of a law with symbols in place of numbers; what was computed from those stays, but for gains."""
    changed = copy.copy(law)
    for name, symbol in symbols.items():
        if name not in ("inertia", SCALE):  # the number of joints is the size of the inertia
            object.__setattr__(changed, name, symbol)
    for name, value in _computed(law, symbols).items():
        vars(changed)[name] = value  # where a cached property has it
    return changed


def _computed(law: Law, symbols: dict[str, ca.SX]) -> dict[str, ca.SX]:
    """Return gains, M̂ and torque limits as far as they depend on symbols."""
    n, computed = law.n_joints, {}
    if isinstance(law, PolePlacement) and law.natural_frequency is not None:
        omega, zeta = symbols.get("natural_frequency"), symbols.get("damping_ratio")
        if omega is not None:
            computed["K1"] = ca.diag(_vector(omega * omega, n))
        if omega is not None or zeta is not None:
            ratio = _vector(law.damping_ratio if zeta is None else zeta, n)
            computed["K2"] = ca.diag(2 * ratio * _vector(law.natural_frequency if omega is None else omega, n))
    if isinstance(law, PolePlacement) and "inertia" in symbols:
        computed["M"] = ca.diag(_vector(symbols["inertia"], n))
    if isinstance(law, PolePlacement) and SCALE in symbols:
        computed["M"] = symbols[SCALE] * law.M
    if "torque_limit" in symbols:
        computed["torque_limits"] = _vector(symbols["torque_limit"], n)
    return computed


def _vector(value: Any, n: int) -> ca.SX:
    """Return one number per joint, shape (n, 1)."""
    values = ca.SX(value if isinstance(value, ca.SX) else np.asarray(value, dtype=float))
    return values if values.numel() == n else ca.repmat(values, n, 1)


def _extended(law: Law, traced: TracedLaw, tunables: list[Tunable]) -> tuple[TracedLaw | None, str]:
    """Return the law with the parameters at the end of its state, or None and why not."""
    symbols = {tunable.name: ca.SX.sym(tunable.name, len(tunable.values)) for tunable in tunables}
    changed = _with_symbols(law, symbols)
    try:
        inputs, results = expressions(
            lambda state, value: limited_step(changed, traced.torque_limits, state, value), *law.example()
        )
    except TRACE_ERRORS:
        return None, "the law decides or computes by its value before it runs"
    parameters = ca.vertcat(*symbols.values())
    states, outputs = [inputs[0], parameters], [results[0], parameters]
    step = ca.Function(
        "step",
        [ca.vertcat(*states), inputs[1]],
        [ca.vertcat(*outputs), results[1]],
        ["x", "u"],
        ["x_next", "y"],
        {"cse": True},
    )
    q, torque = ca.SX.sym("q", law.n_joints), ca.SX.sym("torque", law.n_joints)
    values = [value for tunable in tunables for value in tunable.values]
    at_rest = traced.start(q, torque)
    start = ca.Function("start", [q, torque], [ca.vertcat(at_rest, ca.SX(values))], {"cse": True})
    reason = _difference(law, traced.torque_limits, step, tunables)
    return (None, reason) if reason else (replace(traced, step=step, start=start), "")


def _difference(law: Law, limits: TorqueLimits | None, step: ca.Function, tunables: list[Tunable]) -> str:
    """Return how the step with changeable parameters differs from the law itself; empty where it does not."""
    values = np.array([value for tunable in tunables for value in tunable.values])
    n_joints, torque = law.n_joints, np.minimum(law.torque_limits / (2 * RANGE), 1.0)
    start = _state_at_start(law, limits, torque)
    expected = _trial(Controller(law, torque_limits=limits).function, start, n_joints)
    reached = _trial(step, start, n_joints, values)
    if not np.array_equal(reached.view(np.uint64), expected.view(np.uint64)):
        return "as a number that may change it rounds differently"
    latest = tunables[-1]
    first = len(values) - len(latest.values)
    for end in (latest.least, latest.greatest):
        if end == latest.values:
            continue
        rebuilt = _build(law, latest.name, np.array(end))
        assert rebuilt is not None  # the range was made so
        if not np.array_equal(_state_at_start(rebuilt, limits, torque), start):
            return "it also sets the state at the start"
        tried = values.copy()
        tried[first:] = end
        expected = _trial(Controller(rebuilt, torque_limits=limits).function, start, n_joints)
        reached = _trial(step, start, n_joints, tried)
        if not np.all(np.abs(reached - expected) <= TOLERANCE * (1 + np.abs(expected))):
            return "it enters numbers that are computed when the law is built"
    return ""


def _state_at_start(law: Law, limits: TorqueLimits | None, torque: Array) -> Array:
    """Return the state at rest at a position that is not zero, with a torque applied."""
    position = np.linspace(-1.0, 1.0, law.n_joints + 2)[1:-1] + 0.1
    return Controller(law, torque_limits=limits).state_at_start(position, torque)


def _trial(function: ca.Function, start: Array, n: int, parameters: Array | None = None) -> Array:
    """Return states and outputs of random steps, small and large, one row each; now and then a position is missing."""
    rng = np.random.default_rng(0)
    step, rows = CompiledStep(function), []
    for size in TRIAL_SIZES:
        step.reset(np.concatenate([start, [] if parameters is None else parameters]))
        for k in range(TRIAL_STEPS):
            step.value[:] = size * rng.standard_normal(4 * n)
            if k == TRIAL_STEPS // 2:
                step.value[0] = np.nan
            step.step()
            rows.append(np.concatenate([step.state[: len(start)], step.output]))
    return np.array(rows)
