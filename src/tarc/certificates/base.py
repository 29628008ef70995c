"""What a certificate is: a claim, a verdict, the matrices that prove it, and the means to check them again."""

import json
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc import check
from tarc.errors import TarcError

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
        from tarc.report.certificates import certificate_figure

        return certificate_figure(self)


Witness = dict[str, Any]
"""Numbers and lists of numbers, by name and unit."""
Judge = Callable[[dict[str, np.ndarray], dict[str, Any]], tuple[str, float, Witness | None]]
JUDGES: dict[str, Judge] = {}
"""By kind of certificate: verdict, margin and witness from matrices and numbers alone."""

FORMS: dict[str, Callable[[dict[str, np.ndarray], dict[str, Any]], dict[str, np.ndarray]]] = {}
"""By kind of certificate: the symmetric forms that must be positive definite, by name; for the figure."""


def _said(value: float | list[float]) -> str:
    return f"{value:.5g}" if np.ndim(value) == 0 else "(" + ", ".join(f"{one:.4g}" for one in np.ravel(value)) + ")"


def definite(form: np.ndarray) -> tuple[str, float, np.ndarray]:
    """Whether a symmetric matrix is positive definite, its least eigenvalue and that one's vector.

    ``certified`` or ``refuted`` only if rounding of the eigenvalues cannot turn the sign, else ``inconclusive``;
    ``inconclusive`` for a matrix that is not finite. Rounding in the entries of the form is not known here.
    """
    if not np.all(np.isfinite(form)):
        return "inconclusive", float("nan"), np.zeros(len(form))
    values, vectors = np.linalg.eigh((form + form.T) / 2)
    room = 10 * len(form) * np.finfo(float).eps * max(float(np.max(np.abs(values))), 1e-300)
    verdict = "certified" if values[0] > room else "refuted" if values[0] < -room else "inconclusive"
    return verdict, float(values[0]), vectors[:, 0]


def schur(A: np.ndarray) -> tuple[str, float, complex]:
    """Whether A is Schur stable, its spectral radius and leading eigenvalue.

    Stable if P − AᵀPA is positive definite, by more than rounding can account for, for the P > 0 of the discrete
    Lyapunov equation in balanced coordinates; unstable if an eigenvalue is outside the circle by more than its
    condition can account for. Where neither is so, ball arithmetic encloses the eigenvalues. Else inconclusive.
    """
    from scipy.linalg import matrix_balance

    balanced = np.asarray(matrix_balance(A, permute=False)[0])
    values, vectors = np.linalg.eig(balanced)
    lead = int(np.argmax(np.abs(values)))
    radius = float(np.abs(values[lead]))
    quick = _contracts(balanced) if radius < 1 else _grows(balanced, vectors, lead, radius)
    verdict = ("certified" if radius < 1 else "refuted") if quick else _enclosed(A)
    return verdict, radius, complex(values[lead])


def _contracts(A: np.ndarray) -> bool:
    from scipy.linalg import solve_discrete_lyapunov

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # near the edge the solver perturbs; its P is judged below, not trusted
            P = solve_discrete_lyapunov(A.T, np.eye(len(A)))
    except np.linalg.LinAlgError:
        return False
    P = (P + P.T) / 2
    drop = P - A.T @ P @ A
    rounding = 10 * len(A) * np.finfo(float).eps * np.linalg.norm(P, 2) * (1 + np.linalg.norm(A, 2) ** 2)
    return bool(np.linalg.eigvalsh(P)[0] > rounding and np.linalg.eigvalsh((drop + drop.T) / 2)[0] > rounding)


def _grows(A: np.ndarray, vectors: np.ndarray, lead: int, radius: float) -> bool:
    try:
        left = np.linalg.inv(vectors)[lead]
    except np.linalg.LinAlgError:
        return False
    condition = np.linalg.norm(left) * np.linalg.norm(vectors[:, lead])
    return bool(radius - 1 > 10 * len(A) * np.finfo(float).eps * np.linalg.norm(A, 2) * condition)


LARGEST_ENCLOSED = 60
"""States up to which eigenvalues are enclosed; the time grows with the cube, from some milliseconds."""


def _enclosed(A: np.ndarray) -> str:
    """Verdict from balls about all eigenvalues of the very A."""
    import flint

    if len(A) > LARGEST_ENCLOSED:
        return "inconclusive"
    before = flint.ctx.prec
    try:
        for precision in (128, 384):
            flint.ctx.prec = precision
            try:
                sizes = [abs(one) for one in flint.acb_mat(A.tolist()).eig(multiple=True)]
            except ValueError:  # not enclosed at this precision
                continue
            if all(size < 1 for size in sizes):
                return "certified"
            if any(size > 1 for size in sizes):
                return "refuted"
    finally:
        flint.ctx.prec = before
    return "inconclusive"
