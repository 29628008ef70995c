"""What a robot and a reference do in a tube of states about the reference."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from tarc.analysis.inertia_rate import inertia_rates, max_rate_point
from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.known_inertia import worst_points
from tarc.analysis.operating_points import OperatingPoint, to_nominal_coordinates
from tarc.analysis.workspace import Workspace
from tarc.analysis.worst_points import sample_points
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.laws.tde import TDE
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.references import Reference

STEPS_PER_PERIOD = 4
"""Samples of the reference in a period, between which its torque is taken as even."""
LEAD_FACTORS = 0.5, 1.0, 2.0
"""Lead times θ over that at which damping counts as much as stiffness."""


ModelStiffness = Callable[[Array], Array]
"""A function of k positions (n, k) to the stiffness of a law's model at rest, (k, n, n)."""
MotionTorque = Callable[[Array, Array, Array], Array]
"""A function of q, q̇ and q̈ of k motions, each (n, k), to torques (n, k)."""


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
        The largest ‖M̂^−½ (∂N/∂q) M̂^−½‖ at rest [1/s²], of N less what a law's model gives at the first position.
    """

    min_ratio: float
    max_ratio: float
    rate: float
    relative_rate: float
    lead_times: Array
    stiffness: Array
    rest_stiffness: float


def tube_bounds(
    plants: Sequence[Plant],
    nominal: Array,
    workspace: Workspace,
    *,
    samples: int,
    seed: int,
    model_stiffness: ModelStiffness | None = None,
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
    model_stiffness
        Stiffness at rest that a law's model takes from the robot's; None for none.
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

    def rest_norms(some: Sequence[OperatingPoint]) -> Array:
        return torque_norms(nominal, some, 0.0, model_stiffness)

    stillest = worst_points(resting, rest_norms, workspace, units)
    rest_stiffness = float(rest_norms(stillest).max())
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


def torque_norms(
    nominal: Array,
    points: Sequence[OperatingPoint],
    lead_time: float,
    model_stiffness: ModelStiffness | None = None,
) -> Array:
    """Return ‖M̂^−½ [G, D/θ] M̂^−½‖ at k points [1/s²], shape (k,), with viscous friction; without D for θ = 0.

    G is less the stiffness of a model, where that is given.
    """
    n = len(nominal)
    M, D, G = np.empty((3, len(points), n, n))
    groups: dict[int, list[int]] = {}
    for i, point in enumerate(points):
        groups.setdefault(id(point.plant), []).append(i)
    for places in groups.values():
        q, v, a = np.array([points[i][1:] for i in places]).transpose(1, 2, 0)
        M[places], D[places], G[places] = points[places[0]].plant.linearised_at(q, v, a)
    if model_stiffness is not None:
        G = G - model_stiffness(np.array([point.position for point in points]).T)
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
    torque_rate, command_rate
        Largest ‖M̂^−½ dτ*/dt‖ and ‖M̂^−½ d(τ* − f)/dt‖ [rad kg^½ m/s³], f the feed-forward; equal without one.
    start_torque
        Largest ‖M̂^−½ (N(qᵈ, 0) − f(qᵈ, 0, 0) − τ* + f)‖ at the start [rad kg^½ m/s²], without friction.
    start_velocity
        q̇ᵈ at the start, (n,).
    """

    low: Array
    high: Array
    speed: Array
    acceleration: Array
    torque_rate: float
    command_rate: float
    start_torque: float
    start_velocity: Array


def reference_bounds(
    plants: Sequence[Plant],
    inverse_root: Array,
    reference: Reference,
    duration: float,
    period: float,
    forward: MotionTorque | None = None,
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
    forward
        Feed-forward f of the law; None for none.
    """
    step = period / STEPS_PER_PERIOD
    q, v, a = reference.sample(np.arange(0, duration + step, step))
    known, known_at_rest = 0 * q, 0 * q[:, 0]
    if forward is not None:
        known, known_at_rest = forward(q, v, a), forward(q[:, :1], 0 * v[:, :1], 0 * a[:, :1])[:, 0]
    rates, command_rates, starts = [], [], []
    for plant in plants:
        torque = torques_along(plant, q, v, a)
        for found, part in ((rates, torque), (command_rates, torque - known)):
            found.append(float(np.linalg.norm(np.diff(inverse_root @ part, axis=1), axis=0).max()) / step)
        held = np.asarray(plant.holding_torque(q[:, 0])) - known_at_rest
        starts.append(float(np.linalg.norm(inverse_root @ (held - torque[:, 0] + known[:, 0]))))
    return ReferenceBounds(
        low=q.min(axis=1),
        high=q.max(axis=1),
        speed=np.abs(v).max(axis=1),
        acceleration=np.abs(a).max(axis=1),
        torque_rate=max(rates),
        command_rate=max(command_rates),
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


def feedforward_along(law: TDE) -> tuple[MotionTorque, ModelStiffness]:
    """Return the feed-forward of a law with a constant M̂ along motions, and its stiffness ∂f(q, 0, 0)/∂q at rest."""
    n = law.n_joints
    q, v, a = (ca.SX.sym(name, n) for name in ("q", "v", "a"))
    torque = ca.densify(law.model_terms(q, q, v, a)[1])
    along = ca.Function("feedforward", [q, v, a], [torque])
    slope = ca.Function("slope", [q], [ca.densify(ca.jacobian(law.model_terms(q, q, 0 * q, 0 * q)[1], q))])

    def stiffness(positions: Array) -> Array:
        return np.array(slope(positions)).reshape(n, positions.shape[1], n).transpose(1, 0, 2)

    return lambda *motion: np.array(along(*motion)), stiffness
