"""The worst operating points of a robot over a workspace, by samples and local search with exact derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, product
from typing import Protocol

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread
from tarc.analysis.operating_points import (
    NEGLIGIBLE_STIFFNESS,
    OperatingPoint,
    UncertaintySamples,
    linearise_point,
    matrix_roots,
    uncertainty_samples,
)
from tarc.analysis.workspace import Workspace
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.numerics.local_search import local_maximum
from tarc.plants.base import Plant

N_SEARCHES = 3
"""Number of points from which a local search starts."""
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
MAX_CORNER_JOINTS = 9
"""Number of joints up to which all combinations of their largest speeds are tried."""
MAX_MOTION_CHANGES = 3
"""Largest number of joints whose speed or acceleration a search changes."""


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
            [_maximise_motion(self._maximise_posture(start, norm, centre), self.workspace, norm) for start in starts]
        )

    def search_globally(self, function: "UncertaintyFunction") -> "SampledPoints":
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

    def _climb(self, start: OperatingPoint, function: "PointFunction", scale: float) -> OperatingPoint:
        """Return a point of larger value, by posture and motion in turn."""
        moved = _maximise_motion(start, self.workspace, function)
        return _maximise_motion(self._maximise_posture(moved, function, scale), self.workspace, function)

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
        norm = UncertaintyNorm(self.nominal, None, 1.0, lead_time)

        def search(start: OperatingPoint) -> OperatingPoint:
            moving = _maximise_motion(start, self.workspace, norm)
            return _maximise_motion(self._maximise_posture(moving, norm, scale), self.workspace, norm)

        sampled_norms = self.uncertainty.stiffness_norms(lead_time)
        scale = max(float(sampled_norms.max()), NEGLIGIBLE_STIFFNESS)
        return self._with_points([search(self.points[i]) for i in np.argsort(sampled_norms)[::-1][:N_SEARCHES]])

    def add_largest_force(self, lead_time: float) -> "SampledPoints":
        """Return the points with those that a local search for the largest ‖E⁻¹[H, C/θ]‖ adds."""
        norm = ForceNorm(self.nominal, lead_time)

        def search(start: OperatingPoint) -> OperatingPoint:
            moving = _maximise_motion(start, self.workspace, norm)
            return _maximise_motion(self._maximise_posture(moving, norm, scale), self.workspace, norm)

        sampled_norms = self.uncertainty.force_norms(lead_time)
        scale = max(float(sampled_norms.max()), NEGLIGIBLE_STIFFNESS)
        return self._with_points([search(self.points[i]) for i in np.argsort(sampled_norms)[::-1][:N_SEARCHES]])

    def _with_points(self, points: list[OperatingPoint]) -> "SampledPoints":
        """Return the points with those found, each with every plant."""
        added = self._with_every_plant(points)
        uncertainty = self.uncertainty.with_more(uncertainty_samples(self.nominal, added))
        return replace(self, points=[*self.points, *added], uncertainty=uncertainty)

    def _maximise_posture(self, start: OperatingPoint, function: "PointFunction", scale: float) -> OperatingPoint:
        return _maximise_posture(start, self.workspace, self.unit_samples, function, scale)


class PointFunction(Protocol):
    """A function of operating points, which a local search makes large."""

    def values(self, points: Sequence[OperatingPoint]) -> Array:
        """Return the number of each of k points, shape (k,)."""
        ...

    def value_and_gradient(self, point: OperatingPoint) -> tuple[float, Array]:
        """Return the number of a point and its derivatives over the posture, shape (n,)."""
        ...


class UncertaintyFunction(PointFunction, Protocol):
    """One that the linearised uncertainty of a point determines."""

    def norms(self, samples: UncertaintySamples) -> Array:
        """Return the number of each of k points, shape (k,)."""
        ...


@dataclass(frozen=True, eq=False)
class UncertaintyNorm:
    """The norm ‖[E − ρ0 I, H/η, C/(η θ)]‖, or ‖[H, C/θ]‖/η without a centre.

    With u and w the singular vectors of the norm σ of K = M̂^½ M⁻¹ X − [ρ0 I, 0, 0], its derivatives are those of

        uᵀ M̂^½ M⁻¹ (dX − dM M⁻¹ X) w,    X = [M̂^½, (∂(M q̈ + N)/∂q) M̂^−½/η, (∂N/∂q̇) M̂^−½/(η θ)].

    Parameters
    ----------
    nominal
        M̂ [kg m² or kg], shape (n, n).
    centre
        ρ0; None to leave E out.
    position_weight, lead_time
        η [1/s²] and θ [s]; without a lead time C is left out.
    """

    nominal: Array
    centre: float | None
    position_weight: float
    lead_time: float

    def values(self, points: Sequence[OperatingPoint]) -> Array:
        """Return the norms of k points, shape (k,)."""
        return self.norms(uncertainty_samples(self.nominal, points))

    def norms(self, samples: UncertaintySamples) -> Array:
        """Return the norms of k points, shape (k,)."""
        if self.centre is None:
            return samples.stiffness_norms(self.lead_time) / self.position_weight
        return samples.joint_norms(self.centre, self.position_weight, self.lead_time)

    def value_and_gradient(self, point: OperatingPoint) -> tuple[float, Array]:
        """Return the norm of a point and its derivatives over the posture, shape (n,)."""
        M, D, G = linearise_point(point)
        root, inverse_root = self._roots
        n = len(M)
        position_share = 1 / self.position_weight
        velocity_share = position_share / self.lead_time if self.lead_time and point.is_moving else 0.0
        inertia_part = 0 * root if self.centre is None else root
        X = np.hstack([inertia_part, position_share * G @ inverse_root, velocity_share * D @ inverse_root])
        K = root @ np.linalg.solve(M, X)
        K[:, :n] -= (self.centre or 0.0) * np.eye(n)
        left, norms, right = np.linalg.svd(K, full_matrices=False)
        u, w = left[:, 0], right[0]
        p, y = np.linalg.solve(M, np.column_stack([root @ u, X @ w])).T
        of_inertia = -np.outer(p, y)
        of_stiffness = position_share * np.outer(p, inverse_root @ w[n : 2 * n])
        of_damping = velocity_share * np.outer(p, inverse_root @ w[2 * n :])
        weight = np.hstack([of_inertia, of_damping, of_stiffness])
        gradient = point.plant.tangent_gradient(point.position, weight, point.velocity, point.acceleration)
        if np.any(of_damping):  # C leaves out the damping at rest
            at_rest = np.hstack([0 * of_inertia, of_damping, 0 * of_stiffness])
            gradient = gradient - point.plant.tangent_gradient(point.position, at_rest)
        return float(norms[0]), gradient

    @cached_property
    def _roots(self) -> tuple[Array, Array]:
        return matrix_roots(self.nominal)


@dataclass(frozen=True, eq=False)
class GrownNorm:
    """The larger norm of the two points of `UncertaintySamples.grown`, which decides the robot certificate.

    What happens within a period is left out; it adds a few per cent of stiffness and damping.

    With f = 1 + share they are f ‖[E − ρ0/f I, H/η, C/(η θ)]‖ and ‖[E − f ρ0 I, f² H/η, f² C/(η θ)]‖/f.

    Parameters
    ----------
    nominal, centre, position_weight, lead_time
        As in `UncertaintyNorm`.
    share
        Growth of ratios, stiffness and damping.
    """

    nominal: Array
    centre: float
    position_weight: float
    lead_time: float
    share: float

    def values(self, points: Sequence[OperatingPoint]) -> Array:
        """Return the norms of k points, shape (k,)."""
        return self.norms(uncertainty_samples(self.nominal, points))

    def norms(self, samples: UncertaintySamples) -> Array:
        """Return the norms of k points, shape (k,)."""
        norms = samples.grown(self.share).joint_norms(self.centre, self.position_weight, self.lead_time)
        return norms.reshape(-1, len(samples.inertia)).max(axis=0)

    def value_and_gradient(self, point: OperatingPoint) -> tuple[float, Array]:
        """Return the norm of a point and its derivatives over the posture, shape (n,)."""
        factor = 1 + self.share
        lighter = UncertaintyNorm(self.nominal, self.centre / factor, self.position_weight, self.lead_time)
        heavier = UncertaintyNorm(self.nominal, factor * self.centre, self.position_weight / factor**2, self.lead_time)
        pairs = [(factor, lighter), (1 / factor, heavier)]
        scale, norm = max(pairs, key=lambda pair: pair[0] * pair[1].values([point])[0])
        value, gradient = norm.value_and_gradient(point)
        return scale * value, scale * gradient


@dataclass(frozen=True, eq=False)
class ForceNorm:
    """The norm ‖E⁻¹[H, C/θ]‖ = ‖M̂^−½ [∂(M q̈ + N)/∂q, (∂N/∂q̇)/θ] M̂^−½‖, linear in G and D.

    Parameters
    ----------
    nominal
        M̂ [kg m² or kg], shape (n, n).
    lead_time
        θ [s]; zero to leave the damping out.
    """

    nominal: Array
    lead_time: float

    def values(self, points: Sequence[OperatingPoint]) -> Array:
        """Return the norms of k points, shape (k,)."""
        return self.norms(uncertainty_samples(self.nominal, points))

    def norms(self, samples: UncertaintySamples) -> Array:
        """Return the norms of k points, shape (k,)."""
        return samples.force_norms(self.lead_time)

    def value_and_gradient(self, point: OperatingPoint) -> tuple[float, Array]:
        """Return the norm of a point and its derivatives over the posture, shape (n,)."""
        _, D, G = linearise_point(point)
        inverse_root = matrix_roots(self.nominal)[1]
        n = len(G)
        velocity_share = 1 / self.lead_time if self.lead_time and point.is_moving else 0.0
        K = np.hstack([inverse_root @ G @ inverse_root, velocity_share * inverse_root @ D @ inverse_root])
        left, norms, right = np.linalg.svd(K, full_matrices=False)
        p, of_position, of_velocity = (
            inverse_root @ left[:, 0],
            inverse_root @ right[0, :n],
            inverse_root @ right[0, n:],
        )
        of_stiffness, of_damping = np.outer(p, of_position), velocity_share * np.outer(p, of_velocity)
        weight = np.hstack([0 * of_stiffness, of_damping, of_stiffness])
        gradient = point.plant.tangent_gradient(point.position, weight, point.velocity, point.acceleration)
        if np.any(of_damping):  # C leaves out the damping at rest
            at_rest = np.hstack([0 * of_stiffness, of_damping, 0 * of_stiffness])
            gradient = gradient - point.plant.tangent_gradient(point.position, at_rest)
        return float(norms[0]), gradient


@dataclass(frozen=True, eq=False)
class InertiaRate:
    """The largest ‖dE⁻¹/dt‖ of `inertia_rates`, for M̂ (n, n) and the largest speed of each joint (n,).

    Without M̂ it is the relative rate ‖M^−½ (dM/dt) M^−½‖.
    """

    nominal: Array | None
    speed: Array

    def values(self, points: Sequence[OperatingPoint]) -> Array:
        """Return the rates of k points, shape (k,)."""
        slopes = np.array([point.plant.inertia_slopes(point.position) for point in points])
        if self.nominal is not None:
            return inertia_rates(self.nominal, slopes, self.speed)
        return np.array(
            [
                inertia_rates(point.plant.inertia(point.position), slope[None], self.speed)[0]
                for point, slope in zip(points, slopes, strict=True)
            ]
        )

    def value_and_gradient(self, point: OperatingPoint) -> tuple[float, Array]:
        """Return the rate of a point and its derivatives over the posture, shape (n,)."""
        joints = np.flatnonzero(self.speed)
        directions = np.eye(len(self.speed))[joints] * self.speed
        if len(joints) <= MAX_CORNER_JOINTS:
            directions = _corner_signs(len(joints)) @ directions
        unit = point.plant.inertia(point.position) if self.nominal is None else self.nominal
        inverse_root = matrix_roots(unit)[1]
        slopes = point.plant.inertia_slopes(point.position)
        rates = inverse_root @ np.tensordot(directions, slopes, 1) @ inverse_root
        values, vectors = np.linalg.eigh(rates)
        largest = np.abs(values).argmax(axis=1)
        norms = np.abs(values).max(axis=1)
        chosen = np.arange(len(directions)) if len(joints) > MAX_CORNER_JOINTS else norms.argmax(keepdims=True)
        gradient = np.zeros(len(self.speed))
        for i in chosen.tolist():
            vector = inverse_root @ vectors[i, :, largest[i]]
            square = np.outer(vector, vector)
            weight = np.sign(values[i, largest[i]]) * square
            gradient += point.plant.inertia_rate_gradient(point.position, directions[i], weight)
            if self.nominal is None:
                gradient -= norms[i] * np.tensordot(slopes, square)
        return float(norms[chosen].sum()), gradient


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


def max_rate_point(
    plants: Sequence[Plant], nominal: Array | None, workspace: Workspace, samples: int, seed: int
) -> OperatingPoint:
    """Return the point with the largest of `inertia_rates`, from samples and a local search from the largest.

    Without M̂ it is that of the largest relative rate.

    Raises
    ------
    InvalidParameter
        For a workspace without speeds.
    """
    speed = workspace.speed
    if speed is None:
        raise InvalidParameter(
            "workspace: it has no speed, so nothing bounds how fast the inertia changes; give one with "
            "with_speed_limits"
        )

    function = InertiaRate(nominal, speed)
    resting = [
        OperatingPoint.at_rest(plant, posture) for posture in workspace.sample(samples, seed) for plant in plants
    ]
    rates = function.values(resting)
    best = [resting[i] for i in np.argsort(rates)[::-1][:N_SEARCHES]]
    units, scale = workspace.unit_samples(samples, seed), max(float(rates.max()), 1e-12)
    best += [_maximise_posture(start, workspace, units, function, scale) for start in best]
    return best[int(np.argmax(function.values(best)))]


def max_inertia_rate(plants: Sequence[Plant], nominal: Array, workspace: Workspace, samples: int, seed: int) -> float:
    """Return the largest of `inertia_rates` over a workspace [1/s]; infinite without a speed."""
    if workspace.speed is None:
        return np.inf
    point = max_rate_point(plants, nominal, workspace, samples, seed)
    return float(InertiaRate(nominal, workspace.speed).values([point])[0])


def inertia_rates(nominal: Array, slopes: Array, speed: Array) -> Array:
    """Return the largest ‖dE⁻¹/dt‖ [1/s] within the speed limits.

    dE⁻¹/dt = Σ q̇_i M̂^−½ (∂M/∂q_i) M̂^−½ is linear in q̇. So its norm is largest where each joint moves at its limit, in
    one direction or the other. Above `MAX_CORNER_JOINTS` joints the sum of the norms bounds it.

    Parameters
    ----------
    nominal
        M̂ [kg m² or kg], shape (n, n).
    slopes
        ∂M/∂q_i, shape (k, n, n, n).
    speed
        Largest speed of each joint [rad/s or m/s], shape (n,).

    Returns
    -------
    Array
        Shape (k,).
    """
    joints = np.flatnonzero(speed)
    if not joints.size:
        return np.zeros(len(slopes))
    inverse_root = matrix_roots(nominal)[1]
    rates = inverse_root @ slopes[:, joints] @ inverse_root * speed[joints, None, None]
    if len(joints) > MAX_CORNER_JOINTS:
        return np.linalg.norm(rates, 2, axis=(2, 3)).sum(axis=1)
    corners = np.einsum("sj,kjab->ksab", _corner_signs(len(joints)), rates)
    return np.abs(np.linalg.eigvalsh(corners)).max(axis=(1, 2))


def _corner_signs(n_joints: int) -> Array:
    """Return all combinations of signs, the first one always positive, shape (2ⁿ⁻¹, n)."""
    return np.array([[1.0, *signs] for signs in product([-1.0, 1.0], repeat=n_joints - 1)])


def _maximise_motion(start: OperatingPoint, workspace: Workspace, function: PointFunction) -> OperatingPoint:
    """Return a point of larger value in the same posture.

    The speed or acceleration of one joint at a time becomes its limit, in one direction or the other, or zero.
    """
    if not start.is_moving or workspace.speed is None or workspace.acceleration is None:
        return start
    limits, n = np.concatenate([workspace.speed, workspace.acceleration]), start.plant.n_joints
    best, best_value = start, float(function.values([start])[0])
    for _ in range(MAX_MOTION_CHANGES):
        motion = np.concatenate([best.velocity, best.acceleration])
        changed = [
            np.where(np.arange(2 * n) == i, sign * limits, motion)
            for i in range(2 * n)
            for sign in (-1, 0, 1)
            if sign * limits[i] != motion[i]
        ]
        candidates = [best._replace(velocity=motion[:n], acceleration=motion[n:]) for motion in changed]
        candidate_values = function.values(candidates)
        if not candidate_values.max() > (1 + 1e-9) * best_value:
            break
        best, best_value = candidates[int(np.argmax(candidate_values))], float(candidate_values.max())
    return best


def _maximise_posture(
    start: OperatingPoint, workspace: Workspace, unit_samples: Array, function: PointFunction, scale: float
) -> OperatingPoint:
    """Return a point of larger value with the same velocity and acceleration.

    The search starts from the posture of the start, in a tube from the sample that is closest to it.
    """
    width = workspace.high - workspace.low
    free = np.flatnonzero(width > 0)
    if not free.size:
        return start
    if workspace.reference is None:
        unit = (start.position - workspace.low) / np.where(width > 0, width, 1.0)
    else:
        distances = np.linalg.norm(workspace.at_unit_points(unit_samples) - start.position, axis=1)
        unit = unit_samples[np.argmin(distances)]

    def unit_at(free_units: Array) -> Array:
        full = unit.copy()
        full[free] = free_units
        return full

    def point_at(free_units: Array) -> OperatingPoint:
        return start._replace(position=workspace.at_unit_points(unit_at(free_units)[None])[0])

    def at(free_units: Array) -> tuple[float, Array]:
        value, gradient = function.value_and_gradient(point_at(free_units))
        return value, gradient @ workspace.unit_slopes(unit_at(free_units))[:, free]

    _, best = local_maximum(at, unit[free], scale=scale, tolerance=1e-5, max_iterations=30)
    return point_at(best)
