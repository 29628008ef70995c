"""What `tarc study` prints."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tarc.cli.tables.console import WIDE
from tarc.core.errors import InvalidParameter
from tarc.simulation.quantities import MEASURES, measure_unit
from tarc.study.statistics import success_rate
from tarc.study.study_result import StudyResult

SHOWN = ("rms_error", "peak_error", "torque_variation")
"""Measures of the table, with those of revolute and of prismatic joints; the folder has all of them."""

PROBABILITIES = [0.05, 0.5, 0.95, 1.0]
"""Quantiles of the table; the last is the greatest value."""


def study_summary(result: StudyResult, report: Path) -> dict[str, Any]:
    """Return rates and quantiles as plain data, ready for JSON; null for an infinite quantile, and one of no law."""
    laws: dict[str, Any] = {}
    for law in result.laws:
        rate = success_rate(result.data["completed"].sel(law=law).values)
        laws[law] = {"success_rate": rate.estimate, "interval": [rate.low, rate.high], "quantiles": {}}
    for measure in result.measures:
        for law, values in result.quantiles(measure, PROBABILITIES).items():
            laws[law]["quantiles"][measure] = {
                f"{probability:g}": float(value) if np.isfinite(value) else None
                for probability, value in zip(PROBABILITIES, values, strict=True)
            }
    return {
        "folder": str(result.folder),
        "report": str(report),
        "runs": result.n_runs,
        "finished": result.data.sizes["run"],
        "laws": laws,
        "traces": [str(path) for path in result.traced],
    }


def print_study(result: StudyResult, report: Path) -> None:
    """Print the share of completed runs and quantiles of each law, and where the results are."""
    console = Console()
    attributes = result.data.attrs
    console.print(f"{attributes['title']}: {result.data.sizes['run']} runs per law", highlight=False)
    for law in result.laws:
        rate = success_rate(result.data["completed"].sel(law=law).values)
        text = f"{100 * rate.estimate:.4g} % completed ({100 * rate.low:.4g} … {100 * rate.high:.4g} %)"
        console.print(f"{escape(law)}: {text}", highlight=False)
    units, command = attributes.get("joint_units", ["rad"]), str(attributes.get("command_unit", ""))
    table = Table()
    table.add_column("law")
    table.add_column("measure")
    headings = ("5 %", "median", "95 %", "greatest") if console.width >= WIDE else ("5 %", "median", "95 %")
    for heading in headings:
        table.add_column(heading, justify="right")
    names = [name for name in result.measures if name.startswith(SHOWN)]
    quantiles = {name: result.quantiles(name, PROBABILITIES) for name in names}
    for law in result.laws:
        for number, name in enumerate(names):
            unit = measure_unit(name, units, command)
            cells = [f"{MEASURES[name].scale * value:.4g}" for value in quantiles[name][law][: len(headings)]]
            label = escape(f"{MEASURES[name].label} [{unit}]")
            table.add_row("" if number else escape(law), label, *cells)
    console.print(table)
    console.print("A run that diverged counts as infinite. The report has the intervals of all numbers.")
    console.print(f"results: {escape(str(result.folder))}, report: {escape(str(report))}", soft_wrap=True)


def interruption(folder: Path) -> str:
    """Return what is kept after Ctrl-C, and how to go on."""
    try:
        result = StudyResult.open(folder)
    except InvalidParameter:
        return "interrupted; nothing was stored"
    kept = f"interrupted: {result.data.sizes['run']} of {result.n_runs} runs are stored in {folder}"
    return f"{kept}; the same command goes on from there"
