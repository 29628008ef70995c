"""Every law in eight scenarios on equal terms: ``python -m benchmarks.comparison``, or ``make compare``.

Gains are those of `tarc.study.tuned_laws`, found on other scenarios. Writes one table as CSV and as markdown.
"""

import argparse
import math
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from tarc import Scenario
from tarc.study import Comparison, compare, tuned_laws

SCENARIOS = (
    "two_link_payload",
    "two_link_friction",
    "ur5e_load",
    "panda_multisine",
    "wheeled_figure_eight",
    "vibration",
    "coarse_encoder",
    "dropout_delay",
)
MEASURES = {"rms_error": ("RMS error [mrad or mm]", 1e3), "torque_variation": ("torque variation [N m/s or N/s]", 1.0)}


def run_all(laws: list[str], jobs: int | None = None) -> dict[str, Comparison]:
    """All laws in all scenarios."""
    return {name: compare(Scenario.load(name), laws, jobs=jobs) for name in SCENARIOS}


def ranks(found: dict[str, Comparison], laws: list[str]) -> dict[str, float]:
    """Geometric mean over the scenarios of a law's RMS error over the median of all laws; infinite if one failed."""
    result = {}
    errors = {
        name: {law: one.get("rms_error", math.inf) for law, one in c.measures.items()} for name, c in found.items()
    }
    for law in laws:
        ratios = []
        for table in errors.values():
            median = float(np.median([value for value in table.values() if math.isfinite(value)]))
            ratios.append(table.get(law, math.inf) / median)
        result[law] = float(np.exp(np.mean(np.log(ratios)))) if all(math.isfinite(r) for r in ratios) else math.inf
    return result


def cell(comparison: Comparison, law: str, measure: str, scale: float) -> str:
    """One number, or why there is none."""
    if law in comparison.failures:
        return "–"
    value = comparison.measures[law].get(measure)
    return "diverged" if value is None else f"{scale * value:.3g}"


def markdown(found: dict[str, Comparison], laws: list[str]) -> str:
    """The tables for the documentation."""
    lines = []
    for measure, (label, scale) in MEASURES.items():
        lines += [f"{label}:", "", "| law | " + " | ".join(name.replace("_", " ") for name in found) + " |"]
        lines.append("| --- |" + " --- |" * len(found))
        lines += [
            f"| {law} | " + " | ".join(cell(c, law, measure, scale) for c in found.values()) + " |" for law in laws
        ]
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--laws", default="all", help="names with commas between")
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--out", type=Path, default=Path("runs/comparison"))
    options = parser.parse_args()
    laws = list(tuned_laws()) if options.laws == "all" else options.laws.split(",")
    found = run_all(laws, options.jobs)
    order = sorted(laws, key=ranks(found, laws).__getitem__)
    console = Console(width=None if Console().is_terminal else 200)
    for measure, (label, scale) in MEASURES.items():
        table = Table("law", *(name.replace("_", " ") for name in found), title=label, title_justify="left")
        for law in order:
            table.add_row(law, *(cell(c, law, measure, scale) for c in found.values()))
        console.print(table)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "comparison.md").write_text(markdown(found, order), encoding="utf-8")
    for name, comparison in found.items():
        (options.out / f"{name}.csv").write_text(comparison.to_csv(), encoding="utf-8")
        comparison.plot("plane").savefig(options.out / f"{name}.png", dpi=90)
        for law, reason in comparison.failures.items():
            console.print(f"{name}: {law} did not run: {reason}", highlight=False)
    console.print(f"written: {options.out}/comparison.md, CSV and figures beside it")


if __name__ == "__main__":
    main()
