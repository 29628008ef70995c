"""Variables of an FMU: inputs, outputs and parameters, each an array of the law's joints or one number."""

from collections.abc import Sequence
from dataclasses import dataclass

from tarc.export.c_source import CSource
from tarc.export.tunable import Tunable

INPUTS = {
    "position": "measured position [rad or m]; a number that is not finite is a missing sample",
    "reference": "reference of the position [rad or m]",
    "velocity_reference": "reference of the velocity [rad/s or m/s]",
    "acceleration_reference": "reference of the acceleration [rad/s2 or m/s2]",
    "applied_torque": "torque that acted in answer to the step before [N m or N], read with uses_applied_torque",
}
DESCRIPTIONS = {
    "torque": "torque to apply [N m or N]",
    "missing": "samples missing in a row",
    "fault": "whether too many samples were missing, so that the safe torque is applied",
    "velocity_estimate": "estimated velocity [rad/s or m/s]",
}
STATUS = "0: all is well, 1: no position yet, 2: this sample was missing, 3: fault"


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU.

    Attributes
    ----------
    name, description
        As other tools show them.
    reference
        Value reference; of element i in FMI 2.0 the i-th after it.
    size
        Number of elements; 0 for one number that is no array.
    member
        Place in the C struct ``model_state``.
    kind
        ``REAL``, ``INTEGER`` or ``BOOLEAN``.
    role
        ``INPUT``, ``OUTPUT``, ``FIXED`` (a parameter), ``TUNABLE`` (one that may change) or ``INDEPENDENT`` (the time).
    start, least, greatest
        Start values and limits of the elements; empty for none.
    joints
        Names of the joints that the elements belong to; empty for none.
    """

    name: str
    description: str
    reference: int
    size: int
    member: str
    kind: str
    role: str
    start: tuple[float, ...] = ()
    least: tuple[float, ...] = ()
    greatest: tuple[float, ...] = ()
    joints: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Return the number of elements."""
        return max(1, self.size)

    def element_name(self, index: int) -> str:
        """Return the name of an element in FMI 2.0, which has no arrays."""
        return f"{self.name}[{index + 1}]" if self.size else self.name

    def element_description(self, index: int) -> str:
        """Return the description of an element, with its joint's name."""
        return f"{self.description}: {self.joints[index]}" if self.joints else self.description


def fmu_variables(source: CSource, tunables: Sequence[Tunable], joint_names: Sequence[str]) -> list[Variable]:
    """Return the variables of a law's FMU: the time, inputs, outputs, then parameters."""
    n = source.traced.n_joints
    joints = tuple(joint_names)
    variables: list[Variable] = []

    def add(
        name: str, description: str, size: int, member: str, kind: str, role: str, **more: tuple[float, ...]
    ) -> None:
        reference = sum(variable.count for variable in variables)
        own = joints if size == n == len(joints) else ()
        variables.append(Variable(name, description, reference, size, member, kind, role, joints=own, **more))

    add("time", "time [s]", 0, "time", "REAL", "INDEPENDENT")
    for name, description in INPUTS.items():
        add(name, description, n, f"in.{name}", "REAL", "INPUT", start=(0.0,) * n)
    unit = "/".join(dict.fromkeys(source.commands))
    command = f"command of the inner loops [{unit}]" if unit else DESCRIPTIONS["torque"]
    add("torque", command, n, "out.torque", "REAL", "OUTPUT")
    for signal in source.signals:
        kind = {"missing": "INTEGER", "fault": "BOOLEAN"}.get(signal.name, "REAL")
        description = DESCRIPTIONS.get(signal.name, f"signal {signal.name} of the law")
        is_array = signal.size > 1 or (signal.size == n == 1 and kind == "REAL" and signal.name in PER_JOINT)
        size = signal.size if is_array else 0
        add(signal.name, description, size, f"out.{signal.name}", kind, "OUTPUT")
    add("status", STATUS, 0, "status", "INTEGER", "OUTPUT")
    text = "torque that acts before the first sample [N m or N]"
    if unit:
        text = f"command before the first sample [{unit}]; of positions the first one"
    add("initial_torque", text, n, "initial_torque", "REAL", "FIXED", start=(0.0,) * n)
    text = "whether applied_torque is read; else the torque counts as applied"
    add("uses_applied_torque", text, 0, "uses_applied_torque", "BOOLEAN", "FIXED", start=(0.0,))
    place = 0
    for tunable in tunables:
        text = f"parameter {tunable.name} of the law; a certificate holds for the exported value alone"
        size = len(tunable.values) if len(tunable.values) > 1 else 0
        limits = {"start": tunable.values, "least": tunable.least, "greatest": tunable.greatest}
        add(tunable.name, text, size, f"parameter[{place}]", "REAL", "TUNABLE", **limits)
        place += len(tunable.values)
    return variables


PER_JOINT = ("velocity_estimate",)
"""Signals that are arrays for one joint too."""
