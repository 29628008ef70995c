"""The worst operating points of a robot over a workspace, by samples and local search with exact derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread
from tarc.analysis.operating_points import NEGLIGIBLE_STIFFNESS, OperatingPoint, UncertaintySamples, uncertainty_samples
from tarc.analysis.point_functions import ForceNorm, PointFunction, UncertaintyFunction, UncertaintyNorm
from tarc.analysis.point_search import N_SEARCHES, maximise_motion, maximise_posture
from tarc.analysis.workspace import Workspace
from tarc.core.types import Array
from tarc.plants.base import Plant

FRESH_SAMPLES = 2
"""Fresh samples of a global search over those that there are."""
N_STARTS = 5
"""Number of points at rest, moving and turned from which a global search climbs."""
N_TURNED = 10
"""Number of points whose joints are turned."""
MAX_TURNING_ROUNDS = 3
"""Largest number of rounds in which joints are turned."""
QUARTER_TURNS = np.pi / 2, -np.pi / 2, np.pi, -np.pi
"""Angles [rad] by which joints are turned."""
NEGLIGIBLE_GROWTH = 1e-4
"""Share by which a largest value must grow for another restart."""


@dataclass(frozen=True, eq=False)
class SampledPoints:
    """Operating points of a robot in a workspace, with the uncertainty at each.

    Attributes
    ----------
    nominal
        M̂ [kg m² or kg], shape (n, n).
    workspace
        The postures and their speeds.
    plants
        The robot, or several.
    unit_samples
        The sampled variables of the workspace on the unit cube, shape (k, v).
    seed
        Seed of the samples.
    points
        The points; the first two are those of the smallest and the largest inertia ratio at rest.
    uncertainty
        Their linearised uncertainty.
    """

    nominal: Array
    workspace: Workspace
    plants: tuple[Plant, ...]
    unit_samples: Array
    seed: int
    points: list[OperatingPoint]
    uncertainty: UncertaintySamples
    _fresh: dict[str, tuple[list[OperatingPoint], UncertaintySamples]] = field(default_factory=dict)

    @classmethod
    def from_robot(
        cls,
        plants: Sequence[Plant],
        spread: InertiaSpread,
        nominal: Array,
        workspace: Workspace,
        samples: int,
        seed: int,
    ) -> "SampledPoints":
        """Return the two postures of the extreme inertia ratios, and sampled points.

        Parameters
        ----------
        plants
            The robot, or several.
        spread
            Inertia ratios of the robot for this M̂ and workspace.
        nominal
            M̂ [kg m² or kg], shape (n, n).
        workspace
            The postures and their speeds.
        samples, seed
            Number of sampled postures, and the seed.
        """
        extremes = (spread.min_plant, spread.min_posture), (spread.max_plant, spread.max_posture)
        points = [OperatingPoint.at_rest(plants[index], posture) for index, posture in extremes]
        points += sample_points(plants, workspace, samples, seed)
        unit_samples = workspace.unit_samples(samples, seed)
        uncertainty = uncertainty_samples(nominal, points)
        return cls(nominal, workspace, tuple(plants), unit_samples, seed, points, uncertainty)

    def scaled(self, nominal: Array, scale: float) -> "SampledPoints":
        """Return the points for an M̂ that is a multiple of this one, which scales E and leaves H and C."""

        points, samples = self._fresh_points()
        fresh = {"points": (points, samples.for_scaled_inertia(scale))}
        return replace(self, nominal=nominal, uncertainty=self.uncertainty.for_scaled_inertia(scale), _fresh=fresh)

    def refine_worst(self, centre: float, position_weight: float, lead_time: float) -> "SampledPoints":
        """Return the points with those that a local search for the largest joint norm adds.

        The search starts from the points of the largest norms, from the stiffest, and from the first two.
        """
        norm = UncertaintyNorm(self.nominal, centre, position_weight, lead_time)
        stiffest = int(np.argmax(self.uncertainty.stiffness_norms(lead_time)))
        worst = np.argsort(self.uncertainty.joint_norms(centre, position_weight, lead_time))[::-1][:N_SEARCHES]
        starts = [self.points[i] for i in dict.fromkeys([0, 1, stiffest, *worst.tolist()])]
        return self._with_points(
            [maximise_motion(self._maximise_posture(start, norm, centre), self.workspace, norm) for start in starts]
        )

    def search_globally(self, function: UncertaintyFunction) -> "SampledPoints":
        """Return the points with those that a search over the whole workspace for the largest value adds.

        Local searches start from the best of fresh samples, at rest and moving, and from the first two points. From the
        best of what they find, one or two joints are then turned by quarters of a turn. Postures that differ so have
        similar inertias, but another stiffness. This is repeated until it adds no larger value.

        Parameters
        ----------
        function
            What is to be large, such as the norm that decides a certificate.
        """
        fresh, fresh_uncertainty = self._fresh_points()
        candidates = [*self.points, *fresh]
        values = np.concatenate(
            [function.norms(part) for samples in (self.uncertainty, fresh_uncertainty) for part in samples.parts()]
        )
        scale = max(float(values.max()), NEGLIGIBLE_STIFFNESS)
        is_moving = np.array([point.is_moving for point in candidates])
        starts = self._with_every_plant(self.points[:2])
        for included in (is_moving, ~is_moving):  # at rest the worst posture is another one
            order = np.argsort(np.where(included, values, -np.inf))[::-1][:N_STARTS]
            starts += [candidates[i] for i in order if included[i]]
        maxima = [self._climb(start, function, scale) for start in starts]
        largest = 0.0
        for _ in range(MAX_TURNING_ROUNDS):
            values_of_maxima = function.values(maxima)
            if values_of_maxima.max() <= (1 + NEGLIGIBLE_GROWTH) * largest:
                break
            largest = float(values_of_maxima.max())
            order = np.argsort(values_of_maxima)[::-1]
            resting, moving = ([maxima[i] for i in order if maxima[i].is_moving is kind] for kind in (False, True))
            best = [*resting[:N_TURNED], *moving[:N_TURNED]]
            turned = [point for start in best for point in self._turned(start)]
            if not turned:
                break
            order = np.argsort(function.values(turned))[::-1][:N_STARTS]
            maxima = [*best, *(self._climb(turned[i], function, scale) for i in order)]
        order = np.argsort(function.values(maxima))[::-1][:N_SEARCHES]
        return self._with_points([maxima[i] for i in order])

    def _fresh_points(self) -> tuple[list[OperatingPoint], UncertaintySamples]:
        """Return samples that no search has seen, the same for all searches, and their uncertainty."""
        if "points" not in self._fresh:
            n_postures = FRESH_SAMPLES * len(self.unit_samples)
            points = sample_points(self.plants, self.workspace, n_postures, self.seed + 1)
            self._fresh["points"] = points, uncertainty_samples(self.nominal, points)
        return self._fresh["points"]

    def _climb(self, start: OperatingPoint, function: PointFunction, scale: float) -> OperatingPoint:
        """Return a point of larger value, by posture and motion in turn."""
        moved = maximise_motion(start, self.workspace, function)
        return maximise_motion(self._maximise_posture(moved, function, scale), self.workspace, function)

    def _turned(self, start: OperatingPoint) -> list[OperatingPoint]:
        """Return the point with one or two joints turned by quarters, where a box of postures contains it."""
        low, high = self.workspace.low, self.workspace.high
        if self.workspace.reference is not None:
            return []
        n = len(low)
        turns = [np.eye(n)[i] * angle for i in range(n) for angle in QUARTER_TURNS]
        both = [first + second for first, second in combinations(turns, 2) if not np.any((first != 0) & (second != 0))]
        postures = start.position + np.array([*turns, *both])
        inside = np.all((postures >= low) & (postures <= high), axis=1)
        return self._with_every_plant([start._replace(position=posture) for posture in postures[inside]])

    def _with_every_plant(self, points: Sequence[OperatingPoint]) -> list[OperatingPoint]:
        return [point._replace(plant=plant) for point in points for plant in self.plants]

    def add_stiffest(self, lead_time: float) -> "SampledPoints":
        """Return the points with those that a local search for the largest ‖[H, C/θ]‖ adds."""
        return self._add_largest(UncertaintyNorm(self.nominal, None, 1.0, lead_time))

    def add_largest_force(self, lead_time: float) -> "SampledPoints":
        """Return the points with those that a local search for the largest ‖E⁻¹[H, C/θ]‖ adds."""
        return self._add_largest(ForceNorm(self.nominal, lead_time))

    def _add_largest(self, function: UncertaintyFunction) -> "SampledPoints":
        """Return the points with those that local searches from the points of the largest values add."""
        values = function.norms(self.uncertainty)
        scale = max(float(values.max()), NEGLIGIBLE_STIFFNESS)
        starts = np.argsort(values)[::-1][:N_SEARCHES]
        return self._with_points([self._climb(self.points[i], function, scale) for i in starts])

    def _with_points(self, points: list[OperatingPoint]) -> "SampledPoints":
        """Return the points with those found, each with every plant."""
        added = self._with_every_plant(points)
        uncertainty = self.uncertainty.with_more(uncertainty_samples(self.nominal, added))
        return replace(self, points=[*self.points, *added], uncertainty=uncertainty)

    def _maximise_posture(self, start: OperatingPoint, function: PointFunction, scale: float) -> OperatingPoint:
        return maximise_posture(start, self.workspace, self.unit_samples, function, scale)


def sample_points(plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int) -> list[OperatingPoint]:
    """Return each robot at rest in sampled postures, then moving there if the workspace has speeds.

    There each joint moves and accelerates at its limit, in one direction or the other at random.
    """
    postures = workspace.sample(samples, seed)
    at_rest = [OperatingPoint.at_rest(plant, posture) for posture in postures for plant in plants]
    if workspace.speed is None or workspace.acceleration is None or not np.any(workspace.speed):
        return at_rest
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(len(postures), 2, workspace.n_joints))
    return at_rest + [
        OperatingPoint(plant, posture, sign[0] * workspace.speed, sign[1] * workspace.acceleration)
        for posture, sign in zip(postures, signs, strict=True)
        for plant in plants
    ]
