"""A law as functions of packed vectors: its step, its start, and where their numbers stand."""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from tarc.control.controller import Controller
from tarc.control.digital_controller import limited_start
from tarc.core.errors import UnsupportedLaw
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
    law, torque_limits
        The law and its limits.
    step
        ``[state, input] -> [next state, output]``; the input is position, reference and its two derivatives.
    start
        ``[position, torque] -> [state]``, the state at rest with a torque applied.
    past_torque
        Place in the state of the torque that the step before returned.
    signals
        What the output holds after the torque, in order.
    """

    law: Law
    torque_limits: TorqueLimits | None
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


def traced_law(law: Law, torque_limits: TorqueLimits | None = None) -> TracedLaw:
    """Trace what `Controller` runs, and its state at the start.

    Raises
    ------
    InvalidParameter
        As `Controller`.
    UnsupportedLaw
        For a law whose start is not affine in position and torque.
    """
    controller = Controller(law, torque_limits=torque_limits)
    n = law.n_joints
    signals, place = [], n
    for name, values in controller.signals.items():
        signals.append(Signal(name, place, values.size))
        place += values.size
    start = _start(law, torque_limits)
    return TracedLaw(law, torque_limits, controller.function, start, controller.past_torque_place, tuple(signals))


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

    def state(z: Array) -> Array:
        q, applied, *model = unpack((np.zeros(n), np.zeros(n), *example), z)
        if isinstance(law, TDE) and has_model:
            return pack(law.with_model_state(super(TDE, law).init(q, applied), *model))
        return pack(limited_start(law, limits, q, applied))

    size = symbols.numel()
    scale = np.ones(size)
    scale[n : 2 * n] = 0.25 * np.minimum(law.torque_limits, 4.0)
    base = state(np.zeros(size))
    columns = np.array([(state(step * unit) - base) / step for unit, step in zip(np.eye(size), scale, strict=True)])
    rng = np.random.default_rng(0)
    for z in scale * rng.uniform(-1, 1, (START_PROBES, size)):
        expected, found = state(z), base + z @ columns
        if not np.all(np.abs(found - expected) <= START_TOLERANCE * (1 + np.abs(expected))):
            raise UnsupportedLaw(
                f"export: the state of {type(law).__name__} at the start is not affine in position and torque, so that "
                "it has no C; run it by Controller, or export another law"
            )
    rows = []
    for constant, row in zip(base.tolist(), columns.T, strict=True):
        value: ca.SX | float = constant
        for k in np.flatnonzero(row):
            term = symbols[int(k)] if row[k] == 1 else float(row[k]) * symbols[int(k)]
            value = term if isinstance(value, float) and value == 0 else value + term
        rows.append(ca.SX(value))
    return ca.Function("start", [position, torque], [ca.vertcat(*rows)], {"cse": True})
