"""Assumptions of a certificate, watched in every period: one function for Python and for exported C."""

from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.system import System
from tarc.core.tracing import CompiledStep, trace
from tarc.core.trees import pack
from tarc.core.types import Array, Vector
from tarc.core.validation import Numbers

TIME_NOT_KNOWN = 0.0
"""Elapsed time that stands for none; NaN does so too."""


class WatchFlag(IntFlag):
    """What left the range that was certified.

    Attributes
    ----------
    POSITION
        A joint is outside the range of positions.
    ERROR
        A joint is farther from its reference than the tube is wide.
    SPEED
        A velocity estimate is above the largest speed.
    LOAD
        The mean torque of the last rest was above that of the largest certified load.
    TIMING
        The time between two samples differs from the period.
    """

    POSITION = 1
    ERROR = 2
    SPEED = 4
    LOAD = 8
    TIMING = 16


class WatchInput(NamedTuple):
    """Measured position, reference, velocity estimate and torque, each (n,), and the time since the last sample [s]."""

    position: Vector
    reference: Vector
    velocity: Vector
    torque: Vector
    elapsed: Vector


class WatchState(NamedTuple):
    """Periods at rest so far, sum of their torques (n,), whether the load was too large, each flag ever set (5,)."""

    rest_periods: Vector
    torque_sum: Vector
    overloaded: Vector
    seen: Vector


class WatchOutput(NamedTuple):
    """Flags of this period and of all periods since the start, each one number: sums of `WatchFlag`."""

    flags: Vector
    flags_seen: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Watch(Component, System):
    """Ranges that a certificate assumes, tested in every period.

        POSITION  q < low or q > high            ERROR  |q − qᵈ| > tube            SPEED  |v̂| > speed
        LOAD  |mean τ| > rest_torque             TIMING  |Δt − T| > tolerance T

    The mean is over ``rest_periods`` periods in a row in which no |v̂| is above ``rest_speed``. There the torque is that
    of gravity, springs and dry friction. A flag of the load stays until the next rest. A position that is not finite
    counts as missing and sets no flag, and so does an elapsed time of 0 or NaN.

    Parameters
    ----------
    n_joints
        Number of joints n.
    low, high
        Ends of the positions [rad or m], one number or one per joint; None or infinity for none.
    tube
        Largest distance of the reference from the position [rad or m]; None or infinity for none.
    speed
        Largest speed [rad/s or m/s]; None or infinity for any.
    rest_torque
        Largest magnitude of the mean torque at rest [N m or N]; None or infinity for any.
    rest_speed
        Largest velocity estimate at rest [rad/s or m/s].
    rest_periods
        Periods of one mean.
    period
        Control period T [s]; None for any elapsed time.
    tolerance
        Largest deviation of the elapsed time over T.

    Raises
    ------
    InvalidParameter
        For numbers out of range, another number of joints, and where there is nothing to watch.

    Examples
    --------
    >>> import tarc
    >>> watch = tarc.Watch(n_joints=2, low=-1.0, high=1.0, speed=[2.0, 3.0], period=1e-3)
    >>> watcher = tarc.Watcher(watch)
    >>> watcher.step([0.0, 1.5], [0.0, 1.5], [0.0, 0.0], [0.0, 0.0], elapsed=2e-3)
    <WatchFlag.POSITION|TIMING: 17>
    """

    n_joints: int
    low: Numbers | None = None
    high: Numbers | None = None
    tube: Numbers | None = None
    speed: Numbers | None = None
    rest_torque: Numbers | None = None
    rest_speed: Numbers = 0.02
    rest_periods: int = 100
    period: float | None = None
    tolerance: float = 0.1

    def __post_init__(self) -> None:
        check.integer("n_joints", self.n_joints, 1)
        check.integer("rest_periods", self.rest_periods, 1)
        check.number("tolerance", self.tolerance, 0)
        if self.period is not None:
            check.number("period", self.period, 0, strict=True)
        check.vector("rest_speed", self.rest_speed, self.n_joints, 0)
        low, high = self._limits("low", -np.inf), self._limits("high", np.inf)
        if np.any(low > high):
            i = int(np.flatnonzero(low > high)[0])
            raise InvalidParameter(f"low, high: joint {i + 1} goes from {low[i]:g} to {high[i]:g}; needs low ≤ high")
        for name in ("tube", "speed", "rest_torque"):
            if np.any(self._limits(name, np.inf) < 0):
                raise InvalidParameter(f"{name}: got {getattr(self, name)!r}; needs numbers of at least 0", name)
        if not self.watched:
            raise InvalidParameter(
                "watch: it has nothing to watch; give low and high, tube, speed, rest_torque or period"
            )

    def _limits(self, name: str, none: float) -> Array:
        """Return the limits of each joint, shape (n,), `HUGE` of `array_ops` where there are none."""
        value = getattr(self, name)
        row = check.float_array(name, none if value is None else value)
        if row.ndim > 1 or row.size not in (1, self.n_joints) or np.any(np.isnan(row)):
            raise InvalidParameter(
                f"{name}: got {value!r}; needs one number or {self.n_joints} of them, one per joint", name
            )
        return np.clip(np.broadcast_to(row, (self.n_joints,)), -ops.HUGE, ops.HUGE)

    @cached_property
    def watched(self) -> WatchFlag:
        """Flags that may be set."""
        result = WatchFlag(0)
        limits = {
            WatchFlag.POSITION: np.minimum(self._limits("high", np.inf), -self._limits("low", -np.inf)),
            WatchFlag.ERROR: self._limits("tube", np.inf),
            WatchFlag.SPEED: self._limits("speed", np.inf),
            WatchFlag.LOAD: self._limits("rest_torque", np.inf),
        }
        for flag, values in limits.items():
            if np.any(values < ops.HUGE):
                result |= flag
        return result if self.period is None else result | WatchFlag.TIMING

    def init(self, first: Vector | None = None, /) -> WatchState:
        """Return the state before the first period."""
        return WatchState(np.zeros(()), np.zeros(self.n_joints), np.zeros(()), np.zeros(len(WatchFlag)))

    def example(self) -> tuple[WatchState, WatchInput]:
        """Return a state and an input with the shapes to trace, at zero."""
        zero = np.zeros(self.n_joints)
        return self.init(), WatchInput(zero, zero, zero, zero, np.zeros(()))

    def step(self, state: WatchState, value: WatchInput) -> tuple[WatchState, WatchOutput]:
        """Test one period."""
        rest_periods, torque_sum, overloaded = self._rest(state, value)
        known = ops.finite(value.position)
        outside = ops.logical_or(
            value.position < self._limits("low", -np.inf), value.position > self._limits("high", np.inf)
        )
        away = ops.abs(value.position - value.reference) > self._limits("tube", np.inf)
        deviation = ops.abs(value.elapsed - (self.period or 0.0))
        tests = {
            WatchFlag.POSITION: lambda: _any(ops.logical_and(known, outside), self.n_joints),
            WatchFlag.ERROR: lambda: _any(ops.logical_and(known, away), self.n_joints),
            WatchFlag.SPEED: lambda: _any(ops.abs(value.velocity) > self._limits("speed", np.inf), self.n_joints),
            WatchFlag.LOAD: lambda: overloaded,
            WatchFlag.TIMING: lambda: ops.logical_and(
                ops.logical_not(value.elapsed == TIME_NOT_KNOWN), deviation > self.tolerance * (self.period or 0.0)
            ),
        }
        now = [ops.where_or_zero(tests[flag](), 1.0) if flag in self.watched else 0.0 for flag in WatchFlag]
        seen = [ops.maximum(state.seen[k], one) for k, one in enumerate(now)]
        output = WatchOutput(_bits(now), _bits(seen))
        return WatchState(rest_periods, torque_sum, overloaded, _stacked(seen)), output

    def _rest(self, state: WatchState, value: WatchInput) -> tuple[Vector, Vector, Vector]:
        """Return the next periods at rest, their sum of torques, and whether the mean was too large."""
        if WatchFlag.LOAD not in self.watched:
            return state.rest_periods, state.torque_sum, state.overloaded
        moves = _any(ops.logical_not(ops.abs(value.velocity) <= self._limits("rest_speed", 0.0)), self.n_joints)
        rests = ops.logical_and(ops.logical_not(moves), ops.all_finite(value.torque))
        count = ops.where_or_zero(rests, state.rest_periods + 1)
        total = ops.where_or_zero(rests, state.torque_sum + value.torque)
        is_full = count >= self.rest_periods
        largest = np.minimum(self._limits("rest_torque", np.inf), ops.HUGE / self.rest_periods) * self.rest_periods
        too_large = ops.where_or_zero(_any(ops.abs(total) > largest, self.n_joints), 1.0)
        overloaded = ops.where(is_full, too_large, state.overloaded)
        not_full = ops.logical_not(is_full)
        return ops.where_or_zero(not_full, count), ops.where_or_zero(not_full, total), overloaded


