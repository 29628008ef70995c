"""Measure everything and print one table: ``python -m benchmarks [NAME …]``, all benchmarks without a name.

It reports, so that it exits with 0 whatever the times are.
"""

import argparse
import os
import platform
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks import certificates, law, robot, simulation, startup
from benchmarks.measure import Row
from tarc.core.errors import TarcError

CAPTION = "Times of calls: the least of many. Ratios, against / measured: the median over turns taken in this run."
BENCHMARKS = {
    f"{benchmark.__module__.removeprefix('benchmarks.')}.{benchmark.__name__}": benchmark
    for benchmark in (
        simulation.period,
        simulation.peer,
        law.step,
        law.with_model,
        robot.closed_loop,
        robot.symbolic,
        certificates.one_and_thirty,
        certificates.affine,
        certificates.command,
        startup.startup,
    )
}


def machine() -> str:
    """Return the machine that it runs on."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    models = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor() or platform.machine()
    versions = [f"{name} {version(name)}" for name in ("numpy", "casadi", "mujoco", "opensmc")]
    load = f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    return "; ".join([model, load, ", ".join([f"Python {platform.python_version()}", *versions])])


def main() -> None:
    """Run them in turn; a missing library or a refused input is reported in its row."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(BENCHMARKS)}")
    names = parser.parse_args().names or list(BENCHMARKS)
    if unknown := set(names) - set(BENCHMARKS):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(BENCHMARKS)}")
    console = Console(width=None if Console().is_terminal else 160)
    console.print(machine(), highlight=False)
    rows: list[Row] = []
    for name in names:
        console.print(f"measuring {name} …", style="dim", highlight=False)
        try:
            rows += BENCHMARKS[name]()
        except (ImportError, TarcError) as error:
            rows.append(Row(name, f"failed: {error}"))
    table = Table("what", "measured", "against", "ratio", "target", "met", caption=CAPTION)
    for row in rows:
        met = {None: "", True: "[green]yes[/green]", False: "[red]no[/red]"}[row.met]
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}×" if row.ratio < 10 else f"{row.ratio:.0f}×"
        table.add_row(row.what, row.measured, row.against, ratio, row.target, met)
    console.print(table)


if __name__ == "__main__":
    main()
