"""How far the inertia ratio spreads over a workspace: the eigenvalues of M(q)⁻¹M̂, and the M̂ that spreads them least."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tarc import check
from tarc.check import Matrix, Numbers
from tarc.errors import TarcError
from tarc.plants.base import Plant
from tarc.plants.euler_lagrange import EulerLagrange
from tarc.signals.references import Reference

SINGULAR = 1e-12
"""Smallest to largest eigenvalue of an inertia matrix below which it counts as singular."""
STEP = 1e-7
"""Step of the differences in the local search, in widths of the box: near the root of the rounding error."""
ROUNDS = 30
"""Most rounds in which `best_shape` adds postures."""
REFINE = 12
"""Starts of the local search."""
SLACK = 1.2
"""Factor from the outermost eigenvalue beyond which `best_shape` drops a posture that it had added."""

Stacked = Callable[[np.ndarray], np.ndarray]
"""Maps inertia matrices (k, n, n) to one number each, (k,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Workspace:
    """A set of postures, and how fast they change: a box of joint positions, or what is in a tube about a reference.

    Made by `box`, `path` or `of`.

    Attributes
    ----------
    low, high
        Ends of the variables: the positions [rad or m], shape (n,); with a reference the time [s] and then an offset
        from it a joint [rad or m], shape (n + 1,).
    reference
        The trajectory at the middle of the tube, or None.
    speed
        The greatest speed of each joint [rad/s or m/s], shape (n,); None for any speed. The slower the robot, the more
        its loop bears.
    """

    low: np.ndarray
    high: np.ndarray
    reference: Reference | None = None
    speed: np.ndarray | None = None

    def __post_init__(self) -> None:
        if np.shape(self.low) != np.shape(self.high) or np.ndim(self.low) != 1:
            raise TarcError(
                f"low, high: got shapes {np.shape(self.low)} and {np.shape(self.high)}; needs one number a joint each"
            )
        wrong = np.flatnonzero(np.asarray(self.low) > np.asarray(self.high))
        if wrong.size:
            i = int(wrong[0])
            raise TarcError(
                f"low, high: number {i + 1} goes from {self.low[i]:g} to {self.high[i]:g}; needs low ≤ high"
            )
        if self.speed is not None:
            object.__setattr__(self, "speed", check.vector("speed", self.speed, self.joints, 0))

    @classmethod
    def box(cls, low: Numbers, high: Numbers, *, speed: Numbers | None = None) -> "Workspace":
        """All positions between low and high [rad or m], one number a joint; equal ones hold a joint still.

        The greatest speed [rad/s or m/s] is one number or one a joint, or None for any.
        """
        first = np.atleast_1d(check.array("low", low))
        return cls(low=first, high=np.atleast_1d(check.array("high", high)), speed=_speed(speed, len(first)))

    @classmethod
    def path(
        cls, reference: Reference, duration: float, *, tube: Numbers = 0.0, speed: Numbers | None = None
    ) -> "Workspace":
        """The positions of a reference in its first seconds, each joint off by at most ±tube [rad or m].

        The duration is in [s]; the tube and the greatest speed [rad/s or m/s] are one number or one a joint, the speed
        None for any.
        """
        if not isinstance(reference, Reference):
            raise TarcError(f"reference: got {type(reference).__name__}; needs one of tarc.signals, such as Sinusoid")
        end = check.number("duration", duration, 0)
        width = check.vector("tube", tube, reference.joints, 0)
        low, high = np.array([0.0, *-width]), np.array([end, *width])
        return cls(low=low, high=high, reference=reference, speed=_speed(speed, reference.joints))

    @classmethod
    def of(cls, plant: Plant, *, speed: Numbers | None = None) -> "Workspace":
        """All that the joints of a robot reach: their ranges in its file, and ±π for a hinge without one.

        The greatest speed [rad/s or m/s] is one number or one a joint, or None for any.

        Raises
        ------
        TarcError
            For a joint in metres without a range.
        """
        from tarc.plants.mujoco import MujocoPlant

        low, high = np.full(plant.joints, -np.pi), np.full(plant.joints, np.pi)
        limited = np.zeros(plant.joints, dtype=bool)
        if isinstance(plant, MujocoPlant):
            limited = plant.model.jnt_limited.astype(bool)
            low, high = np.where(limited[:, None], plant.model.jnt_range, np.column_stack([low, high])).T
        for name, unit, known in zip(plant.joint_names, plant.joint_units, limited, strict=True):
            if unit != "rad" and not known:
                raise TarcError(
                    f"workspace: joint {name} slides [m] and has no range; give the ranges of all joints with "
                    "Workspace.box(low, high)"
                )
        return cls(low=low, high=high, speed=_speed(speed, plant.joints))

    def within(self, speed: Numbers | None) -> "Workspace":
        """The same postures, no joint faster than its speed [rad/s or m/s], one number or one a joint.

        Any speed for None and where one is infinite.
        """
        if speed is None:
            return replace(self, speed=None)
        given = np.asarray(speed, dtype=float)
        return replace(self, speed=None if np.isposinf(given).any() else _speed(given, self.joints))

    @property
    def joints(self) -> int:
        """How many joints n."""
        return len(self.low) - (self.reference is not None)

    def sample(self, samples: int, seed: int = 0) -> np.ndarray:
        """Postures (k, n) [rad or m] evenly at random from the workspace; a single one where it is a point."""
        return self.positions(self.low + self.units(samples, seed) * (self.high - self.low))

    def units(self, samples: int, seed: int) -> np.ndarray:
        """Points (k, v) of the unit cube of its variables, evenly at random; zero for a variable that is held."""
        check.whole("samples", samples, 1)
        free = self.high > self.low
        rng = np.random.default_rng(check.whole("seed", seed))
        return rng.random((samples if free.any() else 1, len(free))) * free

    def positions(self, variables: np.ndarray) -> np.ndarray:
        """Positions (k, n) [rad or m] at the variables (k, v), a row each."""
        if self.reference is None:
            return variables
        return self.reference.sample(variables[:, 0])[0].T + variables[:, 1:]


def _speed(given: Numbers | None, joints: int) -> np.ndarray | None:
    return None if given is None else check.vector("speed", given, joints, 0)


class Extremum(NamedTuple):
    """The greatest value found: where, of which plant, and what the samples alone had found."""

    value: float
    posture: np.ndarray
    plant: int
    sampled: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Spread:
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

    low: float
    high: float
    where_low: np.ndarray
    where_high: np.ndarray
    plant_low: int
    plant_high: int
    sampled_low: float
    sampled_high: float
    samples: int

    @property
    def ratio(self) -> float:
        """The greatest by the least."""
        return self.high / self.low


def spread(
    plant: Plant | Sequence[Plant],
    inertia: Matrix,
    workspace: Workspace,
    *,
    samples: int = 2000,
    seed: int = 0,
    refine: int = REFINE,
) -> Spread:
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
    plants = _plants(plant)
    nominal = check.definite("inertia", inertia, plants[0].joints)
    low, high = extremes(_ends(nominal), plants, workspace, samples=samples, seed=seed, refine=refine)
    return Spread(
        low=1 / low.value,
        high=-1 / high.value,
        where_low=low.posture,
        where_high=high.posture,
        plant_low=low.plant,
        plant_high=high.plant,
        sampled_low=1 / low.sampled,
        sampled_high=-1 / high.sampled,
        samples=samples,
    )


def inverse_ratios(M: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Eigenvalues of M̂⁻¹M, ascending, shape (k, n), of matrices M (k, n, n): one by the eigenvalues of M⁻¹M̂.

    With M̂ = LLᵀ they are those of the symmetric L⁻¹ M L⁻ᵀ.
    """
    whiten = np.linalg.inv(np.linalg.cholesky(nominal))
    return np.linalg.eigvalsh(whiten @ M @ whiten.T)


def _ends(nominal: np.ndarray) -> tuple[Stacked, Stacked]:
    """What is greatest where the least, and where the greatest, eigenvalue of M⁻¹M̂ is found."""
    return lambda M: inverse_ratios(M, nominal)[:, -1], lambda M: -inverse_ratios(M, nominal)[:, 0]


def extremes(
    functions: Sequence[Stacked],
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    samples: int = 2000,
    seed: int = 0,
    refine: int = REFINE,
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
    plants = _plants(plant)
    return [_top(peaks) for peaks in _peaks(functions, plants, _Grid(workspace, plants, samples, seed), refine)]


def best_shape(
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    samples: int = 2000,
    diagonal: bool = False,
    tolerance: float = 0.01,
    seed: int = 0,
) -> tuple[np.ndarray, float]:
    """The M̂ whose eigenvalues of M(q)⁻¹M̂ spread least over a workspace: min t, M(q) ≼ X ≼ t M(q).

    Cutting planes: solve for a few postures, look for those that violate it most with `spread`, add them, repeat. For
    the postures at hand the solver's t is a lower bound for every X, and the spread of the X at hand an upper one; the
    two must meet. The answer is the X and its spread, not the solver's word.

    Parameters
    ----------
    plant, workspace, samples, seed
        As in `spread`.
    diagonal
        Of all diagonal matrices only.
    tolerance
        By which share the spread may exceed the lower bound.

    Returns
    -------
    X, t
        X [kg m² or kg], shape (n, n), scaled so that the eigenvalues of M(q)⁻¹X found over the workspace lie between
        1 and t; multiply it by a ratio that the loop tolerates.

    Raises
    ------
    TarcError
        As `spread`; when the solver fails or the bounds do not meet.
    """
    plants = _plants(plant)
    check.number("tolerance", tolerance, 1e-4, high=1.0)
    grid = _Grid(workspace, plants, samples, seed)
    pool = np.concatenate(grid.inertias)
    mean = pool.mean(axis=0)
    X, bound = np.diag(np.diag(mean)) if diagonal else mean, 1.0
    best, ratio = X, np.inf
    below = above = pool[:0]
    for _ in range(ROUNDS):
        lows, highs = _peaks(_ends(X), plants, grid, REFINE)
        low, high = 1 / _top(lows).value, -1 / _top(highs).value
        if high / low < ratio:
            best, ratio = X / low, high / low
        if ratio <= (1 + tolerance) * bound:
            return best, ratio
        fresh_low, fresh_high = ([plants[one.plant].inertia(one.posture) for one in ends] for ends in (lows, highs))
        below = np.concatenate([_active(below, X, -1), fresh_low])
        above = np.concatenate([_active(above, X, 0), fresh_high])
        X, lower = _solve(below, above, mean, diagonal)
        bound = max(bound, lower)
    raise TarcError(
        f"best_shape: after {ROUNDS} rounds the spread {ratio:.4g} is still more than {tolerance:.2g} above its lower "
        f"bound {bound:.4g}; raise the tolerance or the number of samples"
    )


def _active(matrices: np.ndarray, X: np.ndarray, end: int) -> np.ndarray:
    """Those whose eigenvalue of M⁻¹X at this end is within a factor of the outermost one; the others do not bind."""
    if not len(matrices):
        return matrices
    values = inverse_ratios(matrices, X)[:, end]
    outermost = values.max() if end == -1 else values.min()
    return matrices[np.abs(np.log(values / outermost)) < np.log(SLACK)]


def _solve(below: np.ndarray, above: np.ndarray, mean: np.ndarray, diagonal: bool) -> tuple[np.ndarray, float]:
    """X and the least t with M_i ≼ X for those below and X ≼ t M_i for those above.

    In coordinates in which the mean of M is the identity, or has ones on its diagonal.
    """
    import warnings

    import cvxpy as cp

    n = len(mean)
    scale = np.diag(np.sqrt(np.diag(mean))) if diagonal else np.linalg.cholesky(mean)
    whiten = np.linalg.inv(scale)
    t = cp.Variable()
    shape = cp.diag(cp.Variable(n)) if diagonal else cp.Variable((n, n), symmetric=True)
    below, above = ((M + M.transpose(0, 2, 1)) / 2 for M in (whiten @ below @ whiten.T, whiten @ above @ whiten.T))
    constraints = [*(shape - M >> 0 for M in below), *(t * M - shape >> 0 for M in above)]
    problem = cp.Problem(cp.Minimize(t), constraints)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(solver=cp.CLARABEL)
    except cp.SolverError as error:
        raise TarcError(f"best_shape: the solver failed ({error}); try other samples, or more armature") from None
    if shape.value is None or t.value is None:
        raise TarcError(f"best_shape: the solver ended {problem.status}; try other samples, or more armature")
    X = scale @ np.asarray(shape.value) @ scale.T
    # a bound that the solver did not reach with full accuracy is none, and then more postures must do
    return check.definite("best_shape", (X + X.T) / 2, n), float(t.value) if problem.status == cp.OPTIMAL else 1.0


class _Grid:
    """Samples of a workspace: the points of the unit cube of its free variables, the postures, M(q) of each plant."""

    def __init__(self, workspace: Workspace, plants: Sequence[Plant], samples: int, seed: int):
        if not isinstance(workspace, Workspace):
            raise TarcError(
                f"workspace: got {type(workspace).__name__}; needs Workspace.of(plant), Workspace.box(low, high) or "
                "Workspace.path(reference, duration)"
            )
        if workspace.joints != plants[0].joints:
            raise TarcError(
                f"workspace: it has {workspace.joints} joints and the robot {plants[0].joints}; give as many"
            )
        self.workspace = workspace
        self.width = workspace.high - workspace.low
        self.free = np.flatnonzero(self.width > 0)
        self.units = workspace.units(samples, seed)[:, self.free]
        self.postures = self.place(self.units)
        self.inertias = [inertias(plant, self.postures) for plant in plants]

    def place(self, units: np.ndarray) -> np.ndarray:
        """Postures (k, n) at points (k, d) of the unit cube."""
        variables = np.tile(self.workspace.low, (len(units), 1))
        variables[:, self.free] += units * self.width[self.free]
        return self.workspace.positions(variables)


def _peaks(functions: Sequence[Stacked], plants: Sequence[Plant], grid: _Grid, refine: int) -> list[list[Extremum]]:
    """For each function the local maxima that are reached from its best samples."""
    check.whole("refine", refine, 0)
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


def _top(peaks: list[Extremum]) -> Extremum:
    """The highest, with the best of the samples."""
    best = max(peaks, key=lambda peak: peak.value)
    return best._replace(sampled=max(peak.sampled for peak in peaks))


def _climb(
    function: Stacked, plant: Plant, place: Callable[[np.ndarray], np.ndarray], start: np.ndarray
) -> tuple[float, np.ndarray]:
    """Local maximum of the function, and where, in the unit cube.

    SLSQP and not L-BFGS-B, which calls threaded LAPACK for each small step in scipy 1.17 and then takes seconds where
    the cores are shared.
    """
    import warnings

    from scipy.optimize import minimize

    nudges = STEP * np.concatenate([np.zeros((1, len(start))), np.eye(len(start))])
    size = max(abs(float(function(inertias(plant, place(start[None])))[0])), 1e-300)

    def downhill(unit: np.ndarray) -> tuple[float, np.ndarray]:
        inward = np.where(unit > 0.5, -1.0, 1.0)
        near = -function(inertias(plant, place(unit + nudges * inward))) / size
        return float(near[0]), (near[1:] - near[0]) / (STEP * inward)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Values in x were outside bounds")  # by rounding; they are clipped
        end = minimize(
            downhill, start, jac=True, method="SLSQP", bounds=[(0.0, 1.0)] * len(start), options={"ftol": 1e-10}
        )
    return -float(end.fun) * size, np.clip(end.x, 0, 1)


def inertias(plant: Plant, postures: np.ndarray) -> np.ndarray:
    """M(q) at the rows of postures (k, n), shape (k, n, n), each positive definite."""
    n = plant.joints
    if isinstance(plant, EulerLagrange):  # one call of CasADi costs as much as a thousand postures
        M = plant.evaluate("inertia", postures.T).T.reshape(-1, n, n)
    else:
        M = np.array([plant.inertia(posture) for posture in postures])
    finite = np.array([np.isfinite(one).all() for one in M])
    values = np.linalg.eigvalsh(np.where(finite[:, None, None], M, 0.0))
    wrong = np.flatnonzero(~(finite & (values[:, 0] > SINGULAR * values[:, -1])))
    if wrong.size:
        i = int(wrong[0])
        what = f"singular (smallest eigenvalue {values[i, 0]:.3g})" if finite[i] else "not finite"
        raise TarcError(
            f"inertia: M(q) is {what} at q = {postures[i].round(4).tolist()}; give the joints rotor inertia, such as "
            "armature=0.1, or a workspace without this posture"
        )
    return M


def _plants(plant: Plant | Sequence[Plant]) -> list[Plant]:
    plants = list(plant) if isinstance(plant, Sequence) else [plant]
    if not plants or not all(isinstance(one, Plant) for one in plants):
        kinds = ", ".join(type(one).__name__ for one in plants) or "none"
        raise TarcError(f"plant: got {kinds}; needs a robot, or several in a list")
    if len({one.joints for one in plants}) > 1:
        raise TarcError(f"plant: got robots of {[one.joints for one in plants]} joints; needs as many in each")
    return plants
