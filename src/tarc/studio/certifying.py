"""The certificates of a design as the page shows them."""

from typing import Any

from tarc.certificates.base import Certificate, describe
from tarc.scenario.model import Scenario
from tarc.studio.design_state import DesignState
from tarc.studio.jobs import Sender
from tarc.studio.results import CertificateRow
from tarc.studio.robots import Robots

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
    kind = certificate.kind
    label = LABELS.get(kind, kind)
    return CertificateRow(kind, label, str(certificate.verdict), certificate.margin, reason, certificate.claim)


def send_certificates(send: Sender, state: DesignState, robots: Robots) -> None:
    """Send the rows of a design, for a `Job`."""
    send(certificate_rows(state.to_content(robots.content(state.robot))))
