"""Stability of a robot held at rest in a posture, and what to change where it is unstable."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tarc.analysis.command_units import in_torque_units, is_symmetric
from tarc.analysis.inertia_ratio import inverse_ratios
from tarc.analysis.linearise import Channel, decoupled_channels, joints_share_loop, posture_channels
from tarc.analysis.stability import UnstableMode, stable_intervals, unstable_mode, widest_interval
from tarc.core.errors import NotLinearisable, UnsupportedLaw
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tde import TDE
from tarc.numerics.matrix_tests import schur_stability
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
    joints = np.eye(n if n_coupled == 1 else 1)
    F, H = (
        np.kron(A_loop[2 * n_coupled :, columns], joints) for columns in (slice(2 * n_coupled, None), slice(n_coupled))
    )
    C, E = np.kron(C_loop[:, 2 * n_coupled :], joints), np.kron(C_loop[:, :n_coupled], joints)
    motion = np.zeros((3 * n, 3 * n))
    motion[:n, n : 2 * n] = np.eye(n)
    motion[n : 2 * n] = np.linalg.solve(M, np.hstack([-G, -D, nominal]))
    discrete = expm(motion * period)[: 2 * n]
    scale = np.repeat([1.0, period], n)  # the velocity in q̇ T
    A, B = discrete[:, : 2 * n] * scale[:, None] / scale, discrete[:, 2 * n :] * scale[:, None]
    A[:, :n] += B @ E
    return np.block([[A, B @ C], [H, np.zeros((len(F), n)), F]])


def unstable_posture(
    law: Law,
    plant: Plant,
    positions: Array,
    computation_delay: int = 0,
    *,
    channels: Sequence[Channel] | None = None,
) -> UnstableMode | None:
    """Return the fastest growing mode of a robot held at rest in one of some postures; None for none.

    This is quick: it linearises the law once, and the robot only where the inertia ratio alone makes the loop unstable.
    A law whose gains differ between the joints, and one with a model of the robot, is linearised in some of the
    postures instead.

    Parameters
    ----------
    law
        The law. None is returned where it is not linearisable.
    plant
        The robot; None is returned for one with passive joints or constraints.
    positions
        Postures [rad or m], shape (n, k).
    computation_delay
        Periods between a measurement and its torque.
    channels
        The linearised loops of the law, where they exist already.
    """
    if not plant.is_fully_driven or plant.constraints:
        return None
    positions = np.asarray(positions)
    if not joints_share_loop(law) or not isinstance(law, PolePlacement) or law.has_model:
        return _unstable_among(law, plant, positions, computation_delay)
    if not is_symmetric(plant.command_gain[:, None] * law.M):
        return None
    law, (plant,) = in_torque_units(law, [plant])
    try:
        channels = decoupled_channels(law, computation_delay) if channels is None else channels
    except NotLinearisable:
        return None
    A, B, C = channels[0].closed_loop(0.0)[:3]
    inertias = np.array([plant.inertia(q) for q in positions.T])
    ratios = 1 / inverse_ratios(inertias, law.M)
    worst_radius, worst = 1.0, None
    for ratio in (ratios.min(), ratios.max()):
        if np.max(np.abs(np.linalg.eigvals(A + ratio * B @ C))) <= 1:
            continue
        posture = positions[:, int(np.argwhere(ratios == ratio)[0, 0])]
        state_matrix = rest_state_matrix((A, B, C), law.M, plant.linearised(posture), law.period)
        verdict, radius, mode = schur_stability(state_matrix)
        if verdict == "refuted" and radius > worst_radius:
            worst_radius = radius
            worst = replace(unstable_mode(radius, mode, law.period), ratio=float(ratio), posture=posture)
    return worst


def _unstable_among(law: Law, plant: Plant, positions: Array, computation_delay: int) -> UnstableMode | None:
    """Return the fastest growing mode at rest in `MAX_POSTURES` of some postures, of any law that has slopes there."""
    try:
        channel_at = posture_channels(law, computation_delay)
    except (UnsupportedLaw, NotLinearisable):
        return None
    worst_radius, worst = 1.0, None
    chosen = np.unique(np.linspace(0, positions.shape[1] - 1, MAX_POSTURES).astype(int))
    for posture in positions[:, chosen].T:
        try:
            loop = channel_at(posture).closed_loop(0.0)[:3]
        except NotLinearisable:
            return None
        state_matrix = rest_state_matrix(loop, np.eye(law.n_joints), plant.linearised(posture), law.period)
        if np.max(np.abs(np.linalg.eigvals(state_matrix))) <= worst_radius:
            continue
        verdict, radius, mode = schur_stability(state_matrix)
        if verdict == "refuted":
            worst_radius, worst = radius, replace(unstable_mode(radius, mode, law.period), posture=posture)
    return worst


def describe_instability(
    law: Law, witness: UnstableMode, computation_delay: int = 0, *, channels: Sequence[Channel] | None = None
) -> str:
    """Return in words which posture is unstable, and what to change.

    Parameters
    ----------
    law
        The law.
    witness
        The mode that `unstable_posture` returned.
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
