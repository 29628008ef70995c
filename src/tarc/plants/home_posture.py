"""The home posture of a robot file, and joints that are locked in it."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

from collections.abc import Callable, Collection, Mapping, Sequence

import mujoco
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, RobotFileError
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.plants.constraints import follower_position
from tarc.plants.joint_roles import Lock
from tarc.plants.robot_file import compile_model, rotation_matrix

Home = Numbers | Mapping[str, float]
"""Positions [rad or m] of the joints: one number per driven joint, or by name."""

SHARE_AT_HOME = 0.8
"""Largest share of the torque limits that gravity takes in a home posture that is searched for."""

SCALAR = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def compile_kinematics(spec: mujoco.MjSpec, label: str) -> mujoco.MjModel:
    """Return the model of the bodies and joints of a file alone; each body has a unit inertia."""
    copy = spec.copy()
    groups = (
        *(copy.keys, copy.sensors, copy.actuators, copy.tendons, copy.equalities, copy.pairs, copy.excludes),
        *(copy.tuples, copy.skins, copy.flexes, copy.geoms, copy.meshes, copy.hfields),
    )
    for group in groups:
        for element in list(group):
            copy.delete(element)
    for body in copy.bodies:
        if body.name != "world":
            body.explicitinertial = True
            body.mass = 1.0
            body.inertia = np.ones(3)
            body.fullinertia = np.full(6, np.nan)
            body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    return compile_model(copy, label)


def home_posture(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    selected: Sequence[str],
    home: Home | None,
    lock: Lock | None,
    label: str,
) -> dict[str, Array]:
    """Return the home position of each joint of a file, by name.

    A hinge or slide has one number, a ball four and a free joint seven. The first of these
    that is known counts: the argument, the keyframe ``home``, zero where the range contains it, the middle of the
    range. A driven joint does not start at the end of its range. A joint that mimics another is where that one puts it,
    unless its own position is known.

    Parameters
    ----------
    spec, model
        The file, and its kinematics.
    selected
        Names of the driven joints, in the order of the argument.
    home
        Positions that the user gives [rad or m].
    lock
        Joints to lock; a mapping has their positions [rad or m].
    label
        The file's name.

    Raises
    ------
    RobotFileError
        For a keyframe of another length than the robot's posture.
    InvalidParameter
        For positions of unknown joints, and for those outside the range of their joint.
    """
    key = home_keyframe(spec)
    if key is not None and len(key.qpos) != model.nq:
        raise RobotFileError(
            f"{label}: its keyframe home has {len(key.qpos)} positions; needs {model.nq}, one per hinge and slide, "
            "four per ball and seven per free joint"
        )
    posture = {}
    for joint in spec.joints:
        number = model.joint(joint.name).id
        place = _address(model, number)
        if key is not None:
            posture[joint.name] = np.array(key.qpos, dtype=float)[place]
        elif joint.type in SCALAR:
            posture[joint.name] = np.array([_within_range(model, number, joint.name in selected)])
        else:
            posture[joint.name] = model.qpos0[place].copy()
    given = _given("home", home, selected, spec, label)
    if isinstance(lock, Mapping):
        given |= _given("lock", lock, selected, spec, label)
    for name, value in given.items():
        number = model.joint(name).id
        low, high = model.jnt_range[number]
        if model.jnt_limited[number] and not low <= value <= high:
            option = "lock" if isinstance(lock, Mapping) and name in lock else "home"
            raise InvalidParameter(
                f"{option}: got {value:g} for joint {name} of {label}; its range is {low:g} to {high:g}", option
            )
        posture[name] = np.array([value])
    _follow_leaders(spec, model, posture, given, has_keyframe=key is not None)
    return posture


def home_keyframe(spec: mujoco.MjSpec) -> mujoco.MjsKey | None:
    """Return the keyframe ``home`` of a file, or None."""
    return next((key for key in spec.keys if key.name == "home" and len(key.qpos)), None)


def _follow_leaders(
    spec: mujoco.MjSpec, model: mujoco.MjModel, posture: dict[str, Array], given: Collection[str], has_keyframe: bool
) -> None:
    """Put joints that mimic others where those put them, unless the user or the keyframe gives their position."""
    followers = {
        equality.name1: equality
        for equality in spec.equalities
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.active and equality.name2
    }
    zeros = {name: model.qpos0[int(model.joint(name).qposadr[0])] for name in posture}
    for _ in followers:  # one may follow another
        for name, equality in followers.items():
            leader = equality.name2
            if name in given or (has_keyframe and leader not in given):
                continue
            displacement = float(posture[leader][0] - zeros[leader])
            posture[name] = np.array([zeros[name] + follower_position(np.array(equality.data), displacement)])


def holding_posture(
    gravity: Callable[[Array], Array], limits: Array, ranges: Array, posture: Array, n_samples: int = 2000
) -> Array:
    """Return the posture (n,) nearest to another one in which torque limits hold the robot, or that one itself.

    Parameters
    ----------
    gravity
        Torque [N m or N] that keeps the robot at rest at a posture.
    limits
        Largest torque of each joint, shape (n,); infinite where unknown, zero where there is none.
    ranges
        Range of each joint [rad or m], shape (n, 2). An infinite range is taken as ±π about the posture.
    posture
        The posture to start from.
    n_samples
        Number of random postures to try.
    """
    limits = np.where(limits > 0, limits, np.inf)
    if np.all(np.abs(gravity(posture)) <= limits):
        return posture
    low = np.where(np.isfinite(ranges[:, 0]), ranges[:, 0], posture - np.pi)
    high = np.where(np.isfinite(ranges[:, 1]), ranges[:, 1], posture + np.pi)
    samples = low + (high - low) * np.random.default_rng(0).random((n_samples, len(posture)))
    middle = (low + high) / 2
    samples = np.vstack([middle, samples])
    distances = np.linalg.norm((samples - posture) / np.maximum(high - low, 1e-9), axis=1)
    for place in np.argsort(distances):
        if np.all(np.abs(gravity(samples[place])) <= SHARE_AT_HOME * limits):
            return samples[place]
    return posture


def _address(model: mujoco.MjModel, joint: int) -> slice:
    """Return the place of a joint in the posture."""
    start = int(model.jnt_qposadr[joint])
    sizes = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
    return slice(start, start + sizes.get(mujoco.mjtJoint(int(model.jnt_type[joint])), 1))


def _within_range(model: mujoco.MjModel, joint: int, driven: bool) -> float:
    """Return zero where the range contains it, for a driven joint inside its ends, else the middle of the range."""
    low, high = model.jnt_range[joint]
    contains_zero = low < 0 < high if driven else low <= 0 <= high
    if not model.jnt_limited[joint] or contains_zero:
        return 0.0
    return float(low + high) / 2


def _given(key: str, home: Home | None, selected: Sequence[str], spec: mujoco.MjSpec, label: str) -> dict[str, float]:
    """Return the positions that the user gives, by name."""
    if home is None:
        return {}
    if not isinstance(home, Mapping):
        return dict(zip(selected, check.vector("home", home, len(selected)).tolist(), strict=True))
    movable = [joint.name for joint in spec.joints if joint.type in SCALAR]
    for name in home:
        if name not in movable:
            raise InvalidParameter(
                f"{key}: {label} has no hinge or slide {name!r}; it has {', '.join(movable)}."
                f"{check.did_you_mean(str(name), movable)}",
                key,
            )
    return {name: check.number(f"{key}: joint {name}", value) for name, value in home.items()}


def lock_joints(
    spec: mujoco.MjSpec, model: mujoco.MjModel, selected: Collection[str], posture: Mapping[str, Array]
) -> None:
    """Delete the joints that are not selected, with their bodies where they are in a posture."""
    for body in spec.bodies:
        joints = list(body.joints)
        if any(joint.name not in selected for joint in joints):
            _lock_body(body, joints, model, selected, posture)
    for joint in list(spec.joints):
        if joint.name not in selected:
            spec.delete(joint)


def _lock_body(
    body: mujoco.MjsBody,
    joints: Sequence[mujoco.MjsJoint],
    model: mujoco.MjModel,
    selected: Collection[str],
    posture: Mapping[str, Array],
) -> None:
    """Move a body to where its locked joints are; the axes of joints before them are seen from its new frame.

    The pose of a body is A·T₁·T₂·…, with one displacement T per joint. A locked T₂ becomes a part of the pose:
    A·T₁·T₂ = A·T₂·(T₂⁻¹·T₁·T₂).
    """
    number = int(model.joint(joints[0].name).bodyid[0])
    place, quaternion = model.body_pos[number].copy(), model.body_quat[number].copy()
    free: dict[str, tuple[Array, Array]] = {}
    has_moved = False
    for joint in joints:
        index = model.joint(joint.name).id
        anchor, axis = model.jnt_pos[index].copy(), model.jnt_axis[index].copy()
        if joint.name in selected:
            free[joint.name] = anchor, axis
            continue
        position, reference = posture[joint.name], model.qpos0[_address(model, index)]
        if np.array_equal(position, reference):
            continue
        has_moved = True
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            place, quaternion = position[:3], position[3:]
            continue
        shift, turn = _displacement(joint.type, anchor, axis, position, reference)
        place = place + rotation_matrix(quaternion) @ shift
        quaternion = _product(quaternion, turn)
        back = rotation_matrix(turn).T
        free = {name: (back @ (point - shift), back @ line) for name, (point, line) in free.items()}
    if not has_moved:
        return
    _without_frame(body, body.parent)
    body.pos, body.quat = place, quaternion / np.linalg.norm(quaternion)
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    for joint in joints:
        if joint.name in free:
            _without_frame(joint, body)
            joint.pos, joint.axis = free[joint.name]


def _displacement(
    kind: mujoco.mjtJoint, anchor: Array, axis: Array, position: Array, reference: Array
) -> tuple[Array, Array]:
    """Return the shift and the rotation (a quaternion) of a body by a hinge, slide or ball in a position."""
    turn = np.array([1.0, 0.0, 0.0, 0.0])
    if kind == mujoco.mjtJoint.mjJNT_SLIDE:
        return axis * float(position[0] - reference[0]), turn
    if kind == mujoco.mjtJoint.mjJNT_HINGE:
        mujoco.mju_axisAngle2Quat(turn, axis, float(position[0] - reference[0]))
    else:
        turn = position / np.linalg.norm(position)
    return anchor - rotation_matrix(turn) @ anchor, turn


def _product(first: Array, second: Array) -> Array:
    result = np.zeros(4)
    mujoco.mju_mulQuat(result, first, second)
    return result


def _without_frame(element: mujoco.MjsBody | mujoco.MjsJoint, parent: mujoco.MjsBody) -> None:
    """Put an element directly into its parent, where a <frame> of the file is between them."""
    if element.frame is not None:
        element.set_frame(parent.add_frame())
