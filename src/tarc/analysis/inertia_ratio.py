"""How far the inertia ratio spreads over a workspace: the eigenvalues of M(q)⁻¹M̂."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.validation import Matrix
from tarc.plants.base import Plant
from tarc.plants.euler_lagrange import EulerLagrange

MIN_CONDITION = 1e-12
"""Smallest to largest eigenvalue of an inertia matrix below which it counts as singular."""
STEP = 1e-7
"""Step of the differences in the local search, in widths of the box: near the root of the rounding error."""
N_SEARCHES = 12
"""Starts of the local search."""

InertiaFunction = Callable[[np.ndarray], np.ndarray]
"""Maps inertia matrices (k, n, n) to one number each, (k,)."""


class Extremum(NamedTuple):
    """The greatest value found: where, of which plant, and what the samples alone had found."""

    value: float
    posture: np.ndarray
    plant: int
    sampled: float


@dataclass(frozen=True, kw_only=True, eq=False)
class InertiaSpread:
    """Least and greatest eigenvalue of M(q)⁻¹M̂ over a workspace, as found by samples and local search.

    Attributes
    ----------
    low, high
        The eigenvalues.
    where_low, where_high
        The positions at which they were found [rad or m], shape (n,).
    plant_low, plant_high
        Of which plant, counted from zero.
    sampled_low, sampled_high
        What the samples alone had found.
    samples
        Number of sampled postures.
    """

    min_ratio: float
    max_ratio: float
    min_posture: np.ndarray
    max_posture: np.ndarray
    min_plant: int
    max_plant: int
    sampled_min: float
    sampled_max: float
    samples: int

    @property
    def ratio(self) -> float:
        """The greatest by the least."""
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
    """Least and greatest eigenvalue of M(q)⁻¹M̂, those of the symmetric E(q) = M̂^½ M(q)⁻¹ M̂^½, over a workspace.

    Parameters
    ----------
    plant
        One robot or several, such as one without and one with its payload. As M grows with the payload, in the order
        of symmetric matrices, these two stand for every payload between.
    inertia
        M̂ [kg m² or kg], as a law takes it.
    workspace
        The postures.
    samples
        How many of them to try.
    seed
        Of the samples.
    refine
        How many of the best samples are starts of a local search, for each end.

    Raises
    ------
    TarcError
        For an M̂ that is not positive definite, joints that do not match, and an inertia matrix that is singular or not
        finite somewhere.
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


