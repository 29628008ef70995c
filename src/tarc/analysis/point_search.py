"""Local search for an operating point at which a function is larger: by motion, and by posture."""

import numpy as np

from tarc.analysis.operating_points import OperatingPoint
from tarc.analysis.point_functions import PointFunction
from tarc.analysis.workspace import Workspace
from tarc.core.types import Array
from tarc.numerics.local_search import local_maximum

N_SEARCHES = 3
"""Number of points from which a local search starts."""
MAX_MOTION_CHANGES = 3
"""Largest number of joints whose speed or acceleration a search changes."""


def maximise_motion(start: OperatingPoint, workspace: Workspace, function: PointFunction) -> OperatingPoint:
    """Return a point of larger value in the same posture.

    The speed or acceleration of one joint at a time becomes its limit, in one direction or the other, or zero.
    """
    if not start.is_moving or workspace.speed is None or workspace.acceleration is None:
        return start
    limits, n = np.concatenate([workspace.speed, workspace.acceleration]), start.plant.n_joints
    best, best_value = start, float(function.values([start])[0])
    for _ in range(MAX_MOTION_CHANGES):
        motion = np.concatenate([best.velocity, best.acceleration])
        changed = [
            np.where(np.arange(2 * n) == i, sign * limits, motion)
            for i in range(2 * n)
            for sign in (-1, 0, 1)
            if sign * limits[i] != motion[i]
        ]
        candidates = [best._replace(velocity=motion[:n], acceleration=motion[n:]) for motion in changed]
        candidate_values = function.values(candidates)
        if not candidate_values.max() > (1 + 1e-9) * best_value:
            break
        best, best_value = candidates[int(np.argmax(candidate_values))], float(candidate_values.max())
    return best


def maximise_posture(
    start: OperatingPoint, workspace: Workspace, unit_samples: Array, function: PointFunction, scale: float
) -> OperatingPoint:
    """Return a point of larger value with the same velocity and acceleration.

    The search starts from the posture of the start, in a tube from the sample that is closest to it.
    """
    width = workspace.high - workspace.low
    free = np.flatnonzero(width > 0)
    if not free.size:
        return start
    if workspace.reference is None:
        unit = (start.position - workspace.low) / np.where(width > 0, width, 1.0)
    else:
        distances = np.linalg.norm(workspace.at_unit_points(unit_samples) - start.position, axis=1)
        unit = unit_samples[np.argmin(distances)]

    def unit_at(free_units: Array) -> Array:
        full = unit.copy()
        full[free] = free_units
        return full

    def point_at(free_units: Array) -> OperatingPoint:
        return start._replace(position=workspace.at_unit_points(unit_at(free_units)[None])[0])

    def at(free_units: Array) -> tuple[float, Array]:
        value, gradient = function.value_and_gradient(point_at(free_units))
        return value, gradient @ workspace.unit_slopes(unit_at(free_units))[:, free]

    _, best = local_maximum(at, unit[free], scale=scale, tolerance=1e-5, max_iterations=30)
    return point_at(best)
