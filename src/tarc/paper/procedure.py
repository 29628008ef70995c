"""The paper's own procedure for choosing parameters, step by step, and the two steps that replace its last."""

from dataclasses import dataclass, field, replace

import numpy as np

from tarc.analysis.stability import stable_intervals, widest_interval
from tarc.certificates.base import Certificate
from tarc.certificates.constant_ratio import certify_constant_ratio
from tarc.core import validation as check
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.paper.lemma1 import ConditionC2Evidence, check_condition_c2
from tarc.paper.nominal_loop import NominalEvidence, check_nominal_loop, nominal_max_window
from tarc.paper.theorem1 import Theorem1Evidence, check_theorem1, theorem1_max_delay
from tarc.paper.theorem2 import Theorem2Evidence, check_theorem2


@dataclass(frozen=True, kw_only=True, eq=False)
class ProcedureStep:
    """A step of the procedure.

    Attributes
    ----------
    name
        The quantities that the step chooses.
    condition
        Their condition, in a sentence.
    values
        Numbers and vectors by symbol, with units.
    outcome
        ``chosen`` or ``too large`` where the designer decides, else the verdict of a certificate.
    meaning
        The consequence.
    """

    name: str
    condition: str
    values: dict[str, float | Array]
    outcome: str
    meaning: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Procedure:
    """The procedure of the paper for one choice of gains, delay and window.

    Attributes
    ----------
    steps
        In order: those of the paper, then the two that replace its last.
    theorem1, condition_c2, theorem2
        Certificates of the paper's conditions.
    nominal_loop
        Certificate of the nominal loop, which repairs Theorem 2.
    running_loop
        Certificate of the sampled loop at the given inertia ratio.
    running_loop_in_range
        Certificate of the sampled loop in the middle of its stable range; None where it has none.
    law
        The law with an inertia of one. The parameters of its adaptation are in none of the conditions.
    """

    steps: tuple[ProcedureStep, ...]
    theorem1: Certificate[Theorem1Evidence] = field(repr=False)
    condition_c2: Certificate[ConditionC2Evidence] = field(repr=False)
    theorem2: Certificate[Theorem2Evidence] = field(repr=False)
    nominal_loop: Certificate[NominalEvidence] = field(repr=False)
    running_loop: Certificate = field(repr=False)
    running_loop_in_range: Certificate | None = field(repr=False)
    law: TARC = field(repr=False)

    @property
    def certificates(self) -> tuple[Certificate, ...]:
        """All certificates, in the order of the steps."""
        optional = () if self.running_loop_in_range is None else (self.running_loop_in_range,)
        paper = (self.theorem1, self.condition_c2, self.theorem2)
        return (*paper, self.nominal_loop, self.running_loop, *optional)

    @property
    def is_complete(self) -> bool:
        """Whether all conditions of the paper are certified, Θ > 0 among them."""
        return all(certificate.certified for certificate in (self.theorem1, self.condition_c2, self.theorem2))

    def explain(self) -> str:
        """Return the steps in words."""
        lines = []
        for number, step in enumerate(self.steps, 1):
            lines += [f"{number}. {step.name}: {step.outcome}", f"   Condition: {step.condition}"]
            if step.values:
                values = (f"{name} = {_format_values(value)}" for name, value in step.values.items())
                lines.append("   Values: " + ", ".join(values))
            lines.append(f"   {step.meaning}")
        lines.append(
            "The procedure ends." if self.is_complete else "The procedure does not end; the last two steps replace it."
        )
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
    """Choose parameters by the paper's procedure, with a verdict at each step.

    K1 = ωn² I and K2 = 2ζωn I; h from the hardware; P, Q, D, β and ξ so that Ψ > 0 (Theorem 1); Q so that (c2); L, with
    ς, so that Θ > 0 (Theorem 2). The last has no solution for any gains, and its step gives the vector that shows it.
    Two steps replace it: the nominal loop, which repairs Theorem 2, and the sampled loop that runs.

    Parameters
    ----------
    natural_frequency, damping_ratio
        ωn [rad/s] and ζ, one number or one per joint.
    delay
        h [s], the least that the hardware allows. It is the control period as well.
    window
        ς [s], a multiple of h; None for ten.
    degree
        Λ, 2 or more.
    n_joints
        Number of joints n.
    ratio
        The inertia ratio M⁻¹M̂ at which the loop is judged first; 1 is in the middle of the range of Lemma 1.

    Raises
    ------
    InvalidParameter
        For numbers out of range.

    References
    ----------
    Paper, Section III-B, Selection of Parameters; Theorems 1 and 2, condition (c2).
    """
    check.number("ratio", ratio, 0, strict=True)
    law, literal, synchronised = _laws(natural_frequency, damping_ratio, delay, window, degree, n_joints)
    theorem1, condition_c2, theorem2 = check_theorem1(law), check_condition_c2(law), check_theorem2(law)
    nominal_loop = check_nominal_loop(law)
    running_loop = certify_constant_ratio(literal, ratio)
    literal_range, synchronised_range = _widest_range(literal), _widest_range(synchronised)
    steps = (
        _gains_step(law),
        _delay_step(law),
        _theorem1_step(theorem1),
        ProcedureStep(
            name="Q for (c2)",
            condition="Q > 0 so that the P of AᵀP + PA = −Q has P3 P2ᵀ > 0.",
            values={},
            outcome=condition_c2.verdict,
            meaning="Any diagonal Q suffices with these gains; with this one s = e1.",
        ),
        _theorem2_step(theorem2),
        _nominal_step(law, nominal_loop),
        _loop_step(running_loop, ratio, literal_range, synchronised_range),
    )
    return Procedure(
        steps=steps,
        theorem1=theorem1,
        condition_c2=condition_c2,
        theorem2=theorem2,
        nominal_loop=nominal_loop,
        running_loop=running_loop,
        running_loop_in_range=_certify_middle(literal, literal_range),
        law=law,
    )


