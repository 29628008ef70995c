"""Every law in ten scenarios on equal terms: ``python -m benchmarks.comparison``, or ``make compare``.

Gains are those of `tarc.study.tuned_laws`, found on other scenarios. It writes tables as CSV and as Markdown. For
`benchmarks.pages` it writes the gains that ran, and error and torque over time as netCDF.
"""

import argparse
import math
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

from tarc import Scenario
from tarc.scenario.yaml_text import write_yaml
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
    "underwater",
    "series_elastic",
)
MEASURES = {"rms_error": ("RMS error [mrad or mm]", 1e3), "torque_variation": ("torque variation [N m/s or N/s]", 1.0)}


UNSTABLE = "°"
"""Mark of a loop that is unstable at rest in a posture of the reference."""


def run_all(laws: list[str], jobs: int | None = None) -> dict[str, Comparison]:
    """All laws in all scenarios."""
    return {name: compare(Scenario.load(name), laws, jobs=jobs) for name in SCENARIOS}


def ranks(found: dict[str, Comparison], laws: list[str]) -> dict[str, float]:
    """Geometric mean of a law's RMS error over the median of all laws, over the scenarios in which it can run.

    Infinite for a law that diverged in one of them, or that can run in none.
    """
    ratios: dict[str, list[float]] = {law: [] for law in laws}
    for comparison in found.values():
        errors = {law: one.get("rms_error", math.inf) for law, one in comparison.measures.items()}
        median = float(np.median([value for value in errors.values() if math.isfinite(value)]))
        for law, error in errors.items():
            ratios[law].append(error / median)
    return {law: float(np.exp(np.mean(np.log(some)))) if some else math.inf for law, some in ratios.items()}


def cell(comparison: Comparison, law: str, measure: str, scale: float) -> str:
    """One number, or why there is none."""
    if law in comparison.failures:
        return "–"
    value = comparison.measures[law].get(measure)
    mark = UNSTABLE if law in comparison.unstable and measure == "rms_error" else ""
    return "diverged" if value is None else f"{scale * value:.3g}{mark}"


def markdown(found: dict[str, Comparison], laws: list[str]) -> str:
    """Return the tables for the documentation."""
    lines = []
    for measure, (label, scale) in MEASURES.items():
        lines += [f"{label}:", "", "| law | " + " | ".join(name.replace("_", " ") for name in found) + " |"]
        lines.append("| --- |" + " --- |" * len(found))
        lines += [
            f"| {law} | " + " | ".join(cell(c, law, measure, scale) for c in found.values()) + " |" for law in laws
        ]
        lines.append("")
    return "\n".join(lines)


def traces(comparison: Comparison) -> xr.Dataset:
    """Norm of the error, and torque of the strongest joint of the first law, over time; mean of the switching gain.

    NaN after a run has ended, and for a law without such a gain.
    """
    runs = {law: run.data for law, run in comparison.runs.items()}
    first = next(iter(runs.values()))
    strongest = int(np.argmax(np.abs(first["torque"].values).max(axis=0)))
    time = max((data["time"].values for data in runs.values()), key=len)
    error = np.full((len(runs), len(time)), np.nan, dtype=np.float32)
    torque, gain = error.copy(), np.full(len(runs), np.nan)
    begin = comparison.scenario.metrics_start
    for i, data in enumerate(runs.values()):
        count = data.sizes["time"]
        error[i, :count] = np.linalg.norm((data["position"] - data["reference"]).values, axis=1)
        torque[i, :count] = data["torque"].values[:, strongest]
        if "gain" in data:
            gain[i] = data["gain"].sel(time=slice(begin, None)).mean()
    dims, joint = ("law", "time"), str(first["joint"].values[strongest])
    return xr.Dataset(
        {
            "error": (dims, error, {"units": first["position"].attrs["units"]}),
            "torque": (dims, torque, {"units": first["torque"].attrs["units"], "joint": joint}),
            "gain": ("law", gain, {"units": f"{first['position'].attrs['units']}/s²"}),
        },
        {"law": list(runs), "time": time},
        {key: comparison.columns[key][2] for key in MEASURES} | {"metrics_start": begin},
    )


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
    used = {law: part for law in order if (part := tuned_laws().get(law))}
    (options.out / "laws.yaml").write_text(write_yaml(used), encoding="utf-8")
    for name, comparison in found.items():
        (options.out / f"{name}.csv").write_text(comparison.to_csv(), encoding="utf-8")
        traces(comparison).to_netcdf(options.out / f"{name}.nc", engine="h5netcdf")
        comparison.plot("plane").savefig(options.out / f"{name}.png", dpi=90)
        for law, reason in comparison.failures.items():
            console.print(f"{name}: {law} did not run: {reason}", highlight=False)
    console.print(f"written: {options.out}/comparison.md; CSV, netCDF and figures beside it")


if __name__ == "__main__":
    main()
