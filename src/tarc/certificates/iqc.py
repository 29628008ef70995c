"""Integral quadratic constraint of an inertia with a bounded rate: its multiplier allows a larger ball."""

from typing import NamedTuple

import numpy as np

from tarc.analysis.operating_points import within_period
from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop
from tarc.core.types import Array
from tarc.numerics.linear_program import CuttingPlanes
from tarc.numerics.norms import fdi_negative

N_DECAYS = 10
"""Number of exponentials in the multiplier."""
N_FIRST_CUTS = 50
"""Approximate number of frequencies in the first linear program."""
MAX_CUT_ROUNDS = 40
"""Largest number of rounds in which `best_multiplier` adds cuts."""
RANGE_TOLERANCE = 1.005
"""Factor by which the range of ratios may still grow when a search ends."""
CLOSE_RANGE = 1.03
"""The same for a search that compares balls."""
MIN_CHANGE = 1e-4
"""Least change in a period, as a share of the centre, for which a multiplier is searched for."""
MIN_COEFFICIENT = 1e-4
"""Share of the largest coefficient below which one is dropped."""
MIN_DECAY = 1e-7
"""Least 1 − p of a decay; slower ones act only below the frequencies that are tested."""
WITHIN_SHARE = 0.05
"""Share β of the bound (1 + β) σ² + (1 + 1/β) ε² on (σ + ε)², where ε is what an acceleration adds in a period."""
FORM_MARGIN = 1e-6
"""Amount by which the form must be negative, as a share of the mismatch's own square."""


class Multiplier(NamedTuple):
    """Proof that a loop tolerates a ball of E that changes slowly.

    A robot of stiffness H maps v to the acceleration b − d with b = E v and d = H x. Let a = b − d − ρ0 v be its
    difference from the centre. With y_m = Σ_i c_i p_i^m, m ≥ 1, any symmetric E(t) whose inverse changes by at most D_m
    within m periods satisfies

        2 Σ_k Σ_m y_m (v_{k+m}ᵀ b_k − v_kᵀ b_{k+m}) ≥ −2 Σ_m |y_m| D_m Σ_k ‖b_k‖²,

    because each summand is b_{k+m}ᵀ (E⁻¹_{k+m} − E⁻¹_k) b_k. It is added to ‖a‖² ≤ δ² (‖v‖² + η² ‖x‖²) and
    ‖d‖ ≤ σ ‖x‖, σ = ‖H‖, which hold for any rate of E. Within a period the acceleration moves x and adds ε to d, with
    ε = σ g (ρ0 + δ) √(‖v‖² + η² ‖x‖²), see `tarc.analysis.operating_points.UncertaintySamples.needed_radius`.

    Attributes
    ----------
    decays, coefficients
        p_i and c_i, shape (k,).
    slope, stiffness
        Weights of the inequalities of the slope and of the stiffness.
    """

    decays: Array
    coefficients: Array
    slope: float = 1.0
    stiffness: float = 1.0


def rate_penalty(decays: Array, max_change: float, largest: float) -> Array:
    """Return 2 Σ_m p^m D_m for each decay p, shape (k,).

    D_m = m Δ ((1 + μ)/(1 − μ))², μ = ε/(1 − ε), ε = Δ · largest/2. Over a period E is nearly the inverse of its
    inverse's mean, if ε is small: half the change of E⁻¹ times the largest E. The penalty is infinite for ε ≥ 1/3.

    Parameters
    ----------
    decays
        p, shape (k,).
    max_change
        Δ, the largest change of E⁻¹ in one period.
    largest
        Largest eigenvalue of E.
    """
    p, half_change = np.asarray(decays, dtype=float), max_change * largest / 2
    if not half_change < 1 / 3:
        return np.full_like(p, np.inf)
    mu = half_change / (1 - half_change)
    return 2 * max_change * ((1 + mu) / (1 - mu)) ** 2 * p / (1 - p) ** 2


def satisfies_iqc(
    loop: UncertainLoop,
    centre: float,
    radius: float,
    max_change: float,
    multiplier: Multiplier,
    position_weight: float = 0.0,
    stiffness: float = 0.0,
    growth: float = 1.0,
) -> bool:
    """Return whether the multiplier proves at all frequencies that the loop tolerates the ball.

    The form of `iqc_matrices` must be negative. It is the sum of the inequalities of `Multiplier`, and of
    |k s/2|² ≥ |w|² for the slope, with their weights.

    Parameters
    ----------
    loop
        The loop.
    centre, radius
        ρ0 and δ.
    max_change
        Δ, the largest change of E⁻¹ in one period.
    multiplier
        The multiplier.
    position_weight, stiffness
        η and the largest ‖[H, C/θ]‖ [1/s²].
    growth
        Factor g in each period for a decay as g^−k. The inequalities hold for signals times g^k as well, because E, H,
        C and the slope have no memory.
    """
    p, c = multiplier.decays, multiplier.coefficients
    in_range = max_change >= 0 and np.all((p > 0) & (p < 1 - MIN_DECAY))
    if not in_range or not multiplier.slope > 0 or not multiplier.stiffness > 0 or radius > centre:
        return False
    if not np.isfinite(np.abs(c) @ rate_penalty(p, max_change, centre + radius) if len(p) else 0.0):
        return False
    A, B, Q, S, R = iqc_matrices(loop, centre, radius, max_change, multiplier, position_weight, stiffness, growth)
    return fdi_negative(A, B, Q, S, R + FORM_MARGIN * np.eye(len(R)))


