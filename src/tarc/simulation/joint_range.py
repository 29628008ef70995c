"""Warning of a run whose reference or start leaves the range of a joint."""

import warnings

import numpy as np

from tarc.core.errors import JointRangeWarning
from tarc.plants.base import Plant
from tarc.simulation.sampled_inputs import InitialConditions, SampledInputs

TOLERANCE = 1e-9
"""Excess over a range that still counts as within [rad or m]: rounding."""


def warn_if_beyond_range(plant: Plant, inputs: SampledInputs, initial: InitialConditions, has_stops: bool) -> None:
    """Warn of each joint whose reference or initial position leaves its range.

    Parameters
    ----------
    plant, inputs, initial
        As simulated.
    has_stops
        Whether the simulation contains the stops at the ends of the ranges.
    """
    positions = inputs.reference[0]
    excess = _excess(plant, positions)
    start = initial.position[list(plant.measured)]
    initial_excess = _excess(plant, start[:, None])[:, 0]
    texts = []
    for joint, (name, unit) in enumerate(zip(plant.joint_names, plant.units, strict=True)):
        low, high = plant.position_limits[joint]
        span = f"of joint {name} leaves its range from {low:.4g} to {high:.4g} {unit}"
        if np.max(excess[joint]) > TOLERANCE:
            first, worst = int(np.argmax(excess[joint] > TOLERANCE)), int(np.argmax(excess[joint]))
            texts.append(
                f"the reference {span} at {inputs.times[first]:g} s, and is farthest off at {inputs.times[worst]:g} s "
                f"with {positions[joint, worst]:.4g} {unit}"
            )
        if initial_excess[joint] > TOLERANCE and start[joint] != positions[joint, 0]:
            texts.append(f"the initial position {span}: {start[joint]:.4g} {unit} at 0 s")
    if texts:
        stops = (
            "MuJoCo simulates the stops, which push the joint back with force"
            if has_stops
            else "The stops at the ends are not simulated in symbols: the run passes them, a real robot would not"
        )
        message = f"{'; '.join(texts)}. {stops}. Keep the reference and the start within the ranges"
        warnings.warn(message, JointRangeWarning, stacklevel=3)


def _excess(plant: Plant, positions: np.ndarray) -> np.ndarray:
    """Return how far positions (n, k) lie beyond the range of each joint [rad or m]; at most 0 within."""
    low, high = plant.position_limits.T[:, :, None]
    return np.fmax(low - positions, positions - high)
