"""The robust ball for an inertia that changes no faster than its robot moves: more room, by a multiplier."""

from typing import Any, NamedTuple

import numpy as np

from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop
from tarc.core.types import Array
from tarc.numerics.norms import fdi_negative

N_DECAYS = 10
"""How many exponentials the multiplier is made of."""
N_FIRST_CUTS = 50
"""About how many frequencies the linear program begins with."""
MAX_CUT_ROUNDS = 40
"""Most rounds in which `best_multiplier` adds what its linear program overlooked."""
RANGE_TOLERANCE = 1.005
"""At which a search ends, where nothing else is said."""
MIN_CHANGE = 1e-4
"""Least change in a period, as a share of the centre, for which a multiplier is searched for."""
MIN_COEFFICIENT = 1e-4
"""Share of the greatest term below which one is dropped."""
MIN_DECAY = 1e-7
"""Least decay in a period that is taken: slower ones have all that they do below the frequencies looked at."""
FORM_MARGIN = 1e-6
"""By how much the form must be negative, as a share of the mismatch's own square."""


class Multiplier(NamedTuple):
    """What shows that a loop bears a ball of E that changes slowly.

    A robot of stiffness H takes v to the acceleration b − d with b = E v, d = H x; let a = b − d − ρ0 v be what is not
    as at the centre. With y_m = Σ_i c_i p_i^m, m ≥ 1, any symmetric E(t) whose inverse changes by at most D_m within m
    periods obeys

        2 Σ_k Σ_m y_m (v_{k+m}ᵀ b_k − v_kᵀ b_{k+m}) ≥ −2 Σ_m |y_m| D_m Σ_k ‖b_k‖²,

    for each summand is b_{k+m}ᵀ (E⁻¹_{k+m} − E⁻¹_k) b_k. Added to ‖a‖² ≤ δ² (‖v‖² + η² ‖x‖²) and ‖d‖ ≤ ‖H‖ ‖x‖ it
    leaves fewer loops to fear than these alone, which hold however fast E changes.

    Attributes
    ----------
    decays, coefficients
        p_i and c_i, shape (k,).
    slope, stiffness
        Weights of what is known of the slope, and of the stiffness.
    """

    decays: Array
    coefficients: Array
    slope: float = 1.0
    stiffness: float = 1.0


def rate_penalty(decays: Array, step: float, most: float) -> Array:
    """2 Σ_m p^m D_m for each decay p, shape (k,), where E⁻¹ changes by a step in each period and E is at most so large.

    D_m = m step ((1 + μ)/(1 − μ))², μ = η/(1 − η): over a period E is not E⁻¹'s inverse mean, but nearly so, where
    what E⁻¹ changes in half of it, times the greatest E, is a small η. Infinite for one that is not.
    """
    p, half = np.asarray(decays, dtype=float), step * most / 2
    if not half < 1 / 3:
        return np.full_like(p, np.inf)
    swing = half / (1 - half)
    return 2 * step * ((1 + swing) / (1 - swing)) ** 2 * p / (1 - p) ** 2


def satisfies_iqc(
    parts: UncertainLoop,
    centre: float,
    radius: float,
    step: float,
    multiplier: Multiplier,
    weight: float = 0.0,
    stiffness: float = 0.0,
) -> bool:
    """Whether the multiplier shows that the loop bears the ball; on all frequencies, from the matrices alone.

    The form is the sum of these inequalities, and of |k s/2|² ≥ |w|² for the slope, with their weights.
    """
    p, c = multiplier.decays, multiplier.coefficients
    fine = step >= 0 and np.all((p > 0) & (p < 1 - MIN_DECAY)) and multiplier.slope > 0 and multiplier.stiffness > 0
    if not fine or radius > centre:
        return False
    if not np.isfinite(np.abs(c) @ rate_penalty(p, step, centre + radius) if len(p) else 0.0):
        return False
    F, G, Q, S, R = iqc_matrices(parts, centre, radius, step, multiplier, weight, stiffness)
    return fdi_negative(F, G, Q, S, R + FORM_MARGIN * np.eye(len(R)))


