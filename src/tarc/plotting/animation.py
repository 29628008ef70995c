"""Animations of runs: robots in three dimensions in one file of HTML, recorded with viser and its static client."""

from tarc.core.optional import require

require("view", "an animation", "viser", "trimesh", "collada")

from collections.abc import Mapping
from contextlib import redirect_stdout
from html import escape
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
import viser

from tarc.core import validation as check
from tarc.core.files import file_in_folder, writing
from tarc.core.types import Array
from tarc.plants.base import Plant
from tarc.plants.geometry import robot_geometry
from tarc.plants.shapes import RobotGeometry
from tarc.plotting.motion import drawn_coordinates, robot_of
from tarc.simulation.run_events import payload_mass

if TYPE_CHECKING:
    from tarc.simulation.run import Run

MAX_FRAMES = 3000
"""Largest number of frames of an animation; longer runs have a lower frame rate."""
GHOST_COLOUR = (60, 120, 200)
GHOST_OPACITY = 0.2
GHOST_GROWTH = 0.004
"""Share of the robot's size by which the ghost is larger than the robot, so that it shows around it."""
PAYLOAD_COLOUR = (230, 159, 0)
FIELD_OF_VIEW = 0.7
"""Vertical angle that the camera sees [rad]."""
ASPECT_RATIO = 1.4
"""Width over height of the window for which the camera's distance is chosen."""


def animate(runs: Mapping[str, "Run"], plant: Plant | None, path: str | Path, frame_rate: float = 30.0) -> Path:
    """Write the robots of runs, side by side, as an animation in one file of HTML.

    Parameters
    ----------
    runs
        Runs of the same robot by the name to show.
    plant
        The robot; None for that of the first run.
    path
        File to write.
    frame_rate
        Postures per second of the run [1/s].

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InvalidParameter
        For a robot without bodies in space, and a run of another robot. For a run that was loaded and has no robot,
        and a file that cannot be written.
    """
    target = file_in_folder("animate", path)
    check.number("frame_rate", frame_rate, 0, strict=True)
    robot = robot_of(next(iter(runs.values())), plant)
    for run in runs.values():
        robot_of(run, robot)
    geometry = robot_geometry(robot)
    end = max(float(run.data["time"].values[-1]) for run in runs.values())
    times = np.linspace(0.0, end, min(int(np.ceil(end * frame_rate)) + 1, MAX_FRAMES))
    motions = {name: _Motion(run, robot, geometry, times) for name, run in runs.items()}
    html = _record(motions, geometry, times)
    title = escape(", ".join(run.title for run in runs.values()))
    html = html.replace("<title>Viser</title>", f"<title>{title}</title>", 1)
    with writing("animate", target):
        target.write_text(html, encoding="utf-8")
    return target


