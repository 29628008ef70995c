"""The same law in units of another sampling period."""

import copy
from dataclasses import MISSING, fields
from typing import Any

import tarc.laws
from tarc.core import validation as check

COMMON: dict[str, float] = {
    "natural_frequency": 1,
    "max_gain": 2,
    "min_gain": 2,
    "initial_gain": 2,
    "integral_gain": 1,
    "delay": -1,
    "window": -1,
}
"""Power of 1/time in the unit of each gain, which laws share."""

OWN: dict[str, dict[str, float]] = {
    "TARC": {"rise_rate": 3, "fall_rate": 3},
    "IVF": {"ideal_velocity_gain": 1, "max_correction": 2},
    "TDCIM": {"time_constant": -1},
    "TerminalSliding": {"max_gain": 1},
    "NonsingularTerminal": {"velocity_scale": 1, "boundary_layer": 1},
    "SlidingMode": {"gain": 2, "boundary_layer": 1, "surface_slope": 1},
    "ASMC": {"adaptation_rate": 3, "threshold": 1, "boundary_layer": 1, "surface_slope": 1},
    "MonotoneASMC": {"adaptation_rate": 2, "dead_zone": 1, "boundary_layer": 1, "surface_slope": 1},
    "ADRC": {"observer_bandwidth": 1},
    "SuperTwisting": {"disturbance_rate": 3, "boundary_layer": 1},
    "CorlessLeitmann": {"uncertainty_bound": 2},
    "AdaptiveFuzzy": {"adaptation_rate": 3, "max_consequent": 2, "velocity_span": 1},
    "ProjectionARC": {"adaptation_gain": -2, "boundary_layer": 1},
}
"""The same of the gains of single laws."""

ESTIMATOR: dict[str, float] = {"window": -1, "cutoff": 1, "jerk": 2.5, "lipschitz": 3}
"""The same of the estimators. The jerk is that of a random walk of the acceleration, per root of the time."""


def with_period(law: dict[str, Any], own: float, period: float) -> dict[str, Any]:
    """Return a law as a scenario writes it, with its gains in units of another period.

        value / ratio^p,    ratio = period / own,    p the power of 1/time in the unit of the value

    In the time t/ratio, on a robot whose motion takes that much longer, it does the same step by step. Positions,
    shares of the inertia and physical parameters stay as they are.

    Parameters
    ----------
    law
        Kind, gains and estimator.
    own, period
        The period [s] to which the gains belong, and that of the result.
    """
    ratio = check.number("period", period, 0, strict=True) / own
    part = copy.deepcopy(law)
    if abs(ratio - 1) < 1e-9:
        return part
    powers: dict[str, float] = COMMON | OWN.get(part["kind"], {})
    if part["kind"] == "NonsingularTerminal":
        powers["reaching_gain"] = 2 - part["reaching_exponent"]  # rad/s² per (rad/s)^ρ
    defaults = {field.name: field.default for field in fields(getattr(tarc.laws, part["kind"]))}
    for key, power in powers.items():
        value = part.get(key, defaults.get(key))
        if isinstance(value, int | float) and value is not MISSING:
            part[key] = _scaled(key, value, ratio, power, period)
    estimator = part.get("estimator", {})
    for key, power in ESTIMATOR.items():
        if key in estimator:
            estimator[key] = _scaled(key, estimator[key], ratio, power, period)
    return part


def _scaled(key: str, value: float, ratio: float, power: float, period: float) -> float:
    """Return a value in units of the period; a window and a delay are whole periods."""
    scaled = value / ratio**power
    return round(scaled / period) * period if key in ("window", "delay") else scaled