def inverse_ratios(M: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Eigenvalues of M̂⁻¹M, ascending, shape (k, n), of matrices M (k, n, n): one by the eigenvalues of M⁻¹M̂.

    With M̂ = LLᵀ they are those of the symmetric L⁻¹ M L⁻ᵀ.
    """
    whiten = np.linalg.inv(np.linalg.cholesky(nominal))
    return np.linalg.eigvalsh(whiten @ M @ whiten.T)


def extreme_ratio_functions(nominal: np.ndarray) -> tuple[InertiaFunction, InertiaFunction]:
    """What is greatest where the least, and where the greatest, eigenvalue of M⁻¹M̂ is found."""
    return lambda M: inverse_ratios(M, nominal)[:, -1], lambda M: -inverse_ratios(M, nominal)[:, 0]


def maximise_over_workspace(
    functions: Sequence[InertiaFunction],
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    samples: int = 2000,
    seed: int = 0,
    refine: int = N_SEARCHES,
) -> list[Extremum]:
    """Greatest value of each function of the inertia matrix over a workspace: samples, then local search.

    Random samples of all plants, shared by the functions; from the best of them SLSQP inside the box.
    Largest eigenvalues and singular values have kinks where two of them cross, but as the greater of smooth functions
    they have no maximum on a kink, so that gradients serve. A greater value elsewhere is not excluded.

    Parameters
    ----------
    functions
        Each maps inertia matrices (k, n, n) to numbers (k,).
    plant, workspace, samples, seed, refine
        As in `spread`.
    """
    plants = as_plants(plant)
    return [
        largest_maximum(peaks)
        for peaks in local_maxima(functions, plants, PostureSamples(workspace, plants, samples, seed), refine)
    ]


class PostureSamples:
    """Samples of a workspace: the points of the unit cube of its free variables, the postures, M(q) of each plant."""

    def __init__(self, workspace: Workspace, plants: Sequence[Plant], samples: int, seed: int):
        if not isinstance(workspace, Workspace):
            raise TarcError(
                f"workspace: got {type(workspace).__name__}; needs Workspace.from_joint_limits(plant), "
                f"Workspace.box(low, high) or "
                "Workspace.from_reference(reference, duration)"
            )
        if workspace.n_joints != plants[0].n_joints:
            raise TarcError(
                f"workspace: it has {workspace.n_joints} joints and the robot {plants[0].n_joints}; give as many"
            )
        self.workspace = workspace
        self.width = workspace.high - workspace.low
        self.free = np.flatnonzero(self.width > 0)
        self.units = workspace.unit_samples(samples, seed)[:, self.free]
        self.postures = self.place(self.units)
        self.inertias = [inertia_matrices(plant, self.postures) for plant in plants]

    def place(self, units: np.ndarray) -> np.ndarray:
        """Postures (k, n) at points (k, d) of the unit cube."""
        variables = np.tile(self.workspace.low, (len(units), 1))
        variables[:, self.free] += units * self.width[self.free]
        return self.workspace.positions(variables)


def local_maxima(
    functions: Sequence[InertiaFunction], plants: Sequence[Plant], grid: PostureSamples, refine: int
) -> list[list[Extremum]]:
    """For each function the local maxima that are reached from its best samples."""
    check.integer("refine", refine, 0)
    found = []
    for function in functions:
        values = np.array([function(stack) for stack in grid.inertias])
        peaks = []
        for flat in np.argsort(values, axis=None)[::-1][: max(refine, 1)]:
            which, index = (int(i) for i in np.unravel_index(flat, values.shape))
            value = sampled = float(values[which, index])
            unit = grid.units[index]
            if refine and grid.free.size:
                climbed, end = _climb(function, plants[which], grid.place, unit)
                value, unit = (climbed, end) if climbed > value else (value, unit)
            peaks.append(Extremum(value, grid.place(unit[None])[0], which, sampled))
        found.append(peaks)
    return found


def largest_maximum(peaks: list[Extremum]) -> Extremum:
    """The highest, with the best of the samples."""
    best = max(peaks, key=lambda peak: peak.value)
    return best._replace(sampled=max(peak.sampled for peak in peaks))


def _climb(
    function: InertiaFunction, plant: Plant, place: Callable[[np.ndarray], np.ndarray], start: np.ndarray
) -> tuple[float, np.ndarray]:
    """Local maximum of the function, and where, in the unit cube.

    SLSQP and not L-BFGS-B, which calls threaded LAPACK for each small step in scipy 1.17 and then takes seconds where
    the cores are shared.
    """
    import warnings

    from scipy.optimize import minimize

    nudges = STEP * np.concatenate([np.zeros((1, len(start))), np.eye(len(start))])
    size = max(abs(float(function(inertia_matrices(plant, place(start[None])))[0])), 1e-300)

    def downhill(unit: np.ndarray) -> tuple[float, np.ndarray]:
        inward = np.where(unit > 0.5, -1.0, 1.0)
        near = -function(inertia_matrices(plant, place(unit + nudges * inward))) / size
        return float(near[0]), (near[1:] - near[0]) / (STEP * inward)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Values in x were outside bounds")  # by rounding; they are clipped
        end = minimize(
            downhill, start, jac=True, method="SLSQP", bounds=[(0.0, 1.0)] * len(start), options={"ftol": 1e-10}
        )
    return -float(end.fun) * size, np.clip(end.x, 0, 1)


def inertia_matrices(plant: Plant, postures: np.ndarray) -> np.ndarray:
    """M(q) at the rows of postures (k, n), shape (k, n, n), each positive definite."""
    n = plant.n_joints
    if isinstance(plant, EulerLagrange):  # one call of CasADi costs as much as a thousand postures
        M = plant.evaluate("inertia", postures.T).T.reshape(-1, n, n)
    else:
        M = np.array([plant.inertia(posture) for posture in postures])
    finite = np.array([np.isfinite(one).all() for one in M])
    values = np.linalg.eigvalsh(np.where(finite[:, None, None], M, 0.0))
    wrong = np.flatnonzero(~(finite & (values[:, 0] > MIN_CONDITION * values[:, -1])))
    if wrong.size:
        i = int(wrong[0])
        what = f"singular (smallest eigenvalue {values[i, 0]:.3g})" if finite[i] else "not finite"
        raise TarcError(
            f"inertia: M(q) is {what} at q = {postures[i].round(4).tolist()}; give the joints rotor inertia, such as "
            "armature=0.1, or a workspace without this posture"
        )
    return M


def as_plants(plant: Plant | Sequence[Plant]) -> list[Plant]:
    """Robots of as many joints each, as a list."""
    plants = list(plant) if isinstance(plant, Sequence) else [plant]
    if not plants or not all(isinstance(one, Plant) for one in plants):
        kinds = ", ".join(type(one).__name__ for one in plants) or "none"
        raise TarcError(f"plant: got {kinds}; needs a robot, or several in a list")
    if len({one.n_joints for one in plants}) > 1:
        raise TarcError(f"plant: got robots of {[one.n_joints for one in plants]} joints; needs as many in each")
    return plants
