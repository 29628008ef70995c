"""Theorem 1 of the paper: Ψ > 0, a condition on the gains and the delay of time-delayed control.

The nominal error is ė = A1 e + B1 e_h + B σ1, with e = [e1; ė1], A1 = [0 I; 0 0], B1 = [0 0; −K1 −K2], B = [0; I] and
A = A1 + B1. With AᵀP + PA = −Q the two blocks of Ψ depend on D/β only,

    Ψ1 = Q − E − (1+ξ)(h²/β) D,     Ψ2 = (ξ−1)(h²/β) D,
    E = β P B1 (A1 D⁻¹A1ᵀ + B1 D⁻¹B1ᵀ + D⁻¹) B1ᵀ P.

The last D⁻¹ comes from the cross term 2eᵀPB1∫Bσ1. That term is linear in e, so it may stay with the other linear term.
The condition is then easier to meet, and does not depend on the unit of time. As printed it does: D⁻¹ counts for more
the slower the loop is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tarc.certificates.base import Certificate, Evidence, Judgement, Verdict
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.numerics.ball_arithmetic import BALLS, FLOATS, Arithmetic, decide, is_negative_at, is_positive_definite
from tarc.numerics.lmi import Inequalities, solve_lmi
from tarc.numerics.sdp import bisect, max_feasible, min_scaled_eigenvalue, symmetric
from tarc.paper.law_parts import (
    GainPart,
    are_symmetric,
    companion,
    delay_or_default,
    independent_parts,
    largest_certified,
    lyapunov,
    require_tde,
    time_scale,
    time_transformation,
)

if TYPE_CHECKING:
    from tarc.core.validation import Matrix


@dataclass(frozen=True, kw_only=True)
class Theorem1Condition:
    """The numbers of Ψ that all parts share.

    Attributes
    ----------
    delay
        h [s].
    beta, xi
        β > 0 and ξ > 1.
    disturbance_term
        Whether E contains its last D⁻¹, as printed.
    """

    delay: float
    beta: float
    xi: float
    disturbance_term: bool

    def is_valid(self) -> bool:
        """Return whether all numbers are finite and in range."""
        finite = all(np.isfinite(value) for value in (self.delay, self.beta, self.xi))
        return finite and self.delay > 0 and self.beta > 0 and self.xi > 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Theorem1Part(GainPart):
    """Matrices of Ψ for joints that are independent of all others.

    Attributes
    ----------
    K1, K2
        Gains, each (n, n).
    P, D
        Symmetric positive definite, each (2n, 2n).
    """

    P: Array
    D: Array

    def is_consistent(self) -> bool:
        """Return whether the shapes fit, and P and D are symmetric."""
        return self.has_gain_shapes() and are_symmetric(2 * self.n_joints, self.P, self.D)


@dataclass(frozen=True, kw_only=True, eq=False)
class Theorem1Witness:
    """A vector on which Ψ1 is negative.

    Attributes
    ----------
    e
        Unit vector, shape (2n,).
    value
        eᵀΨ1e.
    """

    e: Array
    value: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Theorem1Evidence(Evidence):
    """The matrices of Ψ.

    Attributes
    ----------
    condition
        Delay, β and ξ.
    parts
        One per group of joints that is independent of the others; empty where the program found no matrices.
    """

    kind: ClassVar[str] = "theorem1"
    witness_type: ClassVar[type[Theorem1Witness]] = Theorem1Witness

    condition: Theorem1Condition
    parts: tuple[Theorem1Part, ...]

    def judge(self) -> Judgement:
        """Return the verdict in ball arithmetic; the margin is the least scaled eigenvalue of Ψ1."""
        consistent = all(part.is_consistent() for part in self.parts)
        if not self.parts or not consistent or not self.condition.is_valid():
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        try:
            eigenpairs = [min_scaled_eigenvalue(psi(part, self.condition, FLOATS)[0]) for part in self.parts]
        except np.linalg.LinAlgError:
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        worst = int(np.argmin([value for value, _ in eigenpairs]))
        margin, vector = eigenpairs[worst]
        if margin > 0 and all(decide(lambda part=part: self._is_positive(part)) for part in self.parts):
            return Judgement(Verdict.CERTIFIED, margin)
        weights = [weight for part in self.parts for weight in (part.P, part.D)]
        sound = all(decide(lambda weight=weight: is_positive_definite(BALLS.matrix(weight))) for weight in weights)
        part = self.parts[worst]
        if sound and decide(lambda: is_negative_at(psi(part, self.condition, BALLS)[0], vector)):
            value = float(vector @ psi(part, self.condition, FLOATS)[0] @ vector)
            return Judgement(Verdict.REFUTED, margin, Theorem1Witness(e=vector, value=value))
        return Judgement(Verdict.INCONCLUSIVE, margin)

    def forms(self) -> dict[str, Array]:
        """Return Ψ1 and Ψ2 of each part."""
        return {
            f"{name}, part {i + 1}": block
            for i, part in enumerate(self.parts)
            for name, block in zip(("Ψ1", "Ψ2"), psi(part, self.condition, FLOATS), strict=True)
        }

    def _is_positive(self, part: Theorem1Part) -> bool:
        weights = (BALLS.matrix(part.P), BALLS.matrix(part.D))
        return all(is_positive_definite(form) for form in (*weights, *psi(part, self.condition, BALLS)))


def check_theorem1(
    law: Law,
    *,
    delay: float | None = None,
    lyapunov_weight: "Matrix | None" = None,
    D: "Matrix | None" = None,
    beta: float | None = None,
    xi: float | None = None,
    disturbance_term: bool = True,
) -> Certificate[Theorem1Evidence]:
    """Test Ψ > 0 of Theorem 1, for given matrices or for those that a semidefinite program finds.

    For fixed gains and delay a Schur complement of E makes Ψ > 0 a linear matrix inequality in P and D/β as ξ → 1.
    The point that the program finds gets a ξ > 1 from its slack. Both blocks of Ψ are then proven positive definite in
    ball arithmetic. The cost depends on the number of different gains, not on the number of joints.

    Parameters
    ----------
    law
        A law on time-delay estimation, for K1, K2 and h.
    delay
        h [s]; None for the law's own.
    lyapunov_weight
        Q, (2n, 2n) symmetric positive definite, one number or 2n; None to find it together with D.
    D
        (2n, 2n) symmetric positive definite, one number or 2n; None to find it. Needs the Lyapunov weight.
    beta, xi
        β > 0 and ξ > 1, with D only; None for β = 1 and for a quarter of the slack of ξ.
    disturbance_term
        Keep the last D⁻¹ of E, as printed.

    Returns
    -------
    Certificate
        For given matrices certified, or refuted with a vector on which Ψ1 is negative. Otherwise certified or
        inconclusive, because a failed search does not show that the loop is unstable. The margin is the least
        eigenvalue of Ψ1 with its diagonal scaled to one.

    Raises
    ------
    UnsupportedLaw
        For a law without time-delay estimation.
    InvalidParameter
        For matrices that are not positive definite, D without a Lyapunov weight, β ≤ 0 and ξ ≤ 1.

    References
    ----------
    Paper, Theorem 1, equation (delay value).
    """
    if D is None and (beta is not None or xi is not None):
        raise InvalidParameter(
            "beta, xi: given without D; they are found together with D, so give D as well, or neither"
        )
    if D is not None and lyapunov_weight is None:
        raise InvalidParameter(
            "lyapunov_weight: missing; a given D needs the weight Q of the Lyapunov equation as well"
        )
    law = require_tde(law)
    condition = Theorem1Condition(
        delay=delay_or_default(law, delay),
        beta=1.0 if beta is None else check.number("beta", beta, 0, strict=True),
        xi=1.01 if xi is None else check.number("xi", xi, 1, strict=True),
        disturbance_term=disturbance_term,
    )
    given = [
        check.positive_definite(name, weight, 2 * law.n_joints)
        for name, weight in (("lyapunov_weight", lyapunov_weight), ("D", D))
        if weight is not None
    ]
    parts = _find_parts(independent_parts(law, *given), condition)
    if parts and xi is None:
        condition = replace(condition, xi=_xi_from_slack(parts, condition))
    evidence = Theorem1Evidence(condition=condition, parts=parts)
    verdict, margin, witness = evidence.judge()
    if D is None and verdict == Verdict.REFUTED:  # a failed candidate of the program shows nothing
        evidence = Theorem1Evidence(condition=condition, parts=())
        verdict, margin, witness = evidence.judge()
    return Certificate(
        evidence=evidence,
        claim=_claim(condition, lyapunov_weight is not None, D is not None),
        verdict=verdict,
        margin=margin,
        margin_meaning="least eigenvalue of Ψ1, its diagonal scaled to one",
        assumptions=_assumptions(condition, bool(given)),
        witness=witness,
        problem="Ψ = diag(Q − E − (1+ξ)(h²/β)D, (ξ−1)(h²/β)D) > 0",
        proof_grade=verdict != Verdict.INCONCLUSIVE,
    )


def theorem1_max_delay(law: Law, *, disturbance_term: bool = True) -> float:
    """Return the largest delay h [s] that Theorem 1 certifies for the gains of a law, to a millionth; 0.0 for none.

    With damping ratio 1 and natural frequency 1 rad/s: 0.2454 s as printed, 0.2708 s without the D⁻¹ term. The latter
    times ωn is the same for all natural frequencies. The exact margin of ė = A1 e + B1 e_h is 0.6474/ωn.

    Raises
    ------
    UnsupportedLaw
        For a law without time-delay estimation.
    """
    parts = independent_parts(require_tde(law))
    limit = min(_Program(K1, K2, None, disturbance_term).max_delay() for K1, K2 in parts)
    return largest_certified(
        limit, lambda delay: check_theorem1(law, delay=delay, disturbance_term=disturbance_term).certified
    )


def psi(part: Theorem1Part, condition: Theorem1Condition, arithmetic: Arithmetic) -> tuple[Array, Array]:
    """Return the blocks Ψ1 and Ψ2, each (2n, 2n), with Q = −(AᵀP + PA)."""
    K1, K2, P, D = (arithmetic.matrix(matrix) for matrix in (part.K1, part.K2, part.P, part.D))
    h, beta, xi = (arithmetic.number(value) for value in (condition.delay, condition.beta, condition.xi))
    A1, B1 = companion(K1, K2)
    A = A1 + B1
    D_inverse = arithmetic.inverse(D)
    inner = A1 @ D_inverse @ A1.T + B1 @ D_inverse @ B1.T
    if condition.disturbance_term:
        inner = inner + D_inverse
    E = beta * (P @ B1 @ inner @ B1.T @ P)
    delay_term = h * h / beta * D
    return -(A.T @ P + P @ A) - E - (1 + xi) * delay_term, (xi - 1) * delay_term


def _claim(condition: Theorem1Condition, has_weight: bool, has_D: bool) -> str:
    """Return what is tested: the condition at the given matrices, or that some matrices exist."""
    if has_D:
        numbers = f"h = {condition.delay:g} s, the given Q and D and ξ = {condition.xi:g}."
    else:
        matrices = "the given Q and some D" if has_weight else "some P, Q, D"
        numbers = f"h = {condition.delay:g} s and {matrices}: the nominal error of time-delayed control is ultimately "
        numbers += "bounded."
    return f"Condition Ψ > 0 of Theorem 1 holds for {numbers}"


def _assumptions(condition: Theorem1Condition, has_weight: bool) -> tuple[str, ...]:
    term = (
        "E has its last D⁻¹, as printed"
        if condition.disturbance_term
        else "E is without its last D⁻¹: its cross term is linear in e, and counts in the ultimate bound"
    )
    return (
        "‖σ1‖ ≤ c for all time; σ1 holds terms in the state even under perfect time-delay estimation, so this is "
        "a condition and no consequence",
        "the nominal equation ė = A1 e + B1 e_h + B σ1 in continuous time with true derivatives; neither the "
        "sampled loop nor its estimator",
        "sufficient only: where it fails, the equation may still be stable",
        "Q is −(AᵀP + PA) for the stored P" + (", the given one to rounding" if has_weight else ""),
        term,
    )


def _find_parts(gain_parts: Sequence[tuple[Array, ...]], condition: Theorem1Condition) -> tuple[Theorem1Part, ...]:
    """Return P and D for each (K1, K2), (K1, K2, Q) or (K1, K2, Q, D); empty where the program finds none."""
    parts = []
    for K1, K2, *weights in gain_parts:
        P = lyapunov(K1, K2, weights[0]) if weights else None
        if P is not None and len(weights) == 2:
            parts.append(Theorem1Part(K1=K1, K2=K2, P=P, D=weights[1]))
            continue
        part = _Program(K1, K2, P, condition.disturbance_term).part(condition.delay)
        if part is None:
            return ()
        parts.append(part)
    return tuple(parts)


def _xi_from_slack(parts: Sequence[Theorem1Part], condition: Theorem1Condition) -> float:
    """Return 1 plus a quarter of the slack of ξ, so that both blocks are positive definite."""
    from scipy.linalg import LinAlgError, eigh

    slack = np.inf
    for part in parts:
        try:
            first, _ = psi(part, replace(condition, xi=1.0), FLOATS)
            delay_term = condition.delay**2 / condition.beta * part.D
            slack = min(slack, eigh(first, delay_term, eigvals_only=True)[0])
        except LinAlgError:
            return condition.xi
    return float(1 + slack / 4) if slack > 0 else condition.xi


class _Program:
    """The semidefinite program of one part, in time scaled by ω: max t with Ψ1's Schur form ≥ t at ξ = 1, tr P = 2n.

    The unknowns are P and Y = 2h²D/β, so that nothing grows as h → 0. The delay enters through r = √2 h only. A given
    P is scaled likewise.
    """

    def __init__(self, K1: Array, K2: Array, P: Array | None, disturbance_term: bool) -> None:
        n = len(K1)
        self.K1, self.K2, self.disturbance_term = K1, K2, disturbance_term
        self.omega = time_scale(K1)
        self.to_seconds = time_transformation(n, 1 / self.omega)
        A1, B1 = companion(K1 / self.omega**2, K2 / self.omega)
        self.A = A1 + B1
        # the last factor has a unit of time that the others do not have
        self.factors = np.hstack([B1 @ A1, B1 @ B1, *([B1 / self.omega] if disturbance_term else [])])
        self.P, self.P_norm = None, 1.0
        if P is not None:
            from_seconds = time_transformation(n, self.omega)
            scaled = from_seconds @ P @ from_seconds
            self.P_norm = float(np.linalg.norm(scaled, 2))
            self.P = scaled / self.P_norm

    def _inequalities(self, r: float, t: Array, Y: Array, P: Array) -> Inequalities:
        """Return what t, Y and P must satisfy for r = √2 h."""
        corner, copies = r * (P @ self.factors), self.factors.shape[1] // len(P)
        head = -(self.A.T @ P + P @ self.A) - Y
        form = np.block([[head, corner], [corner.T, np.kron(np.eye(copies), Y)]])
        # Y reduces Ψ1, so it needs no more slack than the delay requires
        slack = np.where(np.arange(len(form)) < len(P), t, r * t)
        trace = [np.trace(P) - len(P)] if self.P is None else []
        return Inequalities(t, [form - np.diag(slack)], trace)

    def solution(self, h: float) -> tuple[Array, Array] | None:
        """Return P and Y for a delay [s], in seconds."""
        r, size = np.sqrt(2) * h * self.omega, len(self.A)
        given = () if self.P is None else (self.P,)
        values = solve_lmi([0, size, *([] if given else [size])], lambda *x: self._inequalities(r, *x, *given))
        if values is None:
            return None
        P, Y = (symmetric(self.to_seconds @ value @ self.to_seconds) for value in ((*values, *given)[2], values[1]))
        return self.P_norm * P, self.P_norm * self.omega * Y

    def part(self, h: float) -> Theorem1Part | None:
        """Return the part with P and D, for β = 1 and a delay [s]."""
        solution = self.solution(h)
        return None if solution is None else self._part(*solution, h)

    def max_delay(self) -> float:
        """Return the largest delay [s] for which a solution is valid."""

        def max_valid(solution: tuple[Array, Array]) -> float:
            def is_valid(h: float) -> bool:
                condition = Theorem1Condition(delay=h, beta=1.0, xi=1.0, disturbance_term=self.disturbance_term)
                return min_scaled_eigenvalue(psi(self._part(*solution, h), condition, FLOATS)[0])[0] > 1e-9

            return bisect(is_valid, 1e-9 / self.omega, 10 / self.omega)

        return max_feasible(self.solution, max_valid, 1e-3 / self.omega)

    def _part(self, P: Array, Y: Array, h: float) -> Theorem1Part:
        return Theorem1Part(K1=self.K1, K2=self.K2, P=P, D=Y / (2 * h**2))
