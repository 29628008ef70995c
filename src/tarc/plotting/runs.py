"""Figures of runs, for the screen and for the column of a paper."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from tarc.core import validation as check
from tarc.plotting.style import COLOURS, StyledFigure
from tarc.simulation.run_events import RunEvent, run_events, saturated_spans

if TYPE_CHECKING:
    from xarray import Dataset

    from tarc.simulation.run import Run


STYLES = ("screen", "column")
COLUMN_WIDTH = 3.5
"""Width of a column of a paper [in]."""
COLUMN_FONT_SIZE = 7.0
COLUMN_LINE_WIDTH = 0.8
EVENT_LINE: dict[str, Any] = {"color": "0.35", "ls": (0, (4, 2)), "lw": 0.9}
SPAN_COLOUR = "0.9"
SATURATION_COLOUR = "#b00020"
RISING_COLOUR, FALLING_COLOUR = COLOURS[3], COLOURS[5]
MAX_NAME = 24
"""Letters of a joint's name that fit above a panel."""
LEGEND_LINE = 0.15
"""Height that a line of the legend above the panels needs [in]."""
COLUMN_LETTERS = 46
"""Letters in a line of a figure for a column."""
MAX_EVENT_LABELS = 4
JOINTS_PER_ROW = 6
"""Joints in a row of the legend of the torques."""
MOST_SAMPLES = 99.7
"""Percentage of the samples of an error that its panel shows, so that a start or a divergence hides nothing."""
MAX_LINEAR_RATIO = 20.0
"""Ratio of the largest to the smallest peak of the gains up to which their axis is linear."""


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
    """Draw, from top to bottom: the error of every joint, its norm, the torques of each law, and the gains."""
    first = next(iter(runs.values())).data
    n_joints = first.sizes["joint"]
    gains = {name: run for name, run in runs.items() if "gain" in run.data}
    error_shape = _rows_and_columns(n_joints, 4)
    torque_shape = _rows_and_columns(len(runs), 3)
    legend_height = 0.13 * _rows_and_columns(n_joints, JOINTS_PER_ROW)[0] + 0.05
    heights = [0.85 * error_shape[0], 1.0, 1.1 * torque_shape[0], legend_height]
    heights += [1.0, 0.1 + 0.1 * len(gains)] if gains else []
    figure = StyledFigure(figsize=(12, 1.85 * sum(heights)), layout="constrained")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    events = _shown_events(runs)

    errors = _joint_errors(figure, grid[0].subgridspec(*error_shape), runs, 1.0)
    norm = figure.add_subplot(grid[1])
    _error_norm(norm, runs, 1.0)
    torques = _torque_panels(figure, grid[2].subgridspec(*torque_shape), runs)
    key = figure.add_subplot(grid[3])
    key.set_axis_off()
    lines, labels = torques[0].get_legend_handles_labels()
    columns = min(JOINTS_PER_ROW, n_joints)
    key.legend(lines, labels, loc="center", ncols=columns, fontsize="small", frameon=False, borderpad=0)
    panels = [*errors, norm, *torques]
    if gains:
        panels.append(figure.add_subplot(grid[4]))
        _gain(panels[-1], gains, _colours(runs), 1.0)
        panels.append(figure.add_subplot(grid[5], sharex=panels[-1]))
        _gain_directions(panels[-1], gains)
        panels[-2].tick_params(labelbottom=False)
    for axes in panels:
        axes.margins(x=0)
        _mark(axes, events)
    panels[-1].set_xlabel("time [s]")
    directions = [Patch(color=RISING_COLOUR, label="ĉ rises"), Patch(color=FALLING_COLOUR, label="ĉ falls")]
    _figure_legend(figure, runs, events, directions if gains else [], 115)
    return figure


