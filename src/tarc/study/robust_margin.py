"""A certificate that is cheap enough for each trial of a search: the ball of inertia ratios that the loop tolerates."""

from collections.abc import Sequence

import numpy as np

from tarc.analysis.command_units import in_torque_units
from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.linearise import Channel, decoupled_channels, joints_share_loop, refuse_nominal_inertia
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.analysis.workspace import Workspace
from tarc.certificates.ball_centre import best_centre
from tarc.certificates.ball_radius import max_radius_any_rate
from tarc.core.errors import UnsupportedLaw
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.plants.base import Plant

SPREAD_SAMPLES = 500
"""Postures that are sampled for the inertia ratios of a robot."""
SPREAD_SEARCHES = 4
"""Samples from which a local search starts, for each end of the ratios."""


def margin_law(law: Law) -> PolePlacement:
    """Return a law that has a robust margin.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia M̂, and one with M̂(q) of a model. For gains that differ between the joints, and a
        robust term without a bound on its slope.
    """
    name = type(law).__name__
    if not isinstance(law, PolePlacement):
        raise UnsupportedLaw(f"margin: {name} has no inertia M̂, which the certificate of inertia ratios needs")
    refuse_nominal_inertia(law, "the margin of a search")
    if not joints_share_loop(law):
        raise UnsupportedLaw(f"margin: the joints of {name} have different gains, which the certificate does not cover")
    if not np.isfinite(law.robust_slope_bound):
        raise UnsupportedLaw(
            f"margin: nothing bounds the slope of the robust term of {name}, so that no certificate covers it"
        )
    return law


class RobustMargin:
    """The margin by which a loop tolerates the inertia ratios of a robot over a workspace.

        margin = δ / δ_needed − 1,    ‖E(t) − ρ0 I‖ ≤ δ for every E(t) that the loop tolerates, at any rate

    δ_needed is the radius about ρ0 that contains the eigenvalues of M(q)⁻¹M̂. It is the margin of
    `tarc.certificates.certify_varying_ratio` without a rate. The ratios are found once for each shape of M̂, and scale
    with M̂.

    Parameters
    ----------
    plants, workspace
        The robot with each payload, and its postures.
    computation_delay
        Periods between a measurement and its torque.
    """

    def __init__(self, plants: Sequence[Plant], workspace: Workspace, computation_delay: int = 0):
        self.plants = list(plants)
        self.workspace = workspace
        self.computation_delay = computation_delay
        self._ratios: dict[bytes, tuple[float, float]] = {}

    def ratio_range(self, law: PolePlacement) -> tuple[float, float]:
        """Return the smallest and the largest eigenvalue of M(q)⁻¹M̂ over the workspace."""
        law, plants = in_torque_units(law, self.plants)
        size = float(np.trace(law.M))
        shape: Array = law.M / size
        key = shape.round(9).tobytes()
        if key not in self._ratios:
            spread = inertia_spread(plants, shape, self.workspace, samples=SPREAD_SAMPLES, refine=SPREAD_SEARCHES)
            self._ratios[key] = spread.min_ratio, spread.max_ratio
        low, high = self._ratios[key]
        return size * low, size * high

    def of(self, law: Law, channels: Sequence[Channel] | None = None) -> float:
        """Return the margin of a law; −1 for a loop that is stable at no centre.

        Parameters
        ----------
        law
            The law.
        channels
            Its linearised loops with the computation delay, where they exist already.

        Raises
        ------
        UnsupportedLaw
            As `margin_law`.
        NotLinearisable
            For a law that has no linearisation at rest.
        """
        law = margin_law(law)
        channels = decoupled_channels(law, self.computation_delay) if channels is None else channels
        low, high = self.ratio_range(law)
        loop = UncertainLoop.from_channel(channels[0], law.robust_slope_bound, intersample=True)
        centre = best_centre(loop, (low, high))
        _, radius = max_radius_any_rate(loop, centre)
        return radius / max(high - centre, centre - low, centre / 1e3) - 1