def iqc_matrices(
    loop: UncertainLoop,
    centre: float,
    radius: float,
    max_change: float,
    multiplier: Multiplier,
    position_weight: float = 0.0,
    stiffness: float = 0.0,
    growth: float = 1.0,
) -> tuple[Array, Array, Array, Array, Array]:
    """Return A, B, Q, S, R of the form that must be negative, each input scaled so that its own square has −1.

    The states are those of the loop, v through the exponentials, and b through the exponentials. The inputs are a, w
    and d, as far as there is a slope and a stiffness. The parameters are those of `satisfies_iqc`.
    """
    A, B, C, D = loop.closed_loop(centre, position_weight, growth)
    p, c = multiplier.decays, multiplier.coefficients
    penalty = np.abs(c) @ rate_penalty(p, max_change, centre + radius) if len(p) else 0.0
    n, k, n_mismatch = len(A), len(p), loop.B_mismatch.shape[1]
    has_slope, has_stiffness = bool(loop.half_slope.item()), bool(position_weight and stiffness)
    n_inputs = B.shape[1] + has_stiffness
    m = n + 2 * k
    # every signal is a row over (states, inputs)
    unit = np.eye(m + n_inputs)
    outputs = np.hstack([C, np.zeros((len(C), 2 * k)), D, np.zeros((len(C), int(has_stiffness)))])
    u, v = unit[m:], outputs[0]
    b = centre * v + u[0] + (u[-1] if has_stiffness else 0.0)
    dynamics = np.zeros((m, m + n_inputs))
    dynamics[:n, :n], dynamics[:n, m : m + B.shape[1]] = A, B
    dynamics[n : n + k] = p[:, None] * (unit[n : n + k] + v)
    dynamics[n + k :] = p[:, None] * (unit[n + k : m] + b)

    form = radius**2 * _square(v) + penalty * _square(b) - sum(_square(row) for row in u[:n_mismatch])
    form = form + _product(v, c @ unit[n + k : m]) - _product(c @ unit[n : n + k], b)
    scale = np.ones(n_inputs)
    position_and_velocity = outputs[1 : len(C) - has_slope] if position_weight else outputs[:0]
    squared_position = position_and_velocity.T @ position_and_velocity
    form = form + radius**2 * squared_position
    if has_slope:
        form = form + multiplier.slope * (_square(outputs[-1]) - _square(u[n_mismatch]))
        scale[n_mismatch] = multiplier.slope**-0.5
    if has_stiffness:
        period = loop.B[1, 0] ** 0.5
        within = stiffness * within_period(loop.lead_periods.item() * period, period) * (centre + radius)
        of_both = (1 + 1 / WITHIN_SHARE) * within**2
        of_position = (1 + WITHIN_SHARE) * (stiffness / position_weight) ** 2 + of_both
        form = form + multiplier.stiffness * (of_position * squared_position + of_both * _square(v) - _square(u[-1]))
        scale[-1] = multiplier.stiffness**-0.5
    Q, S, R = form[:m, :m], form[:m, m:] * scale, form[m:, m:] * scale * scale[:, None]
    return dynamics[:, :m], dynamics[:, m:] * scale, Q, S, R


def _square(row: Array) -> Array:
    return np.outer(row, row)


def _product(first: Array, second: Array) -> Array:
    return np.outer(first, second) + np.outer(second, first)


