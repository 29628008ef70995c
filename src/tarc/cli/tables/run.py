"""What `tarc run` and `tarc demo` print."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tarc.cli.tables.console import VERDICT_COLOURS, print_written
from tarc.scenario.model import Scenario
from tarc.simulation.quantities import MEASURES, measure_unit
from tarc.simulation.run import Run


def run_summary(
    scenario: Scenario, runs: dict[str, Run], files: list[Path], verdicts: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return results as plain data, ready for JSON."""
    results = {}
    for name, run in runs.items():
        status, metrics = run.status, run.metrics_or_none(scenario.metrics_start)
        results[name] = {
            "status": "completed" if status.completed else "diverged",
            "divergence_time": status.divergence_time,
            "fault_time": status.fault_time,
            "saturated": status.saturated,
            "metrics": {key: value if math.isfinite(value) else None for key, value in metrics.items()},
        }
    for name, verdict in (verdicts or {}).items():
        results[name]["verdict"] = verdict
    return {"name": scenario.name, "runs": results, "files": [str(file) for file in files]}


def print_runs(
    scenario: Scenario, runs: dict[str, Run], files: list[Path], verdicts: Mapping[str, str] | None = None
) -> None:
    """Print a table of measures, one column per run, with its verdict where there is one, and the files."""
    console = Console()
    since = f", measured after {scenario.metrics_start:g} s" if scenario.metrics_start else ""
    table = Table(title=f"{scenario.name}, {scenario.duration:g} s{since}", title_justify="left")
    table.add_column("measure")
    for name in runs:
        table.add_column(name, justify="right")
    table.add_column("unit")
    results = {name: run.metrics_or_none(scenario.metrics_start) for name, run in runs.items()}
    first = next(iter(runs.values()))
    for key, (label, _, scale, _) in MEASURES.items():
        if any(key in result for result in results.values()):
            cells = [f"{scale * result[key]:.4g}" if key in result else "–" for result in results.values()]
            label = label.replace("torque", "command") if first.command_unit else label
            table.add_row(label, *cells, measure_unit(key, first.joint_units, first.command_unit))
    table.add_section()
    statuses = [str(run.status) for run in runs.values()]
    table.add_row("status", *[s if s.startswith("completed") else f"[bold red]{s}[/bold red]" for s in statuses], "")
    if verdicts:
        cells = [f"[{VERDICT_COLOURS[verdict]}]{verdict}[/]" for verdict in (verdicts[name] for name in runs)]
        table.add_row("on the robot", *cells, "")
    console.print(table)
    if not any(results.values()):
        console.print(f"no measures: no run lasts beyond metrics_start, {scenario.metrics_start:g} s")
    print_written(console, files)
