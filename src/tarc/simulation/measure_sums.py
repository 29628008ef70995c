"""Measures of a run from sums that grow while it goes on, as `Run.metrics` has them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tarc.core import array_ops as ops
from tarc.core.types import Array, Vector
from tarc.simulation.closed_loop import ClosedLoop, LoopInput, LoopOutput
from tarc.simulation.quantities import JOINT_KINDS, MEASURES

FREQUENCY = 50.0
"""Frequency above which torque counts as high-frequency [Hz], the default of `Run.metrics`."""

AT_LIMIT = 1 - 1e-12
"""Share of its limit from which a torque is at it."""

Sums = dict[str, Vector]
"""Sums, peaks and values of the period before, by name; all zero before the first measured sample."""


class MeasureSums:
    """What a run adds up in each period, and the measures that follow.

    The spectrum of the torque needs all samples; its share above `FREQUENCY` comes from the recorded torque.

    Parameters
    ----------
    loop
        The loop, with numbers.
    example
        Its output, with numbers, which shows the signals of the law.
    """

    def __init__(self, loop: ClosedLoop, example: LoopOutput):
        plant, controller = loop.plant, loop.controller
        units = plant.units
        kinds = list(dict.fromkeys(units))
        self._joints = {
            f"_{JOINT_KINDS[unit]}" if len(kinds) > 1 else "": [i for i, other in enumerate(units) if other == unit]
            for unit in kinds
        }
        self._n, self.period = plant.n_joints, controller.law.period
        signals, zero = example.controller.signals, np.zeros(self._n)
        self.has_gain = "gain" in signals
        self.has_sliding = self.has_gain and controller.law.sliding(zero, zero) is not None
        self.has_auxiliary = "auxiliary" in signals
        self.has_rate = controller.torque_limits is not None and controller.torque_limits.rate is not None

    @property
    def suffixes(self) -> list[str]:
        """Return the ends of the names of measures over joints: one for each kind of joint where kinds mix."""
        return list(self._joints)

    def start(self) -> Sums:
        """Return all sums at zero."""
        zero = np.zeros(())
        sums: Sums = {"count": zero, "past_torque": np.zeros(self._n), "saturated": zero}
        for suffix in self._joints:
            names = ["error_squares", "peak_error", "torque_changes", "peak_torque"]
            names += ["peak_change"] if self.has_rate else []
            names += ["tde_squares", "tde_count"] if self.has_auxiliary else []
            sums |= {f"{name}{suffix}": zero for name in names}
        if self.has_gain:
            sums |= {"gain": zero, "peak_gain": zero, "past_gain": zero}
        if self.has_sliding:
            sums |= {"past_sliding": zero, "over": zero, "under": zero}
        return sums

    def step(self, sums: Sums, loop: ClosedLoop, value: LoopInput, output: LoopOutput) -> Sums:
        """Add a period."""
        error = output.position - value.reference
        torque = output.controller.torque
        has_past = sums["count"] > 0
        change = ops.abs(torque - sums["past_torque"])
        after = {"count": sums["count"] + 1, "past_torque": torque}
        limits = _torque_limits(loop)
        after["saturated"] = sums["saturated"] + _total(ops.where(ops.abs(torque) >= limits * AT_LIMIT, 1.0, 0.0))
        for suffix, joints in self._joints.items():
            own_error, own_torque, own_change = error[joints], torque[joints], change[joints]

            def add(name: str, more: Vector, suffix: str = suffix) -> None:
                after[f"{name}{suffix}"] = sums[f"{name}{suffix}"] + more

            def rise(name: str, values: Vector, suffix: str = suffix) -> None:
                highest = sums[f"{name}{suffix}"]
                for i in range(values.shape[0]):
                    highest = ops.maximum(highest, values[i])
                after[f"{name}{suffix}"] = highest

            add("error_squares", _total(own_error**2))
            rise("peak_error", ops.abs(own_error))
            add("torque_changes", ops.where_or_zero(has_past, _total(own_change)))
            rise("peak_torque", ops.abs(own_torque))
            if self.has_rate:
                rise("peak_change", ops.where_or_zero(has_past, own_change))
            if self.has_auxiliary:
                signals = output.controller.signals
                tde_error = (output.acceleration - signals["auxiliary"])[joints]
                counts = ops.logical_and(ops.finite(tde_error), ops.logical_not(signals["fault"]))
                add("tde_squares", _total(ops.where_or_zero(counts, tde_error**2)))
                add("tde_count", _total(ops.where(counts, 1.0, 0.0)))
        return self._in_order(after | self._gain_sums(sums, loop, value, output, has_past))

    def _gain_sums(self, sums: Sums, loop: ClosedLoop, value: LoopInput, output: LoopOutput, has_past: Vector) -> Sums:
        """Add the gain of a period, and whether gain and ‖s‖ changed in opposite directions."""
        if not self.has_gain:
            return {}
        gain = output.controller.signals["gain"]
        peak = ops.where(has_past, ops.maximum(sums["peak_gain"], gain), gain)
        after = {"gain": sums["gain"] + gain, "peak_gain": peak, "past_gain": gain}
        if self.has_sliding:
            error = output.position - value.reference
            size = ops.norm(loop.controller.law.sliding(error, output.velocity - value.velocity_reference))
            past_gain, past_size = sums["past_gain"], sums["past_sliding"]
            for name, rises in (
                ("over", (past_gain < gain, size < past_size)),
                ("under", (gain < past_gain, past_size < size)),
            ):
                is_apart = ops.logical_and(has_past, ops.logical_and(*rises))
                after[name] = sums[name] + ops.where(is_apart, 1.0, 0.0)
            after["past_sliding"] = size
        return after

    def _in_order(self, sums: Sums) -> Sums:
        """Return the sums in the order of `start`."""
        return {name: sums[name] for name in self.start()}

    def by_name(self, rows: Array) -> dict[str, Array]:
        """Return packed sums of several runs, (numbers, runs), by name."""
        named, start = {}, 0
        for name, example in self.start().items():
            size = int(np.size(example))
            named[name] = rows[start : start + size] if example.ndim else rows[start]
            start += size
        return named

    def measures(self, sums: Mapping[str, Array], high_frequency_shares: Mapping[str, Array]) -> dict[str, Array]:
        """Return the measures of several runs, from sums (runs,) and shares of the torque's energy by suffix."""
        count, n = sums["count"], self._n
        measures: dict[str, Any] = {"saturated": sums["saturated"] / (count * n)}
        for suffix, joints in self._joints.items():
            own = {name.removesuffix(suffix): value for name, value in sums.items() if name.endswith(suffix)}
            measures[f"rms_error{suffix}"] = np.sqrt(own["error_squares"] / (count * len(joints)))
            measures[f"peak_error{suffix}"] = own["peak_error"]
            measures[f"torque_variation{suffix}"] = own["torque_changes"] / (self.period * (count - 1))
            measures[f"high_frequency_share{suffix}"] = high_frequency_shares[suffix]
            measures[f"peak_torque{suffix}"] = own["peak_torque"]
            if self.has_rate:
                measures[f"peak_torque_rate{suffix}"] = own["peak_change"] / self.period
            if self.has_auxiliary:
                measures[f"rms_tde_error{suffix}"] = np.sqrt(own["tde_squares"] / own["tde_count"])
        if self.has_gain:
            measures |= {"mean_gain": sums["gain"] / count, "peak_gain": sums["peak_gain"]}
        if self.has_sliding:
            measures["overestimation"] = sums["over"] / (count - 1)
            measures["underestimation"] = sums["under"] / (count - 1)
        return {name: np.asarray(measures[name]) for name in MEASURES if name in measures}

    def shares(self, torque: Array) -> dict[str, Array]:
        """Return the share of the torque's energy about its mean above `FREQUENCY`, by suffix, each (runs,).

        Parameters
        ----------
        torque
            Of the measured samples, (runs, n, samples).
        """
        low, total = self._energies(torque)
        shares = {}
        for suffix, joints in self._joints.items():
            energy, high = total[:, joints].sum(axis=1), low[:, joints].sum(axis=1)
            shares[suffix] = np.divide(high, energy, out=np.zeros(len(energy)), where=energy > 0)
        return shares

    def _energies(self, torque: Array) -> tuple[Array, Array]:
        """Return the energy above `FREQUENCY` and all of it, each (runs, n)."""
        n_samples = torque.shape[-1]
        energy = np.abs(np.fft.rfft(torque - torque.mean(axis=-1, keepdims=True), axis=-1)) ** 2
        energy[..., 1 : (n_samples + 1) // 2] *= 2
        is_high = np.fft.rfftfreq(n_samples, self.period) > FREQUENCY
        return energy[..., is_high].sum(axis=-1), energy.sum(axis=-1)


def _total(values: Vector) -> Vector:
    """Return the sum of the elements (n,)."""
    total = values[0]
    for i in range(1, values.shape[0]):
        total = total + values[i]
    return total


def _torque_limits(loop: ClosedLoop) -> Vector:
    """Return the largest torque of each joint, (n,), that law and interface allow."""
    limits, interface = loop.controller.law.torque_limits, loop.controller.torque_limits
    return limits if interface is None else ops.minimum(limits, interface.magnitudes(loop.plant.n_joints))
