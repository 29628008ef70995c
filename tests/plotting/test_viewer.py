"""MuJoCo's viewer: what it is given to draw, and what is said where there is no window."""

import mujoco
import numpy as np
import pytest

from tarc import Scenario, plants
from tarc.core.errors import InvalidParameter, MissingTool
from tarc.plotting import viewer


@pytest.fixture(scope="module")
def run():
    changes = ["duration=0.1", "disturbance.0.start_time=0.05", "native=false"]
    return Scenario.load("ur5e", changes).run(progress=False)["TDC"]


def test_no_display_is_a_missing_tool(run, monkeypatch):
    monkeypatch.setattr(viewer, "missing_display", lambda: viewer.missing_display_on("linux", {}))
    with pytest.raises(MissingTool, match="there is no display .* run.animate"):
        run.view()


@pytest.mark.parametrize(
    ("platform", "environment", "reason"),
    [
        ("linux", {}, "there is no display"),
        ("linux", {"DISPLAY": ":0"}, ""),
        ("linux", {"WAYLAND_DISPLAY": "wayland-0"}, ""),
        ("darwin", {}, "mjpython"),
        ("win32", {}, ""),
    ],
)
def test_display_is_found_by_platform(platform, environment, reason):
    found = viewer.missing_display_on(platform, environment)
    assert reason in found
    assert bool(found) == bool(reason)


def test_robots_that_are_not_from_files_are_refused(run):
    six = (1.0,) * 6
    arm = plants.NLinkArm(masses=six, lengths=six, centres=six, inertias=six)
    named = run.data.assign_coords(joint=arm.joint_names)
    with pytest.raises(InvalidParameter, match="shows robots from files"):
        type(run)(named).view(plant=arm)


def test_robot_ghost_and_payload_are_where_the_run_has_them(run):
    robot = run.plant
    motion = viewer.PlayedRun(run, robot, robot.mujoco)
    scene = mujoco.MjvScene(motion.model, 200)
    motion.show(0.0, scene)
    n_ghost = scene.ngeom
    assert n_ghost > 20
    assert all(geom.rgba[3] == pytest.approx(0.25) for geom in scene.geoms[:n_ghost])
    motion.show(motion.end, scene)
    assert motion.data.qpos == pytest.approx(run.data["position"].values[-1], abs=1e-9)
    assert scene.ngeom == n_ghost + 1
    assert scene.geoms[n_ghost].label == "5 kg"
    assert scene.geoms[n_ghost].pos == pytest.approx(motion.data.xpos[robot.mujoco.payload_body], abs=1e-6)
    assert np.all(np.isfinite(motion.data.xpos))
