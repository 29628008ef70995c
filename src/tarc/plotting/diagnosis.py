"""Figure of a diagnosed log."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tarc.logs.limit_cycles import torque_spectrum
from tarc.plotting.style import COLOURS, StyledFigure

if TYPE_CHECKING:
    from tarc.logs.diagnosis import Diagnosis

MAX_POINTS = 4000
"""Most points of a line over time."""
BINS = 300
"""Most points of a spectrum."""


def diagnosis_figure(diagnosis: "Diagnosis") -> Figure:
    """Draw errors, torques over their limits, the spectrum of the torques, and noise and delay of each joint."""
    figure = StyledFigure(figsize=(12, 6.6), layout="constrained")
    grid = figure.add_gridspec(2, 4, width_ratios=[1, 1, 1, 1])
    _errors(figure.add_subplot(grid[0, :2]), diagnosis)
    _torques(figure.add_subplot(grid[0, 2:]), diagnosis)
    _spectra(figure.add_subplot(grid[1, :2]), diagnosis)
    _noise(figure.add_subplot(grid[1, 2]), diagnosis)
    _delays(figure.add_subplot(grid[1, 3]), diagnosis)
    count = len(diagnosis.findings)
    words = "no finding" if not count else f"{count} finding{'s' if count > 1 else ''}"
    figure.suptitle(f"{diagnosis.log.run.title}: {words}", fontsize="medium")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 7), fontsize="small")
    return figure


def _lines(axes: Axes, diagnosis: "Diagnosis", values: np.ndarray) -> None:
    every = max(len(values) // MAX_POINTS, 1)
    for i, name in enumerate(diagnosis.log.joint_names):
        axes.plot(diagnosis.log.times[::every], values[::every, i], lw=0.8, color=COLOURS[i % len(COLOURS)], label=name)
    axes.set_xlabel("time [s]")
    for cycle in diagnosis.limit_cycles:
        axes.axvspan(cycle.start_time, cycle.stop_time, color=COLOURS[1], alpha=0.06, lw=0)


def _errors(axes: Axes, diagnosis: "Diagnosis") -> None:
    log = diagnosis.log
    _lines(axes, diagnosis, 1e3 * (log.position - log.reference[0]))
    axes.set_ylabel("error [mrad or mm]")


def _torques(axes: Axes, diagnosis: "Diagnosis") -> None:
    log = diagnosis.log
    limits = log.run.data["torque_limit"].values if "torque_limit" in log.run.data else np.full(log.n_joints, np.inf)
    is_limited = np.all(np.isfinite(limits))
    _lines(axes, diagnosis, log.torque / limits if is_limited else log.torque)
    axes.set_ylabel("torque / limit" if is_limited else "torque [N m or N]")
    if is_limited:
        for side in (-1, 1):
            axes.axhline(side, color="#888888", lw=0.8, ls="--")


def _spectra(axes: Axes, diagnosis: "Diagnosis") -> None:
    log = diagnosis.log
    for i in range(log.n_joints):
        frequencies, power = torque_spectrum(log, i)
        if not len(power) or not np.any(power > 0):
            continue
        edges = np.unique(np.geomspace(1, len(power) + 1, BINS).astype(int)) - 1
        starts = edges[:-1]
        means = np.add.reduceat(power, starts) / np.diff(np.append(starts, len(power)))
        axes.loglog(frequencies[starts], np.sqrt(means), lw=0.9, color=COLOURS[i % len(COLOURS)])
    for cycle in diagnosis.limit_cycles:
        axes.axvline(cycle.frequency, color=COLOURS[cycle.joint % len(COLOURS)], lw=0.8, ls=":")
    axes.set_xlabel("frequency [Hz], above the motion; dotted: limit cycles")
    axes.set_ylabel("torque spectrum, relative")


def _noise(axes: Axes, diagnosis: "Diagnosis") -> None:
    n = diagnosis.log.n_joints
    axes.bar(np.arange(n), 1e6 * np.nan_to_num(diagnosis.encoders.noise), 0.6, color=COLOURS[0], label="measured")
    if diagnosis.assumed_noise is not None:
        axes.plot(np.arange(n), 1e6 * diagnosis.assumed_noise, "_", ms=22, mew=2, color=COLOURS[1], label="design")
    axes.set_ylabel("noise of the encoder [µrad or µm]")
    _by_joint(axes, diagnosis)


def _delays(axes: Axes, diagnosis: "Diagnosis") -> None:
    delay = diagnosis.delay
    if delay is None:
        axes.text(0.5, 0.5, "no delay\nto be seen", ha="center", va="center", transform=axes.transAxes)
    else:
        axes.plot(np.arange(diagnosis.log.n_joints), delay.by_joint, "o", color=COLOURS[0], label="per joint")
        axes.axhspan(delay.delay - delay.error, delay.delay + delay.error, color=COLOURS[0], alpha=0.2, lw=0)
        axes.axhline(delay.delay, color=COLOURS[0], lw=1, label="all")
    if diagnosis.assumed_delay is not None:
        axes.axhline(diagnosis.assumed_delay, color=COLOURS[1], lw=1.2, ls="--", label="certified")
    axes.set_ylabel("delay [periods]")
    _by_joint(axes, diagnosis)


def _by_joint(axes: Axes, diagnosis: "Diagnosis") -> None:
    names = diagnosis.log.joint_names
    axes.set_xticks(np.arange(len(names)), names, rotation=30, ha="right", fontsize="small")
    axes.set_xlim(-0.6, len(names) - 0.4)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="small", frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
