"""Recorded motion of a real robot."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array

MIN_ROWS = 6
"""Fewest rows of a log."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotLog:
    """Rows of positions, and of velocities, torques and references where the robot reports them.

    Attributes
    ----------
    times
        Stamps [s], shape (k,); they may repeat, but never decrease.
    position
        Measured positions [rad or m], shape (k, n); NaN for a lost sample.
    velocity, torque, reference
        Recorded velocities, torques on the joints [N m or N] and references, each of shape (k, n), or None.
    joint_names
        Name of each joint.
    label
        Name of the record, for tables and figures.
    law
        The law that ran, as `tarc.runtime.run_live` describes it in JSON; empty where that is unknown.
    gain_changes
        Times [s] and new gains of this law, where they changed meanwhile.

    Raises
    ------
    InvalidParameter
        For shapes that do not match, fewer than six rows, and stamps that are no numbers or decrease.
    """

    times: Array
    position: Array
    velocity: Array | None = None
    torque: Array | None = None
    reference: Array | None = None
    joint_names: tuple[str, ...] = ()
    label: str = "log"
    law: str = ""
    gain_changes: tuple[tuple[float, Mapping[str, float]], ...] = ()

    def __post_init__(self) -> None:
        times = check.array("times", self.times)
        position = check.float_array("position", self.position)
        if position.ndim != 2 or times.shape != position.shape[:1] or len(times) < MIN_ROWS or position.shape[1] < 1:
            raise InvalidParameter(
                f"times, position: got shapes {times.shape} and {position.shape}; needs (k,) and (k, n) with k at "
                f"least {MIN_ROWS}"
            )
        if np.any(np.diff(times) < 0):
            row = int(np.argmax(np.diff(times) < 0)) + 1
            raise InvalidParameter(f"times: row {row} is earlier than the row before it; sort the rows of the log")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "position", position)
        for name in ("velocity", "torque", "reference"):
            value = getattr(self, name)
            if value is None:
                continue
            table = check.float_array(name, value)
            if table.shape != position.shape:
                raise InvalidParameter(f"{name}: got shape {table.shape}; the positions have {position.shape}", name)
            object.__setattr__(self, name, table)
        names = tuple(self.joint_names) or tuple(f"joint {i + 1}" for i in range(position.shape[1]))
        if len(names) != position.shape[1]:
            raise InvalidParameter(
                f"joint_names: got {len(names)} names for {position.shape[1]} joints; needs one per joint",
                "joint_names",
            )
        object.__setattr__(self, "joint_names", names)

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return self.position.shape[1]

    def select(self, rows: Array) -> Self:
        """Return the log with some of its rows, by a mask or by their indices."""
        tables = {
            name: value[rows]
            for name in ("times", "position", "velocity", "torque", "reference")
            if (value := getattr(self, name)) is not None
        }
        return replace(self, **tables)

    def between(self, start_time: float | None, stop_time: float | None) -> Self:
        """Return the rows from a start to a stop time [s] after the first stamp; None for no bound.

        Raises
        ------
        InvalidParameter
            Where fewer than six rows are left.
        """
        since_first = self.times - self.times[0]
        first = -np.inf if start_time is None else check.number("start_time", start_time)
        last = np.inf if stop_time is None else check.number("stop_time", stop_time)
        inside = (since_first >= first) & (since_first <= last)
        if np.count_nonzero(inside) < MIN_ROWS:
            raise InvalidParameter(
                f"start_time, stop_time: {np.count_nonzero(inside)} rows of {self.label} are from {start_time} to "
                f"{stop_time} s; it lasts {since_first[-1]:g} s, and at least {MIN_ROWS} rows are needed"
            )
        return self if np.all(inside) else self.select(inside)
