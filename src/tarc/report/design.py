"""Figures of a design: the loops that are to be had, and why one was chosen."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from tarc.report.figures import COLOURS

if TYPE_CHECKING:
    from tarc.design.choose import Design


def plot_front(design: "Design") -> Figure:
    """Torque noise against the error that a step leaves, of every loop that bears the robot, with the choice."""
    figure = Figure(figsize=(8.5, 5.0), layout="constrained")
    axes = figure.subplots()
    per_noise = design.torque_noise.max() / design.chosen.noise
    per_error = 1e3 / float(np.max(np.diag(design.shape)))
    for label, colour, marker, members in (
        ("literal", COLOURS[1], "s", [one for one in design.candidates if one.feasible and not one.synchronised]),
        ("synchronised", COLOURS[0], "o", [one for one in design.candidates if one.feasible and one.synchronised]),
    ):
        x, y = [per_noise * one.noise for one in members], [per_error * one.error for one in members]
        axes.loglog(x, y, marker, ms=3, alpha=0.4, color=colour, ls="", label=label)
    best = design.front
    axes.loglog(
        [per_noise * one.noise for one in best], [per_error * one.error for one in best], color="0.4", lw=1,
        label="not beaten in both",
    )  # fmt: skip
    axes.loglog(
        per_noise * design.chosen.noise, per_error * design.chosen.error, "*", ms=16, color=COLOURS[3], label="chosen"
    )
    axes.set_xlabel("torque noise of the loudest joint, RMS [N m]")
    axes.set_ylabel("RMS error for one step of 1 N m a second,\nstrongest joint [mrad]")
    axes.legend(frameon=False)
    axes.grid(alpha=0.3, which="both")
    return figure


def plot_reach(design: "Design") -> Figure:
    """The spread that loops bear over window and bandwidth, and the line where it is the robot's."""
    figure = Figure(figsize=(9.5, 4.2), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    level = np.log10(design.spread)
    for ax, synchronised in zip(axes, (False, True), strict=True):
        best: dict[tuple[int, float], float] = {}
        for one in design.candidates:
            if one.synchronised == synchronised and one.degree == 2 and one.delay == 1:
                best[one.window, one.bandwidth] = max(one.reach, best.get((one.window, one.bandwidth), 0.0))
        x, y = np.array(list(best)).T
        z = np.log10(np.maximum(np.minimum(list(best.values()), 300.0), 1.0))
        if len(set(x)) > 1 and len(set(y)) > 1:
            drawn = ax.tricontourf(x, np.log10(y), z, levels=np.linspace(0, 2.5, 11), cmap="viridis", extend="max")
            ax.tricontour(x, np.log10(y), z, levels=[level], colors="white", linewidths=2)
            if synchronised:
                bar = figure.colorbar(drawn, ax=axes, label="spread that the loop bears")
                bar.set_ticks([0, 0.5, 1, 1.5, 2, 2.5], labels=["1", "3", "10", "30", "100", "300"])
        if design.chosen.synchronised == synchronised:
            ax.plot(design.chosen.window, np.log10(design.chosen.bandwidth), "*", ms=16, color=COLOURS[3])
        ax.set_title("synchronised" if synchronised else "literal", fontsize="medium")
        ax.set_xlabel("window [periods]")
    speeds = [one.bandwidth for one in design.candidates]
    ticks = [one for one in (1, 2, 5, 10, 20, 50, 100, 200) if min(speeds) * 0.9 <= one <= max(speeds) * 1.1]
    axes[0].set_yticks(np.log10(ticks), labels=[str(one) for one in ticks])
    axes[0].set_ylabel("bandwidth [rad/s]")
    figure.suptitle(f"white line: the robot's spread, {design.spread:.3g}", fontsize="medium")
    return figure


FIGURES: dict[str, Callable[["Design"], Figure]] = {"front": plot_front, "reach": plot_reach}
