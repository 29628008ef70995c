"""What a certificate is: a claim, a verdict, the matrices that prove it, and the means to check them again."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.analysis.stability import Witness
from tarc.core import validation as check
from tarc.core.errors import TarcError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


VERDICTS = ("certified", "refuted", "inconclusive")


@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate:
    """The outcome of a test of stability, with its evidence.

    Attributes
    ----------
    kind
        Which test, such as ``loop``.
    claim
        What is certified or refuted, in a sentence.
    verdict
        ``certified``, ``refuted`` or ``inconclusive``.
    margin
        How far from the edge, positive where certified; ``margin_meaning`` says in what.
    assumptions
        What the verdict takes for granted.
    matrices, numbers
        The evidence, and what else was found.
    witness
        Where refuted: what shows it, such as a mode that grows or a vector on which a form is negative.
    problem
        The condition that was tested, as a formula.
    proof_grade
        Whether the verdict was decided in ball arithmetic, which encloses every rounding error, and not in floating
        point.
    """

    kind: str
    claim: str
    verdict: str
    margin: float
    margin_meaning: str
    assumptions: tuple[str, ...]
    matrices: dict[str, np.ndarray]
    numbers: dict[str, float] = field(default_factory=dict)
    witness: "Witness | None" = None
    problem: str = ""
    proof_grade: bool = False

    def __post_init__(self) -> None:
        check.one_of("verdict", self.verdict, VERDICTS)

    @property
    def certified(self) -> bool:
        """Whether the verdict is ``certified``."""
        return self.verdict == "certified"

    def verify(self) -> bool:
        """Judge the stored matrices anew, without any solver; whether the verdict is the same."""
        if not all(np.all(np.isfinite(matrix)) for matrix in self.matrices.values()):
            return self.verdict == "inconclusive"
        try:
            return JUDGES[self.kind](self.matrices, self.numbers)[0] == self.verdict
        except (KeyError, ValueError, np.linalg.LinAlgError, TarcError):  # what is missing or does not fit
            return False

    def explain(self) -> str:
        """The claim, the verdict and what it rests on, in plain words."""
        grade = ", decided in ball arithmetic" if self.proof_grade else ""
        lines = [self.claim, f"Verdict: {self.verdict}{grade}; {self.margin_meaning}: {self.margin:.4g}."]
        if self.problem:
            lines.insert(1, f"Tested: {self.problem}")
        if self.witness:
            lines.append("Shown by: " + ", ".join(f"{key} {_said(value)}" for key, value in self.witness.items()) + ".")
        return "\n".join([*lines, "Assumed:", *(f"- {assumption}" for assumption in self.assumptions)])

    def to_json(self) -> str:
        """All of it as JSON."""
        content = asdict(self) | {"matrices": {name: matrix.tolist() for name, matrix in self.matrices.items()}}
        return json.dumps(content)

    @classmethod
    def from_json(cls, text: str) -> "Certificate":
        """Read what `to_json` wrote."""
        try:
            content = json.loads(text)
            content["matrices"] = {name: np.array(rows, dtype=float) for name, rows in content["matrices"].items()}
            content["assumptions"] = tuple(content["assumptions"])
            return cls(**content)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise TarcError(f"from_json: this is no certificate ({error}); needs what to_json wrote") from None

    def plot(self) -> "Figure":
        """Figure of the evidence."""
        from tarc.plotting.certificates import certificate_figure

        return certificate_figure(self)


Judge = Callable[[dict[str, np.ndarray], dict[str, Any]], tuple[str, float, Witness | None]]
JUDGES: dict[str, Judge] = {}
"""By kind of certificate: verdict, margin and witness from matrices and numbers alone."""

FORMS: dict[str, Callable[[dict[str, np.ndarray], dict[str, Any]], dict[str, np.ndarray]]] = {}
"""By kind of certificate: the symmetric forms that must be positive definite, by name; for the figure."""


def _said(value: float | list[float]) -> str:
    return f"{value:.5g}" if np.ndim(value) == 0 else "(" + ", ".join(f"{one:.4g}" for one in np.ravel(value)) + ")"
