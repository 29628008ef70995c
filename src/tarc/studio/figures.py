"""Figures of the page as plain dictionaries that plotly.js draws; nothing is computed here but colours and shapes."""

import math
from typing import Any

import numpy as np

from tarc.core.types import Array
from tarc.studio.design_state import CONTROLS, DesignState
from tarc.studio.results import CurvePair, LoopAnalysis, RobotFacts

EMPTY: dict[str, Any] = {
    "data": [],
    "layout": {
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "xaxis": {"visible": False},
        "yaxis": {"visible": False},
    },
    "config": {"displayModeBar": False},
}
"""A figure before its first result."""
GRID = "rgba(128,128,128,0.25)"
STABLE = "rgba(0,140,110,0.30)"
STABLE_AT_MEAN = "rgba(0,114,178,0.20)"
DESIGN = "#0072b2"
RIVAL = "#d55e00"
DOT_STABLE = "#008c6e"
DOT_UNSTABLE = "#c62828"
RATIO_NAMES = ("smallest ratio", "mean ratio", "largest ratio")
DASHES = ("dot", "solid", "dash")
CIRCLE = "M 9,0 C 9,5 5,9 0,9 C -5,9 -9,5 -9,0 C -9,-5 -5,-9 0,-9 C 5,-9 9,-5 9,0 Z"
"""Outline of the dot [pixels]; a shape of type circle has no negative ends on a logarithmic axis."""
MAX_ZOOM_OUT = 20.0
"""Largest ordinate over the smallest peak of a completed run."""
MIN_RANGE = 1e-9
RANGES = {control.name: (control.low, control.high) for control in CONTROLS}


def _axis(title: str, **more: Any) -> dict[str, Any]:
    return {
        "title": {"text": title, "standoff": 6},
        "gridcolor": GRID,
        "zerolinecolor": GRID,
        "automargin": True,
        "exponentformat": "power",
        **more,
    }


def _figure(data: list[dict[str, Any]], x: dict[str, Any], y: dict[str, Any], **layout: Any) -> dict[str, Any]:
    return {
        "data": data,
        "layout": {
            "margin": {"l": 8, "r": 8, "t": 8, "b": 8},
            "paper_bgcolor": "rgba(0,0,0,0)",
            "plot_bgcolor": "rgba(0,0,0,0)",
            "font": {"size": 12},
            "xaxis": x,
            "yaxis": y,
            "showlegend": True,
            "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
            "hovermode": "closest",
            "uirevision": "kept",
            **layout,
        },
        "config": {"displaylogo": False, "displayModeBar": False, "scrollZoom": False},
    }


def map_figure(state: DesignState, analysis: LoopAnalysis, facts: RobotFacts) -> dict[str, Any]:
    """Return the stability map: inertia share over natural frequency, with the design as a dot that can be dragged."""
    x = analysis.map.natural_frequencies
    low, high = analysis.map.shares(facts)
    mean = float(np.sqrt(facts.min_ratio * facts.max_ratio))
    bounds = RANGES["inertia_share"]
    data = [
        _band(
            x,
            analysis.map.low / mean,
            analysis.map.high / mean,
            "stable at the mean inertia",
            STABLE_AT_MEAN,
            bounds,
        ),
        _band(x, low, high, "stable at every inertia", STABLE, bounds),
        {
            "x": [state.natural_frequency],
            "y": [state.inertia_share],
            "mode": "markers",
            "name": "design",
            "marker": {"size": 12, "color": dot_colour(analysis)},
            "showlegend": False,
            "hovertemplate": "ωn %{x:.3g} rad/s<br>share %{y:.3g}<extra>design</extra>",
        },
    ]
    dot = {
        "type": "path",
        "path": CIRCLE,
        "xsizemode": "pixel",
        "ysizemode": "pixel",
        "xanchor": state.natural_frequency,
        "yanchor": state.inertia_share,
        "fillcolor": dot_colour(analysis),
        "line": {"color": "white", "width": 2},
    }
    x_axis = _control_axis("natural frequency [rad/s]", "natural_frequency")
    y_axis = _control_axis("inertia share M̂ / mean inertia", "inertia_share")
    return _figure(data, x_axis, y_axis, shapes=[dot])