def _laws(
    natural_frequency: Numbers,
    damping_ratio: Numbers,
    delay: float,
    window: float | None,
    degree: int,
    n_joints: int,
) -> tuple[TARC, TDC, TDC]:
    """Return TARC, and TDC with the last torque and with the averaged torque, with an inertia of one."""
    n = check.integer("n_joints", n_joints, 1)
    omega = check.vector("natural_frequency", natural_frequency, n, 0, strict=True)
    zeta = check.vector("damping_ratio", damping_ratio, n, 0, strict=True)
    h = check.number("delay", delay, 0, strict=True)
    length = 10 * h if window is None else window
    estimator = Algebraic(window=length, degree=check.integer("degree", degree, 2, 6))
    shared = {"inertia": np.ones(n), "natural_frequency": omega, "damping_ratio": zeta, "estimator": estimator}
    law = TARC(rise_rate=1.0, fall_rate=1.0, period=h, **shared)
    return law, TDC(period=h, **shared), TDC(synchronised=True, period=h, **shared)


def exact_delay(law: TDC | TARC) -> float:
    """Return the delay [s] below which ė = A1 e + B1 e_h is stable, for diagonal gains.

    The characteristic equation s² + (k2 s + k1) e^{−sh} = 0 first has a root jω at ω⁴ = k1² + k2² ω²,
    ωh = arctan(k2 ω/k1).
    """
    k1, k2 = law.K1.diagonal(), law.K2.diagonal()
    omega = np.sqrt((k2**2 + np.sqrt(k2**4 + 4 * k1**2)) / 2)
    return float(np.min(np.arctan2(k2 * omega, k1) / omega))


def _widest_range(law: TDC) -> tuple[float, float] | None:
    """Return the widest range of stable inertia ratios; None for none."""
    return widest_interval(stable_intervals(law))


def _certify_middle(law: TDC, stable_range: tuple[float, float] | None) -> Certificate | None:
    """Return the certificate of the sampled loop at the geometric mean of its stable range."""
    if stable_range is None:
        return None
    low, high = stable_range
    return certify_constant_ratio(law, float(np.sqrt(max(low, 1e-3 * high) * high)))


def _gains_step(law: TARC) -> ProcedureStep:
    """Return the step of K1 and K2."""
    return ProcedureStep(
        name="K1, K2",
        condition="K1 = ωn² I and K2 = 2ζωn I, with ωn and ζ of the decay that the error shall have.",
        values={
            "ωn [rad/s]": np.asarray(law.natural_frequency),
            "ζ": np.asarray(law.damping_ratio),
            "K1 [1/s²]": law.K1.diagonal().copy(),
            "K2 [1/s]": law.K2.diagonal().copy(),
        },
        outcome="chosen",
        meaning="A = [0 I; −K1 −K2] is Hurwitz.",
    )


def _delay_step(law: TARC) -> ProcedureStep:
    """Return the step of h: the delay against the limits of Theorem 1 and of its equation."""
    h, certified, exact = law.period, theorem1_max_delay(law), exact_delay(law)
    values: dict[str, float | Array] = {
        "h [s]": h,
        "largest by Theorem 1 [s]": certified,
        "stability limit of the equation [s]": exact,
    }
    if h <= certified:
        meaning = f"h is {h / certified:.2g} of the largest that Theorem 1 certifies for these gains."
    else:
        share = values["share of ωn that Theorem 1 certifies"] = _certified_frequency_share(law, h)
        state = "unstable as well" if h >= exact else "still stable, because the theorem is conservative"
        remedy = f", or {share:.3g} of these natural frequencies" if share else "; no lower natural frequency suffices"
        meaning = (
            f"h is too large: Theorem 1 certifies up to {certified:.4g} s for these gains. Its equation, "
            f"ė = A1 e + B1 e_h, is {state}. Take a shorter h{remedy}."
        )
    return ProcedureStep(
        name="h",
        condition="The least that the hardware allows, within the limit of Theorem 1.",
        values=values,
        outcome="chosen" if h <= certified else "too large",
        meaning=meaning,
    )


