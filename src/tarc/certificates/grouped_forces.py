"""Bounds on stiffness and damping by parts of the motion, for robots with too many corners of their motions."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tarc.analysis.motion_forces import ForceGroup, MotionCorners
from tarc.analysis.operating_points import MAX_LEAD_TIME, NEGLIGIBLE_STIFFNESS
from tarc.analysis.workspace_boxes import Matrices, angles_that_matter, as_polynomials, in_angles
from tarc.certificates.affine import find_proof
from tarc.certificates.affine_cover import ACCELERATION_SHARE, LEAD_FACTORS
from tarc.certificates.robot_evidence import AffineCover
from tarc.core.types import Array
from tarc.numerics.eigenvalue_proof import Boxes
from tarc.numerics.trig_polynomial import DEGREE, PolynomialFamily, TrigPolynomial, too_large
from tarc.plants.base import Plant

FORCE_ROOM = 1.1
"""Factor on the largest norm found of each group. What is nearer takes more boxes, what is farther a slower loop."""
NEGLIGIBLE_JOINT = 0.01
"""Share of the largest part of a group below which a joint's parts are bounded by a constant, without corners."""
SEARCH_SAMPLES = 300
"""Number of postures at which the largest norm is looked for."""
N_STARTS = 6
"""Number of corners from whose worst posture a pattern search starts."""
FIRST_STEP, LAST_STEP = 0.3, 1e-3
"""Steps of that search [rad]."""


class GroupsLeftOut(Exception):
    """Why there are no bounds by groups."""


@dataclass(frozen=True, eq=False)
class GroupBound:
    """A group of forces, and the norm up to which it is to be proven.

    Attributes
    ----------
    group
        The group.
    functions
        [0, K; Kᵀ, 0] at each corner of its motions and for each plant, with K = M̂^−½ G M̂^−½ or M̂^−½ D M̂^−½.
    angles
        Joints whose angles they depend on.
    largest
        Largest ‖K‖ that was found, [1/s²] or, for damping, [1/s].
    """

    group: ForceGroup
    functions: list[TrigPolynomial]
    angles: Array
    largest: float

    @property
    def limit(self) -> float:
        """The bound to prove."""
        return max(FORCE_ROOM * self.largest, NEGLIGIBLE_STIFFNESS)

    def scaled(self) -> list[TrigPolynomial]:
        """Return the functions over the bound, whose eigenvalues must be below one."""
        return [(1 / self.limit) * function for function in self.functions]

    def norm_at(self, index: int, posture: Array) -> float:
        """Return ‖K‖ at a corner and a posture, with what the function leaves out."""
        function = self.functions[index]
        values = np.linalg.eigvalsh(function(posture[self.angles][None])[0])
        return float(values[-1]) + function.left_out

    def __str__(self) -> str:
        return f"up to {self.limit:.4g} {'1/s' if self.group.is_damping else '1/s²'}"


def group_bounds(
    plants: Sequence[Plant], inverse_root: Array, corners: MotionCorners, boxes: Boxes, *, deadline: float = np.inf
) -> list[GroupBound]:
    """Return the groups of forces of plants at all motions, with the largest norm that a search finds.

    Parameters
    ----------
    plants
        Robots, such as one without and one with its payload.
    inverse_root
        M̂^−½, shape (n, n).
    corners
        Speeds and accelerations.
    boxes
        Postures.
    deadline
        `time.monotonic` at which they are left out [s].

    Raises
    ------
    GroupsLeftOut
        Where the time ends, and before functions of a group that are `too_large`.
    """
    groups, bounds = corners.groups(), []
    parts = [corners.parts(plant) for plant in plants]
    for number, group in enumerate(groups, 1):

        def check_time(place: str = f"group {number} of {len(groups)}, {group.name}") -> None:
            if time.monotonic() >= deadline:
                raise GroupsLeftOut(f"the time ended at {place}")

        rows = [
            [_dilation(row[place], inverse_root, group.is_damping, check_time) for place in group.places]
            for row in parts
        ]
        angles = angles_that_matter([function for row in rows for function in row], boxes)
        _check_size(group, len(plants) * len(group.places), (2 * DEGREE + 1) ** len(angles), 2 * len(inverse_root))
        polynomials = [
            as_polynomials(row, plant.label, boxes[0][0], angles) for row, plant in zip(rows, plants, strict=True)
        ]
        families = [_family(corners, group, row) for row in polynomials]
        n_functions, n_modes = sum(len(family.weights) for family, _ in families), families[-1][0].n_modes
        _check_size(group, n_functions, 2 * n_modes, 2 * len(inverse_root))
        functions = [
            replace(member, left_out=member.left_out + constant)
            for family, constant in families
            for member in family.members()
        ]
        largest = largest_eigenvalue(functions, in_angles(boxes, angles), check_time)
        bounds.append(GroupBound(group, functions, angles, largest))
    return bounds


