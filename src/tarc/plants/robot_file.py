"""Robot files: finding, reading and trimming MJCF and URDF to the joints that a law drives."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tarc import check
from tarc.errors import TarcError


def shipped_robots() -> list[str]:
    """Names of the robot files that come with the package."""
    return sorted(
        entry.name for entry in files("tarc.plants").joinpath("robots").iterdir() if entry.name.endswith("xml")
    )


def find_robot(path: str | Path) -> Path:
    """The file itself, or one of the shipped robots by name (``ur5e`` or ``ur5e.xml``)."""
    here = Path(path).expanduser()
    shipped = Path(str(files("tarc.plants").joinpath("robots")))
    for candidate in (here, shipped / here.name, shipped / f"{here.name}.xml"):
        if candidate.is_file() and (candidate == here or len(here.parts) == 1):
            return candidate
    names = [name.removesuffix(".xml") for name in shipped_robots()]
    raise TarcError(
        f"robot file: {str(path)!r} not found; looked for {here.resolve()} and among the shipped robots "
        f"({', '.join(names)}).{check.nearest(here.stem, names)}"
    )


@contextmanager
def without_log_file() -> Iterator[None]:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT into the user's folder; a run's own status tells of divergence."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def compile_model(spec: mujoco.MjSpec, label: str) -> mujoco.MjModel:
    """The model; moving links without mass get a mass too small to matter, which MuJoCo insists on."""
    try:
        return spec.compile()
    except ValueError as error:
        if "mjMINVAL" not in str(error):
            raise TarcError(f"{label}: MuJoCo refuses the model: {error}") from None
    spec.compiler.boundmass, spec.compiler.boundinertia = 1e-9, 1e-12
    try:
        return spec.compile()
    except ValueError as error:
        raise TarcError(f"{label}: MuJoCo refuses the model: {error}") from None


def read_specification(file: Path) -> mujoco.MjSpec:
    """The file as a MuJoCo specification, actuators, keyframes aside, meshes of a URDF left out."""
    try:
        root = ET.parse(file).getroot()
    except ET.ParseError as error:
        raise TarcError(f"robot file: {file} is no XML file ({error}); needs MJCF or URDF") from None
    if root.tag not in ("robot", "mujoco"):
        raise TarcError(f"robot file: {file} has root <{root.tag}>; needs <mujoco> (MJCF) or <robot> (URDF)")
    try:
        if root.tag == "mujoco":
            return _without_missing_meshes(mujoco.MjSpec.from_file(str(file)), file)
        for link in root.iter("link"):
            for tag in ("visual", "collision"):
                for shape in link.findall(tag):
                    link.remove(shape)
        compiler = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
        compiler.set("fusestatic", "false")
        return mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise TarcError(f"robot file: MuJoCo cannot read {file}: {error}") from None


def _without_missing_meshes(spec: mujoco.MjSpec, file: Path) -> mujoco.MjSpec:
    """Drop the geoms whose mesh file is not there; their body must state its inertia itself."""
    folder = file.parent / spec.meshdir

    def missing(name: str) -> bool:
        return bool(name) and not (folder / (Path(name).name if spec.strippath else name)).is_file()

    for texture in spec.textures:
        if texture.file and not (file.parent / spec.texturedir / texture.file).is_file():
            texture.file, texture.builtin = "", mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = texture.height = 1
    gone = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes if missing(mesh.file)}
    for geom in list(spec.geoms):
        if geom.meshname in gone:
            if (
                geom.parent.name != "world"
                and not geom.parent.explicitinertial
                and geom.mass != 0
                and geom.density != 0
            ):
                raise TarcError(
                    f"robot file: {file.name} takes the inertia of body {geom.parent.name!r} from the mesh "
                    f"{gone[geom.meshname].file!r}, which is not in {folder}; add the mesh or an <inertial>"
                )
            spec.delete(geom)
    for mesh in gone.values():
        spec.delete(mesh)
    return spec


def choose_joints(spec: mujoco.MjSpec, wanted: Sequence[str] | None, label: str) -> dict[str, float]:
    """Lock all joints but the wanted; the home posture of the file, by joint."""
    for number, joint in enumerate(spec.joints):
        joint.name = joint.name or f"joint{number + 1}"
    plain = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    movable = [joint.name for joint in spec.joints if joint.type in plain]
    if wanted is None:
        loose = [joint.name for joint in spec.joints if joint.type not in plain]
        if loose:
            raise TarcError(
                f"{label}: joint {loose[0]!r} is free or a ball; a law drives hinges and slides. List the joints to "
                f"control, the others are locked: joints={movable[:3]}…"
            )
        followers = [equality.name1 for equality in spec.equalities if equality.type == mujoco.mjtEq.mjEQ_JOINT]
        wanted = [name for name in movable if name not in followers]
    for name in wanted:
        if name not in movable:
            raise TarcError(
                f"{label}: no hinge or slide {name!r}; it has {', '.join(movable)}.{check.nearest(name, movable)}"
            )
    if len(set(wanted)) < len(wanted):
        raise TarcError(f"{label}: joints: got {list(wanted)}; names one of them twice")
    if not wanted:
        raise TarcError(f"{label}: it has no hinge or slide joint to control")
    posture = _home(spec)
    for group in (spec.keys, spec.equalities, spec.sensors, spec.tendons):
        for element in list(group):
            spec.delete(element)
    limits = {}
    for actuator in spec.actuators:
        limit = _largest_torque(actuator)
        if limit is not None:
            limits[actuator.target] = limits.get(actuator.target, 0.0) + limit
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint in list(spec.joints):
        if joint.name not in wanted:
            spec.delete(joint)
        elif joint.name in limits and joint.actfrcrange[1] <= 0:
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.actfrcrange = [-limits[joint.name], limits[joint.name]]
    return posture


def _home(spec: mujoco.MjSpec) -> dict[str, float]:
    """Joint positions of the keyframe ``home``, by name; empty if there is none or joints are not all simple."""
    key = next((key for key in spec.keys if key.name == "home"), None)
    joints = list(spec.joints)
    if key is None or len(key.qpos) != len(joints):
        return {}
    return {joint.name: float(q) for joint, q in zip(joints, key.qpos, strict=True)}


def _largest_torque(actuator: Any) -> float | None:
    """What an actuator can give its joint, by its force range or a motor's control range; None if unlimited."""
    if actuator.trntype != mujoco.mjtTrn.mjTRN_JOINT:
        return None
    low, high = np.abs(np.asarray(actuator.forcerange) * actuator.gear[0])
    if (low == high == 0 or not actuator.forcelimited) and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
        low, high = np.abs(np.asarray(actuator.ctrlrange) * actuator.gainprm[0] * actuator.gear[0])
    return float(min(low, high) or max(low, high)) or None


def set_joint(joint: Any, name: str, value: float) -> None:
    """Set ``armature``, ``viscous`` or ``coulomb`` of a joint."""
    if name == "armature":
        joint.armature = value
    elif name == "coulomb":
        joint.frictionloss = value
    else:
        joint.damping = [value, 0.0, 0.0]


def tool_body(spec: mujoco.MjSpec, tool: str, label: str) -> tuple[Any, Any]:
    """Body that carries the payload, and where on it."""
    sites = {site.name: site for site in spec.sites}
    if (tool or "tool") in sites:
        site = sites[tool or "tool"]
        return site.parent, site.pos
    bodies = {body.name: body for body in spec.bodies}
    if tool:
        if tool not in bodies:
            raise TarcError(f"{label}: tool {tool!r} is no body or site of it.{check.nearest(tool, [*sites, *bodies])}")
        return bodies[tool], [0.0, 0.0, 0.0]
    last = list(spec.joints)[-1].parent
    while True:
        children = list(last.bodies)
        if not children:
            return last, [0.0, 0.0, 0.0]
        last = children[0]
