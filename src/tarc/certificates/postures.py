"""What a robot is in the postures of a workspace: how far its inertia is off, its stiffness, how fast they change."""

import warnings
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from tarc.certificates.spread import inertias
from tarc.certificates.workspace import Workspace
from tarc.errors import TarcError
from tarc.plants.base import Plant

Array = np.ndarray

SEARCHES = 4
"""How many postures are starts of a local search."""
STEP = 1e-5
"""Step of its differences, in widths of the box; what is searched for is a difference itself."""
NUDGE = 1e-5
"""Step of the differences of the inertia over a joint [rad or m]."""
CORNERS = 9
"""Joints up to which all combinations of their greatest speeds are tried."""

Posture = tuple[Plant, Array]


def sampled(plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int) -> list[Posture]:
    """Each robot in each of some postures of the workspace."""
    return [(plant, posture) for posture in workspace.sample(samples, seed) for plant in plants]


def searched(
    postures: list[Posture], E: Array, H: Array, workspace: Workspace, units: Array, nominal: Array,
    centre: float, weight: float,
) -> tuple[list[Posture], Array, Array]:  # fmt: skip
    """Postures and their `mismatches`, and those that a local search for the greatest joint norm adds to them.

    It starts from the worst of them, the stiffest, and the first two, taken for the ends of the ratios.
    """
    stiff = int(np.argmax(np.linalg.norm(H, 2, axis=(1, 2))))
    worst = np.argsort(joint_norms(E, H, centre, weight))[::-1][:SEARCHES]
    starts = [postures[i] for i in dict.fromkeys([0, 1, stiff, *worst.tolist()])]

    def value(some: Sequence[Posture]) -> Array:
        return joint_norms(*mismatches(nominal, some), centre, weight)

    added = [_climb(start, workspace, units, value, centre) for start in starts]
    one, two = mismatches(nominal, added)
    return [*postures, *added], np.concatenate([E, one]), np.concatenate([H, two])


Value = Callable[[Sequence[Posture]], Array]
"""Maps k postures to a number each, (k,)."""


def fastest(plants: Sequence[Plant], nominal: Array, workspace: Workspace, samples: int, seed: int) -> Posture:
    """Where `rates` is greatest: of samples and what a local search from the best of them finds."""
    speed = workspace.speed
    if speed is None:
        raise TarcError("workspace: it has no speed, so that nothing bounds how fast the inertia changes; give one")

    def value(some: Sequence[Posture]) -> Array:
        return rates(nominal, np.array([inertia_slopes(*one) for one in some]), speed)

    return greatest(value, sampled(plants, workspace, samples, seed), workspace, workspace.units(samples, seed))


def greatest(value: Value, postures: Sequence[Posture], workspace: Workspace, units: Array) -> Posture:
    """Of postures, and what a local search from the best of them finds, the one of the greatest value."""
    found = value(postures)
    best = [postures[i] for i in np.argsort(found)[::-1][:SEARCHES]]
    best += [_climb(start, workspace, units, value, max(float(found.max()), 1e-12)) for start in best]
    return best[int(np.argmax(value(best)))]


def greatest_rate(plants: Sequence[Plant], nominal: Array, workspace: Workspace, samples: int, seed: int) -> float:
    """The greatest of `rates` over a workspace [1/s]; infinite without a speed."""
    if workspace.speed is None:
        return np.inf
    slopes = inertia_slopes(*fastest(plants, nominal, workspace, samples, seed))
    return float(rates(nominal, slopes[None], workspace.speed)[0])


def inertia_slopes(plant: Plant, posture: Array) -> Array:
    """∂M/∂q_i, shape (n, n, n), the joint i first."""
    nudges = NUDGE * np.eye(plant.joints)
    ahead, behind = inertias(plant, np.concatenate([posture + nudges, posture - nudges])).reshape(
        2, *[plant.joints] * 3
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


def _climb(start: Posture, workspace: Workspace, units: Array, value: Value, scale: float) -> Posture:
    """A posture of greater value near one; in a tube, near the closest of the samples, units of its variables."""
    from scipy.optimize import minimize

    plant, posture = start
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

    def place(points: Array) -> Array:
        variables = np.tile(unit, (len(points), 1))
        variables[:, free] = points
        return workspace.positions(workspace.low + variables * width)

    def downhill(point: Array) -> tuple[float, Array]:
        inward = np.where(point > 0.5, -1.0, 1.0)
        near = -value([(plant, one) for one in place(point + nudges * inward)]) / scale
        return float(near[0]), (near[1:] - near[0]) / (STEP * inward)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Values in x were outside bounds")  # by rounding; they are clipped
        end = minimize(
            downhill, unit[free], jac=True, method="SLSQP", bounds=[(0.0, 1.0)] * len(free),
            options={"ftol": 1e-5, "maxiter": 30},
        )  # fmt: skip
    return plant, place(np.clip(end.x, 0, 1)[None])[0]


def mismatches(nominal: Array, postures: Sequence[Posture]) -> tuple[Array, Array]:
    """E = M̂^½ M⁻¹ M̂^½ and H = M̂^½ M⁻¹ (∂g/∂q) M̂^−½ [1/s²] of robots in postures, each (k, n, n).

    Held at rest the robot obeys ẍ = E v − H x in coordinates x = M̂^½ q.
    """
    rest = [plant.at_rest(posture) for plant, posture in postures]
    for (_, posture), (_, _, stiffness) in zip(postures, rest, strict=True):
        if not np.isfinite(stiffness).all():
            raise TarcError(
                f"stiffness: that of gravity and springs is not finite at q = {posture.round(4).tolist()}; check the "
                "potential energy, or give a workspace without this posture"
            )
    return in_nominal(nominal, np.array([M for M, _, _ in rest]), np.array([G for _, _, G in rest]))


def _roots(nominal: Array) -> tuple[Array, Array]:
    """M̂^½ and its inverse."""
    values, vectors = np.linalg.eigh(nominal)
    return vectors * values**0.5 @ vectors.T, vectors * values**-0.5 @ vectors.T


def in_nominal(nominal: Array, M: Array, G: Array) -> tuple[Array, Array]:
    """E and H of `mismatches` from inertias and stiffnesses (k, n, n)."""
    root, inverse = _roots(nominal)
    return root @ np.linalg.solve(M, root + 0 * M), root @ np.linalg.solve(M, G @ inverse)


def joint_norms(E: Array, H: Array, centre: float, weight: float) -> Array:
    """‖[E − ρ0 I, H/η]‖ of each pair, shape (k,): what a ball about the centre must hold, with the weight η [1/s²]."""
    apart = E - centre * np.eye(E.shape[1])
    return np.linalg.norm(np.concatenate([apart, H / weight], axis=2), 2, axis=(1, 2))
