"""Stiffness and damping of all motions within speeds and accelerations, as combinations of functions of the posture.

G = ∂(M q̈ + N)/∂q is affine in the accelerations a and quadratic in the speeds v, and D = ∂N/∂q̇ without friction is
linear in v:

    [G, D] = [G0, 0] + Σ a_j [A_j, 0] + Σ s_i [S_i, 0] + Σ_{i<j} v_i v_j [C_ij, 0] + Σ v_i [0, D_i],    s_i = v_i².

In each pair (v_i, s_i) it is affine. The parabola s = v² lies in the polygon of its chord and some tangents. So a
convex function of [G, D], such as a norm, is largest where each pair is at a corner and each a_j at its limit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product

import numpy as np

from tarc.analysis.workspace_boxes import Matrices
from tarc.core.types import Array
from tarc.plants.base import Plant


@dataclass(frozen=True)
class MotionCorners:
    """Corners of the motions within speeds and accelerations.

    Attributes
    ----------
    speed, acceleration
        Largest of each joint, shape (n,).
    n_tangents
        Number of tangents of the parabola s = v², its ends included; more are tighter.
    """

    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    n_tangents: int = 3

    @property
    def moving(self) -> list[int]:
        """Joints with a speed."""
        return [i for i, limit in enumerate(self.speed) if limit > 0]

    @property
    def accelerated(self) -> list[int]:
        """Joints with an acceleration."""
        return [i for i, limit in enumerate(self.acceleration) if limit > 0]

    def _pairs(self) -> list[tuple[float, float]]:
        """Corners of the polygon about s = v², −1 ≤ v ≤ 1."""
        ends = np.linspace(-1, 1, self.n_tangents)
        tangents = [((a + b) / 2, a * b) for a, b in pairwise(ends)]
        return [(-1.0, 1.0), *((float(v), float(s)) for v, s in tangents), (1.0, 1.0)]

    def count(self) -> int:
        """Return the number of corners."""
        n_pairs, n_moving = self.n_tangents + 1, len(self.moving)
        first = n_pairs // 2 if n_moving else 1
        return first * n_pairs ** max(n_moving - 1, 0) * 2 ** len(self.accelerated)

    def corners(self) -> list[tuple[Array, Array, Array]]:
        """Return v, s and a of each corner, over their limits.

        Of v and −v, which differ in the sign of D alone, one is enough.
        """
        n, moving, accelerated = len(self.speed), self.moving, self.accelerated
        choices = [self._pairs()] * len(moving)
        if choices:
            choices[0] = [pair for pair in choices[0] if pair[0] > 0]
        found = []
        for pairs in product(*choices):
            v, s = np.zeros(n), np.zeros(n)
            for joint, (speed, square) in zip(moving, pairs, strict=True):
                v[joint], s[joint] = speed, square
            for signs in product((-1.0, 1.0), repeat=len(accelerated)):
                a = np.zeros(n)
                a[accelerated] = signs
                found.append((v, s, a))
        return found

    def weights(self, v: Array, s: Array, a: Array) -> Array:
        """Return the factors of the parts of `parts`."""
        moving, accelerated = self.moving, self.accelerated
        mixed = [v[i] * v[j] for i, j in combinations(moving, 2)]
        return np.array([1.0, *a[accelerated], *s[moving], *mixed, *v[moving]])

    def parts(self, plant: Plant) -> list[Matrices]:
        """Return the functions of the posture [G, D] that these factors multiply, each (k, n, 2n)."""
        n = len(self.speed)
        speeds, accelerations, zero = np.diag(self.speed), np.diag(self.acceleration), np.zeros(n)

        def motion(postures: Array, v: Array, a: Array) -> Array:
            ones = np.ones(len(postures))
            _, D, G = plant.linearised_at(postures.T, np.outer(v, ones), np.outer(a, ones))
            still = plant.linearised_at(postures.T, np.outer(zero, ones), np.outer(zero, ones))
            D = D - still[1]
            return np.concatenate([G - still[2], D], axis=2)

        def rest(postures: Array) -> Array:
            zeros = np.zeros((n, len(postures)))
            G = plant.linearised_at(postures.T, zeros, zeros)[2]
            return np.concatenate([G, 0 * G], axis=2)

        def stiffness(terms: Sequence[tuple[float, Array]], acceleration: Array = zero) -> Matrices:
            def at(postures: Array) -> Array:
                total = np.sum([factor * motion(postures, v, acceleration) for factor, v in terms], axis=0)
                return np.concatenate([total[:, :, :n], 0 * total[:, :, n:]], axis=2)

            return at

        def damping(v: Array) -> Matrices:
            def at(postures: Array) -> Array:
                values = motion(postures, v, zero)
                return np.concatenate([0 * values[:, :, :n], values[:, :, n:]], axis=2)

            return at

        found: list[Matrices] = [rest]
        found += [stiffness([(1.0, zero)], accelerations[j]) for j in self.accelerated]
        found += [stiffness([(1.0, speeds[i])]) for i in self.moving]
        found += [
            stiffness([(1.0, speeds[i] + speeds[j]), (-1.0, speeds[i]), (-1.0, speeds[j])])
            for i, j in combinations(self.moving, 2)
        ]
        return [*found, *(damping(speeds[i]) for i in self.moving)]
