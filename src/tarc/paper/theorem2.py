"""Theorem 2 of the paper: Θ > 0, which no gains, delay, window or weights meet; and the vector that shows it.

With the notation of `tarc.paper.check_theorem1`, B̄ = B [K2 0], B̆ = B [0 K2] and J = [0 I], the condition is

        [ Q − Ē − (1+ξ)(h²/β)D    PB̆                    PB̄J  ]
    Θ = [ B̆ᵀP                     (ξ−1)(h²/β)D − F̄      0     ] > 0,
        [ JᵀB̄ᵀP                   0                      JᵀLJ  ]

    Ē = β P B1 (A1 D⁻¹A1ᵀ + B1 D⁻¹B1ᵀ + D⁻¹ + B̄ D⁻¹B̄ᵀ) B1ᵀ P,     F̄ = ((h²/β) D + L) ς∫Ω_1².

As printed it is singular: JᵀLJ is (4n, 4n) of rank 2n. In the reduced form ∫Ω_1 e_h stands for the stacked integral and
L for JᵀLJ, J in the corner left out: size 6n. That is not positive definite either. With A_b = A + B̆ = [0 I; −K1 0] and
S = PA_b + A_bᵀP, tr(P⁻¹S) = 2 tr A_b = 0, so that some e ≠ 0 has eᵀSe ≥ 0, and at (e, −e, 0)

    Θ:  −eᵀSe − 2(h²/β) eᵀDe − eᵀ(Ē + F̄)e < 0.

The proof in the paper gives −PB̆ in place of PB̆; then it is (e, e, 0). For the nominal loop there is a condition that
can be met, in `tarc.paper.check_nominal_loop`.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.analysis.stability import Witness
from tarc.certificates.base import FORMS, JUDGES, Certificate, dict_certificate
from tarc.core import validation as check
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.numerics.ball_arithmetic import BALLS, FLOATS, Arithmetic, negative_at, positive, prove
from tarc.numerics.sdp import least, solve, symmetric
from tarc.paper.kernel import kernel_energy
from tarc.paper.law_parts import companion, delay_of, delayed, gains, gather, lyapunov, rate, store, stretch, windowed

if TYPE_CHECKING:
    from tarc.core.validation import Matrix


NAMES = ("K1", "K2", "P", "D", "L")
SHAPES = {"K1": (1, 1), "K2": (1, 1), "P": (2, 2), "D": (2, 2), "L": (2, 2)}


def check_theorem2(
    law: Law,
    *,
    delay: float | None = None,
    window: float | None = None,
    weight: "Matrix | None" = None,
    D: "Matrix | None" = None,
    L: "Matrix | None" = None,
    beta: float = 1.0,
    xi: float | None = None,
) -> Certificate:
    """Theorem 2: the vector on which Θ is negative, for given numbers or the best that a semidefinite program finds.

    Joints that the gains and weights do not couple have a Θ each; one that is not positive definite is enough, and only
    that is stored.

    Parameters
    ----------
    law
        A law on time-delay estimation with the estimator `tarc.estimators.Algebraic`, for K1, K2, h, ς and Λ.
    delay, window
        h and ς [s]; None for the law's own.
    weight, D, L
        Q, D and L, each (2n, 2n) symmetric positive definite, one number or 2n. Where all are None, those that make
        the least eigenvalue of Θ largest; else 1 for each that is None.
    beta, xi
        β > 0 and ξ > 1; None for ξ = 2 + ς∫Ω_1², for which the block of e_h can be positive.

    Returns
    -------
    Certificate
        Refuted, with the vector (e, −e, 0) on which the reduced Θ, and with zeros the printed one, is negative in ball
        arithmetic. Its margin is the least eigenvalue of the reduced Θ once its diagonal is scaled to one. Its numbers
        tell the size and the rank of the printed JᵀLJ.

    Raises
    ------
    TarcError
        For another estimator, weights that are not positive definite, β ≤ 0, ξ ≤ 1.

    References
    ----------
    Paper, Theorem 2, equation (delay value 1).
    """
    law = delayed(law)
    estimator = windowed(law)
    joints = law.n_joints
    length = estimator.window if window is None else check.number("window", window, 0, strict=True)
    easy = 2 + float(kernel_energy(estimator.degree)) / length**2
    numbers = {
        "delay": delay_of(law, delay),
        "window": length,
        "degree": float(estimator.degree),
        "beta": check.number("beta", beta, 0, strict=True),
        "xi": easy if xi is None else check.number("xi", xi, 1, strict=True),
        "size of JᵀLJ": 4.0 * joints,
        "rank of JᵀLJ": 2.0 * joints,
    }
    searched = weight is None and D is None and L is None
    weights = [
        check.positive_definite(name, 1.0 if one is None else one, 2 * joints)
        for name, one in (("weight", weight), ("D", D), ("L", L))
    ]
    K1, K2, Q, *rest = gains(law, *weights)[0]
    part = (_favourable(K1, K2, numbers) if searched else None) or (K1, K2, lyapunov(K1, K2, Q), *rest)
    matrices = store([part], NAMES)
    verdict, margin, witness = judge(matrices, numbers)
    at = f"h = {numbers['delay']:g} s, ς = {length:g} s and Λ = {estimator.degree}"
    return dict_certificate(
        kind="theorem2",
        claim=f"Condition Θ > 0 of Theorem 2 can be met for {at} by some P, Q, D, L, β, ξ."
        if searched
        else f"Condition Θ > 0 of Theorem 2 holds for {at} and the given weights.",
        verdict=verdict,
        margin=margin,
        margin_meaning="least eigenvalue of the reduced Θ, its diagonal scaled to one",
        assumptions=(
            "the reduced form, with ∫Ω_1 e_h for the stacked integral; the printed one is singular besides, for its "
            "last block has half the rank of its size",
            "the vector is for the stored P, D, L, but no choice is better: S = PA_b + A_bᵀP with A_b = [0 I; −K1 0] "
            "has tr(P⁻¹S) = 2 tr A_b = 0, so that some e has eᵀSe ≥ 0, and there Θ is below −2(h²/β)eᵀDe, whatever the "
            "gains, weights, delay and window",
            "it says that the printed proof of stability is none, not that the loop is unstable",
        ),
        matrices=matrices,
        numbers=numbers,
        witness=witness,
        problem="Θ = [Q − Ē − (1+ξ)(h²/β)D, PB̆, PB̄; ·, (ξ−1)(h²/β)D − F̄, 0; ·, ·, L] > 0",
        proof_grade=verdict != "inconclusive",
    )


def theta(part: tuple[Array, ...], numbers: dict[str, Any], kit: Arithmetic) -> Array:
    """The reduced Θ, shape (6n, 6n), in (e, e_h, ∫Ω_1 e_h), at K1, K2, P, D, L, with Q = −(AᵀP + PA)."""
    K1, K2, P, D, L = (kit.matrix(one) for one in part)
    h, beta, xi, window = (kit.number(numbers[name]) for name in ("delay", "beta", "xi", "window"))
    energy = kit.number(kernel_energy(int(numbers["degree"]))) / (window * window)
    A1, B1, B_bar, B_breve = (*companion(K1, K2), *couplings(K2))
    A = A1 + B1
    inverse = kit.inverse(D)
    inner = A1 @ inverse @ A1.T + B1 @ inverse @ B1.T + inverse + B_bar @ inverse @ B_bar.T
    E = beta * (P @ B1 @ inner @ B1.T @ P)
    slope = h * h / beta * D
    F = (slope + L) * energy
    first, second, third = -(A.T @ P + P @ A) - E - (1 + xi) * slope, P @ B_breve, P @ B_bar
    none = np.zeros_like(P)
    return np.block([[first, second, third], [second.T, (xi - 1) * slope - F, none], [third.T, none, L]])


def printed(theta: Array) -> Array:
    """Θ as printed, shape (8n, 8n), from the reduced one: the block JᵀLJ has zeros for ∫Ω_1 e."""
    n = len(theta) // 6
    keep = np.concatenate([np.arange(4 * n), np.arange(6 * n, 8 * n)])
    result = np.zeros((8 * n, 8 * n))
    result[np.ix_(keep, keep)] = theta
    return result


def couplings(K2: Array) -> tuple[Array, Array]:
    """B̄ = [0 0; K2 0] and B̆ = [0 0; 0 K2]."""
    none = np.zeros_like(K2)
    return np.block([[none, none], [K2, none]]), np.block([[none, none], [none, K2]])


def judge(matrices: dict[str, Array], numbers: dict[str, Any]) -> tuple[str, float, Witness | None]:
    """Verdict, margin and witness from the stored matrices: refuted by ball arithmetic, or inconclusive."""
    from scipy.linalg import LinAlgError, eigh

    parts = gather(matrices, SHAPES)
    positives = [numbers[name] for name in ("delay", "window", "beta")]
    legal = np.all(np.isfinite([*positives, numbers["xi"]])) and min(positives) > 0 and numbers["xi"] > 1
    if not parts or not legal or numbers["degree"] not in range(1, 7):
        return "inconclusive", 0.0, None
    part = parts[0]
    K1, _, P, _, _ = part
    none = np.zeros_like(K1)
    A_b = np.block([[none, np.eye(len(K1))], [-K1, none]])
    try:
        form = theta(part, numbers, FLOATS)
        margin = least(form)[0]
        e = eigh(symmetric(P @ A_b) * 2, P)[1][:, -1]
    except LinAlgError:
        return "inconclusive", 0.0, None
    e /= np.linalg.norm(e)
    vector = np.concatenate([e, -e, 0 * e])

    def refuted() -> bool:
        legitimate = all(positive(BALLS.matrix(one)) for one in part[2:])
        return legitimate and negative_at(theta(part, numbers, BALLS), vector)

    if not prove(refuted):
        return "inconclusive", margin, None
    return "refuted", margin, {"e": e.tolist(), "Θ at (e, −e, 0)": float(vector @ form @ vector)}


JUDGES["theorem2"] = judge
FORMS["theorem2"] = lambda matrices, numbers: {
    f"Θ, part {i + 1}": theta(part, numbers, FLOATS) for i, part in enumerate(gather(matrices, SHAPES))
}


def _favourable(K1: Array, K2: Array, numbers: dict[str, float]) -> tuple[Array, ...] | None:
    """K1, K2, P, D, L for β and ξ with the largest least eigenvalue of Θ, in time scaled by ω and with tr P = 2n."""
    import cvxpy as cp

    n, omega = len(K1), rate(K1)
    k1, k2 = K1 / omega**2, K2 / omega
    h, xi = numbers["delay"] * omega, numbers["xi"]
    energy = float(kernel_energy(int(numbers["degree"]))) / (numbers["window"] * omega) ** 2
    A1, B1, B_bar, B_breve = (*companion(k1, k2), *couplings(k2))
    A, size = A1 + B1, 2 * n
    # printed with D where units want another weight: the last two factors, and D in F̄, have a unit of time to spare
    factors = h * np.hstack([B1 @ A1, B1 @ B1, B1 / omega, B1 @ B_bar / omega])
    P, Y, L = (cp.Variable((size, size), symmetric=True) for _ in range(3))  # Y = h²D/β
    t, none = cp.Variable(), np.zeros((size, size))
    form = cp.bmat(
        [
            [-(A.T @ P + P @ A) - (1 + xi) * Y, P @ B_breve, P @ B_bar, P @ factors],
            [(P @ B_breve).T, (xi - 1) * Y - (omega**2 * Y + L) * energy, none, np.zeros((size, 4 * size))],
            [(P @ B_bar).T, none, L, np.zeros((size, 4 * size))],
            [(P @ factors).T, np.zeros((4 * size, 2 * size)), cp.kron(np.eye(4), Y)],
        ]
    )
    room = np.diag(np.concatenate([np.ones(3 * size), np.zeros(4 * size)]))
    limits = [cp.trace(P) == size, *(one >> 1e-6 * np.eye(size) for one in (P, Y, L))]
    found = solve(cp.Problem(cp.Maximize(t), [(form + form.T) / 2 >> t * room, *limits]), P, Y, L)
    if found is None:
        return None
    back = stretch(n, 1 / omega)
    scales = (1.0, omega * numbers["beta"] / numbers["delay"] ** 2, 1 / omega)
    return (K1, K2, *(symmetric(scale * back @ one @ back) for scale, one in zip(scales, found, strict=True)))
