"""Stability of the linearised loop over the inertia ratio: stable intervals, crossings, delay margin."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.laws.base import Law


@dataclass(frozen=True, kw_only=True, eq=False)
class Witness:
    """What shows a refutation; one subclass for each kind of it."""


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
CIRCLE_TOLERANCE = 1e-9
"""Distance from the unit circle within which an eigenvalue counts as on it."""


def stable_intervals(law: Law, *, computation_delay: int = 0, gain: float = 0.0) -> list[tuple[float, float]]:
    """All ranges of the inertia ratio in which the loop is stable, from the lowest up.

    The ends are the ratios at which an eigenvalue lies on the unit circle. They are found all at once, as eigenvalues
    of a matrix pencil, and not on a grid; for that the gains must not couple the joints.
    """
    channels = decoupled_channels(law, computation_delay, gain)
    edges = {0.0, *(edge for channel in channels for edge in crossings(*open_loop_matrices(channel)))}
    edges = sorted(edges | set(_missed_crossings(channels, edges)))
    bounds = [*edges, edges[-1] * 2 + 1.0]
    found: list[tuple[float, float]] = []
    for low, high in pairwise(bounds):
        if spectral_radius(channels, (low + high) / 2) < 1 - CIRCLE_TOLERANCE:
            end = np.inf if high == bounds[-1] else high
            joined = found and found[-1][1] == low
            found[-1:] = [(found[-1][0], end)] if joined else [*found[-1:], (low, end)]
    return found


def _missed_crossings(channels: list[Channel], edges: set[float]) -> list[float]:
    """Ratios at which the loop gains or loses stability with no edge between: what rounding hid from the pencil."""
    from scipy.optimize import brentq

    trials = np.unique([*np.geomspace(1e-4, 30.0, 25), *((one + two) / 2 for one, two in pairwise(sorted(edges)))])
    radii = [spectral_radius(channels, float(trial)) - 1 for trial in trials]
    found = []
    for (one, before), (two, after) in pairwise(zip(trials, radii, strict=True)):
        if before * after < 0 and not any(one <= edge <= two for edge in edges):
            edge: Any = brentq(lambda ratio: spectral_radius(channels, ratio) - 1, float(one), float(two))
            found.append(float(edge))
    return found


def stable_interval(law: Law, *, computation_delay: int = 0, gain: float = 0.0) -> tuple[float, float]:
    """The range of the inertia ratio, of the widest ratio of its ends, in which the loop is stable.

    Raises
    ------
    TarcError
        When there is none.
    """
    found = stable_intervals(law, computation_delay=computation_delay, gain=gain)
    if not found:
        raise TarcError(
            "stable_interval: no inertia ratio makes this loop stable; use a shorter window, a lower natural "
            "frequency or less "
            "computation delay"
        )
    return max(found, key=lambda ends: ends[1] / max(ends[0], 1e-300))


def crossings(A: np.ndarray, b: np.ndarray, c: np.ndarray, low: float = 1e-9, high: float = 1e6) -> list[float]:
    """All ratios ρ between low and high for which A + ρ b c has an eigenvalue on the unit circle, in order.

    With G(z) = c (zI − A)⁻¹ b real on the circle, G(z) = G(1/z), whose zeros are eigenvalues of a pencil; then
    ρ = 1/G(z).
    """
    from scipy.linalg import eigvals

    m, n = len(A), b.shape[1]
    if n != 1:
        raise TarcError(
            "stable intervals: the gains couple the joints of this law; use stiffness and viscosity that are scalar, "
            "or with the gain at zero diagonal"
        )
    eye, none = np.eye(m), np.zeros((m, m))
    left = np.block([[eye, none, 0 * b], [none, -A, -b], [0 * c, 0 * c, np.zeros((1, 1))]])
    right = np.block([[A, none, b], [none, -eye, 0 * b], [c, -c, np.zeros((1, 1))]])
    z = np.asarray(eigvals(right, left))
    ratios = []
    for angle in np.abs(np.angle(z[np.isfinite(z) & (np.abs(np.abs(z) - 1) < 1e-2) & (np.imag(z) >= -1e-9)])):
        try:
            response = _real_response(A, b, c, float(angle))
        except np.linalg.LinAlgError:  # on a pole of the open loop, where the ratio is zero
            continue
        # one too many does no harm, for every range between two is tested; one too few does
        if response.real > 0 and abs(response.imag) < 0.1 * abs(response):
            ratios.append(float(1 / response.real))
    unique: list[float] = []
    for ratio in sorted(ratios):
        if low < ratio < high and (not unique or ratio > unique[-1] * (1 + 1e-7)):
            unique.append(ratio)
    return unique


def _real_response(A: np.ndarray, b: np.ndarray, c: np.ndarray, angle: float) -> complex:
    """G(e^{jω}) where it is real, by Newton's method on its imaginary part from an angle nearby."""
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


def open_loop_matrices(channel: Channel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, b, c with the closed loop A + ρ b c."""
    return channel.closed_loop(0.0)[:3]


def spectral_radius(channels: list[Channel], ratio: float) -> float:
    """Return the largest magnitude of an eigenvalue of the loops closed at a ratio."""
    return max(float(np.max(np.abs(np.linalg.eigvals(channel.state_matrix(ratio))))) for channel in channels)


def delay_margin(channel: Channel, ratio: float) -> int:
    """How many periods later v may come before the loop is unstable, up to `LONGEST_DELAY`.

    The delay d at which a pole reaches the circle solves e^{−jωd} L(e^{jω}) = 1 where |L| = 1, L from v back to v. That
    guess, from a grid, is kept if the eigenvalues agree on both its sides; else every delay is tried in turn.
    """

    def stable(periods: int) -> bool:
        return spectral_radius([channel.with_delay(periods)], ratio) < 1

    if channel.n_coupled == 1:
        A, b, c = open_loop_matrices(channel)
        angles = np.geomspace(1e-4, np.pi, 50)
        z = np.exp(1j * angles)[:, None, None]
        L = (ratio * c @ np.linalg.solve(z * np.eye(len(A)) - A, b + 0 * z))[:, 0, 0]
        size, turn = np.log(np.abs(L)), np.angle(L) % (2 * np.pi)
        k = np.flatnonzero(size[:-1] * size[1:] < 0)
        share = size[k] / (size[k] - size[k + 1])
        step = (turn[k + 1] - turn[k] + np.pi) % (2 * np.pi) - np.pi
        delays = (turn[k] + share * step) % (2 * np.pi) / (angles[k] + share * (angles[k + 1] - angles[k]))
        guess = int(np.min(delays, initial=MAX_DELAY_PERIODS))
        for d in (guess, guess + 1, guess - 1):
            if 0 <= d < MAX_DELAY_PERIODS and stable(d) and not stable(d + 1):
                return d
    return next((d for d in range(MAX_DELAY_PERIODS) if not stable(d + 1)), MAX_DELAY_PERIODS)


def disturbance_to_error(channel: Channel, ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """From an acceleration, held like the torque, to the position."""
    A, B, C, _, _ = channel.closed_loop(ratio)
    return A, B, np.eye(*C.shape), np.zeros_like(channel.D)


def noise_to_torque(channel: Channel, ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """From an error of the measured position to M̂⁻¹τ."""
    A, B, C, _, _ = channel.closed_loop(ratio)
    into = ratio * B @ channel.D
    into[2 * channel.n_coupled :] += channel.G
    return A, into, C, channel.D
