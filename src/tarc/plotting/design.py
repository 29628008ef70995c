"""Figures of a design: the loops that are to be had, and why one was chosen."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter, NullLocator

from tarc.plotting.certificates import design_figure
from tarc.plotting.runs import COLOURS

if TYPE_CHECKING:
    from tarc.design.candidates import Candidate
    from tarc.design.selection import Design


STAR: dict[str, Any] = {"marker": "*", "ms": 18, "color": COLOURS[3], "mec": "black", "mew": 0.8, "ls": "", "zorder": 5}
WIDEST = 300.0
"""Spread beyond which the map has one colour."""


def plot_front(design: "Design") -> Figure:
    """Torque noise against the error that a step leaves, of every loop that bears the robot, with the choice."""
    figure = Figure(figsize=(8.5, 5.0), layout="constrained")
    axes = figure.subplots()
    plant = design.plants[0]
    limit = design.law.torque_limits if design.law.torque_limit is not None else np.full(design.law.n_joints, np.inf)
    shares = 100 * design.torque_noise / limit
    known = bool(np.any(np.isfinite(limit)))
    loudest = int(np.argmax(shares if known else design.torque_noise))
    per_noise = (shares if known else design.torque_noise)[loudest] / design.candidate.noise
    heaviest = int(np.argmax(np.diag(design.shape)))
    per_error = 1e3 / float(design.shape[heaviest, heaviest])

    def points(members: "list[Candidate]") -> tuple[list[float], list[float]]:
        return [per_noise * one.noise for one in members], [per_error * one.error for one in members]

    able = [one for one in design.candidates if one.feasible]
    for label, colour, marker, members in (
        ("literal", COLOURS[1], "s", [one for one in able if not one.synchronised]),
        ("synchronised", COLOURS[0], "o", [one for one in able if one.synchronised]),
    ):
        if members:
            axes.plot(*points(members), marker, ms=3.5, alpha=0.45, color=colour, ls="", label=label)
    axes.plot(*points(design.front), color="0.4", lw=1, drawstyle="steps-post", label="not beaten in both")
    axes.plot(*points([design.candidate]), label="chosen", **STAR)
    if design.noise_budget is not None and known:
        allowed = 100 * design.noise_budget
        axes.axvline(allowed, color=COLOURS[2], ls="--", label=f"budget, {allowed:.3g} %")
    _log(axes, "x")
    _log(axes, "y")
    axes.set_xlabel(
        f"torque noise of the loudest joint, {plant.joint_names[loudest]}, RMS "
        f"[{'% of its limit' if known else _force(design, loudest)}]"
    )
    axes.set_ylabel(
        f"RMS error of {plant.joint_names[heaviest]} for one step\nof 1 {_force(design, heaviest)} a second "
        f"[m{plant.units[heaviest]}]"
    )
    axes.legend(frameon=False, fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.grid(alpha=0.3)
    axes.set_title(_title(design), fontsize="medium")
    return figure


def plot_reach(design: "Design") -> Figure:
    """The spread that loops bear over window and natural frequency, and where it is the robot's; at one natural
    frequency over the
    window alone. For a robot of bounded speed, for which it is not known how much more a loop bears, those that do.
    """
    if design.workspace.speed is not None:
        return _region(design)
    sides = {both: _grid(design, both) for both in (False, True)}
    return _map(design, sides) if all(len(grid[1]) > 1 for grid in sides.values()) else _lines(design)


def _region(design: "Design") -> Figure:
    figure = Figure(figsize=(9.5, 4.4), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    able = [one for one in design.candidates if one.feasible]
    limited = design.law.torque_limit is not None
    loudest = float(np.max(100 * design.torque_noise / design.law.torque_limits if limited else design.torque_noise))
    noise = {one: loudest * one.noise / design.candidate.noise for one in able}
    least, most = np.log10(min(noise.values())), np.log10(max(noise.values()))
    drawn: Any = None
    for axes, synchronised in zip(panels, (False, True), strict=True):
        for degree, marker in ((2, "o"), (3, "s")):
            # the quietest scale of M̂ of each loop on top
            some = [one for one in able if (one.synchronised, one.degree) == (synchronised, degree)]
            some.sort(key=lambda one: -noise[one])
            drawn = axes.scatter(
                [one.window for one in some],
                [one.natural_frequency for one in some],
                c=[np.log10(noise[one]) for one in some],
                vmin=least,
                vmax=most,
                cmap="viridis_r",
                marker=marker,
                s=30,
                label=f"degree {degree}",
            )
        if design.candidate.synchronised == synchronised:
            axes.plot(design.candidate.window, design.candidate.natural_frequency, **STAR)
        axes.set_title("synchronised" if synchronised else "literal", fontsize="medium")
        axes.set_xlabel("window [periods]")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(alpha=0.3)
    _log(panels[0], "y")
    panels[0].set_ylabel("bandwidth [rad/s]")
    panels[1].legend(frameon=False, fontsize="small")
    bar = figure.colorbar(
        drawn,
        ax=panels,
        label=f"torque noise of the loudest joint, RMS [{'% of its limit' if limited else 'N m or N'}]",
    )
    ticks = np.linspace(least, most, 6)
    bar.set_ticks(list(ticks), labels=[f"{10**one:.2g}" for one in ticks])
    figure.suptitle(
        f"{_title(design)}\nloops found that bear the robot's spread, {design.spread:.3g}, with gravity, motion and "
        "room; star: chosen",
        fontsize="medium",
    )
    return figure


def _grid(design: "Design", synchronised: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Windows (w,), natural frequencies (b,) and the widest spread that a loop bears there (b, w), of those looked
    at first."""
    found: dict[tuple[int, float], float] = {}
    for one in design.candidates:
        if one.synchronised == synchronised and one.degree == _degree(design, synchronised):
            found[one.window, one.natural_frequency] = max(
                one.max_spread, found.get((one.window, one.natural_frequency), 1.0)
            )
    # the neighbours of the choice, looked at later, have few windows a natural frequency and few natural frequencies
    # a window
    speeds = _frequent([speed for _, speed in found])
    windows = _frequent([window for window, speed in found if speed in speeds])
    values = np.array([[found.get((int(w), float(s)), 1.0) for w in windows] for s in speeds])
    return windows, speeds, values


