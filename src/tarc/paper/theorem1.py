"""Theorem 1 of the paper: Ψ > 0, a condition on the gains and the delay of time-delayed control.

The nominal error is ė = A1 e + B1 e_h + B σ1, with e = [e1; ė1], A1 = [0 I; 0 0], B1 = [0 0; −K1 −K2], B = [0; I] and
A = A1 + B1. With AᵀP + PA = −Q and only D/β mattering, the two blocks of Ψ are

    Ψ1 = Q − E − (1+ξ)(h²/β) D,     Ψ2 = (ξ−1)(h²/β) D,
    E = β P B1 (A1 D⁻¹A1ᵀ + B1 D⁻¹B1ᵀ + D⁻¹) B1ᵀ P.

The last D⁻¹ comes from the cross term 2eᵀPB1∫Bσ1. It is linear in e, so that it may be left with the other such term
instead; the condition is then weaker to meet, and the same in any unit of time. As printed it is not: D⁻¹ counts for
more the slower the loop is.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tarc.analysis.stability import Witness
from tarc.certificates.base import FORMS, JUDGES, Certificate, dict_certificate
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.numerics.ball_arithmetic import BALLS, FLOATS, Arithmetic, negative_at, positive, prove
from tarc.numerics.sdp import furthest, least, longest, solve, symmetric
from tarc.paper.law_parts import companion, delay_of, delayed, gains, gather, lyapunov, rate, store, stretch

if TYPE_CHECKING:
    from tarc.core.validation import Matrix


NAMES = ("K1", "K2", "P", "D")
SHAPES = {"K1": (1, 1), "K2": (1, 1), "P": (2, 2), "D": (2, 2)}


def check_theorem1(
    law: Law,
    *,
    delay: float | None = None,
    weight: "Matrix | None" = None,
    D: "Matrix | None" = None,
    beta: float | None = None,
    xi: float | None = None,
    disturbance_term: bool = True,
) -> Certificate:
    """Theorem 1: whether Ψ > 0, for given numbers or for some that a semidefinite program finds.

    For fixed gains and delay a Schur complement of E makes Ψ > 0 a linear matrix inequality in P and D/β as ξ → 1.
    The point that is found gets a ξ > 1 from its slack, and both blocks of Ψ are then proven positive definite there
    in ball arithmetic. Joints whose gains do not couple them cost what their different gains cost.

    Parameters
    ----------
    law
        A law on time-delay estimation, for K1, K2 and h.
    delay
        h [s]; None for the law's own.
    weight
        Q, (2n, 2n) symmetric positive definite, one number or 2n; None to have it found with D.
    D
        (2n, 2n) symmetric positive definite, one number or 2n; None to have it found. Needs the weight.
    beta, xi
        β > 0 and ξ > 1, with D only; None for β = 1 and for a quarter of the slack that ξ has.
    disturbance_term
        Keep the D⁻¹ term of E, as printed.

    Returns
    -------
    Certificate
        With numbers of the caller's own: certified or refuted, the latter with a vector on which Ψ1 is negative.
        With found ones: certified or inconclusive, for that none were found does not show that the loop is unstable.
        Its margin is the least eigenvalue of Ψ1 once its diagonal is scaled to one.

    Raises
    ------
    TarcError
        For a law without time-delay estimation, weights that are not positive definite, D without a weight, β ≤ 0,
        ξ ≤ 1.

    References
    ----------
    Paper, Theorem 1, equation (delay value).
    """
    if D is None and (beta is not None or xi is not None):
        raise TarcError("beta, xi: given without D; they are found together with D, so give D as well, or neither")
    if D is not None and weight is None:
        raise TarcError("weight: missing; a given D needs the weight Q of the Lyapunov equation as well")
    law = delayed(law)
    h = delay_of(law, delay)
    given = [
        check.positive_definite(name, one, 2 * law.n_joints)
        for name, one in (("weight", weight), ("D", D))
        if one is not None
    ]
    numbers = {
        "delay": h,
        "beta": 1.0 if beta is None else check.number("beta", beta, 0, strict=True),
        "xi": 1.01 if xi is None else check.number("xi", xi, 1, strict=True),
        "disturbance term": float(disturbance_term),
    }
    points = []
    for K1, K2, *weights in gains(law, *given):
        P = lyapunov(K1, K2, weights[0]) if weights else None
        points.append((K1, K2, P, weights[1]) if D is not None else _Program(K1, K2, P, disturbance_term).point(h))
    found = all(point is not None for point in points)
    if found and xi is None:
        numbers["xi"] = _xi(points, numbers)
    parts = points if found else gains(law)
    verdict, margin, witness = judge(store(parts, NAMES), numbers)
    if D is None and verdict == "refuted":  # a candidate that fails shows nothing
        parts, verdict, margin, witness = gains(law), "inconclusive", 0.0, None
    if D is not None:
        what = f"h = {h:g} s, the given Q and D and ξ = {numbers['xi']:g}."
    else:
        by = "some P, Q, D" if weight is None else "the given Q and some D"
        what = f"h = {h:g} s and {by}: the nominal error of time-delayed control is ultimately bounded."
    term = (
        "E has its last D⁻¹, as printed"
        if disturbance_term
        else "E is without its last D⁻¹: the cross term that it is for is linear in e, and counts in the ultimate bound"
    )
    return dict_certificate(
        kind="theorem1",
        claim=f"Condition Ψ > 0 of Theorem 1 holds for {what}",
        verdict=verdict,
        margin=margin,
        margin_meaning="least eigenvalue of Ψ1, its diagonal scaled to one",
        assumptions=(
            "‖σ1‖ ≤ c for all time; σ1 holds terms in the state even under perfect time-delay estimation, so this is "
            "a condition and no consequence",
            "the nominal equation ė = A1 e + B1 e_h + B σ1 in continuous time with true derivatives; neither the "
            "sampled loop nor its estimator",
            "sufficient only: where it fails, the equation may still be stable",
            "Q is −(AᵀP + PA) for the stored P" + (", the given one to rounding" if given else ""),
            term,
        ),
        matrices=store(parts, NAMES),
        numbers=numbers,
        witness=witness,
        problem="Ψ = diag(Q − E − (1+ξ)(h²/β)D, (ξ−1)(h²/β)D) > 0",
        proof_grade=verdict != "inconclusive",
    )


def theorem1_max_delay(law: Law, *, disturbance_term: bool = True) -> float:
    """The largest delay h [s] that Theorem 1 certifies for the gains of a law, to a millionth; 0.0 for none.

    As printed, with damping 1 and natural frequency 1 rad/s: 0.2454 s; without the D⁻¹ term 0.2708 s over the
    natural frequency. The
    exact margin of ė = A1 e + B1 e_h is 0.6474 over the natural frequency.
    """
    h = min(_Program(K1, K2, None, disturbance_term).longest() for K1, K2 in gains(delayed(law)))
    for room in (1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
        if h > 0 and check_theorem1(law, delay=h * (1 - room), disturbance_term=disturbance_term).certified:
            return float(h * (1 - room))
    return 0.0


class UltimateBound(NamedTuple):
    """What a bound on the TDE error means for the error; see `ultimate_bound`."""

    printed: float
    error: float
    position: float
    rate: float
    gamma: float
    iota: float
    z: float


def ultimate_bound(certificate: Certificate, bound: float) -> UltimateBound:
    """What Theorem 1 says of the error when ‖σ1‖ ≤ c for all time.

    Parameters
    ----------
    certificate
        A certified one of `theorem1`.
    bound
        c [rad/s² or m/s²].

    Returns
    -------
    UltimateBound
        ``printed``, the radius of [e; e_h] outside which V̇ < 0: the r with λ r² = Γ1 + 2ιc r, λ the least eigenvalue
        of Ψ, ι = ‖BᵀP‖, Γ1 = h²c²‖BᵀDB‖/β (the paper's z → 0). Without the D⁻¹ term: Γ1 = 0, ι + h‖K2ᵀBᵀP‖.
        ``error`` and ``position``: limsup ‖e‖ and limsup ‖e1‖ are no larger. ``rate``, the ε they are for [1/s].
        ``gamma`` and ``iota``, Γ1 and ι; ``z``, the share of Ψ1 that ε takes.

    Raises
    ------
    TarcError
        For any other certificate, and a negative bound.

    Notes
    -----
    V̇ < 0 outside a ball does not by itself bound e, since V holds integrals over [t − 2h, t]. But for any ε > 0,

        εV + V̇ ≤ −eᵀΨ1e + 2eᵀPw + Γ1 + ε eᵀPe + ε∫_0^{2h} m(s) e(t−s)ᵀXe(t−s) ds,    X = D/β,

    m(s) = h(h−s) + ξh² for s ≤ h and h(2h−s) after. Times e^{εt} and integrated, the last term gives no more than
    μ eᵀXe, μ = ε∫m(s)e^{εs}ds = h(1+e^{εh})(e^{εh}−1−εh)/ε + ξh²(e^{εh}−1). If εP + μX ≤ zΨ1 with z < 1, then
    limsup V ≤ C/ε with C = sup wᵀPΨ1⁻¹Pw/(1−z) + Γ1, and eᵀPe ≤ V. Here w = Bσ1, without the D⁻¹ term less B1∫Bσ1.
    Parts that decouple share c: their V are added, each over its own C for c = 1. ε is the best.
    """
    from scipy.linalg import eigh
    from scipy.optimize import minimize_scalar

    if certificate.kind != "theorem1" or not certificate.certified:
        raise TarcError(
            f"certificate: got one of {certificate.kind} that is {certificate.verdict}; an ultimate bound needs one of "
            "theorem1 that is certified"
        )
    c = check.number("bound", bound, 0)
    h, beta, xi, disturbed = (certificate.numbers[name] for name in ("delay", "beta", "xi", "disturbance term"))
    parts, printed = [], []
    for part in gather(certificate.matrices, SHAPES):
        K1, K2, P, D = part
        n, X = len(K1), D / beta
        first, second = psi(part, certificate.numbers, FLOATS)
        root = np.linalg.cholesky(np.linalg.inv(first)).T
        # what σ1 of now, of the last h, and its square over the last h are multiplied with
        now, before = P[:, n:], 0 * P[:, n:] if disturbed else h * P[:, n:] @ K2
        constant = h**2 * np.linalg.norm(X[n:, n:], 2) if disturbed else 0.0
        inverse = np.linalg.inv(P)
        outer = np.array([np.linalg.norm(inverse, 2), np.linalg.norm(inverse[:n, :n], 2)])
        parts.append((first, P, X, np.linalg.norm(root @ now, 2), np.linalg.norm(root @ before, 2), constant, outer))
        narrow = min(np.linalg.eigvalsh(first)[0], np.linalg.eigvalsh(second)[0])
        printed.append((-narrow, constant, np.linalg.norm(now, 2), np.linalg.norm(before, 2)))

    def share(epsilon: float, first: Array, P: Array, X: Array) -> float:
        """The least z with εP + μX ≤ zΨ1."""
        grown = np.expm1(epsilon * h)
        mu = h * (2 + grown) * (grown - epsilon * h) / epsilon + xi * h**2 * grown
        return float(eigh(epsilon * P + mu * X, first, eigvals_only=True)[-1])

    def squares(epsilon: float) -> Array:
        """Squared bounds on ‖e‖ and ‖e1‖ for c = 1; infinite where ε is too fast."""
        rows = []
        for first, P, X, now, before, constant, outer in parts:
            z = share(epsilon, first, P, X)
            if z >= 1:
                return np.full(2, np.inf)
            left = np.sqrt(1 - z)
            rows.append((now / left, before / left, constant, *outer))
        now, before, constant, *outer = np.array(rows).T
        weight = (now + before) ** 2 + constant
        shared = np.max(now / np.sqrt(weight)) + np.max(before / np.sqrt(weight))
        return np.max(np.array(outer) * weight, axis=1) * (shared**2 + np.max(constant / weight)) / epsilon

    fastest = min(float(eigh(first, P, eigvals_only=True)[0]) for first, P, *_ in parts)
    last = furthest(lambda epsilon: bool(np.isfinite(squares(epsilon)[1])), 1e-9 * fastest, fastest)
    found: Any = minimize_scalar(lambda part: np.log(squares(last * part)[1]), bounds=(1e-6, 0.9999), method="bounded")
    epsilon = last * float(found.x)
    narrow, constant, now, before = np.max(printed, axis=0) * (-1, 1, 1, 1)
    linear = now + before
    radius = c * (linear + np.sqrt(linear**2 + narrow * constant)) / narrow
    error, position = c * np.sqrt(squares(epsilon))
    z = max(share(epsilon, *part[:3]) for part in parts)
    gamma, iota = float(constant * c**2), float(np.max([one[2] for one in printed]))
    return UltimateBound(float(radius), float(error), float(position), float(epsilon), gamma, iota, z)


def psi(part: tuple[Array, ...], numbers: dict[str, Any], kit: Arithmetic) -> tuple[Array, Array]:
    """The blocks Ψ1 and Ψ2, each (2n, 2n), at K1, K2, P, D, with Q = −(AᵀP + PA)."""
    K1, K2, P, D = (kit.matrix(one) for one in part)
    h, beta, xi = (kit.number(numbers[name]) for name in ("delay", "beta", "xi"))
    A1, B1 = companion(K1, K2)
    A = A1 + B1
    inverse = kit.inverse(D)
    inner = A1 @ inverse @ A1.T + B1 @ inverse @ B1.T
    if numbers["disturbance term"]:
        inner = inner + inverse
    E = beta * (P @ B1 @ inner @ B1.T @ P)
    slope = h * h / beta * D
    return -(A.T @ P + P @ A) - E - (1 + xi) * slope, (xi - 1) * slope


def judge(matrices: dict[str, Array], numbers: dict[str, Any]) -> tuple[str, float, Witness | None]:
    """Verdict, margin and witness from the stored matrices: certified and refuted by ball arithmetic alone."""
    parts = gather(matrices, SHAPES)
    legal = all(np.isfinite(value) for value in numbers.values())
    if not parts or not (legal and numbers["delay"] > 0 and numbers["beta"] > 0 and numbers["xi"] > 1):
        return "inconclusive", 0.0, None
    try:
        margin, vectors = np.inf, []
        for part in parts:
            value, vector = least(psi(part, numbers, FLOATS)[0])
            margin = min(margin, value)
            vectors.append((value, vector))
    except np.linalg.LinAlgError:
        return "inconclusive", 0.0, None

    def holds(part: tuple[Array, ...]) -> bool:
        forms = psi(part, numbers, BALLS)
        return all(positive(form) for form in (*(BALLS.matrix(one) for one in part[2:]), *forms))

    if margin > 0 and all(prove(lambda part=part: holds(part)) for part in parts):
        return "certified", margin, None
    which = int(np.argmin([value for value, _ in vectors]))
    vector = vectors[which][1]
    sound = all(prove(lambda one=one: positive(BALLS.matrix(one))) for part in parts for one in part[2:])
    if sound and prove(lambda: negative_at(psi(parts[which], numbers, BALLS)[0], vector)):
        value = float(vector @ psi(parts[which], numbers, FLOATS)[0] @ vector)
        return "refuted", margin, {"e": vector.tolist(), "eᵀΨ1e": value}
    return "inconclusive", margin, None


def _forms(matrices: dict[str, Array], numbers: dict[str, Any]) -> dict[str, Array]:
    parts = [zip(("Ψ1", "Ψ2"), psi(part, numbers, FLOATS), strict=True) for part in gather(matrices, SHAPES)]
    return {f"{name}, part {i + 1}": form for i, part in enumerate(parts) for name, form in part}


JUDGES["theorem1"] = judge
FORMS["theorem1"] = _forms


class _Program:
    """The semidefinite program of one part, in time scaled by ω: max t with Ψ1's Schur form ≥ t at ξ = 1, tr P = 2n.

    Unknown are P and Y = 2h²D/β, so that nothing grows as h → 0; h enters through r = √2 h only. A given P is scaled
    likewise.
    """

    def __init__(self, K1: Array, K2: Array, P: Array | None, disturbance_term: bool) -> None:
        import cvxpy as cp

        n = len(K1)
        self.gains, self.disturbance_term = (K1, K2), disturbance_term
        self.omega = rate(K1)
        self.back = stretch(n, 1 / self.omega)
        A1, B1 = companion(K1 / self.omega**2, K2 / self.omega)
        A = A1 + B1
        # the last factor has a unit of time that the others have not
        factors = np.hstack([B1 @ A1, B1 @ B1, *([B1 / self.omega] if disturbance_term else [])])
        copies = factors.shape[1] // (2 * n)
        self.Y, t, self.r = cp.Variable((2 * n, 2 * n), symmetric=True), cp.Variable(), cp.Parameter(nonneg=True)
        if P is None:
            self.P, self.size = cp.Variable((2 * n, 2 * n), symmetric=True), 1.0
            limits: list[Any] = [cp.trace(self.P) == 2 * n]
        else:
            forth = stretch(n, self.omega)
            scaled, limits = forth @ P @ forth, []
            self.size = float(np.linalg.norm(scaled, 2))
            self.P = cp.Constant(scaled / self.size)
        off = self.r * (self.P @ factors)
        form = cp.bmat([[-(A.T @ self.P + self.P @ A) - self.Y, off], [off.T, cp.kron(np.eye(copies), self.Y)]])
        # Y needs to be no larger than the delay asks for, and what it takes is missing from Ψ1
        head = np.arange((copies + 1) * 2 * n) < 2 * n
        room = t * np.diag(head.astype(float)) + (self.r * t) * np.diag((~head).astype(float))
        self.problem = cp.Problem(cp.Maximize(t), [(form + form.T) / 2 >> room, *limits])

    def candidate(self, h: float) -> tuple[Array, Array] | None:
        """P and Y for a delay [s]."""
        self.r.value = np.sqrt(2) * h * self.omega
        found = solve(self.problem, self.P, self.Y)
        if found is None:
            return None
        P, Y = (symmetric(self.back @ one @ self.back) for one in found)
        return self.size * P, self.size * self.omega * Y

    def point(self, h: float) -> tuple[Array, ...] | None:
        """K1, K2, P, D with β = 1 for a delay [s]."""
        found = self.candidate(h)
        return None if found is None else (*self.gains, found[0], found[1] / (2 * h**2))

    def longest(self) -> float:
        """The largest delay [s] for which a point is found."""

        def reach(found: tuple[Array, Array]) -> float:
            P, Y = found

            def holds(h: float) -> bool:
                numbers = {"delay": h, "beta": 1.0, "xi": 1.0, "disturbance term": self.disturbance_term}
                return least(psi((*self.gains, P, Y / (2 * h**2)), numbers, FLOATS)[0])[0] > 1e-9

            return furthest(holds, 1e-9 / self.omega, 10 / self.omega)

        return longest(self.candidate, reach, 1e-3 / self.omega)


def _xi(points: list[Any], numbers: dict[str, float]) -> float:
    """1 and a quarter of what ξ may exceed it by, so that both blocks have room."""
    from scipy.linalg import LinAlgError, eigh

    slack = np.inf
    for point in points:
        try:
            first, _ = psi(point, {**numbers, "xi": 1.0}, FLOATS)
            slack = min(slack, eigh(first, numbers["delay"] ** 2 / numbers["beta"] * point[3], eigvals_only=True)[0])
        except LinAlgError:
            return numbers["xi"]
    return float(1 + slack / 4) if slack > 0 else numbers["xi"]
