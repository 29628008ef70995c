"""Certificates read back from what they wrote."""

import json
from typing import Any

from tarc.certificates.affine import AffineEvidence
from tarc.certificates.base import Certificate, Evidence, certificate_from_plain
from tarc.certificates.constant_ratio import ConstantRatioEvidence
from tarc.certificates.known_inertia_evidence import KnownInertiaEvidence
from tarc.certificates.region_evidence import RegionEvidence
from tarc.certificates.robot_evidence import RobotEvidence
from tarc.certificates.sector import SectorEvidence
from tarc.certificates.varying_ratio import VaryingRatioEvidence
from tarc.core.errors import InvalidParameter
from tarc.paper.lemma1 import ConditionC2Evidence, Lemma1Evidence
from tarc.paper.nominal_loop import NominalEvidence
from tarc.paper.theorem1 import Theorem1Evidence
from tarc.paper.theorem2 import Theorem2Evidence


def _evidence_types() -> dict[str, type[Evidence]]:
    """Return the class of evidence of each kind of certificate."""
    classes: tuple[type[Evidence], ...] = (
        RobotEvidence,
        ConstantRatioEvidence,
        SectorEvidence,
        VaryingRatioEvidence,
        AffineEvidence,
        RegionEvidence,
        Lemma1Evidence,
        ConditionC2Evidence,
        Theorem1Evidence,
        Theorem2Evidence,
        NominalEvidence,
        KnownInertiaEvidence,
    )
    return {evidence_type.kind: evidence_type for evidence_type in classes}


def certificate_from_dict(content: dict[str, Any]) -> Certificate:
    """Return the certificate that `Certificate.to_dict` wrote.

    Raises
    ------
    InvalidParameter
        For content that is no certificate.
    """
    try:
        evidence_type = _evidence_types()[content["kind"]]
        return certificate_from_plain(evidence_type, content, content["evidence"])
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InvalidParameter(f"certificate: cannot read it ({error}); needs what Certificate.to_dict wrote") from None


def certificate_from_json(text: str) -> Certificate:
    """Return the certificate that `Certificate.to_json` wrote.

    Raises
    ------
    InvalidParameter
        For text that is no certificate.
    """
    try:
        content = json.loads(text)
    except ValueError as error:
        raise InvalidParameter(
            f"certificate: the text is no JSON ({error}); needs what Certificate.to_json wrote"
        ) from None
    return certificate_from_dict(content)
