"""Robots from files, in symbols or in MuJoCo."""

from collections.abc import Sequence
from pathlib import Path

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.validation import Numbers
from tarc.plants.home_posture import Home
from tarc.plants.joint_roles import Lock
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.rigid_body import RigidBody
from tarc.plants.servo import PositionServo, ServoedPlant

BACKENDS = ("auto", "symbolic", "mujoco")


def load_robot(
    path: str | Path,
    *,
    joints: Sequence[str] | None = None,
    lock: Lock | None = None,
    passive: Sequence[str] | None = None,
    home: Home | None = None,
    armature: Numbers | None = None,
    viscous: Numbers | None = None,
    coulomb: Numbers | None = None,
    payload: float = 0.0,
    tool: str | None = None,
    contact: bool = False,
    balance_inertia: bool = False,
    actuators: str = "file",
    kp: Numbers | None = None,
    kd: Numbers | None = None,
    backend: str = "auto",
) -> RigidBody | ServoedPlant | MujocoPlant:
    """Read an MJCF or URDF file, or one of the shipped robots by name (``"ur5e"``, ``"panda"``).

    Of a URDF the kinematics and inertias are read; the meshes are not needed. A law drives those
    joints that ``joints`` lists, else those with an actuator, else all hinges and slides. In a file with actuators,
    hinges and slides without one are passive: simulated, but no torque acts on them. Certificates and designs refuse
    passive joints.

    All other joints are locked: those that ``lock`` names or ``joints`` leaves out, those that mimic another, and free
    and ball joints. So are those that an actuator moves through a tendon. Passive joints, a floating base and joints
    that a tendon moves are named in a `RobotFileWarning`, unless ``lock`` names them.

    Parameters
    ----------
    path
        The file.
    joints
        Names of the joints to drive. The plant's joints keep the order of the file.
    lock
        Joints to lock in the home posture, by name, or positions [rad or m] to lock them at, by name.
    passive
        Names of joints that move without a torque, beside those without an actuator in a file with actuators. A joint
        that mimics another then follows it by a constraint, in MuJoCo.
    home
        Home posture [rad or m]: one number per joint in the order of ``joints`` or of the file, or numbers by name.
        A name may also be that of a locked joint. None for the keyframe ``home``, else zero, or the middle of a range
        without zero. Where the torque limits do not hold the robot there, it is the nearest of 2000 random postures in
        which 80 % of them do.
    armature, viscous, coulomb
        Rotor inertia [kg m²], viscous [N m s/rad] and Coulomb friction [N m]: one number, or one per joint in the
        order of ``joints`` or of the file. None keeps the values of the file.
    payload
        Mass at the tool [kg].
    tool
        Body or site that carries the payload; None for a site named ``tool``, else the last body, which may be
        a finger.
    contact
        Compute contacts, which needs MuJoCo.
    balance_inertia
        Replace the moments of an inertia that no body has by their mean, with a `RobotFileWarning`. Links that are
        fixed to each other are judged by their sum.
    actuators
        ``"file"`` for what the actuators of an MJCF take. A joint with a ``position`` or ``velocity`` actuator, or a
        general one with their bias, takes a commanded position or velocity. ``"torque"`` for torques at all joints,
        with the limits of the actuators.
    kp, kd
        Gains of position loops at all joints, as of `tarc.plants.PositionServo`; None for none. They replace those of
        the file.
    backend
        ``"symbolic"`` for equations of motion in CasADi, which are compiled and differentiated exactly.
        ``"mujoco"`` for MuJoCo, step by step. ``"auto"`` for the first where the robot permits it.

    Returns
    -------
    RigidBody, ServoedPlant or MujocoPlant
        The robot; a `ServoedPlant` where joints take commanded positions or velocities.

    Raises
    ------
    RobotFileError
        For a file that is missing or does not read, and balls that are not locked. For constraints of parts that are
        not rigid, and some tendons in space over joints of which only some are locked. For actuators of other kinds
        than torque, position and velocity. For links with an inertia that no body has, and for an inertia matrix that
        is singular. Also for a robot that only MuJoCo simulates where the backend is ``"symbolic"``.
    InvalidParameter
        For joints or a tool that the file does not have, negative parameters, and an unknown backend. Also for a home
        posture outside the ranges, for ``kd`` without ``kp``, and for ``kp`` where MuJoCo simulates the robot.
    """
    check.one_of("backend", backend, BACKENDS)
    plant = MujocoPlant.from_file(
        path,
        joints=joints,
        lock=lock,
        passive=passive,
        home=home,
        armature=armature,
        viscous=viscous,
        coulomb=coulomb,
        payload=payload,
        tool=tool,
        contact=contact,
        balance_inertia=balance_inertia,
        actuators=actuators if kp is None else "torque",
    )
    if backend != "auto":
        plant._file_options["backend"] = backend
    uses_mujoco = backend == "mujoco" or (backend == "auto" and bool(plant.needs_mujoco))
    if kp is not None:
        return _with_position_loops(plant, kp, kd, uses_mujoco)
    if kd is not None:
        raise InvalidParameter(f"kd: got {kd!r} without kp; give the gain of the position loops too", "kd")
    if uses_mujoco:
        return plant
    plant.require_equations()
    if plant.servo is None:
        return RigidBody(plant)
    return ServoedPlant(RigidBody(plant.without_servo()), plant.servo).from_file()


def _with_position_loops(plant: MujocoPlant, kp: Numbers, kd: Numbers | None, uses_mujoco: bool) -> PositionServo:
    """Return a robot of torques with position loops at its joints."""
    if uses_mujoco:
        reason = plant.needs_mujoco or "backend='mujoco'"
        raise InvalidParameter(
            f"kp: {plant.label} is simulated by MuJoCo ({reason}); give its file the actuators", "kp"
        )
    options = {key: value for key, value in (("kp", kp), ("kd", kd)) if value is not None}
    plant._file_options = {key: value for key, value in plant._file_options.items() if key != "actuators"} | options
    return PositionServo(RigidBody(plant), kp, 0.0 if kd is None else kd).from_file()
