"""What a robot is along its motions in a workspace: inertia that is off, stiffness, damping, how fast they change."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from tarc.analysis.inertia_ratio import inertias
from tarc.analysis.workspace import Workspace
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.plants.base import Plant

SEARCHES = 3
"""How many postures are starts of a local search."""
STEP = 1e-5
"""Step of its differences, in widths of the box; what is searched for is a difference itself."""
NUDGE = 1e-5
"""Step of the differences of the inertia over a joint [rad or m]."""
CORNERS = 9
"""Joints up to which all combinations of their greatest speeds are tried."""
TURNS = 3
"""Most joints whose speed or acceleration a search changes."""
LONGEST = 1.0
"""Greatest lead [s]."""
ADDED = 0.02, 0.06, 0.12, 0.2, 0.35
"""Shares of what is left of a ball's centre that stiffness and damping may take."""
TOGETHER = 64
"""Of how many robots norms are computed at once."""
NEGLIGIBLE = 1e-9
"""Stiffness [1/s²] and damping [1/s] of a robot below which they count as none."""


class Instant(NamedTuple):
    """A robot in a posture, at rest or moving: position, velocity and acceleration, each (n,)."""

    plant: Plant
    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def at_rest(cls, plant: Plant, position: Array) -> "Instant":
        """Without velocity and acceleration."""
        still = np.zeros(plant.n_joints)
        return cls(plant, np.asarray(position, dtype=float), still, still)

    @property
    def moves(self) -> bool:
        """Whether it does."""
        return bool(np.any(self.velocity) or np.any(self.acceleration))


@dataclass(frozen=True, eq=False)
class Mismatches:
    """What k robots differ in from a double integrator, each (k, n, n): ẍ = E v − H x − C ẋ in coordinates x = M̂^½ q.

    E = M̂^½ M⁻¹ M̂^½, H = M̂^½ M⁻¹ (∂(M q̈ + N)/∂q) M̂^−½ [1/s²] and C = M̂^½ M⁻¹ (∂N/∂q̇) M̂^−½ [1/s], of the last that part
    which is not there at rest: viscous friction is left out.
    """

    inertia: Array
    stiffness: Array
    damping: Array

    def sizes(self, lead: float) -> Array:
        """‖[H, C/lead]‖ of each [1/s²], for the lead by which the velocity counts beside the position [s]."""
        return _norms(_beside(self.stiffness, self.damping, lead))

    def joint_norms(self, centre: float, weight: float, lead: float = 0.0) -> Array:
        """‖[E − ρ0 I, H/η, C/(η lead)]‖ of each: what a ball about the centre must hold, with the weight η [1/s²]."""
        apart = self.inertia - centre * np.eye(self.inertia.shape[1])
        beside = _beside(self.stiffness, self.damping, lead) / weight
        return _norms(np.concatenate([apart, beside], axis=2))

    def needed(self, centre: float, weight: float, lead: float = 0.0) -> float:
        """The greatest of `joint_norms`, of those alone whose Frobenius norm is not below it already."""
        apart = self._squares[0] - 2 * centre * self._squares[1] + centre**2 * self.inertia.shape[1]
        bounds = apart + (self._squares[2] + (self._squares[3] / lead**2 if lead else 0.0)) / weight**2
        best, order = 0.0, np.argsort(bounds)[::-1]
        for start in range(0, len(order), TOGETHER):
            some = order[start : start + TOGETHER]
            if bounds[some[0]] * (1 + 1e-9) < best**2:
                break
            part = Mismatches(self.inertia[some], self.stiffness[some], self.damping[some])
            best = max(best, float(part.joint_norms(centre, weight, lead).max()))
        return best

    def weights(self, centre: float, lead: float) -> list[float]:
        """The weights η [1/s²] that are worth a try, the heaviest first; none without stiffness and damping.

        The heavier, the less is added to what E alone needs, and the less the loop bears. They are those with which
        what is left of the centre, ρ0 − δ, shrinks by the shares of `ADDED`.
        """
        stiffest = float(self.sizes(lead).max())
        if not stiffest > NEGLIGIBLE:
            return []
        alone = self.needed(centre, np.inf)
        spare = centre - alone if alone < centre else centre
        tried = np.geomspace(100.0, 0.01, 40)
        needed = np.array([self.needed(centre, stiffest / centre * float(one), lead) for one in tried])
        logs = np.interp([alone + share * spare for share in ADDED], needed, np.log(tried))
        return [stiffest / centre * float(np.exp(one)) for one in dict.fromkeys(logs)]

    @cached_property
    def _squares(self) -> tuple[Array, ...]:
        """tr E², tr E, ‖H‖²_F and ‖C‖²_F."""
        E, H, C = (np.sum(one**2, axis=(1, 2)) for one in (self.inertia, self.stiffness, self.damping))
        return E, np.trace(self.inertia, axis1=1, axis2=2), H, C

    def lead(self) -> float:
        """The time for which the greatest damping counts as much as the greatest stiffness, or LONGEST if that is less
        [s]; zero for no damping.
        """
        stiffest, most = (float(_norms(one).max()) for one in (self.stiffness, self.damping))
        return min(most / max(stiffest, NEGLIGIBLE), LONGEST) if most > NEGLIGIBLE else 0.0

    def __or__(self, other: "Mismatches") -> "Mismatches":
        pairs = (self.inertia, other.inertia), (self.stiffness, other.stiffness), (self.damping, other.damping)
        return Mismatches(*(np.concatenate(pair) for pair in pairs))