def _degree(design: "Design", synchronised: bool) -> int:
    """That of the choice; literal loops have degree 2."""
    return design.candidate.degree if synchronised else min(design.candidate.degree, 2)


def _frequent(values: list[Any]) -> np.ndarray:
    each, counts = np.unique(values, return_counts=True)
    return each[2 * counts > counts.max()] if len(each) else each


def _map(design: "Design", sides: dict[bool, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Figure:
    figure = Figure(figsize=(9.5, 4.4), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    level = np.log10(design.spread)
    drawn: Any = None
    line = False
    for axes, (synchronised, (windows, speeds, values)) in zip(panels, sides.items(), strict=True):
        z = np.log10(np.clip(values, 1.0, WIDEST))
        drawn = axes.contourf(windows, speeds, z, levels=np.linspace(0, 2.5, 11), cmap="viridis", extend="max")
        if z.min() < level < z.max():
            axes.contour(windows, speeds, z, levels=[level], colors="white", linewidths=2)
            line = True
        able = [one for one in design.candidates if one.feasible and one.synchronised == synchronised]
        able = [one for one in able if one.degree == _degree(design, synchronised)]
        axes.plot([one.window for one in able], [one.natural_frequency for one in able], "o", color="black", ms=2.5)
        if design.candidate.synchronised == synchronised:
            axes.plot(design.candidate.window, design.candidate.natural_frequency, clip_on=False, **STAR)
        axes.set_facecolor("0.9")
        word = "synchronised" if synchronised else "literal"
        axes.set_title(f"{word}, degree {_degree(design, synchronised)}", fontsize="medium")
        axes.set_xlabel("window [periods]")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlim(min([windows.min(), *(one.window for one in able)]) - 0.3, windows.max())
        axes.set_ylim(speeds.min(), speeds.max())
        _log(axes, "y")
    bar = figure.colorbar(drawn, ax=panels, label="spread that the loop bears")
    bar.set_ticks([0, 0.5, 1, 1.5, 2, 2.5], labels=["1", "3", "10", "30", "100", "300"])
    panels[0].set_ylabel("bandwidth [rad/s]")
    figure.suptitle(
        f"{_title(design)}\n{'white line: ' if line else ''}the robot's spread, {design.spread:.3g}; dots: loops that "
        "bear it with gravity, motion and room; star: chosen",
        fontsize="medium",
    )
    return figure


def _lines(design: "Design") -> Figure:
    figure = Figure(figsize=(8.5, 4.4), layout="constrained")
    axes = figure.subplots()
    able: list[Candidate] = []
    for synchronised, colour, word in ((False, COLOURS[1], "literal"), (True, COLOURS[0], "synchronised")):
        for degree, style in ((2, "-"), (3, "--")):
            best: dict[int, Candidate] = {}
            for one in design.candidates:
                if (one.synchronised, one.degree) == (synchronised, degree):
                    best[one.window] = max(
                        one, best.get(one.window, one), key=lambda any: (any.feasible, any.max_spread)
                    )
            windows = sorted(best)
            if not windows:
                continue
            reach = [float(np.clip(best[window].max_spread, 1.0, 10 * WIDEST)) for window in windows]
            axes.plot(windows, reach, style, color=colour, lw=1.2, label=f"{word}, degree {degree}")
            able += [one for one in best.values() if one.feasible]
    axes.plot([one.window for one in able], [one.max_spread for one in able], "o", color="black", ms=3.5)
    axes.axhline(design.spread, color="0.4", lw=1.5, label=f"the robot's spread, {design.spread:.3g}")
    axes.plot(design.candidate.window, design.candidate.max_spread, label="chosen", **STAR)
    axes.set_xlabel("window [periods]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _log(axes, "y")
    axes.set_ylabel(f"spread that the loop bears\nat {design.candidate.natural_frequency:.4g} rad/s")
    axes.legend(frameon=False, fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.grid(alpha=0.3)
    figure.suptitle(
        f"{_title(design)}\ndots: loops that bear the robot with gravity, motion and room", fontsize="medium"
    )
    return figure


def _title(design: "Design") -> str:
    from tarc.design.writer import plant_name

    low, high = design.payload
    carried = f", {low:g} to {high:g} kg" if high > low else f", {high:g} kg" if high else ""
    rate = 1 / design.law.period
    return f"{plant_name(design.plants[0])}{carried}: {type(design.law).__name__} at {rate:.4g} Hz"


def _force(design: "Design", joint: int) -> str:
    return "N" if design.plants[0].units[joint] == "m" else "N m"


def _log(axes: Axes, which: str) -> None:
    """A logarithmic axis whose ticks are plain numbers."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    axes.set_xscale("log") if which == "x" else axes.set_yscale("log")
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    width = np.log10(high / low)
    steps = (1,) if width > 3 else (1, 2, 5) if width > 1 else (1, 1.5, 2, 3, 4, 5, 6, 8)
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [step * 10.0**decade for decade in decades for step in steps]
    inside = [one for one in ticks if low <= one <= high]
    if len(inside) < 3:
        inside = [one for one in MaxNLocator(5).tick_values(low, high) if low <= one <= high]
    axis.set_major_locator(FixedLocator(inside))
    axis.set_major_formatter("{x:.4g}")
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


FIGURES: dict[str, Callable[["Design"], Figure]] = {"front": plot_front, "reach": plot_reach}

MAX_MAP_WINDOW = 20
"""Longest window [periods] for which the law's figure is drawn: its map looks at longer ones still."""


def design_figures(design: "Design") -> dict[str, Figure]:
    """All figures of a design, by name; that of the law only where its map does not take long."""
    found = {kind: draw(design) for kind, draw in FIGURES.items()}
    if design.candidate.window <= MAX_MAP_WINDOW:
        found["law"] = design_figure(design.law, design.certificates, design.candidate.computation_delay)
    return found
