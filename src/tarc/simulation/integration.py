"""Steps per period that integrate a plant under zero-order hold to a stated error."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tarc.core.types import Array
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.sensors import Encoder
from tarc.simulation.closed_loop import INTEGRATORS
from tarc.simulation.record import Record

RESOLVED_SHARE = 0.02
"""Largest error of a period, by the smallest step of the encoder."""

MAX_ERROR = 1e-9
"""Largest error of a period [rad or m] where the sensor is not quantised."""

MAX_SUBSTEPS = 64

DIVERGED_SUBSTEPS = 8
"""Runge–Kutta steps per period from which a run that diverges is not refined."""

REFINEMENT = 4
"""Ratio of the number of steps of the reference solution to those that it judges."""

N_STATES = 64
"""States of a run at which the error is estimated."""


@dataclass(frozen=True)
class Integration:
    """How a plant is integrated over a period: the method, and its equal steps."""

    integrator: str
    substeps: int


def max_error(sensor: Encoder) -> float:
    """Return the largest error of a period [rad or m] that a sensor hardly resolves."""
    steps = sensor.step_size[sensor.step_size > 0]
    return RESOLVED_SHARE * float(np.min(steps)) if steps.size else MAX_ERROR


def integration_error(
    plant: SymbolicPlant, record: Record, disturbance: Array, period: float, integration: Integration
) -> float:
    """Return the largest error that one period adds [rad or m], at states of a run.

        max over the states of |q − q*| + T |q̇ − q̇*|

    with the state (q*, q̇*) after a period by four times as many Runge–Kutta steps.

    Parameters
    ----------
    plant
        The robot with its own parameters; those of a schedule are left out.
    record
        The run: position, velocity and torque at each sample.
    disturbance
        Torque [N m or N] added in each period, shape (n, periods).
    period
        T [s].
    integration
        What is judged.
    """
    q, dq = _motion(plant, record, "position"), _motion(plant, record, "velocity")
    torque = record.arrays["torque"].T
    torque = plant.joint_input(torque, disturbance[:, : q.shape[1]])
    chosen = np.unique(np.linspace(0, q.shape[1] - 1, N_STATES).astype(int))
    is_finite = np.all(np.isfinite(np.vstack([q, dq, torque])[:, chosen]), axis=0)
    if not np.any(is_finite):
        return float("nan")
    q, dq, torque = (array[:, chosen[is_finite]] for array in (q, dq, torque))
    end, end_velocity = _hold(plant, q, dq, torque, period, integration)
    finer = Integration("Runge–Kutta", REFINEMENT * integration.substeps)
    true_end, true_velocity = _hold(plant, q, dq, torque, period, finer)
    return float(np.max(np.abs(end - true_end) + period * np.abs(end_velocity - true_velocity)))


def _motion(plant: SymbolicPlant, record: Record, name: str) -> Array:
    """Return the position or velocity of all coordinates (m, k) of a run."""
    if plant.is_fully_driven:
        return record.arrays[name].T
    values = np.zeros((plant.n_coordinates, len(record.arrays[name])))
    values[list(plant.measured)] = record.arrays[name].T
    if plant.unmeasured:
        values[list(plant.unmeasured)] = record.arrays[f"passive_{name}"].T
    return values


def _hold(
    plant: SymbolicPlant, q: Array, dq: Array, torque: Array, period: float, integration: Integration
) -> tuple[Array, Array]:
    """Integrate columns of states (m, k) over one period with the torque held."""
    for _ in range(integration.substeps):
        step = INTEGRATORS[integration.integrator]
        q, dq, _ = step(plant, q, dq, torque, period / integration.substeps)
    return q, dq


def choose_integration(trial: Callable[[Integration], tuple[float, bool]], tolerance: float) -> Integration:
    """Return the cheapest method and steps whose error is small enough, or `MAX_SUBSTEPS` where none is.

    A run that diverges with `DIVERGED_SUBSTEPS` diverges with more, and at its speeds none is accurate.

    Parameters
    ----------
    trial
        Error [rad or m] of a run, and whether the run diverged.
    tolerance
        Largest error [rad or m].
    """
    chosen = Integration("midpoint", 1)
    if trial(chosen)[0] <= tolerance:
        return chosen
    chosen = Integration("Runge–Kutta", 1)
    while True:
        error, diverged = trial(chosen)
        most = DIVERGED_SUBSTEPS if diverged else MAX_SUBSTEPS
        if error <= tolerance or chosen.substeps >= most:
            return chosen
        factor = (error / tolerance) ** 0.25 if np.isfinite(error) else MAX_SUBSTEPS
        chosen = replace(chosen, substeps=int(min(np.ceil(chosen.substeps * max(factor, 1.1)), most)))
