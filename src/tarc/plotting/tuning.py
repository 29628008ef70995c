"""Figure of the fronts that a search of gains found."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tarc.plotting.style import COLOURS, StyledFigure, style_tradeoff
from tarc.study.front import TuningFront

MARKERS = "osD^vP*X<>"


def front_figure(
    fronts: Mapping[str, TuningFront], title: str, units: tuple[str, str], pick: str | int = "knee"
) -> Figure:
    """Draw RMS error over torque variation of the fronts, both logarithmic, with the least error of linear controllers.

    Parameters
    ----------
    fronts
        The fronts, by name.
    title
        Its title.
    units
        Unit of the error and of the torque variation.
    pick
        The point that is ringed, as in `TuningFront.pick`.
    """
    figure = StyledFigure(figsize=(8.5, 5.2), layout="constrained")
    axes = figure.subplots()
    for i, (name, front) in enumerate(fronts.items()):
        _draw(axes, name, front, COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)], pick)
    axes.set_xlabel(f"torque variation [{units[1]}]")
    axes.set_ylabel(f"RMS error [m{units[0]}]")
    axes.set_title(title, fontsize="medium")
    style_tradeoff(axes)
    return figure


def _draw(axes: Axes, name: str, front: TuningFront, colour: str, marker: str, pick: str | int) -> None:
    """Draw a front as steps, the bound below it as a dashed line, and a ring round the picked point."""
    places = np.array([(point.torque_variation, 1e3 * point.rms_error) for point in reversed(front.points)])
    corners = [tuple(places[0])]
    for point, following in pairwise(places):
        corners += [(following[0], point[1]), tuple(following)]
    axes.plot(*np.array(corners).T, color=colour, lw=1, alpha=0.6)
    axes.plot(*places.T, marker, ms=5, color=colour, ls="", label=name)
    picked = front.pick(pick)
    axes.plot(
        picked.torque_variation,
        1e3 * picked.rms_error,
        "o",
        ms=13,
        mfc="none",
        mec=colour,
        mew=1.5,
        label=f"{name}, picked",
    )
    bounds = [
        (point.torque_variation, 1e3 * point.least_error)
        for point in reversed(front.points)
        if point.least_error is not None
    ]
    if bounds:
        axes.plot(*np.array(bounds).T, color=colour, ls="--", lw=1, label=f"{name}, best linear\ncontroller there")
