"""Functions of operating points that searches make large: norms of the linearised uncertainty, with derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from tarc.analysis.operating_points import (
    OperatingPoint,
    UncertaintySamples,
    linearise_point,
    matrix_roots,
    uncertainty_samples,
)
from tarc.core.types import Array


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
        return float(norms[0]), _weighted_gradient(point, of_inertia, of_damping, of_stiffness)

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
        return float(norms[0]), _weighted_gradient(point, 0 * of_stiffness, of_damping, of_stiffness)


def _weighted_gradient(point: OperatingPoint, of_inertia: Array, of_damping: Array, of_stiffness: Array) -> Array:
    """Return the derivatives of Σ W_M M + W_D (D − D at rest) + W_G G over the posture, shape (n,), element by element.

    The weights have the shape (n, n).
    """
    weight = np.hstack([of_inertia, of_damping, of_stiffness])
    gradient = point.plant.tangent_gradient(point.position, weight, point.velocity, point.acceleration)
    if np.any(of_damping):  # C leaves out the damping at rest
        at_rest = np.hstack([0 * of_inertia, of_damping, 0 * of_stiffness])
        gradient = gradient - point.plant.tangent_gradient(point.position, at_rest)
    return gradient
