"""The motion on which a design is tried: slow sines that stay in range and within the torque limits."""

from collections.abc import Sequence

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.plants.base import Plant
from tarc.signals.references import Sinusoid

DURATION = 10.0
"""Duration of the scenario [s]."""
MAX_AMPLITUDE = 0.4
"""Largest amplitude of the sines [rad or m]."""
BASE_FREQUENCY = 1.5
"""Frequency of the first joint's sine [rad/s]; each further joint adds a fifth of it."""
MAX_SPEED_SHARE = 0.8
"""Largest speed and acceleration of the sines, over those that the workspace allows."""
MAX_GRAVITY_SHARE = 0.7
"""Largest gravity torque along the sines, over the torque limit; the amplitudes are reduced until it is met."""
NOISE_PEAK = 4.0
"""Torque that gravity leaves to the noise, over its RMS."""
N_POSTURES = 500
"""Number of postures among which one is looked for where gravity leaves torque."""


def slow_sines(law: TDC | TARC, plants: Sequence[Plant], workspace: Workspace, torque_noise: np.ndarray) -> Sinusoid:
    """Return sines about the home posture that begin at rest.

    The amplitudes are at most a quarter of the workspace's width, and smaller where gravity alone would take most of
    the torque. Where it does so in the home posture itself, the sines are about the closest of `N_POSTURES` sampled
    postures where it does not. The frequencies keep each joint below its largest speed and acceleration.
    """
    limits = np.minimum(MAX_GRAVITY_SHARE * law.torque_limits, law.torque_limits - NOISE_PEAK * torque_noise)
    home = np.clip(plants[0].home, workspace.low, workspace.high)
    for middle in (home, _light_posture(plants[-1], workspace, home, limits)):
        for share in (1.0, 0.5, 0.25, 0.1):
            sines = _sines_about(middle, share, workspace)
            postures = sines.sample(np.linspace(0, DURATION, 100))[0].T
            if np.all(_gravity_shares(plants[-1], postures, limits) <= 1):
                return sines
    return sines


def _sines_about(middle: np.ndarray, share: float, workspace: Workspace) -> Sinusoid:
    """Return sines about a posture with a share of their largest amplitude, in numbers of four decimals."""
    low, high = workspace.low, workspace.high
    amplitude = share * np.minimum(MAX_AMPLITUDE, (high - low) / 4)
    offset = np.clip(np.clip(middle, low + amplitude, high - amplitude).round(4), low, high)
    room = np.minimum(offset - low, high - offset)
    amplitude = np.floor(1e4 * np.minimum(amplitude, room) + 1e-6) / 1e4
    frequency = BASE_FREQUENCY * (1 + 0.2 * np.arange(len(middle)))
    if workspace.speed is not None and workspace.acceleration is not None:
        width = np.maximum(amplitude, 1e-9)
        fastest = np.minimum(workspace.speed / width, (workspace.acceleration / width) ** 0.5)
        frequency = np.minimum(frequency, MAX_SPEED_SHARE * fastest)
    return Sinusoid(amplitude=amplitude, frequency=frequency.round(3), phase=np.pi / 2, offset=offset)


def _light_posture(plant: Plant, workspace: Workspace, home: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the sampled posture closest to home where gravity needs half of the limits, or that with the least."""
    postures = workspace.sample(N_POSTURES)
    shares = _gravity_shares(plant, postures, limits)
    distances = np.linalg.norm(postures - home, axis=1)
    return postures[np.argmin(np.where(shares <= max(0.5, shares.min()), distances, np.inf))]


def _gravity_shares(plant: Plant, postures: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the largest gravity torque over its limit at each posture (k, n), shape (k,)."""
    torques = np.array([np.abs(np.asarray(plant.gravity_torque(posture))) for posture in postures])
    return np.max(torques / np.maximum(limits, 1e-9), axis=1)
