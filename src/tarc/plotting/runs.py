"""Figures of runs and estimators, for the screen and for the column of a paper."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from tarc.core import validation as check

if TYPE_CHECKING:
    from xarray import Dataset

    from tarc.estimators.base import Estimator
    from tarc.simulation.run import Run


COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"]
"""Okabe and Ito's palette, which colour-blind readers can distinguish."""

STYLES = ("screen", "column")
COLUMN_WIDTH = 3.5
"""Width of a column of a paper [in]."""
COLUMN_FONT_SIZE = 7.0
COLUMN_LINE_WIDTH = 0.8


def run_figure(runs: dict[str, "Run"], style: str = "screen") -> Figure:
    """Draw tracking, error, torque and gain of one or more runs of the same robot.

    Parameters
    ----------
    runs
        Runs by the name to show.
    style
        ``screen`` shows every joint; ``column`` is 3.5 inches wide, for a paper.
    """
    check.one_of("style", style, STYLES)
    return _column(runs) if style == "column" else _screen(runs)


def _screen(runs: dict[str, "Run"]) -> Figure:
    first = next(iter(runs.values())).data
    joints = first["joint"].values
    gains = {name: run for name, run in runs.items() if "gain" in run.data}
    tracks = int(np.ceil(len(joints) / 4))
    across = int(np.ceil(len(joints) / tracks))
    heights = [1.0] * tracks + [1.2, 1.2] + [1.0] * bool(gains)
    figure = Figure(figsize=(12, 2.0 * sum(heights)), layout="constrained")
    grid = figure.add_gridspec(len(heights), across * len(runs) * 2, height_ratios=heights)
    width = len(runs) * 2

    for i, joint in enumerate(joints):
        row, column = divmod(i, across)
        axes = figure.add_subplot(grid[row, column * width : (column + 1) * width])
        axes.plot(first["time"], first["reference"][:, i], "--", color="0.4", lw=1.2, label="reference")
        for colour, name, run in _drawn(runs):
            axes.plot(run.data["time"], run.data["position"][:, i], color=colour, lw=1.0, label=name)
        axes.set_title(str(joint), fontsize="medium")
        units = first["joint_unit"].values
        axes.set_ylabel(f"position [{units[i]}]" if column == 0 or units[i] != units[i - 1] else "")
        axes.margins(x=0)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=4, fontsize="small")

    _errors(figure.add_subplot(grid[tracks, :]), runs, 1.0)
    share = grid.ncols // len(runs)
    panels: list[Axes] = []
    for k, (name, run) in enumerate(runs.items()):
        axes = figure.add_subplot(grid[tracks + 1, k * share : (k + 1) * share], sharey=panels[0] if panels else None)
        for colour, i in zip(COLOURS * len(joints), range(len(joints)), strict=False):
            axes.plot(run.data["time"], run.data["torque"][:, i], color=colour, lw=0.8, label=str(joints[i]))
        axes.set_title(f"{_output(first)}, {name}", fontsize="medium")
        axes.set_ylabel(f"{_output(first)} [{_unit(first, 'torque')}]" if k == 0 else "")
        axes.margins(x=0)
        panels.append(axes)
    panels[-1].legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    if gains:
        _gain(figure.add_subplot(grid[tracks + 2, :]), gains, 1.0)
    figure.axes[-1].set_xlabel("time [s]")
    for panel in panels if not gains else []:
        panel.set_xlabel("time [s]")
    return figure


def _column(runs: dict[str, "Run"]) -> Figure:
    size, line = COLUMN_FONT_SIZE, COLUMN_LINE_WIDTH
    first = next(iter(runs.values())).data
    gains = {name: run for name, run in runs.items() if "gain" in run.data}
    rows = 3 if gains else 2
    figure = Figure(figsize=(COLUMN_WIDTH, 1.15 * rows + 0.3), layout="constrained")
    panels = figure.subplots(rows, 1, sharex=True)
    _errors(panels[0], runs, line)
    strongest = int(np.argmax(np.abs(first["torque"].values).max(axis=0)))
    for colour, name, run in _drawn(runs):
        panels[1].plot(run.data["time"], run.data["torque"][:, strongest], color=colour, lw=line * 0.8, label=name)
    panels[1].set_ylabel(f"{_output(first)} [{_unit(first, 'torque')}]")
    panels[1].set_title(str(first["joint"].values[strongest]), fontsize=size, pad=2)
    if gains:
        _gain(panels[2], gains, line)
    panels[-1].set_xlabel("time [s]")
    for axes in panels:
        axes.tick_params(labelsize=size)
        for text in (axes.xaxis.label, axes.yaxis.label):
            text.set_fontsize(size)
        legend = axes.get_legend()
        for text in legend.get_texts() if legend else []:
            text.set_fontsize(size - 1)
    return figure


def _drawn(runs: dict[str, "Run"]) -> list[tuple[str, str, "Run"]]:
    """Return colour, name and run, the first run last, so that it lies on top."""
    return [(colour, name, run) for colour, (name, run) in zip(COLOURS, runs.items(), strict=False)][::-1]


