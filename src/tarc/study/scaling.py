"""The same law in units of another sampling period and another noise."""

import copy
from dataclasses import fields
from typing import Any

import tarc.laws
from tarc.core import validation as check

Powers = dict[str, tuple[float, float]]
"""Powers of 1/time and of the position in the unit of each gain: (2, 1) for rad/s² or m/s²."""

COMMON: Powers = {
    "natural_frequency": (1, 0),
    "integral_gain": (1, 0),
    "gain": (2, 1),
    "max_gain": (2, 1),
    "min_gain": (2, 1),
    "initial_gain": (2, 1),
    "delay": (-1, 0),
    "window": (-1, 0),
}
LAYER: Powers = {"boundary_layer": (1, 1)}
"""A boundary layer of s = ė + λ e."""

OWN: dict[str, Powers] = {
    "TARC": {"rise_rate": (3, 0), "fall_rate": (3, 0), "boundary_layer": (0, 1)},
    "TDARC": {
        "rise_rate": (2, 0),
        "fall_rate": (2, 0),
        "state_rise_rate": (0, -2),
        "state_fall_rate": (0, -2),
        "max_state_gain": (1, 0),
        **LAYER,
    },
    "BarrierTDARC": {
        "position_limit": (0, 1),
        "velocity_limit": (1, 1),
        "barrier_gain": (2, 0),
        "adaptation_rate": (2, 0),
        "state_adaptation_rate": (0, -2),
        "leakage": (1, 0),
        "decay_time": (-1, 0),
        "max_state_gain": (1, 0),
        **LAYER,
    },
    "IVF": {"ideal_velocity_gain": (1, 0), "max_correction": (2, 1)},
    "TDCIM": {"time_constant": (-1, 0)},
    "TerminalSliding": {
        "nonlinear_damping": (0, -1),
        "error_scale": (0, 1),
        "boundary_layer": (0, 1),
        "max_gain": (1, 0),
    },
    "NonsingularTerminal": {"velocity_scale": (1, 1), **LAYER},
    "SlidingMode": {"surface_slope": (1, 0), **LAYER},
    "ASMC": {"adaptation_rate": (3, 1), "threshold": (1, 1), "surface_slope": (1, 0), **LAYER},
    "MonotoneASMC": {"adaptation_rate": (2, 0), "dead_zone": (1, 1), "surface_slope": (1, 0), **LAYER},
    "ADRC": {"observer_bandwidth": (1, 0)},
    "SuperTwisting": {"disturbance_rate": (3, 1), **LAYER},
    "CorlessLeitmann": {"uncertainty_bound": (2, 1), "boundary_layer": (0, 1)},
    "AdaptiveFuzzy": {
        "adaptation_rate": (3, 0),
        "max_consequent": (2, 1),
        "position_span": (0, 1),
        "velocity_span": (1, 1),
    },
    "ProjectionARC": {"adaptation_gain": (-2, -2), **LAYER},
}
"""The powers of the gains of single laws."""

ESTIMATOR: Powers = {
    "window": (-1, 0),
    "cutoff": (1, 0),
    "noise": (0, 1),
    "jerk": (2.5, 1),  # of a random walk of the acceleration, per root of the time
    "lipschitz": (3, 1),
}


def rescale(law: dict[str, Any], own: float, period: float, position: float = 1.0) -> dict[str, Any]:
    """Return a law as a scenario writes it, with its gains in units of another period and position.

        value · position^b / ratio^a,    ratio = period / own,    a and b the powers of 1/time and of the position

    On a robot whose motion takes that much longer and is that much larger it does the same, step by step. Shares of
    the inertia and physical parameters stay as they are.

    Parameters
    ----------
    law
        Kind, gains and estimator.
    own, period
        The period [s] to which the gains belong, and that of the result.
    position
        Ratio of the positions.

    Raises
    ------
    InvalidParameter
        For a period or a ratio that is not above zero.
    """
    ratio = check.number("period", period, 0, strict=True) / own
    check.number("position", position, 0, strict=True)
    part = copy.deepcopy(law)
    if abs(ratio - 1) < 1e-9 and position == 1:
        return part
    powers = COMMON | OWN.get(part["kind"], {})
    if part["kind"] == "NonsingularTerminal":  # rad/s² per (rad/s)^ρ
        exponent = part["reaching_exponent"]
        powers["reaching_gain"] = 2 - exponent, 1 - exponent
    defaults = {field.name: field.default for field in fields(getattr(tarc.laws, part["kind"]))}
    for gains, table, own_values in ((part, powers, defaults), (part.get("estimator", {}), ESTIMATOR, {})):
        for key, (time_power, position_power) in table.items():
            value = gains.get(key, own_values.get(key))
            if isinstance(value, int | float):
                scaled = value * position**position_power / ratio**time_power
                gains[key] = round(scaled / period) * period if key in ("window", "delay") else scaled
    return part
