"""Robots from MJCF or URDF files, on MuJoCo."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tarc import check
from tarc.check import Numbers
from tarc.errors import TarcError
from tarc.plants.base import Plant

PAYLOAD_RADIUS = 0.05
"""Radius [m] of the homogeneous ball that a payload is."""


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


class MujocoPlant(Plant):
    """A robot whose joints are all hinges and slides, simulated by MuJoCo. Made by `from_file`.

    Torque acts on the joints directly; actuators in the file are removed and their limits kept as
    `torque_limit`. Contacts are off unless asked for.

    Attributes
    ----------
    model
        The ``mujoco.MjModel``.
    torque_limit
        Limits from the file [N m or N], shape (n,), infinite where it has none; the smaller one where a range is
        not symmetric.
    """

    def __init__(self, spec: mujoco.MjSpec, home: np.ndarray, tool: str, payload: float, label: str):
        body = _tool_body(spec, tool, label)
        body[0].add_body(
            name="tarc_payload", pos=body[1], ipos=[0.0] * 3, mass=0.0, inertia=[0.0] * 3, explicitinertial=True
        )
        self.model: mujoco.MjModel = _compile(spec, label)
        self.label = label
        self._home = home
        self._scratch = mujoco.MjData(self.model)
        self._payload_body = self.model.body("tarc_payload").id
        limited, ranges = self.model.jnt_actfrclimited.astype(bool), np.abs(self.model.jnt_actfrcrange)
        self.torque_limit = np.where(limited, ranges.min(axis=1), np.inf)
        self.set_parameters(self.model, {"payload": np.array(payload)})
        least = np.linalg.eigvalsh(self.inertia(home))[0]
        if not least > 1e-9:
            raise TarcError(
                f"{label}: its inertia matrix is singular (smallest eigenvalue {least:.2g}); links without mass need "
                "rotor inertia: give armature=0.1, or one number a joint"
            )

    def __repr__(self) -> str:
        return f"MujocoPlant({self.label!r}, joints={self.joints})"

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        *,
        joints: Sequence[str] | None = None,
        armature: Numbers | None = None,
        viscous: Numbers | None = None,
        coulomb: Numbers | None = None,
        payload: float = 0.0,
        tool: str | None = None,
        contact: bool = False,
    ) -> "MujocoPlant":
        """Read an MJCF or URDF file, or one of the shipped robots by name (``"ur5e"``, ``"panda"``).

        Of a URDF the kinematics and inertias are read and the meshes are not needed; joints that mimic another are
        locked at zero, as are all joints that are not listed.

        Parameters
        ----------
        path
            The file.
        joints
            Names of the joints to control; None for all hinges and slides. The plant's own order is the file's.
        armature, viscous, coulomb
            Rotor inertia [kg m²], viscous [N m s/rad] and Coulomb friction [N m], one number or one a joint in the
            order of ``joints`` (of the file, if that is None); None keeps what the file has.
        payload
            Mass at the tool [kg].
        tool
            Body or site that carries the payload; None for a site named ``tool``, else the last body, which may be
            a finger.
        contact
            Compute contacts.

        Raises
        ------
        TarcError
            For a file that is missing or does not read, unknown joints, free or ball joints that are not locked, and
            an inertia matrix that is singular.
        """
        file = find_robot(path)
        spec = _read(file)
        names = [joints] if isinstance(joints, str) else joints
        home = _choose_joints(spec, names, file.name)
        kept = {joint.name: joint for joint in spec.joints}
        for name, value in (("armature", armature), ("viscous", viscous), ("coulomb", coulomb)):
            if value is not None:
                for key, number in zip(names or kept, check.vector(name, value, len(kept), 0), strict=True):
                    _set_joint(kept[key], name, float(number))
        if not contact:
            spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        return cls(spec, home, tool or "", check.number("payload", payload, 0), file.name)

    @property
    def joints(self) -> int:
        """How many joints n."""
        return self.model.nv

    @property
    def joint_names(self) -> list[str]:
        """As in the file."""
        return [self.model.joint(i).name or f"joint{i + 1}" for i in range(self.joints)]

    @property
    def joint_units(self) -> list[str]:
        """``m`` for slides."""
        return ["m" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "rad" for kind in self.model.jnt_type]

    @property
    def home(self) -> np.ndarray:
        """The keyframe ``home`` of the file, else zero, shape (n,)."""
        return self._home.copy()

    @property
    def parameters(self) -> dict[str, np.ndarray]:
        """Payload [kg], and armature, viscous and coulomb friction of each joint."""
        model = self.model
        return {
            "payload": np.array(model.body_mass[self._payload_body]),
            "armature": model.dof_armature.copy(),
            "viscous": model.dof_damping.copy().reshape(self.joints, -1)[:, 0],
            "coulomb": model.dof_frictionloss.copy(),
        }

    def set_parameters(self, model: mujoco.MjModel, values: dict[str, np.ndarray]) -> None:
        """Write parameters, as `parameters` names them, into a model of this robot."""
        if "payload" in values:
            mass = float(np.squeeze(values["payload"]))
            model.body_mass[self._payload_body] = mass
            model.body_inertia[self._payload_body] = 0.4 * mass * PAYLOAD_RADIUS**2
        if "armature" in values:
            model.dof_armature[:] = values["armature"]
        if "viscous" in values:
            model.dof_damping.reshape(self.joints, -1)[:, 0] = values["viscous"]
        if "coulomb" in values:
            model.dof_frictionloss[:] = values["coulomb"]
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def copy_model(self) -> mujoco.MjModel:
        """A model to simulate with, whose parameters may change without changing this plant."""
        import copy

        return copy.copy(self.model)

    def _placed(self, position: Any) -> mujoco.MjData:
        self._scratch.qpos[:] = check.vector("position", position, self.joints)
        self._scratch.qvel[:] = 0
        mujoco.mj_fwdPosition(self.model, self._scratch)
        return self._scratch

    def inertia(self, position: Any) -> np.ndarray:
        """M(q) with rotor inertia [kg m² or kg], shape (n, n)."""
        data = self._placed(position)
        matrix = np.zeros((self.joints, self.joints))
        mujoco.mj_fullM(self.model, data, matrix)
        return matrix

    def gravity_torque(self, position: Any) -> np.ndarray:
        """Torque that holds the robot at rest [N m or N], shape (n,)."""
        data = self._placed(position)
        mujoco.mj_fwdVelocity(self.model, data)
        return data.qfrc_bias - data.qfrc_passive


def _compile(spec: mujoco.MjSpec, label: str) -> mujoco.MjModel:
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


def _read(file: Path) -> mujoco.MjSpec:
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


def _choose_joints(spec: mujoco.MjSpec, wanted: Sequence[str] | None, label: str) -> np.ndarray:
    """Lock all joints but the wanted; the home posture of those kept."""
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
    if not wanted:
        raise TarcError(f"{label}: it has no hinge or slide joint to control")
    posture = _home(spec)
    home = np.array([posture.get(joint.name, _middle(joint)) for joint in spec.joints if joint.name in wanted])
    for group in (spec.keys, spec.equalities, spec.sensors, spec.tendons):
        for element in list(group):
            spec.delete(element)
    limits = {}
    for actuator in spec.actuators:
        low, high = np.asarray(actuator.forcerange) * actuator.gear[0]
        if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT and low != high and actuator.forcelimited:
            limits[actuator.target] = min(abs(low), abs(high))
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint in list(spec.joints):
        if joint.name not in wanted:
            spec.delete(joint)
        elif joint.name in limits and joint.actfrcrange[1] <= 0:
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.actfrcrange = [-limits[joint.name], limits[joint.name]]
    return home


def _home(spec: mujoco.MjSpec) -> dict[str, float]:
    """Joint positions of the keyframe ``home``, by name; empty if there is none or joints are not all simple."""
    key = next((key for key in spec.keys if key.name == "home"), None)
    joints = list(spec.joints)
    if key is None or len(key.qpos) != len(joints):
        return {}
    return {joint.name: float(q) for joint, q in zip(joints, key.qpos, strict=True)}


def _middle(joint: Any) -> float:
    """Zero, if the joint's range allows it, else the middle of the range."""
    low, high = joint.range
    return float((low + high) / 2) if low < high and not low < 0 < high else 0.0


def _set_joint(joint: Any, name: str, value: float) -> None:
    if name == "armature":
        joint.armature = value
    elif name == "coulomb":
        joint.frictionloss = value
    else:
        joint.damping = [value, 0.0, 0.0]


def _tool_body(spec: mujoco.MjSpec, tool: str, label: str) -> tuple[Any, Any]:
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
