"""What the log of a run on a robot has: a Run's variables, and its timing."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from tarc.control.watch import WatchFlag
from tarc.core.array_ops import HUGE
from tarc.core.types import Array
from tarc.core.units import joint_units, unit_for_joints
from tarc.core.version import __version__
from tarc.laws.base import Law
from tarc.runtime.limits import SafetyLimits
from tarc.signals.references import Reference
from tarc.simulation.dataset import describe, to_json
from tarc.simulation.quantities import VARIABLES

ENDED_BY_FORCE = "the loop's process ended"
"""Attribute ``ended`` of a log whose loop was killed."""


class Phase(IntEnum):
    """Parts of a run, in order."""

    HOLD = 0
    PUSH = 1
    RAMP = 2
    TRACK = 3
    STOP = 4
    SAFE_STOP = 5


TIMING = {
    "phase": ("part of the run: 0 hold, 1 push, 2 ramp, 3 track, 4 stop, 5 safe stop", "1"),
    "period_start": ("start of the period, from the first deadline on", "s"),
    "lateness": ("start of the period after the deadline that the loop waited for", "s"),
    "computation_time": ("time from the start of the period until the torque was written", "s"),
    "sample_time": ("the robot's own stamp of the sample", "s"),
    "overrun": ("whether the loop missed the period", "1"),
    "gain_changes": ("changes of the law's gains so far, of those in the attribute of this name", "1"),
    "assumption_flags": ("what left the range that was certified, as bits", "1"),
}
"""Long name and unit of each variable that a simulated run does not have; each is one number per period."""

MEASURED = ("measured_position", "reference", "velocity_reference", "acceleration_reference", "torque")
"""Variables of the loop with one number per joint."""


class Column(NamedTuple):
    """A variable by its place in a row, and whether it has one number per joint."""

    name: str
    start: int
    size: int
    is_vector: bool


@dataclass(frozen=True)
class LogLayout:
    """Places of the variables in a row of the ring: the number of the period first, then timing, then vectors.

    Attributes
    ----------
    columns
        All variables.
    width
        Numbers in a row.
    """

    columns: tuple[Column, ...]
    width: int

    @classmethod
    def of(cls, law: Law) -> "LogLayout":
        """Return the layout for a law."""
        signals = law.step(*law.example())[1].signals
        n = law.n_joints
        shapes: dict[str, tuple[int, ...]] = {
            "period": (),
            **dict.fromkeys(TIMING, ()),
            **dict.fromkeys(MEASURED, (n,)),
        }
        shapes |= {name: np.shape(leaf) for name, leaf in signals.items()}
        columns, place = [], 0
        for name, shape in shapes.items():
            size = int(np.prod(shape))
            columns.append(Column(name, place, size, bool(shape)))
            place += size
        return cls(tuple(columns), place)

    def views(self, row: Array) -> dict[str, Array]:
        """Return the part of each variable in a row, as views."""
        return {column.name: row[column.start : column.start + column.size] for column in self.columns}


@dataclass(frozen=True)
class LogSubject:
    """What a log says of how its run was made.

    Attributes
    ----------
    law, reference, limits
        As run.
    joint_names, units
        Of the joints, in order.
    label
        Name of the robot.
    scenario, certificate
        Ready for JSON; None for none.
    watchdog
        [s].
    """

    law: Law
    reference: Reference
    limits: SafetyLimits
    joint_names: Sequence[str]
    units: Sequence[str]
    label: str
    scenario: Mapping[str, Any] | None
    certificate: Mapping[str, Any] | None
    watchdog: float


def header(layout: LogLayout, subject: LogSubject, facts: Mapping[str, str]) -> dict[str, Any]:
    """Return what the writer of the log needs, ready for JSON."""
    law, units = subject.law, list(subject.units)
    torque_unit = joint_units([unit_for_joints("N m", [unit]) for unit in units])
    variables = []
    for column in layout.columns[1:]:
        label, unit = TIMING.get(column.name) or VARIABLES.get(column.name, (column.name.replace("_", " "), "1"))
        unit = torque_unit if column.name == "torque" else unit_for_joints(unit, units)
        variables.append({**column._asdict(), "attributes": {"long_name": label, "units": unit}})
    limits = subject.limits.largest_torque(law)
    static = {"torque_limit": [limit if limit < HUGE else "inf" for limit in limits.tolist()]}
    if subject.limits.torque_rate is not None:
        static["torque_rate_limit"] = np.broadcast_to(subject.limits.torque_rate, limits.shape).tolist()
    return {
        "n_joints": law.n_joints,
        "width": layout.width,
        "period": law.period,
        "variables": variables,
        "static": static,
        "joint_names": list(subject.joint_names),
        "joint_units": units,
        "position_unit": unit_for_joints("rad", units),
        "torque_unit": torque_unit,
        "attributes": attributes(subject, facts),
    }


def attributes(subject: LogSubject, facts: Mapping[str, str]) -> dict[str, str | float]:
    """Return the attributes of a log whose loop is still running."""
    law, limits = subject.law, subject.limits
    return {
        "title": f"{type(law).__name__} on {subject.label}",
        "source": f"tarc-control {__version__}",
        "plant": subject.label,
        "law": to_json(describe(law)),
        "reference_signal": to_json(describe(subject.reference)),
        "torque_limits": "" if limits.interface is None else to_json(describe(limits.interface)),
        "safety_limits": to_json(describe(limits)),
        "scenario": "" if subject.scenario is None else json.dumps(subject.scenario),
        "certificate": "" if subject.certificate is None else json.dumps(subject.certificate),
        "flag_names": json.dumps([flag.name for flag in WatchFlag]),
        "realtime": json.dumps(dict(facts)),
        "period": law.period,
        "watchdog": subject.watchdog,
        "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "tracking_start": float("nan"),
        "divergence_time": float("nan"),
        "counts": "",
        "push": "",
        "gain_changes": "[]",
        "ended": ENDED_BY_FORCE,
    }