def _legend(axes: Axes, ncols: int = 4) -> None:
    """Draw a legend above the axes, where it hides nothing."""
    axes.legend(fontsize="small", loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=ncols, frameon=False, borderpad=0)


def _output(data: "Dataset") -> str:
    """Return what the law outputs: a torque, or a command of inner loops."""
    return "torque" if _unit(data, "torque").startswith("N") else "command"


def _unit(data: "Dataset", name: str) -> str:
    return str(data[name].attrs["units"])


def error_norms(data: "Dataset") -> dict[str, np.ndarray]:
    """Return the Euclidean norm of the tracking error over the joints of each unit, shape (k,), by the unit."""
    error = (data["position"] - data["reference"]).values
    units = data["joint_unit"].values
    return {str(unit): np.linalg.norm(error[:, units == unit], axis=1) for unit in dict.fromkeys(units)}


def _errors(axes: Axes, runs: dict[str, "Run"], line: float) -> None:
    """Draw the Euclidean norm of the tracking error over the joints, logarithmic; one for each unit of the joints."""
    errors = []
    for colour, name, run in _drawn(runs):
        norms = error_norms(run.data)
        for style, (unit, error) in zip(("-", "--"), norms.items(), strict=False):
            label = name if len(norms) == 1 else f"{name} [m{unit}]"
            shown = np.maximum(error, 1e-9) * 1e3
            axes.semilogy(run.data["time"], shown, style, color=colour, lw=line, label=label)
            errors.append(error)
    units = error_norms(next(iter(runs.values())).data)
    axes.set_ylabel(f"error ‖e‖ [{' or '.join(f'm{unit}' for unit in units)}]")
    low = min(float(np.percentile(error, 1)) for error in errors) * 1e3
    high = max(float(np.max(error)) for error in errors) * 1e3
    axes.set_ylim(max(low, 1e-6) / 2, max(high, 1e-5) * 2)
    is_narrow = high < 100 * low
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if is_narrow else (1,)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    _legend(axes)
    axes.grid(alpha=0.3)
    axes.margins(x=0)


def _gain(axes: Axes, runs: dict[str, "Run"], line: float) -> None:
    """Draw the gain, and below it a band that shows where it rises and falls."""
    for colour, (name, run) in zip(COLOURS[-3:-7:-1] if len(runs) > 1 else ["0.25"], runs.items(), strict=False):
        time, gain = run.data["time"].values, run.data["gain"].values
        label = f"ĉ, {name}"
        axes.plot(time, gain, color=colour, lw=line, label=label)
    run = next(iter(runs.values()))
    time, gain = run.data["time"].values, run.data["gain"].values
    change = np.diff(gain, append=gain[-1])
    high = float(gain.max()) or 1.0
    for sign, colour, label in ((1, COLOURS[1], "ĉ rises"), (-1, COLOURS[0], "ĉ falls")):
        axes.fill_between(time, -0.16 * high, -0.06 * high, where=sign * change > 0, color=colour, lw=0, label=label)
    axes.set_ylim(-0.2 * high, 1.05 * high)
    axes.set_ylabel("gain ĉ [" + str(run.data["gain"].attrs["units"]) + "]")
    _legend(axes)
    axes.grid(alpha=0.3)
    axes.margins(x=0)


def estimator_figure(estimator: "Estimator") -> Figure:
    """Draw the gain relative to the ideal derivative, and the phase error, over frequency."""
    period = estimator.sampling_period
    frequency = np.geomspace(1.0, np.pi / period, 600)
    figure = Figure(figsize=(7, 5), layout="constrained")
    gain, phase = figure.subplots(2, 1, sharex=True)
    for colour, order, name in zip(COLOURS, (1, 2), ("velocity", "acceleration"), strict=False):
        if order > estimator.max_derivative:
            continue
        ratio = estimator.frequency_response(frequency, order) / (1j * frequency) ** order
        delay, noise = round(estimator.group_delay(order) * 1e3, 9) + 0.0, estimator.noise_gain(order)
        label = f"{name}: delay {delay:.2f} ms, noise gain {noise:.3g} s$^{{-{order}}}$"
        gain.loglog(frequency, np.abs(ratio), color=colour, label=label)
        lag = np.rad2deg(np.unwrap(np.angle(ratio)))
        phase.semilogx(frequency, np.where(np.abs(ratio) > 1e-3, lag, np.nan), color=colour)
    gain.axhline(1.0, color="0.6", lw=0.8)
    gain.set_ylim(1e-2, 10)
    gain.set_ylabel("gain / ideal")
    gain.legend(fontsize="small", loc="lower left")
    phase.set_ylabel("phase error [°]")
    phase.set_xlabel("frequency [rad/s]")
    gain.set_title(f"{type(estimator).__name__}, period {period * 1e3:g} ms", fontsize="medium")
    for axes in (gain, phase):
        axes.grid(alpha=0.3)
        axes.margins(x=0)
    return figure
