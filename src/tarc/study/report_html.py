"""Pieces of HTML of a study's report: tables, figures, and numbers as text."""

import io
import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from tarc.core.formatting import format_vector
from tarc.simulation.quantities import measure_unit
from tarc.study.statistics import Interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of the figures that the page's style replaces in dark mode."""

INK = "#000000"


def svg_figure(figure: "Figure", name: str, caption: str) -> str:
    """Return a figure as SVG in the page, whose colours follow the page's, with its caption."""
    from matplotlib import rc_context

    stream = io.StringIO()
    with rc_context({"svg.hashsalt": name}):
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None, "Creator": None}, dpi=150)
    picture = stream.getvalue()
    picture = picture[picture.index("<svg") :]
    picture = re.sub(r"<metadata>.*?</metadata>", "", picture, flags=re.DOTALL)
    picture = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', picture)
    picture = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", picture)
    for number, colour in enumerate(PALETTE):
        picture = picture.replace(colour, f"var(--c{number})")
    picture = picture.replace(INK, "currentColor")
    for side in ("width", "height"):
        picture = re.sub(rf'(<svg [^>]*?){side}="[^"]*"', r"\1", picture, count=1)
    picture = picture.replace("<svg ", f'<svg role="img" aria-label="{escape(caption)}" ', 1)
    return f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>"


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]], n_texts: int = 1) -> str:
    """Return a table; all columns but the first ones hold numbers."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{'' if place < n_texts else ' class=number'}>{cell}</{tag}>" for place, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    head = f"<thead><tr>{cells('th', heads)}</tr></thead>" if any(heads) else ""
    return f'<div class="wide"><table>{head}<tbody>{body}</tbody></table></div>'


def unit_of(data: xr.Dataset, measure: str) -> str:
    """Return the unit of a measure on the study's robot."""
    return measure_unit(measure, data.attrs.get("joint_units", ["rad"]), str(data.attrs.get("command_unit", "")))


def capitalised(text: str) -> str:
    """Return a text with a capital first letter."""
    return text[0].upper() + text[1:]


def format_number(value: float) -> str:
    """Return four significant digits; words for what is infinite."""
    value = float(value)
    if np.isnan(value):
        return "–"
    if np.isinf(value):
        return "diverged" if value > 0 else "none"
    if value != 0 and not 1e-3 <= abs(value) < 1e7:
        mantissa, exponent = f"{value:.3e}".split("e")
        return f"{float(mantissa):g}e{int(exponent)}"
    return format_count(round(value)) if abs(value) >= 10_000 else f"{value:.4g}"


def format_range(interval: Interval) -> str:
    """Return the ends of an interval; an open end in words."""
    low, high = interval.low, interval.high
    if low == np.inf:
        return "diverged"
    if np.isinf(low) and np.isinf(high):
        return "too few runs"
    if np.isinf(high):
        return f"at least {format_number(low)}"
    if np.isinf(low):
        return f"at most {format_number(high)}"
    return f"{format_number(low)} to {format_number(high)}"


def format_percent(interval: Interval) -> str:
    """Return a share with its interval in percent."""
    estimate, low, high = (100 * end for end in interval)
    return f"{estimate:.4g} % ({low:.4g} to {high:.4g} %)"


def format_count(count: int) -> str:
    """Return a whole number, with its digits in groups of three from ten thousand on."""
    return f"{count:,}".replace(",", "\N{NARROW NO-BREAK SPACE}") if count >= 10_000 else str(count)


def format_value(value: object) -> str:
    """Return a number, a vector or anything else as text."""
    if isinstance(value, np.ndarray | list | tuple):
        return format_vector(value) if np.asarray(value).dtype.kind in "biuf" else ", ".join(map(str, value))
    return format_number(float(value)) if isinstance(value, float | np.floating) else str(value)
