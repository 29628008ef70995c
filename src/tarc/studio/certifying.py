"""The certificates of a design, in a process of their own that the next move of a slider ends."""

import asyncio
import multiprocessing
import os
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from tarc.certificates.base import Certificate, Verdict, describe
from tarc.core.errors import (
    InvalidParameter,
    NoStableRatio,
    NotConverged,
    NotLinearisable,
    RobotFileError,
    ScenarioError,
    UnsupportedLaw,
)
from tarc.scenario.model import Scenario

DESIGN_ERRORS = (
    InvalidParameter,
    NoStableRatio,
    NotConverged,
    NotLinearisable,
    RobotFileError,
    ScenarioError,
    UnsupportedLaw,
)
"""Errors of a design that the page shows."""
LABELS = {
    "robot": "Robot",
    "known_inertia": "Robot, known M̂(q)",
    "constant_ratio": "Constant ratio",
    "sector": "Sector",
    "varying_ratio": "Varying ratio",
    "affine": "Affine Lyapunov function",
    "lemma1": "Lemma 1",
    "c2": "Condition (c2)",
    "theorem1": "Theorem 1",
    "theorem2": "Theorem 2",
    "nominal": "Nominal loop",
}
"""What the page calls the kinds of certificates."""
METHODS = ("forkserver", "spawn")


@dataclass(frozen=True)
class CertificateRow:
    """A certificate as the page shows it.

    Attributes
    ----------
    kind
        Name of the test.
    verdict
        Its verdict.
    margin
        Its margin.
    reason
        Why, in one line.
    claim
        What it claims.
    """

    kind: str
    verdict: Verdict
    margin: float
    reason: str
    claim: str

    @property
    def label(self) -> str:
        """Return what the page calls it."""
        return LABELS.get(self.kind, self.kind)


def certificate_rows(content: dict[str, Any]) -> list[CertificateRow]:
    """Certify the first law of a scenario.

    Raises
    ------
    UnsupportedLaw, NotLinearisable
        Where no certificate applies.
    """
    certified = Scenario.parse(content).certify(progress=False)
    rows = [_row(certificate, "") for certificate in certified.known_inertia.values()]
    for certification in certified.values():
        for kind, certificate in certification.certificates.items():
            rows.append(_row(certificate, certification.suggestion if kind == "robot" else ""))
    return rows


def _row(certificate: Certificate, suggestion: str) -> CertificateRow:
    """Return a certificate with its reason: the witness of a refutation, else what its margin means."""
    reason = f"{certificate.margin_meaning}: {certificate.margin:.3g}"
    if certificate.witness is not None:
        reason = str(describe(certificate.witness))
    if suggestion and not certificate.certified:
        reason = suggestion
    elif certificate.basis:
        reason += f", on {certificate.basis}"
    return CertificateRow(certificate.kind, certificate.verdict, certificate.margin, reason, certificate.claim)


def _certify_and_send(content: dict[str, Any], connection: Connection) -> None:
    """Send the rows, or the message of an error."""
    try:
        connection.send(certificate_rows(content))
    except DESIGN_ERRORS as error:
        connection.send(str(error))
    connection.close()


class CertificateJob:
    """Certificates of one design, being computed in a process."""

    def __init__(self, content: dict[str, Any]) -> None:
        context = process_context()
        self._receiver, sender = context.Pipe(duplex=False)
        self._process = context.Process(target=_certify_and_send, args=(content, sender), daemon=True)
        self._process.start()
        sender.close()

    async def result(self) -> list[CertificateRow] | str | None:
        """Return the rows; a message for a design without certificates; None for a job that was cancelled."""
        try:
            return await asyncio.get_running_loop().run_in_executor(None, self._receiver.recv)
        except (EOFError, OSError):
            return None
        finally:
            self._process.join(timeout=1)

    def cancel(self) -> None:
        """End the process at once."""
        if self._process.is_alive():
            self._process.kill()


def process_context() -> Any:
    """Return the context of new processes: copies of one that has imported all, where the system has that."""
    available = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context(next(method for method in METHODS if method in available))
    if context.get_start_method() == "forkserver":
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        context.set_forkserver_preload(["tarc.studio.certifying"])
    return context