def dot_colour(analysis: LoopAnalysis) -> str:
    """Return the colour of the design's dot, by its linear stability."""
    return DOT_STABLE if all(analysis.is_stable) else DOT_UNSTABLE


def _control_axis(title: str, name: str) -> dict[str, Any]:
    """Return the logarithmic axis of a control over its range, with numbers at 1, 2 and 5 of each decade."""
    low, high = RANGES[name]
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [float(f"{digit}e{decade}") for decade in decades for digit in (1, 2, 5)]
    shown = [tick for tick in ticks if low <= tick <= high]
    ends = [math.log10(low), math.log10(high)]
    return _axis(title, type="log", range=ends, fixedrange=True, tickvals=shown, ticktext=[f"{x:g}" for x in shown])


def _band(x: Array, low: Array, high: Array, name: str, colour: str, bounds: tuple[float, float]) -> dict[str, Any]:
    """Return a filled band between two curves, without the points at which it is empty."""
    is_there = np.isfinite(low) & np.isfinite(high)
    x, low, high = x[is_there], low[is_there], np.minimum(high[is_there], 10 * bounds[1])
    return {
        "x": [*x.tolist(), *x[::-1].tolist()],
        "y": [*low.tolist(), *high[::-1].tolist()],
        "mode": "lines",
        "fill": "toself",
        "fillcolor": colour,
        "line": {"width": 1, "color": colour},
        "name": name,
        "hoveron": "points",
        "hovertemplate": f"ωn %{{x:.3g}} rad/s<br>share %{{y:.3g}}<extra>{name}</extra>",
    }


def gain_figure(analysis: LoopAnalysis) -> dict[str, Any]:
    """Return the loop gain |L| over frequency at the smallest, mean and largest inertia ratio."""
    is_shown = analysis.frequencies > 0.3
    data = [
        {
            "x": analysis.frequencies[is_shown].tolist(),
            "y": gains[is_shown].tolist(),
            "mode": "lines",
            "name": name,
            "line": {"color": DESIGN, "dash": dash, "width": 1.5},
            "hovertemplate": "%{x:.3g} rad/s<br>gain %{y:.3g}<extra>" + name + "</extra>",
        }
        for name, gains, dash in zip(RATIO_NAMES, analysis.loop_gains, DASHES, strict=True)
    ]
    one = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 1, "y1": 1, "line": {"color": "gray", "width": 1}}
    return _figure(
        data,
        _axis("frequency [rad/s]", type="log", dtick=1),
        _axis("loop gain", type="log", dtick=2, range=[-2.5, 3.5]),
        shapes=[one],
    )


def curves_figure(pair: CurvePair, quantity: str, joint: str) -> dict[str, Any]:
    """Return error, torque or gain of design and rival over time.

    Parameters
    ----------
    pair
        The runs.
    quantity
        ``error``, ``torque`` or ``gain``.
    joint
        Name of a joint; empty for the norm over all.
    """
    data = []
    measure = {"error": "peak_error", "torque": "peak_torque", "gain": "peak_gain"}[quantity]
    scale = pair.design.scales[measure]
    for curves, colour in ((pair.rival, RIVAL), (pair.design, DESIGN)):
        values = {"error": curves.errors, "torque": curves.torques, "gain": curves.gain}[quantity]
        if values is None:
            continue
        if values.ndim == 2:
            values = values[:, curves.joints.index(joint)] if joint in curves.joints else np.linalg.norm(values, axis=1)
        data.append(
            {
                "x": curves.times.tolist(),
                "y": [float(f"{scale * value:.5g}") for value in values],
                "mode": "lines",
                "name": curves.name,
                "line": {"color": colour, "width": 1.4},
                "hovertemplate": "%{x:.3f} s<br>%{y:.4g}<extra>" + curves.name + "</extra>",
            }
        )
    if quantity == "gain":
        y_axis = _axis("gain ĉ [rad/s²]")
    else:
        y_axis = _axis(f"{quantity}, {joint or 'norm'} [{pair.design.units[measure]}]")
        y_axis["range"] = [scale * end for end in _range(pair, quantity, joint)]
    return _figure(data, _axis("time [s]"), y_axis)


