"""The least error that any linear controller of one joint can have at a given torque variation, and the distance to it.

One joint of known inertia is q̈ = a + d with the acceleration a by its torque, held over each period T. The disturbing
acceleration d is a random walk with steps of RMS w at the sampling instants. The position is measured with white noise
of RMS σ, and the torque of a period may use its first sample. The linear controllers that minimise the variance of the
position plus a weight times that of the change of a are those of LQG. No other linear controller has less of both.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.core import validation as check
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.numerics.norms import balance

INTEGRAL_TOLERANCE = 1e-6
"""Largest position after a lasting step of d, over that of a loop without integral action, which counts as none."""
EDGE = 1e-9
"""Distance from the unit circle within which an eigenvalue counts as outside."""
MAX_LOG_WEIGHT = 38.0
"""Natural logarithm of the largest weight on the change of a, in the units of `optimal_loop`."""


@dataclass(frozen=True)
class LoopDeviations:
    """RMS values of a loop under noise and a disturbance that walks.

    Attributes
    ----------
    error
        RMS position [rad or m].
    change
        RMS change of the acceleration by the torque from period to period [rad/s² or m/s²].
    """

    error: float
    change: float


@dataclass(frozen=True)
class OptimumDistance:
    """Error and torque variation of a loop over the least ones of linear controllers of the same joint.

    Attributes
    ----------
    ratio
        Error over the least one at the same torque variation, at least 1.
    change_ratio
        Torque variation over the least one at the same error, at least 1.
    loop
        RMS values of the loop.
    least_error
        Least RMS position of any linear controller with that RMS change [rad or m].
    noise
        RMS error σ of the measured position [rad or m].
    disturbance
        RMS step w of the disturbing acceleration per period [rad/s² or m/s²].
    inertia_ratio
        ρ at which the loop is taken.
    """

    ratio: float
    change_ratio: float
    loop: LoopDeviations
    least_error: float
    noise: float
    disturbance: float
    inertia_ratio: float


def loop_deviations(channel: Channel, ratio: float, noise: float, disturbance: float) -> LoopDeviations:
    """Return the RMS position and the RMS change of acceleration of a loop of one joint.

    In coordinates y − x∞ d the walk of d adds −x∞ times its step, with x∞ = (I − A)⁻¹B where the loop settles after a
    lasting step. Both are infinite for an unstable loop. The error is infinite where that is not at zero.

    Parameters
    ----------
    channel
        The loop, of one joint.
    ratio
        ρ, the inertia ratio.
    noise
        σ [rad or m].
    disturbance
        w [rad/s² or m/s²].
    """
    A, B, C, _, _ = channel.closed_loop(ratio)
    if np.max(np.abs(np.linalg.eigvals(A))) >= 1 - EDGE:
        return LoopDeviations(np.inf, np.inf)
    settled = np.linalg.solve(np.eye(len(A)) - A, B)
    from_noise = ratio * B @ channel.D
    from_noise[2:] += channel.G
    # the last state is the former v, without what the step of d adds to it
    A_full = np.block([[A, np.zeros((len(A), 1))], [C, np.zeros((1, 1))]])
    inputs = np.block([[noise * from_noise, -disturbance * settled], [noise * channel.D, -disturbance * C @ settled]])
    outputs = np.vstack([np.eye(1, len(A_full)), ratio * np.hstack([C, [[-1.0]]])])
    A_full, inputs, outputs = balance(A_full, inputs, outputs)
    X = _covariance(A_full, inputs)
    direct = noise * ratio * channel.D.item()
    variances = np.diag(outputs @ X @ outputs.T)
    if not np.all(variances >= 0):  # so near the edge of stability that rounding spoils the equation
        return LoopDeviations(np.inf, np.inf)
    error, change = np.sqrt(variances + np.array([0.0, direct**2]))
    scale = channel.period**2 + abs((B[0] / max(ratio, 1e-300)).item())
    if disturbance and abs(settled[0, 0]) > INTEGRAL_TOLERANCE * max(scale, float(np.max(np.abs(settled)))):
        return LoopDeviations(np.inf, float(change))
    return LoopDeviations(float(error), float(change))


def optimal_loop(disturbance: float, weight: float, delay: int = 0) -> tuple[float, float]:
    """Return RMS position over σ and RMS change of acceleration over σ/T² of the LQG controller.

        x = [q, T q̇, T²(a + d)] / (σ or σ/T²),   η = T² Δa/σ,   minimise E[q²] + weight · E[η²]

    The controller is η = −K x̂ with the filtered state x̂, by the two Riccati equations.

    Parameters
    ----------
    disturbance
        T² w/σ.
    weight
        Of the change; above zero.
    delay
        Periods between a measurement and its torque.
    """
    A, B = _joint(delay)
    gain, innovation, filter_error = _filter(A, disturbance)
    scale = _time_scale(weight ** (-1 / 6), len(A))
    K = _regulator(A, B, weight, scale)
    closed = (A - B @ K) * scale / scale[:, None]
    # the filtered state and its error are uncorrelated, and the innovations are white
    X = _covariance(closed, innovation**0.5 * gain / scale[:, None])
    change = K * scale
    return float(np.sqrt(filter_error + X[0, 0])), float(np.sqrt((change @ X @ change.T).item()))


def _joint(delay: int) -> tuple[Array, Array]:
    """Return A and B of the joint in the units of `optimal_loop`; changes under way are states, the next one first."""
    A, B = np.zeros((3 + delay, 3 + delay)), np.zeros((3 + delay, 1))
    A[:3, :3] = [[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]
    effect = np.array([0.5, 1.0, 1.0])
    if delay == 0:
        return A, effect[:, None]
    A[:3, 3] = effect
    A[3:-1, 4:] = np.eye(delay - 1)
    B[-1] = 1.0
    return A, B


def _time_scale(rate: float, n_states: int) -> Array:
    """Return the scale of each state for a loop of this rate per period, so that slow loops are as well conditioned."""
    return min(rate, 1.0) ** np.minimum(np.arange(n_states), 3)


def _regulator(A: Array, B: Array, weight: float, scale: Array) -> Array:
    """Return K of η = −K x, computed in scaled states."""
    from scipy.linalg import solve_discrete_are

    unit = scale[1] ** 3
    A, B, weight = A * scale / scale[:, None], B * unit / scale[:, None], weight * unit**2
    Q = np.zeros_like(A)
    Q[0, 0] = 1.0
    P = solve_discrete_are(A, B, Q, np.array([[weight]]))
    return unit * np.linalg.solve(weight + B.T @ P @ B, B.T @ P @ A) / scale


def _filter(A: Array, disturbance: float) -> tuple[Array, float, float]:
    """Return L of x̂ = x̂⁻ + L (y − q̂⁻), the variance of y − q̂⁻ and that of q − q̂. Changes under way are known."""
    from scipy.linalg import solve_discrete_are

    scale = _time_scale(disturbance ** (1 / 3), 3)
    walk = np.zeros((3, 3))
    walk[2, 2] = (disturbance / scale[2]) ** 2
    S = solve_discrete_are((A[:3, :3] * scale / scale[:, None]).T, np.eye(3, 1), walk, np.eye(1))
    gain = np.zeros((len(A), 1))
    gain[:3, 0] = S[:, 0] * scale / (1 + S[0, 0])
    return gain, float(1 + S[0, 0]), float(S[0, 0] / (1 + S[0, 0]))


def _covariance(A: Array, B: Array) -> Array:
    from scipy.linalg import solve_discrete_lyapunov

    return np.asarray(solve_discrete_lyapunov(A, B @ B.T, method="bilinear"))


def least_error(change: float, *, noise: float, disturbance: float, period: float, delay: int = 0) -> float:
    """Return the least RMS position of any linear controller with at most an RMS change of acceleration.

    It is infinite for a change that only loops of some 10⁻³ rad per period would have.

    Parameters
    ----------
    change
        RMS change of the acceleration by the torque from period to period [rad/s² or m/s²].
    noise
        RMS error σ of the measured position [rad or m].
    disturbance
        RMS step w of the disturbing acceleration per period [rad/s² or m/s²].
    period
        T [s].
    delay
        Periods between a measurement and its torque.

    Raises
    ------
    InvalidParameter
        For numbers that are not above zero, and a negative delay.

    References
    ----------
    K. J. Åström and B. Wittenmark, Computer-Controlled Systems, 3rd ed., 1997, chapter 11.
    """
    check.number("change", change, 0, strict=True)
    step = _normalised_walk(noise, disturbance, period, delay)
    return noise * _least_other(step, period**2 * change / noise, delay, given=1)


def least_change(error: float, *, noise: float, disturbance: float, period: float, delay: int = 0) -> float:
    """Return the least RMS change of acceleration of any linear controller with at most an RMS position.

    It is infinite for a position that none has, and zero for one that a loop of less than some 10⁻³ rad per period has.

    Parameters
    ----------
    error
        RMS position [rad or m].
    noise, disturbance, period, delay
        As in `least_error`.

    Raises
    ------
    InvalidParameter
        For numbers that are not above zero, and a negative delay.
    """
    check.number("error", error, 0, strict=True)
    step = _normalised_walk(noise, disturbance, period, delay)
    return noise / period**2 * _least_other(step, error / noise, delay, given=0)


def _normalised_walk(noise: float, disturbance: float, period: float, delay: int) -> float:
    """Return T² w/σ of numbers that are checked."""
    check.number("noise", noise, 0, strict=True)
    check.number("disturbance", disturbance, 0, strict=True)
    check.number("period", period, 0, strict=True)
    check.integer("delay", delay)
    return period**2 * disturbance / noise


@lru_cache(maxsize=4096)
def _least_other(disturbance: float, value: float, delay: int, given: int) -> float:
    """Return the other of `optimal_loop`'s two values at the weight where the ``given`` one is this value.

    Over the weight the position rises and the change falls.
    """
    from scipy.optimize import brentq

    def values(log_weight: float) -> tuple[float, float]:
        return optimal_loop(disturbance, float(np.exp(log_weight)), delay)

    def excess(log_weight: float) -> float:
        return float(np.log(values(log_weight)[given] / value)) * (1 if given == 0 else -1)

    low, high = -MAX_LOG_WEIGHT / 2, MAX_LOG_WEIGHT
    if excess(low) > 0:
        return values(low)[0] if given else np.inf
    if excess(high) < 0:
        return np.inf if given else 0.0
    root: Any = brentq(excess, low, high, xtol=1e-4)
    return values(float(root))[1 - given]


def distance_from_optimum(
    channel: Channel, ratio: float, *, noise: float = 1.0, disturbance: float | None = None, delay: int = 0
) -> OptimumDistance:
    """Return how far a loop of one joint is from the best linear controller for the same joint.

    Parameters
    ----------
    channel
        The loop, of one joint.
    ratio
        ρ, the inertia ratio.
    noise
        σ [rad or m]; it matters only beside a disturbance.
    disturbance
        w [rad/s² or m/s²]; None for the one that adds as much to the loop's mean squared error as the noise does.
    delay
        Computation delay that the loop contains [periods].
    """
    if disturbance is None:
        by_noise, by_walk = loop_deviations(channel, ratio, noise, 0.0), loop_deviations(channel, ratio, 0.0, 1.0)
        disturbance = by_noise.error / by_walk.error if np.isfinite(by_walk.error) else np.inf
    loop = LoopDeviations(np.inf, np.inf)
    if np.isfinite(disturbance) and disturbance > 0:
        loop = loop_deviations(channel, ratio, noise, disturbance)
    if not np.isfinite(loop.error):
        return OptimumDistance(np.inf, np.inf, loop, np.nan, noise, float(disturbance), float(ratio))
    problem = {"noise": noise, "disturbance": disturbance, "period": channel.period, "delay": delay}
    least = least_error(loop.change, **problem)
    change = least_change(loop.error, **problem)
    change_ratio = loop.change / change if change else np.inf
    return OptimumDistance(loop.error / least, change_ratio, loop, least, noise, disturbance, float(ratio))


def law_distances(law: Law, ratios: Sequence[float], computation_delay: int = 0) -> list[OptimumDistance]:
    """Return the distance of a law at some inertia ratios, each that of its worst joint.

    Parameters
    ----------
    law
        A law with an inertia M̂ whose gains do not couple the joints.
    ratios
        Inertia ratios ρ.
    computation_delay
        Periods between a measurement and its torque.

    Raises
    ------
    UnsupportedLaw, NotLinearisable
        As `tarc.analysis.linearise.decoupled_channels`.
    """
    channels = [loop for loop in decoupled_channels(law, computation_delay) if loop.n_coupled == 1]
    return [
        max(
            (distance_from_optimum(channel, float(ratio), delay=computation_delay) for channel in channels),
            key=lambda distance: distance.ratio,
        )
        for ratio in ratios
    ]


def optimal_front(disturbance: float, *, noise: float, period: float, delay: int = 0, count: int = 60) -> Array:
    """Return the front of all linear controllers: RMS changes and least RMS positions, shape (2, count).

    Parameters
    ----------
    disturbance, noise, period, delay
        As in `least_error`.
    count
        Number of points.
    """
    step = period**2 * disturbance / noise
    weights = np.exp(np.linspace(-MAX_LOG_WEIGHT / 2, MAX_LOG_WEIGHT, count))
    points = np.array([optimal_loop(step, float(weight), delay) for weight in weights])
    return np.array([points[:, 1] * noise / period**2, points[:, 0] * noise])
