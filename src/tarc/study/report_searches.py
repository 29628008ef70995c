"""Sections of a report about searches among the draws: a rare event, a worst case."""

from collections.abc import Mapping
from html import escape

import numpy as np

from tarc.study.rare_events import RareProbability
from tarc.study.report_html import format_count, format_value, html_table, svg_figure


def rare_event_section(result: RareProbability, event: str, label: str) -> str:
    """Return the section about a rare event, for `write_report`.

    Parameters
    ----------
    result
        The result of `tarc.study.rare_events.rare_probability`.
    event
        The event in words, such as ``TDC diverges``.
    label
        Of the performance whose levels were split.
    """
    from tarc.plotting.study import levels_figure

    probability = result.probability
    return "\n".join(
        [
            "<h2>Rare event</h2>",
            f"<p>{escape(event)} with probability <b>{probability.estimate:.2g}</b> "
            f"({probability.low:.2g} to {probability.high:.2g}), from {format_count(result.n_runs)} runs in "
            f"{len(result.estimates)} independent estimates by importance splitting. "
            f"Plain sampling needs {format_count(round(100 / probability.estimate))} runs to see it a hundred "
            "times.</p>"
            if probability.estimate
            else "",
            svg_figure(levels_figure(result, label), "levels", "Probability over the levels of each estimate"),
        ]
    )


def worst_case_section(
    text: str,
    draws: Mapping[str, float | int | str],
    errors: Mapping[str, tuple[np.ndarray, np.ndarray]],
    label: str,
    threshold: float,
) -> str:
    """Return the section about a worst case, for `write_report`; `WorstCase.section` makes it.

    Parameters
    ----------
    text
        What was searched and found, in words.
    draws
        Drawn values of the worst run, by key.
    errors
        Time [s] and norm of the error of some runs, by their names.
    label
        Of the error, with its unit.
    threshold
        Error beyond which a run has diverged, in the same unit.
    """
    from tarc.plotting.study import worst_case_figure

    rows = [[f"<code>{escape(key)}</code>", format_value(value)] for key, value in draws.items()]
    picture = worst_case_figure(errors, label, threshold)
    return "\n".join(
        [
            "<h2>Worst case</h2>",
            f"<p>{escape(text)}</p>",
            html_table(["key", "value"], rows),
            svg_figure(picture, "worst-case", f"{label} over time: {', '.join(errors)}"),
        ]
    )
