"""What is generated in the pages of the laws: ``python -m benchmarks.pages``, after ``make compare``.

Each page ``docs/laws/NAME.md`` is written by hand, but for two parts between markers that this module writes. They are
the equation, from the docstring, and the benchmark, from ``runs/comparison``, with the figure
``docs/images/laws/NAME.png``. ``docs/images/make.py`` runs the comparison and this.
"""

import argparse
import csv
import inspect
import io
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from PIL import Image

from benchmarks.comparison import MEASURES, SCENARIOS
from benchmarks.latex import to_latex
from tarc import laws
from tarc.plotting.style import COLOURS, StyledFigure
from tarc.scenario.yaml_text import read_yaml, write_yaml
from tarc.study import tuned_laws

DOCS = Path(__file__).resolve().parents[1] / "docs"
YARDSTICK = "tdc"
DRAWN = {"ur5e_load": (2.9, 3.5), "two_link_payload": (5.9, 6.5)}
"""Scenarios for the figure, the first that the law runs in, each with the time [s] in which its torque is shown."""
AVERAGED = 0.1
"""Over how long the error in the figure is averaged [s]."""
COLOURFUL = 2
"""How many variants of a law are drawn over time."""


class Result(NamedTuple):
    """One scenario of the comparison: measures by law, empty for a run that diverged, and trajectories."""

    measures: dict[str, dict[str, float]]
    traces: xr.Dataset

    def place(self, name: str, measure: str) -> tuple[int, int]:
        """Place among the laws that ran to the end, and how many these are."""
        values = [one[measure] for one in self.measures.values() if one]
        return 1 + sum(value < self.measures[name][measure] for value in values), len(values)

    def ratio(self, name: str, measure: str) -> float:
        """To the yardstick's; NaN where one of both has no number."""
        one, other = (self.measures.get(law, {}).get(measure, math.nan) for law in (name, YARDSTICK))
        return one / other


def concrete_laws() -> list[type[laws.Law]]:
    """Every law of the package that can be constructed: those that have a page."""
    found = [getattr(laws, name) for name in laws.__all__]
    return [kind for kind in found if issubclass(kind, laws.Law) and not inspect.isabstract(kind)]


def read(folder: Path) -> tuple[dict[str, Result], dict[str, dict[str, Any]]]:
    """Results by scenario, and the gains that ran, by the law's name."""
    if not (folder / "laws.yaml").is_file():
        raise SystemExit(f"{folder} has no results; run make compare first")
    results = {}
    for scenario in SCENARIOS:
        measures: dict[str, dict[str, float]] = {}
        for row in csv.DictReader(io.StringIO((folder / f"{scenario}.csv").read_text(encoding="utf-8"))):
            if not row["status"].startswith("failed"):
                measures[row["law"]] = {key: float(row[key]) for key in MEASURES if row[key]}
        results[scenario] = Result(measures, xr.load_dataset(folder / f"{scenario}.nc", engine="h5netcdf"))
    return results, read_yaml((folder / "laws.yaml").read_text(encoding="utf-8"), "laws.yaml")


def equation(kind: type) -> str:
    """Return the docstring from its equation up to the parameters, with the equation as LaTeX."""
    text = inspect.cleandoc(kind.__doc__ or "").split("\n\n", 1)[1]
    text = re.split(r"\n(?:Parameters|Notes|References|Raises)\n---", text)[0].strip("\n")
    text = re.sub(r"[ \n]?Takes the\s+parameters of\s[^.:]*(?:, and:|\.)[ ]?", "", text)
    blocks = re.sub(r"((?:^    .+\n?)+)", lambda block: f"{to_latex(block[1])}\n\n", text, flags=re.M)
    return re.sub(r"\n{3,}", "\n\n", blocks).strip()


