"""Measures of a run, from its signals as arrays."""

from collections.abc import Mapping, Sequence

import numpy as np

from tarc.core.types import Array
from tarc.simulation.quantities import JOINT_KINDS, MEASURES

SIGNALS = ("position", "reference", "torque", "tde_error", "gain", "sliding")
"""Signals from which measures are computed; a law may lack the last three."""


def compute_measures(
    signals: Mapping[str, Array],
    period: float,
    torque_limits: Array,
    joint_units: Sequence[str],
    *,
    has_rate_limit: bool = False,
    frequency: float = 50.0,
    n_averaged: int = 1,
) -> dict[str, float]:
    """Return the measures of `Run.metrics` by name.

    Parameters
    ----------
    signals
        `SIGNALS` by name, each (k,) or (k, n) for k ≥ 2 samples.
    period
        Control period [s].
    torque_limits
        Largest torque that is applied [N m or N], (n,).
    joint_units
        Unit of each joint, ``rad`` or ``m``.
    has_rate_limit
        Whether the rate of the torque is limited.
    frequency
        Frequency above which torque counts as high-frequency [Hz].
    n_averaged
        Samples of the moving average of gain and ‖s‖.
    """
    measures = {"saturated": saturated_share(signals["torque"], torque_limits)}
    units = np.array(joint_units)
    kinds = list(dict.fromkeys(joint_units))
    for unit in kinds:
        suffix = f"_{JOINT_KINDS[unit]}" if len(kinds) > 1 else ""
        joints = np.flatnonzero(units == unit)
        chosen = {name: signals[name][:, joints] for name in SIGNALS[:4] if name in signals}
        summed = _summed_measures(chosen, period, frequency, has_rate_limit)
        measures |= {f"{name}{suffix}": value for name, value in summed.items()}
    if "gain" in signals:
        measures |= _gain_measures(signals["gain"], signals.get("sliding"), n_averaged)
    return {name: measures[name] for name in MEASURES if name in measures}


def saturated_share(torque: Array, torque_limits: Array) -> float:
    """Return the share of the samples, over all joints, in which the torque is at its limit."""
    return float(np.mean(np.abs(torque) >= torque_limits * (1 - 1e-12)))


def _gain_measures(gain: Array, sliding: Array | None, n_averaged: int) -> dict[str, float]:
    """Compute mean and peak of the gain, and the shares of over- and underestimation."""
    measures = {"mean_gain": float(np.mean(gain)), "peak_gain": float(np.max(gain))}
    if sliding is not None:
        # a moving average over m samples changes by 1/m of the difference between samples that are m periods apart
        sliding_change = sliding[n_averaged:] - sliding[:-n_averaged]
        gain_change = gain[n_averaged:] - gain[:-n_averaged]
        measures["overestimation"] = float(np.mean((gain_change > 0) & (sliding_change < 0)))
        measures["underestimation"] = float(np.mean((gain_change < 0) & (sliding_change > 0)))
    return measures


def _summed_measures(
    signals: Mapping[str, Array], period: float, frequency: float, has_rate_limit: bool
) -> dict[str, float]:
    """Return the measures that join all joints of the signals, which have the same unit."""
    error = signals["position"] - signals["reference"]
    torque = signals["torque"]
    measures = {
        "rms_error": float(np.sqrt(np.mean(error**2))),
        "peak_error": float(np.max(np.abs(error))),
        "torque_variation": float(np.sum(np.abs(np.diff(torque, axis=0))) / (period * (len(torque) - 1))),
        "high_frequency_share": _energy_share_above(torque, period, frequency),
        "peak_torque": float(np.max(np.abs(torque))),
    }
    if has_rate_limit:
        measures["peak_torque_rate"] = float(np.max(np.abs(np.diff(torque, axis=0)))) / period
    if "tde_error" in signals:
        tde_error = signals["tde_error"]
        tde_error = tde_error[~np.isnan(tde_error)]
        measures["rms_tde_error"] = float(np.sqrt(np.mean(tde_error**2))) if tde_error.size else np.nan
    return measures


def _energy_share_above(torque: Array, period: float, frequency: float) -> float:
    """Return the share of the torque's energy about its mean that lies above a frequency [Hz]."""
    spectrum = np.abs(np.fft.rfft(torque - torque.mean(axis=0), axis=0)) ** 2
    spectrum[1 : (len(torque) + 1) // 2] *= 2  # positive and negative frequencies; the Nyquist frequency occurs once
    is_high = np.fft.rfftfreq(len(torque), period) > frequency
    total = spectrum.sum()
    return float(spectrum[is_high].sum() / total) if total > 0 else 0.0
