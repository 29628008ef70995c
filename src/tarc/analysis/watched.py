"""What to watch on the machine: the workspace that a certificate assumes."""

from collections.abc import Sequence

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.control.watch import Watch
from tarc.core import validation as check
from tarc.core.types import Array
from tarc.plants.base import Plant

WATCHED_SAMPLES = 500
"""Postures in which the torque at rest is computed, and times at which a reference is read."""
REST_TORQUE_FACTOR = 1.1
"""Largest torque at rest over the largest one of the samples."""


def watch_workspace(
    workspace: Workspace, period: float, plants: Sequence[Plant] = (), *, tolerance: float = 0.1
) -> Watch:
    """Return a watch of the positions, speeds and loads for which a robot was certified.

    The positions of a tube about a reference are those of the smallest box that contains it. With robots, the torque
    at rest is at most 1.1 times the largest that holds one of them in 500 postures, and its dry friction.

    Parameters
    ----------
    workspace
        Of the certificate.
    period
        Control period T [s].
    plants
        The robots of the certificate, such as one without and one with its payload. The load is not watched
        without any, nor with inner loops, whose command is no torque.
    tolerance
        Largest deviation of the time between two samples over T.

    Raises
    ------
    InvalidParameter
        For a period that is not above zero, or a negative tolerance.
    """
    check.number("period", period, 0, strict=True)
    n = workspace.n_joints
    low, high, tube = workspace.low, workspace.high, None
    if workspace.reference is not None:
        tube = np.maximum(-workspace.low[1:], workspace.high[1:])
        path = workspace.reference.sample(np.linspace(workspace.low[0], workspace.high[0], WATCHED_SAMPLES))[0]
        low, high = path.min(axis=1) + workspace.low[1:], path.max(axis=1) + workspace.high[1:]
    takes_torques = all(plant.in_torque_units() is plant for plant in plants)
    return Watch(
        n_joints=n,
        low=low,
        high=high,
        tube=tube,
        speed=workspace.speed,
        rest_torque=_rest_torque(workspace, plants) if plants and takes_torques else None,
        period=period,
        tolerance=tolerance,
    )


def _rest_torque(workspace: Workspace, plants: Sequence[Plant]) -> Array:
    """Return the largest torque of each joint [N m or N], shape (n,), that holds one of the robots at rest."""
    postures = workspace.sample(WATCHED_SAMPLES)
    largest = np.zeros(workspace.n_joints)
    for plant in plants:
        friction = np.zeros(workspace.n_joints)
        for name in getattr(plant, "dry_friction", ()):
            value = np.asarray(plant.parameters[name])
            if value.size in (1, workspace.n_joints):
                friction = np.maximum(friction, np.abs(value))
        holding = [np.abs(np.ravel(plant.holding_torque(plant.coordinates(posture)))) for posture in postures]
        largest = np.maximum(largest, REST_TORQUE_FACTOR * np.max(holding, axis=0) + friction)
    return largest
