"""What the page reads of a loop that runs in another process."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tarc.core.types import Array
from tarc.runtime.ring import Ring
from tarc.studio.results import LiveLog

PHASES = ("hold", "push", "ramp", "track", "stop", "safe stop")


@dataclass(frozen=True, eq=False)
class LiveRows:
    """Rows since the last look.

    Attributes
    ----------
    times
        [s], shape (k,).
    errors, torques
        Norm over the joints, shape (k,), in the units of the reader.
    lateness
        How late each period began [µs], shape (k,); nan for a missed one.
    phase
        Of the newest row, in words.
    """

    times: Array
    errors: Array
    torques: Array
    lateness: Array
    phase: str


class LiveReader:
    """Reads the rows of a loop out of the memory that both map; the loop never waits.

    Attributes
    ----------
    units
        Of ``error`` and ``torque``: mrad or mm, but rad or m where joints of both kinds mix.

    Raises
    ------
    FileNotFoundError
        For a run that is over already.
    """

    def __init__(self, log: LiveLog) -> None:
        folder = Path(log.folder)
        head = json.loads((folder / "header.json").read_text(encoding="utf-8"))
        self._places = {part["name"]: slice(part["start"], part["start"] + part["size"]) for part in head["variables"]}
        self._period = float(head["period"])
        position = str(head["position_unit"])
        is_plain = position in ("rad", "m")
        self._error_scale = 1e3 if is_plain else 1.0
        self.units = {"error": f"m{position}" if is_plain else position, "torque": str(head["torque_unit"])}
        self._ring = Ring(folder / "ring", "r")

    def read(self) -> LiveRows | None:
        """Return the rows since the last call; None for none."""
        rows = self._ring.read()
        if not len(rows):
            return None
        errors = rows[:, self._places["measured_position"]] - rows[:, self._places["reference"]]
        return LiveRows(
            times=rows[:, 0] * self._period,
            errors=self._error_scale * np.linalg.norm(errors, axis=1),
            torques=np.linalg.norm(rows[:, self._places["torque"]], axis=1),
            lateness=1e6 * rows[:, self._places["lateness"]].ravel(),
            phase=PHASES[int(rows[-1, self._places["phase"]][0])],
        )
