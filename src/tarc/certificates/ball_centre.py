"""The centre of the ball that contains most, or a range of inertia ratios with the largest margin."""

from typing import NamedTuple

import numpy as np

from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop
from tarc.certificates.ball import RadiusProof
from tarc.certificates.ball_radius import max_radius
from tarc.certificates.iqc import CLOSE_RANGE, best_multiplier
from tarc.core.errors import NoStableRatio
from tarc.core.types import Array
from tarc.numerics.interval_minimum import minimise_in_interval

FEW_FREQUENCIES = 150
"""Number of frequencies of the grid on which balls are compared, before the best ones are proven at all frequencies."""
CENTRE_FACTORS = 0.94, 0.88, 0.82
"""Factors on the best centre of the grid, to try others."""
NO_BALL = 1e-3
"""Radius over centre up to which a ball counts as none, such as rounding leaves for a mode on the unit circle."""


def best_centre(loop: UncertainLoop, ratio_range: tuple[float, float] | None, max_change: float | None = None) -> float:
    """Return the centre whose ball has the largest quotient of its ends, or contains a range with the largest margin.

    Raises
    ------
    NoStableRatio
        For a loop that is stable for no ratio, without a range.
    """
    responses = FrequencyResponses(loop) if max_change is None else FrequencyResponses(loop, count=FEW_FREQUENCIES)
    search = _CentreSearch(loop, responses, ratio_range)
    if ratio_range is None:
        best = search.refine(np.log(np.geomspace(1e-4, 10.0, 33)), None, 1e-4 if max_change is None else 2e-2)
        if search.value(best, None) <= NO_BALL:
            raise NoStableRatio(
                "varying ratio: no inertia ratio makes this loop stable; use a shorter window, a lower natural "
                "frequency, a smaller slope or less computation delay"
            )
        if max_change is not None:  # with a rate the best centre is a little higher
            best = search.refine(best + np.log([0.8, 1.0, 1.25, 1.5, 1.8]), max_change, 1e-2)
        return float(np.exp(best))
    low, high = ratio_range
    tolerance = 1e-4 if max_change is None else 2e-2
    best = search.refine(np.log(np.linspace(low, high, 9) if high > low else np.array([low])), None, tolerance)
    if max_change is not None:
        best = search.refine(np.sort([best, np.log((low + high) / 2)]), max_change, 1e-2)
    return float(np.exp(best))


class _CentreSearch(NamedTuple):
    """Search for the best centre, over its logarithm."""

    loop: UncertainLoop
    responses: FrequencyResponses
    ratio_range: tuple[float, float] | None

    def value(self, log_centre: float, max_change: float | None, least: float = 0.0) -> float:
        """Return the radius over the centre, or over the radius that contains the range; negative if unstable.

        The search for it ends where it cannot become the ``least``.
        """
        centre = float(np.exp(log_centre))
        spectral_radius = float(np.max(np.abs(np.linalg.eigvals(self.loop.closed_loop(centre)[0]))))
        if spectral_radius >= 1:
            return -spectral_radius
        needed = centre if self.ratio_range is None else self._needed_radius(centre, *self.ratio_range)
        if max_change is None:
            return self.responses.best_scale(centre)[1] / needed
        options = {"responses": self.responses, "least": least * needed, "close": CLOSE_RANGE}
        return best_multiplier(self.loop, centre, max_change, **options)[1] / needed

    @staticmethod
    def _needed_radius(centre: float, low: float, high: float) -> float:
        return max(high - centre, centre - low, 1e-12)

    def refine(self, log_centres: Array, max_change: float | None, tolerance: float) -> float:
        """Return the best of some log centres, refined between its neighbours."""
        values: list[float] = []
        for log_centre in log_centres:
            values.append(self.value(log_centre, max_change, least=max(values, default=0.0)))
        top = int(np.argmax(values))
        ends = log_centres[max(top - 1, 0)], log_centres[min(top + 1, len(log_centres) - 1)]
        if ends[0] == ends[1] or values[top] <= NO_BALL:
            return log_centres[top]
        refined, negative = minimise_in_interval(
            lambda log_centre: -self.value(log_centre, max_change), *ends, tolerance
        )
        return refined if -negative > values[top] else log_centres[top]


def best_ball(loop: UncertainLoop, max_change: float | None) -> tuple[float, RadiusProof, float]:
    """Return centre, proof and radius of the ball with the largest quotient of its ends.

    The best centre on the grid of frequencies need not be the best at all frequencies, so others are tried.
    """
    centre = best_centre(loop, None, max_change)
    proof, radius = max_radius(loop, centre, max_change=max_change)
    for factor in CENTRE_FACTORS if max_change is not None else ():
        other_proof, other_radius = max_radius(loop, factor * centre, max_change=max_change)
        if other_radius > factor * radius:
            return factor * centre, other_proof, other_radius
    return centre, proof, radius
