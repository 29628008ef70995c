"""Whether the certificates tell the truth: ``python -m benchmarks.soundness`` simulates random designs against them.

Nothing here uses the matrices of a certificate. The loops are recurrences written by hand from the equations of the
laws, with weights from least squares of their own, and the adversaries choose what the certificates say may vary:
the mismatch E(t) within its ball, at any speed or within a rate, alone or with a stiffness H(t) of the robot, in two
dimensions, and the slope κ(t) of the robust term.
"""

import argparse
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from tarc import estimators, laws
from tarc.analysis import stable_intervals
from tarc.analysis.linearise import decouple
from tarc.analysis.uncertain_loop import parts_of
from tarc.certificates import ball, loop, slope
from tarc.certificates.varying_ratio import best_scales, widest
from tarc.core.progress import Progress

Array = np.ndarray

PERIOD = 1e-3
SUBSTEPS = 4
"""Stretches of a period over which a mismatch that may change within it is constant."""
LOOK = 50
"""Steps between two measurements of the size of the states."""


@dataclass(frozen=True)
class Design:
    """A law in numbers, and the inertia ratio and slope of its robust term that it is to bear."""

    bandwidth: float = 10.0
    damping: float = 1.0
    window: int = 10
    degree: int = 2
    cutoff: float = 0.0
    synchronised: bool = False
    periods: int = 1
    computation: int = 0
    actuation: int = 0
    ratio: float = 0.1
    kappa: float = 0.0
    weight: float = 1.0
    boundary: float = 0.01
    margin: float = 1.0

    @property
    def estimator(self) -> estimators.Estimator:
        """Filtered difference where there is a cutoff, plain where the window is zero, else the sliding window."""
        if self.cutoff:
            return estimators.FilteredDifference(cutoff=self.cutoff)
        if not self.window:
            return estimators.BackwardDifference()
        return estimators.Algebraic(window=self.window * PERIOD, degree=self.degree)

    @cached_property
    def law(self) -> laws.TDE:
        """The law of the package with these numbers: TARC where there is a robust term."""
        options: dict[str, Any] = {
            "inertia": 0.1,
            "bandwidth": self.bandwidth,
            "damping": self.damping,
            "period": PERIOD,
            "estimator": self.estimator,
            "synchronised": self.synchronised,
            "actuation_delay": self.actuation,
            "delay": None if self.periods == 1 else self.periods * PERIOD,
        }
        if not self.kappa:
            return laws.TDC(**options)
        weight = [2 * self.bandwidth**2 * self.weight, 2.0]  # P2 = q1 / (2 K1)
        options |= {"weight": weight, "boundary": self.boundary, "margin": self.margin}
        return laws.TARC(rise=100.0, fall=100.0, **options)

    @property
    def alternates(self) -> bool:
        """Whether a torque that alternates from period to period is never damped: a pole at −1 for every ratio."""
        return not self.synchronised and (self.periods + self.actuation) % 2 == 0

    @property
    def gain(self) -> float:
        """The frozen ĉ [rad/s²] that makes the slope α ĉ P2/ε."""
        return self.kappa * self.boundary / (self.margin * self.weight)


def draw(rng: np.random.Generator, robust: bool = False) -> Design:
    """A random design, ratio and slope aside."""
    kind = rng.choice(["window", "difference", "filter"], p=[0.8, 0.08, 0.12])
    degree = int(rng.choice([2, 3], p=[0.75, 0.25]))
    synchronised = bool(rng.random() < 0.5)
    return Design(
        bandwidth=float(np.exp(rng.uniform(np.log(2), np.log(60)))),
        damping=float(rng.uniform(0.5, 2)),
        window=int(rng.integers(degree, 26)) if kind == "window" else 0,
        degree=degree,
        cutoff=float(np.exp(rng.uniform(np.log(50), np.log(2000)))) if kind == "filter" else 0.0,
        synchronised=synchronised,
        periods=1 if synchronised or rng.random() < 0.9 else int(rng.choice([2, 3])),
        computation=int(rng.choice([0, 1, 2, 3], p=[0.5, 0.2, 0.15, 0.15])),
        actuation=int(rng.choice([1, 2, 3])) if rng.random() < 0.15 else 0,
        weight=float(np.exp(rng.uniform(-1, 1))) if robust else 1.0,
        boundary=float(np.exp(rng.uniform(np.log(1e-3), np.log(0.1)))) if robust else 0.01,
        margin=float(rng.uniform(1, 2)) if robust else 1.0,
    )


class Recurrence(NamedTuple):
    """v_k = Σ_{i≥1} v_i v_{k−i} + Σ_{i≥0} q_i q_{k−i} + w_k + e w_{k−1}, which acts ``delay`` periods later."""

    v: Array
    q: Array
    e: float
    delay: int


def least_squares(window: int, degree: int, derivative: int) -> Array:
    """Weights of the window's samples, newest first, by fitting a polynomial to each sample's own unit."""
    if not window:  # backward differences
        return np.array([[1.0, -1.0, 0.0], [1.0, -2.0, 1.0]])[derivative - 1] / PERIOD**derivative
    age = -np.arange(window + 1) * PERIOD
    fit = np.polynomial.polynomial.polyfit(age / PERIOD, np.eye(window + 1), degree)
    return fit[derivative] * derivative / PERIOD**derivative  # j! is j for the first two derivatives


