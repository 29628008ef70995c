"""How fast a robot's inertia changes at most, by samples and local search with exact derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tarc.analysis.operating_points import OperatingPoint, matrix_roots
from tarc.analysis.point_search import N_SEARCHES, maximise_posture
from tarc.analysis.workspace import Workspace
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.plants.base import Plant

MAX_CORNER_JOINTS = 9
"""Number of joints up to which all combinations of their largest speeds are tried."""


@dataclass(frozen=True, eq=False)
class InertiaRate:
    """The largest ‖dE⁻¹/dt‖ of `inertia_rates`, for M̂ (n, n) and the largest speed of each joint (n,).

    Without M̂ it is the relative rate ‖M^−½ (dM/dt) M^−½‖.
    """

    nominal: Array | None
    speed: Array

    def values(self, points: Sequence[OperatingPoint]) -> Array:
        """Return the rates of k points, shape (k,)."""
        slopes = np.array([point.plant.inertia_slopes(point.position) for point in points])
        if self.nominal is not None:
            return inertia_rates(self.nominal, slopes, self.speed)
        return np.array(
            [
                inertia_rates(point.plant.inertia(point.position), slope[None], self.speed)[0]
                for point, slope in zip(points, slopes, strict=True)
            ]
        )

    def value_and_gradient(self, point: OperatingPoint) -> tuple[float, Array]:
        """Return the rate of a point and its derivatives over the posture, shape (n,)."""
        joints = np.flatnonzero(self.speed)
        directions = np.eye(len(self.speed))[joints] * self.speed
        if len(joints) <= MAX_CORNER_JOINTS:
            directions = _corner_signs(len(joints)) @ directions
        unit = point.plant.inertia(point.position) if self.nominal is None else self.nominal
        inverse_root = matrix_roots(unit)[1]
        slopes = point.plant.inertia_slopes(point.position)
        rates = inverse_root @ np.tensordot(directions, slopes, 1) @ inverse_root
        values, vectors = np.linalg.eigh(rates)
        largest = np.abs(values).argmax(axis=1)
        norms = np.abs(values).max(axis=1)
        chosen = np.arange(len(directions)) if len(joints) > MAX_CORNER_JOINTS else norms.argmax(keepdims=True)
        gradient = np.zeros(len(self.speed))
        for i in chosen.tolist():
            vector = inverse_root @ vectors[i, :, largest[i]]
            square = np.outer(vector, vector)
            weight = np.sign(values[i, largest[i]]) * square
            gradient += point.plant.inertia_rate_gradient(point.position, directions[i], weight)
            if self.nominal is None:
                gradient -= norms[i] * np.tensordot(slopes, square)
        return float(norms[chosen].sum()), gradient


def max_rate_point(
    plants: Sequence[Plant], nominal: Array | None, workspace: Workspace, samples: int, seed: int
) -> OperatingPoint:
    """Return the point with the largest of `inertia_rates`, from samples and a local search from the largest.

    Without M̂ it is that of the largest relative rate.

    Raises
    ------
    InvalidParameter
        For a workspace without speeds.
    """
    speed = workspace.speed
    if speed is None:
        raise InvalidParameter(
            "workspace: it has no speed, so nothing bounds how fast the inertia changes; give one with "
            "with_speed_limits"
        )

    function = InertiaRate(nominal, speed)
    resting = [
        OperatingPoint.at_rest(plant, posture) for posture in workspace.sample(samples, seed) for plant in plants
    ]
    rates = function.values(resting)
    best = [resting[i] for i in np.argsort(rates)[::-1][:N_SEARCHES]]
    units, scale = workspace.unit_samples(samples, seed), max(float(rates.max()), 1e-12)
    best += [maximise_posture(start, workspace, units, function, scale) for start in best]
    return best[int(np.argmax(function.values(best)))]


def max_inertia_rate(plants: Sequence[Plant], nominal: Array, workspace: Workspace, samples: int, seed: int) -> float:
    """Return the largest of `inertia_rates` over a workspace [1/s]; infinite without a speed."""
    if workspace.speed is None:
        return np.inf
    point = max_rate_point(plants, nominal, workspace, samples, seed)
    return float(InertiaRate(nominal, workspace.speed).values([point])[0])


def inertia_rates(nominal: Array, slopes: Array, speed: Array) -> Array:
    """Return the largest ‖dE⁻¹/dt‖ [1/s] within the speed limits.

    dE⁻¹/dt = Σ q̇_i M̂^−½ (∂M/∂q_i) M̂^−½ is linear in q̇. So its norm is largest where each joint moves at its limit, in
    one direction or the other. Above `MAX_CORNER_JOINTS` joints the sum of the norms bounds it.

    Parameters
    ----------
    nominal
        M̂ [kg m² or kg], shape (n, n).
    slopes
        ∂M/∂q_i, shape (k, n, n, n).
    speed
        Largest speed of each joint [rad/s or m/s], shape (n,).

    Returns
    -------
    Array
        Shape (k,).
    """
    joints = np.flatnonzero(speed)
    if not joints.size:
        return np.zeros(len(slopes))
    inverse_root = matrix_roots(nominal)[1]
    rates = inverse_root @ slopes[:, joints] @ inverse_root * speed[joints, None, None]
    if len(joints) > MAX_CORNER_JOINTS:
        return np.linalg.norm(rates, 2, axis=(2, 3)).sum(axis=1)
    corners = np.einsum("sj,kjab->ksab", _corner_signs(len(joints)), rates)
    return np.abs(np.linalg.eigvalsh(corners)).max(axis=(1, 2))


def _corner_signs(n_joints: int) -> Array:
    """Return all combinations of signs, the first one always positive, shape (2ⁿ⁻¹, n)."""
    return np.array([[1.0, *signs] for signs in product([-1.0, 1.0], repeat=n_joints - 1)])