def iqc_matrices(
    parts: UncertainLoop,
    centre: float,
    radius: float,
    step: float,
    multiplier: Multiplier,
    weight: float = 0.0,
    stiffness: float = 0.0,
) -> tuple[Array, ...]:
    """A, B, Q, S, R of the form that `bears` asks to be negative, each input scaled to have −1 of its own square."""
    A, B, C, D = parts.closed_loop(centre, weight)
    p, c = multiplier.decays, multiplier.coefficients
    paid = np.abs(c) @ rate_penalty(p, step, centre + radius) if len(p) else 0.0
    n, k, wide = len(A), len(p), parts.B_mismatch.shape[1]
    sloping, stiff = bool(parts.half_slope.item()), bool(weight and stiffness)
    inputs = B.shape[1] + stiff
    # states: the loop, v through the exponentials, b through them; everything below is a row over (state, input)
    size = n + 2 * k + inputs
    unit = np.eye(size)
    outputs = np.hstack([C, np.zeros((len(C), 2 * k)), D, np.zeros((len(C), int(stiff)))])
    u, v = unit[n + 2 * k :], outputs[0]
    b = centre * v + u[0] + (u[-1] if stiff else 0.0)
    rows = np.zeros((n + 2 * k, size))
    rows[:n, :n], rows[:n, n + 2 * k : n + 2 * k + B.shape[1]] = A, B
    rows[n : n + k] = p[:, None] * (unit[n : n + k] + v)
    rows[n + k :] = p[:, None] * (unit[n + k : n + 2 * k] + b)

    def square(row: Array) -> Array:
        return np.outer(row, row)

    def product(one: Array, other: Array) -> Array:
        return np.outer(one, other) + np.outer(other, one)

    form = radius**2 * square(v) + paid * square(b) - sum(square(one) for one in u[:wide])
    form = form + product(v, c @ unit[n + k : n + 2 * k]) - product(c @ unit[n : n + k], b)
    scale = np.ones(inputs)
    here = outputs[1 : len(C) - sloping] if weight else outputs[:0]  # position and velocity
    form = form + radius**2 * here.T @ here
    if sloping:
        form = form + multiplier.slope * (square(outputs[-1]) - square(u[wide]))
        scale[wide] = multiplier.slope**-0.5
    if stiff:
        form = form + multiplier.stiffness * ((stiffness / weight) ** 2 * here.T @ here - square(u[-1]))
        scale[-1] = multiplier.stiffness**-0.5
    m = n + 2 * k
    F, G = rows[:, :m], rows[:, m:] * scale
    Q, S, R = form[:m, :m], form[:m, m:] * scale, form[m:, m:] * scale * scale[:, None]
    return F, G, Q, S, R