def recurrence(design: Design) -> Recurrence:
    """The law as a recurrence.

    Literal: v = u − z⁻ᵐ â + z⁻ᵐ⁻ᵃ v; synchronised: v = u − â + z⁻¹⁻ᵃ c(z) v; with u = −K1 q − K2 v̂ + w, and behind a
    low-pass both times its 1 − p z⁻¹.
    """
    pole = np.exp(-design.cutoff * PERIOD) if design.cutoff else 0.0
    lag = np.array([1.0, -pole])
    rate, second = ((1 - pole) * least_squares(design.window, design.degree, j) for j in (1, 2))
    K1, K2 = design.bandwidth**2, 2 * design.damping * design.bandwidth

    def later(polynomial: Array, periods: int) -> Array:
        return np.concatenate([np.zeros(periods), polynomial])

    if design.synchronised:
        # the second difference estimate of a motion whose acceleration is one in a single period, then zero
        since = np.arange(len(second))
        pulse = PERIOD**2 * np.where(since > 0, since - 0.5, 0.0)
        average = np.array([second[: k + 1] @ pulse[k::-1] for k in range(1, len(second))])
        past, estimate = later(average, 1 + design.actuation), second
    else:
        past = later(lag, design.periods + design.actuation)
        estimate = later(second, design.periods)
    v = _sum(past, later(-lag[1:], 1))
    q = -_sum(_sum(K1 * lag, K2 * rate), estimate)
    return Recurrence(v[1:], q, float(lag[1]), design.computation)


def _sum(one: Array, two: Array) -> Array:
    """Of two polynomials, constant first."""
    return np.polynomial.polynomial.polyadd(one, two)


def _padded(polynomial: Array, length: int) -> Array:
    return np.pad(polynomial, (0, length - len(polynomial)))


class Polynomials(NamedTuple):
    """In powers of z⁻¹, constant first: of the closed loop, and of the numerators from a to v and q, and w to q."""

    closed: Array
    a_to_v: Array
    a_to_q: Array
    w_to_q: Array


def polynomials(law: Recurrence, ratio: float, kappa: float = 0.0, stiffness: float = 0.0) -> Polynomials:
    """Of the loop around q̈ = ρ v − h q, v held for a period, with a constant slope in it."""
    multiply = np.polynomial.polynomial.polymul
    own, side = np.concatenate([[1.0], -law.v]), _sum(-law.q, kappa * np.array([1.0, law.e]))
    swing = np.emath.sqrt(stiffness) * PERIOD
    # q = motion / (1 − 2 cos(√h T) z⁻¹ + z⁻²) of an acceleration
    reach = np.real(np.sinc(swing / 2 / np.pi) ** 2)
    motion = PERIOD**2 / 2 * reach * np.array([0.0, 1.0, 1.0])
    late = np.concatenate([np.zeros(law.delay), motion])
    free = multiply(own, [1.0, -2.0 * np.real(np.cos(swing)), 1.0])
    closed = _sum(free, ratio * multiply(late, side))
    return Polynomials(closed, -multiply(motion, side), multiply(motion, own), ratio * multiply(late, [1.0, law.e]))


def radius(closed: Array) -> float:
    """Largest root of a closed loop's polynomial."""
    return float(np.max(np.abs(np.roots(closed))))


def blur(closed: Array) -> float:
    """How far rounding of the coefficients may move the largest root, with room."""
    roots = np.roots(closed)
    lead = roots[np.argmax(np.abs(roots))]
    size = np.abs(lead) ** np.arange(len(closed) - 1, -1, -1)
    steep = np.abs(np.polyval(np.polyder(closed), lead))
    return float(1e4 * np.finfo(float).eps * (size @ np.abs(closed)) / max(steep, 1e-300)) + 1e-10


def respond(top: Array, bottom: Array, angles: Array) -> Array:
    """Frequency response at angles [rad a period]."""
    back = np.exp(-1j * angles)
    value = np.polynomial.polynomial.polyval
    return value(back, top) / value(back, bottom)


ANGLES = np.concatenate([np.geomspace(1e-5, 0.3, 1500), np.linspace(0.3, np.pi, 1500)])


def peak(top: Array, bottom: Array) -> tuple[float, float]:
    """Largest gain on a grid, drawn closer three times around its best point, and where [rad a period]."""
    return _highest(lambda angles: np.abs(respond(top, bottom, angles)))


def joint_peak(known: Polynomials, weight: float) -> tuple[float, float]:
    """Largest gain from a to (v, weight q) of one loop, and where [rad a period]."""

    def size(angles: Array) -> Array:
        q = weight * respond(known.a_to_q, known.closed, angles)
        return np.hypot(np.abs(respond(known.a_to_v, known.closed, angles)), np.abs(q))

    return _highest(size)


def most_negative(top: Array, bottom: Array) -> tuple[float, float]:
    """How far the response reaches to the left of zero, and where [rad a period]."""
    return _highest(lambda angles: -np.real(respond(top, bottom, angles)))


def _highest(function: Callable[[Array], Array]) -> tuple[float, float]:
    angles, best, where = ANGLES, -np.inf, 0.0
    for _ in range(4):
        values = function(angles)
        top = int(np.argmax(values))
        if values[top] > best:
            best, where = float(values[top]), float(angles[top])
        angles = np.linspace(angles[max(top - 1, 0)], angles[min(top + 1, len(angles) - 1)], 41)
    return best, where


# Constant loops, simulated


def trend(closed: Array, guess: float, most: int = 400_000) -> float:
    """Simulate a constant loop after a kick: the logarithm of its last quarter's peak over its second's.

    Long enough to show which way a mode of the guessed radius goes; NaN if that takes more steps than allowed: then
    the roots must decide.
    """
    from scipy.signal import lfilter

    steps = int(40 / max(abs(np.log(guess)), 1e-12)) + 40 * len(closed)
    if steps > most:
        return np.nan
    kick = np.zeros(steps)
    kick[0] = 1.0
    size = np.abs(np.asarray(lfilter([1.0], closed, kick)))
    if not np.all(np.isfinite(size)):
        return np.inf
    quarter = steps // 4
    late, early = size[3 * quarter :].max(), size[quarter : 2 * quarter].max()
    return float(np.log(max(late, 1e-300) / max(early, 1e-300)))


