"""Causal estimators of velocity and acceleration from positions alone."""

from tarc.estimators.algebraic import Algebraic
from tarc.estimators.base import Estimate, Estimator
from tarc.estimators.difference import BackwardDifference, FilteredDifference
from tarc.estimators.differentiator import RobustDifferentiator
from tarc.estimators.high_gain import HighGain
from tarc.estimators.kalman import Kalman
from tarc.estimators.oracle import TrueDerivatives

__all__ = [
    "Algebraic",
    "BackwardDifference",
    "Estimate",
    "Estimator",
    "FilteredDifference",
    "HighGain",
    "Kalman",
    "RobustDifferentiator",
    "TrueDerivatives",
]
