"""Proofs by branch and bound that the eigenvalues of trigonometric polynomials stay below a bound over boxes.

On a box with centre c and half widths h, with q = c + t h and |t_i| ≤ 1, B = b I − F is

    B(q) = B(c) − Σ t_i h_i ∂_i F − ½ Σ t_i t_j h_i h_j ∂_ij F − cubic terms − fourth order.

With L Lᵀ = B(c) and S = L⁻¹, it is positive definite if S B Sᵀ is. So a change counts relative to the room that is left
in its own direction. In these coordinates the cubic terms are bounded by their norms at c. Entry by entry, the fourth
order is at most Σ_m (Σ_i |m_i| h_i)⁴/24 √(A_m² + B_m²).

The rest is quadratic in t. With only the positive part of each h_i² ∂_ii F it is convex in each t_i by itself. So its
largest eigenvalue is at a corner of the box, and all corners are tested. This holds for products t_i t_j as well, which
the corners contain exactly.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, permutations, product
from math import factorial
from typing import NamedTuple

import numpy as np

from tarc.core.types import Array
from tarc.numerics.trig_polynomial import TrigPolynomial

ALLOWANCE = 1e-8
"""What is taken from every bound, over the sum of all coefficients' moduli.

It stands for rounding in the samples, the coefficients and the values, which is at most 10⁻¹¹ of this sum.
"""
ROUNDING = 1e-11
"""Bound on rounding in the value and in each derivative, over the sums of their coefficients' moduli.

A sum of K terms with phases up to 10 π rounds by at most (K + 100) 2⁻⁵³ of it, and K is at most 2 × 10⁴.
"""
MIN_ROOM = 1e-6
"""What must be left of S B Sᵀ, whose centre is the identity. It stands for rounding in S and in the corners' test."""
MAX_CONDITION = 1e8
"""Largest condition of B(c) for which S counts: n² 2⁻⁵³ times this is below `MIN_ROOM`."""
MIN_PIVOT = 1e-12
"""Pivot of a matrix near the identity that does not count as positive."""
SLOPE_WEIGHT = 0.1
"""Weight of first derivatives, against higher ones, in the choice of the angle to cut across."""
MAX_BATCH = 256
"""Largest number of boxes that are looked at together; more leave the cache."""
BATCH_NUMBERS = 4_000_000
"""Largest number of phases and derivatives of these boxes together."""

Boxes = tuple[Array, Array]
"""Centres and half widths of boxes, each (k, d)."""


class Proof(NamedTuple):
    """Outcome of `prove_below`.

    Attributes
    ----------
    share
        Share of the volume in which the bounds are proven, the mean over the functions; 1 for a proof.
    counterexample
        Index of a function and angles at which it has an eigenvalue above its bound; None where none was met.
    n_boxes
        Number of boxes that were looked at.
    open_boxes
        Boxes that are left, for each function.
    interrupted
        Whether Ctrl-C ended the proof.
    """

    share: float
    counterexample: tuple[int, Array] | None
    n_boxes: int
    open_boxes: list[Boxes]
    interrupted: bool = False

    @property
    def complete(self) -> bool:
        """Whether the bounds are proven everywhere."""
        return self.counterexample is None and not any(len(c) for c, _ in self.open_boxes)


class Outcome(NamedTuple):
    """What is known of some boxes.

    Attributes
    ----------
    above
        A box at whose centre an eigenvalue is above the bound; None for none.
    left
        The boxes in which the bound is not proven.
    cuts
        For each of them, the angle to cut it across.
    """

    above: int | None
    left: Array
    cuts: Array


