"""What is wrong in a diagnosed log, and what to change."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tde import TDE
from tarc.logs.command_delay import CommandDelay
from tarc.logs.encoder_check import EncoderCheck
from tarc.logs.limit_cycles import LimitCycle
from tarc.logs.loop_checks import Assumption, LoopTiming, TorqueUse
from tarc.logs.loop_log import LoopLog

MAX_NOISE = 1.3
"""Largest noise over that of the design."""
WANTED_ENDS = ("completed", "stopped on request")
"""How a loop on a machine ends that nothing stopped."""
MAX_SHARE = 1e-3
"""Largest share of samples that may be missing or stale."""
MAX_JITTER = 0.05
"""Largest deviation of the sampling times [periods]."""
MAX_DELAY_ERROR = 0.6
"""Standard error above which a delay does not show [periods]."""
MIN_DELAY_CHANGE = 0.75
"""Least distance of a delay from the one that was certified [periods]."""
SIGNIFICANT = 3.0
"""Standard errors by which a number must differ."""
WIDER = {
    "load at rest": "certify with this load: a payload in the scenario, or tarc design --payload",
    "sample timing": "give the loop real-time priority and a core of its own; a certificate counts on even samples",
}
"""What to change where an assumption of the certificate was left, by its name."""
BUSY = 0.8
"""Largest computation time over the period."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something that is wrong.

    Attributes
    ----------
    kind
        One word: ``noise``, ``resolution``, ``missing``, ``stale``, ``jitter``, ``delay``, ``saturation``, ``rate``,
        ``limit_cycle``, ``certificate``, ``overruns``, ``computation``, ``stop`` or ``fault``.
    joint
        Name of the joint that shows it most; empty where it concerns all.
    text
        What was measured.
    change
        What to change.
    """

    kind: str
    joint: str
    text: str
    change: str


def findings_of(
    log: LoopLog,
    law: Law | None,
    *,
    encoders: EncoderCheck,
    assumed_noise: Array | None,
    delay: CommandDelay | None,
    assumed_delay: float | None,
    torque: TorqueUse,
    timing: LoopTiming | None,
    limit_cycles: tuple[LimitCycle, ...],
    assumptions: tuple[Assumption, ...],
) -> tuple[Finding, ...]:
    """Return the findings of what was measured, the most urgent first.

    Parameters
    ----------
    log
        The log.
    law
        The law of its design, for what to change; None where it is not known.
    encoders, assumed_noise, delay, assumed_delay, torque, timing, limit_cycles, assumptions
        As in `tarc.Diagnosis`.
    """
    parts = (
        _fault(log, law),
        _limit_cycles(log, law, limit_cycles),
        _torque(log, torque, limit_cycles),
        _timing(log, timing),
        _samples(log, encoders),
        _noise(log, law, encoders, assumed_noise),
        _delay(law, delay, assumed_delay),
        _assumptions(log, assumptions),
    )
    return tuple(finding for part in parts for finding in part)


def _fault(log: LoopLog, law: Law | None) -> Iterator[Finding]:
    data = log.run.data
    ended = str(data.attrs.get("ended", WANTED_ENDS[0]))
    if ended not in WANTED_ENDS:
        change = "cure the other findings first, then start again with a smaller M̂ and a slower reference"
        yield Finding(kind="stop", joint="", text=f"the loop stopped: {ended}", change=change)
    if "fault" not in data or not np.any(data["fault"].values > 0):
        return
    first = float(log.times[int(np.argmax(data["fault"].values > 0))])
    most = "max_missing" if law is None else f"max_missing = {law.max_missing}"
    yield Finding(
        kind="fault",
        joint="",
        text=f"the law gave up at {first:.3f} s, after more samples in a row were missing than {most} allows",
        change="find out why samples are missing; reset the law after a fault",
    )


def _limit_cycles(log: LoopLog, law: Law | None, cycles: tuple[LimitCycle, ...]) -> Iterator[Finding]:
    for cycle in cycles:
        yield Finding(
            kind="limit_cycle",
            joint=log.joint_names[cycle.joint],
            text=f"oscillates at {cycle.frequency:.3g} Hz with {1e3 * cycle.amplitude:.3g} "
            f"{log.position_unit(cycle.joint)} and {cycle.torque_amplitude:.3g} {log.torque_unit(cycle.joint)}, in "
            f"{cycle.share:.0%} of the log from {cycle.start_time:.4g} s on",
            change=f"{_remedy(law, cycle.frequency, cycle.joint)}; what stays then comes from outside",
        )


def _remedy(law: Law | None, frequency: float, joint: int) -> str:
    """Return what damps an oscillation: a smaller M̂ above the natural frequency, else a lower one."""
    if not isinstance(law, PolePlacement):
        return "lower the inertia M̂ or the natural frequency by 30 %, then tarc certify"
    own = float(np.sqrt(np.maximum(np.linalg.eigvals(law.K1).real, 0.0).max()))
    if 2 * np.pi * frequency > 2 * own:
        inertia = float(law.inertia_at(np.zeros(law.n_joints))[joint, joint])
        return (
            f"it is {2 * np.pi * frequency / own:.2g} times as fast as the natural frequency: M̂ is too large for "
            f"window and delay. Halve law.inertia (now {inertia:.3g} at this joint), or take synchronised=true, then "
            "tarc certify"
        )
    return f"lower law.natural_frequency from {own:.3g} to {0.7 * own:.3g} rad/s, then tarc certify"


def _torque(log: LoopLog, torque: TorqueUse, cycles: tuple[LimitCycle, ...]) -> Iterator[Finding]:
    oscillating = {cycle.joint for cycle in cycles}
    for shares, kind, what in (
        (torque.saturated, "saturation", "limit of the torque"),
        (torque.rate_limited, "rate", "limit of the torque's rate"),
    ):
        for joint in np.flatnonzero(shares > 0):
            longest = f", {1e3 * torque.longest[joint]:.3g} ms in a row at most" if kind == "saturation" else ""
            change = (
                "slow the reference down, reduce the load, or raise the limit where the drive allows it; at the start, "
                "begin at rest on the reference"
            )
            yield Finding(
                kind=kind,
                joint=log.joint_names[joint],
                text=f"at the {what} in {shares[joint]:.2%} of the periods{longest}; no certificate covers that",
                change="cure the limit cycle first" if int(joint) in oscillating else change,
            )


def _timing(log: LoopLog, timing: LoopTiming | None) -> Iterator[Finding]:
    if timing is None:
        return
    T = log.period
    if timing.overruns > 0:
        yield Finding(
            kind="overruns",
            joint="",
            text=f"the loop missed {timing.overruns:.3%} of its periods; starts are up to "
            f"{1e3 * timing.lateness[2]:.3g} ms late, {1e3 * timing.lateness[1]:.3g} ms in 99.9 %",
            change="run with real-time priority and locked memory, on a core of its own; else take a longer period",
        )
    if timing.computation_time[1] > BUSY * T:
        yield Finding(
            kind="computation",
            joint="",
            text=f"a step takes {1e3 * timing.computation_time[1]:.3g} ms in 99.9 % of the periods of {1e3 * T:.3g} ms",
            change=f"compile the law (native), or take a period of {2e3 * timing.computation_time[1]:.2g} ms",
        )


def _samples(log: LoopLog, encoders: EncoderCheck) -> Iterator[Finding]:
    worst = int(np.argmax(encoders.missing))
    if encoders.missing[worst] > MAX_SHARE:
        yield Finding(
            kind="missing",
            joint=log.joint_names[worst],
            text=f"{encoders.missing[worst]:.2%} of its samples are missing, up to {encoders.longest_gap} in a row",
            change="mend the bus or the cable; the estimator predicts samples, but no certificate covers that",
        )
    if encoders.stale > MAX_SHARE:
        yield Finding(
            kind="stale",
            joint="",
            text=f"{encoders.stale:.2%} of the moving rows repeat the one before",
            change="read the encoders at the rate of the law, or pass NaN for a sample that is not new",
        )
        return  # repeated rows are old, which is a jitter too
    if encoders.jitter > max(MAX_JITTER * log.period, SIGNIFICANT * encoders.jitter_error):
        yield Finding(
            kind="jitter",
            joint="",
            text=f"samples are {1e3 * encoders.jitter:.3g} ms off their times (standard deviation), "
            f"{encoders.jitter / log.period:.2g} periods",
            change="stamp the samples and pass Controller.step(…, time=stamp), or let one clock start sampling and law",
        )


def _noise(log: LoopLog, law: Law | None, encoders: EncoderCheck, assumed: Array | None) -> Iterator[Finding]:
    if assumed is None:
        return
    ratio = encoders.noise / np.maximum(assumed, 1e-300)
    steps = np.nan_to_num(encoders.resolution) / np.sqrt(12) / np.maximum(assumed, 1e-300)
    worst = int(np.nanargmax(np.fmax(np.nan_to_num(ratio), steps)))
    size = max(float(np.nan_to_num(ratio[worst])), float(steps[worst]))
    if not size > MAX_NOISE or np.max(assumed) == 0:
        return
    is_step = steps[worst] > MAX_NOISE
    what = (
        f"a step of {1e3 * encoders.resolution[worst]:.3g} {log.position_unit(worst)}"
        if is_step
        else f"a noise of {1e3 * encoders.noise[worst]:.3g} {log.position_unit(worst)}"
    )
    yield Finding(
        kind="resolution" if is_step else "noise",
        joint=log.joint_names[worst],
        text=f"the encoder has {what}; the design assumes a noise of {1e3 * assumed[worst]:.3g}, {size:.2g} times less",
        change=_longer_window(law, size),
    )


def _longer_window(law: Law | None, ratio: float) -> str:
    """Return the window at which the acceleration is as noisy as in the design."""
    estimator = None if law is None else law.estimator
    if not isinstance(estimator, Algebraic) or estimator.max_derivative < 2:
        return "lengthen the estimator's window, or lower law.natural_frequency; then tarc certify"
    allowed = estimator.noise_gain(2) / ratio
    for count in range(estimator.samples, 20 * estimator.samples):
        window = count * estimator.sampling_period
        longer = Algebraic(window=window, degree=estimator.degree).with_period(estimator.sampling_period)
        if longer.noise_gain(2) <= allowed:
            return (
                f"estimator.window={window:.4g} has the torque noise of the design; it allows a smaller M̂ only: "
                "tarc certify, or tarc design with this encoder"
            )
    return "use a better encoder, or lower law.natural_frequency; then tarc certify"


def _delay(law: Law | None, delay: CommandDelay | None, assumed: float | None) -> Iterator[Finding]:
    if delay is None or assumed is None or delay.error > MAX_DELAY_ERROR:
        return
    if abs(delay.delay - assumed) < max(MIN_DELAY_CHANGE, SIGNIFICANT * delay.error):
        return
    periods = max(round(delay.delay), 0)
    change = f"computation_delay: {periods} in the scenario, then tarc certify"
    if law is not None:
        own = f"law.actuation_delay={periods}"
        if isinstance(law, TDE) and not law.synchronised and periods % 2:
            own += " with law.synchronised=true"
        change = f"{own} and {change}"
    yield Finding(
        kind="delay",
        joint="",
        text=f"the motion follows the torque after {delay.delay:.2f} ± {delay.error:.2f} periods, actuation and "
        f"measurement together; {assumed:g} were certified",
        change=change,
    )


def _assumptions(log: LoopLog, assumptions: tuple[Assumption, ...]) -> Iterator[Finding]:
    for part in assumptions:
        if part.holds:
            continue
        worst = f", up to {part.worst:.3g} times the limit" if np.isfinite(part.worst) else ""
        yield Finding(
            kind="certificate",
            joint="" if part.joint is None else log.joint_names[part.joint],
            text=f"{part.name} left the certified range in {part.share:.2%} of the periods, from "
            f"{part.first_time:.3f} s on{worst}: the certificate says nothing about these",
            change=WIDER.get(part.name, "certify the wider range (tarc certify --tube, --speed), or stay inside it"),
        )