def _column(runs: dict[str, "Run"]) -> Figure:
    """Draw the error of every joint, the torque of the strongest one and the gains, for a column of a paper."""
    size, line = COLUMN_FONT_SIZE, COLUMN_LINE_WIDTH
    first = next(iter(runs.values())).data
    gains = {name: run for name, run in runs.items() if "gain" in run.data}
    n_joints = first.sizes["joint"]
    error_shape = _rows_and_columns(n_joints, 2 if n_joints <= 6 else 3)
    heights = [0.8 * error_shape[0], *[1.0] * (2 if gains else 1)]
    figure = StyledFigure(figsize=(COLUMN_WIDTH, 1.15 * sum(heights) + 0.3), layout="constrained")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    letters = int(COLUMN_LETTERS / error_shape[1])
    panels = _joint_errors(figure, grid[0].subgridspec(*error_shape), runs, line, letters, 2)
    torque = figure.add_subplot(grid[1])
    strongest = int(np.argmax(np.abs(first["torque"].values).max(axis=0)))
    for colour, _, run in _drawn(runs):
        torque.plot(run.data["time"], run.data["torque"][:, strongest], color=colour, lw=line * 0.8)
        for start, stop in _saturation(run):
            torque.axvspan(start, stop, 0.0, 0.04, color=SATURATION_COLOUR, lw=1)
    torque.set_ylabel(f"{_output(first)} [{_unit(first, 'torque')}]")
    torque.set_title(f"{_output(first)} of {_short(first['joint'].values[strongest])}")
    panels.append(torque)
    if gains:
        panels.append(figure.add_subplot(grid[2]))
        _gain(panels[-1], gains, _colours(runs), line)
    panels[-1].set_xlabel("time [s]")
    events = _shown_events(runs)
    for axes in panels:
        axes.margins(x=0)
        axes.tick_params(labelsize=size - 1, length=2, pad=2)
        axes.title.set_fontsize(size)
        axes.xaxis.label.set_fontsize(size)
        axes.yaxis.label.set_fontsize(size)
        _mark(axes, events)
    _figure_legend(figure, runs, events, [], 64, size - 0.5)
    return figure


def _rows_and_columns(count: int, most: int) -> tuple[int, int]:
    """Return rows and columns of a grid of panels with a largest number of columns, filled evenly."""
    rows = int(np.ceil(count / most))
    return rows, int(np.ceil(count / rows))


def _colours(runs: dict[str, "Run"]) -> dict[str, str]:
    """Return the colour of each run, by its name."""
    return {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(runs)}


def _drawn(runs: dict[str, "Run"]) -> list[tuple[str, str, "Run"]]:
    """Return colour, name and run, the first run last, so that it lies on top."""
    return [(colour, name, runs[name]) for name, colour in _colours(runs).items()][::-1]


def _short(name: object, letters: int = MAX_NAME) -> str:
    """Return a name, cut in its middle to fit above a narrow panel."""
    text = str(name)
    kept = letters - 1
    return text if len(text) <= letters else f"{text[: kept // 2]}…{text[-(kept - kept // 2) :]}"


