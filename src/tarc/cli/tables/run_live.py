"""What `tarc run-live` prints at its end."""

from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tarc.cli.tables.console import print_written
from tarc.control.watch import WatchFlag
from tarc.runtime import LiveRun
from tarc.runtime.live_run import PERCENTILES

MICROSECONDS = 1e6


def summary(result: LiveRun) -> dict[str, Any]:
    """Return a run as plain data, ready for JSON."""
    return {
        "ended": result.ended,
        "safe_stop": result.is_safe_stop,
        "periods": result.n_periods,
        "overruns": result.overruns,
        "percentiles": list(PERCENTILES),
        **{name: [float(f"{value:.4g}") for value in values] for name, values in result.percentiles().items()},
        "counts": dict(result.counts),
        "facts": dict(result.facts),
        "push": [response.to_dict() | {"fault": response.fault} for response in result.push],
        "flags": flag_names(result.flags_seen),
        "log": str(result.log),
    }


def print_result(result: LiveRun, joint_names: list[str]) -> None:
    """Print why a run ended, percentiles and overruns, the pushes, and what was got of the system."""
    console = Console(width=None if Console().is_terminal else 100)
    colour = "red" if result.is_safe_stop else "green"
    console.print(f"[{colour}]{'safe stop: ' if result.is_safe_stop else ''}{escape(result.ended)}[/]", highlight=False)
    table = Table("time [µs]", *(f"{p:g} %" for p in PERCENTILES), title="Percentiles", title_justify="left")
    for name, values in result.percentiles().items():
        table.add_row(name.replace("_", " "), *(f"{MICROSECONDS * value:.0f}" for value in values))
    console.print(table)
    console.print(f"{result.overruns} of {result.n_periods} periods missed", highlight=False)
    counts = [f"{number} {name}" for name, number in result.counts.items() if number]
    if counts:
        console.print(f"samples and packets: {', '.join(counts)}", highlight=False)
    if result.push:
        console.print(_push_table(result, joint_names))
    if result.flags_seen:
        names = ", ".join(flag_names(result.flags_seen))
        console.print(f"[yellow]left what the certificate assumes: {names}[/]", highlight=False)
    for name, text in result.facts.items():
        console.print(f"{name}: {escape(text)}", highlight=False)
    if result.log is not None:
        print_written(console, [result.log])


def flag_names(flags: WatchFlag) -> list[str]:
    """Return the names of flags in small letters."""
    return [str(flag.name).lower() for flag in WatchFlag if flag & flags]


def _push_table(result: LiveRun, joint_names: list[str]) -> Table:
    header = ["joint", "ratio", "stable ×", "constant", "friction", "finding"]
    table = Table(
        *header,
        title="Push: inertia ratio, factors of torque that keep it stable, torque constant, dry friction",
        title_justify="left",
    )
    for response in result.push:
        least, most = response.tolerance
        table.add_row(
            escape(joint_names[response.joint]),
            _number(response.ratio),
            f"{least:.2g} to {most:.3g}" if np.isfinite(most) else "–",
            " to ".join(dict.fromkeys(_number(value) for value in response.torque_constant)),
            _number(response.friction),
            f"[red]{response.fault}[/]" if response.fault else "ok",
        )
    return table


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"