class _Motion:
    """Poses of a run's robot and of its reference, and the payload, at the times of the frames."""

    def __init__(self, run: "Run", plant: Plant, geometry: RobotGeometry, times: Array):
        data = run.data
        actual = drawn_coordinates(run, plant, "position", times)
        wanted = drawn_coordinates(run, plant, "reference", times)
        self.robot = geometry.poses(actual)
        self.ghost = geometry.poses(wanted)
        self.payload = payload_mass(data, times)
        self.extent = geometry.extent(np.concatenate([actual[:: max(len(times) // 50, 1)], wanted[:1]]))


def _record(motions: Mapping[str, _Motion], geometry: RobotGeometry, times: Array) -> str:
    """Return the page that shows the motions."""
    with redirect_stdout(StringIO()):  # the server greets and takes its leave there
        server = viser.ViserServer(host="127.0.0.1", verbose=False)
        try:
            nodes = _build_scene(server, motions, geometry)
            serializer = server.get_scene_serializer()
            for k, step in enumerate(np.diff(times, append=times[-1])):
                if k:
                    for robot in nodes:
                        robot.move(k)
                serializer.insert_sleep(float(step))
            return serializer.as_html()
        finally:
            server.stop()


def _build_scene(
    server: viser.ViserServer, motions: Mapping[str, _Motion], geometry: RobotGeometry
) -> list["_RobotNodes"]:
    """Add floor, camera, and the robots side by side along x, each with its ghost and its name."""
    extents = np.array([motion.extent for motion in motions.values()])
    low, high = extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)
    size = high - low
    spacing = 1.15 * size[0] + 0.1 * float(size.max())
    scene = server.scene
    scene.set_up_direction("+z")
    nodes = []
    for number, (name, motion) in enumerate(motions.items()):
        root = f"/robot{number + 1}"
        shift = (number - (len(motions) - 1) / 2) * spacing
        scene.add_frame(root, show_axes=False, position=(shift, 0.0, 0.0))
        place = (float(low[0] + high[0]) / 2, float(low[1] + high[1]) / 2, float(high[2]) + 0.02 * float(size.max()))
        scene.add_label(f"{root}/name", name, position=place, anchor="bottom-center")
        nodes.append(_RobotNodes(server, f"{root}/reference", motion.ghost, geometry, None))
        nodes.append(_RobotNodes(server, f"{root}/robot", motion.robot, geometry, motion.payload))
    width = spacing * (len(motions) - 1) + size[0]
    floor = float(low[2]) if low[2] < -0.05 * size.max() else 0.0
    cell = 10.0 ** np.floor(np.log10(float(size.max()))) / 2
    scene.add_grid(
        "/floor", *[float(2 * width), float(2 * width)], cell_size=cell, section_size=2 * cell, position=(0, 0, floor)
    )
    middle = (low + high) / 2
    seen = max(float(width) / ASPECT_RATIO, 1.25 * float(size[2]))
    distance = seen / (2 * np.tan(FIELD_OF_VIEW / 2)) + float(size[1]) / 2
    server.initial_camera.fov = FIELD_OF_VIEW
    server.initial_camera.look_at = (0.0, float(middle[1]), float(middle[2]))
    server.initial_camera.position = (0.25 * distance, float(middle[1]) - distance, float(middle[2]) + 0.3 * distance)
    return nodes


class _RobotNodes:
    """The frames of a robot's bodies in the scene."""

    def __init__(
        self,
        server: viser.ViserServer,
        root: str,
        poses: tuple[Array, Array],
        geometry: RobotGeometry,
        payload: Array | None,
    ):
        self._poses = poses
        self._mass = payload
        self._frames: list[Any] = []
        scene = server.scene
        names: list[str] = []
        for body, (name, parent) in enumerate(zip(geometry.names, geometry.parents, strict=True)):
            names.append(f"{root if parent < 0 else names[parent]}/{name.replace('/', '_')}")
            position, quaternion = poses[0][0, body], poses[1][0, body]
            self._frames.append(scene.add_frame(names[body], show_axes=False, position=position, wxyz=quaternion))
        is_ghost = payload is None
        for number, shape in enumerate(geometry.shapes):
            scene.add_mesh_simple(
                f"{names[shape.body]}/shape{number}",
                _grown(shape.vertices, shape.faces, geometry) if is_ghost else shape.vertices,
                shape.faces,
                color=GHOST_COLOUR if is_ghost else shape.colour,
                opacity=GHOST_OPACITY if is_ghost else None,
                flat_shading=not is_ghost,
                cast_shadow=not is_ghost,
            )
        self._ball: Any = None
        if payload is not None and geometry.payload is not None and np.any(payload > 0):
            name = f"{names[geometry.payload]}/payload"
            self._ball = scene.add_icosphere(name, geometry.payload_radius, color=PAYLOAD_COLOUR)
            self._label = scene.add_label(f"{name}/mass", "", anchor="bottom-left", font_screen_scale=0.8)
            self._show_payload(0)

    def move(self, frame: int) -> None:
        """Record the poses of a frame where they differ from the frame before."""
        positions, quaternions = self._poses
        for body, handle in enumerate(self._frames):
            if np.any(np.abs(positions[frame, body] - positions[frame - 1, body]) > 1e-7):
                handle.position = positions[frame, body]
            if np.any(np.abs(quaternions[frame, body] - quaternions[frame - 1, body]) > 1e-7):
                handle.wxyz = quaternions[frame, body]
        if self._ball is not None and self._mass is not None and self._mass[frame] != self._mass[frame - 1]:
            self._show_payload(frame)

    def _show_payload(self, frame: int) -> None:
        """Show the payload where there is one, with its mass."""
        mass = 0.0 if self._mass is None else float(self._mass[frame])
        self._ball.visible = mass > 0
        self._label.text = f"{mass:.3g} kg"


def _grown(vertices: Array, faces: Array, geometry: RobotGeometry) -> Array:
    """Return the vertices of a mesh moved outward by a share of the robot's size."""
    size = max(float(np.ptp(shape.vertices, axis=0).max()) for shape in geometry.shapes)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return np.asarray(vertices + GHOST_GROWTH * 3 * size * mesh.vertex_normals, dtype=np.float32)
