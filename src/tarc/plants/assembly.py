"""Positions that satisfy the equality constraints of a MuJoCo model."""

from tarc.core.optional import require

require("robots", "tarc.plants.MujocoPlant")

from collections.abc import Sequence

import mujoco
import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.formatting import format_vector
from tarc.core.types import Array

TOLERANCE = 1e-10
"""Violation of the constraints [m or rad] that counts as none."""

MAX_VIOLATION = 1e-4
"""Violation [m or rad] with which a mechanism is not assembled."""

MAX_STEP = 0.3
"""Largest step of a joint [rad or m] in the search."""

MAX_ITERATIONS = 200


def constraint_rows(model: mujoco.MjModel, position: Array) -> tuple[Array, Array]:
    """Return violation (k,) and Jacobian (k, m) of the equality constraints at a position (m,)."""
    data = mujoco.MjData(model)
    data.qpos[:] = position
    mujoco.mj_fwdPosition(model, data)
    J = np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(J, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    else:
        J[:] = np.reshape(data.efc_J[: J.size], J.shape)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    return data.efc_pos[rows], J[rows]


def assembled(model: mujoco.MjModel, position: Array, free: Sequence[int], label: str) -> Array:
    """Return a position (m,) that satisfies the constraints, by Newton's method from another.

    Parameters
    ----------
    model
        With equality constraints.
    position
        Position (m,) [rad or m] from which to start.
    free
        Numbers of the joints that may change.
    label
        The file's name.

    Raises
    ------
    InvalidParameter
        Where the search finds none.
    """
    places, values = list(free), position.copy()
    violation, J = constraint_rows(model, values)
    for _ in range(MAX_ITERATIONS):
        if not np.any(np.abs(violation) > TOLERANCE) or not places:
            break
        step = np.linalg.lstsq(J[:, places], -violation, rcond=1e-9)[0]
        size = float(np.max(np.abs(step)))
        if size < TOLERANCE:
            break
        values[places] += step * min(1.0, MAX_STEP / size)
        violation, J = constraint_rows(model, values)
    if violation.size and np.max(np.abs(violation)) > MAX_VIOLATION:
        driven = [i for i in range(len(position)) if i not in places]
        raise InvalidParameter(
            f"initial_position: with the driven joints of {label} at ({format_vector(position[driven])}) its "
            f"constraints are violated by {np.max(np.abs(violation)):.2g} [m or rad] at least; start where they hold",
            "initial_position",
        )
    return values
