"""Noise of the measured position, and the torque noise that it causes."""

import numpy as np

from tarc.signals.sensors import Encoder


def measurement_deviation(sensor: Encoder) -> np.ndarray:
    """Return the standard deviation σ of the measured position [rad or m].

        σ² = σ_noise² + step²/12

    The second term is that of rounding to the nearest step. The shape is that of the encoder's step: () or (n,).
    """
    return np.sqrt(np.asarray(sensor.noise) ** 2 + np.asarray(sensor.step_size) ** 2 / 12)


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
    sigma = np.broadcast_to(measurement_deviation(sensor), (len(shape),))
    return noise_gain * np.linalg.norm(shape * sigma, axis=1)