def _check_size(group: ForceGroup, n_functions: int, n_coefficients: int, size: int) -> None:
    """Raise GroupsLeftOut for functions of a group that need too much memory."""
    reason = too_large(n_functions, n_coefficients, size)
    if reason:
        raise GroupsLeftOut(f"{group.name}: {reason}")


def _dilation(function: Matrices, inverse_root: Array, is_damping: bool, check_time: Callable[[], None]) -> Matrices:
    """Return [0, K; Kᵀ, 0] of a part of [G, D], whose largest eigenvalue is ‖K‖."""
    n = len(inverse_root)

    def at(postures: Array) -> Array:
        check_time()
        values = function(postures)
        matrix = np.zeros((len(values), 2 * n, 2 * n))
        K = inverse_root @ (values[:, :, n:] if is_damping else values[:, :, :n]) @ inverse_root
        matrix[:, :n, n:] = K
        matrix[:, n:, :n] = K.transpose(0, 2, 1)
        return matrix

    return at


def _family(corners: MotionCorners, group: ForceGroup, parts: list[TrigPolynomial]) -> tuple[PolynomialFamily, float]:
    """Return the sums at all corners, and a constant bound on the parts of joints that hardly matter."""
    sizes = np.array([part.sup_norm() for part in parts])
    joints = sorted({joint for part in group.joints for joint in part})
    shares = {joint: sum(s for s, part in zip(sizes, group.joints, strict=True) if joint in part) for joint in joints}
    left_out = [joint for joint in joints if shares[joint] <= NEGLIGIBLE_JOINT * sizes.max()]
    constant = float(sum(s for s, part in zip(sizes, group.joints, strict=True) if set(part) & set(left_out)))
    return PolynomialFamily.from_parts(parts, corners.group_weights(group, left_out)), constant


def largest_eigenvalue(
    functions: Sequence[TrigPolynomial], boxes: Boxes, check_time: Callable[[], None] = lambda: None
) -> float:
    """Return the largest eigenvalue that samples and pattern search find in boxes, with what functions leave out.

    Parameters
    ----------
    functions, boxes
        The functions, and where to search.
    check_time
        Called before each function, to end the search.
    """
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(boxes[0]), size=SEARCH_SAMPLES)
    postures = boxes[0][chosen] + rng.uniform(-1, 1, (SEARCH_SAMPLES, boxes[0].shape[1])) * boxes[1][chosen]
    values = np.array([_largest(function, postures, check_time) for function in functions])
    starts = np.argsort(values.max(axis=1))[::-1][:N_STARTS]
    largest = 0.0
    for i in starts.tolist():
        j = int(values[i].argmax())
        low, high = (boxes[0][chosen[j]] + sign * boxes[1][chosen[j]] for sign in (-1, 1))
        value = _climb(functions[i], postures[j], float(values[i, j]), low, high)
        largest = max(largest, value + functions[i].left_out)
    return largest


def _largest(function: TrigPolynomial, postures: Array, check_time: Callable[[], None]) -> Array:
    check_time()
    return np.linalg.eigvalsh(function(postures))[:, -1]


def _climb(function: TrigPolynomial, start: Array, value: float, low: Array, high: Array) -> float:
    """Return the largest eigenvalue that steps along the angles reach from a posture."""
    step, steps = FIRST_STEP, np.vstack([np.eye(len(start)), -np.eye(len(start))])
    while step > LAST_STEP and len(start):
        candidates = np.clip(start + step * steps, low, high)
        values = np.linalg.eigvalsh(function(candidates))[:, -1]
        best = int(values.argmax())
        if values[best] > value:
            start, value = candidates[best], float(values[best])
        else:
            step /= 2
    return value


def cover_groups(cover: AffineCover, bounds: Sequence[GroupBound]) -> AffineCover | None:
    """Return a Lyapunov function that covers the sum of groups of forces; None where none was found.

    With ‖G‖ at most g, the sum over the groups of stiffness, and ‖D‖ at most d, in units of M̂, for every θ

        ‖E⁻¹ [H, C/θ]‖ ≤ (g² + d²/θ²)^½.

    Parameters
    ----------
    cover
        The one that covers what was found. Ratios and rates are as there.
    bounds
        The groups.
    """
    stiffness = sum(bound.limit for bound in bounds if not bound.group.is_damping)
    damping = sum(bound.limit for bound in bounds if bound.group.is_damping)
    lead_times = np.zeros(1)
    if damping > NEGLIGIBLE_STIFFNESS:
        lead_times = min(damping / stiffness, MAX_LEAD_TIME) * np.array(LEAD_FACTORS)
    ratios = replace(
        cover.proof.ratios,
        powers=np.ones(len(lead_times)),
        lead_times=lead_times,
        stiffness=np.hypot(stiffness, damping / lead_times) if lead_times.all() else np.array([stiffness]),
        shares=np.full(len(lead_times), ACCELERATION_SHARE),
        form=None,
    )
    proof = find_proof(cover.proof.loop.full.loop, ratios)
    return None if proof is None else replace(cover, proof=proof)
