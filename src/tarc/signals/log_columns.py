"""Where a log has its times, positions, velocities, torques and references."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.optional import require

QUANTITIES = ("position", "velocity", "torque", "reference")
"""What a log may have per joint."""
TIME_NAMES = ("time", "t", "stamp", "timestamp", "time_s", "times")
WORDS = {
    "position": ("q", "position", "positions", "pos", "joint_position", "actual_q"),
    "velocity": ("dq", "qd", "velocity", "velocities", "vel", "v", "joint_velocity", "actual_qd"),
    "torque": ("tau", "torque", "torques", "effort", "tau_j", "joint_torque", "actual_torque"),
    "reference": ("q_d", "q_ref", "qref", "ref", "reference", "q_des", "target_q", "desired_position"),
}
"""Names of columns, before the number of a joint or after its name."""
SCALES = {
    "rad": 1.0,
    "m": 1.0,
    "s": 1.0,
    "Nm": 1.0,
    "N": 1.0,
    "rad/s": 1.0,
    "m/s": 1.0,
    "deg": 0.017453292519943295,
    "deg/s": 0.017453292519943295,
    "mm": 1e-3,
    "mm/s": 1e-3,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
}
"""Factor from a unit to rad, m, s, N m or N."""


@dataclass(frozen=True, kw_only=True)
class LogColumns:
    """Names of a log's columns, for files that name them otherwise than `read_log` expects.

    Parameters
    ----------
    time
        Column of the stamps; None for a known name, or with ``period``.
    period
        Time between rows [s], for a log without stamps.
    position, velocity, torque, reference
        Columns of each quantity in the order of the joints. In CSV a list of names. In MAT the path of an array, such
        as ``rec.position``, whichever of its axes is time. For a folder the file of a quantity, numbers row by row.
    joints
        Names of the joints. From a bag these are taken, in this order.
    topic
        Topic of a bag with the type ``sensor_msgs/JointState``; None for the only one, or ``/joint_states``.
    units
        Unit of ``time`` or of a quantity, such as ``{position: deg}``: rad, deg, m, mm, s, ms, us, ns, Nm, N and those
        of velocity with ``/s``.

    Raises
    ------
    InvalidParameter
        For units that are unknown, and for a period that is not above 0.
    """

    time: str | None = None
    period: float | None = None
    position: str | Sequence[str] | None = None
    velocity: str | Sequence[str] | None = None
    torque: str | Sequence[str] | None = None
    reference: str | Sequence[str] | None = None
    joints: Sequence[str] | None = None
    topic: str | None = None
    units: Mapping[str, str] | None = None

    def __post_init__(self) -> None:
        if self.period is not None:
            check.number("columns.period", self.period, 0, strict=True)
        for quantity, unit in (self.units or {}).items():
            check.one_of("columns.units", quantity, ("time", *QUANTITIES))
            check.one_of(f"columns.units.{quantity}", unit, SCALES)

    def scale(self, quantity: str) -> float:
        """Return the factor to SI units of the time or of a quantity."""
        return SCALES[(self.units or {}).get(quantity, "rad")]

    def names(self, quantity: str) -> list[str] | None:
        """Return the columns of a quantity as a list, or None where it has none."""
        value = getattr(self, quantity)
        return [value] if isinstance(value, str) else None if value is None else [str(name) for name in value]


class ColumnPlace(NamedTuple):
    """Quantity and joint of a column, by its name."""

    quantity: str
    joint: str


def columns_from(given: "LogColumns | Mapping[str, Any] | str | Path | None") -> LogColumns:
    """Return columns from a mapping, or from a YAML file that has one.

    Raises
    ------
    InvalidParameter
        For a file that does not read as a mapping, and for unknown keys.
    MissingTool
        For YAML without the library that reads it.
    """
    if given is None:
        return LogColumns()
    if isinstance(given, LogColumns):
        return given
    content = given if isinstance(given, Mapping) else _read_mapping(Path(given))
    known = [field.name for field in fields(LogColumns)]
    for key in content:
        check.one_of("columns", str(key), known)
    return LogColumns(**content)


def _read_mapping(path: Path) -> Mapping[str, Any]:
    require("cli", f"Columns in YAML ({path.name})", "ruamel.yaml")
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    if not path.is_file():
        raise InvalidParameter(f"columns: no file {str(path)!r}; looked for {path.resolve()}", "columns")
    try:
        content = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except (YAMLError, UnicodeDecodeError) as error:
        raise InvalidParameter(f"columns: {path} is no valid YAML: {error}", "columns") from None
    if not isinstance(content, Mapping):
        raise InvalidParameter(f"columns: {path} has no keys; needs position: [q1, q2] and the like", "columns")
    return content


def place_of(name: str) -> ColumnPlace | None:
    """Return what a column has, by its name: ``q1``, ``tau_2``, ``velocity[3]``, ``elbow/effort``, or None."""
    lower = name.strip().lower()
    numbered = re.fullmatch(r"(.*?)[_\[(. ]*(\d+)[\])]?", lower)
    for quantity, words in WORDS.items():
        if numbered and numbered[1] in words:
            return ColumnPlace(quantity, numbered[2])
        for word in words:
            if lower.endswith((f"/{word}", f".{word}")):
                return ColumnPlace(quantity, name.strip()[: -len(word) - 1])
    return None


def split_unit(name: str) -> tuple[str, float | None]:
    """Return a header's name and the factor of the unit in its brackets, None without a known unit."""
    match = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]", name.strip())
    unit = match[2].replace("°", "deg").replace("N m", "Nm").replace("µ", "u") if match else ""
    if match and unit in SCALES:
        return match[1], SCALES[unit]
    return name.strip(), None
