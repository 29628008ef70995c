"""Stability of the linearised loop over the inertia ratio: stable intervals, crossings, delay margin."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.core.errors import NoStableRatio, UnsupportedLaw
from tarc.core.types import Array
from tarc.laws.base import Law


@dataclass(frozen=True, kw_only=True, eq=False)
class Witness:
    """Proof of a refutation; one subclass per kind."""


@dataclass(frozen=True, kw_only=True, eq=False)
class UnstableMode(Witness):
    """A mode of a loop that grows.

    Attributes
    ----------
    ratio
        Inertia ratio at which it grows.
    slope
        Slope of the robust term at which it grows [1/s²].
    gain
        Gain ĉ at which it grows [rad/s²].
    growth_rate
        ln |z| / T of its eigenvalue z [1/s].
    frequency
        |arg z| / T [rad/s].
    posture
        Position of the robot at which it grows [rad or m], shape (n,).
    """

    ratio: float | None = None
    slope: float | None = None
    gain: float | None = None
    growth_rate: float
    frequency: float
    posture: Array | None = None


def unstable_mode(radius: float, mode: complex, period: float) -> UnstableMode:
    """Return the mode of an eigenvalue outside the unit circle, of magnitude ``radius``."""
    growth_rate, frequency = float(np.log(radius) / period), float(abs(np.angle(mode)) / period)
    return UnstableMode(growth_rate=growth_rate, frequency=frequency)


MAX_DELAY_PERIODS = 200
"""Largest delay margin that is tried [periods]."""
CIRCLE_TOLERANCE = 1e-9
"""Distance from the unit circle within which an eigenvalue counts as on it."""


def stable_intervals(
    law: Law, *, computation_delay: int = 0, gain: float = 0.0, channels: Sequence[Channel] | None = None
) -> list[tuple[float, float]]:
    """Return all ranges of the inertia ratio in which the loop is stable, in ascending order.

    The ends are the ratios at which an eigenvalue lies on the unit circle. They are found all at once, as eigenvalues
    of a matrix pencil, and not on a grid.

    Parameters
    ----------
    law
        A law with an inertia M̂, whose gains do not couple the joints.
    computation_delay
        Periods between a measurement and its torque.
    gain
        Frozen switching gain ĉ [rad/s²].
    channels
        The loops of `decoupled_channels` for these arguments, where they exist already.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia, and for gains that couple the joints.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        For a negative delay or gain.
    """
    channels = decoupled_channels(law, computation_delay, gain) if channels is None else channels
    edges = {0.0, *(edge for channel in channels for edge in crossings(*open_loop_matrices(channel)))}
    edges = sorted(edges | set(_missed_crossings(channels, edges)))
    bounds = [*edges, edges[-1] * 2 + 1.0]
    intervals: list[tuple[float, float]] = []
    for low, high in pairwise(bounds):
        if spectral_radius(channels, (low + high) / 2) < 1 - CIRCLE_TOLERANCE:
            end = np.inf if high == bounds[-1] else high
            if intervals and intervals[-1][1] == low:
                intervals[-1] = (intervals[-1][0], end)
            else:
                intervals.append((low, end))
    return intervals


def _missed_crossings(channels: Sequence[Channel], edges: set[float]) -> list[float]:
    """Return ratios at which stability changes with no edge between: what rounding hid from the pencil."""
    from scipy.optimize import brentq

    middles = ((low + high) / 2 for low, high in pairwise(sorted(edges)))
    trials = np.unique([*np.geomspace(1e-4, 30.0, 25), *middles])
    excess = [spectral_radius(channels, float(trial)) - 1 for trial in trials]
    missed = []
    for (low, excess_low), (high, excess_high) in pairwise(zip(trials, excess, strict=True)):
        if excess_low * excess_high < 0 and not any(low <= edge <= high for edge in edges):
            missed.append(brentq(lambda ratio: spectral_radius(channels, ratio) - 1, float(low), float(high)))
    return [float(ratio) for ratio in missed]


def stable_interval(law: Law, *, computation_delay: int = 0, gain: float = 0.0) -> tuple[float, float]:
    """Return the stable range of the inertia ratio whose ends have the largest quotient.

    Parameters
    ----------
    law, computation_delay, gain
        As in `stable_intervals`.

    Raises
    ------
    NoStableRatio
        For a loop that is stable for no ratio.
    UnsupportedLaw, NotLinearisable, InvalidParameter
        As in `stable_intervals`.
    """
    interval = widest_interval(stable_intervals(law, computation_delay=computation_delay, gain=gain))
    if interval is None:
        raise NoStableRatio(
            "stable_interval: no inertia ratio makes this loop stable; use a shorter window, a lower natural "
            "frequency or less computation delay"
        )
    return interval


def widest_interval(intervals: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """Return the interval whose ends have the largest quotient; None for none."""
    return max(intervals, key=lambda ends: ends[1] / max(ends[0], 1e-300), default=None)


def crossings(A: Array, b: Array, c: Array, low: float = 1e-9, high: float = 1e6) -> list[float]:
    """Return all ratios ρ for which A + ρ b c has an eigenvalue on the unit circle, in ascending order.

    There G(z) = c (zI − A)⁻¹ b is real, so G(z) = G(1/z), whose zeros are eigenvalues of a pencil. Then ρ = 1/G(z).

    Parameters
    ----------
    A, b, c
        Of one input and one output, shapes (m, m), (m, 1) and (1, m).
    low, high
        Limits of the ratios to return.

    Raises
    ------
    UnsupportedLaw
        For more than one input.
    """
    from scipy.linalg import eigvals

    m, n = len(A), b.shape[1]
    if n != 1:
        raise UnsupportedLaw(
            "stable intervals: the gains couple the joints of this law; use scalar natural frequencies and damping "
            "ratios, or diagonal ones with a gain of zero"
        )
    identity, zero = np.eye(m), np.zeros((m, m))
    left = np.block([[identity, zero, 0 * b], [zero, -A, -b], [0 * c, 0 * c, np.zeros((1, 1))]])
    right = np.block([[A, zero, b], [zero, -identity, 0 * b], [c, -c, np.zeros((1, 1))]])
    z = np.asarray(eigvals(right, left))
    ratios = []
    for angle in np.abs(np.angle(z[np.isfinite(z) & (np.abs(np.abs(z) - 1) < 1e-2) & (np.imag(z) >= -1e-9)])):
        try:
            response = _real_response(A, b, c, float(angle))
        except np.linalg.LinAlgError:  # on a pole of the open loop, where the ratio is zero
            continue
        # one too many does no harm, because every range between two is tested; one too few does
        if response.real > 0 and abs(response.imag) < 0.1 * abs(response):
            ratios.append(float(1 / response.real))
    unique: list[float] = []
    for ratio in sorted(ratios):
        if low < ratio < high and (not unique or ratio > unique[-1] * (1 + 1e-7)):
            unique.append(ratio)
    return unique


def _real_response(A: Array, b: Array, c: Array, angle: float) -> complex:
    """Return G(e^{jω}) where it is real, by Newton's method on its imaginary part from an angle nearby."""
    response = 0j
    for _ in range(8):
        z = np.exp(1j * angle)
        inner = np.linalg.solve(z * np.eye(len(A)) - A, b)
        response = complex((c @ inner).item())
        slope = (-1j * z * (c @ np.linalg.solve(z * np.eye(len(A)) - A, inner)).item()).imag
        move = -response.imag / slope if slope else 0.0
        if abs(response.imag) < 1e-12 * abs(response) or abs(move) > 0.1 * angle:
            break
        angle += move
    return response


