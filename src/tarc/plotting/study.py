"""Figures of studies: rates, distributions, paired ratios, what matters, the worst case and rare events."""

from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, MaxNLocator, NullFormatter

from tarc.plotting.style import COLOURS, StyledFigure

if TYPE_CHECKING:
    from tarc.study.rare_events import RareProbability
    from tarc.study.sensitivity import Sensitivity
    from tarc.study.statistics import Interval, PairedComparison

POINTS = 400
"""Points of a distribution's curve."""

SCATTERED = 1000
"""Runs of a scatter matrix: the first ones."""

FAILED = "#D55E00"
"""Colour of runs that diverged."""

FEW_RUNS = 300
"""Runs up to which the points of a scatter matrix are larger."""

FEW_VALUES = 6
"""Different values of a draw up to which each has a mark."""

MANY_TIMES = 30
"""Ratio of the largest to the least value of a draw from which on its axis is logarithmic."""

STYLES = ("-", "--", ":", "-.")
"""Line styles of a distribution: the next one where the colours have been used."""

MAX_LAWS = len(COLOURS)
"""Laws of a figure of what matters: the first ones, since each needs a colour."""

MAX_ROWS = 20
"""Draws of a figure of what matters; of more, those that matter to none of its laws are left out."""

WIDTH = 7.6
ROW = 0.34


def rate_figure(rates: Mapping[str, "Interval"], label: str = "runs that completed") -> Figure:
    """Draw the success rate of every law, with its interval."""
    figure, axes = _rows(list(rates))
    for row, interval in enumerate(rates.values()):
        _bar(axes, row, [100 * end for end in interval], COLOURS[row % len(COLOURS)])
    axes.set_xlabel(f"{label} [%]")
    low = 100 * min(interval.low for interval in rates.values())
    axes.set_xlim(max(low - 0.1 * (100 - low) - 0.01, 0), 100 + 0.04 * (100 - low) + 0.01)
    return figure


