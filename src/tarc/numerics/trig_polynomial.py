"""Symmetric matrices of trigonometric polynomials, and proofs that their eigenvalues stay below a bound."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, permutations, product
from typing import NamedTuple

import numpy as np

from tarc.core.types import Array

DEGREE = 2
"""Degree in each angle. The inertia of a robot has it, since it is quadratic in the rotation of each joint."""
NEGLIGIBLE = 1e-12
"""Coefficient, over the largest, that is left out; all of them together are added to every bound."""
BATCH = 2048
"""Number of boxes that are looked at together."""


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
    def from_samples(cls, function: Callable[[Array], Array], n_angles: int) -> "TrigPolynomial":
        """Return the polynomial through a function's values on the grid of five points per angle.

        Parameters
        ----------
        function
            From angles (k, d) to symmetric matrices (k, n, n), of degree two in each angle.
        n_angles
            d.
        """
        count = 2 * DEGREE + 1
        grid = 2 * np.pi / count * np.array(list(product(range(count), repeat=n_angles)))
        values = np.asarray(function(grid.reshape(-1, n_angles)))
        n = values.shape[-1]
        axes = tuple(range(n_angles))
        transformed = np.fft.fftn(values.reshape(*[count] * n_angles, n, n), axes=axes) / count**n_angles
        flat = transformed.reshape(-1, n, n)
        indices = np.array(list(product(range(count), repeat=n_angles))).reshape(-1, n_angles)
        modes = np.where(indices > DEGREE, indices - count, indices)
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
        return self.cosines.reshape(len(self.modes), -1), self.sines.reshape(len(self.modes), -1)

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

    def __add__(self, other: "TrigPolynomial") -> "TrigPolynomial":
        modes, inverse = np.unique(np.concatenate([self.modes, other.modes]), axis=0, return_inverse=True)
        cosines, sines = np.zeros((2, len(modes), *self.cosines.shape[1:]))
        np.add.at(cosines, inverse.ravel(), np.concatenate([self.cosines, other.cosines]))
        np.add.at(sines, inverse.ravel(), np.concatenate([self.sines, other.sines]))
        return TrigPolynomial(modes, cosines, sines, self.left_out + other.left_out)

    def __rmul__(self, factor: float) -> "TrigPolynomial":
        return TrigPolynomial(self.modes, factor * self.cosines, factor * self.sines, abs(factor) * self.left_out)

    def sup_norm(self) -> float:
        """Return a bound on ‖F(q)‖ for all q: the norm of the sum of the coefficients' moduli."""
        moduli = np.hypot(self.cosines, self.sines).sum(axis=0)
        return float(np.linalg.norm(moduli, 2)) + self.left_out


class Expansion(NamedTuple):
    """A polynomial at the centres of boxes, in steps of their half widths.

    Attributes
    ----------
    values
        F, shape (k, n, n).
    slopes
        h_i ∂_i F, shape (k, d, n, n).
    curvatures
        h_i h_j ∂_ij F, shape (k, d, d, n, n).
    remainders
        Bound on the rest: Σ h_i h_j h_k ‖∂_ijk F‖/6, and Σ h_i h_j h_k h_l sup‖∂_ijkl F‖/24, shape (k,).
    """

    values: Array
    slopes: Array
    curvatures: Array
    remainders: Array