@dataclass(frozen=True, eq=False)
class BoxTest:
    """A test of whether the largest eigenvalue of F(q) stays below a bound over boxes.

    Attributes
    ----------
    function
        F.
    bound
        b.
    """

    function: TrigPolynomial
    bound: float

    @cached_property
    def _upper(self) -> tuple[Array, Array]:
        return np.triu_indices(self.function.cosines.shape[1])

    @cached_property
    def _positions(self) -> Array:
        """Place of each entry of a symmetric matrix among those of its upper half, shape (n, n)."""
        n = self.function.cosines.shape[1]
        places = np.zeros((n, n), dtype=int)
        places[self._upper] = np.arange(len(self._upper[0]))
        return np.maximum(places, places.T)

    @cached_property
    def _weights(self) -> Array:
        """How often each entry of the upper half occurs."""
        return np.where(self._upper[0] == self._upper[1], 1.0, 2.0)

    @cached_property
    def _sizes(self) -> Array:
        """√(A_m² + B_m²), the upper half, shape (K, n (n + 1)/2)."""
        return np.hypot(*(part[:, *self._upper] for part in (self.function.cosines, self.function.sines)))

    @cached_property
    def limit(self) -> float:
        """The bound without what rounding and terms left out may add."""
        moduli = float(np.linalg.norm(self._sizes.sum(axis=0)[self._positions]))
        return self.bound - self.function.left_out - ALLOWANCE * moduli

    @cached_property
    def orders(self) -> list[tuple[int, ...]]:
        """Angles of all derivatives from the first to the third."""
        d = self.function.n_angles
        return [angles for order in (1, 2, 3) for angles in combinations_with_replacement(range(d), order)]

    @cached_property
    def _factors(self) -> Array:
        """Number of orders of each derivative's angles, over the factorial of their number."""
        return np.array([len(set(permutations(angles))) / factorial(len(angles)) for angles in self.orders])

    @cached_property
    def _coefficients(self) -> Array:
        """Coefficients of F and its derivatives, of the cosines and then of the sines, shape (2 K, ·)."""
        A, B = (part[:, *self._upper] for part in (self.function.cosines, self.function.sines))
        m = self.function.modes.astype(float)
        columns = [np.vstack([A, B])]
        for angles in self.orders:
            a, b = A, B
            for angle in angles:
                a, b = m[:, angle, None] * b, -m[:, angle, None] * a
            columns.append(np.vstack([a, b]))
        return np.hstack(columns)

    @property
    def batch(self) -> int:
        """Number of boxes to look at together."""
        corners = 2**self.function.n_angles * self.function.cosines.shape[1] ** 2
        return int(np.clip(BATCH_NUMBERS // max(sum(self._coefficients.shape), corners), 1, MAX_BATCH))

    @cached_property
    def _corners(self) -> tuple[Array, Array]:
        """The signs t of all corners, and their products t_i t_j, i < j."""
        d = self.function.n_angles
        signs = np.array(list(product((-1.0, 1.0), repeat=d)))
        i, j = np.triu_indices(d, 1)
        return signs, signs[:, i] * signs[:, j]

    def _expand(self, c: Array, h: Array) -> tuple[Array, Array, Array]:
        """Return F, its derivatives as they occur in the expansion, and the bound on the rest; all the upper half."""
        m = self.function.modes.astype(float)
        phases = c @ m.T
        terms = np.hstack([np.cos(phases), np.sin(phases)]) @ self._coefficients
        terms = terms.reshape(len(c), 1 + len(self.orders), -1)
        steps = np.array([np.prod(h[:, list(angles)], axis=1) for angles in self.orders]).reshape(-1, len(c)).T
        reach = h @ np.abs(m).T
        rest = (reach**4 / 24 + ROUNDING * (1 + reach) ** 3) @ self._sizes
        return terms[:, 0], terms[:, 1:] * (steps * self._factors)[:, :, None], rest

    def apply(self, c: Array, h: Array) -> Outcome:
        """Test boxes (k, d)."""
        n = self.function.cosines.shape[1]
        values, derivatives, rest = self._expand(c, h)
        B = self.limit * np.eye(n) - values[:, self._positions]
        sizes = np.linalg.eigvalsh(B)
        nothing = np.zeros(0, dtype=int)
        if sizes[:, 0].min() < 0:
            return Outcome(int(np.argmin(sizes[:, 0])), nothing, nothing)
        norms = np.sqrt(derivatives**2 @ self._weights).sum(axis=1) + np.sqrt(rest**2 @ self._weights)
        left = np.flatnonzero(norms >= sizes[:, 0] * (1 - MIN_ROOM))
        if not len(left):
            return Outcome(None, nothing, nothing)
        is_sound = sizes[left, 0] * MAX_CONDITION > sizes[left, -1]
        B[left[~is_sound]] = np.eye(n)
        settled, cuts = self._scaled_test(
            B[left], derivatives[left][:, :, self._positions], rest[left][:, self._positions]
        )
        settled &= is_sound
        return Outcome(None, left[~settled], cuts[~settled])

    def _scaled_test(self, B: Array, derivatives: Array, rest: Array) -> tuple[Array, Array]:
        """Return whether each box is settled in the coordinates of its own room, and the angle to cut it across."""
        d, n = self.function.n_angles, B.shape[1]
        S = np.linalg.inv(np.linalg.cholesky(B))
        transposed = S.transpose(0, 2, 1)
        scaled = S[:, None] @ derivatives @ transposed[:, None]
        norms = np.linalg.norm(scaled, axis=(2, 3))
        n_second = d * (d + 1) // 2
        fourth = np.linalg.norm(np.abs(S) @ rest @ np.abs(transposed), axis=(1, 2))
        room = 1 - MIN_ROOM - fourth - norms[:, d + n_second :].sum(axis=1)
        settled = np.zeros(len(B), dtype=bool)
        hopeful = np.flatnonzero(room > 0)
        if len(hopeful):
            slopes, curvatures = scaled[hopeful, :d], scaled[hopeful, d : d + n_second]
            corners = room[hopeful, None, None] * np.eye(n) - self._convex_part(curvatures)
            signs, products = self._corners
            k = len(hopeful)
            is_mixed = np.array([len(set(angles)) == 2 for angles in self.orders[d : d + n_second]])
            mixed = curvatures[:, is_mixed].reshape(k, -1, n * n)
            changes = signs @ slopes.reshape(k, d, n * n) + products @ mixed
            corners = corners[:, None] - changes.reshape(k, -1, n, n)
            settled[hopeful] = positive_definite(corners.reshape(-1, n, n)).reshape(k, -1).all(axis=1)
        counts = np.array([[angles.count(i) for i in range(d)] for angles in self.orders], dtype=float)
        counts[:d] *= SLOPE_WEIGHT
        return settled, np.argmax(norms @ counts, axis=1)

    def _convex_part(self, curvatures: Array) -> Array:
        """Return the sum of the positive parts of what multiplies the squares t_i²."""
        n_second, d = curvatures.shape[1], self.function.n_angles
        is_square = [len(set(angles)) == 1 for angles in self.orders[d : d + n_second]]
        values, vectors = np.linalg.eigh(curvatures[:, np.array(is_square)])
        return ((vectors * np.maximum(values, 0)[..., None, :]) @ vectors.swapaxes(-1, -2)).sum(axis=1)


def positive_definite(matrices: Array) -> Array:
    """Return whether all pivots of each of many small symmetric matrices (k, n, n) are above `MIN_PIVOT`."""
    A = np.ascontiguousarray(matrices.transpose(1, 2, 0))
    n = len(A)
    result = np.ones(A.shape[2], dtype=bool)
    for j in range(n):
        result &= A[j, j] > MIN_PIVOT
        rows = A[j, j + 1 :] * (result / np.where(result, A[j, j], 1.0))
        for i in range(j + 1, n):
            A[i, i:] -= rows[i - j - 1] * A[j, i:]
    return result


def prove_below(
    functions: Sequence[TrigPolynomial],
    bounds: Sequence[float],
    boxes: Boxes,
    *,
    time_limit: float = np.inf,
    on_progress: Callable[[float, list[Boxes], int], object] = lambda share, open_boxes, n_boxes: None,
    open_boxes: Sequence[Boxes] | None = None,
) -> Proof:
    """Prove that the largest eigenvalues of matrices stay below bounds over boxes, by branch and bound.

    Boxes that the test of this module does not settle are cut in two across the angle that adds most.

    Parameters
    ----------
    functions, bounds
        Polynomials of the same angles, and the bound of each.
    boxes
        Centres and half widths, each (k, d).
    time_limit
        Time after which the proof stops as it is [s]. Each function has the same part of it, and what others leave.
    on_progress
        Called with the proven share, the open boxes and the number of boxes that were looked at.
    open_boxes
        Boxes that an earlier proof left, for each function, to go on from.
    """
    boxes = np.asarray(boxes[0], dtype=float), np.asarray(boxes[1], dtype=float)
    total = max(float(_volumes(boxes[1]).sum()), 1e-300)
    left = [boxes] * len(functions) if open_boxes is None else list(open_boxes)
    volumes = np.array([_volumes(h).sum() for _, h in left]) / total
    start, n_boxes = time.monotonic(), 0

    def share() -> float:
        return 1 - float(np.mean(volumes)) if any(len(c) for c, _ in left) else 1.0

    try:
        while True:
            unfinished = [i for i, (c, _) in enumerate(left) if len(c)]
            remaining = time_limit - (time.monotonic() - start)
            if not unfinished or remaining <= 0:
                return Proof(share(), None, n_boxes, left)
            for place, i in enumerate(unfinished):
                remaining = time_limit - (time.monotonic() - start)
                until = time.monotonic() + max(remaining, 0.0) / (len(unfinished) - place)
                test = BoxTest(functions[i], bounds[i])
                while len(left[i][0]) and time.monotonic() < until:
                    above, count, left[i] = _step(test, left[i])
                    volumes[i] = _volumes(left[i][1]).sum() / total
                    n_boxes += count
                    if above is not None:
                        return Proof(share(), (i, above), n_boxes, left)
                    on_progress(share(), left, n_boxes)
    except KeyboardInterrupt:
        return Proof(share(), None, n_boxes, left, interrupted=True)


def _step(test: BoxTest, boxes: Boxes) -> tuple[Array | None, int, Boxes]:
    """Test the last boxes; return a counterexample, their number, and what is left, with the halves last."""
    c, h = (part[-test.batch :] for part in boxes)
    rest = [part[: -test.batch] for part in boxes]
    above, left, cuts = test.apply(c, h)
    if above is not None:
        return c[above], len(c), boxes
    rows = np.arange(len(left))
    centres, halves = c[left], h[left].copy()
    halves[rows, cuts] /= 2
    shift = np.zeros_like(halves)
    shift[rows, cuts] = halves[rows, cuts]
    added = np.concatenate([centres - shift, centres + shift]), np.concatenate([halves, halves])
    return None, len(c), (np.concatenate([rest[0], added[0]]), np.concatenate([rest[1], added[1]]))


def _volumes(half_widths: Array) -> Array:
    """Return volumes over the angles that have a width."""
    return np.prod(np.where(half_widths > 0, 2 * half_widths, 1.0), axis=1)
