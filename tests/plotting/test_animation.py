"""Animations: bodies where closed forms and MuJoCo have them, shapes of files, and a page that needs nothing else."""

import base64
import re

import msgspec
import mujoco
import numpy as np
import pytest
import trimesh
import zstandard
from scipy.spatial.transform import Rotation

from tarc import Run, estimators, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter
from tarc.plants.file_shapes import find_mesh
from tarc.plants.geometry import robot_geometry
from tarc.plants.shapes import RobotGeometry, capsule
from tarc.plotting.motion import drawn_coordinates

LINKS = """
<robot name="arm">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="base"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="50" velocity="3"/></joint>
  <link name="upper"><inertial><mass value="1"/><origin xyz="0 0 0.2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{upper}</link>
  <joint name="j2" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="50" velocity="3"/></joint>
  <link name="lower"><inertial><mass value="1"/><origin xyz="0 0 0.3"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{lower}</link>
</robot>
"""


def two_joints(folder, upper="", lower=""):
    """Return an arm whose URDF has these shapes."""
    path = folder / "arm_description" / "urdf" / "arm.urdf"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(LINKS.format(upper=upper, lower=lower), encoding="utf-8")
    return plants.load_robot(path, armature=0.1)


def bounds(geometry: RobotGeometry, body: str) -> np.ndarray:
    """Return the box of a body's shapes in its own frame."""
    vertices = [shape.vertices for shape in geometry.shapes if geometry.names[shape.body] == body]
    points = np.concatenate(vertices)
    return np.array([points.min(axis=0), points.max(axis=0)])


def run_of(plant, disturbance=(), duration=0.2, inertia=None):
    """Return a short run on a plant."""
    law = laws.TDC(
        inertia=0.1 * plant.joint_inertia(plant.home) if inertia is None else inertia,
        natural_frequency=10.0,
        period=1e-3,
        estimator=estimators.Algebraic(window=0.010, degree=2),
    )
    reference = signals.Sinusoid(amplitude=0.3, frequency=2.0, offset=plant.home)
    return simulate(plant, law, reference, duration, disturbance=disturbance, initial_torque="rest", native=False)


def recorded(path):
    """Return the header and the messages of an animation."""
    match = re.search(r'window\.__VISER_EMBED_DATA__="([^"]+)"', path.read_text(encoding="utf-8"))
    assert match
    content = base64.b64decode(match.group(1))
    inner = zstandard.ZstdDecompressor().decompress(content[8:], max_output_size=int.from_bytes(content[:8], "little"))
    length = int.from_bytes(inner[:8], "little")
    return msgspec.msgpack.decode(inner[8 : 8 + length])


def test_planar_arm_ends_where_its_angles_say():
    arm = plants.NLinkArm(masses=(1, 1, 1), lengths=(0.5, 0.4, 0.3), centres=(0.2, 0.2, 0.2), inertias=(0.1, 0.1, 0.1))
    q = np.random.default_rng(0).uniform(-3, 3, (5, 3))
    positions, _ = robot_geometry(arm).world_poses(q)
    angles = np.cumsum(q, axis=1)
    tip = np.column_stack([np.cos(angles) @ arm.lengths, np.zeros(5), np.sin(angles) @ arm.lengths])
    assert positions[:, 3] == pytest.approx(tip, abs=1e-12)


def test_pendulum_hangs_at_zero():
    positions, _ = robot_geometry(plants.Pendulum(length=2.0)).world_poses(np.array([[0.0], [np.pi / 2]]))
    assert positions[:, 1] == pytest.approx(np.array([[0, 0, -2.0], [2.0, 0, 0]]), abs=1e-12)


@pytest.mark.parametrize("plant", [plants.TwoLinkArm(), plants.load_robot("panda", armature=0.1)])
def test_poses_in_the_parents_frames_give_those_in_the_world(plant):
    geometry = robot_geometry(plant)
    q = np.random.default_rng(1).uniform(-2, 2, (4, plant.n_coordinates))
    world, world_turns = geometry.world_poses(q)
    places, turns = geometry.poses(q)
    for body, parent in enumerate(geometry.parents):
        at, turn = places[:, body], Rotation.from_quat(turns[:, body], scalar_first=True)
        if parent >= 0:
            carrier = Rotation.from_quat(world_turns[:, parent], scalar_first=True)
            at, turn = world[:, parent] + carrier.apply(at), carrier * turn
        assert at == pytest.approx(world[:, body], abs=1e-12)
        own = Rotation.from_quat(world_turns[:, body], scalar_first=True)
        assert (turn.inv() * own).magnitude() == pytest.approx(0, abs=1e-7)


def test_shipped_robots_have_the_shapes_of_their_files():
    plant = plants.MujocoPlant.from_file("ur5e")
    model = plant.model
    drawn = [geom for geom in range(model.ngeom) if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE]
    assert len(robot_geometry(plant).shapes) == len(drawn)


def test_links_without_shapes_are_capsules_between_joints(tmp_path):
    geometry = robot_geometry(two_joints(tmp_path))
    assert bounds(geometry, "upper")[:, 2] == pytest.approx([0, 0.4], abs=0.05)
    assert bounds(geometry, "lower")[:, 2] == pytest.approx([0, 0.3], abs=0.05), "to the centre of mass of the last"


