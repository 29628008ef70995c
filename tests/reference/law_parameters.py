"""Random designs of the laws on time-delay estimation, as plain numbers."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tarc import estimators, laws

PERIOD = 1e-3
"""Sampling period of all loops [s]."""


@dataclass(frozen=True)
class LawParameters:
    """A law in numbers, and the inertia ratio and slope of its robust term that it is to tolerate."""

    natural_frequency: float = 10.0
    damping_ratio: float = 1.0
    window: int = 10
    degree: int = 2
    cutoff: float = 0.0
    synchronised: bool = False
    delay_periods: int = 1
    computation_delay: int = 0
    actuation_delay: int = 0
    ratio: float = 0.1
    slope: float = 0.0
    P2: float = 1.0
    boundary_layer: float = 0.01
    gain_factor: float = 1.0

    @property
    def estimator(self) -> estimators.Estimator:
        """Filtered difference where there is a cutoff, plain where the window is zero, else the sliding window."""
        if self.cutoff:
            return estimators.FilteredDifference(cutoff=self.cutoff)
        if not self.window:
            return estimators.BackwardDifference()
        return estimators.Algebraic(window=self.window * PERIOD, degree=self.degree)

    @cached_property
    def law(self) -> laws.TDE:
        """The law of the package with these numbers: TARC where there is a robust term."""
        options: dict[str, Any] = {
            "inertia": 0.1,
            "natural_frequency": self.natural_frequency,
            "damping_ratio": self.damping_ratio,
            "period": PERIOD,
            "estimator": self.estimator,
            "synchronised": self.synchronised,
            "actuation_delay": self.actuation_delay,
            "delay": None if self.delay_periods == 1 else self.delay_periods * PERIOD,
        }
        if not self.slope:
            return laws.TDC(**options)
        weight = [2 * self.natural_frequency**2 * self.P2, 2.0]  # P2 = q1 / (2 K1)
        options |= {"lyapunov_weight": weight, "boundary_layer": self.boundary_layer, "gain_factor": self.gain_factor}
        return laws.TARC(rise_rate=100.0, fall_rate=100.0, **options)

    @property
    def alternates(self) -> bool:
        """Whether a torque that alternates from period to period is never damped: a pole at −1 for every ratio."""
        return not self.synchronised and (self.delay_periods + self.actuation_delay) % 2 == 0

    @property
    def frozen_gain(self) -> float:
        """The frozen ĉ [rad/s²] that makes the slope α ĉ P2/ε."""
        return self.slope * self.boundary_layer / (self.gain_factor * self.P2)


def draw_parameters(rng: np.random.Generator, robust: bool = False) -> LawParameters:
    """Return a random design, ratio and slope aside."""
    kind = rng.choice(["window", "difference", "filter"], p=[0.8, 0.08, 0.12])
    degree = int(rng.choice([2, 3], p=[0.75, 0.25]))
    synchronised = bool(rng.random() < 0.5)
    return LawParameters(
        natural_frequency=float(np.exp(rng.uniform(np.log(2), np.log(60)))),
        damping_ratio=float(rng.uniform(0.5, 2)),
        window=int(rng.integers(degree, 26)) if kind == "window" else 0,
        degree=degree,
        cutoff=float(np.exp(rng.uniform(np.log(50), np.log(2000)))) if kind == "filter" else 0.0,
        synchronised=synchronised,
        delay_periods=1 if synchronised or rng.random() < 0.9 else int(rng.choice([2, 3])),
        computation_delay=int(rng.choice([0, 1, 2, 3], p=[0.5, 0.2, 0.15, 0.15])),
        actuation_delay=int(rng.choice([1, 2, 3])) if rng.random() < 0.15 else 0,
        P2=float(np.exp(rng.uniform(-1, 1))) if robust else 1.0,
        boundary_layer=float(np.exp(rng.uniform(np.log(1e-3), np.log(0.1)))) if robust else 0.01,
        gain_factor=float(rng.uniform(1, 2)) if robust else 1.0,
    )
