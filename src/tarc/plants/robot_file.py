"""Robot files: finding, reading and trimming MJCF and URDF to the joints that a law drives."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, RobotFileError


def shipped_robots() -> list[str]:
    """Return the names of the robot files that come with the package."""
    return sorted(
        entry.name for entry in files("tarc.plants").joinpath("robots").iterdir() if entry.name.endswith("xml")
    )


def find_robot(path: str | Path) -> Path:
    """Return the file itself, or one of the shipped robots by name (``ur5e`` or ``ur5e.xml``)."""
    file = Path(path).expanduser()
    shipped = Path(str(files("tarc.plants").joinpath("robots")))
    for candidate in (file, shipped / file.name, shipped / f"{file.name}.xml"):
        if candidate.is_file() and (candidate == file or len(file.parts) == 1):
            return candidate
    names = [name.removesuffix(".xml") for name in shipped_robots()]
    raise RobotFileError(
        f"robot file: {str(path)!r} not found; looked for {file.resolve()} and among the shipped robots "
        f"({', '.join(names)}).{check.did_you_mean(file.stem, names)}"
    )


@contextmanager
def without_log_file() -> Iterator[None]:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT into the user's folder; the status of a run reports divergence."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def compile_model(spec: mujoco.MjSpec, label: str) -> mujoco.MjModel:
    """Compile the model; moving links without mass get 1e-9 kg, since MuJoCo requires a mass."""
    try:
        return spec.compile()
    except ValueError as error:
        if "mjMINVAL" not in str(error):
            raise RobotFileError(f"{label}: MuJoCo refuses the model: {_line(error)}") from None
    spec.compiler.boundmass, spec.compiler.boundinertia = 1e-9, 1e-12
    try:
        return spec.compile()
    except ValueError as error:
        raise RobotFileError(f"{label}: MuJoCo refuses the model: {_line(error)}") from None


def check_links(spec: mujoco.MjSpec, label: str) -> None:
    """Refuse masses below zero and reversed ranges, which MuJoCo accepts."""
    for body in spec.bodies:
        if body.explicitinertial and not (np.isfinite(body.mass) and body.mass >= 0):
            raise RobotFileError(
                f"{label}: link {body.name!r} has the mass {body.mass:g} kg; needs a number of at least 0. Correct its "
                "<inertial>"
            )
    for joint in spec.joints:
        if joint.range[0] > joint.range[1]:
            raise RobotFileError(
                f"{label}: the range of joint {joint.name!r} goes from {joint.range[0]:g} to {joint.range[1]:g}; needs "
                "the lower end first"
            )


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a quaternion."""
    unit = np.array(quaternion, dtype=float)
    mujoco.mju_normalize4(unit)
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, unit)
    return matrix.reshape(3, 3)


def _line(error: Exception) -> str:
    """Return MuJoCo's message, in one line."""
    return " ".join(str(error).split())


def parse_robot(file: Path) -> ET.Element:
    """Parse the file and return its root, MJCF or URDF."""
    needs = "needs MJCF or URDF"
    try:
        content = file.read_bytes()
    except OSError as error:
        raise RobotFileError(f"robot file: {file} cannot be read: {error.strerror or error}") from None
    if not content.strip():
        raise RobotFileError(f"robot file: {file} is empty; {needs}")
    try:
        root = ET.fromstring(content)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise RobotFileError(f"robot file: {file} is no XML file ({error}); {needs}") from None
    if root.tag not in ("robot", "mujoco"):
        raise RobotFileError(f"robot file: {file} has root <{root.tag}>; needs <mujoco> (MJCF) or <robot> (URDF)")
    if any("xacro}" in str(element.tag) for element in root.iter()):
        target = "robot.urdf" if file.name != "robot.urdf" else "plain.urdf"
        raise RobotFileError(
            f"robot file: {file} is a template of xacro; make a URDF of it first: xacro {file.name} > {target}"
        )
    return root


KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical")
"""Joints of a URDF; spherical is MuJoCo's own."""


def _check_tree(root: ET.Element, file: Path) -> None:
    """Refuse duplicate names, and joints of a URDF whose kind or whose links are unknown, which MuJoCo does not
    name."""
    for tag in ("link", "joint"):
        names = [element.get("name", "") for element in root.findall(tag)]
        duplicate = next((name for name in names if names.count(name) > 1), None)
        if duplicate is not None:
            raise RobotFileError(
                f"robot file: {file}: the name {duplicate!r} stands for more than one {tag}; rename one of them"
            )
    links = [link.get("name", "") for link in root.findall("link")]
    for joint in root.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        if kind not in KINDS:
            raise RobotFileError(
                f"robot file: {file}: joint {name!r} is of the type {kind!r}; known are {', '.join(KINDS)}."
                f"{check.did_you_mean(str(kind), KINDS)}"
            )
        for end in ("parent", "child"):
            part = joint.find(end)
            link = None if part is None else part.get("link")
            if link not in links:
                raise RobotFileError(
                    f"robot file: {file}: the {end} of joint {name!r} is {link!r}, and there is no such link."
                    f"{check.did_you_mean(str(link), links)}"
                )


