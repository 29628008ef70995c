"""Linearised uncertainty of a robot over a workspace: inertia mismatch, stiffness, damping and their rates."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple, TypeVar

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.plants.base import Plant

T = TypeVar("T")

MAX_LEAD_TIME = 1.0
"""Largest lead time θ [s]."""
RADIUS_SHARES = 0.02, 0.06, 0.12, 0.2, 0.35
"""Shares of ρ0 − δ that stiffness and damping may take."""
SEARCH_MARGIN = 0.05
"""Share by which ratios, rates, stiffness and damping may exceed the largest that samples and search found.

Samples and search may miss the worst posture, so a verdict that rests on them must hold for that much more.
"""
PART = 256
"""Number of points of a part."""
NORM_BATCH = 64
"""Number of points whose norms are computed at once."""
N_TRIED_WEIGHTS = 25
"""Number of weights between which those with the wanted shares are interpolated."""
N_WEIGHTS = 5
"""Number of weights at which the points that may decide are looked for."""
NEGLIGIBLE_STIFFNESS = 1e-9
"""Stiffness [1/s²] and damping [1/s] below which a robot counts as having none."""


class OperatingPoint(NamedTuple):
    """A robot in a posture, at rest or moving: position, velocity and acceleration, each (n,)."""

    plant: Plant
    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def at_rest(cls, plant: Plant, position: Array) -> "OperatingPoint":
        """Return the point without velocity and acceleration."""
        posture = np.asarray(position, dtype=float)
        return cls(plant, posture, np.zeros(len(posture)), np.zeros(len(posture)))

    @property
    def is_moving(self) -> bool:
        """Whether velocity or acceleration differs from zero."""
        return bool(self.velocity.any() or self.acceleration.any())


@dataclass(frozen=True, eq=False)
class UncertaintySamples:
    """Differences of k operating points from a double integrator: ẍ = E v − H x − C ẋ in coordinates x = M̂^½ q.

        E = M̂^½ M⁻¹ M̂^½,     H = M̂^½ M⁻¹ (∂(M q̈ + N)/∂q) M̂^−½,     C = M̂^½ M⁻¹ (∂N/∂q̇) M̂^−½

    C leaves out viscous friction, which is there at rest as well.

    Attributes
    ----------
    inertia, stiffness, damping
        E, H [1/s²] and C [1/s], each (k, n, n).
    held_stiffness
        That part of −H which the law itself adds, at the position of the sample [1/s²], (k, n, n); None for none.
    friction
        What viscous friction adds to C [1/s], (k, n, n); None for none.
    """

    inertia: Array
    stiffness: Array
    damping: Array
    held_stiffness: Array | None = None
    friction: Array | None = None

    def stiffness_norms(self, lead_time: float) -> Array:
        """Return ‖[H, C/θ]‖ of each point [1/s²], shape (k,), for the lead time θ [s]."""
        return self._of_forces("_stiffness_norms", lead_time)

    def _stiffness_norms(self, lead_time: float) -> Array:
        return _spectral_norms(_stack(self.stiffness, self.damping, lead_time))

    def force_norms(self, lead_time: float, power: float = 1.0) -> Array:
        """Return ‖E^−p [H, C/θ]‖ of each point [1/s²], shape (k,); with p = 1 those of torques, without M⁻¹."""
        return _spectral_norms(self._powers(-power) @ _stack(self.stiffness, self.damping, lead_time))

    def force_lead_time(self, power: float = 1.0) -> float:
        """Return the θ [s] at which ‖E^−p C‖ counts as ‖E^−p H‖, at most `MAX_LEAD_TIME`; zero without damping."""
        stiffness = float(self.force_norms(0.0, power).max())
        damping = float(_spectral_norms(self._powers(-power) @ self.damping).max())
        if not damping > NEGLIGIBLE_STIFFNESS:
            return 0.0
        return min(damping / max(stiffness, NEGLIGIBLE_STIFFNESS), MAX_LEAD_TIME)

    def _powers(self, power: float) -> Array:
        """Return E^p of each point."""
        values, vectors = np.linalg.eigh((self.inertia + self.inertia.transpose(0, 2, 1)) / 2)
        return vectors * values[:, None] ** power @ vectors.transpose(0, 2, 1)

    def joint_norms(self, centre: float, position_weight: float, lead_time: float = 0.0) -> Array:
        """Return ‖[E − ρ0 I, H/η, C/(η θ)]‖ of each point, shape (k,), for a centre ρ0 and a weight η [1/s²]."""
        mismatch = self.inertia - centre * np.eye(self.inertia.shape[1])
        stiffness = _stack(self.stiffness, self.damping, lead_time) / position_weight
        return _spectral_norms(np.concatenate([mismatch, stiffness], axis=2))

    @property
    def _frictionless(self) -> bool:
        return self.friction is None or not np.any(self.friction)

    def with_friction(self) -> "UncertaintySamples":
        """Return the points without viscous friction, then all of them with it; the same where there is none."""
        if self.friction is None or self._frictionless:
            return self
        inertia, stiffness = (np.concatenate([part, part]) for part in (self.inertia, self.stiffness))
        return UncertaintySamples(inertia, stiffness, np.concatenate([self.damping, self.damping + self.friction]))

    def needed_radius(
        self, centre: float, position_weight: float, lead_time: float = 0.0, period: float = 0.0
    ) -> float:
        """Return the largest of `joint_norms`, and what the acceleration adds to it within a period.

        The position within a period T is not x + t ẋ, and the velocity is not its mean. They differ by at most T/π and
        (T/π)² times the acceleration, in the mean square (Wirtinger). With κ = ‖[H, C/θ]‖ the loop must tolerate

            (norm + g ρ0)/(1 − g),     g = κ (T/π) √((T/π)² + θ²).

        Without a period it is the norm alone.
        """
        largest = self._once(self._largest_norm, centre, position_weight, lead_time)
        if not period or not np.isfinite(position_weight):
            return largest
        within = float(self.stiffness_norms(lead_time).max()) * within_period(lead_time, period)
        return (largest + within * centre) / (1 - within) if within < 1 else np.inf

    def _largest_norm(self, centre: float, position_weight: float, lead_time: float) -> float:
        """Return the largest of `joint_norms`."""
        bounds = self._squared_bounds(centre, position_weight, self.stiffness_norms(lead_time))
        return _largest(bounds, lambda places: self.at(places).joint_norms(centre, position_weight, lead_time))[1]

    def place_of_largest_norm(
        self,
        included: Array,
        centre: float,
        position_weight: float,
        lead_time: float,
        share: float,
        period: float,
    ) -> int:
        """Return the number of the included point, of booleans (k,), whose `joint_norms` are largest once `grown`."""

        def norms(places: Array) -> Array:
            grown = self.at(places).grown(share, period)
            return grown.joint_norms(centre, position_weight, lead_time).reshape(-1, len(places)).max(axis=0)

        stiffest = (1 + share) * self._stiffest(lead_time, period)
        bounds = self._squared_bounds(centre, position_weight, stiffest, share)
        return _largest(np.where(included, bounds, -1.0), norms)[0]

    def _squared_bounds(self, centre: float, position_weight: float, stiffness: Array, share: float = 0.0) -> Array:
        """Return ‖E − ρ0 I‖² + ‖[H, C/θ]‖²/η² of each point for E grown by a share; no norm is larger."""
        (low, high), factor = self._eigenvalues, 1 + share
        mismatch = np.maximum(factor * high - centre, centre - low / factor)
        return mismatch**2 + (stiffness / position_weight) ** 2

    def _stiffest(self, lead_time: float, period: float) -> Array:
        """Return the largest ‖[H, C/θ]‖ of each point with and without friction, at both ends of a period, (k,)."""
        return self._of_forces("_largest_stiffness_norms", lead_time, period)

    def _largest_stiffness_norms(self, lead_time: float, period: float) -> Array:
        stacks = [_stack(self.stiffness, damping, lead_time) for damping in self._dampings(period)]
        return np.max([_spectral_norms(stack) for stack in stacks], axis=0)

    def at(self, places: Array | slice) -> "UncertaintySamples":
        """Return some of the points, by their numbers or as a slice."""
        return UncertaintySamples(
            self.inertia[places],
            self.stiffness[places],
            self.damping[places],
            held_stiffness=None if self.held_stiffness is None else self.held_stiffness[places],
            friction=None if self.friction is None else self.friction[places],
        )

    def parts(self) -> Iterator["UncertaintySamples"]:
        """Yield the points in parts whose matrices stay in the processor's cache."""
        for start in range(0, len(self.inertia), PART):
            yield self.at(slice(start, start + PART))

    def candidate_weights(self, centre: float, lead_time: float) -> list[float]:
        """Return weights η [1/s²] to try, in descending order; none without stiffness and damping.

        A larger η adds less to what E alone needs, and reduces the radius that the loop tolerates. With these weights
        ρ0 − δ shrinks by the shares of `RADIUS_SHARES`.
        """
        return self._once(self._candidate_weights, centre, lead_time)

    def _candidate_weights(self, centre: float, lead_time: float) -> list[float]:
        stiffest = float(self.stiffness_norms(lead_time).max())
        if not stiffest > NEGLIGIBLE_STIFFNESS:
            return []
        inertia_radius = self.needed_radius(centre, np.inf)
        spare = centre - inertia_radius if inertia_radius < centre else centre
        factors = np.geomspace(100.0, 0.01, N_TRIED_WEIGHTS)
        weights = stiffest / centre * factors
        largest = self.decisive([centre], [lead_time], 0.0, 0.0)
        radii = np.array([largest.needed_radius(centre, float(weight), lead_time) for weight in weights])
        logs = np.interp([inertia_radius + share * spare for share in RADIUS_SHARES], radii, np.log(factors))
        return [stiffest / centre * float(np.exp(log)) for log in dict.fromkeys(logs)]

    def decisive(
        self, centres: Iterable[float], lead_times: Iterable[float], share: float, period: float
    ) -> "UncertaintySamples":
        """Return the points that may have the largest norm at some centre, lead time and weight, once `grown`."""
        if not float(self.stiffness_norms(0.0).max()) > NEGLIGIBLE_STIFFNESS:
            return self
        places = []
        for centre, lead_time in product(centres, lead_times):
            stiffness = (1 + share) * self._stiffest(lead_time, period)
            weights = stiffness.max() / centre * np.geomspace(100.0, 0.01, N_WEIGHTS)
            bounds = [self._squared_bounds(centre, weight, stiffness, share) for weight in weights]
            places += [np.argsort(bound)[-NORM_BATCH:] for bound in bounds]
        return self.at(np.unique(np.concatenate(places)))

    @cached_property
    def _eigenvalues(self) -> tuple[Array, Array]:
        """Return the smallest and the largest eigenvalue of E, each (k,)."""
        values = np.linalg.eigvalsh(self.inertia)
        return values[:, 0], values[:, -1]

    def _once(self, function: Callable[..., T], *arguments: float) -> T:
        """Return a method's value, computed once for these arguments."""
        key = function.__name__, *arguments
        if key not in self._values:
            self._values[key] = function(*arguments)
        return self._values[key]

    @cached_property
    def _values(self) -> dict[tuple[Any, ...], Any]:
        return {}

    def grown(self, share: float, period: float = 0.0) -> "UncertaintySamples":
        """Return each point with more uncertainty, at the start and the end of a period.

        These are E (1 + share) and E/(1 + share), both with H and C times 1 + share. With a period T they are there
        with C and with C + H T, since x(t) = x + t ẋ at the mean velocity. What lies between all of them has no larger
        norm, which is convex in E, H and C. So any viscous friction between none and that of the robot counts as well.
        """
        factor, dampings = 1 + share, self._dampings(period)
        count = len(dampings)
        inertia = np.concatenate([factor * self.inertia] * count + [self.inertia / factor] * count)
        stiffness = factor * np.concatenate(2 * count * [self.stiffness])
        return UncertaintySamples(inertia, stiffness, factor * np.concatenate(2 * dampings))

    def _dampings(self, period: float) -> list[Array]:
        """Return C without and with viscous friction, at the start and the end of a period, each (k, n, n)."""
        moving = self.stiffness if self.held_stiffness is None else self.stiffness + self.held_stiffness
        dampings = [self.damping, *([] if self._frictionless else [self.damping + self.friction])]
        return dampings + ([damping + period * moving for damping in dampings] if period else [])

    def max_grown_stiffness(self, lead_time: float, share: float, period: float) -> float:
        """Return the largest ‖[H, C/θ]‖ of the `grown` points [1/s²]."""
        return float((1 + share) * self._stiffest(lead_time, period).max())

    def lead_time(self, friction: bool = False) -> float:
        """Return the θ [s] at which the largest damping counts as the largest stiffness, at most `MAX_LEAD_TIME`.

        It is zero without damping. With ``friction`` the damping is the larger of C with and without viscous friction.
        """
        stiffness = float(self.stiffness_norms(0.0).max())
        damping = float(self._of_forces("_damping_norms", friction).max())
        if not damping > NEGLIGIBLE_STIFFNESS:
            return 0.0
        return min(damping / max(stiffness, NEGLIGIBLE_STIFFNESS), MAX_LEAD_TIME)

    def _damping_norms(self, friction: bool) -> Array:
        """Return ‖C‖ of each point [1/s], shape (k,)."""
        norms = _spectral_norms(self.damping)
        if not friction or self.friction is None or self._frictionless:
            return norms
        return np.maximum(norms, _spectral_norms(self.damping + self.friction))

    def for_scaled_inertia(self, scale: float) -> "UncertaintySamples":
        """Return the points for M̂ times a number, which multiplies E and leaves H and C."""
        scaled = replace(self, inertia=scale * self.inertia)
        vars(scaled)["_force_values"] = self._force_values
        return scaled

    def with_more(self, added: "UncertaintySamples") -> "UncertaintySamples":
        """Return the points with a few more, and what is known of the H and C of each."""
        joined = self | added
        for (name, *arguments), known in self._force_values.items():
            joined._force_values[name, *arguments] = np.concatenate([known, added._of_forces(name, *arguments)])
        return joined

    def _of_forces(self, name: str, *arguments: float) -> Array:
        """Return what a method gives of H and C, an array over the points, computed once for these arguments."""
        key = name, *arguments
        if key not in self._force_values:
            self._force_values[key] = getattr(self, name)(*arguments)
        return self._force_values[key]

    @cached_property
    def _force_values(self) -> dict[tuple[Any, ...], Array]:
        return {}

    def __or__(self, added: "UncertaintySamples") -> "UncertaintySamples":
        def both(first: Array | None, second: Array | None) -> Array | None:
            return None if first is None or second is None else np.concatenate([first, second])

        return UncertaintySamples(
            np.concatenate([self.inertia, added.inertia]),
            np.concatenate([self.stiffness, added.stiffness]),
            np.concatenate([self.damping, added.damping]),
            held_stiffness=both(self.held_stiffness, added.held_stiffness),
            friction=both(self.friction, added.friction),
        )


