"""The paper's own procedure for choosing parameters, step by step, to where it cannot end and what stands in for it."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tarc.analysis.stability import stable_intervals
from tarc.certificates.base import Certificate
from tarc.certificates.constant_ratio import certify_constant_ratio
from tarc.core import validation as check
from tarc.core.validation import Numbers
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.paper.lemma1 import check_condition_c2
from tarc.paper.nominal_loop import check_nominal_loop, nominal_max_window
from tarc.paper.theorem1 import check_theorem1, theorem1_max_delay
from tarc.paper.theorem2 import check_theorem2


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """A step of the procedure.

    Attributes
    ----------
    name
        What is chosen.
    asked
        The condition, in a sentence.
    found
        The values by name, with units.
    verdict
        ``chosen`` where the designer decides, else that of a certificate.
    meaning
        What follows.
    """

    name: str
    asked: str
    found: dict[str, Any]
    verdict: str
    meaning: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Procedure:
    """The procedure of the paper for one choice of gains, delay and window.

    Attributes
    ----------
    steps
        In order: those of the paper, then the two that stand in for its last.
    certificates
        By name: ``theorem1``, ``c2``, ``theorem2``, ``nominal``, ``loop`` (for the ratio asked for) and, where the loop
        is stable for some ratio, ``loop, middle``.
    law
        The law that was judged, with an inertia of one; the adaptive law's parameters are in none of the conditions.
    """

    steps: tuple[Step, ...]
    certificates: dict[str, Certificate] = field(repr=False)
    law: TARC = field(repr=False)

    @property
    def ended(self) -> bool:
        """Whether all conditions of the paper are certified, Θ > 0 among them."""
        return all(self.certificates[kind].certified for kind in ("theorem1", "c2", "theorem2"))

    def explain(self) -> str:
        """The steps in plain words."""
        lines = []
        for number, step in enumerate(self.steps, 1):
            lines += [f"{number}. {step.name}: {step.verdict}", f"   Asked: {step.asked}"]
            values = {name: value for name, value in step.found.items() if np.ndim(value) < 2}
            if values:
                lines.append("   Found: " + ", ".join(f"{name} = {_said(value)}" for name, value in values.items()))
            lines.append(f"   {step.meaning}")
        lines.append("The procedure ends." if self.ended else "The procedure does not end; the last steps stand in.")
        return "\n".join(lines)


def run_procedure(
    natural_frequency: Numbers,
    *,
    damping_ratio: Numbers = 1.0,
    delay: float = 1e-3,
    window: float | None = None,
    degree: int = 2,
    n_joints: int = 1,
    ratio: float = 1.0,
) -> Procedure:
    """Choose parameters as the paper does, with a verdict at each step.

    K1 = ωn² I and K2 = 2ζωn I; h from the hardware; P, Q, D, β and ξ so that Ψ > 0 (Theorem 1); Q so that (c2); L, with
    ς, so that Θ > 0 (Theorem 2). The last has no solution for any gains: its step carries the vector that shows it.
    In its place come the nominal loop, which is Theorem 2 repaired, and the sampled loop that runs.

    Parameters
    ----------
    natural_frequency, damping_ratio
        ωn [rad/s] and ζ, one number or one a joint.
    delay
        h [s], the least that the hardware allows. It is the control period as well.
    window
        ς [s], a multiple of h; None for ten.
    degree
        Λ, 2 or more.
    n_joints
        How many joints n.
    ratio
        The inertia ratio M⁻¹M̂ for which the loop is judged first; 1 is in the middle of what Lemma 1 allows.

    Raises
    ------
    TarcError
        For numbers out of range.

    References
    ----------
    Paper, Section III-B, Selection of Parameters; Theorems 1 and 2, condition (c2).
    """
    n = check.integer("n_joints", n_joints, 1)
    omega = check.vector("natural_frequency", natural_frequency, n, 0, strict=True)
    zeta = check.vector("damping_ratio", damping_ratio, n, 0, strict=True)
    h = check.number("delay", delay, 0, strict=True)
    check.number("ratio", ratio, 0, strict=True)
    length = 10 * h if window is None else window
    shared: Any = dict(
        inertia=np.ones(n),
        natural_frequency=omega,
        damping_ratio=zeta,
        period=h,
        estimator=Algebraic(window=length, degree=check.integer("degree", degree, 2, 6)),
    )
    law = TARC(rise_rate=1.0, fall_rate=1.0, **shared)
    found = {
        "theorem1": check_theorem1(law),
        "c2": check_condition_c2(law),
        "theorem2": check_theorem2(law),
        "nominal": check_nominal_loop(law),
    }
    linear = TDC(**shared)
    found["loop"] = certify_constant_ratio(linear, ratio)
    ranges = _widest(linear), _widest(TDC(synchronised=True, **shared))
    if ranges[0]:
        low, high = ranges[0]
        found["loop, middle"] = certify_constant_ratio(linear, float(np.sqrt(max(low, 1e-3 * high) * high)))
    steps = (
        Step(
            name="K1, K2",
            asked="K1 = ωn² I and K2 = 2ζωn I, ωn and ζ as the error is to decay.",
            found={
                "ωn [rad/s]": omega,
                "ζ": zeta,
                "K1 [1/s²]": law.K1.diagonal().copy(),
                "K2 [1/s]": law.K2.diagonal().copy(),
            },
            verdict="chosen",
            meaning="A = [0 I; −K1 −K2] is Hurwitz.",
        ),
        _delay_step(law, h),
        _theorem1_step(found["theorem1"]),
        Step(
            name="Q for (c2)",
            asked="Q > 0 so that the P of AᵀP + PA = −Q has P3 P2ᵀ > 0.",
            found={"Q": law.Q, "P": law.P},
            verdict=found["c2"].verdict,
            meaning="Any diagonal Q will do with these gains; with this one s = e1.",
        ),
        _theorem2_step(found["theorem2"]),
        _nominal_step(law, found["nominal"]),
        _loop_step(found["loop"], ratio, *ranges),
    )
    return Procedure(steps=steps, certificates=found, law=law)


def exact_delay(law: TDC | TARC) -> float:
    """The delay [s] below which ė = A1 e + B1 e_h is stable, for diagonal gains.

    The characteristic equation s² + (k2 s + k1) e^{−sh} = 0 first has a root jω at ω⁴ = k1² + k2² ω²,
    ωh = arctan(k2 ω/k1).
    """
    k1, k2 = law.K1.diagonal(), law.K2.diagonal()
    omega = np.sqrt((k2**2 + np.sqrt(k2**4 + 4 * k1**2)) / 2)
    return float(np.min(np.arctan2(k2 * omega, k1) / omega))


def _widest(law: TDC) -> tuple[float, float] | None:
    """The widest range of stable inertia ratios, or None."""
    return max(stable_intervals(law), key=lambda ends: ends[1] / max(ends[0], 1e-300), default=None)


def _delay_step(law: TARC, h: float) -> Step:
    """The delay against the largest that Theorem 1 certifies and the largest that its equation bears."""
    longest, exact = theorem1_max_delay(law), exact_delay(law)
    values = {"h [s]": h, "largest by Theorem 1 [s]": longest, "largest that the equation bears [s]": exact}
    if h <= longest:
        meaning = f"h is {h / longest:.2g} of the largest that Theorem 1 certifies for these gains."
    else:
        share = values["natural frequencies by Theorem 1, of these"] = _slower(law, h)
        state = "unstable as well" if h >= exact else "stable still, for the theorem is conservative"
        remedy = (
            f", or {share:.3g} of these natural frequencies"
            if share
            else "; with this one no natural frequency was found to do"
        )
        meaning = (
            f"h is too large: Theorem 1 certifies up to {longest:.4g} s for these gains. The equation that it is for, "
            f"ė = A1 e + B1 e_h, is {state}. Take a shorter h{remedy}."
        )
    return Step(
        name="h",
        asked="The least that the hardware allows, within what Theorem 1 certifies.",
        found=values,
        verdict="chosen" if h <= longest else "too large",
        meaning=meaning,
    )


def _slower(law: TARC, h: float) -> float:
    """The largest share of the natural frequencies, to 1/1024, with which Theorem 1 certifies a delay [s]; 0 for
    none."""
    low, high = 0.0, 1.0
    for _ in range(10):
        middle = (low + high) / 2
        slower = replace(law, natural_frequency=middle * np.asarray(law.natural_frequency))
        low, high = (middle, high) if check_theorem1(slower, delay=h).certified else (low, middle)
    return low


def _theorem1_step(certificate: Certificate) -> Step:
    values = {name: matrix for name, matrix in certificate.matrices.items() if name[0] in "PD"}
    if certificate.certified:
        values |= {"β": certificate.numbers["beta"], "ξ": certificate.numbers["xi"]}
        meaning = "They serve the proof only, which takes a bounded σ1 for granted; σ1 holds the loop's own state."
    else:
        meaning = "None were found, which does not show that there are none, nor that the loop is unstable."
    return Step(
        name="P, D, β, ξ (Theorem 1)",
        asked="Ψ > 0 for some P, D > 0, β > 0 and ξ > 1, by a semidefinite program.",
        found=values,
        verdict=certificate.verdict,
        meaning=meaning,
    )


def _theorem2_step(certificate: Certificate) -> Step:
    witness = certificate.witness or {}
    return Step(
        name="L, ς (Theorem 2)",
        asked="Θ > 0 for some P, D, L > 0, β > 0 and ξ > 1, by a semidefinite program.",
        found={name: matrix for name, matrix in certificate.matrices.items() if name[0] in "PDL"}
        | {"β": certificate.numbers["beta"], "ξ": certificate.numbers["xi"], "ς [s]": certificate.numbers["window"]}
        | witness,
        verdict=certificate.verdict,
        meaning="Here the procedure cannot end. As printed Θ is singular; its reduced form is negative at (e, −e, 0) "
        "for the e found, and such an e exists for all gains, weights, delays and windows. So the printed proof is "
        "none; that the loop is unstable does not follow.",
    )


def _nominal_step(law: TARC, certificate: Certificate) -> Step:
    longest, window = nominal_max_window(law), certificate.numbers["window"]
    values = {"ς [s]": window, "largest ς [s]": longest}
    if certificate.certified:
        values["mean square gain [s²]"] = certificate.numbers["mean square gain"]
        meaning = "This is input-to-state stability of the continuous loop from σ′, not yet of the loop that runs."
    elif longest:
        meaning = f"The window is too long: {longest:.4g} s is the longest that is certified with this h."
    else:
        meaning = "With this h no window is certified; take a shorter h or a lower natural frequency."
    return Step(
        name="ς (nominal loop)",
        asked="In place of Theorem 2: a functional with P, R1, R2 for the loop with h and the window's own lag.",
        found=values,
        verdict=certificate.verdict,
        meaning=meaning,
    )


def _loop_step(
    certificate: Certificate,
    ratio: float,
    literal: tuple[float, float] | None,
    averaged: tuple[float, float] | None,
) -> Step:
    values: dict[str, Any] = {"ρ": ratio, "spectral radius": certificate.numbers["spectral radius"]}
    if literal:
        values |= {"least stable ρ": literal[0], "greatest stable ρ": literal[1]}
    if averaged:
        values |= {"least with averaged torque": averaged[0], "greatest with averaged torque": averaged[1]}
    first = f"At ρ = {ratio:g}, which Lemma 1 {'allows' if ratio < 2 else 'forbids'}, the loop is " + (
        "stable. " if certificate.certified else "not stable. " if certificate.witness else "not decided. "
    )
    if literal:
        second = "M̂ must keep the eigenvalues of M(q)⁻¹M̂ within the stable range; for a robot use certificates.robot."
    elif averaged:
        second = "No M̂ makes it stable unless the past torques are averaged, synchronised=True."
    else:
        second = "No M̂ makes it stable; take a shorter h, a shorter window or a lower natural frequency."
    return Step(
        name="M̂ (the loop that runs)",
        asked="The sampled loop, with its estimator, is stable for the inertia ratio ρ = M⁻¹M̂.",
        found=values,
        verdict=certificate.verdict,
        meaning=first + second,
    )


def _said(value: Any) -> str:
    """Numbers in few digits; one for a vector of equal ones."""
    numbers = np.unique(np.ravel(value)) if np.size(value) > 1 and np.ptp(value) == 0 else np.ravel(value)
    return f"{numbers[0]:.4g}" if len(numbers) == 1 else "(" + ", ".join(f"{one:.4g}" for one in numbers) + ")"
