"""Symmetric matrices of trigonometric polynomials."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from tarc.core.types import Array

DEGREE = 2
"""Degree in each angle. The inertia of a robot has it, since it is quadratic in the rotation of each joint."""
NEGLIGIBLE = 1e-12
"""Coefficient, over the largest, that is left out; all of them together are added to every bound."""
MAX_NUMBERS = 100_000_000
"""Largest number of coefficients of polynomials that are in memory together; 0.8 GB."""


def too_large(n_functions: int, n_coefficients: int, size: int) -> str:
    """Return why matrices of polynomials need too much memory, in words; empty where `MAX_NUMBERS` contains them.

    Parameters
    ----------
    n_functions
        Number of matrices.
    n_coefficients
        Number of coefficients of each entry.
    size
        Number of rows, and of columns.
    """
    numbers = n_functions * n_coefficients * size**2
    if numbers <= MAX_NUMBERS:
        return ""
    needed, allowed = (f"{8e-9 * count:.2g} GB" for count in (numbers, MAX_NUMBERS))
    return f"{n_functions} functions of {n_coefficients} coefficients per entry need {needed} of at most {allowed}"


@dataclass(frozen=True, eq=False)
class TrigPolynomial:
    """F(q) = Σ_m A_m cos(m·q) + B_m sin(m·q), with symmetric coefficients.

    Attributes
    ----------
    modes
        The integer vectors m, shape (K, d).
    cosines, sines
        A_m and B_m, shape (K, n, n).
    left_out
        Bound on the norm of the terms that were left out.
    """

    modes: Array
    cosines: Array
    sines: Array
    left_out: float = 0.0

    @classmethod
    def from_samples(cls, function: Callable[[Array], Array], n_angles: int, degree: int = DEGREE) -> "TrigPolynomial":
        """Return the polynomial through a function's values on a grid of 2·degree + 1 points per angle.

        Parameters
        ----------
        function
            From angles (k, d) to symmetric matrices (k, n, n), of that degree in each angle.
        n_angles
            d.
        degree
            Degree in each angle; two for the inertia of a robot.
        """
        count = 2 * degree + 1
        grid = 2 * np.pi / count * np.array(list(product(range(count), repeat=n_angles)))
        values = np.asarray(function(grid.reshape(count**n_angles, n_angles)))
        n = values.shape[-1]
        axes = tuple(range(n_angles))
        transformed = np.fft.fftn(values.reshape(*[count] * n_angles, n, n), axes=axes) / count**n_angles
        flat = transformed.reshape(-1, n, n)
        indices = np.array(list(product(range(count), repeat=n_angles)), dtype=int).reshape(count**n_angles, n_angles)
        modes = np.where(indices > degree, indices - count, indices)
        # of m and −m one is enough
        weights = modes @ (10.0 ** np.arange(n_angles)[::-1]) if n_angles else np.zeros(1)
        kept = weights >= 0
        factor = np.where(weights > 0, 2.0, 1.0)[kept, None, None]
        cosines, sines = factor * flat.real[kept], -factor * flat.imag[kept]
        sizes = np.abs(cosines).sum(axis=(1, 2)) + np.abs(sines).sum(axis=(1, 2))
        large = sizes > NEGLIGIBLE * max(float(sizes.max()), 1e-300)
        return cls(modes[kept][large], cosines[large], sines[large], float(sizes[~large].sum()))

    @property
    def n_angles(self) -> int:
        """Number of angles d."""
        return self.modes.shape[1]

    def __call__(self, angles: Array) -> Array:
        """Return F at angles (k, d), shape (k, n, n)."""
        phases = angles @ self.modes.T
        shape = len(angles), *self.cosines.shape[1:]
        flat = np.cos(phases) @ self.flat[0] + np.sin(phases) @ self.flat[1]
        return flat.reshape(shape)

    @cached_property
    def flat(self) -> tuple[Array, Array]:
        """The coefficients, each (K, n²)."""
        shape = self.cosines.shape[0], self.cosines.shape[1] * self.cosines.shape[2]
        return self.cosines.reshape(shape), self.sines.reshape(shape)

    def derivative(self, *angles: int) -> "TrigPolynomial":
        """Return the derivative over some angles, in turn."""
        result = self
        for angle in angles:
            factor = result.modes[:, angle, None, None]
            result = TrigPolynomial(result.modes, factor * result.sines, -factor * result.cosines, result.left_out)
        return result.without_zeros()

    def without_zeros(self) -> "TrigPolynomial":
        """Return the same without terms that are zero."""
        used = np.any(self.cosines, axis=(1, 2)) | np.any(self.sines, axis=(1, 2))
        return TrigPolynomial(self.modes[used], self.cosines[used], self.sines[used], self.left_out)

    def __rmul__(self, factor: float) -> "TrigPolynomial":
        return TrigPolynomial(self.modes, factor * self.cosines, factor * self.sines, abs(factor) * self.left_out)

    def sup_norm(self) -> float:
        """Return a bound on ‖F(q)‖ for all q: the norm of the sum of the coefficients' moduli."""
        moduli = np.hypot(self.cosines, self.sines).sum(axis=0)
        return float(np.linalg.norm(moduli, 2)) + self.left_out


