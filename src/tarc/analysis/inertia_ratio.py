"""Inertia ratios of a robot over a workspace: the eigenvalues of M(q)⁻¹M̂."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Matrix
from tarc.numerics.local_search import local_maximum
from tarc.plants.base import Plant

MIN_CONDITION = 1e-12
"""Smallest to largest eigenvalue of an inertia matrix below which it counts as singular."""
N_SEARCHES = 12
"""Number of samples from which a local search starts."""


class InertiaFunction(NamedTuple):
    """A function of the inertia matrix.

    Attributes
    ----------
    values
        Maps inertia matrices (k, n, n) to one number each, (k,).
    gradient
        Maps one inertia matrix (n, n) to the derivative of the number over its entries, (n, n).
    """

    values: Callable[[Array], Array]
    gradient: Callable[[Array], Array]


class Extremum(NamedTuple):
    """A largest value.

    Attributes
    ----------
    value
        The value.
    posture
        Where it was found [rad or m], shape (n,).
    plant
        Index of the plant.
    sampled
        Largest value of the samples alone.
    """

    value: float
    posture: Array
    plant: int
    sampled: float


@dataclass(frozen=True, kw_only=True, eq=False)
class InertiaSpread:
    """Smallest and largest eigenvalue of M(q)⁻¹M̂ over a workspace, from samples and local search.

    Attributes
    ----------
    min_ratio, max_ratio
        The eigenvalues.
    min_posture, max_posture
        Where they were found [rad or m], shape (n,).
    min_plant, max_plant
        Index of the plant.
    sampled_min, sampled_max
        Eigenvalues of the samples alone.
    samples
        Number of sampled postures.
    """

    min_ratio: float
    max_ratio: float
    min_posture: Array
    max_posture: Array
    min_plant: int
    max_plant: int
    sampled_min: float
    sampled_max: float
    samples: int

    @property
    def ratio(self) -> float:
        """Largest ratio divided by the smallest."""
        return self.max_ratio / self.min_ratio


def inertia_spread(
    plant: Plant | Sequence[Plant],
    inertia: Matrix,
    workspace: Workspace,
    *,
    samples: int = 2000,
    seed: int = 0,
    refine: int = N_SEARCHES,
) -> InertiaSpread:
    """Return the smallest and largest eigenvalue of M(q)⁻¹M̂ over a workspace.

    They are also those of the symmetric E(q) = M̂^½ M(q)⁻¹ M̂^½.

    Parameters
    ----------
    plant
        One robot or several, such as one without and one with its payload. M grows with the payload, in the order of
        symmetric matrices. So these two stand for every payload between.
    inertia
        M̂ [kg m² or kg], as for a law.
    workspace
        The postures.
    samples, seed
        Number of sampled postures, and the seed.
    refine
        Number of the best samples from which a local search starts, for each end.

    Raises
    ------
    InvalidParameter
        For an M̂ that is not positive definite, numbers of joints that differ, and an M(q) that is singular or not
        finite at a posture.
    """
    plants = as_plants(plant)
    nominal = check.positive_definite("inertia", inertia, plants[0].n_joints)
    low, high = maximise_over_workspace(
        extreme_ratio_functions(nominal), plants, workspace, samples=samples, seed=seed, refine=refine
    )
    return InertiaSpread(
        min_ratio=1 / low.value,
        max_ratio=-1 / high.value,
        min_posture=low.posture,
        max_posture=high.posture,
        min_plant=low.plant,
        max_plant=high.plant,
        sampled_min=1 / low.sampled,
        sampled_max=-1 / high.sampled,
        samples=samples,
    )


def inverse_ratios(M: Array, nominal: Array) -> Array:
    """Return the eigenvalues of M̂⁻¹M, ascending, shape (k, n): the reciprocals of the inertia ratios.

    With M̂ = LLᵀ they are those of the symmetric L⁻¹ M L⁻ᵀ.

    Parameters
    ----------
    M
        Inertia matrices, shape (k, n, n).
    nominal
        M̂, shape (n, n), or one for each of them, (k, n, n).
    """
    whiten = np.linalg.inv(np.linalg.cholesky(nominal))
    return np.linalg.eigvalsh(whiten @ M @ np.swapaxes(whiten, -1, -2))


def extreme_ratio_functions(nominal: Array) -> tuple[InertiaFunction, InertiaFunction]:
    """Return functions that are largest at the smallest and at the largest eigenvalue of M⁻¹M̂: 1/ρ and −1/ρ."""
    whiten = np.linalg.inv(np.linalg.cholesky(nominal))

    def gradient(M: Array, index: int) -> Array:
        vector = whiten.T @ np.linalg.eigh(whiten @ M @ whiten.T)[1][:, index]
        return np.outer(vector, vector)

    return (
        InertiaFunction(lambda M: inverse_ratios(M, nominal)[:, -1], lambda M: gradient(M, -1)),
        InertiaFunction(lambda M: -inverse_ratios(M, nominal)[:, 0], lambda M: -gradient(M, 0)),
    )


def maximise_over_workspace(
    functions: Sequence[InertiaFunction],
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    samples: int = 2000,
    seed: int = 0,
    refine: int = N_SEARCHES,
) -> list[Extremum]:
    """Return the largest value of each function of the inertia matrix over a workspace.

    Random samples of all plants are shared by the functions. From the best of them a local search starts. Largest
    eigenvalues and singular values have kinks where two of them cross. But as the larger of smooth functions they have
    no maximum on a kink, so gradients serve. A larger value elsewhere is not excluded.

    Parameters
    ----------
    functions
        Functions of the inertia matrix.
    plant, workspace, samples, seed, refine
        As in `inertia_spread`.

    Raises
    ------
    InvalidParameter
        As in `inertia_spread`.
    """
    plants = as_plants(plant)
    return [
        largest_maximum(peaks)
        for peaks in local_maxima(functions, plants, PostureSamples(workspace, plants, samples, seed), refine)
    ]


class PostureSamples:
    """Sampled postures of a workspace and the inertia matrices of each plant there.

    Attributes
    ----------
    units
        Points of the unit cube of the variables that are free, shape (k, d).
    inertias
        M(q) of each plant, shape (k, n, n).
    """

    def __init__(self, workspace: Workspace, plants: Sequence[Plant], samples: int, seed: int):
        if not isinstance(workspace, Workspace):
            raise InvalidParameter(
                f"workspace: got {type(workspace).__name__}; needs Workspace.from_joint_limits(plant), "
                "Workspace.box(low, high) or Workspace.from_reference(reference, duration)"
            )
        if workspace.n_joints != plants[0].n_joints:
            raise InvalidParameter(
                f"workspace: it has {workspace.n_joints} joints and the robot {plants[0].n_joints}; give as many"
            )
        self.workspace = workspace.for_joints(plants[0].joint_names)
        self.free = np.flatnonzero(workspace.high > workspace.low)
        self.units = workspace.unit_samples(samples, seed)[:, self.free]
        self.inertias = [inertia_matrices(plant, self.postures_at(self.units)) for plant in plants]

    def postures_at(self, units: Array) -> Array:
        """Return postures (k, n) at points (k, d) of the unit cube."""
        return self.workspace.at_unit_points(self._points_at(units))

    def slopes_at(self, unit: Array) -> Array:
        """Return the derivatives of the posture over a point (d,) of the unit cube, shape (n, d)."""
        return self.workspace.unit_slopes(self._points_at(unit[None])[0])[:, self.free]

    def _points_at(self, units: Array) -> Array:
        points = np.zeros((len(units), len(self.workspace.low)))
        points[:, self.free] = units
        return points


def local_maxima(
    functions: Sequence[InertiaFunction], plants: Sequence[Plant], postures: PostureSamples, refine: int
) -> list[list[Extremum]]:
    """Return for each function the local maxima reached from its best samples."""
    check.integer("refine", refine, 0)
    return [_local_maxima(function, plants, postures, refine) for function in functions]


def _local_maxima(
    function: InertiaFunction, plants: Sequence[Plant], postures: PostureSamples, refine: int
) -> list[Extremum]:
    values = np.array([function.values(matrices) for matrices in postures.inertias])
    maxima = []
    for flat in np.argsort(values, axis=None)[::-1][: max(refine, 1)]:
        index, sample = (int(i) for i in np.unravel_index(flat, values.shape))
        value = sampled = float(values[index, sample])
        unit = postures.units[sample]
        if refine and postures.free.size:
            plant = plants[index]

            def at(unit: Array, plant: Plant = plant) -> tuple[float, Array]:
                posture = postures.postures_at(unit[None])
                M = inertia_matrices(plant, posture)
                gradient = plant.inertia_gradient(posture[0], function.gradient(M[0]))
                return float(function.values(M)[0]), gradient @ postures.slopes_at(unit)

            higher, end = local_maximum(at, unit, scale=max(abs(sampled), 1e-300), tolerance=1e-10)
            value, unit = (higher, end) if higher > value else (value, unit)
        maxima.append(Extremum(value, postures.postures_at(unit[None])[0], index, sampled))
    return maxima


def largest_maximum(maxima: Sequence[Extremum]) -> Extremum:
    """Return the largest of some maxima, with the largest of the samples."""
    largest = max(maxima, key=lambda maximum: maximum.value)
    return largest._replace(sampled=max(maximum.sampled for maximum in maxima))


def inertia_matrices(plant: Plant, postures: Array) -> Array:
    """Return M(q) at postures (k, n), shape (k, n, n), each positive definite.

    Raises
    ------
    InvalidParameter
        For an M(q) that is singular or not finite.
    """
    M = plant.inertia_matrices(postures.T)
    is_finite = np.array([np.isfinite(matrix).all() for matrix in M])
    values = np.linalg.eigvalsh(np.where(is_finite[:, None, None], M, 0.0))
    invalid = np.flatnonzero(~(is_finite & (values[:, 0] > MIN_CONDITION * values[:, -1])))
    if invalid.size:
        i = int(invalid[0])
        fault = f"singular (smallest eigenvalue {values[i, 0]:.3g})" if is_finite[i] else "not finite"
        raise InvalidParameter(
            f"inertia: M(q) is {fault} at q = {postures[i].round(4).tolist()}; give the joints rotor inertia, such as "
            "armature=0.1, or a workspace without this posture"
        )
    return M


def as_plants(plant: Plant | Sequence[Plant]) -> list[Plant]:
    """Return one robot or several as a list.

    Raises
    ------
    InvalidParameter
        For an empty list, for anything else than robots, for numbers of joints that differ, and for passive joints.
    """
    plants = list(plant) if isinstance(plant, Sequence) else [plant]
    if not plants or not all(isinstance(robot, Plant) for robot in plants):
        kinds = ", ".join(type(robot).__name__ for robot in plants) or "none"
        raise InvalidParameter(f"plant: got {kinds}; needs a robot, or several in a list")
    counts = [robot.n_joints for robot in plants]
    if len(set(counts)) > 1:
        raise InvalidParameter(f"plant: got robots of {counts} joints; needs as many in each")
    for robot in plants:
        robot.require_fully_driven("a certificate")
    return plants
