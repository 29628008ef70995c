"""Reader of the netCDF of a run: the log of a loop on a robot, or a simulated one."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.optional import require
from tarc.core.types import Array
from tarc.signals.robot_log import RobotLog


def read_run(file: Path) -> RobotLog:
    """Return the rows of a run, with the changes of its law's gains.

    Raises
    ------
    InvalidParameter
        For a file that is no run. For changes of gains whose values it lacks, since their law is then unknown.
    MissingTool
        Without the library that reads netCDF.
    """
    require("sim", "A log in netCDF", "h5netcdf")
    import h5netcdf

    try:
        with h5netcdf.File(file, "r") as content:
            variables = {name: np.asarray(part) for name, part in content.variables.items()}
            attributes = dict(content.attrs)
    except OSError as error:
        raise InvalidParameter(f"path: {file} does not read as netCDF ({error})", "path") from None
    lacking = [name for name in ("time", "joint", "measured_position") if name not in variables]
    if lacking:
        raise InvalidParameter(
            f"path: {file} has no {', '.join(lacking)}; needs the log of run_live, or a run that was saved", "path"
        )
    return RobotLog(
        times=variables["time"],
        position=variables["measured_position"],
        torque=variables.get("torque"),
        reference=variables.get("reference"),
        joint_names=tuple(map(_text, variables["joint"])),
        label=file.stem,
        law=_text(attributes.get("law", "")),
        gain_changes=_changes(file, variables, attributes),
    )


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


def _changes(
    file: Path, variables: dict[str, Array], attributes: dict[str, Any]
) -> tuple[tuple[float, dict[str, float]], ...]:
    """Return the time and the gains of each change that the loop took."""
    counts = variables.get("gain_changes")
    if counts is None:
        return ()
    gains = json.loads(_text(attributes.get("gain_changes", "[]")))
    taken = int(np.max(counts, initial=0))
    if taken > len(gains):
        raise InvalidParameter(
            f"gain_changes: {file} has {taken} changes of the law's gains, and the values of {len(gains)}; the loop's "
            "process or that of its log was ended by force, so use the rows before the first change alone",
            "path",
        )
    starts = [int(np.argmax(counts >= number + 1)) for number in range(taken)]
    return tuple((float(variables["time"][start]), change) for start, change in zip(starts, gains, strict=False))
