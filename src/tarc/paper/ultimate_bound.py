"""The ultimate bound on the error that a certificate of Theorem 1 implies."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tarc.certificates.base import Certificate
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.numerics.ball_arithmetic import FLOATS
from tarc.numerics.interval_minimum import minimise_in_interval
from tarc.numerics.sdp import bisect
from tarc.paper.theorem1 import Theorem1Condition, Theorem1Evidence, Theorem1Part, psi


class UltimateBound(NamedTuple):
    """Bounds on the error that follow from a bound c on the TDE error ‖σ1‖.

    Attributes
    ----------
    printed_radius
        Radius of [e; e_h] outside which V̇ < 0, as in the paper for z → 0.
    error, position
        Bounds on limsup ‖e‖ and limsup ‖e1‖.
    decay_rate
        The ε for which they hold [1/s].
    gamma, iota
        The paper's Γ1 and ι.
    psi_share
        z, the share of Ψ1 that ε takes.
    """

    printed_radius: float
    error: float
    position: float
    decay_rate: float
    gamma: float
    iota: float
    psi_share: float


class _Terms(NamedTuple):
    """Matrices and norms of one independent part.

    ``current``, ``past`` multiply c of now and of the last h in ‖Ψ1^(−½) P w‖. ``constant`` is Γ1/c². ``P_inverse`` is
    ‖P⁻¹‖ and the norm of its block of e1.
    """

    psi1: Array
    P: Array
    X: Array
    current: float
    past: float
    constant: float
    P_inverse: Array


def ultimate_bound(certificate: Certificate[Theorem1Evidence], disturbance_bound: float) -> UltimateBound:
    """Return the ultimate bound on the error by Theorem 1 for ‖σ1‖ ≤ c at all time.

    The printed radius is the r with λ r² = Γ1 + 2ιc r. Here λ is the least eigenvalue of Ψ, ι = ‖BᵀP‖ and
    Γ1 = h²c²‖BᵀDB‖/β. Without the D⁻¹ term, Γ1 = 0 and ι + h‖K2ᵀBᵀP‖ stands for ι.

    Parameters
    ----------
    certificate
        A certified one of `check_theorem1`.
    disturbance_bound
        c [rad/s² or m/s²].

    Raises
    ------
    InvalidParameter
        For any other certificate, and a negative bound.

    Notes
    -----
    V̇ < 0 outside a ball does not by itself bound e, because V holds integrals over [t − 2h, t]. But for any ε > 0,

        εV + V̇ ≤ −eᵀΨ1e + 2eᵀPw + Γ1 + ε eᵀPe + ε∫_0^{2h} m(s) e(t−s)ᵀXe(t−s) ds,    X = D/β,

    with m(s) = h(h−s) + ξh² for s ≤ h and h(2h−s) after. Multiplied by e^{εt} and integrated, the last term is at most
    μ eᵀXe, μ = ε∫m(s)e^{εs}ds = h(1+e^{εh})(e^{εh}−1−εh)/ε + ξh²(e^{εh}−1). If εP + μX ≤ zΨ1 with z < 1, then
    limsup V ≤ C/ε with C = sup wᵀPΨ1⁻¹Pw/(1−z) + Γ1, and eᵀPe ≤ V. Here w = Bσ1, without the D⁻¹ term less B1∫Bσ1.
    Independent parts share c: their V are added, each over its own C for c = 1. The best ε is taken.
    """
    evidence = certificate.evidence
    if not isinstance(evidence, Theorem1Evidence) or not certificate.certified:
        raise InvalidParameter(
            f"certificate: got one of {certificate.kind} that is {certificate.verdict}; an ultimate bound needs one of "
            "theorem1 that is certified"
        )
    c = check.number("disturbance_bound", disturbance_bound, 0)
    terms = [_terms(part, evidence.condition) for part in evidence.parts]
    epsilon = _best_decay_rate(terms, evidence.condition)
    error, position = c * np.sqrt(_squared_bounds(epsilon, terms, evidence.condition))
    printed = [_printed_terms(part, evidence.condition) for part in evidence.parts]
    narrow, constant, current, past = np.max(printed, axis=0) * (-1, 1, 1, 1)
    linear = current + past
    return UltimateBound(
        printed_radius=float(c * (linear + np.sqrt(linear**2 + narrow * constant)) / narrow),
        error=float(error),
        position=float(position),
        decay_rate=epsilon,
        gamma=float(constant * c**2),
        iota=float(current),
        psi_share=max(_psi_share(epsilon, part, evidence.condition) for part in terms),
    )


def _disturbance_factors(part: Theorem1Part, condition: Theorem1Condition) -> tuple[Array, Array, float]:
    """Return what multiplies σ1 of now and of the last h, and Γ1/c²."""
    n = len(part.K1)
    current = part.P[:, n:]
    if condition.disturbance_term:
        X = part.D / condition.beta
        return current, 0 * current, float(condition.delay**2 * np.linalg.norm(X[n:, n:], 2))
    return current, condition.delay * current @ part.K2, 0.0


def _printed_terms(part: Theorem1Part, condition: Theorem1Condition) -> tuple[float, float, float, float]:
    """Return −λ, Γ1/c², ι and its addition without the D⁻¹ term; the largest of each over the parts count."""
    current, past, constant = _disturbance_factors(part, condition)
    narrow = min(np.linalg.eigvalsh(block)[0] for block in psi(part, condition, FLOATS))
    return -float(narrow), constant, float(np.linalg.norm(current, 2)), float(np.linalg.norm(past, 2))


def _terms(part: Theorem1Part, condition: Theorem1Condition) -> _Terms:
    n = len(part.K1)
    psi1, _ = psi(part, condition, FLOATS)
    root = np.linalg.cholesky(np.linalg.inv(psi1)).T
    current, past, constant = _disturbance_factors(part, condition)
    inverse = np.linalg.inv(part.P)
    return _Terms(
        psi1=psi1,
        P=part.P,
        X=part.D / condition.beta,
        current=float(np.linalg.norm(root @ current, 2)),
        past=float(np.linalg.norm(root @ past, 2)),
        constant=constant,
        P_inverse=np.array([np.linalg.norm(inverse, 2), np.linalg.norm(inverse[:n, :n], 2)]),
    )


def _psi_share(epsilon: float, terms: _Terms, condition: Theorem1Condition) -> float:
    """Return the least z with εP + μX ≤ zΨ1."""
    from scipy.linalg import eigh

    h = condition.delay
    growth = np.expm1(epsilon * h)
    mu = h * (2 + growth) * (growth - epsilon * h) / epsilon + condition.xi * h**2 * growth
    return float(eigh(epsilon * terms.P + mu * terms.X, terms.psi1, eigvals_only=True)[-1])


def _squared_bounds(epsilon: float, parts: Sequence[_Terms], condition: Theorem1Condition) -> Array:
    """Return the squared bounds on ‖e‖ and ‖e1‖ for c = 1; infinite where no z < 1 exists for ε."""
    rows = []
    for terms in parts:
        z = _psi_share(epsilon, terms, condition)
        if z >= 1:
            return np.full(2, np.inf)
        remaining = np.sqrt(1 - z)
        rows.append((terms.current / remaining, terms.past / remaining, terms.constant, *terms.P_inverse))
    current, past, constant, *P_inverse = np.array(rows).T
    weight = (current + past) ** 2 + constant
    combined = np.max(current / np.sqrt(weight)) + np.max(past / np.sqrt(weight))
    return np.max(np.array(P_inverse) * weight, axis=1) * (combined**2 + np.max(constant / weight)) / epsilon


def _best_decay_rate(parts: Sequence[_Terms], condition: Theorem1Condition) -> float:
    """Return the ε [1/s] with the least bound on ‖e1‖."""
    from scipy.linalg import eigh

    def squared_position(epsilon: float) -> float:
        return float(_squared_bounds(epsilon, parts, condition)[1])

    fastest = min(float(eigh(terms.psi1, terms.P, eigvals_only=True)[0]) for terms in parts)
    limit = bisect(lambda epsilon: bool(np.isfinite(squared_position(epsilon))), 1e-9 * fastest, fastest)
    share, _ = minimise_in_interval(lambda share: np.log(squared_position(limit * share)), 1e-6, 0.9999)
    return limit * share