def rounded(value: Any) -> Any:
    """Return a law as a scenario writes it, with four digits."""
    if isinstance(value, dict):
        return {key: rounded(one) for key, one in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


def gains(variants: dict[str, dict[str, Any]]) -> str:
    """Return the laws' gains as a scenario writes them."""
    entries = [{"label": name, **rounded(law)} for name, law in variants.items()]
    text = write_yaml({"law": entries}, width=100)
    return f"```yaml\n{text}```"


def table(name: str, results: dict[str, Result]) -> str:
    """Error and torque variation of one law in every scenario, with ratio to the yardstick's and place."""
    heads = [head for label in ("RMS error", "variation") for head in (label, "× TDC", "place")]
    rows = [[scenario.replace("_", " "), *cells(name, result)] for scenario, result in results.items()]
    ratios = {key: [ratio for one in results.values() if (ratio := one.ratio(name, key)) > 0] for key in MEASURES}
    mean = [relative(float(np.exp(np.mean(np.log(some)))) if some else math.nan) for some in ratios.values()]
    lines = [["scenario", *heads], ["---"] * 7, *rows, ["geometric mean", "", mean[0], "", "", mean[1], ""]]
    if name == YARDSTICK:
        lines = [line[:2] + line[3:5] + line[6:] for line in lines[:-1]]
    return "\n".join("| " + " | ".join(tied(one) for one in line) + " |" for line in lines)


def cells(name: str, result: Result) -> list[str]:
    """Return the cells of one law in one scenario."""
    if name not in result.measures:
        return ["–"] * 6
    if not result.measures[name]:
        return ["diverged", "–", "–", "diverged", "–", "–"]
    found = []
    for key, (_, scale) in MEASURES.items():
        place, count = result.place(name, key)
        value = f"{significant(scale * result.measures[name][key])} {result.traces.attrs[key]}"
        found += [value, relative(result.ratio(name, key)), f"{place}/{count}"]
    return found


def adapted(name: str, results: dict[str, Result]) -> list[str]:
    """Return the mean of a gain that adapts; empty for a law with a fixed gain or none."""
    means = [one.traces["gain"].sel(law=name) if one.measures.get(name) else None for one in results.values()]
    known = [float(one) for one in means if one is not None]
    if not known or not np.ptp(known) > 1e-9 * max(known):  # so also for NaN
        return []
    shown = ["–" if one is None else tied(f"{significant(float(one))} {one.attrs['units']}") for one in means]
    return [f"The gain on average, in the table's order: {', '.join(shown)}.\nNear zero it plays no part."]


def significant(value: float) -> str:
    """Three digits, without an exponent."""
    return f"{float(f'{value:.3g}'):.10g}"


def relative(ratio: float) -> str:
    """Return a ratio with two decimals, or three digits; a dash for NaN."""
    return "–" if math.isnan(ratio) else f"{ratio:.2f}" if ratio < 10 else significant(ratio)


def tied(text: str) -> str:
    """Text that no line breaks."""
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def standing(name: str, results: dict[str, Result]) -> tuple[int, float]:
    """In how many scenarios a law did not run to its end, and its mean standing in error: less is better."""
    places = [one.place(name, "rms_error") for one in results.values() if one.measures.get(name)]
    lost = len(results) - len(places)
    return lost, float(np.mean([place / count for place, count in places])) if places else math.inf


def figure(variants: Iterable[str], results: dict[str, Result], others: Iterable[str]) -> tuple[Figure, str] | None:
    """Draw the law among the others, and over time against the yardstick; return also the first scenario it runs in."""
    names = list(variants)
    places = [*DRAWN, *(name for name in results if name not in DRAWN)]
    scenario = next((one for one in places if any(results[one].measures.get(name) for name in names)), None)
    if scenario is None:
        return None
    result = results[scenario]
    colours = dict(zip(names, COLOURS, strict=False))
    canvas = StyledFigure(figsize=(7.6, 3.9), layout="constrained")
    grid = canvas.add_gridspec(1, 2)
    left, right = canvas.add_subfigure(grid[0]), canvas.add_subfigure(grid[1])
    draw_plane(left.subplots(), result, colours, others)
    ran = [name for name in names if result.measures.get(name)]
    over_time = {name: colours[name] for name in ran[:COLOURFUL]}
    if YARDSTICK in result.measures and YARDSTICK not in names:
        over_time[YARDSTICK] = "0.35"
    span = DRAWN.get(scenario, (result.traces.attrs["metrics_start"], result.traces.attrs["metrics_start"] + 0.6))
    draw_time(right.subplots(2, 1), result, over_time, span)
    canvas.suptitle(scenario.replace("_", " "), fontsize="medium")
    return canvas, scenario


def draw_plane(axes: Axes, result: Result, colours: dict[str, str], others: Iterable[str]) -> None:
    """Accuracy against smoothness, the others grey."""
    points = {name: (one["torque_variation"], 1e3 * one["rms_error"]) for name, one in result.measures.items() if one}
    for name, colour in colours.items():
        if name in points:
            axes.plot(*points[name], "o", color=colour, ms=8, mec="white", zorder=3, label=name)
    if YARDSTICK in points and YARDSTICK not in colours:
        axes.plot(*points[YARDSTICK], "o", color="0.35", ms=5.5, zorder=2, label=YARDSTICK)
    for name in others:
        if name in points and name not in colours and name != YARDSTICK:
            axes.plot(*points[name], "o", color="0.75", ms=4.5, zorder=1)
    shown = [points[name] for name in (*colours, YARDSTICK) if name in points]
    middle = np.median(list(points.values()), axis=0)
    near = [point for point in points.values() if np.all(np.abs(np.log10(np.array(point) / middle)) < 2)]
    corners = np.array([*shown, *near])
    low, high = corners.min(axis=0), corners.max(axis=0)
    axes.set(xscale="log", yscale="log", xlim=(low[0] / 1.2, high[0] * 1.2), ylim=(low[1] / 1.4, high[1] * 1.4))
    round_ticks(axes.xaxis)
    round_ticks(axes.yaxis)
    axes.set_xlabel(f"torque variation [{result.traces.attrs['torque_variation']}]", fontsize="small")
    axes.set_ylabel(f"RMS error [{result.traces.attrs['rms_error']}]", fontsize="small")
    finish(axes)


def round_ticks(axis: Axis) -> None:
    """Label round numbers alone on a logarithmic axis, more of them where it is short."""
    decades = np.ptp(np.log10(axis.get_view_interval()))
    axis.set_major_locator(LogLocator(subs=(1, 2, 3, 5) if decades < 1 else (1, 2, 5) if decades < 2.5 else (1,)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def draw_time(panels: Any, result: Result, colours: dict[str, str], span: tuple[float, float]) -> None:
    """Draw the error's norm over the whole run, and the torque of the strongest joint for a moment of it."""
    traces = result.traces
    time = traces["time"].values
    errors, torques = panels
    count = max(round(AVERAGED / (time[1] - time[0])), 1)
    inside = (time >= span[0]) & (time <= span[1])
    for depth, (name, colour) in enumerate(colours.items()):
        error = np.convolve(traces["error"].sel(law=name).values.astype(float) ** 2, np.ones(count) / count, "valid")
        errors.semilogy(time[count - 1 :], 1e3 * np.sqrt(error), color=colour, lw=1.2, label=name, zorder=3 - depth / 9)
        torques.plot(
            time[inside], traces["torque"].sel(law=name).values[inside], color=colour, lw=0.9, zorder=3 - depth / 9
        )
    errors.axvspan(*span, color="0.9", lw=0, zorder=0)
    measured = np.concatenate(
        [line.get_ydata()[time[count - 1 :] >= traces.attrs["metrics_start"]] for line in errors.lines]
    )
    measured = measured[np.isfinite(measured)]
    if measured.size:
        errors.set_ylim(measured.min() / 1.5, measured.max() * 1.5)
    round_ticks(errors.yaxis)
    errors.set_ylabel(f"error ‖e‖ [m{traces['error'].attrs['units']}]", fontsize="small")
    torques.set_ylabel(f"torque [{traces['torque'].attrs['units']}]", fontsize="small")
    torques.set_title(f"{traces['torque'].attrs['joint']}", fontsize="small", loc="left", pad=3)
    torques.set_xlabel("time [s]", fontsize="small")
    for axes in (errors, torques):
        axes.margins(x=0)
        finish(axes)


def finish(axes: Axes) -> None:
    """Small ticks, a light grid, a legend above."""
    axes.tick_params(which="both", labelsize="x-small")
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            fontsize="x-small",
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=3,
            frameon=False,
            borderpad=0.2,
            handletextpad=0.4,
            handlelength=1.2,
            columnspacing=0.9,
        )


def save(canvas: Figure, target: Path) -> None:
    """Write a figure with a palette, in a third of the space."""
    buffer = io.BytesIO()
    canvas.savefig(buffer, dpi=125)
    image = Image.open(buffer).convert("RGB")
    target.parent.mkdir(parents=True, exist_ok=True)
    palette = image.quantize(colors=128, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    palette.save(target, optimize=True)


def replace(text: str, part: str, content: str) -> str:
    """Return a page with one generated part written again."""
    pattern = rf"(<!-- begin {part} -->\n).*?(<!-- end {part} -->)"
    new, count = re.subn(pattern, lambda found: f"{found[1]}\n{content}\n\n{found[2]}", text, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"a page needs <!-- begin {part} --> and <!-- end {part} --> once each; found {count}")
    return new


def benchmark(name: str, results: dict[str, Result], used: dict[str, dict[str, Any]]) -> tuple[str, Figure | None]:
    """Return the part about the benchmark, and write its figure."""
    variants = {label: law for label, law in used.items() if law["kind"] == name}
    if not variants:
        return "No gains have been searched for yet.", None
    order = sorted(variants, key=lambda label: (label != YARDSTICK, *standing(label, results)))
    variants = {label: variants[label] for label in order}
    drawn = figure(order, results, used)
    parts = []
    if drawn:
        shown = drawn[1].replace("_", " ")
        parts.append(f"![{name} among all laws, and over time against TDC](../images/laws/{name}.png)")
        parts.append(
            f"The scenario: {shown}.\n"
            "Left, each point is a law, the others in grey: lower is more accurate, further left is smoother.\n"
            f"Right, the error over the whole run, averaged over {AVERAGED:g} s, and the torque of the strongest joint "
            "in the shaded part."
        )
    for label in order:
        parts += [f"**`{label}`**", table(label, results), *adapted(label, results)]
    parts += ["The gains:", gains(variants)]
    return "\n\n".join(parts), drawn[0] if drawn else None


def main() -> None:
    """Write the generated parts and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="classes whose pages to write; all without")
    parser.add_argument("--results", type=Path, default=Path("runs/comparison"))
    parser.add_argument("--equations", action="store_true", help="only the equations, which need no results")
    options = parser.parse_args()
    kinds = [kind for kind in concrete_laws() if not options.names or kind.__name__ in options.names]
    for kind in kinds:
        write_part(kind, "equation", equation(kind))
    if options.equations:
        return
    results, used = read(options.results)
    if used != {name: tuned_laws().get(name) for name in used}:
        print("the gains have changed since the comparison ran; run make compare again")
    for kind in kinds:
        content, canvas = benchmark(kind.__name__, results, used)
        write_part(kind, "benchmark", content)
        if canvas:
            save(canvas, DOCS / "images" / "laws" / f"{kind.__name__}.png")
        print(kind.__name__)


def write_part(kind: type, part: str, content: str) -> None:
    """Write one generated part of a law's page."""
    page = DOCS / "laws" / f"{kind.__name__}.md"
    if not page.is_file():
        raise SystemExit(f"{page} is missing; begin it as a copy of another law's")
    page.write_text(replace(page.read_text(encoding="utf-8"), part, content), encoding="utf-8")


if __name__ == "__main__":
    main()
