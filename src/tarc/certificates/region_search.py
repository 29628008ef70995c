"""Search for the Lyapunov function of a region of attraction, by semidefinite programs on a few ratios."""

from typing import NamedTuple

import numpy as np

from tarc.certificates.affine_form import LyapunovMatrices, RatioSet
from tarc.certificates.reduced_loop import gramian
from tarc.certificates.region_form import (
    InputBounds,
    RegionWeights,
    TrackingLoop,
    region_decrease,
    region_forms,
    signal_bounds,
)
from tarc.certificates.region_tube import TubeSize
from tarc.core.types import Array
from tarc.numerics import sdp
from tarc.numerics.matrix_polynomial import evaluate

N_RATIOS = 7
"""Number of ratios in a program, of a range whose ends differ by more than `NARROW`."""
NARROW = 1.3
"""Quotient of the ends of a range below which a program has three ratios."""
N_TESTED = 60
"""Number of ratios at which a solution is tested."""
MIN_SHARE = 1e-13
"""Least eigenvalue of the matrix that scales the states, as a share of the largest."""
SOLVER_OPTIONS: tuple[dict[str, float], ...] = (
    {"equilibrate_enable": False},
    {"static_regularization_constant": 1e-7},
    {},
)
"""Settings of the solver, tried in turn."""
STRICTNESS = 1e-7
"""Decrease that the program asks for beyond zero, in its own coordinates."""


class RegionCandidate(NamedTuple):
    """A Lyapunov function that a solver found, and the loop in whose states it is."""

    loop: TrackingLoop
    matrices: LyapunovMatrices
    weights: RegionWeights


def first_scaling(loop: TrackingLoop, bounds: InputBounds, tube: TubeSize, ratio: float) -> TrackingLoop:
    """Return the loop at a constant ratio in balanced states: as much reached by the inputs as seen in e and ė."""
    A = loop.A + ratio * loop.B[:, :1] @ loop.C
    rows = tube.rows(loop)
    columns = [loop.B, bounds.noise * loop.noise, bounds.residual * loop.residual, bounds.change * loop.change]
    inputs, tiny = np.hstack(columns), np.eye(len(A))
    seen = gramian(A.T, np.hstack([rows.T, 3e-5 * np.linalg.norm(rows) * tiny]))
    reached = np.linalg.cholesky(gramian(A, np.hstack([inputs, 1e-7 * tiny])))
    left, values, _ = np.linalg.svd(reached.T @ seen @ reached)
    back = np.linalg.inv(reached)
    return rescaled(loop, back.T @ left @ np.diag(values**0.5) @ left.T @ back)


def rescaled(loop: TrackingLoop, P: Array) -> TrackingLoop:
    """Return the loop in states in which yᵀPy is the sum of squares."""
    values, vectors = np.linalg.eigh((P + P.T) / 2)
    values = np.maximum(values, MIN_SHARE * values[-1])
    return loop.transformed((vectors * np.sqrt(values)).T, vectors / np.sqrt(values))


def find_region(
    loop: TrackingLoop, ratios: RatioSet, bounds: InputBounds, tube: TubeSize, decay: float, *, rounds: int
) -> RegionCandidate | None:
    """Return a Lyapunov function whose level 1 lies in the tube, with V⁺ ≤ ϱ V + g of the least g; None for none.

    Parameters
    ----------
    loop, ratios, bounds
        The loop, what it must tolerate in the tube, and what acts on it.
    tube
        Its size.
    decay
        ϱ.
    rounds
        Number of programs, each in states scaled by the solution before.
    """
    is_narrow = ratios.max_ratio < NARROW * ratios.min_ratio
    points = list(np.geomspace(ratios.min_ratio, ratios.max_ratio, 3 if is_narrow else N_RATIOS))
    grid = np.geomspace(ratios.min_ratio, ratios.max_ratio, N_TESTED)
    best = None
    for _ in range(rounds):
        candidate = _solve(loop, ratios, bounds, tube, decay, points)
        if candidate is None:
            break
        forms = region_decrease(candidate.loop, ratios, candidate.matrices, candidate.weights, decay)
        least = np.array([_least(evaluate(forms, ratio)) for ratio in grid])
        if least.min() > 0:
            best = candidate
        else:
            points += grid[least <= least.min() / 2].tolist()[:3]
        loop = scaled_by(candidate, ratios)
    return best


def scaled_by(candidate: RegionCandidate, ratios: RatioSet) -> TrackingLoop:
    """Return the loop in states in which V at the middle ratio is the sum of squares."""
    P0, P1, Q1 = candidate.matrices[:3]
    return rescaled(candidate.loop, P0 + (P1 + Q1) / (ratios.min_ratio * ratios.max_ratio) ** 0.5)


def _least(value: Array) -> float:
    """Return the least eigenvalue with the diagonal scaled to one."""
    scale = np.maximum(np.abs(np.diag(value)), 1e-300) ** -0.5
    return float(np.linalg.eigvalsh(value * np.outer(scale, scale))[0])


