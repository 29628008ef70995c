"""Linearised uncertainty of a robot under a law with M̂(q), and its worst operating points."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from tarc.analysis.inertia_rate import inertia_rates
from tarc.analysis.operating_points import OperatingPoint, UncertaintySamples, biases, linearise_points
from tarc.analysis.workspace import Workspace
from tarc.core.types import Array
from tarc.laws.nominal_inertia import NominalInertia
from tarc.numerics.local_search import local_maximum

N_STARTS = 3
"""Number of points from which a local search starts."""

UNIT_STEP = 1e-5
"""Step of differences on the unit cube."""

PointValues = Callable[[Sequence[OperatingPoint]], Array]
"""A function from k operating points to one number each, (k,)."""


@dataclass(frozen=True, eq=False)
class KnownInertia:
    """M̂(q) and ĥ of a law along the motions of a robot.

    Along a motion the law holds a = M̂(q)⁻¹ (M q̈ + N − ĥ). A small error about it obeys, in q,

        q̈ = E v − H q − C q̇,     E = M⁻¹M̂,     H = M⁻¹ (∂(M q̈ + N)/∂q − ∂(M̂ a + ĥ)/∂q),     C = M⁻¹ ∂N/∂q̇.

    Dry friction is left out of N.

    Parameters
    ----------
    inertia
        M̂(q) with its terms ĥ.
    """

    inertia: NominalInertia

    @cached_property
    def _slopes(self) -> ca.Function:
        """The function of (q, q̇, a) for ∂(M̂(q) a + ĥ(q, q̇))/∂q."""
        n = self.inertia.model.n_joints
        q, v, a = (ca.SX.sym(name, n) for name in ("q", "v", "a"))
        torque = self.inertia.at(q) @ a + self.inertia.forces(q, v)
        return ca.Function("slopes", [q, v, a], [ca.densify(ca.jacobian(torque, q))])

    def inertias(self, points: Sequence[OperatingPoint]) -> Array:
        """Return M̂ at k points, shape (k, n, n)."""
        positions = np.array([point.position for point in points]).T
        return self.inertia.fraction * self.inertia.robot.inertia_matrices(positions)

    def linearised(self, points: Sequence[OperatingPoint]) -> tuple[Array, Array, Array]:
        """Return M, D and G − ∂(M̂ a + ĥ)/∂q at k points, each (k, n, n); D without viscous friction."""
        M, D, G, slopes = self.linearised_apart(points)
        return M, D, G - slopes

    def linearised_apart(self, points: Sequence[OperatingPoint]) -> tuple[Array, Array, Array, Array]:
        """Return M, D, G and the law's own stiffness ∂(M̂ a + ĥ)/∂q at k points, each (k, n, n)."""
        M, D, G = linearise_points(points)
        k, n, _ = M.shape
        q, v, acceleration = (np.array([point[i] for point in points]) for i in (1, 2, 3))
        forces = self.inertia.forces
        known = forces(q[0], v[0])[None] if k == 1 else forces(q.T, v.T).T
        torque = (M @ acceleration[:, :, None])[:, :, 0] + biases(points) - known
        a = np.linalg.solve(self.inertias(points), torque[:, :, None])[:, :, 0]
        slopes = np.array(self._slopes(q.T, v.T, a.T)).reshape(n, k, n).transpose(1, 0, 2)
        return M, D, G, slopes

    def uncertainty(self, points: Sequence[OperatingPoint]) -> UncertaintySamples:
        """Return E, H, C and the law's own part of H at k points in coordinates M̂(q)^½ q."""
        M, D, G, own = self.linearised_apart(points)
        return to_posture_coordinates(self.inertias(points), M, D, G - own, own)

    def rates(self, points: Sequence[OperatingPoint], speed: Array) -> Array:
        """Return the largest ‖M̂^−½ (dM̂/dt) M̂^−½‖ [1/s] at k points within the speed limits, shape (k,)."""
        fraction, robot = self.inertia.fraction, self.inertia.robot
        slopes = np.array([fraction * robot.inertia_slopes(point.position) for point in points])
        pairs = zip(self.inertias(points), slopes, strict=True)
        return np.array([inertia_rates(nominal, slope[None], speed)[0] for nominal, slope in pairs])


