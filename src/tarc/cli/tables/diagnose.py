"""Tables of a diagnosed log."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tarc.cli.tables.console import print_written

if TYPE_CHECKING:
    from tarc.logs.diagnosis import Diagnosis


def print_diagnosis(diagnosis: "Diagnosis", files: list[Path]) -> None:
    """Print what was measured, what was found, and the files that were written."""
    console = Console()
    console.print(_joint_table(diagnosis))
    console.print(_loop_table(diagnosis))
    if diagnosis.is_clean:
        console.print("nothing found that is wrong", highlight=False)
    for number, finding in enumerate(diagnosis.findings, 1):
        place = f" {finding.joint}" if finding.joint else ""
        console.print(
            f"{number}. {finding.kind.replace('_', ' ')}{place}: {finding.text}", markup=False, highlight=False
        )
        console.print(f"   change: {finding.change}", markup=False, highlight=False)
    if files:
        print_written(console, files)


def _joint_table(diagnosis: "Diagnosis") -> Table:
    """Return one row per joint: step and noise of its encoder, missing samples, saturation."""
    encoders, torque, assumed = diagnosis.encoders, diagnosis.torque, diagnosis.assumed_noise
    table = Table(title=escape(diagnosis.log.run.title), title_justify="left")
    for name in ("joint", "step [µrad]", "noise [µrad]", "of the design", "missing", "saturated", "peak / limit"):
        is_joint = name == "joint"
        table.add_column(escape(name), justify="left" if is_joint else "right", no_wrap=is_joint)
    for i, name in enumerate(diagnosis.log.joint_names):
        table.add_row(
            escape(name),
            _number(1e6 * encoders.resolution[i]),
            _number(1e6 * encoders.noise[i]),
            "–" if assumed is None else _number(1e6 * assumed[i]),
            f"{encoders.missing[i]:.2%}",
            f"{torque.saturated[i]:.2%}",
            f"{torque.peak[i]:.0%}" if torque.peak[i] > 0 else "–",
        )
    return table


def _loop_table(diagnosis: "Diagnosis") -> Table:
    """Return what concerns all joints."""
    table = Table(show_header=False)
    encoders, delay, timing = diagnosis.encoders, diagnosis.delay, diagnosis.timing
    shows_jitter = np.isfinite(encoders.jitter_error)
    jitter = f"{1e6 * encoders.jitter:.3g} ± {1e6 * encoders.jitter_error:.2g} µs" if shows_jitter else "does not show"
    table.add_row("jitter of the samples", jitter)
    table.add_row("stale rows", f"{encoders.stale:.2%}")
    if delay is None:
        table.add_row("delay, torque to motion", "not sought: needs a scenario and a motion")
    else:
        certified = f", {diagnosis.assumed_delay:g} certified"
        table.add_row("delay, torque to motion", f"{delay.delay:.2f} ± {delay.error:.2f} periods{certified}")
    if timing is not None:
        late, busy = timing.lateness, timing.computation_time
        table.add_row("periods missed", f"{timing.overruns:.3%}")
        table.add_row("start late, 50 %, 99.9 %, most", ", ".join(f"{1e3 * value:.3g}" for value in late) + " ms")
        table.add_row("computation, the same", ", ".join(f"{1e3 * value:.3g}" for value in busy) + " ms")
    table.add_row("limit cycles", f"{len(diagnosis.limit_cycles)}")
    for part in diagnosis.assumptions:
        table.add_row(f"certified {part.name}", "held" if part.holds else f"left in {part.share:.2%} of the periods")
    return table


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"
