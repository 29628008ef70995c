"""What a robot and a reference do in a tube of states about the reference."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.known_inertia import worst_points
from tarc.analysis.operating_points import OperatingPoint, to_nominal_coordinates
from tarc.analysis.workspace import Workspace
from tarc.analysis.worst_points import inertia_rates, max_rate_point, sample_points
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.references import Reference

STEPS_PER_PERIOD = 4
"""Samples of the reference in a period, between which its torque is taken as even."""
LEAD_FACTORS = 0.5, 1.0, 2.0
"""Lead times θ over that at which damping counts as much as stiffness."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TubeBounds:
    """Largest values that were found of a robot in a tube, in coordinates M̂^½ q.

    Attributes
    ----------
    min_ratio, max_ratio
        Smallest and largest eigenvalue of M(q)⁻¹M̂.
    rate, relative_rate
        Largest ‖M̂^−½ (dM/dt) M̂^−½‖ and ‖M^−½ (dM/dt) M^−½‖ [1/s].
    lead_times, stiffness
        θ [s], and for each the largest ‖M̂^−½ [∂(M q̈ᵈ + N)/∂q, (∂N/∂q̇)/θ] M̂^−½‖ [1/s²], each (k,).
    rest_stiffness
        The largest ‖M̂^−½ (∂N/∂q) M̂^−½‖ at rest [1/s²].
    """

    min_ratio: float
    max_ratio: float
    rate: float
    relative_rate: float
    lead_times: Array
    stiffness: Array
    rest_stiffness: float


def tube_bounds(
    plants: Sequence[Plant], nominal: Array, workspace: Workspace, *, samples: int, seed: int
) -> TubeBounds:
    """Return the largest values in a tube, from samples and local search.

    Viscous friction counts. Means of ∂(M q̈ + N)/∂q and ∂N/∂q̇ between two states of the tube have no larger norms.

    Parameters
    ----------
    plants
        The robot, or several.
    nominal
        M̂ [kg m² or kg], shape (n, n).
    workspace
        A box of postures with the speeds of the tube and the accelerations of the reference.
    samples, seed
        Number of sampled postures, and the seed.
    """
    spread = inertia_spread(plants, nominal, workspace, samples=samples, seed=seed)
    fastest = [max_rate_point(plants, of, workspace, samples, seed) for of in (nominal, None)]
    points, units = sample_points(plants, workspace, samples, seed), workspace.unit_samples(samples, seed)
    resting = [point for point in points if not point.is_moving]
    speed = np.asarray(workspace.speed)
    rate, relative = (
        max(_rates(point.plant.inertia(point.position) if of is None else of, point, speed) for point in fastest)
        for of in (nominal, None)
    )

    def norms(some: Sequence[OperatingPoint], lead_time: float) -> Array:
        return torque_norms(nominal, some, lead_time)

    stillest = worst_points(resting, lambda some: norms(some, 0.0), workspace, units)
    rest_stiffness = float(norms(stillest, 0.0).max())
    stiffness, damping = float(norms(points, 0.0).max()), float((norms(points, 1e-9) * 1e-9).max())
    middle = min(damping / max(stiffness, 1e-9), 1.0)
    lead_times = np.array([factor * max(middle, 1e-3) for factor in LEAD_FACTORS])
    largest = [
        float(norms(worst_points(points, lambda some, t=t: norms(some, t), workspace, units), t).max())
        for t in lead_times.tolist()
    ]
    return TubeBounds(
        min_ratio=spread.min_ratio,
        max_ratio=spread.max_ratio,
        rate=rate,
        relative_rate=relative,
        lead_times=lead_times,
        stiffness=np.array(largest),
        rest_stiffness=rest_stiffness,
    )


def _rates(nominal: Array, point: OperatingPoint, speed: Array) -> float:
    slopes = point.plant.inertia_slopes(point.position)
    return float(inertia_rates(nominal, slopes[None], speed)[0])


def torque_norms(nominal: Array, points: Sequence[OperatingPoint], lead_time: float) -> Array:
    """Return ‖M̂^−½ [G, D/θ] M̂^−½‖ at k points [1/s²], shape (k,), with viscous friction; without D for θ = 0."""
    n = len(nominal)
    M, D, G = np.empty((3, len(points), n, n))
    groups: dict[int, list[int]] = {}
    for i, point in enumerate(points):
        groups.setdefault(id(point.plant), []).append(i)
    for places in groups.values():
        q, v, a = np.array([points[i][1:] for i in places]).transpose(1, 2, 0)
        M[places], D[places], G[places] = points[places[0]].plant.linearised_at(q, v, a)
    return to_nominal_coordinates(nominal, np.broadcast_to(nominal, M.shape), D, G).force_norms(lead_time)


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceBounds:
    """What a reference asks of robots.

    Attributes
    ----------
    low, high
        Range of the positions [rad or m], each (n,).
    speed, acceleration
        Largest of each joint, (n,).
    torque_rate
        Largest ‖M̂^−½ dτ*/dt‖ [rad kg^½ m/s³].
    start_torque
        Largest ‖M̂^−½ (N(qᵈ, 0) − τ*)‖ at the start [rad kg^½ m/s²], without friction.
    start_velocity
        q̇ᵈ at the start, (n,).
    """

    low: Array
    high: Array
    speed: Array
    acceleration: Array
    torque_rate: float
    start_torque: float
    start_velocity: Array


def reference_bounds(
    plants: Sequence[Plant], inverse_root: Array, reference: Reference, duration: float, period: float
) -> ReferenceBounds:
    """Return what a reference asks of robots, from samples at quarters of a period.

    Parameters
    ----------
    plants
        The robot in symbols, or several.
    inverse_root
        M̂^−½, shape (n, n).
    reference, duration, period
        The motion, its duration [s] and T [s].
    """
    step = period / STEPS_PER_PERIOD
    q, v, a = reference.sample(np.arange(0, duration + step, step))
    rates, starts = [], []
    for plant in plants:
        torque = inverse_root @ torques_along(plant, q, v, a)
        rates.append(float(np.linalg.norm(np.diff(torque, axis=1), axis=0).max()) / step)
        held = inverse_root @ np.asarray(plant.holding_torque(q[:, 0]))
        starts.append(float(np.linalg.norm(held - torque[:, 0])))
    return ReferenceBounds(
        low=q.min(axis=1),
        high=q.max(axis=1),
        speed=np.abs(v).max(axis=1),
        acceleration=np.abs(a).max(axis=1),
        torque_rate=max(rates),
        start_torque=max(starts),
        start_velocity=v[:, 0],
    )


def torques_along(plant: Plant, q: Array, v: Array, a: Array) -> Array:
    """Return M q̈ + N without dry friction at k motions, (n, k)."""
    if not isinstance(plant, SymbolicPlant):
        raise InvalidParameter(f"plant: got {plant.label}; the torque along a reference needs a robot in symbols")
    n = plant.n_joints
    position, velocity, acceleration = (ca.SX.sym(name, n) for name in ("q", "v", "a"))
    smooth = {name: 0 * np.asarray(plant.parameters[name], dtype=float) for name in plant.dry_friction}
    bias = plant.evaluate("bias", position, velocity, parameters=smooth)
    torque = plant.evaluate("inertia", position) @ acceleration + bias
    return np.array(ca.Function("torque", [position, velocity, acceleration], [torque])(q, v, a))