def _solve(
    loop: TrackingLoop,
    ratios: RatioSet,
    bounds: InputBounds,
    tube: TubeSize,
    decay: float,
    points: list[float],
) -> RegionCandidate | None:
    """Return the Lyapunov function of the least g, with a decrease at some ratios; None where the solver fails."""
    import cvxpy as cp

    m, middle = len(loop.A), (ratios.min_ratio * ratios.max_ratio) ** 0.5
    has_two_parts = ratios.relative_rate < (1 - 1e-9) * ratios.rate * ratios.max_ratio
    is_used = [True, True, True, has_two_parts, has_two_parts, ratios.nominal_rate > 0]
    variables = [cp.Variable((m, m), symmetric=True) if used else None for used in is_used]
    zero = cp.Constant(np.zeros((m, m)))
    P0, P1, S, Q1, R, S0 = (zero if variable is None else variable for variable in variables)
    signals = region_forms(loop, ratios)
    force_squares, squares = signal_bounds(ratios, bounds)
    constant, factor = signals.next_state
    sizes = np.concatenate([np.ones(m), _input_sizes(loop, squares, tube)])
    forms = [*((0, form) for form in signals.forces), (1, signals.swing)]
    forms += [(0, signals.slope)] if signals.slope else []
    forms += [(0, [-part]) for part in signals.inputs]
    scaled = [[part * np.outer(sizes, sizes) for part in form] for _, form in forms]
    units = np.array([max(np.abs(evaluate(form, middle)).max(), 1e-300) for form in scaled])
    weights = cp.Variable(len(forms), nonneg=True)
    own = np.zeros(len(forms) - len(force_squares) - len(squares))
    g = (np.concatenate([force_squares, own, squares]) / units) @ weights
    constraints: list[cp.Constraint] = [S - P1 >> 0, S + P1 >> 0]
    constraints += [R - Q1 >> 0, R + Q1 >> 0] if has_two_parts else []
    constraints += [S0 - P0 >> 0, S0 + P0 >> 0] if ratios.nominal_rate > 0 else []
    ends = [P0 + (P1 + Q1) * (middle / ratio) for ratio in (ratios.min_ratio, ratios.max_ratio)]
    constraints += [P - np.outer(row, row) >> 0 for P in ends for row in tube.rows(loop)]
    state = signals.state * sizes
    for ratio in points:
        later = (constant + ratio * factor) * sizes
        P = P0 + (P1 + Q1) * (middle / ratio)
        changed = P + ratios.max_change * middle * S + ratios.max_relative_change * (middle / ratio) * R
        changed = changed + ratios.max_nominal_change * S0
        drop = decay * state.T @ P @ state - later.T @ changed @ later
        for i, (degree, _) in enumerate(forms):
            drop = drop - weights[i] * (evaluate(scaled[i], ratio) / ratio**degree / units[i])
        constraints.append((drop + drop.T) / 2 >> STRICTNESS * np.eye(len(sizes)))
    problem, used = cp.Problem(cp.Minimize(g), constraints), [x for x in variables if x is not None]
    solutions = (sdp.solve(problem, weights, *used, **options) for options in SOLVER_OPTIONS)
    values = next((solution for solution in solutions if solution is not None), None)
    if values is None:
        return None
    solved = iter(values[1:])
    parts = [np.zeros((m, m)) if variable is None else next(solved) for variable in variables]
    return _candidate(loop, parts, np.maximum(values[0], 1e-14) / units, middle)


def _candidate(loop: TrackingLoop, parts: list[Array], weights: Array, middle: float) -> RegionCandidate:
    """Return a solution with its units, and S and R above P1 and Q1 beyond rounding."""
    P0, P1, S, Q1, R, S0 = parts
    matrices = LyapunovMatrices(
        P0=P0,
        P1=middle * P1,
        Q1=middle * Q1,
        S=middle * _above(S, P1),
        R=middle * _above(R, Q1),
        S0=_above(S0, P0) if np.any(S0) else S0,
    )
    *forces, swing, slope = weights[:-4] if loop.half_slope else np.append(weights[:-4], 0.0)
    others = [float(value) for value in (swing, slope, *weights[-4:])]
    return RegionCandidate(loop, matrices, RegionWeights(np.array(forces), *others))


def _input_sizes(loop: TrackingLoop, squares: Array, tube: TubeSize) -> Array:
    """Return sizes of the inputs in units of the states."""
    acceleration = 0.1 / max(float(np.linalg.norm(loop.B, 2)), 1e-300)
    sizes = [acceleration] * 5 + [max(float(part) ** 0.5, 1e-9) for part in squares[1:]]
    return np.array(sizes + [loop.half_slope * tube.error] * (loop.half_slope > 0))


def _above(S: Array, P1: Array) -> Array:
    """Return S with so much added to its diagonal that S ± P1 are positive definite."""
    least = min(float(np.linalg.eigvalsh(S + sign * P1)[0]) for sign in (-1, 1))
    return S + (max(-2 * least, 0.0) + 1e-9 * np.linalg.norm(S, 2) + 1e-15) * np.eye(len(S))
