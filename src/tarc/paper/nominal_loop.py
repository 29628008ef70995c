"""Theorem 2 repaired, for the nominal loop: input-to-state stability with a delay and a derivative window.

Theorem 2 of the paper has no solution (see `tarc.paper.check_theorem2`). Its loop, with the delay h, the window ς and
the kernel Ω_1,

    ë1 = −K1 e1(t−h) − K2 ∫_{−ς}^0 Ω_1(ψ) e1(t−h+ψ) dψ + σ′,

has a condition that can be met. By parts ∫Ω_1 e1 = ∫w e2 with e2 = ė1, w(ψ) = −∫_{−ς}^ψ Ω_1 and ∫w = 1. So with
z1 = ∫_{−h}^0 e2(t+θ)dθ, z2 = ∫_{−h−ς}^0 g(θ) ė2(t+θ)dθ and g(θ) = ∫_{−ς}^{min(0, θ+h)} w,

    ė2 = −K1 e1 − K2 e2 + K1 z1 + K2 z2 + σ′.

With G = ∫|g| = h + ς G0, G0 a constant of the degree, and the functional

    V = eᵀPe + ∫_{−h}^0∫_{t+θ}^t e^{2a(s−t)} e2ᵀR1e2 ds dθ + ∫_{−h−ς}^0|g(θ)|∫_{t+θ}^t e^{2a(s−t)} ė2ᵀR2ė2 ds dθ

Jensen's inequality, which with |g| as the weight needs no sign of w, gives V̇ + 2aV ≤ F(e, z1, z2, σ′) + γ²‖σ′‖²,

    F = 2eᵀPė + 2a eᵀPe + h e2ᵀR1e2 + G ė2ᵀR2ė2 − e^{−2ah}/h z1ᵀR1z1 − e^{−2a(h+ς)}/G z2ᵀR2z2 − γ²‖σ′‖².

F grows with G, so any upper bound of G suffices, and F < 0 at one window implies F < 0 at all shorter ones.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tarc.certificates.base import Certificate, Evidence, Judgement, Verdict
from tarc.core import validation as check
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.numerics.ball_arithmetic import BALLS, FLOATS, Arithmetic, decide, is_positive_definite
from tarc.numerics.lmi import Inequalities, solve_lmi
from tarc.numerics.sdp import bisect, max_feasible, min_scaled_eigenvalue, symmetric
from tarc.paper.kernel import lag_area
from tarc.paper.law_parts import (
    GainPart,
    are_symmetric,
    delay_or_default,
    independent_parts,
    largest_certified,
    require_algebraic,
    require_tde,
    time_scale,
    time_transformation,
    window_or_default,
)


@dataclass(frozen=True, kw_only=True)
class NominalLoop:
    """The numbers of the nominal loop.

    Attributes
    ----------
    delay, window
        h and ς [s].
    degree
        Λ of the estimator.
    decay_rate
        a [1/s].
    """

    delay: float
    window: float
    degree: int
    decay_rate: float

    def is_valid(self) -> bool:
        """Return whether all numbers are finite and in range."""
        finite = bool(np.all(np.isfinite([self.delay, self.window, self.decay_rate])))
        return finite and min(self.delay, self.window) > 0 and self.decay_rate >= 0 and 1 <= self.degree <= 6


@dataclass(frozen=True, kw_only=True, eq=False)
class NominalPart(GainPart):
    """The functional V for joints that are independent of all others.

    Attributes
    ----------
    K1, K2
        Gains, each (n, n).
    P, R1, R2
        Symmetric positive definite: (2n, 2n), (n, n) and (n, n).
    """

    P: Array
    R1: Array
    R2: Array

    def is_consistent(self) -> bool:
        """Return whether the shapes fit, and P, R1 and R2 are symmetric."""
        n = self.n_joints
        return self.has_gain_shapes() and are_symmetric(2 * n, self.P) and are_symmetric(n, self.R1, self.R2)


@dataclass(frozen=True, kw_only=True, eq=False)
class NominalEvidence(Evidence):
    """The functional V and the gain γ.

    Attributes
    ----------
    loop
        Delay, window, degree and decay rate.
    parts
        One per group of joints that is independent of the others; empty where the program found none.
    gamma
        γ; None where the program found none.
    mean_square_gain
        γ [s²], without decay: from rest ∫‖e1‖² ≤ γ²∫‖σ′‖². None unless certified.
    peak_gain
        γ/√(2a) [s²], with decay, where P ≥ CᵀC with C = [I 0]: limsup ‖e1‖ is at most this times sup ‖σ′‖. None unless
        certified.
    """

    kind: ClassVar[str] = "nominal"

    loop: NominalLoop
    parts: tuple[NominalPart, ...]
    gamma: float | None
    mean_square_gain: float | None = None
    peak_gain: float | None = None

    def judge(self) -> Judgement:
        """Return the verdict in ball arithmetic; the margin is the least scaled eigenvalue of the first condition."""
        gamma = self.gamma
        if not self.parts or gamma is None or not np.isfinite(gamma) or gamma <= 0 or not self.loop.is_valid():
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        if not all(part.is_consistent() for part in self.parts):
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        margin = min(min_scaled_eigenvalue(conditions(part, self.loop, gamma, FLOATS)[0])[0] for part in self.parts)

        def is_positive(part: NominalPart) -> bool:
            weights = (BALLS.matrix(weight) for weight in (part.P, part.R1, part.R2))
            return all(is_positive_definite(form) for form in (*weights, *conditions(part, self.loop, gamma, BALLS)))

        proven = margin > 0 and all(decide(lambda part=part: is_positive(part)) for part in self.parts)
        return Judgement(Verdict.CERTIFIED if proven else Verdict.INCONCLUSIVE, margin)

    def forms(self) -> dict[str, Array]:
        """Return −F of each part."""
        gamma = self.gamma
        if gamma is None:
            return {}
        return {f"−F, part {i + 1}": conditions(part, self.loop, gamma, FLOATS)[0] for i, part in enumerate(self.parts)}


def check_nominal_loop(
    law: Law, *, window: float | None = None, delay: float | None = None, decay_rate: float = 0.0
) -> Certificate[NominalEvidence]:
    """Certify input-to-state stability of the nominal loop with its delay and its derivative window.

    A semidefinite program finds P, R1, R2 and the least γ². Ball arithmetic then proves the inequality. The cost
    depends on the number of different gains, not on the number of joints.

    Parameters
    ----------
    law
        A law on time-delay estimation with the estimator `tarc.estimators.Algebraic`, for K1, K2, h, ς and Λ.
    window, delay
        ς and h [s]; None for the law's own.
    decay_rate
        a [1/s]. At zero γ is a gain in mean square; above, e decays as e^{−at} where σ′ is zero.

    Returns
    -------
    Certificate
        Certified or inconclusive, because the condition is only sufficient. The margin is the least eigenvalue of the
        negated form with its diagonal scaled to one.

    Raises
    ------
    UnsupportedLaw
        For a law without time-delay estimation, or with another estimator.
    InvalidParameter
        For a window, delay or decay rate out of range.
    """
    law = require_tde(law)
    estimator = require_algebraic(law)
    loop = NominalLoop(
        delay=delay_or_default(law, delay),
        window=window_or_default(estimator, window),
        degree=estimator.degree,
        decay_rate=check.number("decay_rate", decay_rate, 0),
    )
    solutions = [_Program(K1, K2, loop.degree).least_gain(loop) for K1, K2 in independent_parts(law)]
    valid = [solution for solution in solutions if solution is not None]
    evidence = NominalEvidence(loop=loop, parts=(), gamma=None)
    if len(valid) == len(solutions):
        evidence = replace(evidence, parts=tuple(part for part, _ in valid), gamma=max(gamma for _, gamma in valid))
    verdict, margin, _ = evidence.judge()
    if verdict == Verdict.CERTIFIED:
        evidence = _with_gain(evidence)
    return Certificate(
        evidence=evidence,
        claim=_claim(loop),
        verdict=verdict,
        margin=margin,
        margin_meaning="least eigenvalue of the negated form, its diagonal scaled to one",
        assumptions=ASSUMPTIONS,
        problem="2eᵀPė + 2a eᵀPe + h e2ᵀR1e2 + G ė2ᵀR2ė2 − e^{−2ah}/h z1ᵀR1z1 − e^{−2a(h+ς)}/G z2ᵀR2z2 "
        + ("− γ²‖σ′‖² < 0, P > CᵀC" if loop.decay_rate else "+ ‖e1‖² − γ²‖σ′‖² < 0"),
        proof_grade=verdict != Verdict.INCONCLUSIVE,
    )


ASSUMPTIONS = (
    "σ′ is an input of its own. Left out: σ′ holds the TDE error with M⁻¹M̂(q̈_h − q̈̂_h), which depends on the loop's own "
    "state and is of its own order; for the loop that runs use tarc.certificates.certify_constant_ratio",
    "continuous time and the kernel Ω_1 with its sign corrected; no sampling",
    "the switching term, the adaptation and torque limits are left out or count as σ′",
    "sufficient only: where it is inconclusive, the nominal loop may still be stable",
)


def _claim(loop: NominalLoop) -> str:
    decay = f", with decay rate {loop.decay_rate:g} 1/s" if loop.decay_rate else ""
    return (
        f"The nominal loop with h = {loop.delay:g} s, ς = {loop.window:g} s and Λ = {loop.degree} is input-to-state "
        f"stable from σ′ to the error{decay}; this is not stability of the loop that runs."
    )


def _with_gain(evidence: NominalEvidence) -> NominalEvidence:
    """Return certified evidence with its gain from σ′ to e1."""
    gamma, a = evidence.gamma, evidence.loop.decay_rate
    if gamma is None or not a:
        return replace(evidence, mean_square_gain=gamma)
    return replace(evidence, peak_gain=gamma / float(np.sqrt(2 * a)))


def nominal_max_window(law: Law, *, delay: float | None = None, decay_rate: float = 0.0) -> float:
    """Return the largest window ς [s] that `check_nominal_loop` certifies for a law's gains and delay; 0.0 for none.

    With damping ratio 1 and ωn h = 0.01, ωn ς is at most 0.980, 1.240 and 1.263 for Λ = 1, 2, 3.

    Raises
    ------
    UnsupportedLaw, InvalidParameter
        As in `check_nominal_loop`.
    """
    law = require_tde(law)
    h, degree = delay_or_default(law, delay), require_algebraic(law).degree
    a = check.number("decay_rate", decay_rate, 0)
    limit = _max_over_parts(law, lambda window: NominalLoop(delay=h, window=window, degree=degree, decay_rate=a))
    return largest_certified(
        limit, lambda window: check_nominal_loop(law, delay=h, window=window, decay_rate=a).certified
    )


def nominal_max_delay(law: Law, *, window: float | None = None, decay_rate: float = 0.0) -> float:
    """Return the largest delay h [s] that `check_nominal_loop` certifies for a law's gains and window; 0.0 for none.

    Raises
    ------
    UnsupportedLaw, InvalidParameter
        As in `check_nominal_loop`.
    """
    law = require_tde(law)
    estimator = require_algebraic(law)
    length, degree = window_or_default(estimator, window), estimator.degree
    a = check.number("decay_rate", decay_rate, 0)
    limit = _max_over_parts(law, lambda h: NominalLoop(delay=h, window=length, degree=degree, decay_rate=a))
    return largest_certified(limit, lambda h: check_nominal_loop(law, delay=h, window=length, decay_rate=a).certified)


def _max_over_parts(law: Law, loop_at: Callable[[float], NominalLoop]) -> float:
    """Return the largest window or delay [s] that is feasible for all independent parts."""
    loop = loop_at(1.0)
    return min(_Program(K1, K2, loop.degree).max_value(loop_at) for K1, K2 in independent_parts(require_tde(law)))


def negated_form(part: NominalPart, loop: NominalLoop, gamma: float, arithmetic: Arithmetic) -> Array:
    """Return −F, (5n, 5n), in (e1, e2, z1, z2, σ′)."""
    matrices = (part.K1, part.K2, part.P, part.R1, part.R2)
    K1, K2, P, R1, R2 = (arithmetic.matrix(matrix) for matrix in matrices)
    values = (loop.delay, loop.window, loop.decay_rate, gamma)
    h, window, a, gamma_value = (arithmetic.number(value) for value in values)
    G = h + window * arithmetic.number(lag_area(loop.degree))
    e1, e2, z1, z2, disturbance = arithmetic.matrix(np.eye(5 * len(K1))).reshape(5, len(K1), -1)
    e2_rate = -K1 @ e1 - K2 @ e2 + K1 @ z1 + K2 @ z2 + disturbance
    e, e_rate = np.concatenate([e1, e2]), np.concatenate([e2, e2_rate])
    power = e.T @ P @ e_rate
    F = (
        power
        + power.T
        + 2 * a * (e.T @ P @ e)
        + h * (e2.T @ R1 @ e2)
        + G * (e2_rate.T @ R2 @ e2_rate)
        - arithmetic.exp(-2 * a * h) / h * (z1.T @ R1 @ z1)
        - arithmetic.exp(-2 * a * (h + window)) / G * (z2.T @ R2 @ z2)
        - gamma_value * gamma_value * (disturbance.T @ disturbance)
    )
    return -F


def conditions(part: NominalPart, loop: NominalLoop, gamma: float, arithmetic: Arithmetic) -> tuple[Array, Array]:
    """Return −F and P, which must be positive definite, less CᵀC: from −F without decay, from P with it."""
    negated, P = negated_form(part, loop, gamma, arithmetic), arithmetic.matrix(part.P)
    if loop.decay_rate:
        return negated, P - _squared_position(part.n_joints, len(P), arithmetic)
    return negated - _squared_position(part.n_joints, len(negated), arithmetic), P


def _squared_position(n: int, size: int, arithmetic: Arithmetic) -> Array:
    """Return the form of ‖e1‖², (size, size)."""
    return arithmetic.matrix(np.diag(np.arange(size) < n).astype(float))


class _Program:
    """The semidefinite programs of one part, in time scaled by ω, with R1/h and R2/G as unknowns.

    The central solution maximises the distance from F = 0 (without σ′) at tr P = 2n; that on the boundary minimises γ².
    """

    def __init__(self, K1: Array, K2: Array, degree: int) -> None:
        self.K1, self.K2, self.omega = K1, K2, time_scale(K1)
        self.area = float(lag_area(degree))

    def _scaled_form(self, loop: NominalLoop, P: Array, S1: Array, S2: Array) -> Array:
        """Return F without γ in scaled time, from P, R1/h and R2/G."""
        n, k1, k2 = len(self.K1), self.K1 / self.omega**2, self.K2 / self.omega
        h, window, a = loop.delay, loop.window, loop.decay_rate
        e1, e2, z1, z2, disturbance = np.eye(5 * n).reshape(5, n, 5 * n)
        e2_rate = -k1 @ e1 - k2 @ e2 + k1 @ z1 + k2 @ z2 + disturbance
        e, e_rate = np.concatenate([e1, e2]), np.concatenate([e2, e2_rate])
        power = e.T @ P @ e_rate
        return (
            power
            + power.T
            + 2 * a / self.omega * (e.T @ P @ e)
            + (self.omega * h) ** 2 * (e2.T @ S1 @ e2)
            + (self.omega * (h + window * self.area)) ** 2 * (e2_rate.T @ S2 @ e2_rate)
            - np.exp(-2 * a * h) * (z1.T @ S1 @ z1)
            - np.exp(-2 * a * (h + window)) * (z2.T @ S2 @ z2)
        )

    def central_solution(self, loop: NominalLoop) -> list[Array] | None:
        """Return P, R1/h, R2/G in scaled time, as far from F = 0 as possible."""
        n = len(self.K1)

        def inequalities(t: Array, P: Array, S1: Array, S2: Array) -> Inequalities:
            free = -self._scaled_form(loop, P, S1, S2)[: 4 * n, : 4 * n]
            return Inequalities(t, [free - t * np.eye(4 * n), P - t * np.eye(2 * n)], [np.trace(P) - 2 * n])

        values = solve_lmi([0, 2 * n, n, n], inequalities)
        return None if values is None else values[1:]

    def _boundary_solution(self, loop: NominalLoop) -> list[Array] | None:
        """Return γ² and P, R1/h, R2/G in scaled time, with the least γ²."""
        n = len(self.K1)
        disturbance, position = np.diag(np.arange(5 * n) >= 4 * n), np.diag((np.arange(5 * n) < n).astype(float))

        def inequalities(gamma_squared: Array, P: Array, S1: Array, S2: Array) -> Inequalities:
            negated = gamma_squared * disturbance - self._scaled_form(loop, P, S1, S2)
            inner = position[: 2 * n, : 2 * n]
            positive = [negated, P - inner] if loop.decay_rate else [negated - position, P]
            return Inequalities(-gamma_squared, [*positive, np.reshape(gamma_squared, (1, 1))])

        return solve_lmi([0, 2 * n, n, n], inequalities)

    def least_gain(self, loop: NominalLoop) -> tuple[NominalPart, float] | None:
        """Return the part and its γ, or None.

        The least γ² lies on the boundary of the feasible set. The result is the first point strictly inside on the
        way from there to a central point.
        """
        central = self.central_solution(loop)
        if central is None:
            return None
        inner = self._normalised(self._part(central, loop), loop)
        if inner is None:
            return None
        boundary = self._boundary_solution(loop)
        if boundary is None:
            return inner
        scale = 1.0 if loop.decay_rate else 1 / self.omega
        outer = self._part(boundary[1:], loop, scale)
        outer_square = float(boundary[0]) * scale / self.omega**3
        for share in (1e-4, 1e-3, 1e-2, 1e-1):
            part = _mix(outer, inner[0], share)
            gamma = float(np.sqrt((1 - share) * outer_square + share * inner[1] ** 2))
            if min(min_scaled_eigenvalue(form)[0] for form in conditions(part, loop, gamma, FLOATS)) > 1e-9:
                return part, gamma
        return inner

    def max_value(self, loop_at: Callable[[float], NominalLoop]) -> float:
        """Return the largest window or delay [s] for which a solution is valid."""
        inside = slice(4 * len(self.K1))

        def max_valid(solution: list[Array]) -> float:
            def is_valid(value: float) -> bool:
                loop = loop_at(value)
                form = negated_form(self._part(solution, loop), loop, 0.0, FLOATS)
                return min_scaled_eigenvalue(form[inside, inside])[0] > 1e-9

            return bisect(is_valid, 1e-9 / self.omega, 100 / self.omega)

        return max_feasible(lambda value: self.central_solution(loop_at(value)), max_valid, 1e-3 / self.omega)

    def _part(self, solution: list[Array], loop: NominalLoop, scale: float = 1.0) -> NominalPart:
        """Return P, R1, R2 of a solution, in seconds."""
        P, S1, S2 = solution
        to_seconds = time_transformation(len(S1), 1 / self.omega)
        h, G = loop.delay, loop.delay + loop.window * self.area
        return NominalPart(
            K1=self.K1,
            K2=self.K2,
            P=symmetric(scale * (to_seconds @ P @ to_seconds)),
            R1=symmetric(scale * (self.omega * h * S1)),
            R2=symmetric(scale * (G / self.omega * S2)),
        )

    def _normalised(self, part: NominalPart, loop: NominalLoop) -> tuple[NominalPart, float] | None:
        """Return the part scaled so that ‖e1‖² takes half of it, and its γ by a Schur complement.

        None where F is not negative without σ′.
        """
        from scipy.linalg import LinAlgError, eigh

        n = len(part.K1)
        form = negated_form(part, loop, 0.0, FLOATS)
        inside, cross, own = form[: 4 * n, : 4 * n], form[: 4 * n, 4 * n :], form[4 * n :, 4 * n :]
        try:
            shares = [
                eigh(_squared_position(n, len(matrix), FLOATS), matrix, eigvals_only=True)[-1]
                for matrix in (inside, part.P)
            ]
        except LinAlgError:
            return None
        scale = 2 * max(shares)
        square = scale * np.linalg.eigvalsh(2 * cross.T @ np.linalg.solve(inside, cross) - own)[-1]
        scaled = replace(part, P=scale * part.P, R1=scale * part.R1, R2=scale * part.R2)
        return scaled, float(np.sqrt(1.01 * square))


def _mix(outer: NominalPart, inner: NominalPart, share: float) -> NominalPart:
    """Return the part between two, with a share of the inner one."""

    def between(outer_weight: Array, inner_weight: Array) -> Array:
        return symmetric((1 - share) * outer_weight + share * inner_weight)

    return replace(inner, P=between(outer.P, inner.P), R1=between(outer.R1, inner.R1), R2=between(outer.R2, inner.R2))