# Loops that an adversary changes


class Adversary(NamedTuple):
    """How the mismatch and the slope are chosen, by the names in `Fleet.run`."""

    mismatch: str = "none"
    slope: str = "none"


MISMATCHES = ("rotate at the peak", "rotate at half", "rotate", "switch", "bang", "greedy", "greedy output", "random")
SLOPES = ("pulse at the peak", "pulse", "greedy", "greedy output", "returning", "phase")


SLOW_MISMATCHES = (
    "rotate at the peak",
    "rotate at half",
    "rotate",
    "switch",
    "pump",
    "bang",
    "greedy output",
    "random",
)


class Case(NamedTuple):
    """A loop, the centre and radius of its mismatch, its largest slope, and the weight η of the robot's stiffness.

    The mismatch adds the acceleration (E − ρ0 I) v − H q with ‖[E − ρ0 I, H/η]‖ at most the radius, ‖dE⁻¹/dt‖ at most
    the rate [1/s] and ‖H‖ at most the stiffness [1/s²].
    """

    law: Recurrence
    centre: float
    radius: float = 0.0
    slope: float = 0.0
    weight: float = 0.0
    rate: float = np.inf
    stiffness: float = np.inf


def lean(case: Case, rate: float | Array, kappa: float = 0.0) -> tuple[Array, Array]:
    """How a pair that turns at a rate does most: shares of mismatch and stiffness as an angle, and its phase."""
    known = polynomials(case.law, case.centre, kappa)
    v = respond(known.a_to_v, known.closed, np.asarray(rate))
    q = case.weight * respond(known.a_to_q, known.closed, np.asarray(rate))
    return np.arctan2(np.abs(q), np.abs(v)), -np.angle(q)


def matrices(case: Case) -> tuple[Array, Array, Array, Array]:
    """A, B, W, C of the loop at the centre with half the slope: x⁺ = A x + B a + W w, v = C x.

    The state is q, q̇ T, the positions before, the newest first, and likewise v, and the last w.
    """
    law, T2 = case.law, PERIOD**2
    m, n = len(law.q) - 1, max(len(law.v), law.delay)
    size = 2 + m + n + 1
    C, act, first = np.zeros(size), np.zeros(size), 2 + m
    C[0], C[2:first], C[first : first + len(law.v)], C[-1] = law.q[0], law.q[1:], law.v, law.e
    half = -case.slope / 2 * np.eye(1, size)[0]  # w = half x
    C = C + half
    act[:] = C if law.delay == 0 else 0
    if law.delay:
        act[first + law.delay - 1] = 1.0
    A, B, W = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    A[0, :2], A[1, 1] = 1.0, 1.0
    A[0] += case.centre * T2 / 2 * act
    A[1] += case.centre * T2 * act
    if m:
        A[2, 0] = 1.0
        A[np.arange(3, first), np.arange(2, first - 1)] = 1.0
    if n:
        A[first] = C
        A[np.arange(first + 1, first + n), np.arange(first, first + n - 1)] = 1.0
    A[-1] = half
    B[:2] = T2 / 2, T2
    if law.delay == 0:
        W[:2] = case.centre * B[:2]
    W[first] = 1.0
    W[-1] = 1.0
    return A, B, W, C


def multiplier(case: Case, kappa: float, rates: Array) -> Array:
    """How much a period multiplies the state by, exactly, while a mismatch at the radius turns at each rate [rad].

    Its eigenvalues are the centre ± the radius. In the frame that turns along, the loop of the complex q has constant
    coefficients. The slope is constant, and so is the stiffness, which turns q by a constant angle.
    """
    A, B, W, C = matrices(case)
    A, C = A + np.outer(W, (case.slope / 2 - kappa) * np.eye(1, len(A))[0]), C.copy()
    C[0] += case.slope / 2 - kappa
    gain = case.radius * (np.outer(B, C) if case.law.delay == 0 else np.outer(B, np.eye(len(A))[_queue_end(case)]))
    found = []
    for rate in np.atleast_1d(rates):
        turn = np.exp(-1j * rate)
        share, phase = lean(case, rate, kappa)
        spring = case.radius * case.weight * np.sin(share) * np.exp(1j * phase)
        same, other = turn * (A + spring * np.outer(B, np.eye(1, len(A))[0])), turn * np.cos(share) * gain
        both = np.block([[(same + other).real, (other - same).imag], [(same + other).imag, (same - other).real]])
        found.append(float(np.max(np.abs(np.linalg.eigvals(both)))))
    return np.array(found)


def _queue_end(case: Case) -> int:
    """Where in the state the v is that acts now."""
    return 2 + len(case.law.q) - 1 + case.law.delay - 1


