"""What `tarc compare` prints."""

import math
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tarc.cli.tables.console import WIDE, print_written
from tarc.study.comparison import Comparison

NARROW_COLUMNS = ("rms_error", "peak_error", "torque_variation")
"""Measures that a narrow terminal shows."""


def comparison_summary(comparison: Comparison, files: list[Path]) -> dict[str, Any]:
    """Return a comparison as plain data, ready for JSON."""
    laws = {
        name: {
            "status": str(comparison.runs[name].status),
            "unstable_at_rest": comparison.unstable.get(name, ""),
            "measures": {key: value if math.isfinite(value) else None for key, value in measures.items()},
        }
        for name, measures in comparison.measures.items()
    }
    return {
        "name": comparison.scenario.name,
        "laws": laws,
        "failures": comparison.failures,
        "front": comparison.front,
        "files": [str(file) for file in files],
    }


def print_comparison(comparison: Comparison, files: list[Path]) -> None:
    """Print one row per law, least error first; laws that no other beats in both error and variation are marked."""
    console = Console()
    scenario = comparison.scenario
    table = Table(
        title=f"{scenario.name}, {scenario.duration:g} s, after {scenario.metrics_start:g} s", title_justify="left"
    )
    table.add_column("law")
    shown = {
        key: column for key, column in comparison.columns.items() if console.width >= WIDE or key in NARROW_COLUMNS
    }
    for label, _, unit in shown.values():
        table.add_column(escape(f"{label} [{unit}]"), justify="right")
    table.add_column("status")
    front = comparison.front
    measures = comparison.measures
    for name in sorted(measures, key=lambda name: measures[name].get("rms_error", math.inf)):
        values = measures[name]
        cells = [f"{scale * values[key]:.4g}" if key in values else "–" for key, (_, scale, _) in shown.items()]
        status = comparison.status_in_words(name)
        is_sound = comparison.runs[name].status.completed and name not in comparison.unstable
        ended = status if is_sound else f"[red]{status}[/red]"
        table.add_row(f"{name} *" if name in front else name, *cells, ended)
    console.print(table)
    console.print("* no other law has both a smaller RMS error and a smaller torque variation")
    for name, text in comparison.unstable.items():
        console.print(f"{name} is never marked: {escape(text)}", highlight=False)
    for name, reason in comparison.failures.items():
        console.print(f"{name} did not run: {escape(reason)}")
    print_written(console, files)