def _largest(bounds: Array, values: Callable[[Array], Array]) -> tuple[int, float]:
    """Return the number and the value of the largest value, whose square no bound is below; in batches."""
    best, largest, order = 0, -1.0, np.argsort(bounds)[::-1]
    for start in range(0, len(order), NORM_BATCH):
        places = order[start : start + NORM_BATCH]
        if largest >= 0 and bounds[places[0]] * (1 + 1e-9) < largest**2:
            break
        found = values(places)
        if found.max() > largest:
            best, largest = int(places[np.argmax(found)]), float(found.max())
    return best, largest


def within_period(lead_time: float, period: float) -> float:
    """Return (T/π) √((T/π)² + θ²) [s²], what an acceleration adds to (x, θ ẋ) within a period T."""
    return period / np.pi * float(np.hypot(period / np.pi, lead_time))


def _stack(stiffness: Array, damping: Array, lead_time: float) -> Array:
    """Return [H, C/θ], what multiplies position and θ times velocity; H for θ = 0."""
    return np.concatenate([stiffness, damping / lead_time], axis=2) if lead_time else stiffness


def _spectral_norms(matrices: Array) -> Array:
    """Return spectral norms by the eigenvalues of A Aᵀ, which is faster than singular values."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(matrices @ matrices.transpose(0, 2, 1))[:, -1], 0.0))


def uncertainty_samples(nominal: Array, points: Sequence[OperatingPoint]) -> UncertaintySamples:
    """Return the linearised uncertainty at operating points.

    Parameters
    ----------
    nominal
        M̂ [kg m² or kg], shape (n, n).
    points
        The points.

    Raises
    ------
    InvalidParameter
        For a stiffness or damping that is not finite.
    """
    M, D, G, friction = linearise_with_friction(points)
    invalid = np.flatnonzero(~np.isfinite(D + G).all(axis=(1, 2)))
    if invalid.size:
        raise InvalidParameter(
            "stiffness: that of gravity and springs is not finite at q = "
            f"{points[invalid[0]].position.round(4).tolist()}; check the potential energy, or give a workspace "
            "without this posture"
        )
    return to_nominal_coordinates(nominal, M, D, G, friction)


def linearise_points(points: Sequence[OperatingPoint]) -> tuple[Array, Array, Array]:
    """Return M, D and G of `linearise_point` at k points, each of shape (k, n, n)."""
    return linearise_with_friction(points)[:3]


def linearise_with_friction(points: Sequence[OperatingPoint]) -> tuple[Array, Array, Array, Array]:
    """Return M, D and G of `linearise_point` and the viscous friction at k points, each of shape (k, n, n)."""
    groups: dict[tuple[int, bool], list[int]] = {}
    for i, point in enumerate(points):
        groups.setdefault((id(point.plant), point.is_moving), []).append(i)
    n = points[0].plant.n_joints
    M, D, G, friction = np.empty((4, len(points), n, n))
    for (_, is_moving), places in groups.items():
        plant = points[places[0]].plant
        q, v, a = np.array([points[i][1:] for i in places]).transpose(1, 2, 0)
        M[places], D[places], G[places] = plant.linearised_at(q, v, a)
        friction[places] = plant.linearised_at(q, 0 * v, 0 * a)[1] if is_moving else D[places]
    return M, D - friction, G, friction


def biases(points: Sequence[OperatingPoint]) -> Array:
    """Return N(q, q̇) without dry friction at k points, shape (k, n)."""
    groups: dict[int, list[int]] = {}
    for i, point in enumerate(points):
        groups.setdefault(id(point.plant), []).append(i)
    found = np.empty((len(points), points[0].plant.n_joints))
    for places in groups.values():
        q, v = np.array([points[i][1:3] for i in places]).transpose(1, 2, 0)
        found[places] = points[places[0]].plant.biases(q, v)
    return found


def linearise_point(point: OperatingPoint) -> tuple[Array, Array, Array]:
    """Return M, D and G of the robot linearised about a point; D without viscous friction."""
    M, D, G = point.plant.linearised(point.position, point.velocity, point.acceleration)
    if not point.is_moving:
        return M, 0 * D, G
    return M, D - point.plant.damping(point.position), G


def matrix_roots(nominal: Array) -> tuple[Array, Array]:
    """Return M̂^½ and its inverse."""
    values, vectors = np.linalg.eigh(nominal)
    return vectors * values**0.5 @ vectors.T, vectors * values**-0.5 @ vectors.T


def to_nominal_coordinates(
    nominal: Array, M: Array, D: Array, G: Array, friction: Array | None = None
) -> UncertaintySamples:
    """Return the uncertainty in coordinates x = M̂^½ q, from inertias, dampings and stiffnesses (k, n, n)."""
    root, inverse_root = matrix_roots(nominal)
    parts = [root + 0 * M, G @ inverse_root, D @ inverse_root]
    parts += [] if friction is None else [friction @ inverse_root]
    inertia, stiffness, damping, *rubbing = np.split(
        root @ np.linalg.solve(M, np.concatenate(parts, axis=2)), len(parts), axis=2
    )
    return UncertaintySamples(inertia, stiffness, damping, friction=rubbing[0] if rubbing else None)