def lagged_force_norms(
    parts: tuple[Array, Array, Array, Array, Array], lead_time: float, power: float, lag_weight: float
) -> Array:
    """Return ‖E^−p [H, C/θ, K/φ]‖ of k points [1/s²], shape (k,), where K is the law's own stiffness.

    Parameters
    ----------
    parts
        M̂, M, D, G less the law's own stiffness, and that stiffness, each (k, n, n).
    lead_time, power, lag_weight
        θ [s], p and φ; without a lead time the damping is left out.
    """
    nominal, M, D, G, own = parts
    matrices = [G, D / lead_time] if lead_time else [G]
    matrices += [own / lag_weight] if lag_weight else []
    samples = [to_posture_coordinates(nominal, M, 0 * M, matrix) for matrix in matrices]
    together = UncertaintySamples(
        samples[0].inertia, np.concatenate([sample.stiffness for sample in samples], axis=2), samples[0].damping
    )
    return together.force_norms(0.0, power)


def to_posture_coordinates(
    nominal: Array, M: Array, D: Array, G: Array, own: Array | None = None
) -> UncertaintySamples:
    """Return the uncertainty in coordinates M̂^½ q, with an M̂ for each point; all have shape (k, n, n).

    The law's own stiffness, by which G is less than that of the robot, acts at the position of the sample.
    """
    values, vectors = np.linalg.eigh(nominal)
    transposed = vectors.transpose(0, 2, 1)
    root = vectors * values[:, None] ** 0.5 @ transposed
    inverse_root = vectors * values[:, None] ** -0.5 @ transposed
    parts = [root, G @ inverse_root, D @ inverse_root] + ([] if own is None else [own @ inverse_root])
    scaled = np.linalg.solve(M, np.concatenate(parts, axis=2))
    return UncertaintySamples(*np.split(root @ scaled, len(parts), axis=2))


def worst_points(
    points: Sequence[OperatingPoint],
    values: PointValues,
    workspace: Workspace,
    unit_samples: Array,
    sampled: Array | None = None,
) -> list[OperatingPoint]:
    """Return the points of the largest values, and those that local searches from them find.

    Parameters
    ----------
    points
        Sampled operating points.
    values
        The function to maximise.
    workspace
        The postures and their speeds.
    unit_samples
        The sampled variables of the workspace on the unit cube, shape (k, v).
    sampled
        The values at the points, where they are known; None to compute them.
    """
    sampled = values(points) if sampled is None else sampled
    starts = [points[i] for i in np.argsort(sampled)[::-1][:N_STARTS]]
    scale = max(float(np.abs(sampled).max()), 1e-12)
    found = []
    for start in starts:
        moved = _change_motion(start, values, workspace)
        climbed = _climb(moved, values, workspace, unit_samples, scale)
        found.append(_change_motion(climbed, values, workspace))
    return [*starts, *found]


def _climb(
    start: OperatingPoint, values: PointValues, workspace: Workspace, unit_samples: Array, scale: float
) -> OperatingPoint:
    """Return a point of larger value with the same velocity and acceleration, by a local search over postures."""
    positions = workspace.at_unit_points(unit_samples)
    unit = unit_samples[int(np.argmin(np.linalg.norm(positions - start.position, axis=1)))]
    free = np.flatnonzero(workspace.high > workspace.low)
    if not free.size:
        return start

    def point_at(free_units: Array) -> OperatingPoint:
        full = unit.copy()
        full[free] = np.clip(free_units, 0, 1)
        return start._replace(position=workspace.at_unit_points(full[None])[0])

    def value_and_gradient(free_units: Array) -> tuple[float, Array]:
        steps = UNIT_STEP * np.eye(len(free))
        candidates = [free_units, *(free_units + steps), *(free_units - steps)]
        found = values([point_at(units) for units in candidates])
        return float(found[0]), (found[1 : len(free) + 1] - found[len(free) + 1 :]) / (2 * UNIT_STEP)

    _, best = local_maximum(value_and_gradient, unit[free], scale=scale, tolerance=1e-6, max_iterations=40)
    climbed = point_at(best)
    return climbed if values([climbed])[0] > values([start])[0] else start


def _change_motion(start: OperatingPoint, values: PointValues, workspace: Workspace) -> OperatingPoint:
    """Return a point of larger value in the same posture, each speed and acceleration at a limit or zero."""
    if not start.is_moving or workspace.speed is None or workspace.acceleration is None:
        return start
    limits, n = np.concatenate([workspace.speed, workspace.acceleration]), start.plant.n_joints
    best, best_value = start, float(values([start])[0])
    for _ in range(2 * n):
        motion = np.concatenate([best.velocity, best.acceleration])
        changed = [np.where(np.arange(2 * n) == i, s * limits, motion) for i in range(2 * n) for s in (-1.0, 0.0, 1.0)]
        candidates = [best._replace(velocity=row[:n], acceleration=row[n:]) for row in changed]
        found = values(candidates)
        if not found.max() > (1 + 1e-9) * best_value:
            break
        best, best_value = candidates[int(np.argmax(found))], float(found.max())
    return best
