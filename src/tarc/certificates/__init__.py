"""Certificates of stability, each of which can be checked again from the matrices that it carries."""

from tarc.core.optional import require

require("certify", "tarc.certificates")

from tarc.certificates.base import Certificate
from tarc.certificates.constant_ratio import loop
from tarc.certificates.robot import robot
from tarc.certificates.sector import slope
from tarc.certificates.varying_ratio import ball

__all__ = ["Certificate", "ball", "loop", "robot", "slope"]