class Fleet:
    """Many loops at once, each in two dimensions as complex numbers, under many adversaries each.

    A symmetric mismatch Δ with eigenvalues l and m, turned by θ, takes v to (l+m)/2 v + (l−m)/2 e^{2iθ} v̄. A stiffness
    beside it that turns q and scales it, in shares of cos and sin, leaves the pair of them the norm of the radius.
    """

    def __init__(self, cases: Sequence[Case], adversaries: Sequence[Adversary], seed: int = 0):
        self.cases, self.adversaries = cases, adversaries
        self.rng = np.random.default_rng(seed)
        count = len(cases)
        self.length = max(max(len(case.law.q), len(case.law.v) + 1, case.law.delay + 1) for case in cases)
        self.q, self.v = np.zeros((self.length, count)), np.zeros((self.length, count))
        for i, case in enumerate(cases):
            self.q[: len(case.law.q), i] = case.law.q
            self.v[1 : len(case.law.v) + 1, i] = case.law.v
        self.e, self.centre, self.radius, self.slope, self.weight = (
            np.array(one)
            for one in zip(*((c.law.e, c.centre, c.radius, c.slope, c.weight) for c in cases), strict=True)
        )
        self.delay = np.array([case.law.delay for case in cases])
        self.peak, self.turn = np.zeros(count), np.zeros(count)
        for i, case in enumerate(cases):
            known = polynomials(case.law, case.centre, case.slope / 2)
            self.peak[i] = joint_peak(known, case.weight)[1]
            self.turn[i] = most_negative(known.w_to_q, known.closed)[1] if case.slope else self.peak[i]
        self.functionals = {kind: self._functional(kind) for kind in ("greedy", "greedy output") if self._uses(kind)}

    def _uses(self, kind: str) -> bool:
        names = {name for adversary in self.adversaries for name in adversary}
        return kind in names or (kind == "greedy" and "bang" in names)

    def _functional(self, kind: str) -> dict[str, Array]:
        """Weights of the histories in BᵀPAx for the two rows that an acceleration enters, and in WᵀPAx.

        P is a Lyapunov matrix of the loop at the centre: of the state, or of v alone.
        """
        from scipy.linalg import solve_discrete_lyapunov

        count = len(self.cases)
        rows = {"q": np.zeros((3, self.length, count)), "v": np.zeros((3, self.length, count))}
        rows |= {"rate": np.zeros((3, count)), "w": np.zeros((3, count))}
        for i, case in enumerate(self.cases):
            A, _, W, C = matrices(case)
            scale = np.ones(len(A))
            scale[2 + len(case.law.q) - 1 :] = PERIOD**2  # so that v counts as q does
            row = C * PERIOD**2 / scale
            weight = np.eye(len(A)) if kind == "greedy" else np.outer(row, row)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # whatever P is, the adversary is allowed; it only guesses worse
                P = solve_discrete_lyapunov(A.T * np.outer(1 / scale, scale), weight, method="bilinear")
            P = (P + P.T) / 2 * np.outer(scale, scale)
            m = len(case.law.q) - 1
            picked = np.stack([P[0] @ A, P[1] @ A, W @ P @ A])
            rows["q"][:, 0, i], rows["rate"][:, i] = picked[:, 0], picked[:, 1]
            rows["q"][:, 1 : m + 1, i] = picked[:, 2 : 2 + m]
            width = min(picked.shape[1] - 3 - m, self.length - 1)
            rows["v"][:, 1 : width + 1, i] = picked[:, 2 + m : 2 + m + width]
            rows["w"][:, i] = picked[:, -1]
        return rows

    def run(self, steps: int, *, within: bool = False) -> Array:
        """Logarithm of the growth over the second half of the steps, (adversaries, cases).

        With ``within`` the mismatch may change inside a period.
        """
        kinds, count, L = len(self.adversaries), len(self.cases), self.length
        shape = (kinds, count)
        rng, T2 = self.rng, PERIOD**2
        q = rng.normal(size=shape) + 1j * rng.normal(size=shape)
        rate = np.zeros(shape, dtype=complex)
        room = 8 * L
        Q, V = np.zeros((room, *shape), dtype=complex), np.zeros((room, *shape), dtype=complex)
        last_w = np.zeros(shape, dtype=complex)
        at, log, half = L - 1, np.zeros(shape), np.zeros(shape)
        rates = {"rotate": rng.uniform(0, 2, count) * self.peak, "pulse": rng.uniform(0, 3, count) * self.turn}
        rates |= {"rotate at half": self.peak / 2, "rotate at the peak": self.peak}
        leans = {kind: self._leans(rates[kind]) for kind in rates if kind.startswith("rotate")}
        aside = rng.uniform(0, 2 * np.pi, count)
        columns, held = np.arange(count), 1 if not within else SUBSTEPS
        for k in range(steps):
            if at == room - 1:
                Q[: L - 1], V[: L - 1] = Q[-(L - 1) :], V[-(L - 1) :]
                at = L - 2
            at += 1
            Q[at] = q
            past_q, past_v = Q[at : at - L if at >= L else None : -1], V[at : at - L if at >= L else None : -1]
            V[at] = 0
            v = np.einsum("lc,lkc->kc", self.q, past_q) + np.einsum("lc,lkc->kc", self.v, past_v) + self.e * last_w
            pulls = {kind: self._pull(rows, past_q, past_v, rate, last_w) for kind, rows in self.functionals.items()}
            kappa = np.zeros(shape)
            for i, adversary in enumerate(self.adversaries):
                if adversary.slope != "none":
                    on = self._steep(adversary.slope, i, k, q, rate, pulls, rates, aside)
                    kappa[i] = np.where(on, self.slope, 0.0)
            w = -kappa * q
            v += w
            V[at] = v
            acting = V[at - self.delay, :, columns].T
            last_w = w
            for j in range(held):
                reach = (held - j - 0.5) / held
                moment = k + (j + 0.5) / held
                push = self.centre * acting
                for i, adversary in enumerate(self.adversaries):
                    if adversary.mismatch != "none":
                        outputs = acting[i], self.weight * q[i]
                        push[i] += self._push(adversary.mismatch, i, moment, reach, outputs, pulls, rates, leans)
                q = q + rate / held + push * T2 / (2 * held**2)
                rate = rate + push * T2 / held
            if k % LOOK == LOOK - 1:
                size = np.maximum(np.max(np.abs(Q[at - L + 1 : at + 1]), axis=0), np.abs(q)) + 1e-290
                size = np.maximum(size, np.max(np.abs(V[at - L + 1 : at + 1]), axis=0) * T2)
                q, rate, last_w = q / size, rate / size, last_w / size
                Q[at - L + 1 : at + 1] /= size
                V[at - L + 1 : at + 1] /= size
                log += np.log(size)
                if k < steps // 2:
                    half = log.copy()
        return log - half

    def _pull(self, rows: dict[str, Array], Q: Array, V: Array, rate: Array, w: Array) -> Array:
        """The three functionals of the state, (3, adversaries, cases)."""
        sums = np.einsum("rlc,lkc->rkc", rows["q"], Q) + np.einsum("rlc,lkc->rkc", rows["v"], V)
        return sums + rows["rate"][:, None] * rate + rows["w"][:, None] * w

    def _leans(self, rates: Array) -> tuple[Array, Array]:
        """`lean` of each case at its own rate."""
        found = [lean(case, rate, case.slope / 2) for case, rate in zip(self.cases, rates, strict=True)]
        return np.array([share for share, _ in found]), np.array([phase for _, phase in found])

    def _push(
        self,
        kind: str,
        i: int,
        moment: float,
        reach: float,
        outputs: tuple[Array, Array],
        pulls: dict[str, Array],
        rates: dict[str, Array],
        leans: dict[str, tuple[Array, Array]],
    ) -> Array:
        """The acceleration that one adversary makes of (v, η q): at most the radius times the norm of both."""
        v, q = outputs
        if kind.startswith("rotate"):
            share, phase = leans[kind]
            mismatch = np.cos(share) * np.exp(2j * rates[kind] * moment) * v.conj()
            return self.radius * (mismatch + np.sin(share) * np.exp(1j * phase) * q)
        if kind == "switch":
            share, sign = leans["rotate"][0], np.sign(np.sin(rates["rotate"] * moment + 0.1))
            return self.radius * sign * (np.cos(share) * v + np.sin(share) * q)
        if kind == "random":
            one, turn = self.rng.uniform(-1, 1, len(v)), np.exp(2j * self.rng.uniform(0, np.pi, len(v)))
            mismatch = (1 + one) / 2 * v + (1 - one) / 2 * turn * v.conj()
            share = np.where(self.weight > 0, self.rng.uniform(0, np.pi / 2, len(v)), 0.0)
            spring = np.exp(1j * self.rng.uniform(0, 2 * np.pi, len(v))) * q
            return self.radius * (np.cos(share) * mismatch + np.sin(share) * spring)
        pull = pulls["greedy output" if kind == "greedy output" else "greedy"][:, i]
        goal, size = reach * pull[0] + pull[1], np.hypot(np.abs(v), np.abs(q))
        if kind == "bang":
            along = (np.where((goal.conj() * one).real >= 0, 1.0, -1.0) * np.abs(one) * one for one in (v, q))
            return self.radius * sum(along) / np.maximum(size, 1e-300)
        # a reflection takes v to any direction, and a rotation q
        return self.radius * size * goal / np.maximum(np.abs(goal), 1e-300)

    def _steep(
        self,
        kind: str,
        i: int,
        k: int,
        q: Array,
        rate: Array,
        pulls: dict[str, Array],
        rates: dict[str, Array],
        aside: Array,
    ) -> Array:
        """Whether the slope is at its largest, else it is zero."""
        if kind == "pulse at the peak":
            return np.sin(2 * self.turn * k + aside) > 0
        if kind == "pulse":
            return np.sin(rates["pulse"] * k + aside) > 0
        if kind == "returning":
            return (q[i].conj() * rate[i]).real < 0
        if kind == "phase":
            beside = np.cos(aside) * q[i] + np.sin(aside) * rate[i] / np.maximum(self.turn, 1e-6)
            return (q[i].conj() * beside).real > 0
        # in the loop with half the slope, more of it adds −k/2 q along W and less of it k/2 q
        return (pulls[kind][2, i].conj() * q[i]).real < 0


