"""Figures of a design: the assessed loops and the chosen one."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter, NullLocator

from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.optimum import loop_deviations, optimal_front
from tarc.certification import LawCertification
from tarc.design.candidates import Candidate
from tarc.design.noise import measurement_deviation
from tarc.design.result import Design
from tarc.design.writer import plant_name
from tarc.plotting.certificates import design_figure
from tarc.plotting.style import COLOURS, StyledFigure

STAR: dict[str, Any] = {"marker": "*", "ms": 18, "color": COLOURS[3], "mec": "black", "mew": 0.8, "ls": "", "zorder": 5}
WIDEST = 300.0
"""Spread beyond which the map has one colour."""


def plot_front(design: Design) -> Figure:
    """Draw the torque's change by noise against the error after a step, for every feasible loop and the chosen one."""
    figure = StyledFigure(figsize=(8.5, 5.0), layout="constrained")
    axes = figure.subplots()
    plant = design.plants[0]
    limit = design.law.torque_limits if design.law.torque_limit is not None else np.full(design.law.n_joints, np.inf)
    shares = 100 * design.torque_change / limit
    has_limit = bool(np.any(np.isfinite(limit)))
    loudest = int(np.argmax(shares if has_limit else design.torque_change))
    per_change = (shares if has_limit else design.torque_change)[loudest] / design.candidate.change
    heaviest = int(np.argmax(np.diag(design.shape)))
    per_error = 1e3 / float(design.shape[heaviest, heaviest])

    def points(members: list[Candidate]) -> tuple[list[float], list[float]]:
        return [per_change * loop.change for loop in members], [per_error * loop.error for loop in members]

    feasible = [loop for loop in design.candidates if loop.feasible]
    for label, colour, marker, members in (
        ("literal", COLOURS[1], "s", [loop for loop in feasible if not loop.synchronised]),
        ("synchronised", COLOURS[0], "o", [loop for loop in feasible if loop.synchronised]),
    ):
        if members:
            axes.plot(*points(members), marker, ms=3.5, alpha=0.45, color=colour, ls="", label=label)
    axes.plot(*points(design.front), color="0.4", lw=1, drawstyle="steps-post", label="Pareto front")
    axes.plot(*points([design.candidate]), label="chosen", **STAR)
    if design.noise_budget is not None and has_limit:
        allowed = 100 * design.noise_budget
        axes.axvline(allowed, color=COLOURS[2], ls="--", label=f"budget, {allowed:.3g} %")
    _log(axes, "x")
    _log(axes, "y")
    axes.set_xlabel(
        f"largest torque change per period by noise, {plant.joint_names[loudest]}, RMS "
        f"[{'% of its limit' if has_limit else plant.torque_units[loudest]}]"
    )
    axes.set_ylabel(
        f"RMS error of {plant.joint_names[heaviest]} for one step\nof 1 {plant.torque_units[heaviest]} per second "
        f"[m{plant.units[heaviest]}]"
    )
    axes.legend(frameon=False, fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.grid(alpha=0.3)
    axes.set_title(_title(design), fontsize="medium")
    return figure


def plot_optimum(design: Design) -> Figure:
    """Draw torque variation against error for the feasible loops, and the least error of any linear controller.

    Both are those of one joint, the heaviest, at the middle of its inertia.
    """
    figure = StyledFigure(figsize=(8.5, 5.0), layout="constrained")
    axes = figure.subplots()
    plant, period = design.plants[0], design.law.period
    joint = int(np.argmax(np.diag(design.shape)))
    inertia = float(design.shape[joint, joint] / design.spread**0.5)
    noise = float(measurement_deviation(design.sensor, design.law.n_joints)[joint])
    chosen = design.optimum_distances[len(design.optimum_distances) // 2]
    disturbance = noise * chosen.disturbance
    per_change = (2 / np.pi) ** 0.5 * inertia / period

    def points(members: list[Candidate]) -> tuple[list[float], list[float]]:
        found = [
            loop_deviations(loop.channel(), loop.inertia_scale * design.spread**0.5, noise, disturbance)
            for loop in members
        ]
        return [per_change * loop.change for loop in found], [1e3 * loop.error for loop in found]

    feasible = [loop for loop in design.candidates if loop.feasible]
    for label, colour, marker, is_synchronised in (
        ("literal", COLOURS[1], "s", False),
        ("synchronised", COLOURS[0], "o", True),
    ):
        members = [loop for loop in feasible if loop.synchronised is is_synchronised]
        if members:
            axes.plot(*points(members), marker, ms=3.5, alpha=0.45, color=colour, ls="", label=label)
    x, y = points([design.candidate])
    axes.plot(x, y, label="chosen", **STAR)
    changes, errors = optimal_front(
        disturbance, noise=noise, period=period, delay=design.candidate.computation_delay, count=120
    )
    bound = np.array([per_change * changes, 1e3 * errors])
    _log(axes, "x")
    _log(axes, "y")
    right, top = axes.get_xlim()[1], axes.get_ylim()[1]
    shown = (bound[0] < right) & (bound[1] < top)
    axes.plot(*bound[:, shown], color="black", lw=1.5, label="least error of any\nlinear controller")
    _log(axes, "x")
    _log(axes, "y")
    unit = plant.torque_units[joint]
    axes.set_xlabel(f"torque variation of {plant.joint_names[joint]} [{unit}/s]")
    axes.set_ylabel(f"RMS error of {plant.joint_names[joint]} [m{plant.units[joint]}]")
    axes.legend(frameon=False, fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.grid(alpha=0.3)
    walk = inertia * disturbance / period**0.5
    axes.set_title(
        f"{_title(design)}\nencoder noise, and a torque that walks by {walk:.2g} {unit} in a second, RMS",
        fontsize="medium",
    )
    return figure


def plot_reach(design: Design) -> Figure:
    """Draw the tolerated spread over window and natural frequency, and where it is the robot's.

    At one natural frequency it is drawn over the window alone. For a robot of bounded speed only the feasible loops
    are drawn, since their tolerated spread is not computed.
    """
    if design.workspace.speed is not None:
        return _region(design)
    sides = {both: _grid(design, both) for both in (False, True)}
    return _map(design, sides) if all(len(grid[1]) > 1 for grid in sides.values()) else _lines(design)


def _region(design: Design) -> Figure:
    figure = StyledFigure(figsize=(9.5, 4.4), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    feasible = [loop for loop in design.candidates if loop.feasible]
    limited = design.law.torque_limit is not None
    loudest = float(np.max(100 * design.torque_noise / design.law.torque_limits if limited else design.torque_noise))
    noise = {loop: loudest * loop.noise / design.candidate.noise for loop in feasible}
    least, most = np.log10(min(noise.values())), np.log10(max(noise.values()))
    drawn: Any = None
    for axes, synchronised in zip(panels, (False, True), strict=True):
        for degree, marker in ((2, "o"), (3, "s")):
            # the quietest scale of M̂ of each loop on top
            shown = [loop for loop in feasible if (loop.synchronised, loop.degree) == (synchronised, degree)]
            shown.sort(key=lambda loop: -noise[loop])
            drawn = axes.scatter(
                [loop.window for loop in shown],
                [loop.natural_frequency for loop in shown],
                c=[np.log10(noise[loop]) for loop in shown],
                vmin=least,
                vmax=most,
                cmap="viridis_r",
                marker=marker,
                s=30,
                label=f"degree {degree}",
            )
        if design.law.synchronised == synchronised:
            axes.plot(window_periods(design), natural_frequency(design), **STAR)
        axes.set_title("synchronised" if synchronised else "literal", fontsize="medium")
        axes.set_xlabel("window [periods]")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(alpha=0.3)
    _log(panels[0], "y")
    panels[0].set_ylabel("natural frequency [rad/s]")
    panels[1].legend(frameon=False, fontsize="small")
    bar = figure.colorbar(
        drawn,
        ax=panels,
        label=f"largest torque noise, RMS [{'% of its limit' if limited else 'N m or N'}]",
    )
    ticks = np.linspace(least, most, 6)
    bar.set_ticks(list(ticks), labels=[f"{10**tick:.2g}" for tick in ticks])
    figure.suptitle(
        f"{_title(design)}\nloops that tolerate the robot's spread, {design.spread:.3g}, with gravity, motion and "
        "margin; star: chosen",
        fontsize="medium",
    )
    return figure


def _grid(design: Design, synchronised: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return windows (w,), natural frequencies (b,) and the largest tolerated spread (b, w) of the first candidates."""
    max_spreads: dict[tuple[int, float], float] = {}
    for loop in design.candidates:
        if loop.synchronised == synchronised and loop.degree == _degree(design, synchronised):
            max_spreads[loop.window, loop.natural_frequency] = max(
                loop.max_spread, max_spreads.get((loop.window, loop.natural_frequency), 1.0)
            )
    # the neighbours of the choice, looked at later, have few windows a natural frequency and few natural frequencies
    # a window
    speeds = _frequent([speed for _, speed in max_spreads])
    windows = _frequent([window for window, speed in max_spreads if speed in speeds])
    values = np.array([[max_spreads.get((int(w), float(s)), 1.0) for w in windows] for s in speeds])
    return windows, speeds, values


def _degree(design: Design, synchronised: bool) -> int:
    """Return the degree of the law; literal loops have degree 2."""
    return design.estimator.degree if synchronised else min(design.estimator.degree, 2)


def _frequent(values: list[Any]) -> np.ndarray:
    each, counts = np.unique(values, return_counts=True)
    return each[2 * counts > counts.max()] if len(each) else each


def _map(design: Design, sides: dict[bool, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Figure:
    figure = StyledFigure(figsize=(9.5, 4.4), layout="constrained")
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
        feasible = [loop for loop in design.candidates if loop.feasible and loop.synchronised == synchronised]
        feasible = [loop for loop in feasible if loop.degree == _degree(design, synchronised)]
        axes.plot(
            [loop.window for loop in feasible],
            [loop.natural_frequency for loop in feasible],
            "o",
            color="black",
            ms=2.5,
        )
        if design.law.synchronised == synchronised:
            axes.plot(window_periods(design), natural_frequency(design), clip_on=False, **STAR)
        axes.set_facecolor("0.9")
        word = "synchronised" if synchronised else "literal"
        axes.set_title(f"{word}, degree {_degree(design, synchronised)}", fontsize="medium")
        axes.set_xlabel("window [periods]")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlim(min([windows.min(), *(loop.window for loop in feasible)]) - 0.3, windows.max())
        axes.set_ylim(speeds.min(), speeds.max())
        _log(axes, "y")
    bar = figure.colorbar(drawn, ax=panels, label="tolerated spread")
    bar.set_ticks([0, 0.5, 1, 1.5, 2, 2.5], labels=["1", "3", "10", "30", "100", "300"])
    panels[0].set_ylabel("natural frequency [rad/s]")
    figure.suptitle(
        f"{_title(design)}\n{'white line: ' if line else ''}the robot's spread, {design.spread:.3g}; dots: loops that "
        "tolerate it with gravity, motion and margin; star: chosen",
        fontsize="medium",
    )
    return figure


def _lines(design: Design) -> Figure:
    figure = StyledFigure(figsize=(8.5, 4.4), layout="constrained")
    axes = figure.subplots()
    feasible: list[Candidate] = []
    for synchronised, colour, word in ((False, COLOURS[1], "literal"), (True, COLOURS[0], "synchronised")):
        for degree, style in ((2, "-"), (3, "--")):
            best: dict[int, Candidate] = {}
            for loop in design.candidates:
                if (loop.synchronised, loop.degree) == (synchronised, degree):
                    best[loop.window] = max(
                        loop, best.get(loop.window, loop), key=lambda any: (any.feasible, any.max_spread)
                    )
            windows = sorted(best)
            if not windows:
                continue
            reach = [float(np.clip(best[window].max_spread, 1.0, 10 * WIDEST)) for window in windows]
            axes.plot(windows, reach, style, color=colour, lw=1.2, label=f"{word}, degree {degree}")
            feasible += [loop for loop in best.values() if loop.feasible]
    axes.plot([loop.window for loop in feasible], [loop.max_spread for loop in feasible], "o", color="black", ms=3.5)
    axes.axhline(design.spread, color="0.4", lw=1.5, label=f"the robot's spread, {design.spread:.3g}")
    axes.plot(window_periods(design), design.candidate.max_spread, label="chosen", **STAR)
    axes.set_xlabel("window [periods]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _log(axes, "y")
    axes.set_ylabel(f"tolerated spread\nat {natural_frequency(design):.4g} rad/s")
    axes.legend(frameon=False, fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.grid(alpha=0.3)
    figure.suptitle(
        f"{_title(design)}\ndots: loops that tolerate the robot with gravity, motion and margin", fontsize="medium"
    )
    return figure


def _title(design: Design) -> str:
    low, high = design.payload
    carried = f", {low:g} to {high:g} kg" if high > low else f", {high:g} kg" if high else ""
    rate = 1 / design.law.period
    return f"{plant_name(design.plants[0])}{carried}: {type(design.law).__name__} at {rate:.4g} Hz"


def window_periods(design: Design) -> int:
    """Return the window of the law [periods]."""
    return round(design.estimator.window / design.law.period)


def natural_frequency(design: Design) -> float:
    """Return the natural frequency of the law [rad/s]."""
    return float(np.max(np.asarray(design.law.natural_frequency, dtype=float)))


def _log(axes: Axes, which: str) -> None:
    """Make an axis logarithmic with plain numbers at its ticks."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    axes.set_xscale("log") if which == "x" else axes.set_yscale("log")
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    width = np.log10(high / low)
    steps = (1,) if width > 3 else (1, 2, 5) if width > 1 else (1, 1.5, 2, 3, 4, 5, 6, 8)
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [step * 10.0**decade for decade in decades for step in steps]
    inside = [tick for tick in ticks if low <= tick <= high]
    if len(inside) < 3:
        inside = [tick for tick in MaxNLocator(5).tick_values(low, high) if low <= tick <= high]
    axis.set_major_locator(FixedLocator(inside))
    axis.set_major_formatter("{x:.4g}")
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


FIGURES: dict[str, Callable[[Design], Figure]] = {
    "front": plot_front,
    "reach": plot_reach,
    "optimum": plot_optimum,
}

MAX_MAP_WINDOW = 20
"""Longest window [periods] for which the law's figure is drawn: its map looks at longer ones still."""


def design_figures(design: Design) -> dict[str, Figure]:
    """Return all figures of a design by name; that of the law only for a short window and a constant M̂."""
    figures = {kind: draw(design) for kind, draw in FIGURES.items()}
    if window_periods(design) <= MAX_MAP_WINDOW and not design.law.has_model:
        figures["law"] = design_figure(
            LawCertification(
                law=design.law,
                channels=decoupled_channels(design.law, design.law.actuation_delay),
                certificates=design.certificates,
                computation_delay=design.law.actuation_delay,
            )
        )
    return figures
