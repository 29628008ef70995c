"""Tendons over joints of which some are locked: what the locked ones give to the length is a constant."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

from collections.abc import Collection, Mapping

import mujoco
import numpy as np

from tarc.core.errors import RobotFileError
from tarc.core.types import Array

COPIED = (
    "actfrclimited",
    "actfrcrange",
    "armature",
    "damping",
    "frictionloss",
    "group",
    "limited",
    "margin",
    "range",
    "solimp_friction",
    "solimp_limit",
    "solref_friction",
    "solref_limit",
    "springlength",
    "stiffness",
    "width",
)
"""Attributes of a tendon besides its name and its path."""


def refuse_unknown_lengths(
    spec: mujoco.MjSpec, partial: Mapping[str, list[str]], held: Collection[str], label: str
) -> None:
    """Refuse tendons in space over locked joints whose length in the file's own posture counts.

    Locked joints shorten a tendon of joints by a constant, and leave the path of a tendon in space as it is.

    Parameters
    ----------
    spec
        The file.
    partial
        The locked joints of each tendon that acts on joints that move too, by its name.
    held
        Names of tendons in equality constraints.
    label
        The file's name.

    Raises
    ------
    RobotFileError
        For a tendon in space with a spring of no stated length, or in an equality constraint.
    """
    for tendon in spec.tendons:
        if tendon.name not in partial or is_of_joints(tendon):
            continue
        has_free_spring = np.any(tendon.stiffness) and has_automatic_spring(tendon)
        if has_free_spring or tendon.name in held:
            reason = "an equality constraint holds it" if tendon.name in held else "its spring has no springlength"
            raise RobotFileError(
                f"{label}: the tendon {tendon.name!r} goes through space, and {reason}. MuJoCo then takes its length "
                f"with all joints at zero displacement, but {', '.join(partial[tendon.name])} would be locked. Lock "
                "all of its joints (lock=, --lock), or none, or state its springlength"
            )


def is_of_joints(tendon: mujoco.MjsTendon) -> bool:
    """Return whether the length of a tendon is a weighted sum of positions of joints: a ``fixed`` tendon."""
    return any(wrap.type == mujoco.mjtWrap.mjWRAP_JOINT for wrap in tendon.path)


def has_automatic_spring(tendon: mujoco.MjsTendon) -> bool:
    """Return whether the spring of a tendon is at rest in the file's own posture."""
    return bool(np.all(np.asarray(tendon.springlength) == -1))


def shorten_tendons(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    acting: Collection[str],
    moving: Collection[str],
    posture: Mapping[str, Array],
    label: str,
) -> None:
    """Take locked joints out of the fixed tendons that act, which stay the same otherwise.

        L' = L − c,    c = Σ coef q over the locked joints

    Range and rest length shift by c. A tendon constraint x₁ = P(x₂) has displacements x = L − L₀ from the length in the
    file's own posture. With x = x' + δ it becomes x₁' = P(x₂' + δ₂) − δ₁, for δ = Σ coef (q − q₀) over the locked
    joints.

    Parameters
    ----------
    spec
        The file, before joints are locked.
    model
        Its kinematics, with all joints.
    acting
        Names of the constraints and tendons that stay.
    moving
        Names of the driven and the passive joints.
    posture
        Home position of each joint.
    label
        The file's name.

    Raises
    ------
    RobotFileError
        For a constraint that determines a tendon of locked joints alone by no linear function.
    """
    coefficients = {
        tendon.name: {wrap.target.name: float(wrap.coef) for wrap in tendon.path}
        for tendon in spec.tendons
        if is_of_joints(tendon)
    }
    places = {name: int(model.joint(name).qposadr[0]) for name in posture}

    def locked_length(path: Mapping[str, float], zeros: Array | None = None) -> float:
        return sum(
            weight * (float(posture[name][0]) - (0.0 if zeros is None else zeros[places[name]]))
            for name, weight in path.items()
            if name not in moving
        )

    shifts = {tendon: locked_length(path, model.qpos0) for tendon, path in coefficients.items()}
    for equality in spec.equalities:
        if equality.name in acting and equality.type == mujoco.mjtEq.mjEQ_TENDON:
            still = {name for name, path in coefficients.items() if not path.keys() & set(moving)}
            _shift_constraint(equality, shifts, still, label)
    for tendon in list(spec.tendons):
        path = coefficients.get(tendon.name, {})
        if tendon.name in acting and path.keys() - set(moving):
            at_rest = sum(weight * float(model.qpos_spring[places[name]]) for name, weight in path.items())
            free = {name: path[name] for name in path if name in moving}
            _rebuild(spec, tendon, free, locked_length(path), at_rest)


def _rebuild(
    spec: mujoco.MjSpec, tendon: mujoco.MjsTendon, path: Mapping[str, float], shift: float, at_rest: float
) -> None:
    """Replace a tendon by one over some joints, shorter by a constant."""
    values = {name: np.copy(value) if np.ndim(value := getattr(tendon, name)) else value for name in COPIED}
    name = tendon.name
    rest = np.full(2, at_rest) if has_automatic_spring(tendon) else values["springlength"]
    spec.delete(tendon)
    shortened = spec.add_tendon(name=name)
    for key, value in values.items():
        setattr(shortened, key, value)
    shortened.range = values["range"] - shift
    shortened.springlength = rest - shift
    for joint, weight in path.items():
        shortened.wrap_joint(joint, weight)


def _shift_constraint(
    equality: mujoco.MjsEquality, shifts: Mapping[str, float], still: Collection[str], label: str
) -> None:
    """Write a tendon constraint in the displacements that the joints that move give, and without tendons at rest."""
    first, second = equality.name1, equality.name2
    values = np.array(equality.data)
    polynomial = np.polynomial.Polynomial(values[:5])
    if second:
        polynomial = polynomial(np.polynomial.Polynomial([shifts.get(second, 0.0), 1.0]))
    polynomial = polynomial - shifts.get(first, 0.0)
    constant, *others = np.append(polynomial.coef, np.zeros(5))[:5]
    if first in still:
        if not others[0] or np.any(others[1:]):
            raise RobotFileError(
                f"{label}: the tendon constraint {equality.name!r} holds the tendon {first!r}, all of whose joints are "
                f"locked, by a function of {second!r} that is not linear. Lock the joints of {second!r} too"
            )
        first, second = second, ""
        constant, others = -constant / others[0], [0.0] * 4
    elif second in still:
        second, others = "", [0.0] * 4
    equality.name1, equality.name2 = first, second
    values[:5] = [constant, *others]
    equality.data = values
