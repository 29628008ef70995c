"""What a logged loop shows besides its encoders: torque limits, deadlines, and the range that was certified."""

from dataclasses import dataclass

import numpy as np

from tarc.core.types import Array
from tarc.logs.loop_log import LoopLog

AT_LIMIT = 1e-6
"""Relative distance from a limit at which a torque counts as limited."""
SPEED_SPAN = 5
"""Periods before and after a sample over which its speed is measured."""
SPEED_MARGIN = 1.2
"""Largest speed that `tarc certify` covers, over that of the reference."""
FLAGS = {
    "POSITION": "position",
    "ERROR": "distance from the reference",
    "SPEED": "speed",
    "LOAD": "load at rest",
    "TIMING": "sample timing",
}
"""What the flags of a machine's loop are about."""
NOISE_MARGIN = 4.0
"""Deviations of the noise that a certified limit is widened by."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueUse:
    """How often the torque was limited.

    Attributes
    ----------
    saturated, rate_limited
        Share of the periods at the limit of magnitude, and of rate, shape (n,).
    longest
        Longest time at the limit of magnitude [s], shape (n,).
    peak
        Largest magnitude over its limit, shape (n,); 0 without a limit.
    """

    saturated: Array
    rate_limited: Array
    longest: Array
    peak: Array


@dataclass(frozen=True, kw_only=True)
class LoopTiming:
    """Deadlines of a loop on a machine.

    Attributes
    ----------
    overruns
        Share of the periods that the loop missed.
    lateness
        Median, 99.9 % quantile and maximum of the start of a period after its deadline [s].
    computation_time
        The same of the time from there until the torque was written [s].
    """

    overruns: float
    lateness: tuple[float, float, float]
    computation_time: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Assumption:
    """An assumption of a certificate, held against a log.

    Attributes
    ----------
    name
        What is limited.
    share
        Share of the periods outside.
    first_time
        When it was left first [s]; NaN where it held.
    worst
        Largest value over its limit; NaN where that is not known.
    joint
        Index of the joint that went farthest; None where it concerns all.
    """

    name: str
    share: float
    first_time: float
    worst: float
    joint: int | None

    @property
    def holds(self) -> bool:
        """Return whether it held in every period."""
        return self.share == 0


def torque_use(log: LoopLog) -> TorqueUse:
    """Return how often each joint's torque was at its limits of magnitude and rate."""
    data, n = log.run.data, log.n_joints
    none = np.full(n, np.inf)
    limits = data["torque_limit"].values if "torque_limit" in data else none
    rates = data["torque_rate_limit"].values if "torque_rate_limit" in data else none
    at_limit = np.abs(log.torque) >= limits * (1 - AT_LIMIT)
    steps = np.abs(np.diff(log.torque, axis=0)) >= rates * log.period * (1 - AT_LIMIT)
    longest = [longest_run(column) * log.period for column in at_limit.T]
    return TorqueUse(
        saturated=np.mean(at_limit, axis=0),
        rate_limited=np.mean(steps, axis=0),
        longest=np.array(longest),
        peak=np.max(np.abs(log.torque), axis=0) / limits,
    )


def longest_run(mask: Array) -> int:
    """Return the length of the longest run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def loop_timing(log: LoopLog) -> LoopTiming | None:
    """Return the deadlines of a loop on a machine; None for a simulated run."""
    data = log.run.data
    if "lateness" not in data or "computation_time" not in data:
        return None
    overruns = float(np.mean(data["overrun"].values > 0)) if "overrun" in data else 0.0
    return LoopTiming(
        overruns=overruns,
        lateness=_quantiles(data["lateness"].values),
        computation_time=_quantiles(data["computation_time"].values),
    )


def _quantiles(values: Array) -> tuple[float, float, float]:
    valid = values[np.isfinite(values)]
    if not valid.size:
        return np.nan, np.nan, np.nan
    median, high, largest = np.quantile(valid, [0.5, 0.999, 1.0])
    return float(median), float(high), float(largest)


def check_assumptions(log: LoopLog, noise: Array, tube: float) -> tuple[Assumption, ...]:
    """Hold the range that was certified against a log.

    A loop on a machine has flags of its own, which count. Else the range is that of `tarc certify` by default: a tube
    about the reference, and 1.2 times its largest speed. Both are widened by four deviations of the encoders' noise.

    Parameters
    ----------
    log
        The log.
    noise
        Deviation of the encoders [rad or m], shape (n,).
    tube
        Largest distance from the reference [rad or m].
    """
    flags = _flags(log)
    if flags is not None:
        return flags
    error = np.abs(log.position - log.reference[0])
    span = 2 * SPEED_SPAN
    speed = np.abs(log.position[span:] - log.position[:-span]) / (span * log.period)
    largest = SPEED_MARGIN * np.max(np.abs(log.reference[1]), axis=0)
    speed_noise = NOISE_MARGIN * np.sqrt(2) * noise / (span * log.period)
    return (
        _assumption("distance from the reference", error, tube + NOISE_MARGIN * noise, log.times),
        _assumption("speed", speed, largest + speed_noise, log.times[SPEED_SPAN:]),
    )


def _assumption(name: str, values: Array, limits: Array, times: Array) -> Assumption:
    over = values / limits
    outside = np.any(over > 1, axis=1)
    rows = np.flatnonzero(outside)
    return Assumption(
        name=name,
        share=float(np.mean(outside)),
        first_time=float(times[rows[0]]) if len(rows) else np.nan,
        worst=float(np.max(over)),
        joint=int(np.argmax(np.max(over, axis=0))),
    )


def _flags(log: LoopLog) -> tuple[Assumption, ...] | None:
    """Return the assumptions that a machine's loop watched; None for none."""
    data = log.run.data
    if "assumption_flags" not in data:
        return None
    names = str(data.attrs.get("flag_names", "")).strip("[] ")
    words = [name.strip(" \"'") for name in names.split(",") if name.strip(" \"'")]
    values = np.nan_to_num(data["assumption_flags"].values).astype(int)
    assumptions = []
    for bit, name in enumerate(words):
        outside = (values >> bit) & 1 > 0
        rows = np.flatnonzero(outside)
        first = float(log.times[rows[0]]) if len(rows) else np.nan
        assumptions.append(
            Assumption(
                name=FLAGS.get(name, name), share=float(np.mean(outside)), first_time=first, worst=np.nan, joint=None
            )
        )
    return tuple(assumptions)
