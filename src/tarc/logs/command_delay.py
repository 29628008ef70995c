"""Time from a law's torque to the measured motion, by correlation with a model's torque."""

from dataclasses import dataclass, replace

import numpy as np

from tarc.core.types import Array
from tarc.logs.loop_log import LoopLog
from tarc.logs.model_check import model_torque
from tarc.plants.base import Plant
from tarc.signals.smoothing import smoothing_curve

N_BLOCKS = 6
"""Parts of a log in which the delay is sought separately, for its error."""
MAX_INSTANTS = 1600
"""Instants of a log that are used."""
BAND, WIDER_BAND = 4.0, 6.0
"""Cut-off of the motion over the frequency of the reference, and a second one that tells the effect of noise."""
LEAST_CUTOFF, MAX_CUTOFF = 3.0, 25.0
"""Bounds of the cut-off [Hz]."""
SLACK = 3.0
"""Periods before zero at which the search begins."""
LONGEST = 12.0
"""Longest delay that is sought [periods]."""
STEP = 0.5
"""Step of the search [periods]."""
HOLD = 0.5
"""Mean age of a torque that is held over a period [periods]."""
MIMICRY = 0.1
"""Part of the unexplained torque that may be in quadrature with the model's, as a delay is."""
FRICTION_SPEED = 0.03
"""Width of the smooth sign of dry friction [rad/s or m/s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandDelay:
    """Delay between the torque that the law commands and the position that it measures.

    Attributes
    ----------
    delay
        [periods], actuation and measurement together, without the half period over which a torque is held.
    error
        Its standard error: the scatter over parts of the log and over joints, and half the change with a wider band.
        It also has a tenth of the angle that the unexplained torque could turn.
    by_joint
        Of each joint [periods], shape (n,); NaN where it does not show.
    explained
        Share of the torque's variance that the model explains at this delay, shape (n,).
    explained_share
        Its mean, weighted as the delay.
    cutoff
        Frequency up to which motion and torque were compared [Hz].
    """

    delay: float
    error: float
    by_joint: Array
    explained: Array
    explained_share: float
    cutoff: float


def command_delay(log: LoopLog, plant: Plant) -> CommandDelay | None:
    """Find the delay at which the commanded torque correlates best with that of the robot's model.

        τ(t − d) ≈ c1 τ_model(q, q̇, q̈) + c2 q̇ + c3 sgn q̇ + c4

    The sum of squares is minimised over d and over c, joint by joint and in each part of the log. Joints and parts
    count by the curvature of their sum. A joint whose friction hides the rest has hardly any.

    Parameters
    ----------
    log
        The log.
    plant
        Its robot; load and friction may be unknown.

    Returns
    -------
    CommandDelay or None
        None for a log without motion, and a robot that has joints without encoders or takes no torques.
    """
    takes_torques = all(unit.startswith("N") for unit in plant.torque_units)
    if not log.motion_frequency or plant.unmeasured or not takes_torques:
        return None
    estimate, wider = (_in_band(log, plant, band * log.motion_frequency) for band in (BAND, WIDER_BAND))
    if estimate is None or wider is None:
        return None
    by_noise = (wider.delay - estimate.delay) / 2
    turn = 2 * np.pi * log.motion_frequency / 2 * log.period  # of the motion in a period [rad]
    by_model = MIMICRY * np.sqrt(max(1 - estimate.explained_share, 0.0)) / turn
    return replace(estimate, error=float(np.linalg.norm([estimate.error, by_noise, by_model])))


def _in_band(log: LoopLog, plant: Plant, cutoff: float) -> CommandDelay | None:
    """Return the delay from motion and torque below a cut-off [Hz]."""
    cutoff = min(float(np.clip(cutoff, LEAST_CUTOFF, MAX_CUTOFF)), 0.2 / log.period)
    motion = smoothing_curve(log.times, log.position, cutoff)
    torque = smoothing_curve(log.times, log.torque, cutoff)
    T = log.period
    margin = min(int(np.ceil(10 / cutoff / T)) + int(LONGEST) + 1, len(log.times) // 4)
    inner = log.times[margin:-margin]
    instants = inner[:: max(len(inner) // MAX_INSTANTS, 1)]
    position, velocity, acceleration = (motion(instants, order) for order in range(3))
    model = model_torque(plant, position, velocity, acceleration)
    delays = np.arange(-SLACK, LONGEST + STEP / 2, STEP)
    shifted = np.stack([torque(instants - (delay + HOLD) * T) for delay in delays])
    n = log.n_joints
    best, weights, explained = np.zeros((N_BLOCKS, n)), np.zeros((N_BLOCKS, n)), np.zeros((N_BLOCKS, n))
    for k, rows in enumerate(np.array_split(np.arange(len(instants)), N_BLOCKS)):
        for i in range(n):
            columns = _columns(model[rows, i], velocity[rows, i])
            best[k, i], weights[k, i], explained[k, i] = _best(columns, shifted[:, rows, i].T, delays)
    return _pooled(best, weights, explained, cutoff)


def _columns(model: Array, velocity: Array) -> Array:
    """Return an orthonormal basis of the model's torque, friction and a constant, shape (k, 4)."""
    columns = np.column_stack([model, velocity, np.tanh(velocity / FRICTION_SPEED), np.ones(len(model))])
    basis, _ = np.linalg.qr(columns / np.maximum(np.sqrt(np.sum(columns**2, axis=0)), 1e-300))
    return basis


def _best(basis: Array, torques: Array, delays: Array) -> tuple[float, float, float]:
    """Return the delay of the least sum of squares, its curvature over that sum, and the explained share."""
    sums = np.sum((torques - basis @ (basis.T @ torques)) ** 2, axis=0)
    k = int(np.argmin(sums))
    if k in (0, len(delays) - 1):
        return float(delays[k]), 0.0, 0.0
    curvature, slope, _ = np.polyfit(delays[k - 1 : k + 2], sums[k - 1 : k + 2], 2)
    total = np.sum((torques[:, k] - np.mean(torques[:, k])) ** 2)
    if curvature <= 0 or total <= 0 or not np.isfinite(curvature):
        return float(delays[k]), 0.0, 0.0
    best = float(np.clip(-slope / (2 * curvature), delays[0], delays[-1]))
    return best, float(curvature / max(sums[k], 1e-12 * total)), float(1 - sums[k] / total)


def _pooled(delays: Array, weights: Array, explained: Array, cutoff: float) -> CommandDelay | None:
    """Return the weighted mean over parts (rows) and joints (columns), with the scatter of both as its error."""
    if not np.sum(weights) > 0:
        return None
    mean = float(np.sum(weights * delays) / np.sum(weights))
    variance = 0.0
    for axis in (0, 1):
        size = np.sum(weights, axis=axis)
        parts = np.sum(weights * delays, axis=axis) / np.maximum(size, 1e-300)
        share = size / np.sum(size)
        effective = 1 / np.sum(share**2)
        if effective > 1:
            variance += float(np.sum(share * (parts - mean) ** 2) / (effective - 1))
    size = np.sum(weights, axis=0)
    by_joint = np.where(size > 0, np.sum(weights * delays, axis=0) / np.maximum(size, 1e-300), np.nan)
    return CommandDelay(
        delay=mean,
        error=float(np.sqrt(variance)),
        by_joint=by_joint,
        explained=np.where(size > 0, np.sum(weights * explained, axis=0) / np.maximum(size, 1e-300), np.nan),
        explained_share=float(np.sum(weights * explained) / np.sum(weights)),
        cutoff=cutoff,
    )
