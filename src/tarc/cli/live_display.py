"""The process that shows a run on a robot while it goes on.

Run as ``python -m tarc.cli.live_display FOLDER`` with the folder of a log. It is a process of its own so that drawing
never keeps the loop waiting.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from tarc.runtime.ring import Ring

REFRESH = 0.1
"""Time between two pictures in a terminal [s]."""
LINE_TIME = 1.0
"""Time between two lines where there is no terminal [s]."""
PHASES = ("hold", "push", "ramp", "track", "stop", "safe stop")


class Display:
    """The newest row of a log, in words.

    Parameters
    ----------
    head
        Of the log.
    ring
        Its rows.
    """

    def __init__(self, head: dict[str, Any], ring: Ring):
        self._head, self._ring = head, ring
        self._places = {
            entry["name"]: slice(entry["start"], entry["start"] + entry["size"]) for entry in head["variables"]
        }
        self._names = [str(name) for name in head["joint_names"]]
        self._position = np.full(len(self._names), np.nan)
        self._overruns = 0
        self._last = -1

    def values(self) -> dict[str, np.ndarray] | None:
        """Return the newest row by the names of its variables; None before the first."""
        row = self._ring.newest()
        if row is None:
            return None
        values = {name: row[place] for name, place in self._places.items()} | {"period": row[:1]}
        measured = values["measured_position"]
        self._position = np.where(np.isfinite(measured), measured, self._position)
        return values | {"position": self._position}

    def table(self) -> Table:
        """Return position, error and torque of each joint as a table."""
        values = self.values()
        title = "waiting for the robot" if values is None else self.line(values)
        unit = self._head["position_unit"]
        table = Table("joint", title=title, title_justify="left")
        for label in (f"position [{unit}]", f"error [m{unit}]", f"torque [{self._head['torque_unit']}]"):
            table.add_column(escape(label), justify="right", min_width=12)
        if values is None:
            return table
        error = 1e3 * (values["position"] - values["reference"])
        for row in zip(self._names, values["position"], error, values["torque"], strict=True):
            name, *numbers = row
            table.add_row(
                escape(name), *(f"{number:.4f}" if k == 0 else f"{number:.3f}" for k, number in enumerate(numbers))
            )
        return table

    def line(self, values: dict[str, np.ndarray]) -> str:
        """Return time, phase and the largest error and torque on one line."""
        time_now = float(values["period"][0]) * self._head["period"]
        error = np.nanmax(np.abs(values["position"] - values["reference"]), initial=0.0)
        text = f"{time_now:7.2f} s  {PHASES[int(values['phase'][0])]:9s}"
        text += f"  error {1e3 * error:.3f} m{self._head['position_unit']}"
        text += f"  torque {np.max(np.abs(values['torque'])):.2f} {self._head['torque_unit']}"
        return text + f"  late {1e6 * float(values['lateness'][0]):.0f} µs"


def main(folder: Path) -> None:
    """Show a log until its loop ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        head = json.loads((folder / "header.json").read_text(encoding="utf-8"))
        ring = Ring(folder / "ring", "r")
    except FileNotFoundError:  # the run is over already
        return
    display, parent = Display(head, ring), os.getppid()
    console = Console()
    if console.is_terminal:
        with Live(display.table(), console=console, auto_refresh=False) as live:
            while not ring.is_ended and os.getppid() == parent:
                time.sleep(REFRESH)
                live.update(display.table(), refresh=True)
        return
    next_line = time.monotonic()
    while not ring.is_ended and os.getppid() == parent:
        time.sleep(REFRESH)
        values = display.values()
        if values is not None and time.monotonic() >= next_line:
            next_line = time.monotonic() + LINE_TIME
            print(display.line(values), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