def _beside(stiffness: Array, damping: Array, lead: float) -> Array:
    """[H, C/lead], what multiplies position and lead times velocity; for no lead, H."""
    return np.concatenate([stiffness, damping / lead], axis=2) if lead else stiffness


def _norms(matrices: Array) -> Array:
    """Spectral norms, by the eigenvalues of A Aᵀ, which is quicker than singular values."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(matrices @ matrices.transpose(0, 2, 1))[:, -1], 0.0))


def sampled(plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int) -> list[Instant]:
    """Each robot at rest in each of some postures; then moving there, each joint at its greatest speed and acceleration
    one way or the other, where the workspace has such.
    """
    postures = workspace.sample(samples, seed)
    result = [Instant.at_rest(plant, posture) for posture in postures for plant in plants]
    if workspace.speed is None or workspace.acceleration is None or not np.any(workspace.speed):
        return result
    ways = np.random.default_rng(seed).choice([-1.0, 1.0], size=(len(postures), 2, workspace.n_joints))
    return result + [
        Instant(plant, posture, way[0] * workspace.speed, way[1] * workspace.acceleration)
        for posture, way in zip(postures, ways, strict=True)
        for plant in plants
    ]


def searched(
    instants: list[Instant],
    found: Mismatches,
    workspace: Workspace,
    units: Array,
    nominal: Array,
    centre: float,
    weight: float,
    lead: float,
) -> tuple[list[Instant], Mismatches]:
    """Instants and their `mismatches`, and those that a local search for the greatest joint norm adds to them.

    It starts from the worst of them, the stiffest, and the first two, taken for the ends of the ratios.
    """
    stiff = int(np.argmax(found.sizes(lead)))
    worst = np.argsort(found.joint_norms(centre, weight, lead))[::-1][:SEARCHES]
    starts = [instants[i] for i in dict.fromkeys([0, 1, stiff, *worst.tolist()])]

    def value(some: Sequence[Instant]) -> Array:
        return mismatches(nominal, some).joint_norms(centre, weight, lead)

    added = [_turned(_climb(start, workspace, units, value, centre), workspace, value) for start in starts]
    return [*instants, *added], found | mismatches(nominal, added)


def with_stiffest(
    instants: list[Instant], found: Mismatches, workspace: Workspace, units: Array, nominal: Array, lead: float
) -> tuple[list[Instant], Mismatches]:
    """Instants and their `mismatches`, and those that a local search for the greatest stiffness adds to them."""
    sizes = found.sizes(lead)

    def value(some: Sequence[Instant]) -> Array:
        return mismatches(nominal, some).sizes(lead)

    starts = [instants[i] for i in np.argsort(sizes)[::-1][:SEARCHES]]
    scale = max(float(sizes.max()), NEGLIGIBLE)

    def turned(one: Instant) -> Instant:
        return _turned(one, workspace, value)

    added = [turned(_climb(turned(start), workspace, units, value, scale)) for start in starts]
    return [*instants, *added], found | mismatches(nominal, added)


Value = Callable[[Sequence[Instant]], Array]
"""Maps k instants to a number each, (k,)."""


def fastest(plants: Sequence[Plant], nominal: Array, workspace: Workspace, samples: int, seed: int) -> Instant:
    """Where `rates` is greatest: of samples and what a local search from the best of them finds."""
    speed = workspace.speed
    if speed is None:
        raise TarcError("workspace: it has no speed, so that nothing bounds how fast the inertia changes; give one")

    def value(some: Sequence[Instant]) -> Array:
        return rates(nominal, np.array([inertia_slopes(one.plant, one.position) for one in some]), speed)

    resting = [Instant.at_rest(plant, posture) for posture in workspace.sample(samples, seed) for plant in plants]
    found = value(resting)
    best = [resting[i] for i in np.argsort(found)[::-1][:SEARCHES]]
    units = workspace.units(samples, seed)
    best += [_climb(start, workspace, units, value, max(float(found.max()), 1e-12)) for start in best]
    return best[int(np.argmax(value(best)))]


def greatest_rate(plants: Sequence[Plant], nominal: Array, workspace: Workspace, samples: int, seed: int) -> float:
    """The greatest of `rates` over a workspace [1/s]; infinite without a speed."""
    if workspace.speed is None:
        return np.inf
    slopes = inertia_slopes(*fastest(plants, nominal, workspace, samples, seed)[:2])
    return float(rates(nominal, slopes[None], workspace.speed)[0])


def inertia_slopes(plant: Plant, posture: Array) -> Array:
    """∂M/∂q_i, shape (n, n, n), the joint i first."""
    nudges = NUDGE * np.eye(plant.n_joints)
    ahead, behind = inertias(plant, np.concatenate([posture + nudges, posture - nudges])).reshape(
        2, *[plant.n_joints] * 3
    )
    return (ahead - behind) / (2 * NUDGE)


def rates(nominal: Array, slopes: Array, speed: Array) -> Array:
    """The greatest ‖dE⁻¹/dt‖ [1/s] where no joint is faster than its speed (n,), shape (k,) for slopes (k, n, n, n).

    dE⁻¹/dt = Σ q̇_i M̂^−½ (∂M/∂q_i) M̂^−½ is linear in q̇, so that its norm is greatest where each joint moves at its
    greatest speed one way or the other; beyond some joints the sum of the norms stands for the greatest of them.
    """
    joints = np.flatnonzero(speed)
    if not joints.size:
        return np.zeros(len(slopes))
    inverse = _roots(nominal)[1]
    D = inverse @ slopes[:, joints] @ inverse * speed[joints, None, None]
    if len(joints) > CORNERS:
        return np.linalg.norm(D, 2, axis=(2, 3)).sum(axis=1)
    signs = np.array([(1, *rest) for rest in product((1, -1), repeat=len(joints) - 1)])
    return np.abs(np.linalg.eigvalsh(np.einsum("sj,kjab->ksab", signs, D))).max(axis=(1, 2))


def _turned(start: Instant, workspace: Workspace, value: Value) -> Instant:
    """An instant of greater value in the same posture: the speed or the acceleration of a joint at a time at its
    greatest, one way or the other, or zero.
    """
    if not start.moves or workspace.speed is None or workspace.acceleration is None:
        return start
    limits, joints = np.concatenate([workspace.speed, workspace.acceleration]), start.plant.n_joints
    best, height = start, float(value([start])[0])
    for _ in range(TURNS):
        motion = np.concatenate([best.velocity, best.acceleration])
        ways = np.array(
            [
                np.where(np.arange(2 * joints) == i, way * limits, motion)
                for i in range(2 * joints)
                for way in (-1, 0, 1)
                if way * limits[i] != motion[i]
            ]
        )
        others = [best._replace(velocity=way[:joints], acceleration=way[joints:]) for way in ways]
        found = value(others)
        if not found.max() > (1 + 1e-9) * height:
            break
        best, height = others[int(np.argmax(found))], float(found.max())
    return best


def _climb(start: Instant, workspace: Workspace, units: Array, value: Value, scale: float) -> Instant:
    """An instant of greater value near one, of the same velocity and acceleration; in a tube, near the closest of the
    samples, units of its variables.
    """
    from scipy.optimize import minimize

    posture = start.position
    width = workspace.high - workspace.low
    free = np.flatnonzero(width > 0)
    if not free.size:
        return start
    if workspace.reference is None:
        unit = (posture - workspace.low) / np.where(width > 0, width, 1.0)
    else:
        apart = workspace.positions(workspace.low + units * width) - posture
        unit = units[np.argmin(np.linalg.norm(apart, axis=1))]
    nudges = STEP * np.concatenate([np.zeros((1, len(free))), np.eye(len(free))])

    def place(points: Array) -> list[Instant]:
        variables = np.tile(unit, (len(points), 1))
        variables[:, free] = points
        return [start._replace(position=one) for one in workspace.positions(workspace.low + variables * width)]

    def downhill(point: Array) -> tuple[float, Array]:
        inward = np.where(point > 0.5, -1.0, 1.0)
        near = -value(place(point + nudges * inward)) / scale
        return float(near[0]), (near[1:] - near[0]) / (STEP * inward)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Values in x were outside bounds")  # by rounding; they are clipped
        end = minimize(
            downhill,
            unit[free],
            jac=True,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(free),
            options={"ftol": 1e-5, "maxiter": 30},
        )
    return place(np.clip(end.x, 0, 1)[None])[0]


def mismatches(nominal: Array, instants: Sequence[Instant]) -> Mismatches:
    """`Mismatches` of robots."""
    tangents = [tangent(one) for one in instants]
    for one, (_, D, G) in zip(instants, tangents, strict=True):
        if not (np.isfinite(G).all() and np.isfinite(D).all()):
            raise TarcError(
                f"stiffness: that of gravity and springs is not finite at q = {one.position.round(4).tolist()}; check "
                "the potential energy, or give a workspace without this posture"
            )
    return in_nominal(nominal, *(np.array(part) for part in zip(*tangents, strict=True)))


def tangent(one: Instant) -> tuple[Array, Array, Array]:
    """M, D and G of the robot linearised about an instant, D without what is there at rest too."""
    M, D, G = one.plant.linearised(one.position, one.velocity, one.acceleration)
    if not one.moves:
        return M, 0 * D, G
    return M, D - one.plant.damping(one.position), G


def _roots(nominal: Array) -> tuple[Array, Array]:
    """M̂^½ and its inverse."""
    values, vectors = np.linalg.eigh(nominal)
    return vectors * values**0.5 @ vectors.T, vectors * values**-0.5 @ vectors.T


def in_nominal(nominal: Array, M: Array, D: Array, G: Array) -> Mismatches:
    """`Mismatches` from inertias, dampings and stiffnesses (k, n, n)."""
    root, inverse = _roots(nominal)
    scaled = np.linalg.solve(M, np.concatenate([root + 0 * M, G @ inverse, D @ inverse], axis=2))
    return Mismatches(*np.split(root @ scaled, 3, axis=2))
