"""A robot in MuJoCo, in a process of its own that keeps its own clock.

Run as ``python -m tarc.runtime.mujoco_peer FOLDER``; `tarc.runtime.MujocoRobot` writes the folder and starts it.
"""

import json
import signal
import sys
from pathlib import Path
from typing import Any

from tarc.core.optional import require

require("robots", "tarc.runtime.MujocoRobot")

import mujoco

from tarc.core.types import Array
from tarc.runtime.peer import Body, run_peer


class MujocoBody(Body):
    """A robot in MuJoCo.

    Parameters
    ----------
    model
        The robot.
    settings
        As `tarc.runtime.MujocoRobot` writes them.
    """

    def __init__(self, model: mujoco.MjModel, settings: dict[str, Any]):
        self._model, self._data = model, mujoco.MjData(model)
        self._driven, self._measured = list(settings["driven"]), list(settings["measured"])
        self._commanded = [tuple(entry) for entry in settings["commanded"]]
        self._substeps = int(settings["substeps"])
        model.opt.timestep = float(settings["period"]) / self._substeps
        self._data.qpos[:] = settings["position"]
        mujoco.mj_forward(model, self._data)

    def position(self) -> Array:
        """Return the positions of the joints [rad or m], shape (n,)."""
        return self._data.qpos[self._measured]

    def holding_torque(self) -> Array:
        """Return the torque of the brakes [N m or N], shape (n,)."""
        return (self._data.qfrc_bias - self._data.qfrc_passive)[self._driven]

    def hold(self) -> None:
        """Stay at rest for a period."""
        self._data.qvel[:] = 0
        mujoco.mj_forward(self._model, self._data)

    def advance(self, torque: Array) -> None:
        """Move by a period under a torque [N m or N], shape (n,)."""
        for joint, actuator, scale in self._commanded:
            self._data.ctrl[actuator] = scale * torque[joint]
            torque[joint] = 0
        self._data.qfrc_applied[self._driven] = torque
        for _ in range(self._substeps):
            mujoco.mj_step(self._model, self._data)


def main(folder: Path) -> None:
    """Run the robot of a folder."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    settings = json.loads((folder / "peer.json").read_text(encoding="utf-8"))
    run_peer(folder, settings, MujocoBody(mujoco.MjModel.from_binary_path(str(folder / "model.mjb")), settings))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
