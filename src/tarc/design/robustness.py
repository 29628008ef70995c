"""The robustness that a robot requires of its loop."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tarc.analysis.inertia_rate import max_inertia_rate
from tarc.analysis.inertia_ratio import InertiaSpread
from tarc.analysis.operating_points import NEGLIGIBLE_STIFFNESS, UncertaintySamples
from tarc.analysis.workspace import Workspace
from tarc.analysis.worst_points import SampledPoints
from tarc.core import validation as check
from tarc.plants.base import Plant

DAMPING_WEIGHT = 1.0
"""Weight of the robot's damping, over the one that makes stiffness and damping equal."""


@dataclass(frozen=True)
class RobustnessSpec:
    """The robustness that a robot requires of its loop, for M̂ = X.

    E = M(q)⁻¹X is the inertia ratio, and H and C are the robot's own stiffness and damping, as in
    `tarc.certificates.certify_robot`. With ρ0 = (1 + spread)/2, the loop must be stable for ‖[E − ρ0 I, H/η]‖ up to
    the radius ratio times ρ0, for one of the weights η. The damping C counts beside H.

    Attributes
    ----------
    spread
        Largest over smallest eigenvalue of M(q)⁻¹X.
    radius_ratios
        Radius over centre of the ball that contains every operating point, for each weight. It has one entry, without
        a weight, for a robot without stiffness and damping.
    stiffness_weights
        The weights η [1/s²].
    max_rate
        Largest ‖dE⁻¹/dt‖ [1/s]; infinite for a robot of any speed.
    stiffness
        Largest ‖[H, C/velocity_weight]‖ [1/s²].
    velocity_weight
        Weight of the velocity beside the position [s].
    """

    spread: float
    radius_ratios: np.ndarray
    stiffness_weights: np.ndarray
    max_rate: float = np.inf
    stiffness: float = 0.0
    velocity_weight: float = 0.0

    @classmethod
    def from_spread(cls, spread: float, rate: float = np.inf) -> "RobustnessSpec":
        """Return the robustness for a robot without stiffness and damping.

        Raises
        ------
        InvalidParameter
            For a spread that is not finite or below 1.
        """
        spread = check.number("spread", spread, 1)
        return cls(spread, np.array([radius_ratio_of(spread)]), np.zeros(1), rate)

    @classmethod
    def from_samples(cls, spread: float, samples: UncertaintySamples, rate: float = np.inf) -> "RobustnessSpec":
        """Return the robustness for sampled uncertainty, without and with friction, and a largest rate [1/s]."""
        samples = samples.with_friction()
        lead = DAMPING_WEIGHT * samples.lead_time()
        stiffness, centre = float(samples.stiffness_norms(lead).max()), (1 + spread) / 2
        if not stiffness > NEGLIGIBLE_STIFFNESS:
            return cls.from_spread(spread, rate)
        weights = np.array(samples.candidate_weights(centre, lead)[::-1])
        norms = np.array([samples.needed_radius(centre, float(weight), lead) for weight in weights])
        return cls(spread, np.maximum(norms / centre, radius_ratio_of(spread)), weights, rate, stiffness, lead)

    @classmethod
    def from_robot(
        cls,
        plants: Sequence[Plant],
        workspace: Workspace,
        shape: np.ndarray,
        spread: InertiaSpread,
        *,
        seed: int = 0,
        search: bool = True,
    ) -> "RobustnessSpec":
        """Return the robustness for a robot.

        Parameters
        ----------
        plants, workspace
            The robot with its smallest and its largest payload, and its postures and speeds.
        shape
            X [kg m² or kg], shape (n, n).
        spread
            Spread of M(q)⁻¹X, as `tarc.analysis.inertia_spread` finds it; as many samples are taken here.
        seed
            Seed of the sampled postures.
        search
            Search for worse operating points than the samples, as the certificate does.
        """
        sampled = SampledPoints.from_robot(plants, spread, shape, workspace, spread.samples, seed)
        lead = DAMPING_WEIGHT * sampled.uncertainty.lead_time()
        stiffness, centre = float(sampled.uncertainty.stiffness_norms(lead).max()), (1 + spread.ratio) / 2
        if search and stiffness > NEGLIGIBLE_STIFFNESS:
            sampled = sampled.add_stiffest(lead)
            for weight in sampled.uncertainty.candidate_weights(centre, lead)[::2]:
                sampled = sampled.refine_worst(centre, weight, lead)
        rate = max_inertia_rate(plants, shape, workspace, spread.samples, seed)
        return cls.from_samples(spread.ratio, sampled.uncertainty, rate)


def radius_ratio_of(spread: float) -> float:
    """Return radius over centre of an interval, from the ratio of its ends."""
    return (spread - 1) / (spread + 1)


def spread_of(radius_ratio: float) -> float:
    """Return the ratio of the ends of an interval, from its radius over centre."""
    return (1 + radius_ratio) / (1 - radius_ratio) if radius_ratio < 1 else np.inf
