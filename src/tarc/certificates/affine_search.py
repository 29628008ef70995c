"""Search for a Lyapunov function that is affine in the inertia, by semidefinite programs on a few ratios."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tarc.certificates.affine_form import (
    LyapunovMatrices,
    Multipliers,
    RatioSet,
    Rows,
    constraint_forms,
    decrease,
    period_form_polynomial,
    signal_rows,
)
from tarc.certificates.force_form import ForcePoints
from tarc.certificates.reduced_loop import ReducedLoop
from tarc.core.types import Array
from tarc.numerics import sdp
from tarc.numerics.matrix_polynomial import evaluate

if TYPE_CHECKING:
    import cvxpy as cp

N_FIRST_RATIOS = 6
"""Number of ratios in the first program."""
N_TESTED_RATIOS = 200
"""Number of ratios at which a solution is tested, to add violated ones."""
MAX_PROGRAMS = 7
"""Largest number of programs."""
MIN_DECREASE = 1e-7
"""Least decrease of the Lyapunov function, in its own coordinates, that counts as one."""
INPUT_SIZE = 0.1
"""Size that the scaled inputs have in the states."""
INPUT_STRICTNESS = 1e-3
"""Decrease for an input of that size, over the decrease for a state."""
MIN_EIGENVALUE_SHARE = 1e-7
"""Least eigenvalue of the matrix that scales the states, as a share of the largest."""
SOLVER_OPTIONS: tuple[dict[str, float], ...] = (
    {"equilibrate_enable": False},
    {"static_regularization_constant": 1e-7},
)
"""Settings of the solver, tried in turn; the states are scaled already."""
ROUGH_OPTIONS: tuple[dict[str, float], ...] = (
    {
        **SOLVER_OPTIONS[0],
        "tol_feas": 1e-6,
        "tol_gap_abs": MIN_DECREASE,
        "tol_gap_rel": MIN_DECREASE,
        "reduced_tol_feas": 1e-3,
    },
    *SOLVER_OPTIONS[1:],
)
"""The same for a rough solution, where one is enough: what it is worth is decided without the solver."""
N_COEFFICIENTS = 5
"""Number of coefficients of a form of the forces."""
MIN_FACTOR = 0.01
"""Least factor of the squared torque in a form over a period, as a share of that of the form."""
S_ROOM = 1e-9
"""Share of the norm of S that is added to its diagonal."""


class AffineCandidate(NamedTuple):
    """A Lyapunov function that a solver found, the loop in whose states it is, and what it tolerates."""

    loop: ReducedLoop
    ratios: RatioSet
    matrices: LyapunovMatrices
    multipliers: Multipliers


def find_affine(
    loop: ReducedLoop,
    ratios: RatioSet,
    on_program: Callable[[], object] = lambda: None,
    max_programs: int = MAX_PROGRAMS,
    forces: ForcePoints | None = None,
    is_enough: Callable[[AffineCandidate], bool] | None = None,
) -> AffineCandidate | None:
    """Return a Lyapunov function that decreases at all tested ratios; None where none was found.

    Each program maximises the least decrease on some ratios. Those at which its solution fails are added to the next.
    The states are then scaled by the solution, so that the next program is well conditioned.

    Parameters
    ----------
    loop
        The loop.
    ratios
        What it must tolerate.
    on_program
        Called after each program, to show progress.
    max_programs
        Largest number of programs.
    forces
        Points that a form of the forces must cover, which is found as well.
    is_enough
        Whether a Lyapunov function is returned without a further program. Programs are then solved roughly.
    """
    if not np.isfinite(ratios.condition) or not np.all(np.isfinite(ratios.force_bounds())):
        return None
    low, high = ratios.min_ratio, ratios.max_ratio
    points = list(np.geomspace(low, high, N_FIRST_RATIOS))
    grid = np.geomspace(low, high, N_TESTED_RATIOS)
    best, n_failed = None, 0
    options = SOLVER_OPTIONS if is_enough is None else ROUGH_OPTIONS
    for _ in range(max_programs):
        candidate, margin = _solve(loop, ratios, points, forces, options)
        on_program()
        if candidate is None:
            return best
        decreases = _least_decreases(candidate, grid)
        if decreases.min() > 0:
            if best is not None or margin > 1e-2 or (is_enough is not None and is_enough(candidate)):
                return candidate
            best = candidate
        elif best is not None:
            return best
        n_failed = n_failed + 1 if margin < MIN_DECREASE else 0
        if n_failed > 1:
            return None
        points += _local_minima(grid, decreases) if margin >= MIN_DECREASE else []
        loop = _rescaled(candidate, (low * high) ** 0.5)
    return best


def _least_decreases(candidate: AffineCandidate, grid: Array) -> Array:
    """Return the least eigenvalue of F(λ)/λ at some ratios, its diagonal scaled to one."""
    forms = decrease(*candidate[:4], growth=1.0)
    values = np.array([evaluate(forms, ratio) / ratio for ratio in grid])
    diagonals = np.diagonal(values, axis1=1, axis2=2)
    scale = np.maximum(np.abs(diagonals), 1e-300) ** -0.5
    return np.linalg.eigvalsh(values * scale[:, :, None] * scale[:, None, :])[:, 0]


def _local_minima(grid: Array, values: Array) -> list[float]:
    """Return the points of a grid at which values are negative and least among their neighbours."""
    before, after = np.append(np.inf, values[:-1]), np.append(values[1:], np.inf)
    return grid[(values <= 0) & (values <= before) & (values <= after)].tolist()


def _rescaled(candidate: AffineCandidate, ratio: float) -> ReducedLoop:
    """Return the loop in states in which the Lyapunov function at a ratio is the sum of squares."""
    P0, P1, Q1 = candidate.matrices[:3]
    values, vectors = np.linalg.eigh(P0 + (P1 + Q1) / ratio)
    values = np.maximum(values, MIN_EIGENVALUE_SHARE * values[-1])
    return candidate.loop.transformed((vectors * np.sqrt(values)).T, vectors / np.sqrt(values))


def _solve(
    loop: ReducedLoop,
    ratios: RatioSet,
    points: list[float],
    forces_to_cover: ForcePoints | None = None,
    options: Sequence[dict[str, float]] = SOLVER_OPTIONS,
) -> tuple[AffineCandidate | None, float]:
    """Return the Lyapunov function with the largest least decrease at some ratios, and that decrease."""
    import cvxpy as cp

    n_states, middle = len(loop.A), (ratios.min_ratio * ratios.max_ratio) ** 0.5
    has_two_parts, has_model = _has_two_parts(ratios), ratios.nominal_rate > 0
    is_used = [True, True, True, has_two_parts, has_two_parts, has_model]
    variables = [cp.Variable((n_states, n_states), symmetric=True) if used else None for used in is_used]
    zero = cp.Constant(np.zeros((n_states, n_states)))
    P0, P1, S, Q1, R, S0 = (zero if variable is None else variable for variable in variables)
    margin = cp.Variable()
    unknown = None if forces_to_cover is None else _UnknownForm(forces_to_cover, ratios)
    rows = signal_rows(loop, ratios if unknown is None else unknown.ratios)
    error, forces, change, slope = constraint_forms(rows, loop, ratios)
    signals = [(0, error), *((0, form) for form in forces), (1, change), (0, slope)]
    signals = [(degree, form) for degree, form in signals if form]
    weights = cp.Variable(len(signals), nonneg=True)
    inputs = INPUT_SIZE / max(float(np.linalg.norm(loop.B, 2)), 1e-300)
    is_state = np.arange(rows.state.shape[1]) < n_states
    scale, strictness = np.where(is_state, 1.0, inputs), np.where(is_state, 1.0, INPUT_STRICTNESS)
    state = rows.state * scale
    constraints = [S - P1 >> 0, S + P1 >> 0, cp.trace(P0 + P1 + Q1) == n_states]
    constraints += [R - Q1 >> 0, R + Q1 >> 0] if has_two_parts else []
    constraints += [S0 - P0 >> 0, S0 + P0 >> 0] if has_model else []
    constraints += [P0 + (P1 + Q1) * (middle / ratio) >> 0 for ratio in (ratios.min_ratio, ratios.max_ratio)]
    for ratio in points:
        later = (rows.next_state[0] + ratio * rows.next_state[1]) * scale
        P = P0 + (P1 + Q1) * (middle / ratio)
        change_of_P = ratios.max_change * middle * S + ratios.max_relative_change * (middle / ratio) * R
        change_of_P = change_of_P + ratios.max_nominal_change * S0
        drop = state.T @ P @ state - later.T @ (P + change_of_P) @ later
        for i, (degree, coefficients) in enumerate(signals):
            form = evaluate(coefficients, ratio) / ratio**degree
            drop = drop - weights[i] * (form * scale * scale[:, None] / inputs**2)
        if unknown is not None:
            drop = drop - unknown.at(ratio, rows, scale * scale[:, None] / inputs**2)
        constraints.append(_symmetric(drop) >> margin * np.diag(strictness))
    constraints += [] if unknown is None else unknown.constraints()
    used = [variable for variable in variables if variable is not None]
    values = _values(options, cp.Problem(cp.Maximize(margin), constraints), weights, margin, *used)
    if values is None:
        return None, 0.0
    weight_values, margin_value, *found = values
    ratios = ratios if unknown is None else unknown.found(1 / inputs**2)
    matrices = _matrices(variables, found, middle)
    weight_values = np.maximum(weight_values, 1e-12) / inputs**2
    multipliers = _named_weights(weight_values, len(forces), bool(change), bool(slope))
    return AffineCandidate(loop, ratios, matrices, multipliers), float(margin_value)


def _matrices(variables: "Sequence[cp.Variable | None]", found: Sequence[Array], middle: float) -> LyapunovMatrices:
    """Return the matrices of a solved program; those that it has not are zero."""
    solved, none = iter(found), np.zeros_like(found[0])
    P0, P1, S, Q1, R, S0 = (none if variable is None else next(solved) for variable in variables)
    return LyapunovMatrices(
        P0=P0,
        P1=middle * P1,
        Q1=middle * Q1,
        S=middle * _above(S, P1),
        R=middle * _above(R, Q1),
        S0=S0 if variables[-1] is None else _above(S0, P0),
    )


class _UnknownForm:
    """A form of the forces whose coefficients are variables of the program, in their units."""

    def __init__(self, points: ForcePoints, ratios: RatioSet):
        import cvxpy as cp

        self.points, self.ratios = points, replace(ratios, form=points.unit_form(0))
        self.variables = cp.Variable(N_COEFFICIENTS, nonneg=True)
        self.units = [points.unit_form(i) for i in range(N_COEFFICIENTS)]

    def at(self, ratio: float, rows: Rows, scale: Array) -> "cp.Expression":
        """Return right less left side of the form over a period at a ratio."""
        polynomials = (period_form_polynomial(rows, self.ratios, unit) for unit in self.units)
        parts = [evaluate(polynomial, ratio) / ratio * scale for polynomial in polynomials]
        total = self.variables[0] * parts[0]
        for i in range(1, N_COEFFICIENTS):
            total = total + self.variables[i] * parts[i]
        return total

    def constraints(self) -> list["cp.Constraint"]:
        """Return what the form must satisfy: it covers the active points, and bounds the torques over a period."""
        constraints = []
        for index in self.points.active:
            parts = self.points.forms(index)
            constraints.append(sum(self.variables[i] * part for i, part in enumerate(parts)) >> 0)
        for ratio in (self.ratios.min_ratio, self.ratios.max_ratio):
            factors = np.array([self.ratios.period_form(unit).factor(ratio) for unit in self.units])
            constraints.append(factors @ self.variables >= MIN_FACTOR * self.variables[0])
        return constraints

    def found(self, factor: float) -> RatioSet:
        """Return the ratios with the form of the solution times a factor, enlarged to cover all points."""
        values = np.asarray(self.variables.value, dtype=float)
        return replace(self.ratios, form=self.points.covering(factor * values))


def _has_two_parts(ratios: RatioSet) -> bool:
    """Return whether the relative rate says more than the rate."""
    return ratios.relative_rate < (1 - 1e-9) * ratios.rate * ratios.max_ratio


def _values(
    options: Sequence[dict[str, float]], problem: "cp.Problem", *expressions: "cp.Expression"
) -> list[Array] | None:
    """Return the values of a solution, by the first settings with which the solver succeeds; None for none."""
    for settings in options:
        values = sdp.solve(problem, *expressions, **settings)
        if values is not None:
            return values
    return None


def _symmetric(expression: "cp.Expression") -> "cp.Expression":
    return (expression + expression.T) / 2


def _above(S: Array, P1: Array) -> Array:
    """Return S with so much added to its diagonal that S ± P1 are positive definite beyond rounding."""
    least = min(float(np.linalg.eigvalsh(S + sign * P1)[0]) for sign in (-1, 1))
    return S + (max(-2 * least, 0.0) + S_ROOM * np.linalg.norm(S, 2) + 1e-15) * np.eye(len(S))


def _named_weights(weights: Array, n_forces: int, has_change: bool, has_slope: bool) -> Multipliers:
    """Return the weights of a solution by name, zero for a missing constraint."""
    others = list(weights[1 + n_forces :])
    return Multipliers(
        error=float(weights[0]),
        forces=weights[1 : 1 + n_forces],
        change=float(others.pop(0)) if has_change else 0.0,
        slope=float(others.pop(0)) if has_slope else 0.0,
    )
