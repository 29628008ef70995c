"""Shapes of robots from files: those of an MJCF, those of a URDF with its meshes, or capsules between joints."""

from tarc.core.optional import require
from tarc.core.types import Array

require("view", "drawing a robot", "mujoco", "trimesh")

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from tarc.plants.mujoco import PAYLOAD_RADIUS, MujocoPlant
from tarc.plants.robot_file import find_robot, parse_robot, rotation_matrix
from tarc.plants.shapes import LINK_COLOUR, RADIUS_SHARE, BodyShape, RobotGeometry, capsule, mesh_shape

MAX_VISIBLE_GROUP = 2
"""Largest group of MuJoCo's geoms that viewers show; collision shapes are in higher ones."""

MIN_LENGTH = 1e-3
"""Shortest capsule that stands for a link [m]."""


def file_geometry(plant: MujocoPlant) -> RobotGeometry:
    """Return bodies, shapes and poses of a robot from a file.

    A link with mass but without shapes, or whose meshes are not found, is drawn as capsules between its joints. So is
    every link of a file without shapes.
    """
    model = plant.model
    path = plant.file_options.get("file")
    root = None if path is None else parse_robot(find_robot(str(path)))
    if root is not None and root.tag == "robot":
        shapes = _urdf_shapes(model, root, find_robot(str(path)))
    else:
        shapes = _model_shapes(model)
    drawn = {shape.body for shape in shapes}
    links = [body for body in range(model.nbody) if body != plant.payload_body and body not in drawn]
    if drawn:
        links = [body for body in links if model.body_mass[body] > 0]
    shapes += _capsules(plant, links)
    names = tuple(model.body(body).name or f"body{body}" for body in range(model.nbody))
    parents = (-1, *(int(parent) for parent in model.body_parentid[1:]))
    return RobotGeometry(
        names, parents, tuple(shapes), plant.payload_body, PAYLOAD_RADIUS, lambda q: _world_poses(model, q)
    )


def _world_poses(model: mujoco.MjModel, coordinates: Array) -> tuple[Array, Array]:
    """Return positions (k, b, 3) and quaternions (k, b, 4) of the bodies at coordinates (k, m)."""
    data = mujoco.MjData(model)
    positions = np.empty((len(coordinates), model.nbody, 3))
    quaternions = np.empty((len(coordinates), model.nbody, 4))
    for k, posture in enumerate(coordinates):
        data.qpos[:] = posture
        mujoco.mj_kinematics(model, data)
        positions[k] = data.xpos
        quaternions[k] = data.xquat
    return positions, quaternions


def _model_shapes(model: mujoco.MjModel) -> list[BodyShape]:
    """Return the visible geoms of a model; of a body that has none of them, the others."""
    visible = [geom for geom in range(model.ngeom) if model.geom_group[geom] <= MAX_VISIBLE_GROUP]
    bodies = {int(model.geom_bodyid[geom]) for geom in visible}
    hidden = [geom for geom in range(model.ngeom) if model.geom_group[geom] > MAX_VISIBLE_GROUP]
    shapes = []
    for geom in [*visible, *(geom for geom in hidden if model.geom_bodyid[geom] not in bodies)]:
        material = model.geom_matid[geom]
        rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
        mesh = _geom_mesh(model, geom)
        if mesh is None or rgba[3] == 0:
            continue
        pose = np.eye(4)
        pose[:3, :3] = rotation_matrix(model.geom_quat[geom])
        pose[:3, 3] = model.geom_pos[geom]
        mesh.apply_transform(pose)
        shapes.append(mesh_shape(int(model.geom_bodyid[geom]), mesh, _colour(rgba)))
    return shapes


def _geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Return a geom as a mesh in its own frame; None for planes, fields and other kinds without an end."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_BOX:
        return trimesh.creation.box(extents=2 * size)
    if kind == kinds.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(subdivisions=2, radius=size[0])
    if kind == kinds.mjGEOM_ELLIPSOID:
        ball = trimesh.creation.icosphere(subdivisions=2)
        return ball.apply_scale(size)
    if kind == kinds.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=size[0], height=2 * size[1])
    if kind == kinds.mjGEOM_CAPSULE:
        rod = trimesh.creation.capsule(radius=size[0], height=2 * size[1], count=[12, 16])
        return rod.apply_translation(-rod.bounds.mean(axis=0))
    if kind == kinds.mjGEOM_MESH:
        number = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[number], model.mesh_vertnum[number]
        first, triangles = model.mesh_faceadr[number], model.mesh_facenum[number]
        vertices = model.mesh_vert[start : start + count]
        return trimesh.Trimesh(vertices, model.mesh_face[first : first + triangles], process=False)
    return None


def _colour(rgba: Array) -> tuple[int, int, int]:
    red, green, blue = (round(255 * float(value)) for value in rgba[:3])
    return red, green, blue


