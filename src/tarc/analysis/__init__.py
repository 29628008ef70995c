"""Analysis of the linearised loop and of the robot: stable inertia ratios, workspace, inertia mismatch, norms."""

from tarc.analysis.inertia_ratio import Spread, spread
from tarc.analysis.inertia_shape import best_shape
from tarc.analysis.stability import stable_interval, stable_intervals
from tarc.analysis.workspace import Workspace
from tarc.numerics.norms import h2_norm, hinf_norm

__all__ = [
    "Spread",
    "Workspace",
    "best_shape",
    "h2_norm",
    "hinf_norm",
    "spread",
    "stable_interval",
    "stable_intervals",
]
