"""Certificates of stability, each of which can be checked again from the matrices that it carries."""

from tarc.certificates.ball import ball
from tarc.certificates.base import Certificate
from tarc.certificates.certify import certify
from tarc.certificates.gain_bounds import GainBounds, gain_bounds
from tarc.certificates.lemma1 import condition_c2, lemma1
from tarc.certificates.loop import loop, stable_interval, stable_intervals
from tarc.certificates.nominal import nominal, nominal_delay, nominal_window
from tarc.certificates.norms import h2_norm, hinf_norm
from tarc.certificates.robot import robot
from tarc.certificates.shape import best_shape
from tarc.certificates.slope import slope
from tarc.certificates.spread import Spread, spread
from tarc.certificates.theorem1 import UltimateBound, theorem1, theorem1_delay, ultimate_bound
from tarc.certificates.theorem2 import theorem2
from tarc.certificates.workspace import Workspace

__all__ = [
    "Certificate",
    "GainBounds",
    "Spread",
    "UltimateBound",
    "Workspace",
    "ball",
    "best_shape",
    "certify",
    "condition_c2",
    "gain_bounds",
    "h2_norm",
    "hinf_norm",
    "lemma1",
    "loop",
    "nominal",
    "nominal_delay",
    "nominal_window",
    "robot",
    "slope",
    "spread",
    "stable_interval",
    "stable_intervals",
    "theorem1",
    "theorem1_delay",
    "theorem2",
    "ultimate_bound",
]
