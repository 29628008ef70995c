"""Stiffness and damping of all motions within speeds and accelerations, as combinations of functions of the posture.

G = ∂(M q̈ + N)/∂q is affine in the accelerations a and quadratic in the speeds v, and D = ∂N/∂q̇ is affine in v, with
viscous friction D0:

    [G, D] = [G0, D0] + Σ a_j [A_j, 0] + Σ s_i [S_i, 0] + Σ_{i<j} v_i v_j [C_ij, 0] + Σ v_i [0, D_i],    s_i = v_i².

In each pair (v_i, s_i) it is affine. The parabola s = v² lies in the polygon of its chord and some tangents. So a
convex function of [G, D], such as a norm, is largest where each pair is at a corner and each a_j at its limit.

That is too many corners for six joints. `MotionCorners.groups` bounds three parts of it by themselves. What is
quadratic in v is a bilinear form Q(u, v) at u = v. So its norm is at most that of Q at any u and v, which is largest
where both are corners of the box of the speeds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement, pairwise, product
from typing import NamedTuple

import numpy as np

from tarc.analysis.workspace_boxes import Matrices
from tarc.core.types import Array
from tarc.plants.base import Plant


class ForceGroup(NamedTuple):
    """Parts of [G, D] whose sum is bounded by itself.

    Attributes
    ----------
    name
        What they are.
    places
        Places of the parts in `MotionCorners.parts`.
    is_damping
        Whether they are parts of D, and not of G.
    joints
        Joints on whose motion each part depends.
    """

    name: str
    places: tuple[int, ...]
    is_damping: bool
    joints: tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class MotionCorners:
    """Corners of the motions within speeds and accelerations.

    Attributes
    ----------
    speed, acceleration
        Largest of each joint, shape (n,).
    n_tangents
        Number of tangents of the parabola s = v², its ends included; more are tighter.
    has_friction
        Whether there is viscous friction, so that v and −v differ. What has none lies between these two.
    """

    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    n_tangents: int = 3
    has_friction: bool = False

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
        first = (n_pairs if self.has_friction else n_pairs // 2) if n_moving else 1
        return first * n_pairs ** max(n_moving - 1, 0) * 2 ** len(self.accelerated)

    def corners(self) -> list[tuple[Array, Array, Array]]:
        """Return v, s and a of each corner, over their limits.

        Of v and −v, which differ in the sign of D alone, one is enough without friction.
        """
        n, moving, accelerated = len(self.speed), self.moving, self.accelerated
        choices = [self._pairs()] * len(moving)
        if choices and not self.has_friction:
            choices[0] = [pair for pair in choices[0] if pair[0] > 0]
        corners = []
        for pairs in product(*choices):
            v, s = np.zeros(n), np.zeros(n)
            for joint, (speed, square) in zip(moving, pairs, strict=True):
                v[joint], s[joint] = speed, square
            for signs in product((-1.0, 1.0), repeat=len(accelerated)):
                a = np.zeros(n)
                a[accelerated] = signs
                corners.append((v, s, a))
        return corners

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
            _, D, G = plant.linearised_at(postures.T, zeros, zeros)
            return np.concatenate([G, D], axis=2)

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

        matrices: list[Matrices] = [rest]
        matrices += [stiffness([(1.0, zero)], accelerations[j]) for j in self.accelerated]
        matrices += [stiffness([(1.0, speeds[i])]) for i in self.moving]
        matrices += [
            stiffness([(1.0, speeds[i] + speeds[j]), (-1.0, speeds[i]), (-1.0, speeds[j])])
            for i, j in combinations(self.moving, 2)
        ]
        return [*matrices, *(damping(speeds[i]) for i in self.moving)]

    def groups(self) -> list[ForceGroup]:
        """Return the groups of the parts: gravity and acceleration, products of speeds, and damping."""
        moving, pairs = self.moving, list(combinations(self.moving, 2))
        joints = [(), *((j,) for j in self.accelerated), *((i,) for i in moving), *pairs, *((i,) for i in moving)]
        speeds = 1 + len(self.accelerated)
        damping = speeds + len(moving) + len(pairs)
        chosen = [
            ("stiffness by gravity and acceleration", range(speeds), False),
            ("stiffness by speeds", range(speeds, damping), False),
            ("damping", (0, *range(damping, len(joints))), True),
        ]
        return [
            ForceGroup(name, tuple(places), is_damping, tuple(joints[place] for place in places))
            for name, places, is_damping in chosen
            if len(places)
        ]

    def group_weights(self, group: ForceGroup, left_out: Sequence[int] = ()) -> list[Array]:
        """Return factors of the parts of a group that contain all motions, without those of some joints."""
        n, kept = len(self.speed), sorted({joint for part in group.joints for joint in part} - set(left_out))
        is_constant = [not part for part in group.joints]
        signs = np.zeros((2 ** len(kept), n))
        signs[:, kept] = np.array(list(product((1.0, -1.0), repeat=len(kept)))).reshape(len(signs), -1)
        if not any(is_constant) or (group.is_damping and not self.has_friction):
            signs = signs[: max(len(signs) // 2, 1)]  # the others are these with the other sign
        if any(is_constant):
            return [np.array([sign[part[0]] if part else 1.0 for part in group.joints]) for sign in signs]
        return [
            np.array([(u[part[0]] * v[part[-1]] + u[part[-1]] * v[part[0]]) / 2 for part in group.joints])
            for u, v in combinations_with_replacement(signs, 2)
        ]