class Watcher:
    """A watch with its state, for a loop in Python: a few microseconds per period.

    Attributes
    ----------
    watch
        What is watched.
    flags, flags_seen
        Of the last step, and of all since `reset`.
    """

    def __init__(self, watch: Watch):
        self.watch = watch
        function, _ = trace(watch.step, *watch.example(), name="watch")
        self._call = CompiledStep(function)
        self.reset()

    def reset(self) -> None:
        """Start anew."""
        self._call.reset(pack(self.watch.init()))
        self.flags = self.flags_seen = WatchFlag(0)

    def step(
        self, position: Numbers, reference: Numbers, velocity: Numbers, torque: Numbers, *, elapsed: float = 0.0
    ) -> WatchFlag:
        """Return the flags of a period.

        Parameters
        ----------
        position, reference
            Measured and wanted [rad or m], each (n,).
        velocity
            The law's estimate [rad/s or m/s], shape (n,): ``controller.signals["velocity_estimate"]``.
        torque
            What the law returned [N m or N], shape (n,).
        elapsed
            Time since the sample before [s]; 0 or NaN where it is unknown, as in the first period.
        """
        n, value = self.watch.n_joints, self._call.value
        value[:n] = position
        value[n : 2 * n] = reference
        value[2 * n : 3 * n] = velocity
        value[3 * n : 4 * n] = torque
        value[4 * n] = elapsed
        self._call.step()
        self.flags, self.flags_seen = (WatchFlag(int(bits)) for bits in self._call.output)
        return self.flags


def _any(condition: Vector, n: int) -> Vector:
    """Return whether a condition holds for any joint."""
    return ops.dot(ops.where_or_zero(condition, np.ones(n)), np.ones(n)) > 0


def _bits(values: list[Vector]) -> Vector:
    """Return the sum of the flags of what is 1."""
    total: Vector = 0.0
    for flag, value in zip(WatchFlag, values, strict=True):
        total = total + float(flag.value) * value
    return total


def _stacked(values: list[Vector]) -> Vector:
    """Return scalars as one vector."""
    return ca.vertcat(*values) if ops.symbolic(*values) else np.array([float(value) for value in values])