def _range(pair: CurvePair, quantity: str, joint: str) -> list[float]:
    """Return a range of the ordinate that holds the better run, and of the other what is not far above."""
    peaks = {}
    for curves in (pair.design, pair.rival):
        values = curves.errors if quantity == "error" else curves.torques
        column = values[:, curves.joints.index(joint)] if joint in curves.joints else np.linalg.norm(values, axis=1)
        finite = np.abs(column[np.isfinite(column)])
        peaks[curves.has_completed, curves.name] = float(finite.max(initial=0.0))
    calm = [peak for (has_completed, _), peak in peaks.items() if has_completed]
    top = max(peaks.values()) if not calm else min(max(peaks.values()), MAX_ZOOM_OUT * min(calm))
    top = 1.1 * max(top, MIN_RANGE)
    return [-top if joint else 0.0, top]


def cloud_figure(
    x: Array, y: Array, completed: Array, kinds: list[str], titles: tuple[str, str], is_logarithmic: bool
) -> dict[str, Any]:
    """Return a measure of the runs of a study over a drawn value; runs that diverged are crosses at the top.

    Parameters
    ----------
    x
        Drawn value of each run, shape (k,).
    y, completed
        Measure, and whether the run came to its end, of the design and its rival, shape (k, 2).
    kinds
        Kinds of the two laws.
    titles
        Of the axes.
    is_logarithmic
        Whether the drawn value has a logarithmic axis.
    """
    is_shown = completed & np.isfinite(y) & (y > 0)
    top = float(2 * y[is_shown].max()) if is_shown.any() else 1.0
    data = []
    for column, (kind, role, colour) in enumerate(zip(kinds, ("", " (rival)"), (DESIGN, RIVAL), strict=True)):
        for chosen, symbol, suffix in ((is_shown[:, column], "circle", ""), (~is_shown[:, column], "x", ", diverged")):
            if not chosen.any():
                continue
            values = y[chosen, column] if symbol == "circle" else np.full(chosen.sum(), top)
            data.append(
                {
                    "x": x[chosen].tolist(),
                    "y": values.tolist(),
                    "customdata": np.flatnonzero(chosen).tolist(),
                    "type": "scattergl",
                    "mode": "markers",
                    "name": f"{kind}{role}{suffix}",
                    "marker": {"size": 6, "color": colour, "opacity": 0.6, "symbol": symbol},
                    "hovertemplate": "run %{customdata}<br>%{x:.4g}<br>%{y:.4g}<extra></extra>",
                }
            )
    x_type = "log" if is_logarithmic else "linear"
    return _figure(data, _axis(titles[0], type=x_type), _axis(titles[1], type="log"))


def live_figure(titles: list[str]) -> dict[str, Any]:
    """Return empty curves over time, one above the other, to which measured values are added."""
    n = len(titles)
    data = [
        {
            "x": [],
            "y": [],
            "yaxis": f"y{k + 1}",
            "mode": "lines",
            "line": {"color": DESIGN, "width": 1.4},
            "name": title,
        }
        for k, title in enumerate(titles)
    ]
    share = 1 / n
    axes = {
        f"yaxis{k + 1}": _axis(title, domain=[1 - share * (k + 0.9), 1 - share * k], exponentformat="none")
        for k, title in enumerate(titles)
    }
    figure = _figure(data, _axis("time [s]", anchor=f"y{n}"), axes.pop("yaxis1"), showlegend=False)
    figure["layout"] |= axes
    return figure
