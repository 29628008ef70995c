"""Certificates: a claim, its verdict, the evidence that proves it, and its verification."""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, Self, TypeVar

import numpy as np

from tarc.certificates.encoding import arrays, from_plain, to_plain
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


EVERY_POSTURE = "every posture"
"""Basis of a certificate whose evidence was proven for the whole workspace, and does not rest on samples."""


class Verdict(StrEnum):
    """The outcome of a test of stability."""

    CERTIFIED = "certified"
    REFUTED = "refuted"
    INCONCLUSIVE = "inconclusive"


class Judgement(NamedTuple):
    """The result of evidence: the verdict, its margin, and for a refutation the witness."""

    verdict: Verdict
    margin: float
    witness: Any = None


@dataclass(frozen=True, eq=False)
class LoopMatrices:
    """Matrices of a loop x⁺ = A x + B u, y = C x, which closes by u = ρ y or u = −κ y."""

    A: Array
    B: Array
    C: Array


MAX_INPUT_ERROR = 1e-12
"""Largest difference of an input matrix from that of a held torque, over the largest entry."""


def require_held_torque(A: Array, B: Array, period: float, B_mismatch: Array | None = None) -> None:
    """Refuse an open loop whose first states are not the robot's, under a torque that is held for the period.

    For n joints the states begin with q and q̇ T, each (n,). An acceleration a that is held adds a T²/2 to q and a T² to
    q̇ T, and nothing to other states. A mismatch that changes within a period has two columns, for
    its mean and its first moment.

    Parameters
    ----------
    A, B
        The loop, opened at its inertia ratio, with an input per joint.
    period
        T [s].
    B_mismatch
        Input matrix of the mismatched acceleration of one joint.

    Raises
    ------
    ValueError
        For other matrices, such as those of another period.
    """
    if not (np.isfinite(period) and period > 0):
        raise ValueError(f"period: got {period}; needs a positive number")
    n = B.shape[1]
    double_integrator = np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(n))
    expected = np.zeros((len(A), 2 * n))
    expected[: 2 * n] = period**2 * np.kron([[1 / 2, 1 / 12**0.5], [1.0, 0.0]], np.eye(n))
    inputs = [B] if B_mismatch is None else [B, B_mismatch]
    is_held = all(
        part.shape[0] == len(A)
        and part.shape[1] in (n, 2 * n)
        and np.abs(part - expected[:, : part.shape[1]]).max() <= MAX_INPUT_ERROR * period**2
        for part in inputs
    )
    if not is_held or not np.array_equal(A[: 2 * n, : 2 * n], double_integrator) or np.any(A[: 2 * n, 2 * n :]):
        raise ValueError("loop: its states are not those of a robot under a torque that is held for the period")


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence(ABC):
    """The matrices and numbers that prove a verdict; one subclass per kind of certificate.

    Attributes
    ----------
    kind
        Name of the test, such as ``constant_ratio``.
    witness_type
        Class of the witness of a refutation; None where the test refutes nothing.
    """

    kind: ClassVar[str]
    witness_type: ClassVar[type[Any] | None] = None

    @abstractmethod
    def judge(self) -> Judgement:
        """Return verdict, margin and witness from the evidence alone, without any solver."""

    def forms(self) -> dict[str, Array]:
        """Return the symmetric forms that must be positive definite, by name, for the figure."""
        return {}

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain data, ready for JSON."""
        return to_plain(self)

    @classmethod
    def from_dict(cls, content: object) -> Self:
        """Return the evidence that `to_dict` wrote.

        Raises
        ------
        ValueError
            For missing or unknown fields, and values of another type.
        """
        return from_plain(cls, content)


DECAY_SHARES = (
    0.99,
    0.97,
    0.94,
    0.9,
    0.8,
    0.7,
    0.6,
    0.5,
    0.4,
    0.3,
    0.2,
    0.14,
    0.1,
    0.07,
    0.05,
    0.03,
    0.02,
    0.01,
    3e-3,
    1e-3,
)
"""Decay rates to prove, as shares of one that is not exceeded."""


def fastest_decay(is_proven: Callable[[float], bool], spectral_radius: float) -> float:
    """Return the largest growth e^{αT} in a period with which something is proven; 1 for none.

    Parameters
    ----------
    is_proven
        Whether it is proven with a growth.
    spectral_radius
        Of a loop among those that decay no slower than is proven.
    """
    slowest = -np.log(spectral_radius) if 0 < spectral_radius < 1 else 0.0
    growths = [float(np.exp(share * slowest)) for share in DECAY_SHARES]
    low, high = 0, len(growths)  # the first that is proven is among these
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if growths[middle] > 1 and is_proven(growths[middle]) else (middle + 1, high)
    return growths[low] if low < len(growths) else 1.0


E = TypeVar("E", bound=Evidence, covariant=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate(Generic[E]):
    """The outcome of a test of stability, with its evidence.

    Attributes
    ----------
    claim
        What is certified or refuted, in a sentence.
    evidence
        The matrices and numbers that prove the verdict, and further findings.
    verdict
        Certified, refuted or inconclusive.
    margin
        Distance from the limit, positive where certified; ``margin_meaning`` names its quantity.
    assumptions
        What the verdict assumes.
    witness
        Proof of a refutation: a mode that grows, or a vector on which a form is negative.
    problem
        The condition that was tested, as a formula.
    basis
        The samples on which the evidence rests, if any, or `EVERY_POSTURE`; part of the verdict in words.
    proof_grade
        Whether ball arithmetic, which encloses every rounding error, decided the verdict, and not floating point.

    Raises
    ------
    InvalidParameter
        For an unknown verdict.
    """

    claim: str
    evidence: E
    verdict: Verdict
    margin: float
    margin_meaning: str
    assumptions: tuple[str, ...]
    witness: Any = None
    problem: str = ""
    basis: str = ""
    proof_grade: bool = False

    def __post_init__(self) -> None:
        if self.verdict not in list(Verdict):
            raise InvalidParameter(f"verdict: got {self.verdict!r}; allowed: {', '.join(Verdict)}")
        object.__setattr__(self, "verdict", Verdict(self.verdict))

    @property
    def kind(self) -> str:
        """Name of the test, such as ``constant_ratio``."""
        return self.evidence.kind

    @property
    def certified(self) -> bool:
        """Whether the verdict is ``certified``."""
        return self.verdict == Verdict.CERTIFIED

    @property
    def verdict_in_words(self) -> str:
        """The verdict, with the samples on which a certified one rests."""
        if not self.certified or not self.basis:
            return str(self.verdict)
        return f"{self.verdict} {'for' if self.basis == EVERY_POSTURE else 'on'} {self.basis}"

    def verify(self) -> bool:
        """Return whether the evidence, judged again without any solver, gives the same verdict."""
        if not all(np.all(np.isfinite(array)) for array in arrays(self.evidence)):
            return self.verdict == Verdict.INCONCLUSIVE
        try:
            return self.evidence.judge().verdict == self.verdict
        except (ValueError, np.linalg.LinAlgError, UnsupportedLaw):  # shapes that do not fit together
            return False

    def explain(self) -> str:
        """Return the claim, the verdict and its assumptions, in words."""
        grade = ", decided in ball arithmetic" if self.proof_grade else ""
        verdict = f"Verdict: {self.verdict_in_words}{grade}; {self.margin_meaning}: {self.margin:.4g}."
        lines = [self.claim]
        if self.problem:
            lines.append(f"Tested: {self.problem}")
        lines.append(verdict)
        decay_rate = getattr(self.evidence, "decay_rate", None)
        if self.certified and decay_rate:
            lines.append(f"Errors decay at least as e^(−{decay_rate:.3g} t), t in seconds.")
        if self.witness:
            lines.append(f"Shown by: {describe(self.witness)}.")
        return "\n".join([*lines, "Assumed:", *(f"- {assumption}" for assumption in self.assumptions)])

    def to_dict(self) -> dict[str, Any]:
        """Return the certificate as plain data for JSON; `tarc.stored_certificates.certificate_from_dict` reads it."""
        return {"kind": self.kind} | to_plain(self)

    def to_json(self) -> str:
        """Return `to_dict` as text."""
        return json.dumps(self.to_dict(), allow_nan=False)

    def plot(self) -> "Figure":
        """Return a figure of the evidence."""
        from tarc.plotting.certificates import certificate_figure

        return certificate_figure(self)


def certificate_from_plain(evidence_type: type[E], content: dict[str, Any], evidence: object) -> Certificate[E]:
    """Return a certificate from plain data of its fields, with evidence of the type given.

    Raises
    ------
    ValueError, TypeError
        For missing or unknown fields, and values of another type.
    """
    plain = {name: value for name, value in content.items() if name not in ("kind", "evidence", "witness")}
    witness = content["witness"]
    if witness is not None and evidence_type.witness_type is not None:
        witness = from_plain(evidence_type.witness_type, witness, "witness")
    margin, assumptions = from_plain(float, plain.pop("margin"), "margin"), tuple(plain.pop("assumptions"))
    return Certificate(
        **plain,
        margin=margin,
        assumptions=assumptions,
        witness=witness,
        evidence=evidence_type.from_dict(evidence),
    )


def describe(witness: object) -> str:
    """Return the names and values of a witness, in words."""
    entries = []
    for name, value in to_plain(witness).items():
        if value is not None:
            text = f"{value:.5g}" if np.ndim(value) == 0 else f"({format_vector(np.ravel(value), digits=4)})"
            entries.append(f"{name.replace('_', ' ')} {text}")
    return ", ".join(entries)
