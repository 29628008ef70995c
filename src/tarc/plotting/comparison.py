"""Figures of laws side by side."""

from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from tarc.plotting.style import COLOURS, StyledFigure, style_tradeoff

if TYPE_CHECKING:
    from tarc.study.comparison import Comparison


MARKERS = "osD^vP*X<>"


def plane(comparison: "Comparison") -> Figure:
    """Draw RMS error over torque variation, both logarithmic, with the Pareto front."""
    figure = StyledFigure(figsize=(8.5, 5.5), layout="constrained")
    axes = figure.subplots()
    points = {
        name: (measures["torque_variation"], 1e3 * measures["rms_error"])
        for name, measures in comparison.measures.items()
        if measures
    }
    for i, (name, point) in enumerate(points.items()):
        axes.plot(*point, MARKERS[i % len(MARKERS)], color=COLOURS[i % len(COLOURS)], label=name)
    front = sorted(points[name] for name in comparison.front)
    if front:
        corners = [(front[0][0], front[0][1])]
        for point, following in pairwise(front):
            corners += [(following[0], point[1]), following]
        axes.plot(*np.array(corners).T, color="0.6", lw=1, zorder=0, label="Pareto front")
    axes.set_xlabel(f"torque variation [{comparison.columns['torque_variation'][2]}]")
    axes.set_ylabel(f"RMS error [{comparison.columns['rms_error'][2]}]")
    axes.set_title(comparison.scenario.name, fontsize="medium")
    style_tradeoff(axes)
    return figure


def side(comparison: "Comparison") -> Figure:
    """Draw the norm of the error and the torque of the strongest joint, of every law on the same axes."""
    runs = comparison.runs
    figure = StyledFigure(figsize=(11, max(3.0, 1.1 * len(runs))), layout="constrained")
    grid = figure.subplots(max(len(runs), 1), 2, sharex=True, sharey="col", squeeze=False)
    for i, ((name, run), row) in enumerate(zip(runs.items(), grid, strict=False)):
        data, colour = run.data, COLOURS[i % len(COLOURS)]
        error = np.linalg.norm((data["position"] - data["reference"]).values, axis=1)
        row[0].semilogy(data["time"], np.maximum(1e3 * error, 1e-3), color=colour, lw=0.8)
        strongest = int(np.argmax(np.abs(data["torque"].values).max(axis=0)))
        row[1].plot(data["time"], data["torque"][:, strongest], color=colour, lw=0.6)
        row[0].set_ylabel(name, rotation=0, ha="right", va="center")
        for axes in row:
            axes.grid(alpha=0.3)
            axes.margins(x=0)
    grid[0, 0].set_title(f"error [{comparison.columns['rms_error'][2]}]", fontsize="medium")
    grid[0, 1].set_title(f"torque of the strongest joint [{comparison.columns['peak_torque'][2]}]", fontsize="medium")
    levels = [np.linalg.norm((run.data["position"] - run.data["reference"]).values, axis=1) for run in runs.values()]
    if levels:
        low = 1e3 * min(float(np.percentile(level, 2)) for level in levels)
        high = 1e3 * float(np.median([level.max() for level in levels]))
        grid[0, 0].set_ylim(max(low, 1e-5) / 2, max(10 * high, 1e-4))
    typical = [np.percentile(np.abs(run.data["torque"].values).max(axis=1), 99) for run in runs.values()]
    if typical:
        grid[0, 1].set_ylim(-1.3 * float(np.median(typical)), 1.3 * float(np.median(typical)))
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    return figure


def gain(comparison: "Comparison") -> Figure:
    """Draw the gain of the laws that adapt one, and the norm that drives it."""
    runs = {name: run for name, run in comparison.runs.items() if "gain" in run.data}
    figure = StyledFigure(figsize=(9, max(2.5, 1.8 * len(runs))), layout="constrained")
    grid = figure.subplots(max(len(runs), 1), 1, sharex=True, squeeze=False)[:, 0]
    for i, ((name, run), axes) in enumerate(zip(runs.items(), grid, strict=False)):
        data = run.data
        axes.plot(data["time"], data["gain"], color=COLOURS[i % len(COLOURS)], lw=0.9)
        axes.set_ylabel(f"{name}\ngain")
        error = np.linalg.norm((data["position"] - data["reference"]).values, axis=1)
        other = axes.twinx()
        shown = data["sliding"].values if "sliding" in data else error
        other.plot(data["time"], shown, color="0.6", lw=0.5, zorder=0)
        other.set_ylabel("‖s‖" if "sliding" in data else "‖e‖", color="0.5")
        axes.margins(x=0)
        axes.grid(alpha=0.3)
    if not runs:
        grid[0].set_axis_off()
        grid[0].text(0.5, 0.5, "no law here adapts a gain", ha="center", transform=grid[0].transAxes)
    grid[-1].set_xlabel("time [s]")
    return figure


FIGURES: dict[str, Callable[["Comparison"], Figure]] = {"plane": plane, "side": side, "gain": gain}