def inverse(m: Array, c: Array) -> tuple[Array, Array]:
    """m and c of the inverse of v ↦ m v + c v̄."""
    size = m**2 - np.abs(c) ** 2
    return m / size, -c / size


class SlowFleet(Fleet):
    """Loops whose mismatch heads for where an adversary wants it, at no more than the rate of its case.

    A symmetric matrix takes v to m v + c v̄, with m real; its norm is |m| + |c|. What is kept here is E⁻¹, for which the
    ball is convex too. The stiffness, which may change at once, takes what room the mismatch leaves it.
    """

    def __init__(self, cases: Sequence[Case], adversaries: Sequence[Adversary], seed: int = 0):
        super().__init__(cases, adversaries, seed)
        self.reach = np.array([case.rate * PERIOD / SUBSTEPS for case in cases])
        self.stiffest = np.array([case.stiffness if case.weight else 0.0 for case in cases])
        shape = len(adversaries), len(cases)
        self.m, self.c = 1 / self.centre + np.zeros(shape), np.zeros(shape, dtype=complex)
        self.goal_m, self.goal_c = np.zeros(shape), np.zeros(shape, dtype=complex)
        share = self.rng.uniform(0, np.pi / 2, len(cases))
        self.extent = self.radius * np.where(self.stiffest > 0, np.cos(share), 1.0)
        self.share = self.reach / np.abs(inverse(self.centre, self.extent)[1])

    def _push(
        self,
        kind: str,
        i: int,
        moment: float,
        reach: float,
        outputs: tuple[Array, Array],
        pulls: dict[str, Array],
        rates: dict[str, Array],
        leans: dict[str, tuple[Array, Array]],
    ) -> Array:
        v, q = outputs[0], outputs[1] / np.where(self.weight > 0, self.weight, 1.0)
        pull = pulls["greedy output"][:, i]
        goal = reach * pull[0] + pull[1]
        along = goal / np.maximum(np.abs(goal), 1e-300)
        m, c = self._aim(kind, i, moment, v, along, rates)
        m, c = inverse(self.centre + m, c)
        m, c = m - self.m[i], c - self.c[i]
        share = np.minimum(1.0, self.reach / np.maximum(np.abs(m) + np.abs(c), 1e-300))
        self.m[i] += share * m
        self.c[i] += share * c
        m, c = inverse(self.m[i], self.c[i])
        m = m - self.centre
        room = np.maximum(self.radius**2 - (np.abs(m) + np.abs(c)) ** 2, 0.0)
        spring = np.minimum(self.stiffest, self.weight * np.sqrt(room))
        towards = np.exp(1j * leans[kind][1]) * q if kind.startswith("rotate") else np.abs(q) * along
        return m * v + c * v.conj() + spring * towards

    def _uses(self, kind: str) -> bool:
        return kind == "greedy output" or super()._uses(kind)

    def _aim(
        self, kind: str, i: int, moment: float, v: Array, along: Array, rates: dict[str, Array]
    ) -> tuple[Array, Array]:
        """Where the mismatch heads: m and c of E − ρ0 I."""
        none, size = np.zeros(len(v)), self.extent
        if kind.startswith("rotate"):
            return none, size * np.exp(1j * np.minimum(2 * rates[kind], self.share * SUBSTEPS) * moment)
        if kind in ("switch", "pump"):
            turn = 2 * self.peak if kind == "pump" else rates["rotate"]
            return size * np.sign(np.sin(turn * moment + 0.1)), none + 0j
        if kind == "bang":
            return size * np.where(np.real(along.conj() * v) >= 0, 1.0, -1.0), none + 0j
        if kind == "random":
            arrived = self.rng.random(len(v)) < np.minimum(1.0, self.share)
            one, turn = self.rng.uniform(-1, 1, len(v)), np.exp(2j * self.rng.uniform(0, np.pi, len(v)))
            self.goal_m[i] = np.where(arrived, size * (1 + one) / 2, self.goal_m[i])
            self.goal_c[i] = np.where(arrived, size * (1 - one) / 2 * turn, self.goal_c[i])
            return self.goal_m[i], self.goal_c[i]
        return none, size * along * v / np.maximum(np.abs(v), 1e-300)


