"""Stability of a robot held at rest in a posture, and what to change where it is unstable."""

from dataclasses import replace

import numpy as np

from tarc.analysis.inertia_ratio import inverse_ratios
from tarc.analysis.linearise import decoupled_channels, joints_share_loop
from tarc.analysis.stability import UnstableMode, stable_intervals, unstable_mode
from tarc.core.errors import TarcError
from tarc.core.formatting import format_vector
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tde import TDE
from tarc.numerics.matrix_tests import schur_stability
from tarc.plants.base import Plant


def rest_state_matrix(loop: tuple[Array, ...], nominal: Array, rest: tuple[Array, ...], period: float) -> Array:
    """State matrix of the law around M δq̈ + D δq̇ + G δq = δτ, the torque held over each period.

    The loop is that of all joints, or one that they share: free, into, out with the double integrator still in it.
    """
    from scipy.linalg import expm

    free, _, out = loop
    M, D, G = rest
    n, width = len(M), len(out)
    joints = np.eye(n if width == 1 else 1)
    F, H = np.kron(free[2 * width :, 2 * width :], joints), np.kron(free[2 * width :, :width], joints)
    C, E = np.kron(out[:, 2 * width :], joints), np.kron(out[:, :width], joints)
    motion = np.zeros((3 * n, 3 * n))
    motion[:n, n : 2 * n] = np.eye(n)
    motion[n : 2 * n] = np.linalg.solve(M, np.hstack([-G, -D, nominal]))
    held = expm(motion * period)[: 2 * n]
    scale = np.repeat([1.0, period], n)  # the velocity in q̇ T
    A, B = held[:, : 2 * n] * scale[:, None] / scale, held[:, 2 * n :] * scale[:, None]
    A[:, :n] += B @ E
    return np.block([[A, B @ C], [H, np.zeros((len(F), n)), F]])


def unstable_posture(law: Law, plant: Plant, positions: Array, computation_delay: int = 0) -> UnstableMode | None:
    """The mode that grows fastest where a robot is held at rest in one of some positions (n, k); None if none does.

    Quick: one linearisation of the law, the inertia in each position, and the robot linearised where the ratio of
    inertias alone makes the loop unstable. Only for laws whose gains are the same on every joint; None for others.
    """
    if not joints_share_loop(law) or not isinstance(law, PolePlacement):
        return None
    try:
        free, into, out = decoupled_channels(law, computation_delay)[0].closed_loop(0.0)[:3]
    except TarcError:  # no linearisation, and so nothing to warn of
        return None
    inertias = np.array([plant.inertia(q) for q in np.asarray(positions).T])
    ratios = 1 / inverse_ratios(inertias, law.M)
    found = None
    for ratio in (ratios.min(), ratios.max()):
        loop = free + ratio * into @ out
        if np.max(np.abs(np.linalg.eigvals(loop))) <= 1:  # the full test only where there is something to show
            continue
        posture = np.asarray(positions)[:, int(np.argwhere(ratios == ratio)[0, 0])]
        answer, radius, mode = schur_stability(
            rest_state_matrix((free, into, out), law.M, plant.linearised(posture), law.period)
        )
        if answer == "refuted" and (found is None or radius > found[0]):
            found = radius, replace(unstable_mode(radius, mode, law.period), ratio=float(ratio), posture=posture)
    return found[1] if found else None


def describe_instability(law: Law, witness: UnstableMode, computation_delay: int = 0) -> str:
    """What `unstable_posture` found, and what to do about it, in a sentence each."""
    ratio = np.nan if witness.ratio is None else witness.ratio
    posture = "" if witness.posture is None else format_vector(witness.posture)
    text = (
        f"{type(law).__name__}: held at rest at q = ({posture}) the loop is unstable: an eigenvalue of M(q)⁻¹M̂ is "
        f"{ratio:.4g}, and a mode grows by e in {1 / witness.growth_rate:.2g} s"
    )
    ranges = stable_intervals(law, computation_delay=computation_delay)
    if not ranges:
        return f"{text}. No ratio is stable: lower the natural frequency, shorten the window or delay less"
    low, high = max(ranges, key=lambda ends: ends[1] / max(ends[0], 1e-300))
    text += f"; the loop is stable from {low:.4g} to {high:.4g}. "
    if ratio < low:
        return text + "Use a larger inertia or a lower bandwidth"
    literal = isinstance(law, TDE) and not law.synchronised
    return text + f"Use a smaller inertia, a shorter window or {'synchronised=True' if literal else 'less bandwidth'}"