def read_specification(file: Path) -> mujoco.MjSpec:
    """Read the file as a MuJoCo specification, without the meshes of a URDF."""
    root = parse_robot(file)
    try:
        if root.tag == "mujoco":
            return _without_missing_meshes(mujoco.MjSpec.from_file(str(file)), file)
        _check_tree(root, file)
        for link in root.iter("link"):
            for tag in ("visual", "collision"):
                for shape in link.findall(tag):
                    link.remove(shape)
        compiler = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
        compiler.set("fusestatic", "false")
        return mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise RobotFileError(f"robot file: MuJoCo cannot read {file}: {_line(error)}") from None


def _without_missing_meshes(spec: mujoco.MjSpec, file: Path) -> mujoco.MjSpec:
    """Drop the geoms whose mesh file is not there; their body must state its inertia itself."""
    folder = file.parent / spec.meshdir

    def missing(name: str) -> bool:
        return bool(name) and not (folder / (Path(name).name if spec.strippath else name)).is_file()

    for texture in spec.textures:
        if texture.file and not (file.parent / spec.texturedir / texture.file).is_file():
            texture.file, texture.builtin = "", mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = texture.height = 1
    missing_meshes = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes if missing(mesh.file)}
    for geom in list(spec.geoms):
        if geom.meshname in missing_meshes:
            if (
                geom.parent.name != "world"
                and not geom.parent.explicitinertial
                and geom.mass != 0
                and geom.density != 0
            ):
                raise RobotFileError(
                    f"robot file: {file.name} takes the inertia of body {geom.parent.name!r} from the mesh "
                    f"{missing_meshes[geom.meshname].file!r}, which is not in {folder}; add the mesh or an <inertial>"
                )
            spec.delete(geom)
    for mesh in missing_meshes.values():
        spec.delete(mesh)
    return spec


def reduce_to_joints(spec: mujoco.MjSpec, keep: Collection[str] = ()) -> None:
    """Remove keyframes and sensors, and the constraints, tendons and actuators that are not to be kept.

    Joints keep the limits of their actuators.
    """
    for group in (spec.keys, spec.equalities, spec.sensors, spec.tendons):
        for element in list(group):
            is_coupling = isinstance(element, mujoco.MjsEquality | mujoco.MjsTendon)
            if not (is_coupling and element.name in keep):
                spec.delete(element)
    limits: dict[str, float] = {}
    for actuator in spec.actuators:
        limit = _largest_torque(actuator)
        if limit is not None:
            limits[actuator.target] = limits.get(actuator.target, 0.0) + limit
    for actuator in list(spec.actuators):
        if actuator.name not in keep:
            spec.delete(actuator)
    for joint in spec.joints:
        if joint.name in limits and joint.actfrcrange[1] <= 0:
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.actfrcrange = [-limits[joint.name], limits[joint.name]]


def actuated_joints(spec: mujoco.MjSpec) -> set[str] | None:
    """Return the names of the joints with an actuator; None where the file has no actuators of joints or tendons."""
    direct = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    indirect = (mujoco.mjtTrn.mjTRN_TENDON, mujoco.mjtTrn.mjTRN_SLIDERCRANK)
    actuators = [actuator for actuator in spec.actuators if actuator.trntype in (*direct, *indirect)]
    if not actuators:
        return None
    return {actuator.target for actuator in actuators if actuator.trntype in direct}


def _largest_torque(actuator: mujoco.MjsActuator) -> float | None:
    """Return the largest torque of an actuator, by its force range or a motor's control range; None if unlimited."""
    if actuator.trntype != mujoco.mjtTrn.mjTRN_JOINT:
        return None
    ranges = []
    if actuator.forcelimited:
        ranges.append(np.asarray(actuator.forcerange) * actuator.gear[0])
    if actuator.ctrllimited and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
        ranges.append(np.asarray(actuator.ctrlrange) * actuator.gainprm[0] * actuator.gear[0])
    limits = [float(np.min(ends) or np.max(ends)) for ends in np.abs(ranges) if np.any(ends)]
    return min(limits, default=None)


def set_joint(joint: mujoco.MjsJoint, name: str, value: float) -> None:
    """Set ``armature``, ``viscous`` or ``coulomb`` of a joint."""
    if name == "armature":
        joint.armature = value
    elif name == "coulomb":
        joint.frictionloss = value
    else:
        joint.damping = [value, 0.0, 0.0]


def tool_body(spec: mujoco.MjSpec, tool: str, driven: Sequence[str], label: str) -> tuple[Any, Any, str]:
    """Return the body that carries the payload, the position on it, and a description."""
    sites = {site.name: site for site in spec.sites}
    if (tool or "tool") in sites:
        site = sites[tool or "tool"]
        return site.parent, site.pos, f"site {site.name}"
    bodies = {body.name: body for body in spec.bodies}
    if tool:
        if tool not in bodies:
            choices = [*sites, *(name for name in bodies if name != "world")]
            raise InvalidParameter(
                f"tool: got {tool!r}; {label} has no such body or site.{check.did_you_mean(tool, choices)} It has "
                f"{', '.join(choices)}",
                "tool",
            )
        return bodies[tool], [0.0, 0.0, 0.0], f"link {tool}"
    last = [joint for joint in spec.joints if joint.name in driven][-1].parent
    while True:
        children = [child for child in last.bodies if not child.joints]
        if not children:
            return last, [0.0, 0.0, 0.0], f"link {last.name}, the last one"
        last = children[0]
