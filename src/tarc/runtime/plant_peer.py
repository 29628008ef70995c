"""A robot in symbols, in a process of its own that keeps its own clock.

Run as ``python -m tarc.runtime.plant_peer FOLDER``; `tarc.runtime.PlantRobot` writes the folder and starts it.
"""

import json
import signal
import sys
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from tarc.core.types import Array
from tarc.runtime.peer import Body, run_peer


class PlantBody(Body):
    """A robot by its traced motion over a period.

    Parameters
    ----------
    motion
        ``[state, torque] -> [next state, position]``, as `tarc.runtime.sampled_plant.SampledPlant.function` returns it.
    holding
        Torque at rest over the position.
    settings
        As `tarc.runtime.PlantRobot` writes them.
    """

    def __init__(self, motion: ca.Function, holding: ca.Function, settings: dict[str, Any]):
        self._motion, self._holding = motion, holding
        position = np.array(settings["position"], dtype=float)
        self._n = len(position)
        self._state = np.concatenate([position, np.zeros(self._n)])

    def position(self) -> Array:
        """Return the positions of the joints [rad or m], shape (n,)."""
        return self._state[: self._n]

    def holding_torque(self) -> Array:
        """Return the torque of the brakes [N m or N], shape (n,)."""
        return np.asarray(self._holding(self.position())).ravel()

    def hold(self) -> None:
        """Stay at rest for a period."""
        self._state[self._n :] = 0.0

    def advance(self, torque: Array) -> None:
        """Move by a period under a torque [N m or N], shape (n,)."""
        self._state = np.asarray(self._motion(self._state, torque)[0]).ravel()


def main(folder: Path) -> None:
    """Run the robot of a folder."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    settings = json.loads((folder / "peer.json").read_text(encoding="utf-8"))
    motion, holding = (ca.Function.load(str(folder / name)) for name in ("motion.casadi", "holding.casadi"))
    run_peer(folder, settings, PlantBody(motion, holding, settings))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
