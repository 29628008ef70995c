"""One style of all figures: colours, axes, and fonts that publishers accept."""

from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"]
"""Okabe and Ito's palette, which colour-blind readers can distinguish."""

STYLE: Any = {
    "axes.spines.right": False,
    "axes.spines.top": False,
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.fonttype": "none",
}
"""Settings of matplotlib. Fonts are embedded as TrueType (42): IEEE refuses Type 3, matplotlib's default."""


class StyledFigure(Figure):
    """A figure of matplotlib whose axes and files have `STYLE`, whatever the user's settings are."""

    def add_subplot(self, *args: Any, **kwargs: Any) -> Any:
        """Add axes, as matplotlib does."""
        with rc_context(STYLE):
            return super().add_subplot(*args, **kwargs)

    def savefig(self, fname: Any, **kwargs: Any) -> None:
        """Write a file, as matplotlib does."""
        with rc_context(STYLE):
            super().savefig(fname, **kwargs)


def style_tradeoff(axes: Axes) -> None:
    """Give axes of error over torque variation logarithmic scales, a grid, and a legend of what is drawn beside it."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    axes.tick_params(which="both", labelsize="small")
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    axes.grid(alpha=0.3, which="both")