# Designs against their certificates

EDGE = 3.0
"""Least logarithm of growth, or of decay, that shows which way a loop goes."""
STEPS = 4000
INSIDE = (0.25, 0.7, 0.05)
"""Shares of the ratios for what needs a stable loop to begin with."""


@dataclass
class Tally:
    """Verdicts counted; undecided are those that neither simulation nor roots can tell from the edge."""

    designs: int = 0
    certified: int = 0
    refuted: int = 0
    inconclusive: int = 0
    undecided: int = 0
    violations: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def count(self, verdict: str) -> None:
        self.designs += 1
        setattr(self, verdict, getattr(self, verdict) + 1)


def ratios(
    design: Design, rng: np.random.Generator, count: int, shares: tuple[float, float, float] = (0.5, 0.3, 0.2)
) -> Array:
    """Ratios to try: these shares near where stability ends, between its ends, and anywhere."""
    found = stable_intervals(design.law, computation_delay=design.computation)
    edges = np.array([edge for ends in found for edge in ends if 1e-6 < edge < 1e3])
    anywhere = np.exp(rng.uniform(np.log(2e-3), np.log(4.0), count))
    if not edges.size:
        return anywhere
    inside = np.exp(rng.uniform(np.log(edges.min()), np.log(edges.max()), count))
    near = rng.choice(edges, count) * np.exp(rng.choice([-1, 1], count) * 10 ** rng.uniform(-3.5, -0.5, count))
    return np.choose(rng.choice(3, count, p=shares), [near, inside, anywhere])


def check_loop(design: Design, rng: np.random.Generator, tally: Tally) -> None:
    """One ratio, simulated after a kick."""
    ratio = float(ratios(design, rng, 1)[0])
    verdict = loop(design.law, ratio, computation_delay=design.computation).verdict
    tally.count(verdict)
    if verdict == "inconclusive":
        return
    closed = polynomials(recurrence(design), ratio).closed
    size = radius(closed)
    way = trend(closed, size)
    if np.isnan(way) and abs(size - 1) > blur(closed):
        way = np.copysign(np.inf, size - 1)
    if design.alternates and verdict == "certified":
        way = 0.0  # by construction, whatever rounding makes of it
    elif np.isnan(way) or abs(way) < EDGE:
        tally.undecided += 1
        return
    if (way < -EDGE) != (verdict == "certified"):
        tally.violations.append(f"loop {verdict} at {ratio!r}, but log growth {way:.3g}: {design}")


def check_range(design: Design, rng: np.random.Generator, tally: Tally) -> None:
    """A range of ratios, by roots at ratios that it holds."""
    hand = recurrence(design)
    low, high = (float(end) for end in np.sort(ratios(design, rng, 2)))
    found = loop(design.law, (low, high), computation_delay=design.computation)
    tally.count(found.verdict)
    if found.verdict == "inconclusive":
        return
    if found.witness:
        size = radius(polynomials(hand, found.witness["ratio"]).closed)
        wrong = not low <= found.witness["ratio"] <= high or size < 1 - 1e-6
        tally.undecided += abs(size - 1) <= 1e-6
    else:
        size = max(radius(polynomials(hand, one).closed) for one in np.geomspace(low, high, 25))
        wrong = size > 1 + 1e-6 or design.alternates
    if wrong:
        tally.violations.append(f"loop {found.verdict} from {low!r} to {high!r}, but radius {size!r}: {design}")