def _urdf_shapes(model: mujoco.MjModel, root: ET.Element, file: Path) -> list[BodyShape]:
    """Return the visual shapes of a URDF's links, the collision shapes of a link without one."""
    bodies = {model.body(body).name: body for body in range(model.nbody)}
    materials = {material.get("name", ""): _material_colour(material) for material in root.findall("material")}
    shapes = []
    for link in root.findall("link"):
        body = bodies.get(link.get("name", ""), 0)
        for element in link.findall("visual") or link.findall("collision"):
            material = element.find("material")
            colour = None
            if material is not None:
                colour = _material_colour(material) or materials.get(material.get("name", ""))
            pose = _origin(element.find("origin"))
            for mesh in _urdf_meshes(element.find("geometry"), file):
                mesh.apply_transform(pose)
                shapes.append(mesh_shape(body, mesh, colour or _mesh_colour(mesh)))
    return shapes


def _material_colour(material: ET.Element) -> tuple[int, int, int] | None:
    element = material.find("color")
    return None if element is None else _colour(_numbers(element, "rgba", "1 1 1 1"))


def _mesh_colour(mesh: trimesh.Trimesh) -> tuple[int, int, int]:
    """Return the main colour of a mesh file's material, or that of links."""
    material = getattr(mesh.visual, "material", None)
    return LINK_COLOUR if material is None else _colour(np.asarray(material.main_color) / 255)


def _numbers(element: ET.Element, name: str, default: str) -> Array:
    return np.array(element.get(name, default).split(), dtype=float)


def _origin(element: ET.Element | None) -> Array:
    """Return the pose of an ``<origin>`` of a URDF, shape (4, 4): turns about fixed axes x, y, z."""
    if element is None:
        return np.eye(4)
    pose = trimesh.transformations.euler_matrix(*_numbers(element, "rpy", "0 0 0"), axes="sxyz")
    pose[:3, 3] = _numbers(element, "xyz", "0 0 0")
    return pose


def _urdf_meshes(geometry: ET.Element | None, file: Path) -> list[trimesh.Trimesh]:
    """Return the meshes of a ``<geometry>``; none for a mesh file that is not found or is in no known format."""
    element = None if geometry is None or not len(geometry) else geometry[0]
    if element is None:
        return []
    if element.tag == "box":
        return [trimesh.creation.box(extents=_numbers(element, "size", "0 0 0"))]
    if element.tag == "sphere":
        return [trimesh.creation.icosphere(subdivisions=2, radius=float(element.get("radius", 0)))]
    if element.tag == "cylinder":
        radius, length = float(element.get("radius", 0)), float(element.get("length", 0))
        return [trimesh.creation.cylinder(radius=radius, height=length)]
    path = find_mesh(element.get("filename", ""), file)
    if element.tag != "mesh" or path is None or path.suffix[1:].lower() not in trimesh.available_formats():
        return []
    scene = trimesh.load_scene(path, skip_materials=path.suffix.lower() == ".obj")
    meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
    for mesh in meshes:
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.apply_scale(_numbers(element, "scale", "1 1 1"))
    return meshes


def find_mesh(name: str, file: Path) -> Path | None:
    """Return the mesh that a URDF names, or None where there is no such file.

    ``package://NAME/PATH`` is looked for as NAME/PATH and as PATH in the folder of the URDF and in those above it.

    Parameters
    ----------
    name
        As the URDF has it.
    file
        The URDF.
    """
    scheme, separator, rest = name.rpartition("://")
    if scheme == "file" or not separator:
        path = file.parent / rest
        return path if path.is_file() else None
    inside = rest.partition("/")[2]
    for folder in file.resolve().parents:
        for candidate in (folder / rest, folder / inside):
            if candidate.is_file():
                return candidate
    return None


def _capsules(plant: MujocoPlant, links: list[int]) -> list[BodyShape]:
    """Return capsules from the joint of each link to those of the links that it carries, or to its centre of mass."""
    model = plant.model
    if not links:
        return []
    data = mujoco.MjData(model)
    data.qpos[:] = plant.coordinates(plant.home)
    mujoco.mj_kinematics(model, data)
    radius = RADIUS_SHARE * max(float(np.linalg.norm(data.xpos, axis=1).max()), 0.05)
    shapes = []
    for body in links:
        start = _joint_place(model, body)
        ends = [
            model.body_pos[child] + rotation_matrix(model.body_quat[child]) @ _joint_place(model, child)
            for child in range(1, model.nbody)
            if model.body_parentid[child] == body
        ]
        ends = [end for end in ends if np.linalg.norm(end - start) > MIN_LENGTH]
        if not ends and body:
            ends = [model.body_ipos[body]]
        shapes += [capsule(body, start, end, radius) for end in ends]
    return shapes


def _joint_place(model: mujoco.MjModel, body: int) -> Array:
    """Return the position of a body's first joint in the frame of the body [m], or its origin without joint."""
    return model.jnt_pos[model.body_jntadr[body]] if model.body_jntnum[body] else np.zeros(3)