def best_multiplier(
    loop: UncertainLoop,
    centre: float,
    max_change: float,
    *,
    position_weight: float = 0.0,
    stiffness: float = 0.0,
    responses: FrequencyResponses | None = None,
    enough: float = np.inf,
    least: float = 0.0,
    close: float = RANGE_TOLERANCE,
) -> tuple[Multiplier, float, float]:
    """Return the multiplier with the largest ball on a grid of frequencies, its radius, and a bound on that radius.

    A linear program over coefficients and weights gives it. Cuts are added half-way between its solution and the best
    feasible point.

    Parameters
    ----------
    loop
        The loop.
    centre
        ρ0.
    max_change
        Δ, the largest change of E⁻¹ in one period.
    position_weight, stiffness
        η and the largest ‖[H, C/θ]‖ [1/s²], as in `tarc.certificates.certify_robot`.
    responses
        Frequency responses of the loop, where they exist already.
    enough
        Radius at which to stop, once it is reached or out of reach.
    least
        Radius at which to stop, once it is out of reach.
    close
        Factor by which the range of ratios may still grow when the search ends.

    Returns
    -------
    multiplier, radius, bound
        The radius is zero where none was found. The bound is that of the last linear program.
    """
    max_change = max(max_change, MIN_CHANGE / centre)  # without a penalty nothing bounds the coefficients
    forms = _FormsOverFrequency(
        loop, responses or FrequencyResponses(loop), centre, max_change, position_weight, stiffness
    )
    best = forms.start()
    radius_ratio = forms.feasible_radius(best)
    if not radius_ratio:
        return forms.multiplier(best), 0.0, centre
    best[-1] = radius_ratio**2
    only_mismatch = np.zeros((len(forms.v), forms.n_inputs), dtype=complex)
    only_mismatch[:, 0] = 1.0
    first = np.arange(0, len(forms.v), max(len(forms.v) // N_FIRST_CUTS, 1))
    program = CuttingPlanes(forms.n_unknowns)
    program.add(*forms.cuts(first, only_mismatch[first]))
    enough, least, bound = (enough / centre) ** 2, (least / centre) ** 2, 1.0
    for _ in range(MAX_CUT_ROUNDS):
        if best[-1] >= enough:
            break
        solution = program.solve()
        if solution is None:
            break
        bound = solution[-1]
        if bound < least or bound < enough < 1 or _ratio_range(bound) < close * _ratio_range(best[-1]):
            break
        trial = (best + solution) / 2
        at_trial = forms.at(trial)
        largest = np.linalg.eigvalsh(at_trial)[:, -1]
        is_peak = (largest >= np.append(largest[1:], -np.inf)) & (largest >= np.append(-np.inf, largest[:-1]))
        violated = np.flatnonzero(is_peak & (largest > -2 * FORM_MARGIN))
        if len(violated):
            program.add(*forms.cuts(violated, np.linalg.eigh(at_trial[violated])[1][:, :, -1]))
        radius_ratio = forms.feasible_radius(trial)
        if radius_ratio**2 > best[-1]:
            best, best[-1] = trial, radius_ratio**2
    return forms.multiplier(best), centre * best[-1] ** 0.5, centre * float(bound) ** 0.5


def _ratio_range(squared_radius_ratio: float) -> float:
    """Return the quotient of the ends of a ball, from (δ/ρ0)²."""
    return (1 + squared_radius_ratio**0.5) / max(1 - squared_radius_ratio**0.5, 1e-9)


class _FormsOverFrequency:
    """The form of `satisfies_iqc` at each frequency of a grid, as a function of the unknowns.

    The unknowns are the c_i above and below zero, the weights of slope and stiffness if there are such, and (δ/ρ0)².
    All are scaled to the order of one. The inputs are a, w and d, as far as they exist.
    """

    def __init__(
        self,
        loop: UncertainLoop,
        responses: FrequencyResponses,
        centre: float,
        max_change: float,
        position_weight: float,
        stiffness: float,
    ):
        G = responses.at_ratio(centre)
        self.n_mismatch, self.half_slope = loop.B_mismatch.shape[1], responses.half_slope
        self.has_slope, self.has_stiffness = bool(self.half_slope), bool(position_weight and stiffness)
        G = G if self.has_slope else G[:, :, : self.n_mismatch]
        G = np.concatenate([G, 0 * G[:, :, :1]], axis=2) if self.has_stiffness else G
        self.n_inputs = G.shape[2]
        self.v, self.q, self.s = centre * G[:, 0], G[:, 1] * responses.lead_factor, G[:, 1]
        identity = np.eye(self.n_inputs)
        self.b = self.v + identity[0] + (identity[-1] if self.has_stiffness else 0)
        self.position_weight, self.stiffness, self.centre = centre * position_weight, stiffness, centre
        self.start_scale = responses.best_scale(centre, position_weight)[0]
        spectral_radius = np.max(np.abs(np.linalg.eigvals(loop.closed_loop(centre)[0])))
        slowest = -np.log(min(max(spectral_radius, 0.5), 1 - 1e-5))
        p = self.decays = np.exp(-np.geomspace(slowest / 5, 2.0, N_DECAYS))
        self.unit = (1 - p**2) / p  # scales each coefficient by the largest of its sine
        z = np.exp(1j * responses.angles)[:, None]
        sines = 4 * self.unit * np.imag(p * z / (1 - p * z))
        penalty = rate_penalty(p, max_change, 2 * centre) * self.unit * centre
        self.n_decays = N_DECAYS if np.isfinite(penalty).all() else 0
        self.penalty, self.sines = penalty[: self.n_decays], sines[:, : self.n_decays]
        self.n_unknowns = 2 * self.n_decays + self.has_slope + self.has_stiffness + 1

    def start(self) -> Array:
        """Return a feasible point: no multiplier, and the scale of the slope for any rate."""
        x = np.zeros(self.n_unknowns)
        if self.has_slope:
            x[2 * self.n_decays] = self.start_scale**-2
        if self.has_stiffness:
            x[-2] = 0.01 / max(np.max(np.abs(self.stiffness * self.q)) ** 2, 1e-12)
        return x

    def at(self, x: Array) -> Array:
        """Return the form at each frequency, shape (f, i, i)."""
        (above, below), weights = x[: 2 * self.n_decays].reshape(2, self.n_decays), list(x[2 * self.n_decays :])
        v, q, s, b = (row.conj()[:, :, None] for row in (self.v, self.q, self.s, self.b))
        half = 1j * (self.sines @ (above - below))[:, None, None] / 2
        form = weights[-1] * v * self.v[:, None] + self.penalty @ (above + below) * b * self.b[:, None]
        form = form + half * b * self.v[:, None] - half * v * self.b[:, None]
        diagonal = np.zeros(self.n_inputs)
        diagonal[: self.n_mismatch] = 1.0
        position_weight = weights[-1] * self.position_weight**2
        if self.has_slope:
            form = form + weights[0] * self.half_slope**2 * s * self.s[:, None]
            diagonal[self.n_mismatch] = weights[0]
        if self.has_stiffness:
            position_weight, diagonal[-1] = position_weight + weights[-2] * self.stiffness**2, weights[-2]
        return form + position_weight * q * self.q[:, None] - np.diag(diagonal)

    def cuts(self, frequencies: Array, x: Array) -> tuple[Array, Array]:
        """Return A and b of A z ≤ b: the form along directions x, at some frequencies, is below its margin."""
        v, q, s, b = (np.sum(row[frequencies] * x, axis=1) for row in (self.v, self.q, self.s, self.b))
        squared_v, squared_q = np.abs(v) ** 2, np.abs(q) ** 2
        cross = self.sines[frequencies] * np.imag(v * b.conj())[:, None]
        penalty = np.abs(b[:, None]) ** 2 * self.penalty
        columns = [penalty - cross, penalty + cross]
        if self.has_slope:
            squared_w = np.abs(x[:, self.n_mismatch]) ** 2
            columns.append((self.half_slope**2 * np.abs(s) ** 2 - squared_w)[:, None])
        if self.has_stiffness:
            columns.append((self.stiffness**2 * squared_q - np.abs(x[:, -1]) ** 2)[:, None])
        columns.append((squared_v + self.position_weight**2 * squared_q)[:, None])
        A, bound = np.hstack(columns), np.sum(np.abs(x[:, : self.n_mismatch]) ** 2, axis=1) - 2 * FORM_MARGIN
        size = np.maximum(np.abs(A).max(axis=1), 1e-12)
        return A / size[:, None], bound / size

    def feasible_radius(self, x: Array) -> float:
        """Return the largest δ/ρ0 that these coefficients and weights prove on the grid; zero for none."""
        remaining = -self.at(np.concatenate([x[:-1], [0.0]])) - 2 * FORM_MARGIN * np.eye(self.n_inputs)
        try:
            factors = np.linalg.cholesky(remaining)
        except np.linalg.LinAlgError:
            return 0.0
        outputs = np.stack([self.v, self.position_weight * self.q], axis=1)
        halves = np.linalg.solve(factors, outputs.conj().transpose(0, 2, 1))
        squared_gains = np.linalg.eigvalsh(halves.conj().transpose(0, 2, 1) @ halves)[:, -1]
        return float(min(1.0, squared_gains.max() ** -0.5))

    def multiplier(self, x: Array) -> Multiplier:
        """Return the multiplier in the units of the loop, without negligible exponentials."""
        above, below = x[: 2 * self.n_decays].reshape(2, self.n_decays)
        c = above - below
        kept = np.abs(c) > MIN_COEFFICIENT * np.abs(c).max(initial=1e-12)
        slope = float(x[2 * self.n_decays]) if self.has_slope else 1.0
        stiffness = float(x[-2]) if self.has_stiffness else 1.0
        coefficients = c * self.unit[: self.n_decays] * self.centre
        return Multiplier(self.decays[: self.n_decays][kept], coefficients[kept], slope, stiffness)
