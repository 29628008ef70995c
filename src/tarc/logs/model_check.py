"""Recorded torque against a robot's model, and what time-delay estimation would leave of it."""

from dataclasses import dataclass

import numpy as np

from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic
from tarc.estimators.base import synchronous_weights
from tarc.logs.even_record import EvenRecord
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant

POSTURES_OF_MEAN = 50
"""Number of postures of the mean inertia along a record."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelCheck:
    """Torque of a model along a record.

    Attributes
    ----------
    torque
        M(q) q̈ + N(q, q̇) on the smooth motion [N m or N], shape (k, n).
    explained
        1 − var(τ − τ_model) / var(τ), shape (n,). It is negative for a model that is worse than a constant.
    residual
        Standard deviation of τ − τ_model [N m or N], shape (n,).
    offset
        Mean of τ − τ_model [N m or N], shape (n,).
    deviation
        Standard deviation of the recorded torque [N m or N], shape (n,).
    """

    torque: Array
    explained: Array
    residual: Array
    offset: Array
    deviation: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class DelayEstimationCheck:
    """What time-delay estimation leaves over of N = τ − M̂ q̈, over the standard deviation of the torque.

    Attributes
    ----------
    inertia
        M̂ [kg m² or kg], shape (n, n).
    window
        ς of its acceleration [s].
    synchronised, literal
        Of N with the smooth torque, shape (n,).
    synchronised_raw, literal_raw
        Of N with the recorded torque, whose own noise no estimate can know, shape (n,).
    """

    inertia: Array
    window: float
    synchronised: Array
    literal: Array
    synchronised_raw: Array
    literal_raw: Array


def check_model(record: EvenRecord, plant: Plant, cutoff: float) -> ModelCheck | None:
    """Compare the recorded torque with that of a robot's model; None without recorded torque."""
    if record.torque is None:
        return None
    motion = (record.motion(record.times, order) for order in range(3))
    model = model_torque(plant, *motion)
    inner = record.inner(1 / cutoff)
    residual = (record.torque - model)[inner]
    deviation = np.std(record.torque[inner], axis=0)
    return ModelCheck(
        torque=model,
        explained=1 - np.var(residual, axis=0) / np.maximum(deviation**2, 1e-300),
        residual=np.std(residual, axis=0),
        offset=np.mean(residual, axis=0),
        deviation=deviation,
    )


def model_torque(plant: Plant, position: Array, velocity: Array, acceleration: Array) -> Array:
    """Return M(q) q̈ + N(q, q̇) with dry friction [N m or N], all of shape (k, n)."""
    if isinstance(plant, SymbolicPlant):
        M = plant.inertia_matrices(position.T)
        N = np.asarray(plant.evaluate("bias", position.T, velocity.T)).reshape(position.shape[::-1]).T
    else:
        M = np.array([plant.inertia(posture) for posture in position])
        N = np.array([plant.bias(*motion) for motion in zip(position, velocity, strict=True)])
    return np.einsum("kij,kj->ki", M, acceleration) + N


def mean_inertia(record: EvenRecord, plant: Plant) -> Array:
    """Return the diagonal of the mean of M(q) along a record, shape (n, n)."""
    rows = np.linspace(0, len(record.times) - 1, POSTURES_OF_MEAN).astype(int)
    return np.diag(np.diag(plant.mean_inertia(record.position[rows].T)))


def check_delay_estimation(
    record: EvenRecord, inertia: Array, window: float, cutoff: float
) -> DelayEstimationCheck | None:
    """Estimate N̂ = τ_h − M̂ â_h along a record, and return what is left of N; None without recorded torque.

    Literal estimation takes the torque of the period before and the acceleration estimate there. Synchronised
    estimation averages the past torques with the weights that match the window.
    """
    if record.torque is None:
        return None
    estimator = Algebraic(window=window).with_period(record.period)
    weights = estimator.weights(2)
    filters = synchronous_weights(weights, record.period)
    inner = record.inner(max(10 / cutoff, 2 * window))
    torque = record.torque
    acceleration = np.column_stack([np.convolve(column, weights)[: len(column)] for column in record.position.T])
    averaged = np.column_stack([np.convolve(column, filters)[: len(column)] for column in torque.T])
    synchronised = _before(averaged) - acceleration @ inertia
    literal = _before(torque) - _before(acceleration) @ inertia
    true = record.motion(record.times, 2) @ inertia
    smooth = record.smooth(torque, cutoff)(record.times)
    deviation = np.maximum(np.std(torque[inner], axis=0), 1e-300)

    def left(applied: Array, estimate: Array) -> Array:
        return np.std((applied - true - estimate)[inner], axis=0) / deviation

    return DelayEstimationCheck(
        inertia=inertia,
        window=window,
        synchronised=left(smooth, synchronised),
        literal=left(smooth, literal),
        synchronised_raw=left(torque, synchronised),
        literal_raw=left(torque, literal),
    )


def _before(values: Array) -> Array:
    """Return values one period later."""
    return np.concatenate([values[:1], values[:-1]])
