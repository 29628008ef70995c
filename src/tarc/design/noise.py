"""Noise of the measured position, and the torque noise that it causes."""

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.signals.sensors import Encoder


def measurement_deviation(sensor: Encoder, n_joints: int) -> np.ndarray:
    """Return the standard deviation σ of the measured position [rad or m], shape (n,).

        σ² = σ_noise² + step²/12

    The second term is that of rounding to the nearest step.

    Raises
    ------
    InvalidParameter
        For an encoder whose resolution has not one number per joint.
    """
    if sensor.step_size.size not in (1, n_joints):
        raise InvalidParameter(
            f"sensor: its resolution has {sensor.step_size.size} numbers; needs one, or {n_joints}, one per joint"
        )
    sigma = np.sqrt(np.asarray(sensor.noise) ** 2 + np.asarray(sensor.step_size) ** 2 / 12)
    return np.broadcast_to(sigma, (n_joints,))


def torque_noise(noise_gain: float, shape: np.ndarray, sensor: Encoder) -> np.ndarray:
    """Return the RMS torque noise of each joint [N m or N], shape (n,).

    Parameters
    ----------
    noise_gain
        Torque over X for white measurement noise [1/s²], as in `tarc.design.Candidate`.
    shape
        X [kg m² or kg], shape (n, n).
    sensor
        The encoder of every joint.
    """
    sigma = measurement_deviation(sensor, len(shape))
    return noise_gain * np.linalg.norm(shape * sigma, axis=1)
