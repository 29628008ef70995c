"""Drive between the torque that is set and the torque on the joints: lag and delay."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.signals.sensors import SAME_INSTANT, numbers_of_at_least_zero

SEGMENTS_PER_TIME_CONSTANT = 4
"""Parts of the shortest time constant over which the torque counts as constant."""
MAX_SEGMENTS = 8
"""Largest number of parts of a period that the lag requires."""


class Segment(NamedTuple):
    """Part of a period, from ``start`` to ``stop`` in periods, within one substep."""

    start: float
    stop: float
    substep: int


class DriveState(NamedTuple):
    """Torques set before, newest first, shape (n, d + 1), and the torque of the lag, (n,), or (0,) without one."""

    commands: Vector
    torque: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive(Component):
    """Drive with a pure delay and a lag of first order.

        T_d τ̇ = u(t − δT) − τ

    u is the torque that is set once per period, after limits and computation delay. The lag is solved exactly. The
    plant is integrated in parts of a period in which no command changes, with the mean of τ in each part. Each number
    is one for all joints or one per joint. Laws and certificates do not know the drive.

    Parameters
    ----------
    time_constant
        T_d [s].
    delay
        δ [periods], also a fraction such as 0.4.
    """

    time_constant: Numbers = 0.0
    delay: Numbers = 0.0

    def __post_init__(self) -> None:
        sizes = {np.size(numbers_of_at_least_zero(name, getattr(self, name))) for name in ("time_constant", "delay")}
        if len(sizes - {1}) > 1:
            raise InvalidParameter(
                f"time_constant, delay: got {np.size(self.time_constant)} and {np.size(self.delay)} numbers; give one "
                "number, or one per joint each"
            )

    def check_joints(self, n_joints: int) -> None:
        """Refuse one number per joint for another number of joints.

        Raises
        ------
        InvalidParameter
            For a time constant or delay of another size than 1 or n.
        """
        for name in ("time_constant", "delay"):
            size = np.size(getattr(self, name))
            if size not in (1, n_joints):
                raise InvalidParameter(
                    f"drive.{name}: got {size} numbers; needs one number or {n_joints} of them", name
                )

    @cached_property
    def _whole_delay(self) -> np.ndarray:
        return np.floor(np.asarray(self.delay, dtype=float) + SAME_INSTANT).astype(int)

    @cached_property
    def _fraction(self) -> np.ndarray:
        fraction = np.asarray(self.delay, dtype=float) - self._whole_delay
        return np.where(fraction > SAME_INSTANT, fraction, 0.0)

    @cached_property
    def _constants(self) -> np.ndarray:
        return np.asarray(self.time_constant, dtype=float)

    @property
    def _has_lag(self) -> bool:
        return bool(np.any(np.asarray(self.time_constant) > 0))

    def segments(self, substeps: int, period: float) -> list[Segment]:
        """Return the parts of a period with equal substeps, so short that commands and torque change between them."""
        parts = 1
        constants = np.asarray(self.time_constant, dtype=float)
        if self._has_lag:
            needed = SEGMENTS_PER_TIME_CONSTANT * period / np.min(constants[constants > 0])
            parts = int(np.ceil(min(needed, MAX_SEGMENTS) / substeps))
        edges = np.unique([*(np.arange(substeps * parts + 1) / (substeps * parts)), *np.ravel(self._fraction)])
        edges = edges[np.diff(edges, append=2.0) > SAME_INSTANT]
        return [
            Segment(float(start), float(stop), int((start + stop) / 2 * substeps)) for start, stop in pairwise(edges)
        ]

    def init(self, torque: Vector) -> DriveState:
        """Return the state after a torque (n,) was set for long."""
        torque = np.asarray(torque, dtype=float)
        commands = np.repeat(torque[:, None], int(np.max(self._whole_delay)) + 1, axis=1)
        return DriveState(commands, torque if self._has_lag else np.zeros(0))

    def step(
        self, state: DriveState, command: Vector, period: Vector, segments: list[Segment]
    ) -> tuple[DriveState, list[Vector]]:
        """Return the next state and the mean torque in each segment, each (n,), for the torque that is set now.

        Parameters
        ----------
        state, command
            The state at the start of the period, and the torque set there (n,).
        period
            Length of this period [s].
        segments
            As `segments` gives them.
        """
        n = command.shape[0]
        whole = np.broadcast_to(self._whole_delay, (n,))
        fraction = np.broadcast_to(self._fraction, (n,))
        has_lag = np.broadcast_to(np.asarray(self.time_constant) > 0, (n,))
        constants = ops.where(has_lag, self._constants, 1.0)
        commands = ops.append_first(state.commands, command)
        torque = state.torque
        means = []
        for segment in segments:
            is_older = (segment.start + segment.stop) / 2 < fraction
            active = ops.pick_columns(commands, whole + is_older)
            if not self._has_lag:
                means.append(active)
                continue
            ratio = (segment.stop - segment.start) * period / constants
            decay = np.where(has_lag, 1.0, 0.0) * ops.exp(-ratio)
            # the mean of exp(-t / T_d) over the segment
            mean_decay = np.where(has_lag, 1.0, 0.0) * (1 - ops.exp(-ratio)) / ratio
            means.append(active + (torque - active) * mean_decay)
            torque = active + (torque - active) * decay
        return DriveState(commands[:, :-1], torque), means