def check_balls(
    designs: Sequence[Design], rng: np.random.Generator, tally: Tally, steps: int, advance: Callable[[], None]
) -> None:
    """Balls about random centres, or to hold random ranges, half of them with a slope, against adversaries."""
    cases: dict[bool, list[tuple[Design, Case]]] = {False: [], True: []}
    for design in designs:
        hand = recurrence(design)
        centre = float(ratios(design, rng, 1, INSIDE)[0])
        known = polynomials(hand, centre)
        options: dict[str, Any] = {"intersample": bool(rng.random() < 0.5), "computation_delay": design.computation}
        if rng.random() < 0.5 and radius(known.closed) < 1:
            reach = max(most_negative(known.w_to_q, known.closed)[0], 1e-9)
            options["slope"] = float(rng.uniform(0.02, 1.2) / reach)
        if rng.random() < 0.4:
            spread = np.exp(10 ** rng.uniform(-2, 0.3))
            options["contains"] = centre / spread, centre * spread
        found = ball(design.law, None if "contains" in options else centre, **options)
        tally.count(found.verdict)
        if found.certified:
            numbers = found.numbers
            case = Case(hand, numbers["centre"], numbers["radius"], numbers["slope"])
            cases[options["intersample"]].append((design, case))
        advance()
    both = [(mismatch, SLOPES[i % len(SLOPES)]) for i, mismatch in enumerate(MISMATCHES)]
    for within, pairs in cases.items():
        for design, case in pairs:
            wrong = frozen_or_turning(case)
            if wrong:
                tally.violations.append(f"ball {case[1:]}, but {wrong}: {design}")
        simulate(pairs, [Adversary(*one) for one in both], rng, tally, steps, within)


def frozen_or_turning(case: Case) -> str:
    """What is unstable of loops that a ball covers: constant ones, and those whose mismatch turns at the worst rate."""
    turns = np.linspace(-np.pi, np.pi, 17) if case.weight else np.arccos(np.linspace(-1, 1, 5))
    for kappa in (0.0, case.slope / 2, case.slope):
        for turn in turns:
            ratio = case.centre + case.radius * np.cos(turn)
            stiffness = np.clip(case.radius * case.weight * np.sin(turn), -case.stiffness, case.stiffness)
            size = radius(polynomials(case.law, ratio, kappa, stiffness).closed)
            if size > 1 + 1e-6:
                return f"radius {size!r} at ratio {ratio!r}, stiffness {stiffness!r}, slope {kappa!r}"
        known = polynomials(case.law, case.centre, kappa)
        fastest = case.rate * PERIOD * (case.centre**2 - case.radius**2) / (2 * case.radius)  # of what E⁻¹ may turn
        rate = min(joint_peak(known, case.weight)[1], fastest if case.rate < np.inf else np.pi)
        alone = case if case.stiffness == np.inf else case._replace(weight=0.0)
        size = multiplier(alone, kappa, np.array([rate / 2, rate])).max()
        if size > 1 + 1e-6:
            return f"multiplier {size!r} turning at {rate!r} rad a period, slope {kappa!r}"
    return ""


def check_pairs(
    designs: Sequence[Design], rng: np.random.Generator, tally: Tally, steps: int, advance: Callable[[], None]
) -> None:
    """Balls of pairs of mismatch and the robot's own stiffness, half of them with a slope, against adversaries."""
    pairs = []
    for design in designs:
        hand, centre = recurrence(design), float(ratios(design, rng, 1, INSIDE)[0])
        known = polynomials(hand, centre)
        steep = weight = 0.0
        if radius(known.closed) < 1:
            where = joint_peak(known, 0.0)[1] * np.exp(rng.uniform(-4, 0))
            v, q = (np.abs(respond(top, known.closed, np.array(where))) for top in (known.a_to_v, known.a_to_q))
            weight = float(v / q * np.exp(rng.uniform(-2, 2)))
            if rng.random() < 0.5:
                steep = float(rng.uniform(0.02, 1.0) / max(most_negative(known.w_to_q, known.closed)[0], 1e-9))
        parts = parts_of(decouple(design.law, design.computation)[0], steep, intersample=True)
        reach = best_scales(parts, centre, weight)[1]
        tally.count("certified" if reach > 0 else "inconclusive")
        if reach > 0:
            case = Case(hand, centre, reach, steep, weight)
            pairs.append((design, case))
            wrong = frozen_or_turning(case)
            if wrong:
                tally.violations.append(f"pairs {case[1:]}, but {wrong}: {design}")
        advance()
    both = [Adversary(mismatch, SLOPES[i % len(SLOPES)]) for i, mismatch in enumerate(MISMATCHES)]
    simulate(pairs, both, rng, tally, steps, within=True)


def check_slow(
    designs: Sequence[Design], rng: np.random.Generator, tally: Tally, steps: int, advance: Callable[[], None]
) -> None:
    """Balls of a mismatch that changes slowly, half of them with a slope, a third with a stiffness."""
    pairs = []
    for design in designs:
        hand, centre = recurrence(design), float(ratios(design, rng, 1, INSIDE)[0])
        rate = float(np.exp(rng.uniform(np.log(0.1), np.log(300.0)))) / centre
        known = polynomials(hand, centre)
        steep = weight = stiffness = 0.0
        if radius(known.closed) < 1:
            if rng.random() < 0.5:
                steep = float(rng.uniform(0.02, 1.0) / max(most_negative(known.w_to_q, known.closed)[0], 1e-9))
            if rng.random() < 1 / 3:
                # a constant stiffness that the loop bears or nearly does: a pole at one has v = h/ρ0 q
                stiffness = float(centre * design.bandwidth**2 * np.exp(rng.uniform(-3, 0.5)))
                weight = float(stiffness / centre * np.exp(rng.uniform(-1, 3)))
        if weight:
            parts = parts_of(decouple(design.law, design.computation)[0], steep, intersample=True)
            reach = widest(parts, centre, weight, step=rate * PERIOD, stiffness=stiffness)[1]
        else:
            found = ball(design.law, centre, slope=steep, rate=rate, computation_delay=design.computation)
            reach = found.numbers["radius"] if found.certified else 0.0
        tally.count("certified" if reach > 0 else "inconclusive")
        if reach > 0:
            case = Case(hand, centre, reach, steep, weight, rate, stiffness if weight else np.inf)
            pairs.append((design, case))
            wrong = frozen_or_turning(case)
            if wrong:
                tally.violations.append(f"slow {case[1:]}, but {wrong}: {design}")
        advance()
    both = [Adversary(mismatch, SLOPES[i % len(SLOPES)]) for i, mismatch in enumerate(SLOW_MISMATCHES)]
    simulate(pairs, both, rng, tally, steps, within=True, fleet=SlowFleet)