@dataclass(frozen=True, eq=False)
class TaylorBounds:
    """A polynomial with its derivatives, all from the same cosines and sines."""

    polynomial: TrigPolynomial

    @cached_property
    def _orders(self) -> list[list[tuple[int, ...]]]:
        """Angles of the derivatives from the first to the third."""
        return [list(combinations_with_replacement(range(self.polynomial.n_angles), order)) for order in (1, 2, 3)]

    @cached_property
    def _coefficients(self) -> tuple[Array, Array]:
        """Coefficients of F and its derivatives side by side, each (K, ·)."""
        cosines, sines = ([part] for part in self.polynomial.flat)
        m = self.polynomial.modes.astype(float)
        for angles in (angles for order in self._orders for angles in order):
            A, B = self.polynomial.flat
            for angle in angles:
                A, B = m[:, angle, None] * B, -m[:, angle, None] * A
            cosines.append(A)
            sines.append(B)
        return np.hstack(cosines), np.hstack(sines)

    @cached_property
    def _fourth_norms(self) -> Array:
        """Bounds on the norms of the fourth derivatives, shape (d, d, d, d)."""
        moduli = np.hypot(self.polynomial.cosines, self.polynomial.sines)
        m = np.abs(self.polynomial.modes).astype(float)
        d = m.shape[1]
        norms = np.empty((d, d, d, d))
        for angles in product(range(d), repeat=4):
            if tuple(sorted(angles)) == angles:
                norm = np.linalg.norm(np.einsum("m,mab->ab", np.prod(m[:, angles], axis=1), moduli), 2)
                for order in permutations(angles):
                    norms[order] = norm
        return norms

    def expand(self, centres: Array, half_widths: Array) -> Expansion:
        """Return the expansion over boxes (k, d)."""
        k, d = centres.shape
        n = self.polynomial.cosines.shape[1]
        phases, h = centres @ self.polynomial.modes.T, half_widths
        cosines, sines = self._coefficients
        stacked = (np.cos(phases) @ cosines + np.sin(phases) @ sines).reshape(k, -1, n, n)
        pairs, triples = self._orders[1:]
        curvatures, start = np.empty((k, d, d, n, n)), 1 + d
        for place, (i, j) in enumerate(pairs, start):
            curvatures[:, i, j] = curvatures[:, j, i] = stacked[:, place] * (h[:, i] * h[:, j])[:, None, None]
        thirds = stacked[:, start + len(pairs) :].reshape(k, len(triples), n * n)
        counts = np.array([len(set(permutations(triple))) for triple in triples])
        sizes = np.linalg.norm(thirds, axis=2) * np.prod(h[:, np.array(triples).reshape(-1, 3)], axis=2)
        remainders = sizes @ counts / 6
        quartic = self._fourth_norms.reshape(d, d, -1)
        squares = (h[:, :, None] * h[:, None]).reshape(k, -1)
        remainders += np.einsum("ki,kj,ijs,ks->k", h, h, quartic, squares, optimize=True) / 24
        return Expansion(stacked[:, 0], h[:, :, None, None] * stacked[:, 1:start], curvatures, remainders)


class Proof(NamedTuple):
    """Outcome of `prove_below`.

    Attributes
    ----------
    share
        Share of the volume in which the bound is proven; 1 for a proof.
    counterexample
        Angles at which an eigenvalue is above the bound; None where none was met.
    n_boxes
        Number of boxes that were looked at.
    open_boxes
        Centres and half widths of boxes that are left, each (k, d).
    """

    share: float
    counterexample: Array | None
    n_boxes: int
    open_boxes: tuple[Array, Array]

    @property
    def complete(self) -> bool:
        """Whether the bound is proven everywhere."""
        return self.counterexample is None and not len(self.open_boxes[0])


def prove_below(
    functions: Sequence[TrigPolynomial],
    bounds: Sequence[float],
    centres: Array,
    half_widths: Array,
    *,
    time_limit: float = np.inf,
    on_share: Callable[[float], object] = lambda share: None,
) -> Proof:
    """Prove that the largest eigenvalues of matrices stay below bounds over boxes, by branch and bound.

    On a box the matrix is its expansion to second order, and a remainder that is bounded by third derivatives. Without
    the negative part of the curvature the largest eigenvalue is convex, and largest at a corner of the box. Boxes that
    this does not settle are cut in two across the angle that adds most.

    Parameters
    ----------
    functions, bounds
        Polynomials of the same angles, and the bound of each.
    centres, half_widths
        Boxes, shape (k, d).
    time_limit
        Time after which the proof stops as it is [s].
    on_share
        Called with the proven share of the volume, to show progress.
    """
    taylors = [TaylorBounds(function) for function in functions]
    # rounding in samples and sums is far below this
    limits = [bound - function.left_out - 1e-9 * abs(bound) for function, bound in zip(functions, bounds, strict=True)]
    pending = [(np.asarray(centres, dtype=float), np.asarray(half_widths, dtype=float))]
    total = float(_volumes(pending[0][1]).sum())
    done, n_boxes, start = 0.0, 0, time.monotonic()
    while pending:
        if time.monotonic() - start > time_limit:
            break
        c, h = pending.pop()
        if len(c) > BATCH:
            pending.append((c[BATCH:], h[BATCH:]))
            c, h = c[:BATCH], h[:BATCH]
        n_boxes += len(c)
        is_open, angle = np.zeros(len(c), dtype=bool), np.zeros(len(c), dtype=int)
        for taylor, limit in zip(taylors, limits, strict=True):
            places = np.flatnonzero(~is_open)
            if not len(places):
                break
            above, unsettled, where = _settle(taylor, limit, c[places], h[places])
            if above is not None:
                return Proof(done / total, c[places][above], n_boxes, _joined(pending, c, h))
            is_open[places[unsettled]] = True
            angle[places[unsettled]] = where
        done += float(_volumes(h[~is_open]).sum())
        on_share(done / total)
        if np.any(is_open):
            pending.append(_halves(c[is_open], h[is_open], angle[is_open]))
    empty = np.zeros((0, np.shape(centres)[1]))
    return Proof(done / total if pending else 1.0, None, n_boxes, _joined(pending, empty, empty))


