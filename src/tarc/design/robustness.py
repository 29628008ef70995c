"""What a robot asks of the loop that is to move it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread
from tarc.analysis.operating_points import (
    NEGLIGIBLE_STIFFNESS,
    OperatingPoint,
    UncertaintySamples,
    add_stiffest,
    max_inertia_rate,
    refine_worst,
    sample_points,
    uncertainty_samples,
)
from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.plants.base import Plant

DAMPING_WEIGHT = 1.0
"""Of the damping beside the stiffness, over that for which both count as much."""


@dataclass(frozen=True)
class RobustnessSpec:
    """What a robot asks of a loop.

    Attributes
    ----------
    spread
        Greatest over least eigenvalue of M(q)⁻¹X.
    shares
        With weights η: radius over centre of the ball that holds [E − ρ0 I, H/η] for all postures, for M̂ = X and
        ρ0 = (1 + spread)/2, beside the damping; E and H as in `tarc.certificates.certify_robot`. Just one share,
        without
        weight, for a robot of neither.
    weights
        The η [1/s²].
    rate
        Greatest ‖dE⁻¹/dt‖ for M̂ = X [1/s]; infinite for a robot of any speed.
    stiffness
        Greatest ‖[H, C/lead]‖ [1/s²].
    lead
        By which the velocity counts beside the position [s].
    """

    spread: float
    radius_ratios: np.ndarray
    stiffness_weights: np.ndarray
    max_rate: float = np.inf
    stiffness: float = 0.0
    velocity_weight: float = 0.0

    @classmethod
    def from_spread(cls, spread: float, rate: float = np.inf) -> "RobustnessSpec":
        """Of a robot without stiffness and damping of its own."""
        spread = check.number("spread", spread, 1)
        return cls(spread, np.array([radius_ratio_of(spread)]), np.zeros(1), rate)

    @classmethod
    def from_samples(cls, spread: float, found: UncertaintySamples, rate: float = np.inf) -> "RobustnessSpec":
        """Of a robot with these mismatches and this greatest rate, for M̂ = X."""
        lead = DAMPING_WEIGHT * found.lead_time()
        stiffness, centre = float(found.stiffness_norms(lead).max()), (1 + spread) / 2
        if not stiffness > NEGLIGIBLE_STIFFNESS:
            return cls.from_spread(spread, rate)
        weights = np.array(found.candidate_weights(centre, lead)[::-1])
        norms = np.array([found.needed_radius(centre, float(weight), lead) for weight in weights])
        return cls(spread, np.maximum(norms / centre, radius_ratio_of(spread)), weights, rate, stiffness, lead)

    @classmethod
    def from_robot(
        cls,
        plants: Sequence[Plant],
        workspace: Workspace,
        shape: np.ndarray,
        found: InertiaSpread,
        *,
        seed: int = 0,
        search: bool = True,
    ) -> "RobustnessSpec":
        """Of a robot, for M̂ = X.

        Parameters
        ----------
        plants, workspace
            The robot with its least and its greatest payload; where and how fast it moves.
        shape
            X [kg m² or kg], shape (n, n).
        found
            The spread of M(q)⁻¹X, as `tarc.analysis.inertia_spread` finds it, from as many samples as are taken here.
        search
            Look for worse instants than the samples, as the certificate does.
        """
        ends = (plants[found.min_plant], found.min_posture), (plants[found.max_plant], found.max_posture)
        instants = [OperatingPoint.at_rest(*one) for one in ends] + sample_points(
            plants, workspace, found.samples, seed
        )
        mismatch = uncertainty_samples(shape, instants)
        lead = DAMPING_WEIGHT * mismatch.lead_time()
        stiffness, middle = float(mismatch.stiffness_norms(lead).max()), (1 + found.ratio) / 2
        if search and stiffness > NEGLIGIBLE_STIFFNESS:
            units = workspace.unit_samples(found.samples, seed)
            instants, mismatch = add_stiffest(instants, mismatch, workspace, units, shape, lead)
            for eta in mismatch.candidate_weights(middle, lead)[::2]:
                instants, mismatch = refine_worst(instants, mismatch, workspace, units, shape, middle, eta, lead)
        rate = max_inertia_rate(plants, shape, workspace, found.samples, seed)
        return cls.from_samples(found.ratio, mismatch, rate)


def radius_ratio_of(spread: float) -> float:
    """Radius over centre of the interval whose ends have this ratio."""
    return (spread - 1) / (spread + 1)


def spread_of(share: float) -> float:
    """The reverse of `share_of`."""
    return (1 + share) / (1 - share) if share < 1 else np.inf
