"""Runs in MuJoCo's viewer, where there is a display."""

from tarc.core.optional import require

require("robots", "MuJoCo's viewer", "mujoco")

import os
import sys
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, MissingTool
from tarc.plants.base import Plant
from tarc.plants.drawn import drawn_plant
from tarc.plants.mujoco import MujocoPlant
from tarc.plotting.motion import drawn_coordinates, robot_of
from tarc.simulation.run_events import payload_mass

if TYPE_CHECKING:
    from tarc.simulation.run import Run

FRAME_RATE = 60.0
"""Postures per second that are shown [1/s]."""
GHOST_COLOUR = (0.24, 0.47, 0.78, 0.25)
PAYLOAD_COLOUR = (0.9, 0.62, 0.0, 1.0)


def missing_display() -> str:
    """Return why no window can be opened here, or an empty text."""
    return missing_display_on(sys.platform, os.environ)


def require_window() -> None:
    """Check that a window can be opened.

    Raises
    ------
    MissingTool
        With the reason.
    """
    reason = missing_display()
    if reason:
        raise MissingTool(f"view: {reason}; run.animate('run.html') or --animate run.html needs none")


def missing_display_on(platform: str, environment: Mapping[str, str]) -> str:
    """Return why no window can be opened, or an empty text.

    Parameters
    ----------
    platform
        As `sys.platform`.
    environment
        Variables of the environment.
    """
    if platform == "darwin" and "MJPYTHON_BIN" not in environment:
        return "macOS lets only mjpython open its window: mjpython your_file.py"
    if platform.startswith("linux") and not (environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")):
        return "there is no display (DISPLAY is not set)"
    return ""


def view(run: "Run", plant: Plant | None = None, speed: float = 1.0) -> None:
    """Play a run in MuJoCo's viewer, over and over, until its window is closed.

    Parameters
    ----------
    run
        The run.
    plant
        The robot; None for the one that was simulated.
    speed
        Time of the run per time on the clock.

    Raises
    ------
    InvalidParameter
        For a robot that is not from a file, and a run that was loaded and has no robot.
    MissingTool
        Where no window can be opened.
    """
    check.number("speed", speed, 0, strict=True)
    robot = robot_of(run, plant)
    drawn = drawn_plant(robot)
    if not isinstance(drawn, MujocoPlant):
        raise InvalidParameter(
            f"plant: MuJoCo's viewer shows robots from files, and {robot.label} is not from one; use run.animate"
        )
    require_window()
    motion = PlayedRun(run, robot, drawn)
    from mujoco import viewer  # loads the window system

    with viewer.launch_passive(motion.model, motion.data, show_left_ui=False, show_right_ui=False) as window:
        start = time.perf_counter()
        while window.is_running():
            passed = speed * (time.perf_counter() - start)
            with window.lock():
                motion.show(passed % max(motion.end, 1e-3), window.user_scn)
            window.sync()
            time.sleep(1 / FRAME_RATE)


class PlayedRun:
    """A run's postures in a copy of the robot's model.

    Attributes
    ----------
    model, data
        Copy of the robot's model, and its data in the present posture.
    end
        Time of the last posture [s].
    """

    def __init__(self, run: "Run", robot: Plant, drawn: MujocoPlant):
        self.model = drawn.copy_model()
        self.data = mujoco.MjData(self.model)
        self._ghost = mujoco.MjData(self.model)
        self.end = float(run.data["time"].values[-1])
        times = np.linspace(0.0, self.end, int(np.ceil(self.end * FRAME_RATE)) + 1)
        self._times = times
        self._positions = drawn_coordinates(run, robot, "position", times)
        self._references = drawn_coordinates(run, robot, "reference", times)
        self._mass = payload_mass(run.data, times)
        self._payload = drawn.payload_body
        self._option = mujoco.MjvOption()

    def show(self, instant: float, scene: mujoco.MjvScene) -> None:
        """Pose the robot at an instant [s], and add its ghost and its payload to a scene."""
        frame = min(int(np.searchsorted(self._times, instant)), len(self._times) - 1)
        for data, postures in ((self.data, self._positions), (self._ghost, self._references)):
            data.qpos[:] = postures[frame]
            data.time = self._times[frame]
            mujoco.mj_forward(self.model, data)
        scene.ngeom = 0
        movable = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
        mujoco.mjv_addGeoms(self.model, self._ghost, self._option, mujoco.MjvPerturb(), movable, scene)
        for geom in scene.geoms[: scene.ngeom]:
            geom.rgba[:] = GHOST_COLOUR
        if self._mass[frame] > 0 and scene.ngeom < scene.maxgeom:
            self._add_payload(scene, self._mass[frame])

    def _add_payload(self, scene: mujoco.MjvScene, mass: float) -> None:
        """Add the ball that stands for the payload, with its mass [kg]."""
        geom = scene.geoms[scene.ngeom]
        kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, [0.05, 0.0, 0.0]
        place = self.data.xpos[self._payload]
        mujoco.mjv_initGeom(geom, kind, np.array(size), place, np.eye(3).ravel(), np.array(PAYLOAD_COLOUR, np.float32))
        geom.label = f"{mass:.3g} kg"
        scene.ngeom += 1
