"""Theorem 2 of the paper: Θ > 0, which no gains, delay, window or weights meet, and the vector that shows it.

With the notation of `tarc.paper.check_theorem1`, B̄ = B [K2 0], B̆ = B [0 K2] and J = [0 I], the condition is

        [ Q − Ē − (1+ξ)(h²/β)D    PB̆                    PB̄J  ]
    Θ = [ B̆ᵀP                     (ξ−1)(h²/β)D − F̄      0     ] > 0,
        [ JᵀB̄ᵀP                   0                      JᵀLJ  ]

    Ē = β P B1 (A1 D⁻¹A1ᵀ + B1 D⁻¹B1ᵀ + D⁻¹ + B̄ D⁻¹B̄ᵀ) B1ᵀ P,     F̄ = ((h²/β) D + L) ς∫Ω_1².

As printed it is singular: JᵀLJ is (4n, 4n) of rank 2n. In the reduced form ∫Ω_1 e_h stands for the stacked integral,
and L for JᵀLJ, without J in the corner: size 6n. That form is not positive definite either. With A_b = A + B̆ =
[0 I; −K1 0] and S = PA_b + A_bᵀP, tr(P⁻¹S) = 2 tr A_b = 0. So some e ≠ 0 has eᵀSe ≥ 0, and at (e, −e, 0)

    Θ:  −eᵀSe − 2(h²/β) eᵀDe − eᵀ(Ē + F̄)e < 0.

The proof in the paper gives −PB̆ in place of PB̆; then the vector is (e, e, 0). `tarc.paper.check_nominal_loop` tests a
condition for the nominal loop that can be met.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tarc.certificates.base import Certificate, Evidence, Judgement, Verdict
from tarc.core import validation as check
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.numerics.ball_arithmetic import BALLS, FLOATS, Arithmetic, decide, is_negative_at, is_positive_definite
from tarc.numerics.lmi import Inequalities, solve_lmi
from tarc.numerics.sdp import min_scaled_eigenvalue, symmetric
from tarc.paper.kernel import kernel_energy
from tarc.paper.law_parts import (
    GainPart,
    are_symmetric,
    companion,
    delay_or_default,
    independent_parts,
    lyapunov,
    require_algebraic,
    require_tde,
    time_scale,
    time_transformation,
    window_or_default,
)

if TYPE_CHECKING:
    from tarc.core.validation import Matrix


@dataclass(frozen=True, kw_only=True)
class Theorem2Condition:
    """The numbers of Θ.

    Attributes
    ----------
    delay, window
        h and ς [s].
    degree
        Λ of the estimator.
    beta, xi
        β > 0 and ξ > 1.
    """

    delay: float
    window: float
    degree: int
    beta: float
    xi: float

    def is_valid(self) -> bool:
        """Return whether all numbers are finite and in range."""
        values = (self.delay, self.window, self.beta, self.xi)
        positive_values = min(self.delay, self.window, self.beta) > 0
        return bool(np.all(np.isfinite(values)) and positive_values and self.xi > 1 and 1 <= self.degree <= 6)


@dataclass(frozen=True, kw_only=True, eq=False)
class Theorem2Part(GainPart):
    """Matrices of Θ for joints that are independent of all others.

    Attributes
    ----------
    K1, K2
        Gains, each (n, n).
    P, D, L
        Symmetric positive definite, each (2n, 2n).
    """

    P: Array
    D: Array
    L: Array

    def is_consistent(self) -> bool:
        """Return whether the shapes fit, and P, D and L are symmetric."""
        return self.has_gain_shapes() and are_symmetric(2 * self.n_joints, self.P, self.D, self.L)


@dataclass(frozen=True, kw_only=True, eq=False)
class Theorem2Witness:
    """A vector on which the reduced Θ is negative.

    Attributes
    ----------
    e
        Unit vector, shape (2n,).
    value
        Θ at (e, −e, 0).
    """

    e: Array
    value: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Theorem2Evidence(Evidence):
    """The matrices of Θ.

    Attributes
    ----------
    condition
        Delay, window, degree, β and ξ.
    part
        Matrices of one group of independent joints. If its Θ is not positive definite, the whole Θ is not.
    last_block_size, last_block_rank
        Size 4n and rank 2n of the printed block JᵀLJ for all joints.
    """

    kind: ClassVar[str] = "theorem2"
    witness_type: ClassVar[type[Theorem2Witness]] = Theorem2Witness

    condition: Theorem2Condition
    part: Theorem2Part
    last_block_size: int
    last_block_rank: int

    def judge(self) -> Judgement:
        """Return refuted if ball arithmetic proves Θ negative at a vector, else inconclusive."""
        from scipy.linalg import LinAlgError, eigh

        part, condition = self.part, self.condition
        if not part.is_consistent() or not condition.is_valid():
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        zero = np.zeros_like(part.K1)
        A_b = np.block([[zero, np.eye(len(part.K1))], [-part.K1, zero]])
        try:
            form = theta(part, condition, FLOATS)
            margin = min_scaled_eigenvalue(form)[0]
            e = eigh(symmetric(part.P @ A_b) * 2, part.P)[1][:, -1]
        except LinAlgError:
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        e /= np.linalg.norm(e)
        vector = np.concatenate([e, -e, 0 * e])

        def is_refuted() -> bool:
            sound = all(is_positive_definite(BALLS.matrix(weight)) for weight in (part.P, part.D, part.L))
            return sound and is_negative_at(theta(part, condition, BALLS), vector)

        if not decide(is_refuted):
            return Judgement(Verdict.INCONCLUSIVE, margin)
        return Judgement(Verdict.REFUTED, margin, Theorem2Witness(e=e, value=float(vector @ form @ vector)))

    def forms(self) -> dict[str, Array]:
        """Return the reduced Θ."""
        return {"Θ": theta(self.part, self.condition, FLOATS)}


def check_theorem2(
    law: Law,
    *,
    delay: float | None = None,
    window: float | None = None,
    lyapunov_weight: "Matrix | None" = None,
    D: "Matrix | None" = None,
    L: "Matrix | None" = None,
    beta: float = 1.0,
    xi: float | None = None,
) -> Certificate[Theorem2Evidence]:
    """Return the vector on which Θ of Theorem 2 is negative, for given matrices or the best of a program.

    Groups of joints that the gains and weights do not couple have a Θ each. If one of them is not positive definite,
    the whole is not, so that only one is stored.

    Parameters
    ----------
    law
        A law on time-delay estimation with the estimator `tarc.estimators.Algebraic`, for K1, K2, h, ς and Λ.
    delay, window
        h and ς [s]; None for the law's own.
    lyapunov_weight, D, L
        Q, D and L, each (2n, 2n) symmetric positive definite, one number or 2n. Where all are None, those with the
        largest least eigenvalue of Θ; else 1 for each that is None.
    beta, xi
        β > 0 and ξ > 1; None for ξ = 2 + ς∫Ω_1², for which the block of e_h can be positive.

    Returns
    -------
    Certificate
        Refuted, with the vector (e, −e, 0). There the reduced Θ, and with zeros the printed one, is negative in ball
        arithmetic. The margin is the least eigenvalue of the reduced Θ with its diagonal scaled to one.

    Raises
    ------
    UnsupportedLaw
        For a law without time-delay estimation, or with another estimator.
    InvalidParameter
        For matrices that are not positive definite, β ≤ 0 and ξ ≤ 1.

    References
    ----------
    Paper, Theorem 2, equation (delay value 1).
    """
    law = require_tde(law)
    estimator = require_algebraic(law)
    joints = law.n_joints
    length = window_or_default(estimator, window)
    default_xi = 2 + float(kernel_energy(estimator.degree)) / length**2
    condition = Theorem2Condition(
        delay=delay_or_default(law, delay),
        window=length,
        degree=estimator.degree,
        beta=check.number("beta", beta, 0, strict=True),
        xi=default_xi if xi is None else check.number("xi", xi, 1, strict=True),
    )
    is_searched = lyapunov_weight is None and D is None and L is None
    weights = [
        check.positive_definite(name, 1.0 if weight is None else weight, 2 * joints)
        for name, weight in (("lyapunov_weight", lyapunov_weight), ("D", D), ("L", L))
    ]
    K1, K2, Q, given_D, given_L = independent_parts(law, *weights)[0]
    given_part = Theorem2Part(K1=K1, K2=K2, P=lyapunov(K1, K2, Q), D=given_D, L=given_L)
    evidence = Theorem2Evidence(
        condition=condition,
        part=(_best_part(K1, K2, condition) if is_searched else None) or given_part,
        last_block_size=4 * joints,
        last_block_rank=2 * joints,
    )
    verdict, margin, witness = evidence.judge()
    return Certificate(
        evidence=evidence,
        claim=_claim(condition, is_searched),
        verdict=verdict,
        margin=margin,
        margin_meaning="least eigenvalue of the reduced Θ, its diagonal scaled to one",
        assumptions=ASSUMPTIONS,
        witness=witness,
        problem="Θ = [Q − Ē − (1+ξ)(h²/β)D, PB̆, PB̄; ·, (ξ−1)(h²/β)D − F̄, 0; ·, ·, L] > 0",
        proof_grade=verdict != Verdict.INCONCLUSIVE,
    )


ASSUMPTIONS = (
    "the reduced form, with ∫Ω_1 e_h for the stacked integral; the printed one is singular as well, because its last "
    "block has half the rank of its size",
    "the vector is for the stored P, D, L, but no choice is better: S = PA_b + A_bᵀP with A_b = [0 I; −K1 0] has "
    "tr(P⁻¹S) = 2 tr A_b = 0. So some e has eᵀSe ≥ 0, and there Θ is below −2(h²/β)eᵀDe, for all gains, weights, "
    "delays and windows",
    "it shows that the printed proof of stability fails, not that the loop is unstable",
)


def _claim(condition: Theorem2Condition, is_searched: bool) -> str:
    """Return what is refuted: that some matrices meet the condition, or that the given ones do."""
    numbers = f"h = {condition.delay:g} s, ς = {condition.window:g} s and Λ = {condition.degree}"
    if is_searched:
        return f"Condition Θ > 0 of Theorem 2 can be met for {numbers} by some P, Q, D, L, β, ξ."
    return f"Condition Θ > 0 of Theorem 2 holds for {numbers} and the given weights."


def theta(part: Theorem2Part, condition: Theorem2Condition, arithmetic: Arithmetic) -> Array:
    """Return the reduced Θ, (6n, 6n), in (e, e_h, ∫Ω_1 e_h), with Q = −(AᵀP + PA)."""
    matrices = (part.K1, part.K2, part.P, part.D, part.L)
    K1, K2, P, D, L = (arithmetic.matrix(matrix) for matrix in matrices)
    values = (condition.delay, condition.beta, condition.xi, condition.window)
    h, beta, xi, window = (arithmetic.number(value) for value in values)
    energy = arithmetic.number(kernel_energy(condition.degree)) / (window * window)
    A1, B1 = companion(K1, K2)
    B_bar, B_breve = couplings(K2)
    A = A1 + B1
    D_inverse = arithmetic.inverse(D)
    inner = A1 @ D_inverse @ A1.T + B1 @ D_inverse @ B1.T + D_inverse + B_bar @ D_inverse @ B_bar.T
    E = beta * (P @ B1 @ inner @ B1.T @ P)
    delay_term = h * h / beta * D
    F = (delay_term + L) * energy
    first = -(A.T @ P + P @ A) - E - (1 + xi) * delay_term
    second, third = P @ B_breve, P @ B_bar
    zero = np.zeros_like(P)
    return np.block([[first, second, third], [second.T, (xi - 1) * delay_term - F, zero], [third.T, zero, L]])


def printed_theta(reduced: Array) -> Array:
    """Return Θ as printed, (8n, 8n), from the reduced one: the block JᵀLJ has zeros for ∫Ω_1 e."""
    n = len(reduced) // 6
    kept = np.concatenate([np.arange(4 * n), np.arange(6 * n, 8 * n)])
    result = np.zeros((8 * n, 8 * n))
    result[np.ix_(kept, kept)] = reduced
    return result


def couplings(K2: Array) -> tuple[Array, Array]:
    """Return B̄ = [0 0; K2 0] and B̆ = [0 0; 0 K2]."""
    zero = np.zeros_like(K2)
    return np.block([[zero, zero], [K2, zero]]), np.block([[zero, zero], [zero, K2]])


def _best_part(K1: Array, K2: Array, condition: Theorem2Condition) -> Theorem2Part | None:
    """Return the matrices with the largest least eigenvalue of Θ, in time scaled by ω and with tr P = 2n."""
    omega, size = time_scale(K1), 2 * len(K1)
    h, xi = condition.delay * omega, condition.xi
    energy = float(kernel_energy(condition.degree)) / (condition.window * omega) ** 2
    A1, B1 = companion(K1 / omega**2, K2 / omega)
    B_bar, B_breve = couplings(K2 / omega)
    A = A1 + B1
    # printed with D where units need another weight: the last two factors, and D in F̄, have an additional unit of time
    factors = h * np.hstack([B1 @ A1, B1 @ B1, B1 / omega, B1 @ B_bar / omega])
    zero, wide = np.zeros((size, size)), np.zeros((size, 4 * size))
    slack = np.diag(np.concatenate([np.ones(3 * size), np.zeros(4 * size)]))

    def inequalities(t: Array, P: Array, Y: Array, L: Array) -> Inequalities:
        form = np.block(
            [
                [-(A.T @ P + P @ A) - (1 + xi) * Y, P @ B_breve, P @ B_bar, P @ factors],
                [(P @ B_breve).T, (xi - 1) * Y - (omega**2 * Y + L) * energy, zero, wide],
                [(P @ B_bar).T, zero, L, wide],
                [(P @ factors).T, wide.T, wide.T, np.kron(np.eye(4), Y)],
            ]
        )
        weights = (weight - 1e-6 * np.eye(size) for weight in (P, Y, L))
        return Inequalities(t, [form - t * slack, *weights], [np.trace(P) - size])

    values = solve_lmi([0, size, size, size], inequalities)  # Y = h²D/β
    if values is None:
        return None
    to_seconds = time_transformation(len(K1), 1 / omega)
    scales = (1.0, omega * condition.beta / condition.delay**2, 1 / omega)
    in_seconds = (
        symmetric(scale * to_seconds @ value @ to_seconds) for scale, value in zip(scales, values[1:], strict=True)
    )
    best_P, best_D, best_L = in_seconds
    return Theorem2Part(K1=K1, K2=K2, P=best_P, D=best_D, L=best_L)