def _settle(taylor: TaylorBounds, limit: float, c: Array, h: Array) -> tuple[int | None, Array, Array]:
    """Return a box whose centre is above the limit, which boxes are not settled, and the angle to cut each across."""
    at = taylor.expand(c, h)
    largest = np.linalg.eigvalsh(at.values)[:, -1]
    if len(largest) and largest.max() > limit:
        return int(np.argmax(largest)), np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    slope_sizes = np.sqrt(np.einsum("kiab,kiab->ki", at.slopes, at.slopes))
    curvature_sizes = np.sqrt(np.einsum("kijab,kijab->kij", at.curvatures, at.curvatures))
    room = limit - largest - at.remainders
    left = np.flatnonzero(room < slope_sizes.sum(axis=1) + curvature_sizes.sum(axis=(1, 2)) / 2)
    hopeful = left[room[left] > 0]
    settled = np.zeros(len(c), dtype=bool)
    if len(hopeful):
        limits = limit - at.remainders[hopeful]
        settled[hopeful] = _below(at.values[hopeful], at.slopes[hopeful], at.curvatures[hopeful], limits)
    left = left[~settled[left]]
    weights = curvature_sizes[left].sum(axis=2) + 0.1 * slope_sizes[left]
    return None, left, np.argmax(weights, axis=1) if len(left) else np.zeros(0, dtype=int)


def _below(values: Array, slopes: Array, curvatures: Array, limits: Array) -> Array:
    """Return whether the largest eigenvalue of a quadratic matrix is below its limit on the cube |t_i| ≤ 1 of each box.

    Without the negative part of its curvature, as one form of t⊗x, it is convex in t, so that the corners decide.
    """
    k, d, n, _ = slopes.shape
    whole = curvatures.transpose(0, 1, 3, 2, 4).reshape(k, d * n, d * n)
    sizes, vectors = np.linalg.eigh(whole)
    whole = (vectors * np.maximum(sizes, 0.0)[:, None]) @ vectors.transpose(0, 2, 1)
    convex = whole.reshape(k, d, n, d, n).transpose(0, 1, 3, 2, 4)
    signs = np.array(list(product((-1.0, 1.0), repeat=d)))
    squares = (signs[:, :, None] * signs[:, None]).reshape(len(signs), d * d)
    corners = values[:, None] + (signs @ slopes.reshape(k, d, n * n)).reshape(k, -1, n, n)
    corners += (squares @ convex.reshape(k, d * d, n * n)).reshape(k, -1, n, n) / 2
    return np.all(np.linalg.eigvalsh(corners)[:, :, -1] <= limits[:, None], axis=1)


def _halves(c: Array, h: Array, angle: Array) -> tuple[Array, Array]:
    rows = np.arange(len(c))
    smaller, shift = h.copy(), np.zeros_like(h)
    smaller[rows, angle] /= 2
    shift[rows, angle] = smaller[rows, angle]
    return np.concatenate([c - shift, c + shift]), np.concatenate([smaller, smaller])


def _volumes(half_widths: Array) -> Array:
    """Return volumes over the angles that have a width."""
    return np.prod(np.where(half_widths > 0, 2 * half_widths, 1.0), axis=1)


def _joined(pending: Sequence[tuple[Array, Array]], c: Array, h: Array) -> tuple[Array, Array]:
    return np.concatenate([c, *(boxes for boxes, _ in pending)]), np.concatenate([h, *(sizes for _, sizes in pending)])
