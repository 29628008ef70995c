"""Analysis of the linearised loop and of the robot: stable inertia ratios, workspace, inertia mismatch, norms."""

from tarc.analysis.inertia_ratio import InertiaSpread, inertia_spread
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.analysis.optimum import (
    LoopDeviations,
    OptimumDistance,
    distance_from_optimum,
    law_distances,
    least_change,
    least_error,
    loop_deviations,
    optimal_front,
)
from tarc.analysis.proven_spread import ProvenSpread, prove_inertia_spread
from tarc.analysis.stability import stable_interval, stable_intervals
from tarc.analysis.watched import watch_workspace
from tarc.analysis.workspace import Workspace
from tarc.numerics.norms import h2_norm, hinf_norm

__all__ = [
    "InertiaSpread",
    "LoopDeviations",
    "OptimumDistance",
    "ProvenSpread",
    "Workspace",
    "best_inertia_shape",
    "distance_from_optimum",
    "h2_norm",
    "hinf_norm",
    "inertia_spread",
    "law_distances",
    "least_change",
    "least_error",
    "loop_deviations",
    "optimal_front",
    "prove_inertia_spread",
    "stable_interval",
    "stable_intervals",
    "watch_workspace",
]