def _figure_legend(
    figure: Figure,
    runs: dict[str, "Run"],
    events: list[RunEvent],
    more: Sequence[Artist],
    width: int,
    size: float | str = "small",
) -> None:
    """Draw the names of the laws and the events above all panels, in as many columns as fit into a width [letters]."""
    handles: list[Artist] = [Line2D([], [], color=colour, label=name) for colour, name, _ in _drawn(runs)[::-1]]
    for label, event in {event.label: event for event in events}.items():
        look: dict[str, Any] = {"color": SPAN_COLOUR, "lw": 6} if _is_area(event) else EVENT_LINE
        handles.append(Line2D([], [], label=label, **look))
    if any(_saturation(run) for run in runs.values()):
        handles.append(Line2D([], [], color=SATURATION_COLOUR, lw=4, label=f"{_output_of(runs)} at its limit"))
    handles += more
    longest = max(len(str(handle.get_label())) for handle in handles)
    ncols = min(len(handles), max(1, width // (longest + 6)))
    figure.set_figheight(figure.get_figheight() + LEGEND_LINE * int(np.ceil(len(handles) / ncols)))
    figure.legend(handles=handles, loc="outside upper left", ncols=ncols, fontsize=size, frameon=False)


def _output_of(runs: dict[str, "Run"]) -> str:
    return _output(next(iter(runs.values())).data)


def _output(data: "Dataset") -> str:
    """Return what the law outputs: a torque, or a command of inner loops."""
    return "torque" if _unit(data, "torque").startswith("N") else "command"


def _unit(data: "Dataset", name: str) -> str:
    return str(data[name].attrs["units"])


def _shown_events(runs: dict[str, "Run"]) -> list[RunEvent]:
    """Return the events of the longest run, without those that last as long as it does; many are named by kind."""
    longest = max((run.data for run in runs.values()), key=lambda data: data.sizes["time"])
    end = float(longest["time"].values[-1])
    events = [event for event in run_events(longest) if event.start_time > 0 or event.stop_time < end]
    if len({event.label for event in events}) <= MAX_EVENT_LABELS:
        return events
    return [event._replace(label=f"{event.kind} changes") for event in events]


def _is_area(event: RunEvent) -> bool:
    return event.kind == "disturbance" and event.stop_time > event.start_time


def _mark(axes: Axes, events: list[RunEvent]) -> None:
    """Mark disturbances as areas, and other events as lines where they start and stop, behind the curves."""
    low, high = axes.get_xlim()
    for event in events:
        if _is_area(event):
            axes.axvspan(max(event.start_time, low), event.stop_time, color=SPAN_COLOUR, lw=0, zorder=0)
            continue
        for time in {event.start_time, event.stop_time}:
            if low < time < high * 0.999:
                axes.axvline(time, zorder=0.5, **EVENT_LINE)


def _joint_errors(
    figure: Figure, grid: GridSpecBase, runs: dict[str, "Run"], line: float, letters: int = MAX_NAME, n_ticks: int = 4
) -> list[Axes]:
    """Draw the error of every joint in a panel of its own, with a scale that shows the most of the run.

    Titles have the name of the joint, cut to a number of letters, and its unit where it differs from the first.
    """
    first = next(iter(runs.values())).data
    units = first["joint_unit"].values
    panels = []
    for i, joint in enumerate(first["joint"].values):
        row, column = divmod(i, grid.ncols)
        axes = figure.add_subplot(grid[row, column])
        axes.axhline(0.0, color="0.6", lw=0.6)
        reach = 0.0
        for colour, _, run in _drawn(runs):
            error = 1e3 * (run.data["position"][:, i] - run.data["reference"][:, i]).values
            axes.plot(run.data["time"], error, color=colour, lw=0.8 * line)
            reach = max(reach, float(np.percentile(np.abs(error), MOST_SAMPLES)))
        unit = f" [m{units[i]}]" if units[i] != units[0] else ""
        axes.set_title(_short(joint, letters - len(unit)) + unit, fontsize="medium")
        if reach > 0:
            axes.set_ylim(-1.25 * reach, 1.25 * reach)
        axes.yaxis.set_major_locator(MaxNLocator(n_ticks, symmetric=True))
        axes.xaxis.set_major_locator(MaxNLocator(4))
        if column == 0 and row == (grid.nrows - 1) // 2:
            axes.set_ylabel(f"error [m{units[0]}]")
        if i + grid.ncols < len(units):
            axes.tick_params(labelbottom=False)
        axes.grid(alpha=0.3)
        panels.append(axes)
    return panels


def _torque_panels(figure: Figure, grid: GridSpecBase, runs: dict[str, "Run"]) -> list[Axes]:
    """Draw the torques of all joints, in a panel for each law, with its saturation at the lower edge."""
    panels: list[Axes] = []
    for k, (name, run) in enumerate(runs.items()):
        data = run.data
        row, column = divmod(k, grid.ncols)
        axes = figure.add_subplot(grid[row, column], sharey=panels[0] if panels else None)
        for i, joint in enumerate(data["joint"].values):
            colour, style = COLOURS[i % len(COLOURS)], ("-", "--")[i // len(COLOURS) % 2]
            axes.plot(data["time"], data["torque"][:, i], style, color=colour, lw=0.8, label=_short(joint, 18))
        axes.set_title(f"{_output(data)}, {name}", fontsize="medium")
        axes.xaxis.set_major_locator(MaxNLocator(5))
        if column == 0:
            axes.set_ylabel(f"{_output(data)} [{_unit(data, 'torque')}]")
        for start, stop in _saturation(run):
            axes.axvspan(start, stop, 0.0, 0.04, color=SATURATION_COLOUR, lw=1)
        if k + grid.ncols < len(runs):
            axes.tick_params(labelbottom=False)
        axes.grid(alpha=0.3)
        panels.append(axes)
    return panels


def _saturation(run: "Run") -> list[tuple[float, float]]:
    """Return the intervals in which a torque is at its limit; those that the figure cannot part are one."""
    return saturated_spans(run.data, float(run.data["time"].values[-1]) / 200)


def error_norms(data: "Dataset") -> dict[str, np.ndarray]:
    """Return the Euclidean norm of the tracking error over the joints of each unit, shape (k,), by the unit."""
    error = (data["position"] - data["reference"]).values
    units = data["joint_unit"].values
    return {str(unit): np.linalg.norm(error[:, units == unit], axis=1) for unit in dict.fromkeys(units)}


def _error_norm(axes: Axes, runs: dict[str, "Run"], line: float) -> None:
    """Draw the Euclidean norm of the tracking error over the joints, logarithmic; one for each unit of the joints."""
    errors = []
    for colour, _, run in _drawn(runs):
        for style, error in zip(("-", "--"), error_norms(run.data).values(), strict=False):
            axes.semilogy(run.data["time"], np.maximum(error, 1e-9) * 1e3, style, color=colour, lw=line)
            errors.append(error)
    units = list(error_norms(next(iter(runs.values())).data))
    axes.set_ylabel(f"‖error‖ [{' or '.join(f'm{unit}' for unit in units)}]")
    low = min(float(np.percentile(error, 1)) for error in errors) * 1e3
    high = max(float(np.max(error)) for error in errors) * 1e3
    axes.set_ylim(max(low, 1e-6) / 2, max(high, 1e-5) * 2)
    is_narrow = high < 100 * low
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if is_narrow else (1,), numticks=6))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    if len(units) > 1:
        lines = [Line2D([], [], color="0.3", ls=style, label=unit) for style, unit in zip("-:", units, strict=False)]
        lines[1].set_linestyle("--")
        axes.legend(
            handles=lines, fontsize="small", loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False
        )
    axes.grid(alpha=0.3)


def _gain(axes: Axes, runs: dict[str, "Run"], colours: dict[str, str], line: float) -> None:
    """Draw the gains of all laws; on a logarithmic axis where they differ much."""
    peaks = []
    for name, run in runs.items():
        gain = run.data["gain"].values
        axes.plot(run.data["time"], gain, color=colours[name], lw=line)
        peaks.append(float(gain.max()))
    high = max(peaks) or 1.0
    positive = [peak for peak in peaks if peak > 0]
    if positive and high > MAX_LINEAR_RATIO * min(positive):
        axes.set_yscale("log", nonpositive="clip")
        axes.yaxis.set_major_locator(LogLocator(numticks=5))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_ylim(min(positive) / 30, 2 * high)
    else:
        axes.set_ylim(0.0, 1.08 * high)
    axes.set_ylabel("gain ĉ [" + str(next(iter(runs.values())).data["gain"].attrs["units"]) + "]")
    axes.grid(alpha=0.3)


def _gain_directions(axes: Axes, runs: dict[str, "Run"]) -> None:
    """Draw for each law a band that shows where its gain rises and falls."""
    for row, run in enumerate(runs.values()):
        gain = run.data["gain"].values
        change = np.diff(gain, append=gain[-1])
        for sign, colour in ((1, RISING_COLOUR), (-1, FALLING_COLOUR)):
            axes.fill_between(run.data["time"], row - 0.4, row + 0.4, where=sign * change > 0, color=colour, lw=0)
    axes.set_yticks(range(len(runs)), [_short(name, 16) for name in runs], fontsize="small")
    axes.set_ylim(len(runs) - 0.5, -0.5)