def _certified_frequency_share(law: TARC, h: float) -> float:
    """Return the largest share of the natural frequencies, to 1/1024, for which Theorem 1 certifies a delay [s]."""
    low, high = 0.0, 1.0
    for _ in range(10):
        middle = (low + high) / 2
        slower = replace(law, natural_frequency=middle * np.asarray(law.natural_frequency))
        low, high = (middle, high) if check_theorem1(slower, delay=h).certified else (low, middle)
    return low


def _theorem1_step(certificate: Certificate[Theorem1Evidence]) -> ProcedureStep:
    """Return the step of P, D, β and ξ."""
    values: dict[str, float | Array] = {}
    meaning = "The program found none; this shows neither that none exist nor that the loop is unstable."
    if certificate.certified:
        condition = certificate.evidence.condition
        values = {"β": condition.beta, "ξ": condition.xi}
        meaning = "They serve the proof only, which assumes a bounded σ1; σ1 holds the loop's own state."
    return ProcedureStep(
        name="P, D, β, ξ (Theorem 1)",
        condition="Ψ > 0 for some P, D > 0, β > 0 and ξ > 1, by a semidefinite program.",
        values=values,
        outcome=certificate.verdict,
        meaning=meaning,
    )


def _theorem2_step(certificate: Certificate[Theorem2Evidence]) -> ProcedureStep:
    """Return the step of L and ς, at which the procedure cannot end."""
    condition, witness = certificate.evidence.condition, certificate.witness
    values: dict[str, float | Array] = {"β": condition.beta, "ξ": condition.xi, "ς [s]": condition.window}
    if witness is not None:
        values |= {"e": witness.e, "Θ at (e, −e, 0)": witness.value}
    return ProcedureStep(
        name="L, ς (Theorem 2)",
        condition="Θ > 0 for some P, D, L > 0, β > 0 and ξ > 1, by a semidefinite program.",
        values=values,
        outcome=certificate.verdict,
        meaning="The procedure cannot end at this step. As printed Θ is singular; its reduced form is negative at "
        "(e, −e, 0). Such an e exists for all gains, weights, delays and windows. So the printed proof fails; this "
        "does not show that the loop is unstable.",
    )


def _nominal_step(law: TARC, certificate: Certificate[NominalEvidence]) -> ProcedureStep:
    """Return the step of the nominal loop, which replaces Theorem 2."""
    evidence, max_window = certificate.evidence, nominal_max_window(law)
    values: dict[str, float | Array] = {"ς [s]": evidence.loop.window, "largest ς [s]": max_window}
    if evidence.mean_square_gain is not None:
        values["mean square gain [s²]"] = evidence.mean_square_gain
        meaning = "This is input-to-state stability of the continuous loop from σ′, not yet of the loop that runs."
    elif max_window:
        meaning = f"The window is too long: {max_window:.4g} s is the longest that is certified with this h."
    else:
        meaning = "With this h no window is certified; take a shorter h or a lower natural frequency."
    return ProcedureStep(
        name="ς (nominal loop)",
        condition="Replaces Theorem 2: a functional with P, R1, R2 for the loop with h and the window's own lag.",
        values=values,
        outcome=certificate.verdict,
        meaning=meaning,
    )


def _loop_step(
    certificate: Certificate,
    ratio: float,
    literal: tuple[float, float] | None,
    synchronised: tuple[float, float] | None,
) -> ProcedureStep:
    """Return the step of M̂, from the sampled loop."""
    values: dict[str, float | Array] = {"ρ": ratio, "spectral radius": certificate.evidence.findings.spectral_radius}
    if literal:
        values |= {"least stable ρ": literal[0], "greatest stable ρ": literal[1]}
    if synchronised:
        values |= {"least with averaged torque": synchronised[0], "greatest with averaged torque": synchronised[1]}
    state = "stable" if certificate.certified else "not stable" if certificate.witness else "not decided"
    lemma = "allows" if ratio < 2 else "forbids"
    if literal:
        remedy = "M̂ must keep the eigenvalues of M(q)⁻¹M̂ within the stable range; for a robot use certify_robot."
    elif synchronised:
        remedy = "No M̂ makes it stable unless the past torques are averaged, synchronised=True."
    else:
        remedy = "No M̂ makes it stable; take a shorter h, a shorter window or a lower natural frequency."
    return ProcedureStep(
        name="M̂ (the loop that runs)",
        condition="The sampled loop, with its estimator, is stable for the inertia ratio ρ = M⁻¹M̂.",
        values=values,
        outcome=certificate.verdict,
        meaning=f"At ρ = {ratio:g}, which Lemma 1 {lemma}, the loop is {state}. {remedy}",
    )


def _format_values(values: float | Array) -> str:
    """Return numbers with four digits; a vector of equal numbers as one number."""
    is_constant = np.size(values) > 1 and np.ptp(values) == 0
    numbers = np.unique(np.ravel(values)) if is_constant else np.ravel(values)
    text = format_vector(numbers, digits=4)
    return text if len(numbers) == 1 else f"({text})"
