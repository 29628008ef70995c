"""What samples and searches have found of a robot in a workspace, for every law with a multiple of the same M̂."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tarc.analysis.inertia_rate import max_rate_point
from tarc.analysis.inertia_ratio import InertiaSpread, inertia_spread
from tarc.analysis.point_functions import GrownNorm
from tarc.analysis.workspace import Workspace
from tarc.analysis.worst_points import SampledPoints
from tarc.certificates.robot_evidence import MaxRatePoint
from tarc.core.types import Array
from tarc.plants.base import Plant

MAX_STIFFNESS_SAMPLES = 500
"""Largest number of postures whose stiffness is computed; it varies less than the eigenvalues of the inertia."""
SAME_SHAPE = 1e-12
"""Relative difference up to which one M̂ is a multiple of another."""


@dataclass(eq=False)
class RobotPoints:
    """Inertia ratios and operating points of a robot in a workspace, and where its inertia changes fastest.

    A search adds what it finds to `sampled`. So the next law meets the worst points of those before it as well.

    Attributes
    ----------
    plants
        The robot, or several.
    nominal
        M̂ [kg m² or kg], shape (n, n).
    workspace
        The postures and their speeds.
    samples, seed
        Number of sampled postures, and the seed.
    spread
        Inertia ratios.
    sampled
        Operating points.
    is_searched
        Whether local searches have added worst points, for this M̂ or a multiple.
    """

    plants: tuple[Plant, ...]
    nominal: Array
    workspace: Workspace
    samples: int
    seed: int
    spread: InertiaSpread
    sampled: SampledPoints
    is_searched: bool = False
    _rate_points: dict[str, MaxRatePoint] = field(default_factory=dict)
    _searched: set[tuple[float, ...]] = field(default_factory=set)

    @classmethod
    def from_robot(
        cls, plants: Sequence[Plant], nominal: Array, workspace: Workspace, *, samples: int = 2000, seed: int = 0
    ) -> "RobotPoints":
        """Return the points of a robot, before any search but that for the extreme ratios.

        Parameters
        ----------
        plants, nominal, workspace, samples, seed
            As the attributes.

        Raises
        ------
        InvalidParameter
            As in `tarc.analysis.inertia_spread`.
        """
        spread = inertia_spread(plants, nominal, workspace, samples=samples, seed=seed)
        workspace = workspace.for_joints(plants[0].joint_names)
        n_points = min(samples, MAX_STIFFNESS_SAMPLES)
        sampled = SampledPoints.from_robot(plants, spread, nominal, workspace, n_points, seed)
        return cls(tuple(plants), nominal, workspace, samples, seed, spread, sampled)

    def for_inertia(self, nominal: Array) -> "RobotPoints":
        """Return the points for another M̂: these for the same, these scaled for a multiple, else new ones."""
        scale = float(np.trace(nominal) / np.trace(self.nominal))
        if not np.allclose(nominal, scale * self.nominal, rtol=0, atol=SAME_SHAPE * np.max(np.abs(nominal))):
            return self.from_robot(self.plants, nominal, self.workspace, samples=self.samples, seed=self.seed)
        if np.array_equal(nominal, self.nominal):
            return self
        ratios = ("min_ratio", "max_ratio", "sampled_min", "sampled_max")
        return replace(
            self,
            nominal=nominal,
            spread=replace(self.spread, **{name: scale * getattr(self.spread, name) for name in ratios}),
            sampled=self.sampled.scaled(nominal, scale),
            _searched=set(),
        )

    def max_rate_point(self) -> MaxRatePoint | None:
        """Return where M̂^−½ M M̂^−½ changes fastest; None for a workspace without a speed."""
        return self._rate_point("nominal", self.nominal)

    def max_relative_rate_point(self) -> MaxRatePoint | None:
        """Return where M changes fastest relative to itself; None for a workspace without a speed."""
        return self._rate_point("relative", None)

    def _rate_point(self, kind: str, nominal: Array | None) -> MaxRatePoint | None:
        if self.workspace.speed is None:
            return None
        if kind not in self._rate_points:  # a multiple of M̂ has it in the same posture
            n_points = min(self.samples, MAX_STIFFNESS_SAMPLES)
            point = max_rate_point(self.plants, nominal, self.workspace, n_points, self.seed)
            self._rate_points[kind] = MaxRatePoint.from_point(point, self.workspace)
        return self._rate_points[kind]

    def search_globally(self, norm: GrownNorm) -> None:
        """Add the worst points for a norm, see `SampledPoints.search_globally`; once for each."""
        key = norm.centre, norm.position_weight, norm.lead_time, norm.share
        if key not in self._searched:
            self.sampled = self.sampled.search_globally(norm)
            self._searched.add(key)
