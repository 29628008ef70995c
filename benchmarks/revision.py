"""Compare `tarc certify` of an old revision with this one: ``python -m benchmarks.revision OLD_CHECKOUT``.

The two take turns, each in a fresh process with default figures, so that a change of the machine's load affects both.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.measure import Row

ROOT = Path(__file__).parents[1]
COMMAND = "from tarc.cli import main; main()"
TARGET = 2.0
"""Least ratio of the old time to the new one."""


def certify_time(checkout: Path, robot: str) -> float:
    """Return the time [s] of a whole process of `tarc certify` with the source of a checkout.

    Raises
    ------
    RuntimeError
        When the command fails, with the end of its output.
    """
    environment = os.environ | {"PYTHONPATH": str(checkout / "src")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation has its modules compiled
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", COMMAND, "certify", robot, "-o", folder]
        start = time.perf_counter()
        result = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True)
        duration = time.perf_counter() - start
    if result.returncode:
        raise RuntimeError(f"tarc certify {robot} failed in {checkout}: {(result.stderr or result.stdout)[-500:]}")
    return duration


def certify_against(old_checkout: Path, robot: str = "ur5e", rounds: int = 5) -> Row:
    """Return the row of `tarc certify`: the median over the rounds of old time / new time."""
    old_times, new_times = [], []
    for checkout in (old_checkout, ROOT):
        certify_time(checkout, robot)  # fills the caches of Python and of fonts
    for i in range(rounds):
        turns = [(old_checkout, old_times), (ROOT, new_times)]
        for checkout, times in turns if i % 2 == 0 else reversed(turns):
            times.append(certify_time(checkout, robot))
    ratio = float(np.median(np.divide(old_times, new_times)))
    return Row(
        f"tarc certify {robot}, default figures, whole process",
        f"{np.median(new_times):.2f} s",
        f"old revision: {np.median(old_times):.2f} s",
        ratio,
        f"≥ {TARGET:g}×",
        ratio >= TARGET,
    )


def main() -> None:
    """Parse the options, measure and print the row."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.revision", description=__doc__)
    parser.add_argument("old_checkout", type=Path, help="folder of the old revision, with its src")
    parser.add_argument("--robot", default="ur5e", help="robot to certify (default ur5e)")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each revision (default 5)")
    options = parser.parse_args()
    if not (options.old_checkout / "src" / "tarc").is_dir():
        parser.error(f"{options.old_checkout}: contains no src/tarc; give the folder of a checkout")
    row = certify_against(options.old_checkout.resolve(), options.robot, options.rounds)
    table = Table("what", "measured", "against", "ratio", "target", "met")
    table.add_row(row.what, row.measured, row.against, f"{row.ratio:.2f}×", row.target, "yes" if row.met else "no")
    Console(width=None if Console().is_terminal else 140).print(table)


if __name__ == "__main__":
    main()
