"""A quadratic form that stiffness and damping of a robot satisfy, which knows how little work they can do.

With ẍ = E (v + k), k = −M̂^−½ (G M̂^−½ x + D M̂^−½ ẋ) the torque by stiffness and damping, all operating points satisfy

    α0 |k|² + α1 kᵀEk + 2 α2 ẋᵀk ≤ β0 |x|² + β1 |ẋ|².

Norms of k alone are this with α2 = 0. The power ẋᵀk sees that Coriolis forces do little work, since Ṁ − 2C is skew, and
that viscous friction takes energy.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tarc.analysis.operating_points import (
    OperatingPoint,
    UncertaintySamples,
    linearise_point,
    matrix_roots,
    uncertainty_samples,
)
from tarc.core.types import Array

N_SEEDS = 8
"""Number of points of each norm at which the first program asks for the form."""
MAX_ADDED = 12
"""Largest number of points that a solution leaves out which are added to the next program."""
MIN_COEFFICIENT = 1e-9
"""Least coefficient in its unit, as a share of the largest; a solver may return zero for all that a form needs."""
MAX_MARGIN = 0.5
"""Largest share of growth that is looked for."""
BISECTIONS = 30
"""Number of steps in which it is found."""
ROUNDING_ROOM = 1 + 1e-9
"""Factor on β0 and β1 beyond the largest value found."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceForm:
    """The form α0 |k|² + α1 kᵀEk + 2 α2 ẋᵀk ≤ β0 |x|² + β1 |ẋ|².

    Attributes
    ----------
    torque, energy, power
        α0, α1 and α2 [1/s].
    position, velocity
        β0 [1/s⁴] and β1 [1/s²].
    split
        Damping [1/s] at which what E changes within a period is split between ẋ and the acceleration E k.
    """

    torque: float
    energy: float
    power: float
    position: float
    velocity: float
    split: float

    @property
    def lead_time(self) -> float:
        """√(β1/β0) [s]."""
        return float(np.sqrt(self.velocity / self.position))

    @property
    def coefficients(self) -> Array:
        """Return α0, α1, α2, β0 and β1, shape (5,)."""
        return np.array([self.torque, self.energy, self.power, self.position, self.velocity])

    def grown(self, share: float) -> "ForceForm":
        """Return the form that a point satisfies if it satisfies this one with more of E, H and C by a share.

        Forces are k = −E⁻¹(H x + C ẋ), and E⁻¹H grows by the share.
        """
        factor = 1 + share
        return replace(self, torque=factor**2 * self.torque, energy=factor**3 * self.energy, power=factor * self.power)

    def loosened(self, factor: float) -> "ForceForm":
        """Return the form with β0 and β1 times a factor."""
        return replace(self, position=factor * self.position, velocity=factor * self.velocity)

    def values(self, samples: UncertaintySamples) -> Array:
        """Return the largest left side over the right side at k points, which is at most one, shape (k,)."""
        torques = _torques(samples) / np.repeat([self.position**0.5, self.velocity**0.5], len(samples.inertia[0]))
        n = samples.inertia.shape[1]
        squares = torques.transpose(0, 2, 1) @ (self.torque * torques + self.energy * samples.inertia @ torques)
        work = self.power / self.velocity**0.5 * torques
        squares[:, n:] -= work
        squares[:, :, n:] -= work.transpose(0, 2, 1)
        return np.linalg.eigvalsh(squares)[:, -1]

    def margin(self, samples: UncertaintySamples) -> float:
        """Return by what share E, H and C of all points may grow, at most `MAX_MARGIN`; −1 if not at all."""
        if self.values(samples).max() > 1:
            return -1.0
        low, high = 0.0, MAX_MARGIN
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            low, high = (middle, high) if self.grown(middle).values(samples).max() <= 1 else (low, middle)
        return low

    def is_valid(self) -> bool:
        """Return whether all numbers are finite and in range."""
        numbers = np.array([*self.coefficients, self.split])
        return bool(np.all(np.isfinite(numbers)) and np.all(numbers >= 0) and min(self.position, self.velocity) > 0)


def _torques(samples: UncertaintySamples) -> Array:
    """Return E⁻¹ [H, C] of each point, shape (k, n, 2n)."""
    return np.linalg.solve(samples.inertia, np.concatenate([samples.stiffness, samples.damping], axis=2))