def check_slopes(
    designs: Sequence[Design], rng: np.random.Generator, tally: Tally, steps: int, advance: Callable[[], None]
) -> None:
    """Caps on the gain of TARC from below the circle criterion to beyond the frozen limit, against adversaries."""
    pairs = []
    for design in designs:
        hand, ratio = recurrence(design), float(ratios(design, rng, 1, INSIDE)[0])
        known = polynomials(hand, ratio)
        reach = most_negative(known.w_to_q, known.closed)[0] if radius(known.closed) < 1 else 1e-2
        kappa = float(np.exp(rng.uniform(-0.7, 1.2)) / max(reach, 1e-9))
        robust = replace(design, kappa=kappa, ratio=ratio)
        found = slope(robust.law, ratio, cap=robust.gain, computation_delay=design.computation)
        tally.count(found.verdict)
        if found.witness:
            shown = found.witness["gain [rad/s²]"] * design.margin * design.weight / design.boundary
            size = radius(polynomials(hand, ratio, shown).closed)
            tally.undecided += abs(size - 1) <= 1e-6
            if size < 1 - 1e-6 or shown > kappa * (1 + 1e-9):
                tally.violations.append(f"slope refuted at {shown!r}, but radius {size!r}: {robust}")
        if found.certified:
            pairs.append((robust, Case(hand, ratio, 0.0, kappa)))
            size = max(radius(polynomials(hand, ratio, kappa * share).closed) for share in np.linspace(0, 1, 9))
            if size > 1 + 1e-6 or design.alternates:
                tally.violations.append(f"slope certified, but radius {size!r}: {robust}")
        advance()
    simulate(pairs, [Adversary("none", kind) for kind in SLOPES], rng, tally, steps, within=False)


def simulate(
    pairs: Sequence[tuple[Design, Case]],
    adversaries: Sequence[Adversary],
    rng: np.random.Generator,
    tally: Tally,
    steps: int,
    within: bool,
    fleet: type[Fleet] = Fleet,
) -> None:
    """Certified cases against adversaries: what grows must do so four and sixteen times as long, or was a transient."""
    for start in range(0, len(pairs), 300):
        some = pairs[start : start + 300]
        growth = fleet([case for _, case in some], adversaries, int(rng.integers(2**31))).run(steps, within=within)
        suspects = np.flatnonzero(growth.max(axis=0) > 0.5)
        if not suspects.size:
            continue
        again = fleet([some[i][1] for i in suspects.tolist()], adversaries, 0).run(4 * steps, within=within)
        for i, log in zip(suspects.tolist(), again.T, strict=True):
            design, case = some[i]
            which = adversaries[int(np.argmax(log))]
            if log.max() > EDGE and fleet([case], [which], 0).run(16 * steps, within=within).max() > EDGE:
                tally.violations.append(f"{case[1:]} certified, but {which} makes log growth {log.max():.3g}: {design}")
            elif log.max() > 0.5:
                tally.undecided += 1


def measure(count: int, seed: int = 0, show: bool | None = False, steps: int = STEPS) -> dict[str, Tally]:
    """Tallies of all certificates: so many loops, a quarter as many balls and slopes, an eighth of the other kinds."""
    rng = np.random.default_rng(seed)
    plan = {"loop": count, "loop, a range": count // 8, "ball": count // 4, "slope": count // 4}
    plan |= {"ball, stiffness": count // 8, "ball, slow": count // 8}
    checks = {"ball": check_balls, "slope": check_slopes, "ball, stiffness": check_pairs, "ball, slow": check_slow}
    tallies = {}
    for name, designs in plan.items():
        tally = tallies[name] = Tally()
        begin = time.perf_counter()
        drawn = [draw(rng, name == "slope") for _ in range(designs)]
        with Progress(name, designs, show) as progress:
            if name.startswith("loop"):
                for design in drawn:
                    (check_loop if name == "loop" else check_range)(design, rng, tally)
                    progress.advance()
            else:
                checks[name](drawn, rng, tally, steps, progress.advance)
        tally.seconds = time.perf_counter() - begin
    return tallies


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soundness", description=__doc__)
    parser.add_argument("--designs", type=int, default=10_000, help="random designs (default 10000)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    tallies = measure(options.designs, options.seed, None)
    table = Table(
        "certificate", "designs", "certified", "refuted", "inconclusive", "undecided", "violations", "time [s]"
    )
    for name, tally in tallies.items():
        numbers = (tally.designs, tally.certified, tally.refuted, tally.inconclusive, tally.undecided)
        table.add_row(name, *map(str, numbers), str(len(tally.violations)), f"{tally.seconds:.0f}")
    table.caption = "Undecided: too near the edge for a simulation to tell; counted among the verdicts too."
    console = Console(width=None if Console().is_terminal else 120)
    console.print(table)
    for tally in tallies.values():
        for violation in tally.violations[:20]:
            console.print(violation, style="red", highlight=False)


if __name__ == "__main__":
    main()
