"""Warning of a run whose reference or start exceeds the limits of a joint."""

import warnings

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import JointLimitWarning
from tarc.core.types import Array
from tarc.core.units import unit_for_joints
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.simulation.sampled_inputs import InitialConditions, SampledInputs

TOLERANCE = 1e-9
"""Excess over a limit that still counts as within [rad or m, /s, /s²]: rounding."""


def warn_if_beyond_limits(
    plant: Plant,
    inputs: SampledInputs,
    initial: InitialConditions,
    has_stops: bool,
    acceleration_limits: Numbers | None = None,
) -> None:
    """Warn of each joint whose reference, or initial position, exceeds a limit: all of them in one warning.

    Parameters
    ----------
    plant, inputs, initial
        As simulated.
    has_stops
        Whether the simulation contains the stops at the ends of the ranges.
    acceleration_limits
        Largest acceleration and deceleration [rad/s² or m/s²], one number or one per joint; None for the plant's own.

    Raises
    ------
    InvalidParameter
        For acceleration limits that are not above zero.
    """
    texts = _beyond_range(plant, inputs, initial)
    remedies = []
    if texts:
        stops = (
            "MuJoCo simulates the stops, which push the joint back with force"
            if has_stops
            else "The stops at the ends are not simulated in symbols: the run passes them, a real robot would not"
        )
        remedies.append(f"{stops}. Keep the reference and the start within the ranges")
    too_fast = _too_fast(plant, inputs, acceleration_limits)
    if too_fast:
        remedies.append("The run has no limits of velocity and acceleration, a real robot has. Slow the reference down")
    if texts or too_fast:
        warnings.warn(f"{'; '.join(texts + too_fast)}. {'. '.join(remedies)}", JointLimitWarning, stacklevel=3)


def _beyond_range(plant: Plant, inputs: SampledInputs, initial: InitialConditions) -> list[str]:
    """Return a text per joint whose reference, or initial position, leaves its range."""
    positions = inputs.reference[0]
    low, high = plant.position_limits.T[:, :, None]
    excess = np.fmax(low - positions, positions - high)
    start = initial.position[list(plant.measured)]
    initial_excess = np.fmax(low[:, 0] - start, start - high[:, 0])
    texts = []
    for joint, (name, unit) in enumerate(zip(plant.joint_names, plant.units, strict=True)):
        span = f"of joint {name} leaves its range from {low[joint, 0]:.4g} to {high[joint, 0]:.4g} {unit}"
        if np.max(excess[joint]) > TOLERANCE:
            first, worst = int(np.argmax(excess[joint] > TOLERANCE)), int(np.argmax(excess[joint]))
            texts.append(
                f"the reference {span} at {inputs.times[first]:g} s, and is farthest off at {inputs.times[worst]:g} s "
                f"with {positions[joint, worst]:.4g} {unit}"
            )
        if initial_excess[joint] > TOLERANCE and start[joint] != positions[joint, 0]:
            texts.append(f"the initial position {span}: {start[joint]:.4g} {unit} at 0 s")
    return texts


def _too_fast(plant: Plant, inputs: SampledInputs, acceleration_limits: Numbers | None) -> list[str]:
    """Return a text per joint and limit of velocity, acceleration, deceleration or jerk that the reference exceeds.

    A joint decelerates where velocity and acceleration have opposite signs. Jerk is the difference of acceleration from
    one sample to the next, by the time between them.
    """
    times = inputs.times
    _, velocity, acceleration = inputs.reference
    up, down = plant.acceleration_limits, plant.deceleration_limits
    if acceleration_limits is not None:
        up = down = check.vector("acceleration_limits", acceleration_limits, plant.n_joints, 0, strict=True)
    is_slowing = (velocity * acceleration < 0) & (up != down)[:, None]
    texts = _above_limit(plant, times, "velocity", velocity, plant.velocity_limits)
    texts += _above_limit(plant, times, "acceleration", np.where(is_slowing, 0.0, acceleration), up)
    texts += _above_limit(plant, times, "deceleration", np.where(is_slowing, acceleration, 0.0), down)
    if np.any(np.isfinite(plant.jerk_limits)):
        jerk = np.diff(acceleration, axis=1) / np.diff(times)
        texts += _above_limit(plant, times[:-1], "jerk", jerk, plant.jerk_limits)
    return texts


def _above_limit(plant: Plant, times: Array, quantity: str, values: Array, limits: Array) -> list[str]:
    """Return a text per joint whose reference exceeds a limit, for values (n, k) and limits (n,)."""
    suffix = {"velocity": "/s", "acceleration": "/s²", "deceleration": "/s²", "jerk": "/s³"}[quantity]
    sizes = np.abs(values)
    texts = []
    for joint, (name, base) in enumerate(zip(plant.joint_names, plant.units, strict=True)):
        unit = unit_for_joints(f"rad{suffix}", [base])
        is_above = sizes[joint] > limits[joint] + TOLERANCE
        if is_above.any():
            first, worst = int(np.argmax(is_above)), int(np.argmax(sizes[joint]))
            texts.append(
                f"the reference of joint {name} exceeds its {quantity} limit of {limits[joint]:.4g} {unit} at "
                f"{times[first]:g} s, and most at {times[worst]:g} s with {values[joint, worst]:.4g} {unit}"
            )
    return texts