def best_multiplier(
    parts: UncertainLoop,
    centre: float,
    step: float,
    *,
    weight: float = 0.0,
    stiffness: float = 0.0,
    responses: FrequencyResponses | None = None,
    enough: float = np.inf,
    close: float = RANGE_TOLERANCE,
) -> tuple[Multiplier, float, float]:
    """The multiplier with which the loop bears the largest ball, its radius, and a bound on any such radius.

    Up to a grid of frequencies.

    A linear program over coefficients and weights, with cuts added half-way between its answer and the best so far.

    Parameters
    ----------
    parts
        Of the loop, as `tarc.certificates.mismatch.parts_of` gives them.
    centre
        ρ0.
    step
        Most that E⁻¹ changes in one period.
    weight, stiffness
        η and the greatest ‖H‖ [1/s²], as in `tarc.certificates.certify_robot`.
    responses
        Those of the parts, where they are known already.
    enough
        A radius at which to stop, once it is reached or out of reach.
    close
        Where the search ends: the spread that may still be gained over the one that is reached.

    Returns
    -------
    multiplier, radius, bound
        The radius is zero where none was found; the bound is that of the last linear program.
    """
    from scipy.optimize import linprog

    step = max(step, MIN_CHANGE / centre)  # where nothing costs anything, nothing bounds the coefficients
    forms = _FormsOverFrequency(parts, responses or FrequencyResponses(parts), centre, step, weight, stiffness)
    goal = np.zeros(forms.unknowns)
    goal[-1] = -1.0
    inside = forms.start()
    reached = forms.feasible_radius(inside)
    if not reached:
        return forms.multiplier(inside), 0.0, centre
    inside[-1] = reached**2
    straight = np.zeros((len(forms.v), forms.inputs), dtype=complex)
    straight[:, 0] = 1.0
    first = np.arange(0, len(forms.v), max(len(forms.v) // N_FIRST_CUTS, 1))
    A, b = forms.cuts(first, straight[first])
    bounds = [(0, None)] * (forms.unknowns - 1) + [(0, 1)]
    enough, bound = (enough / centre) ** 2, 1.0
    for _ in range(MAX_CUT_ROUNDS):
        if inside[-1] >= enough:
            break
        found: Any = linprog(goal, A_ub=A, b_ub=b, bounds=bounds, method="highs-ds", options={"presolve": False})
        bound = found.x[-1] if found.status == 0 else bound
        if found.status != 0 or bound < enough < 1 or _spread(bound) < close * _spread(inside[-1]):
            break
        trial = (inside + found.x) / 2
        values, vectors = np.linalg.eigh(forms.at(trial))
        top = values[:, -1]
        peak = (top >= np.append(top[1:], -np.inf)) & (top >= np.append(-np.inf, top[:-1]))
        where = np.flatnonzero(peak & (top > -2 * FORM_MARGIN))
        if len(where):
            more = forms.cuts(where, vectors[where][:, :, -1])
            A, b = np.concatenate([A, more[0]]), np.concatenate([b, more[1]])
        reached = forms.feasible_radius(trial)
        if reached**2 > inside[-1]:
            inside, inside[-1] = trial, reached**2
    return forms.multiplier(inside), centre * inside[-1] ** 0.5, centre * float(bound) ** 0.5


def _spread(square: float) -> float:
    """Ratio of the ends of a ball, of the square of its radius over the centre."""
    return (1 + square**0.5) / max(1 - square**0.5, 1e-9)


class _FormsOverFrequency:
    """The form of `bears` at each frequency of a grid, as a function of what is searched for.

    That is the c_i above and below zero, the weights of slope and stiffness where there are such, and (δ/ρ0)²; all
    scaled to be of the order of one. A row x of inputs holds a, the rest of a, w and d, as far as they are there.
    """

    def __init__(
        self,
        parts: UncertainLoop,
        responses: FrequencyResponses,
        centre: float,
        step: float,
        weight: float,
        stiffness: float,
    ):
        G = responses.at_ratio(centre)
        self.wide, self.half = parts.B_mismatch.shape[1], responses.half_slope
        self.sloping, self.stiff = bool(self.half), bool(weight and stiffness)
        G = G if self.sloping else G[:, :, : self.wide]
        G = np.concatenate([G, 0 * G[:, :, :1]], axis=2) if self.stiff else G
        self.inputs = G.shape[2]
        self.v, self.q, self.s = centre * G[:, 0], G[:, 1] * responses.lead_factor, G[:, 1]
        self.b = self.v + np.eye(self.inputs)[0] + (np.eye(self.inputs)[-1] if self.stiff else 0)
        self.weight, self.stiffness = centre * weight, stiffness
        self.started = responses.best_scale(centre, weight)
        lead = np.max(np.abs(np.linalg.eigvals(parts.closed_loop(centre)[0])))
        slowest = -np.log(min(max(lead, 0.5), 1 - 1e-5))
        p = self.decays = np.exp(-np.geomspace(slowest / 5, 2.0, N_DECAYS))
        self.top = (1 - p**2) / p  # over the greatest of its sine
        self.centre = centre
        z = np.exp(1j * responses.angles)[:, None]
        self.sines = 4 * self.top * np.imag(p * z / (1 - p * z))
        paid = rate_penalty(p, step, 2 * centre) * self.top * centre
        self.used = N_DECAYS if np.isfinite(paid).all() else 0
        self.paid, self.sines = paid[: self.used], self.sines[:, : self.used]
        self.unknowns = 2 * self.used + self.sloping + self.stiff + 1

    def start(self) -> Array:
        """What certainly works: no multiplier, and the scale of the slope that the ball at any speed has."""
        x = np.zeros(self.unknowns)
        if self.sloping:
            x[2 * self.used] = self.started[0] ** -2
        if self.stiff:
            x[-2] = 0.01 / max(np.max(np.abs(self.stiffness * self.q)) ** 2, 1e-12)
        return x

    def at(self, x: Array) -> Array:
        """The form at each frequency, (f, i, i)."""
        (above, below), rest = x[: 2 * self.used].reshape(2, self.used), list(x[2 * self.used :])
        v, q, s, b = (one.conj()[:, :, None] for one in (self.v, self.q, self.s, self.b))
        half = 1j * (self.sines @ (above - below))[:, None, None] / 2
        rows = rest[-1] * v * self.v[:, None] + self.paid @ (above + below) * b * self.b[:, None]
        rows = rows + half * b * self.v[:, None] - half * v * self.b[:, None]
        fixed = np.zeros(self.inputs)
        fixed[: self.wide] = 1.0
        scale = rest[-1] * self.weight**2
        if self.sloping:
            rows, fixed[self.wide] = rows + rest[0] * self.half**2 * s * self.s[:, None], rest[0]
        if self.stiff:
            scale, fixed[-1] = scale + rest[-2] * self.stiffness**2, rest[-2]
        return rows + scale * q * self.q[:, None] - np.diag(fixed)

    def cuts(self, where: Array, x: Array) -> tuple[Array, Array]:
        """Rows A and sides b of A z ≤ b: the form along some x, at frequencies, below a margin."""
        v, q, s, b = (np.sum(one[where] * x, axis=1) for one in (self.v, self.q, self.s, self.b))
        square, position = np.abs(v) ** 2, np.abs(q) ** 2
        cross = self.sines[where] * np.imag(v * b.conj())[:, None]
        paid = np.abs(b[:, None]) ** 2 * self.paid
        columns = [paid - cross, paid + cross]
        if self.sloping:
            columns.append((self.half**2 * np.abs(s) ** 2 - np.abs(x[:, self.wide]) ** 2)[:, None])
        if self.stiff:
            columns.append((self.stiffness**2 * position - np.abs(x[:, -1]) ** 2)[:, None])
        columns.append((square + self.weight**2 * position)[:, None])
        A, b = np.hstack(columns), np.sum(np.abs(x[:, : self.wide]) ** 2, axis=1) - 2 * FORM_MARGIN
        size = np.maximum(np.abs(A).max(axis=1), 1e-12)
        return A / size[:, None], b / size

    def feasible_radius(self, x: Array) -> float:
        """The greatest radius over the centre that these coefficients and weights show on the grid; zero for none."""
        rest = -self.at(np.concatenate([x[:-1], [0.0]])) - 2 * FORM_MARGIN * np.eye(self.inputs)
        if np.linalg.eigvalsh(rest).min() <= 0:
            return 0.0
        sides = np.stack([self.v, self.weight * self.q], axis=1)
        small = sides @ np.linalg.solve(rest, sides.conj().transpose(0, 2, 1))
        return float(min(1.0, np.linalg.eigvalsh(small)[:, -1].max() ** -0.5))

    def multiplier(self, x: Array) -> Multiplier:
        """In the units of the loop, without the exponentials that are not used."""
        above, below = x[: 2 * self.used].reshape(2, self.used)
        c = above - below
        keep = np.abs(c) > MIN_COEFFICIENT * np.abs(c).max(initial=1e-12)
        slope = float(x[2 * self.used]) if self.sloping else 1.0
        stiffness = float(x[-2]) if self.stiff else 1.0
        top = self.top[: self.used]
        return Multiplier(self.decays[: self.used][keep], (c * top * self.centre)[keep], slope, stiffness)