def test_shapes_of_a_urdf_are_read_with_origin_scale_and_colour(tmp_path):
    meshes = tmp_path / "arm_description" / "meshes"
    meshes.mkdir(parents=True)
    trimesh.creation.box(extents=[100, 200, 300]).export(meshes / "link.stl")
    box = '<visual><origin xyz="0 0 0.2" rpy="0 0 1.5707963"/><geometry><box size="0.2 0.1 0.4"/></geometry></visual>'
    name = "package://arm_description/meshes/link.stl"
    shape = f'<geometry><mesh filename="{name}" scale="0.001 0.001 0.001"/></geometry>'
    mesh = f'<visual>{shape}<material name="red"/></visual>'
    plant = two_joints(tmp_path, box, mesh)
    geometry = robot_geometry(plant)
    assert bounds(geometry, "upper") == pytest.approx(np.array([[-0.05, -0.1, 0], [0.05, 0.1, 0.4]]), abs=1e-6)
    assert bounds(geometry, "lower") == pytest.approx(np.array([[-0.05, -0.1, -0.15], [0.05, 0.1, 0.15]]), abs=1e-6)
    assert [shape.colour for shape in geometry.shapes][-1] == (255, 0, 0)
    file = tmp_path / "arm_description" / "urdf" / "arm.urdf"
    for known in ("../meshes/link.stl", f"file://{meshes}/link.stl", "package://nosuch/meshes/link.stl"):
        path = find_mesh(known, file)
        assert path is not None, known
        assert path.samefile(meshes / "link.stl")
    assert find_mesh("package://other/none.stl", file) is None


def test_a_link_whose_mesh_is_missing_is_a_capsule(tmp_path):
    box = '<visual><geometry><box size="0.2 0.1 0.4"/></geometry></visual>'
    mesh = '<visual><geometry><mesh filename="package://nosuch/link.dae"/></geometry></visual>'
    geometry = robot_geometry(two_joints(tmp_path, mesh, box))
    assert bounds(geometry, "upper")[:, 2] == pytest.approx([0, 0.4], abs=0.05)


def test_capsule_reaches_from_point_to_point():
    start, end = np.array([0.1, 0.2, 0.3]), np.array([0.4, -0.2, 0.3])
    vertices = capsule(0, start, end, 0.01).vertices
    along = (vertices - start) @ (end - start) / np.linalg.norm(end - start)
    assert [along.min(), along.max()] == pytest.approx([-0.01, 0.51], abs=1e-3)


def test_animation_is_one_file_that_holds_the_motion(tmp_path):
    plant = plants.TwoLinkArm()
    run = run_of(plant, signals.Payload(mass=1.0, start_time=0.1))
    path = run.animate(tmp_path / "run.html", others={"again": run})
    text = path.read_text(encoding="utf-8")
    assert not re.search(r'<(?:script|link|img)[^>]*(?:src|href)="(?!data:)', text), "a part that is elsewhere"
    content = recorded(path)
    end = run.data["time"].values[-1]
    assert content["durationSeconds"] == pytest.approx(end)
    messages = [message for _, message in content["messages"]]
    assert {"TDC", "again", "1 kg"} <= {message.get("props", {}).get("text") for message in messages} | {
        message.get("updates", {}).get("text") for message in messages
    }
    turns = [m for m in messages if m["type"].startswith("SetOrientation") and m["name"].endswith("robot/link1")]
    half = float(run.data["position"].values[-1, 0]) / 2
    assert np.abs(turns[-1]["wxyz"]) == pytest.approx(np.abs([np.cos(half), 0, np.sin(half), 0]), abs=1e-6)


def test_robot_behind_an_elastic_gearbox_is_drawn_at_its_links(tmp_path):
    arm = plants.TwoLinkArm()
    plant = plants.Gearbox(plant=arm, stiffness=1e4, motor_inertia=0.1, encoder="motor")
    run = run_of(plant, duration=0.05, inertia=0.1 * np.eye(2))
    times = run.data["time"].values
    assert drawn_coordinates(run, plant, "position", times) == pytest.approx(run.data["passive_position"].values)
    assert drawn_coordinates(run, plant, "reference", times) == pytest.approx(run.data["reference"].values)


def test_what_has_no_bodies_is_refused(tmp_path):
    with pytest.raises(InvalidParameter, match="WheeledMobileRobot cannot be drawn"):
        robot_geometry(plants.WheeledMobileRobot())


def test_a_loaded_run_needs_its_robot(tmp_path):
    plant = plants.Pendulum()
    run_of(plant).save(tmp_path / "run.nc")
    again = Run.load(tmp_path / "run.nc")
    with pytest.raises(InvalidParameter, match="give the robot that was simulated"):
        again.animate(tmp_path / "run.html")
    with pytest.raises(InvalidParameter, match="has the joints joint1, joint2"):
        again.animate(tmp_path / "run.html", plant=plants.TwoLinkArm())
    assert again.animate(tmp_path / "run.html", plant=plant, frame_rate=5).is_file()
