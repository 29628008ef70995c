"""Figure and page of a replayed log."""

import base64
import io
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tarc.estimators.algebraic import Algebraic
from tarc.logs.tables import Table, replay_tables
from tarc.plotting.style import COLOURS, StyledFigure

if TYPE_CHECKING:
    from tarc.logs.replayed import Replay

MAX_POINTS = 4000
"""Most points of a line over time."""
DETAIL = 0.2
"""Part of the record that shows single accelerations [s]."""
DOTS_PER_INCH = 110
JOINTS_ACROSS = 4
"""Most torque panels side by side."""

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; margin: 0.5rem 0 1.5rem; }
td, th { border-bottom: 1px solid #ccc; padding: 0.2rem 0.8rem; text-align: right; white-space: nowrap; }
td:first-child, th:first-child { text-align: left; }
img { max-width: 100%; }
div { overflow-x: auto; }
"""


def replay_figure(replay: "Replay") -> Figure:
    """Draw the steps of time, the residual of the positions, the accelerations, and the torque of each joint."""
    torque, n = replay.record.torque, replay.log.n_joints
    across = min(n, JOINTS_ACROSS)
    rows = 0 if torque is None else int(np.ceil(n / across))
    figure = StyledFigure(figsize=(12, 6.4 + 1.9 * rows), layout="constrained")
    grid = figure.add_gridspec(2 + rows, 2 * across, height_ratios=[1.5, 1.5, *([1.0] * rows)])
    _steps(figure.add_subplot(grid[0, :across]), replay)
    _stamps(figure.add_subplot(grid[0, across:]), replay)
    _residuals(figure.add_subplot(grid[1, :across]), replay)
    _accelerations(figure.add_subplot(grid[1, across:]), replay)
    for i in range(n if torque is not None else 0):
        row, column = divmod(i, across)
        _torque(figure.add_subplot(grid[2 + row, 2 * column : 2 * column + 2]), replay, i, column == 0)
    if rows:
        handles = figure.axes[4].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=3, fontsize="small", title="torque over time [s]")
    figure.suptitle(f"{replay.log.label}: {replay.record.times[-1]:.3g} s, {n} joints", fontsize="medium")
    return figure


def _steps(axes: Axes, replay: "Replay") -> None:
    T = replay.timing.period
    limit = 5.5
    bins = list(np.arange(-0.05, limit + 0.1, 0.1))
    for values, colour, name in (
        (np.diff(replay.log.times), COLOURS[1], "stamped"),
        (np.diff(replay.timing.times), COLOURS[0], "repaired"),
    ):
        axes.hist(np.minimum(values / T, limit), bins, histtype="step", color=colour, lw=1.2, label=name)
    axes.set_yscale("log")
    axes.set_xlabel(f"step between rows [periods of {1e3 * T:g} ms]")
    axes.set_ylabel("rows")
    _legend_above(axes)


def _stamps(axes: Axes, replay: "Replay") -> None:
    stamps = replay.log.times - replay.log.times[0]
    late = 1e3 * (stamps - replay.timing.times)
    every = max(len(late) // MAX_POINTS, 1)
    axes.plot(replay.timing.times[::every], late[::every], ".", ms=2, color=COLOURS[1])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("stamp − repaired time [ms]")


def _residuals(axes: Axes, replay: "Replay") -> None:
    places = np.arange(replay.log.n_joints)
    axes.bar(places - 0.2, 1e6 * replay.timing.residual_before, 0.4, color=COLOURS[1], label="stamped")
    axes.bar(places + 0.2, 1e6 * replay.timing.residual, 0.4, color=COLOURS[0], label="repaired")
    axes.set_yscale("log")
    axes.set_xticks(places, replay.log.joint_names, rotation=30 if replay.log.n_joints > 4 else 0)
    axes.set_ylabel("position off the motion [µrad or µm]")
    _legend_above(axes)


def _accelerations(axes: Axes, replay: "Replay") -> None:
    record, check = replay.record, replay.windows[0]
    i = int(np.argmax(np.std(record.motion(record.times, 2), axis=0)))
    length = max(round(DETAIL / record.period), 8)
    jerk = np.abs(record.motion(record.times, 3)[:, i])
    first = int(np.argmax(jerk[length:-length])) + length // 2
    part = slice(first, first + length)
    times = record.times[part]
    weights = _weights(check.window, record.period)
    estimate = np.convolve(record.position[:, i], weights)[: len(record.times)][part]
    axes.plot(times, estimate, color=COLOURS[0], lw=1, label=f"window of {1e3 * check.window:g} ms")
    axes.plot(times, record.motion(times, 2)[:, i], color="0.3", lw=1, label="motion")
    axes.plot(
        times,
        record.motion(times - check.predicted_delay, 2)[:, i],
        "--",
        color=COLOURS[1],
        lw=1,
        label="motion, delayed",
    )
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"acceleration, {replay.log.joint_names[i]}")
    axes.margins(x=0)
    _legend_above(axes)


def _legend_above(axes: Axes) -> None:
    axes.legend(fontsize="small", loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)


def _weights(window: float, period: float) -> np.ndarray:
    return Algebraic(window=window).with_period(period).weights(2)


def _torque(axes: Axes, replay: "Replay", i: int, first: bool) -> None:
    record = replay.record
    every = max(len(record.times) // MAX_POINTS, 1)
    times = record.times[::every]
    if replay.shadow is not None:
        axes.plot(times, replay.shadow.torque[::every, i], color=COLOURS[1], lw=1.5, label="law in shadow mode")
    if record.torque is not None:
        axes.plot(times, record.torque[::every, i], color="0.35", lw=0.5, label="recorded")
        low, high = np.min(record.torque[:, i]), np.max(record.torque[:, i])
        axes.set_ylim(low - 0.25 * (high - low), high + 0.25 * (high - low) + 1e-9)
    if replay.model is not None:
        axes.plot(times, replay.model.torque[::every, i], color=COLOURS[0], lw=0.9, label="model")
    explained = "" if replay.model is None else f", {replay.model.explained[i]:.1%} explained"
    axes.set_title(f"{replay.log.joint_names[i]}{explained}", fontsize="small")
    axes.set_ylabel("torque [N m or N]" if first else "")
    axes.tick_params(labelsize="x-small")
    axes.margins(x=0)


def replay_page(replay: "Replay") -> str:
    """Return figure and tables as a page of HTML that links to nothing."""
    buffer = io.BytesIO()
    replay_figure(replay).savefig(buffer, dpi=DOTS_PER_INCH)
    picture = base64.b64encode(buffer.getvalue()).decode("ascii")
    title = escape(f"Replay of {replay.log.label}")
    parts = [_html_table(table) for table in replay_tables(replay)]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{STYLE}</style></head>\n<body><h1>{title}</h1>\n"
        f'<img alt="steps, residuals, accelerations and torques" src="data:image/png;base64,{picture}">\n'
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _html_table(table: Table) -> str:
    title, header, rows = table

    def line(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    head = line(header, "th") if any(header) else ""
    body = "\n".join(line(row, "td") for row in rows)
    return f"<h2>{escape(title)}</h2>\n<div><table>{head}\n{body}</table></div>"