@dataclass(frozen=True, eq=False)
class FormValue:
    """The value of a form at operating points, without viscous friction, for a search for the worst.

    Parameters
    ----------
    nominal
        M̂ [kg m² or kg], shape (n, n).
    form
        The form.
    """

    nominal: Array
    form: ForceForm

    def values(self, points: Sequence[OperatingPoint]) -> Array:
        """Return the values at k points, shape (k,)."""
        return self.norms(uncertainty_samples(self.nominal, points))

    def norms(self, samples: UncertaintySamples) -> Array:
        """Return the values at k points, shape (k,)."""
        return self.form.values(samples)

    def value_and_gradient(self, point: OperatingPoint) -> tuple[float, Array]:
        """Return the value at a point and its derivatives over the posture, shape (n,).

        With y = (x, ẋ) where it is reached, r = R y and R = M̂^−½ [G, D] M̂^−½, they are those of

            2 (α0 r + α1 E r − α2 ẋ)ᵀ dR y − α1 (E r)ᵀ dE⁻¹ (E r).
        """
        M, D, G = linearise_point(point)
        inverse_root, form, n = matrix_roots(self.nominal)[1], self.form, len(M)
        E = np.linalg.inv(inverse_root @ M @ inverse_root)
        scales = np.repeat([form.position**-0.5, form.velocity**-0.5], n)
        R = inverse_root @ np.hstack([G @ inverse_root, D @ inverse_root]) * scales
        work = np.zeros((2 * n, 2 * n))
        work[n:] = form.power / form.velocity**0.5 * R
        values, vectors = np.linalg.eigh(R.T @ (form.torque * R + form.energy * E @ R) - work - work.T)
        y = vectors[:, -1]
        r = R @ y
        state = y * scales
        pull = inverse_root @ (2 * (form.torque * r + form.energy * E @ r - form.power * state[n:]))
        light = inverse_root @ E @ r
        of_inertia = -form.energy * np.outer(light, light)
        of_stiffness, of_damping = (np.outer(pull, inverse_root @ part) for part in (state[:n], state[n:]))
        weight = np.hstack([of_inertia, of_damping, of_stiffness])
        gradient = point.plant.tangent_gradient(point.position, weight, point.velocity, point.acceleration)
        at_rest = np.hstack([0 * of_inertia, of_damping, 0 * of_stiffness])  # D leaves out the damping at rest
        gradient = gradient - point.plant.tangent_gradient(point.position, at_rest)
        return float(values[-1]), gradient


class FormUnits(NamedTuple):
    """Sizes of a robot's forces: largest ‖E⁻¹H‖ [1/s²] and ‖E⁻¹C‖ [1/s], and a ratio λ between the extremes."""

    stiffness: float
    damping: float
    ratio: float

    @property
    def of_coefficients(self) -> Array:
        """Return units of α0, α1, α2, β0 and β1, shape (5,)."""
        return np.array([1.0, 1 / self.ratio, self.damping, self.stiffness**2, self.damping**2])


@dataclass(eq=False)
class ForcePoints:
    """Points that a form must cover with a margin, and the few of them that programs need.

    Parameters
    ----------
    samples
        Uncertainty at the points, in those without and in those with viscous friction.
    share
        Growth of E, H and C that is covered besides.
    """

    samples: UncertaintySamples
    share: float

    def __post_init__(self) -> None:
        n, samples = self.samples.inertia.shape[1], self.samples
        self.torques = (1 + self.share) * _torques(samples)
        self.inertia = (1 + self.share) * samples.inertia
        stiffness, damping = (
            np.linalg.norm(part, 2, axis=(1, 2)) for part in (self.torques[:, :, :n], self.torques[:, :, n:])
        )
        values = np.linalg.eigvalsh(samples.inertia)
        self.units = FormUnits(
            float(stiffness.max()),
            max(float(damping.max()), 1e-6 * float(stiffness.max())),
            float((values.min() * values.max()) ** 0.5),
        )
        weights = np.repeat([self.units.stiffness, self.units.damping], n)
        self.torques = self.torques / weights
        squares = np.linalg.norm(self.torques, 2, axis=(1, 2))
        energies = np.linalg.eigvalsh(self.torques.transpose(0, 2, 1) @ self.inertia @ self.torques)[:, -1]
        worst = [np.argsort(size)[-N_SEEDS:] for size in (stiffness, damping, squares, energies)]
        self.active = np.unique(np.concatenate(worst)).tolist()

    def forms(self, index: int) -> tuple[Array, ...]:
        """Return what α0, α1, α2, β0 and β1 add to right less left side at a point, in their units, each (2n, 2n)."""
        torques, inertia = self.torques[index], self.inertia[index]
        n = len(inertia)
        work = np.zeros((2 * n, 2 * n))
        work[n:] = torques
        position, velocity = np.diag(np.repeat([1.0, 0.0], n)), np.diag(np.repeat([0.0, 1.0], n))
        energy = torques.T @ (inertia / self.units.ratio) @ torques
        return -torques.T @ torques, -energy, work + work.T, position, velocity

    def unit_form(self, place: int) -> ForceForm:
        """Return the form of which one coefficient is one in its unit, and the others are zero."""
        return self._form(np.eye(len(self.units.of_coefficients))[place])

    def _form(self, coefficients: Array) -> ForceForm:
        torque, energy, power, position, velocity = (coefficients * self.units.of_coefficients).tolist()
        return ForceForm(
            torque=torque,
            energy=energy,
            power=power,
            position=position,
            velocity=velocity,
            split=self.units.damping / 2,
        )

    def covering(self, coefficients: Array) -> ForceForm:
        """Return the form of coefficients in their units, with β0 and β1 enlarged so that it covers all points.

        Points that need it become active.
        """
        form = self._form(np.maximum(coefficients, MIN_COEFFICIENT * max(float(coefficients.max()), MIN_COEFFICIENT)))
        values = form.grown(self.share).values(self.samples)
        worst = np.argsort(values)[::-1][:MAX_ADDED]
        self.active = sorted({*self.active, *worst[values[worst] > 1 + 1e-6].tolist()})
        return form.loosened(max(float(values.max()), 1.0) * ROUNDING_ROOM)
