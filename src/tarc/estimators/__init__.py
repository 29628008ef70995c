"""Velocity and acceleration from positions alone, all causal."""

from tarc.estimators.algebraic import Algebraic
from tarc.estimators.base import Estimate, Estimator
from tarc.estimators.difference import BackwardDifference, FilteredDifference

__all__ = ["Algebraic", "BackwardDifference", "Estimate", "Estimator", "FilteredDifference"]
