"""Algebraic (least-squares) derivative estimation over a sliding window."""

from dataclasses import dataclass
from functools import cached_property
from math import factorial

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.validation import Numbers
from tarc.estimators.base import WindowedEstimator


@dataclass(frozen=True, kw_only=True, eq=False)
class Algebraic(WindowedEstimator):
    """Derivatives at the newest sample of the polynomial that fits the window best.

    In continuous time q̂^(j)(t) = ∫_{−ς}^0 Ω_j(ψ) q(t+ψ) dψ with the kernel Ω_j of `kernel`. In discrete time it has the
    exact least-squares weights over the N + 1 newest samples, ς = N T. They tend to the kernel as N grows. Both are
    exact on polynomials up to the degree Λ. The window is itself a low-pass filter.

    Parameters
    ----------
    window
        ς [s], a whole multiple of the period.
    degree
        Λ; velocity needs 1, acceleration (and so every law that uses time-delay estimation) needs 2.

    Raises
    ------
    InvalidParameter
        When the window holds fewer than degree + 1 samples or is no multiple of the period.

    References
    ----------
    Paper, Lemma 2, with the sign of the kernel corrected; J. Reger and J. Jouffroy, 48th IEEE CDC, 2009.

    Examples
    --------
    >>> from tarc.estimators import Algebraic
    >>> Algebraic(window=0.002, degree=2).with_period(0.001).weights(2).round()   # second difference
    array([ 1000000., -2000000.,  1000000.])
    """

    window: float
    degree: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("window", self.window, 0, strict=True)
        object.__setattr__(self, "degree", check.integer("degree", self.degree, 1, 6))
        if self.period is not None and self.samples < self.degree + 1:
            raise InvalidParameter(
                f"window: {self.window:g} s holds {self.samples} samples at a period of {self.period:g} s; degree "
                f"{self.degree} needs {self.degree + 1}. Use window={self.degree * self.period:g} or more, or a "
                "lower degree"
            )

    @property
    def samples(self) -> int:
        """Return N + 1, the number of samples in the window, both ends counted."""
        return check.whole_periods("window", self.window, self.sampling_period) + 1

    @property
    def max_derivative(self) -> int:
        """Return the degree."""
        return self.degree

    def kernel(self, psi: Numbers, derivative: int = 1) -> np.ndarray:
        """Return the continuous kernel Ω_j(ψ) [s^−(j+1)] for ψ in [−ς, 0].

        Ω_j(ψ) = (Λ+1+j)! / (ς^{j+1} j! (Λ−j)!) Σ_k (Λ+1+k)! / ((j+k+1)(Λ−k)!(k!)²) (ψ/ς)^k. The factor (−1)^k that
        the paper prints in the sum belongs to the convention with q(t−ψ) and is left out.
        """
        if derivative not in range(self.degree + 1):
            raise InvalidParameter(
                f"derivative: got {derivative!r}; a kernel of degree {self.degree} has 0 to {self.degree}"
            )
        n, j = self.degree, derivative
        psi = np.asarray(psi, dtype=float)
        scale = factorial(n + 1 + j) / (self.window ** (j + 1) * factorial(j) * factorial(n - j))
        total = sum(
            factorial(n + 1 + k) / ((j + k + 1) * factorial(n - k) * factorial(k) ** 2) * (psi / self.window) ** k
            for k in range(n + 1)
        )
        return np.where((psi >= -self.window) & (psi <= 0), scale * total, 0.0)

    def weights(self, derivative: int) -> np.ndarray:
        """Return the weights [s^−j] of the N + 1 samples, newest first, for the derivative at the newest."""
        return self._fit[self._order(derivative)] * factorial(derivative) / self.window**derivative

    @property
    def prediction(self) -> np.ndarray:
        """Return the weights over the past window that give its polynomial's value one period later."""
        return (1 / (self.samples - 1)) ** np.arange(self.degree + 1) @ self._fit

    @cached_property
    def _fit(self) -> np.ndarray:
        """Return in rows the coefficients of the best polynomial in time over ς, from samples newest first."""
        age = -np.linspace(0, 1, self.samples)
        return np.linalg.pinv(np.vander(age, self.degree + 1, increasing=True))


def polynomial_weights(ages: np.ndarray, degree: int, derivative: int) -> np.ndarray:
    """Return the least-squares weights [s^−j] of samples at uneven ages for a derivative at age 0.

    With A_im = (−age_i / ς)^m, m = 0 … Λ, the weights are row j of (AᵀA)⁻¹Aᵀ times j! / ς^j. They are exact on
    polynomials up to the degree Λ, whatever the ages; even ages give those of `Algebraic`.

    Parameters
    ----------
    ages
        Time since each sample was measured [s], shape (…, N + 1), more than Λ of them different.
    degree
        Λ.
    derivative
        j, at most Λ.
    """
    span = np.maximum(np.max(np.abs(ages), axis=-1, keepdims=True), 1e-300)
    powers = (-ages / span)[..., None] ** np.arange(degree + 1)
    return np.linalg.pinv(powers)[..., derivative, :] * factorial(derivative) / span**derivative
