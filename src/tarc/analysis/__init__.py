"""Analysis of the linearised loop and of the robot: stable inertia ratios, workspace, inertia mismatch, norms."""

from tarc.analysis.inertia_ratio import InertiaSpread, inertia_spread
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.analysis.stability import stable_interval, stable_intervals
from tarc.analysis.workspace import Workspace
from tarc.numerics.norms import h2_norm, hinf_norm

__all__ = [
    "InertiaSpread",
    "Workspace",
    "best_inertia_shape",
    "h2_norm",
    "hinf_norm",
    "inertia_spread",
    "stable_interval",
    "stable_intervals",
]
