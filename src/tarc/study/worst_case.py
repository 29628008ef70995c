"""Search for the worst case within the draws of a study: globally first, then along gradients."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.progress import Progress
from tarc.core.types import Array

Objective = Callable[[Array], Array]
"""Values (k,), more is worse, of runs at points (k, d) of the unit cube."""

Gradient = Callable[[Array], Array]
"""Direction (d,) in which the objective rises at a point (d,) of the unit cube."""

EDGE = 0.001
"""Share of each draw's distribution that is left out at both of its ends: a normal draw has no end of its own."""

STEPS = np.array([0.3, 0.1, 0.03, 0.01, 0.003, 0.001])
"""Lengths of the steps along a gradient that are tried at once."""

MAX_STEPS = 20


@dataclass(frozen=True, eq=False)
class WorstPoint:
    """The worst point that a search has found.

    Attributes
    ----------
    point
        The point of the unit cube, shape (d,).
    value
        Its objective.
    start_value
        Largest objective of the points at which the search began.
    global_value
        Largest objective before the steps along gradients.
    history
        Largest objective after each generation of the global search and each step.
    n_runs
        Number of runs.
    n_steps
        Number of steps along gradients that made it worse.
    """

    point: Array
    value: float
    start_value: float
    global_value: float
    history: tuple[float, ...]
    n_runs: int
    n_steps: int


class _Counted:
    """The objective, with the number of runs and the worst of them."""

    def __init__(self, objective: Objective):
        self.objective = objective
        self.n_runs = 0
        self.point = np.zeros(0)
        self.value = -np.inf

    def __call__(self, points: Array) -> Array:
        values = np.asarray(self.objective(points), dtype=float)
        if values.shape != (len(points),) or not np.all(np.isfinite(values)):
            raise InvalidParameter(
                f"objective: returned shape {values.shape} for {len(points)} points, or numbers that are not finite; "
                "needs one finite value per point"
            )
        self.n_runs += len(points)
        worst = int(np.argmax(values))
        if values[worst] > self.value:
            self.point, self.value = np.array(points[worst]), float(values[worst])
        return values


def search_worst_point(
    objective: Objective,
    starts: Array,
    *,
    gradient: Gradient | None = None,
    generations: int = 30,
    population: int = 0,
    edge: float = EDGE,
    seed: int = 0,
    progress: bool | None = None,
) -> WorstPoint:
    """Search the unit cube for the point with the largest objective.

    SciPy's differential evolution begins at the given points and at a Latin hypercube. Steps along gradients follow: of
    several lengths the best is taken, until none makes it worse. The result is a lower bound of the largest value.

    Parameters
    ----------
    objective
        Values of runs at points of the unit cube; finite, more is worse.
    starts
        Points to begin at, such as the worst draws of a study, shape (k, d).
    gradient
        Direction in which the objective rises at a point; None for no steps.
    generations
        Largest number of generations; zero for steps alone.
    population
        Runs per generation; zero for five per draw, at least 20.
    edge
        Distance that points keep from the faces of the cube.
    seed
        Of the search.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Raises
    ------
    InvalidParameter
        Without a start, for points outside the cube, and for an objective that is not finite.

    References
    ----------
    Storn, Price, Journal of Global Optimization 11, 1997; `scipy.optimize.differential_evolution`.
    """
    points = check.array("starts", starts)
    if points.ndim != 2 or len(points) == 0 or np.any((points < 0) | (points > 1)):
        raise InvalidParameter(f"starts: got shape {points.shape}; needs one or more points of the unit cube, (k, d)")
    check.integer("generations", generations)
    check.number("edge", edge, 0, high=0.4)
    size = check.integer("population", population) or max(5 * points.shape[1], 20)
    points = np.clip(points, edge, 1 - edge)
    counted = _Counted(objective)
    with Progress("searching the worst case", generations + MAX_STEPS, progress) as bar:
        start_value = float(np.max(counted(points)))
        history = _evolve(counted, points, generations, size, edge, seed, bar) if generations else []
        global_value, n_steps = counted.value, 0
        if gradient is not None:
            n_steps = _climb(counted, gradient, edge, history, bar)
    return WorstPoint(counted.point, counted.value, start_value, global_value, tuple(history), counted.n_runs, n_steps)


def _evolve(
    counted: _Counted, starts: Array, generations: int, size: int, edge: float, seed: int, bar: Progress
) -> list[float]:
    """Search globally; return the largest objective after each generation."""
    from scipy.optimize import differential_evolution
    from scipy.stats import qmc

    dimension = starts.shape[1]
    chosen = starts[: max(size // 2, 1)]
    filling = qmc.LatinHypercube(dimension, rng=np.random.default_rng(seed)).random(max(size - len(chosen), 4))
    history: list[float] = []

    def record(*_: object) -> None:
        history.append(counted.value)
        bar.advance()

    population: Any = np.clip(np.vstack([chosen, filling]), edge, 1 - edge)
    try:
        differential_evolution(
            lambda columns: -counted(columns.T),
            [(edge, 1 - edge)] * dimension,
            init=population,
            maxiter=generations,
            tol=1e-4,
            polish=False,
            updating="deferred",
            vectorized=True,
            callback=record,
            rng=np.random.default_rng(seed),
        )
    except RuntimeError as error:  # SciPy's, about what the objective raised
        if isinstance(error.__cause__, InvalidParameter):
            raise error.__cause__ from None
        raise
    return history


def _climb(counted: _Counted, gradient: Gradient, edge: float, history: list[float], bar: Progress) -> int:
    """Step along gradients while that makes the worst point worse; return the number of steps."""
    for step in range(MAX_STEPS):
        bar.advance()
        before = counted.value
        direction = np.asarray(gradient(counted.point), dtype=float)
        at_face = (counted.point <= edge) & (direction < 0) | (counted.point >= 1 - edge) & (direction > 0)
        direction = np.where(at_face, 0.0, direction)
        length = float(np.linalg.norm(direction))
        if not np.isfinite(length) or length == 0:
            return step
        counted(np.clip(counted.point + STEPS[:, None] * direction / length, edge, 1 - edge))
        if counted.value <= before:
            return step
        history.append(counted.value)
    return MAX_STEPS