def open_loop_matrices(channel: Channel) -> tuple[Array, Array, Array]:
    """Return A, b, c with the closed loop A + ρ b c."""
    return channel.closed_loop(0.0)[:3]


def spectral_radius(channels: Sequence[Channel], ratio: float) -> float:
    """Return the largest magnitude of an eigenvalue of the loops closed at a ratio."""
    return max(float(np.max(np.abs(np.linalg.eigvals(channel.state_matrix(ratio))))) for channel in channels)


def delay_margin(channel: Channel, ratio: float) -> int:
    """Return how many further periods of delay leave the loop stable, at most `MAX_DELAY_PERIODS`.

    A pole reaches the circle at a delay d with e^{−jωd} L(e^{jω}) = 1, where |L| = 1 and L leads from v back to v. That
    guess, from a grid, is kept if the eigenvalues agree on both its sides. Else every delay is tried in turn.
    """

    def is_stable(periods: int) -> bool:
        return spectral_radius([channel.with_delay(periods)], ratio) < 1

    if channel.n_coupled == 1:
        guess = _delay_margin_guess(channel, ratio)
        for periods in (guess, guess + 1, guess - 1):
            if 0 <= periods < MAX_DELAY_PERIODS and is_stable(periods) and not is_stable(periods + 1):
                return periods
    return next((periods for periods in range(MAX_DELAY_PERIODS) if not is_stable(periods + 1)), MAX_DELAY_PERIODS)


def _delay_margin_guess(channel: Channel, ratio: float) -> int:
    """Return the least delay at which a pole reaches the circle, interpolated on a grid of angles."""
    A, b, c = open_loop_matrices(channel)
    angles = np.geomspace(1e-4, np.pi, 50)
    z = np.exp(1j * angles)[:, None, None]
    L = (ratio * c @ np.linalg.solve(z * np.eye(len(A)) - A, b + 0 * z))[:, 0, 0]
    log_gain, phase = np.log(np.abs(L)), np.angle(L) % (2 * np.pi)
    k = np.flatnonzero(log_gain[:-1] * log_gain[1:] < 0)
    fraction = log_gain[k] / (log_gain[k] - log_gain[k + 1])
    step = (phase[k + 1] - phase[k] + np.pi) % (2 * np.pi) - np.pi
    delays = (phase[k] + fraction * step) % (2 * np.pi) / (angles[k] + fraction * (angles[k + 1] - angles[k]))
    return int(np.min(delays, initial=MAX_DELAY_PERIODS))


def disturbance_to_error(channel: Channel, ratio: float) -> tuple[Array, Array, Array, Array]:
    """Return A, B, C, D from an acceleration, held like the torque, to the position."""
    A, B, C, _, _ = channel.closed_loop(ratio)
    return A, B, np.eye(*C.shape), np.zeros_like(channel.D)


def noise_to_torque(channel: Channel, ratio: float) -> tuple[Array, Array, Array, Array]:
    """Return A, B, C, D from an error of the measured position to M̂⁻¹τ."""
    A, B, C, _, _ = channel.closed_loop(ratio)
    B_noise = ratio * B @ channel.D
    B_noise[2 * channel.n_coupled :] += channel.G
    return A, B_noise, C, channel.D
