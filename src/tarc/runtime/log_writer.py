"""The process that writes the log of a run, while the loop goes on.

Run as ``python -m tarc.runtime.log_writer FOLDER TARGET``; `tarc.runtime.log.Log` writes the folder and starts it. It
ends with the loop, and finishes the file where the loop's process is killed.
"""

import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np

from tarc.core.types import Array
from tarc.runtime.ring import Ring

POLL = 0.05
"""Time between two looks for rows [s]."""
CHUNK = 1024
"""Rows of a chunk of the file."""
NOT_HELD = ("measured_position", "lateness", "computation_time", "sample_time", "period_start")
"""Variables that are unknown in a period of which no row came; others keep their values."""


class LogFile:
    """The netCDF file.

    Parameters
    ----------
    target
        The file.
    head
        As `tarc.runtime.log_format.header` has it.
    """

    def __init__(self, target: Path, head: dict[str, Any]):
        self._head = head
        self._n = int(head["n_joints"])
        self._length = 0
        self._last = np.full(int(head["width"]), np.nan)
        self._last_position = np.full(self._n, np.nan)
        self._file = h5netcdf.File(target, "w")
        self._file.dimensions = {"time": None, "joint": self._n}
        self._add_coordinates()
        for variable in head["variables"]:
            self._add(variable["name"], variable["is_vector"], variable["attributes"])
        held = "measured position, the last valid one where a sample is missing"
        self._add("position", True, {"long_name": held, "units": head["position_unit"]})
        for name, values in head["static"].items():
            unit = head["torque_unit"] + ("/s" if "rate" in name else "")
            label = f"largest {name.removesuffix('_limit').replace('_', ' ')}"
            created = self._file.create_variable(name, ("joint",), float, data=np.array(values, dtype=float))
            created.attrs.update({"long_name": label, "units": unit})
        self.set_attributes(head["attributes"])
        self._file.flush()

    def _add_coordinates(self) -> None:
        self._file.create_variable("time", ("time",), float, chunks=(CHUNK,))
        self._file.variables["time"].attrs.update({"units": "s", "long_name": "time"})
        for name, key in (("joint", "joint_names"), ("joint_unit", "joint_units")):
            texts = np.array(self._head[key], dtype=object)
            self._file.create_variable(name, ("joint",), h5py.string_dtype(), data=texts)
        self._file.attrs["coordinates"] = "joint_unit"

    def _add(self, name: str, is_vector: bool, attributes: dict[str, str]) -> None:
        dimensions, chunks = (("time", "joint"), (CHUNK, self._n)) if is_vector else (("time",), (CHUNK,))
        variable = self._file.create_variable(name, dimensions, float, chunks=chunks, fillvalue=np.nan)
        variable.attrs.update(attributes)

    def append(self, rows: Array) -> None:
        """Write rows (k, columns); periods of which none came are filled in."""
        if not len(rows):
            return
        rows = self._without_gaps(rows)
        start, stop = self._length, self._length + len(rows)
        self._file.resize_dimension("time", stop)
        self._file.variables["time"][start:stop] = rows[:, 0] * self._head["period"]
        for variable in self._head["variables"]:
            values = rows[:, variable["start"] : variable["start"] + variable["size"]]
            target = self._file.variables[variable["name"]]
            target[start:stop] = values if target.ndim == 2 else values[:, 0]
            if variable["name"] == "measured_position":
                self._file.variables["position"][start:stop] = self._held(values)
        self._length = stop
        self._file.flush()

    def _without_gaps(self, rows: Array) -> Array:
        """Return rows with one for each period: where none came, the one before with the period marked as missed."""
        expected = int(rows[-1, 0]) + 1 - self._length
        if len(rows) == expected:
            self._last = rows[-1]
            return rows
        complete = np.empty((expected, rows.shape[1]))
        places = {variable["name"]: variable for variable in self._head["variables"]}
        filled, source = self._last, 0
        for k in range(expected):
            if int(rows[source, 0]) == self._length + k:
                complete[k] = rows[source]
                source += 1
            else:
                complete[k] = filled
                complete[k, 0] = self._length + k
                complete[k, places["overrun"]["start"]] = 1.0
                for name in NOT_HELD:
                    complete[k, places[name]["start"] : places[name]["start"] + places[name]["size"]] = np.nan
            filled = complete[k]
        self._last = rows[-1]
        return complete

    def _held(self, values: Array) -> Array:
        """Return measured positions with the last valid one where one is missing."""
        held = np.empty_like(values)
        for k, row in enumerate(values):
            self._last_position = np.where(np.isfinite(row), row, self._last_position)
            held[k] = self._last_position
        return held

    def set_attributes(self, attributes: dict[str, Any]) -> None:
        """Set attributes of the file."""
        for name, value in attributes.items():
            self._file.attrs[name] = value

    def close(self) -> None:
        """Say how long the run was, and close the file."""
        self._file.attrs["duration"] = self._length * float(self._head["period"])
        self._file.close()


def write(folder: Path, target: Path) -> None:
    """Write the rows of a ring until the loop ends."""
    parent = os.getppid()
    head = json.loads((folder / "header.json").read_text(encoding="utf-8"))
    ring = Ring(folder / "ring", "r")
    file = LogFile(target, head)
    (folder / "ready").touch()
    while True:
        is_ended = ring.is_ended or os.getppid() != parent
        file.append(ring.read())
        if is_ended:
            break
        time.sleep(POLL)
    changes, end = folder / "changes.json", folder / "end.json"
    if changes.exists():
        file.set_attributes({"gain_changes": changes.read_text(encoding="utf-8")})
    if end.exists():
        file.set_attributes(json.loads(end.read_text(encoding="utf-8")))
    file.close()
    if not ring.is_ended:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    write(Path(sys.argv[1]), Path(sys.argv[2]))
