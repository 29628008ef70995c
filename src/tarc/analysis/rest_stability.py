"""Stability of a robot held at rest in a posture, and what to change where it is unstable."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from tarc.analysis.command_units import in_torque_units, is_symmetric
from tarc.analysis.inertia_ratio import inverse_ratios
from tarc.analysis.linearise import (
    Channel,
    coupled_channel,
    decoupled_channels,
    joints_share_loop,
    posture_channels,
)
from tarc.analysis.stability import UnstableMode, stable_intervals, unstable_mode, widest_interval
from tarc.core.errors import InvalidParameter, NotLinearisable, UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tde import TDE
from tarc.numerics.matrix_tests import powers_vanish, schur_stability
from tarc.plants.base import Plant

MAX_POSTURES = 8
"""Postures in which a law is linearised that needs it in each of them."""


def rest_state_matrix(
    loop: tuple[Array, Array, Array], nominal: Array, robot: tuple[Array, Array, Array], period: float
) -> Array:
    """Return the state matrix of a law around M δq̈ + D δq̇ + G δq = δτ, the torque held over each period.

    Parameters
    ----------
    loop
        A, B, C of the loop of all joints, or of one that they share, opened at its inertia ratio.
    nominal
        M̂ [kg m² or kg], shape (n, n).
    robot
        M, D and G, each (n, n).
    period
        T [s].
    """
    from scipy.linalg import expm

    A_loop, _, C_loop = loop
    M, D, G = robot
    n, n_coupled = len(M), len(C_loop)
    q, x = slice(n_coupled), slice(2 * n_coupled, None)
    parts = A_loop[x, x], A_loop[x, q], C_loop[:, x], C_loop[:, q]
    F, H, C, E = (np.kron(part, np.eye(n)) for part in parts) if n_coupled == 1 else parts
    motion = np.zeros((3 * n, 3 * n))
    motion[:n, n : 2 * n] = np.eye(n)
    motion[n : 2 * n] = np.linalg.solve(M, np.hstack([-G, -D, nominal]))
    discrete = expm(motion * period)[: 2 * n]
    scale = np.repeat([1.0, period], n)  # the velocity in q̇ T
    A, B = discrete[:, : 2 * n] * scale[:, None] / scale, discrete[:, 2 * n :] * scale[:, None]
    A[:, :n] += B @ E
    return np.block([[A, B @ C], [H, np.zeros((len(F), n)), F]])


def model_stiffness(inertia: NominalInertia, position: Array, torque: Array) -> Array:
    """Return ∂(M̂(q) a + ĥ(q, 0))/∂q of a robot held at rest, with a = M̂(q)⁻¹ (τ − ĥ) constant, shape (n, n).

    Parameters
    ----------
    inertia
        M̂(q) and ĥ.
    position
        q [rad or m], shape (n,).
    torque
        Holding torque τ [N m or N], shape (n,).
    """
    zero = np.zeros(len(position))
    acceleration = np.linalg.solve(inertia.at(position), torque - inertia.forces(position, zero))
    q = ca.SX.sym("q", len(position))
    slopes = ca.jacobian(inertia.at(q) @ acceleration + inertia.forces(q, zero), q)
    return np.array(ca.Function("slopes", [q], [ca.densify(slopes)])(position))


def loop_with_model(
    law: PolePlacement, position: Array, torque: Array, computation_delay: int = 0
) -> tuple[Array, Array, Array]:
    """Return A, B, C of the loop of all joints, opened at its inertia ratio, of a law with M̂(q) at rest.

    The stiffness of the model adds M̂⁻¹ `model_stiffness` to the direct term from position to M̂⁻¹τ.

    Parameters
    ----------
    law
        A law with M̂(q).
    position
        q [rad or m], shape (n,).
    torque
        Holding torque [N m or N], shape (n,).
    computation_delay
        Periods between a measurement and its torque.

    Raises
    ------
    InvalidParameter
        For a law with a constant M̂.
    """
    if not isinstance(law.inertia, NominalInertia):
        raise InvalidParameter(f"law: {type(law).__name__} has a constant M̂; use decoupled_channels")
    is_shared = joints_share_loop(law)
    channel = decoupled_channels(law)[0] if is_shared else coupled_channel(law)
    matrices = {name: np.kron(getattr(channel, name), np.eye(law.n_joints if is_shared else 1)) for name in "FGHCDE"}
    matrices["D"] = matrices["D"] + np.linalg.solve(
        law.inertia.at(position), model_stiffness(law.inertia, position, torque)
    )
    return replace(channel, **matrices).with_delay(computation_delay).closed_loop(0.0)[:3]


@dataclass(frozen=True, eq=False)
class RobotAtRest:
    """A robot in some postures, with what the checks of all laws there have in common.

    Attributes
    ----------
    plant
        The robot.
    positions
        Postures [rad or m], shape (n, k).
    """

    plant: Plant
    positions: Array

    @cached_property
    def inertias(self) -> Array:
        """Return the inertia M in each posture [kg m² or kg], shape (k, n, n)."""
        return np.array([self.plant.inertia(q) for q in self.positions.T])

    @cached_property
    def tangents(self) -> list[tuple[Array, tuple[Array, Array, Array]]]:
        """Return at most `MAX_POSTURES` of the postures, each with M, D and G of `Plant.linearised`."""
        chosen = np.unique(np.linspace(0, self.positions.shape[1] - 1, MAX_POSTURES).astype(int))
        return [(q, self.plant.linearised(q)) for q in self.positions[:, chosen].T]


def unstable_posture(law: Law, plant: Plant, positions: Array, computation_delay: int = 0) -> UnstableMode | None:
    """Return the fastest growing mode of a robot held at rest in some postures, shape (n, k), as `fastest_at_rest`."""
    return fastest_at_rest(law, [RobotAtRest(plant, np.asarray(positions))], computation_delay)


def fastest_at_rest(
    law: Law,
    robots: Sequence[RobotAtRest],
    computation_delay: int = 0,
    *,
    channels: Sequence[Channel] | None = None,
) -> UnstableMode | None:
    """Return the fastest growing mode of some robots held at rest in their postures; None for none.

    This is quick: it linearises the law once, and the robot only where the inertia ratio alone makes the loop unstable.
    A law whose gains differ between the joints, and one with a model of the robot, is linearised in some of the
    postures instead.

    Parameters
    ----------
    law
        The law. None is returned where it is not linearisable.
    robots
        The robots; one with passive joints or constraints is left out.
    computation_delay
        Periods between a measurement and its torque.
    channels
        The linearised loops of the law, where they exist already.
    """
    robots = [robot for robot in robots if robot.plant.is_fully_driven and not robot.plant.constraints]
    if isinstance(law, PolePlacement) and joints_share_loop(law) and (not law.has_model or _has_nominal(law)):
        witnesses = [_unstable_by_ratio(law, robot, computation_delay, channels) for robot in robots]
        return max(filter(None, witnesses), key=lambda witness: witness.growth_rate, default=None)
    return _unstable_among(law, robots, computation_delay)


def _has_nominal(law: PolePlacement) -> bool:
    return isinstance(law.inertia, NominalInertia)


def _unstable_by_ratio(
    law: PolePlacement, robot: RobotAtRest, computation_delay: int, channels: Sequence[Channel] | None
) -> UnstableMode | None:
    """Return the fastest growing mode at the least and the largest inertia ratio, of a law with one loop for all."""
    has_nominal = _has_nominal(law)
    if not has_nominal:
        if not is_symmetric(robot.plant.command_gain[:, None] * law.M):
            return None
        law, (converted,) = in_torque_units(law, [robot.plant])
        robot = robot if converted is robot.plant else RobotAtRest(converted, robot.positions)
    try:
        channels = decoupled_channels(law, computation_delay) if channels is None else channels
    except NotLinearisable:
        return None
    A, B, C = channels[0].closed_loop(0.0)[:3]
    plant = robot.plant
    nominal_inertias = np.array([law.inertia_at(q) for q in robot.positions.T])
    ratios = 1 / inverse_ratios(robot.inertias, nominal_inertias)
    worst_radius, worst = 1.0, None
    for ratio in (ratios.min(), ratios.max()):
        if np.max(np.abs(np.linalg.eigvals(A + ratio * B @ C))) <= 1:
            continue
        index = int(np.argwhere(ratios == ratio)[0, 0])
        posture, loop = robot.positions[:, index], (A, B, C)
        if has_nominal:
            loop = loop_with_model(law, posture, plant.holding_torque(posture), computation_delay)
        state_matrix = rest_state_matrix(loop, nominal_inertias[index], plant.linearised(posture), law.period)
        verdict, radius, mode = schur_stability(state_matrix)
        if verdict == "refuted" and radius > worst_radius:
            worst_radius = radius
            worst = replace(unstable_mode(radius, mode, law.period), ratio=float(ratio), posture=posture)
    return worst


def _unstable_among(law: Law, robots: Sequence[RobotAtRest], computation_delay: int) -> UnstableMode | None:
    """Return the fastest growing mode at rest in some postures of each robot, of any law that has slopes there."""
    worst_radius, worst = 1.0, None
    try:
        loop_at = _posture_loops(law, computation_delay)
        for robot in robots:
            for posture, tangent in robot.tangents:
                state_matrix = rest_state_matrix(*loop_at(robot.plant, posture), tangent, law.period)
                if powers_vanish(state_matrix / worst_radius):
                    continue
                if np.max(np.abs(np.linalg.eigvals(state_matrix))) <= worst_radius:
                    continue
                verdict, radius, mode = schur_stability(state_matrix)
                if verdict == "refuted":
                    worst_radius, worst = radius, replace(unstable_mode(radius, mode, law.period), posture=posture)
    except (UnsupportedLaw, NotLinearisable):
        return None
    return worst


def _posture_loops(
    law: Law, computation_delay: int
) -> Callable[[Plant, Array], tuple[tuple[Array, Array, Array], Array]]:
    """Return a function from a robot in a posture to A, B, C of the loop of all joints there, and its nominal inertia.

    It traces the law only once.
    """
    if isinstance(law, PolePlacement) and isinstance(law.inertia, NominalInertia):

        def with_model(plant: Plant, posture: Array) -> tuple[tuple[Array, Array, Array], Array]:
            torque = plant.holding_torque(posture)
            return loop_with_model(law, posture, torque, computation_delay), law.inertia_at(posture)

        return with_model
    channel_at = posture_channels(law, computation_delay)
    return lambda _, posture: (channel_at(posture).closed_loop(0.0)[:3], np.eye(law.n_joints))


def describe_instability(
    law: Law, witness: UnstableMode, computation_delay: int = 0, *, channels: Sequence[Channel] | None = None
) -> str:
    """Return in words which posture is unstable, and what to change.

    Parameters
    ----------
    law
        The law.
    witness
        The mode that `fastest_at_rest` returned.
    computation_delay
        Periods between a measurement and its torque.
    channels
        The linearised loops of the law, where they exist already.
    """
    posture = "" if witness.posture is None else format_vector(witness.posture)
    text = f"{type(law).__name__}: held at rest at q = ({posture}) the loop is unstable: "
    growth = f"a mode grows by e in {1 / witness.growth_rate:.2g} s"
    ratio = witness.ratio
    if ratio is None:
        return f"{text}{growth}. Lower the gains, shorten the window or delay less"
    text += f"an eigenvalue of M(q)⁻¹M̂ is {ratio:.4g}, and {growth}"
    channels = decoupled_channels(law, computation_delay) if channels is None else channels
    if any(channel.n_coupled > 1 for channel in channels):
        return f"{text}. Lower the natural frequency, shorten the window or delay less"
    interval = widest_interval(stable_intervals(law, channels=channels))
    if interval is None:
        return f"{text}. No ratio is stable: lower the natural frequency, shorten the window or delay less"
    low, high = interval
    text += f"; the loop is stable from {low:.4g} to {high:.4g}. "
    if ratio < low:
        return text + "Use a larger inertia or a lower natural frequency"
    literal = isinstance(law, TDE) and not law.synchronised
    alternative = "synchronised=True" if literal else "a lower natural frequency"
    return text + f"Use a smaller inertia, a shorter window or {alternative}"
