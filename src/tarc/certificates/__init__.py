"""Certificates of stability, each of which can be checked again from the matrices that it carries."""

from tarc.core.optional import require

require("certify", "tarc.certificates")

from tarc.certificates.affine import certify_affine
from tarc.certificates.base import Certificate
from tarc.certificates.bound_prover import ProvenPart
from tarc.certificates.certified_gains import CertifiedGains, GainRange, certify_gains
from tarc.certificates.constant_ratio import certify_constant_ratio
from tarc.certificates.known_inertia import certify_known_inertia
from tarc.certificates.region import certify_region
from tarc.certificates.robot import certify_robot, strengthen_robot
from tarc.certificates.robot_proof import ProvenRobot, prove_robot
from tarc.certificates.sector import certify_sector
from tarc.certificates.varying_ratio import certify_varying_ratio

__all__ = [
    "Certificate",
    "CertifiedGains",
    "GainRange",
    "ProvenPart",
    "ProvenRobot",
    "certify_affine",
    "certify_constant_ratio",
    "certify_gains",
    "certify_known_inertia",
    "certify_region",
    "certify_robot",
    "certify_sector",
    "certify_varying_ratio",
    "prove_robot",
    "strengthen_robot",
]