@dataclass(frozen=True, eq=False)
class PolynomialFamily:
    """Polynomials that are sums of the same parts with different factors.

    Attributes
    ----------
    modes
        The integer vectors of all parts, shape (K, d).
    cosines, sines
        Coefficients of the parts, shape (p, K, n, n).
    left_out
        Of the parts, shape (p,).
    weights
        Factors, shape (k, p).
    """

    modes: Array
    cosines: Array
    sines: Array
    left_out: Array
    weights: Array

    @classmethod
    def from_parts(cls, parts: Sequence[TrigPolynomial], weights: Sequence[Array]) -> "PolynomialFamily":
        """Return the family of parts and of the factors of each member."""
        modes, places = np.unique(np.concatenate([part.modes for part in parts]), axis=0, return_inverse=True)
        cosines, sines = np.zeros((2, len(parts), len(modes), *parts[0].cosines.shape[1:]))
        ends = np.cumsum([len(part.modes) for part in parts])
        for number, (part, own) in enumerate(zip(parts, np.split(places.ravel(), ends[:-1]), strict=True)):
            np.add.at(cosines[number], own, part.cosines)
            np.add.at(sines[number], own, part.sines)
        return cls(modes, cosines, sines, np.array([part.left_out for part in parts]), np.array(weights))

    @cached_property
    def _totals(self) -> Array:
        """Sum of the moduli of each member's coefficients, by mode, shape (k, K)."""
        sizes = np.abs(self.cosines).sum(axis=(2, 3)) + np.abs(self.sines).sum(axis=(2, 3))
        return np.abs(self.weights) @ sizes

    @cached_property
    def _is_large(self) -> Array:
        """Whether coefficients of a mode count beside those of all members, shape (K,)."""
        return np.any(self._totals > NEGLIGIBLE * max(float(self._totals.max(initial=0)), 1e-300), axis=0)

    @property
    def n_modes(self) -> int:
        """Number of modes of each member."""
        return int(np.sum(self._is_large))

    def members(self) -> list[TrigPolynomial]:
        """Return all polynomials, without coefficients that are negligible beside those of all parts."""
        total, large = self._totals, self._is_large
        left_out = np.abs(self.weights) @ self.left_out + total[:, ~large].sum(axis=1)
        return [
            TrigPolynomial(
                self.modes[large],
                np.tensordot(weights, self.cosines[:, large], axes=1),
                np.tensordot(weights, self.sines[:, large], axes=1),
                float(rest),
            )
            for weights, rest in zip(self.weights, left_out, strict=True)
        ]