def distribution_figure(
    values: Mapping[str, np.ndarray], quantiles: Mapping[str, Mapping[float, "Interval"]], label: str
) -> Figure:
    """Draw the share of runs up to each value of a measure, with the intervals of quantiles.

    Parameters
    ----------
    values
        Measure of every run by law, each of shape (runs,); NaN for a run that diverged, which is in no share.
    quantiles
        Intervals by law and probability.
    label
        Of the measure, with its unit.
    """
    is_crowded = len(values) > len(COLOURS)
    height = max(3.4, 0.16 * len(values) + 0.4) if is_crowded else 3.4
    figure = StyledFigure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots()
    shown = []
    for place, (name, column) in enumerate(values.items()):
        ordered = np.sort(column[np.isfinite(column)])
        colour, style = COLOURS[place % len(COLOURS)], STYLES[place // len(COLOURS) % len(STYLES)]
        if ordered.size:
            chosen = np.unique(np.linspace(0, ordered.size - 1, POINTS).astype(int))
            axes.plot(ordered[chosen], 100 * (chosen + 1) / column.size, color=colour, ls=style, lw=1.4, label=name)
            shown.append(ordered)
        for probability, interval in quantiles[name].items():
            ends = [end for end in (interval.low, interval.high) if np.isfinite(end)]
            if len(ends) == 2:
                axes.plot(ends, [100 * probability] * 2, color=colour, lw=5, alpha=0.35, solid_capstyle="butt")
    if shown and min(part[0] for part in shown) > 0 and max(p[-1] for p in shown) > 5 * min(p[0] for p in shown):
        _log(axes, axes.xaxis, np.concatenate([part[[0, -1]] for part in shown]))
    axes.set_xlabel(label)
    axes.set_ylabel("runs up to this value [%]")
    axes.set_ylim(0, 101)
    axes.grid(alpha=0.3)
    if is_crowded:
        figure.legend(loc="outside right upper", fontsize="x-small", frameon=False)
    elif shown:
        axes.legend(fontsize="small", frameon=False, loc="lower right")
    return figure


def ratio_figure(comparisons: Sequence["PairedComparison"], label: str) -> Figure:
    """Draw the median ratio of a measure to that of the reference, with its interval, for every other law."""
    figure, axes = _rows([comparison.law for comparison in comparisons])
    ends = []
    for row, comparison in enumerate(comparisons):
        colour = {"less": COLOURS[2], "more": COLOURS[1], "open": "0.5"}[comparison.verdict]
        _bar(axes, row, list(comparison.ratio), colour)
        ends += [end for end in comparison.ratio if np.isfinite(end) and end > 0]
    axes.axvline(1.0, color="0.5", lw=1, ls="--", zorder=0)
    _log(axes, axes.xaxis, np.array([*ends, 1.0]))
    axes.set_xlabel(f"{label} over that of {comparisons[0].reference}, median over the draws")
    return figure


def sensitivity_figure(sensitivities: Mapping[str, "Sensitivity"], keys: Sequence[str]) -> Figure:
    """Draw the first-order index of each draw with its interval, and the rank coefficient.

    Parameters
    ----------
    sensitivities
        Of each law. The first `MAX_LAWS` are drawn.
    keys
        The draws. Of more than `MAX_ROWS`, those whose index is above zero for one of these laws.
    """
    sensitivities = dict(islice(sensitivities.items(), MAX_LAWS))
    if len(keys) > MAX_ROWS:
        matters = [key for key in keys if any(found.first_order[key].low > 0 for found in sensitivities.values())]
        keys = (matters or list(keys))[:MAX_ROWS]
    count = len(sensitivities)
    figure = StyledFigure(figsize=(WIDTH, 1.1 + ROW * len(keys) * (0.7 + 0.4 * count)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for place, (name, found) in enumerate(sensitivities.items()):
        rows = np.arange(len(keys)) + (place - (count - 1) / 2) * 0.7 / count
        colour = COLOURS[place % len(COLOURS)]
        for row, key in zip(rows, keys, strict=True):
            _bar(left, row, list(found.first_order[key]), colour, size=4)
            if (coefficient := found.rank_coefficients[key]) is not None:
                _bar(right, row, list(coefficient), colour, size=4)
        left.plot([], [], "o", color=colour, ms=4, label=name)
    left.set_yticks(range(len(keys)), keys, fontsize="small")
    left.set_ylim(len(keys) - 0.5, -0.5)
    left.set_xlim(-0.03, 1.03)
    left.set_xlabel("share of the variance, first order")
    right.axvline(0.0, color="0.5", lw=1, ls="--", zorder=0)
    right.set_xlim(-1.05, 1.05)
    right.set_xlabel("rank regression coefficient")
    for axes in (left, right):
        axes.grid(alpha=0.3, axis="x")
    if count > 1:
        figure.legend(loc="outside upper center", ncols=min(count, 5), fontsize="small", frameon=False)
    return figure


def scatter_figure(draws: Mapping[str, np.ndarray], measure: np.ndarray, label: str) -> Figure:
    """Draw a measure over each draw, and the draws over each other with the measure as colour.

    Parameters
    ----------
    draws
        Values by key, each of shape (runs,), numbers; those that matter most first.
    measure
        Of every run, shape (runs,); NaN for one that diverged, which is a cross.
    label
        Of the measure, with its unit.
    """
    keys, count = list(draws), len(draws)
    columns = {key: np.asarray(column, dtype=float)[:SCATTERED] for key, column in draws.items()}
    values = measure[:SCATTERED]
    has_value = np.isfinite(values)
    figure = StyledFigure(figsize=(WIDTH, 0.4 + 1.65 * count), layout="constrained")
    grid = figure.subplots(count, count, squeeze=False, sharex="col")
    is_log = bool(np.any(has_value)) and float(np.min(values[has_value])) > 0
    colours = np.log(values[has_value]) if is_log else values[has_value]
    for row in range(count):
        for column in range(count):
            axes: Axes = grid[row, column]
            if column >= count - row:
                axes.set_axis_off()
                continue
            x = columns[keys[column]]
            if row == 0:
                _measure_panel(axes, x, values, is_log)
            else:
                y = columns[keys[count - row]]
                axes.scatter(x[has_value], y[has_value], c=colours, cmap="viridis", s=5, lw=0, rasterized=True)
                axes.plot(x[~has_value], y[~has_value], "x", color=FAILED, ms=3.5, mew=0.9)
                _draw_axis(axes, axes.yaxis, y)
            _draw_axis(axes, axes.xaxis, x)
            _scatter_labels(axes, keys, row, column, label)
    return figure


def _measure_panel(axes: Axes, x: np.ndarray, values: np.ndarray, is_log: bool) -> None:
    """Draw the measure over a draw; runs that diverged stand at the top."""
    has_value = np.isfinite(values)
    size, alpha = (2.5, 0.5) if x.size > FEW_RUNS else (5.0, 0.8)
    axes.plot(x[has_value], values[has_value], ".", color=COLOURS[0], ms=size, alpha=alpha, mew=0, rasterized=True)
    if is_log:
        _log(axes, axes.yaxis, values[has_value])
    transform = axes.get_xaxis_transform()
    axes.plot(x[~has_value], np.full(int(np.sum(~has_value)), 0.98), "x", color=FAILED, ms=3.5, transform=transform)


def _draw_axis(axes: Axes, axis: Axis, column: np.ndarray) -> None:
    """Mark the values of a choice; make the axis of a draw over decades logarithmic."""
    different = np.unique(column)
    if different.size <= FEW_VALUES:
        axis.set_major_locator(FixedLocator(different.tolist()))
        axis.set_major_formatter("{x:g}")
    elif different[0] > 0 and different[-1] > MANY_TIMES * different[0] and np.median(column) < different[-1] / 4:
        _log(axes, axis, different[[0, -1]])
    else:
        axis.set_major_locator(MaxNLocator(3))


def _scatter_labels(axes: Axes, keys: Sequence[str], row: int, column: int, label: str) -> None:
    """Label the outer axes of the triangle."""
    count = len(keys)
    axes.tick_params(labelsize="x-small")
    is_last = column == count - row - 1
    axes.tick_params(labelbottom=is_last, labelleft=column == 0)
    if is_last:
        axes.set_xlabel(keys[column], fontsize="x-small")
    if column == 0:
        axes.set_ylabel(label if row == 0 else keys[count - row], fontsize="x-small")


def worst_case_figure(errors: Mapping[str, tuple[np.ndarray, np.ndarray]], label: str, threshold: float) -> Figure:
    """Draw the norm of the error over time of several runs, such as a typical one and the worst.

    Parameters
    ----------
    errors
        Time [s] and norm of the error by the run's name, each of shape (k,).
    label
        Of the error, with its unit.
    threshold
        Error beyond which a run has diverged, in the same unit; drawn where a run comes near.
    """
    figure = StyledFigure(figsize=(WIDTH, 3.0), layout="constrained")
    axes = figure.subplots()
    high = 0.0
    for place, (name, (time, error)) in enumerate(errors.items()):
        axes.semilogy(time, np.maximum(error, 1e-6), color=COLOURS[place % len(COLOURS)], lw=1.0, label=name)
        high = max(high, float(np.max(error)))
    if high > 0.1 * threshold:
        axes.axhline(threshold, color=FAILED, ls="--", lw=1)
    low = min(float(np.percentile(error, 2)) for _, error in errors.values())
    axes.set_ylim(max(low, 1e-6) / 2, 2 * max(high, 1e-6))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    axes.margins(x=0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", frameon=False, loc="upper left", ncols=3, bbox_to_anchor=(0.0, 1.13))
    return figure


def levels_figure(found: "RareProbability", label: str, transform: Callable[[float], float] = float) -> Figure:
    """Draw the probability over the levels of each estimate, and the mean of the estimates with its interval.

    Parameters
    ----------
    found
        The estimates.
    label
        Of the levels.
    transform
        From a level to what is drawn, such as from a logarithm to its number.
    """
    figure = StyledFigure(figsize=(WIDTH, 3.4), layout="constrained")
    axes = figure.subplots()
    for levels in found.levels:
        thresholds = [transform(level.threshold) for level in levels]
        probabilities = np.cumprod([level.probability for level in levels])
        axes.semilogy(thresholds, probabilities, ".-", color=COLOURS[0], alpha=0.4, lw=1, ms=5)
    estimate, low, high = found.probability
    axes.errorbar(
        [transform(found.threshold)],
        [estimate],
        [[estimate - low], [high - estimate]],
        fmt="o",
        color=COLOURS[1],
        capsize=4,
    )
    axes.set_xlabel(label)
    axes.set_ylabel("probability of as much or more")
    axes.grid(alpha=0.3)
    return figure


def _rows(names: Sequence[str]) -> tuple[Figure, Axes]:
    """Return a figure with one row per name."""
    figure = StyledFigure(figsize=(WIDTH, 0.9 + ROW * max(len(names), 1)), layout="constrained")
    axes = figure.subplots()
    axes.set_yticks(range(len(names)), names, fontsize="small")
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(alpha=0.3, axis="x")
    return figure, axes


def _bar(axes: Axes, row: float, ends: Sequence[float], colour: str, size: float = 6) -> None:
    """Draw an estimate with its interval; an end that is infinite is left open."""
    estimate, low, high = ends
    if np.isfinite(estimate):
        drawn = [end if np.isfinite(end) else estimate for end in (low, high)]
        axes.plot(drawn, [row, row], color=colour, lw=2, solid_capstyle="butt")
        axes.plot([estimate], [row], "o", color=colour, ms=size)


def _log(axes: Axes, axis: Axis, values: np.ndarray) -> None:
    """Make an axis logarithmic, with few round numbers."""
    (axes.set_xscale if axis is axes.xaxis else axes.set_yscale)("log")
    decades = float(np.ptp(np.log10(values[values > 0]))) if np.any(values > 0) else 1.0
    subs = (
        np.arange(1.0, 10.0, 0.1 if decades < 0.15 else 0.5).tolist()
        if decades < 0.5
        else [1, 2, 5]
        if decades < 1.5
        else [1]
    )
    axis.set_major_locator(LogLocator(subs=subs, numticks=8 if axis is axes.xaxis else 5))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())
