"""Certificates of stability, each of which can be checked again from the matrices that it carries."""

from tarc.certificates.ball import ball
from tarc.certificates.base import Certificate
from tarc.certificates.loop import loop, stable_interval, stable_intervals
from tarc.certificates.norms import h2_norm, hinf_norm
from tarc.certificates.robot import robot
from tarc.certificates.slope import slope
from tarc.certificates.workspace import Spread, Workspace, best_shape, spread

__all__ = [
    "Certificate",
    "Spread",
    "Workspace",
    "ball",
    "best_shape",
    "h2_norm",
    "hinf_norm",
    "loop",
    "robot",
    "slope",
    "spread",
    "stable_interval",
    "stable_intervals",
]
