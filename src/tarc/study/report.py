"""One HTML file that explains a study: what was varied, what came out and how sure it is."""

from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from tarc.core.files import file_in_folder, save_text
from tarc.scenario.yaml_text import read_yaml
from tarc.simulation.quantities import MEASURES
from tarc.study.report_html import (
    format_count,
    format_number,
    format_percent,
    format_range,
    format_value,
    html_table,
    svg_figure,
    unit_of,
)
from tarc.study.report_measures import measure_section, other_measures, sensitivity_section
from tarc.study.statistics import PairedComparison
from tarc.study.summary import StudySummary, summarise

if TYPE_CHECKING:
    pass

MAX_LISTED = 10
"""Runs of a list, such as that of diverged ones."""


def write_report(
    data: xr.Dataset,
    path: str | Path,
    *,
    reference: str | None = None,
    limits: Mapping[str, float] | None = None,
    more: Sequence[str] = (),
) -> Path:
    """Write the report of a study as one HTML file, which needs no network.

    Parameters
    ----------
    data
        Results with dimensions ``run`` and ``law``.
    path
        File to write, such as ``report.html``.
    reference
        Name of the law that the others are compared with; the first without a name.
    limits
        Largest allowed value by measure [SI units]: a run that exceeds one is no success.
    more
        Further sections as HTML, such as that of `rare_event_section`.

    Raises
    ------
    InvalidParameter
        For a file that cannot be written, an unknown law or measure, and a study without runs.
    """
    target = file_in_folder("report", path)
    summary = summarise(data, reference=reference, limits=limits)
    return save_text("report", target, _page(data, summary, more))


def _page(data: xr.Dataset, summary: StudySummary, more: Sequence[str]) -> str:
    """Return the whole page."""
    name = str(data.attrs.get("title", "study")).removeprefix("study ")
    sections = [
        _summary_section(name, summary),
        _varied_section(data, summary),
        _success_section(data, summary),
        *(measure_section(data, summary, measure) for measure in summary.ranked),
        other_measures(data, summary),
        sensitivity_section(data, summary),
        *more,
        _intervals_section(summary),
        _reproduction_section(data),
    ]
    style = files("tarc.study").joinpath("report.css").read_text(encoding="utf-8")
    body = "\n".join(section for section in sections if section)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<meta name="color-scheme" '
        f'content="light dark">\n<title>{escape(name)}: study</title>\n<style>\n{style}</style>\n</head>\n'
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _summary_section(name: str, summary: StudySummary) -> str:
    """Return title and the result in sentences."""
    lines = [f"<h1>{escape(name)}</h1>", f'<p class="lead">{_count(summary)}</p>', "<ul>"]
    for law, interval in summary.success.items():
        failed = summary.n_runs - round(interval.estimate * summary.n_runs)
        what = "met the limits" if summary.limits else "completed"
        lines.append(
            f"<li><b>{escape(law)}</b>: {format_percent(interval)} of the runs {what}"
            f"{f'; {failed} did not' if failed else ''}.</li>"
        )
    for measure, comparisons in summary.comparisons.items():
        for comparison in comparisons:
            lines.append(f"<li>{_comparison_sentence(measure, comparison)}</li>")
    return "\n".join([*lines, "</ul>"])


def _count(summary: StudySummary) -> str:
    n_laws = len(summary.laws)
    laws = f"{n_laws} laws" if n_laws > 1 else escape(", ".join(summary.laws))
    varied = f"{len(summary.draws)} draws" if len(summary.draws) != 1 else "one draw"
    seed = "; all laws see the same draws and the same noise" if n_laws > 1 else ""
    return f"{format_count(summary.n_runs)} runs of {laws} with {varied} each{seed}."


def _comparison_sentence(measure: str, comparison: PairedComparison) -> str:
    label, law = MEASURES[measure].label, f"<b>{escape(comparison.law)}</b>"
    ratio = f"{format_number(comparison.ratio.estimate)} ({format_range(comparison.ratio)})"
    base = f"{law} has {ratio} of the {label} of {escape(comparison.reference)}, median over the draws"
    if comparison.verdict == "open":
        return f"{base}: the interval contains one, so that the study does not decide which has less."
    return f"{base}: {comparison.verdict}."


def _varied_section(data: xr.Dataset, summary: StudySummary) -> str:
    """Return what was varied, and how."""
    content = _content(data)
    described = {key: _distribution(given) for key, given in content.get("draws", {}).items()}
    rows = []
    for key, column in summary.draws.items():
        applied = (
            f"{format_number(column.min())} to {format_number(column.max())}" if column.dtype.kind in "iuf" else "–"
        )
        rows.append([f"<code>{escape(key)}</code>", escape(described.get(key, "–")), applied])
    scenario, method = content.get("scenario", {}), data.attrs.get("integration", {})
    facts = {
        "Scenario": scenario.get("name") if isinstance(scenario, Mapping) else scenario,
        "Sampling": str(content.get("sampling", "")).replace("_", " "),
        "Seed": content.get("seed"),
        "Engine": data.attrs.get("engine"),
        "Integration": f"{method['integrator']}, steps per period: {method['substeps']}" if method else None,
        "Correlation": "Gaussian copula, see the study below" if content.get("correlation") else None,
        "Known to the laws": ", ".join(content.get("known", [])),
        "Version": data.attrs.get("source"),
        "Computer": data.attrs.get("host"),
    }
    shown = "; ".join(f"{name}: {format_value(value)}" for name, value in facts.items() if value not in (None, ""))
    return "\n".join(
        [
            "<h2>What was varied</h2>",
            html_table(["key", "distribution", "values that ran"], rows, 2)
            if rows
            else "<p>Nothing but the noise.</p>",
            "<p>The values were read back from robot, sensor and law before the runs.</p>" if rows else "",
            f'<p class="note">{escape(shown)}.</p>' if shown else "",
        ]
    )


def _content(data: xr.Dataset) -> Mapping[str, Any]:
    """Return the keys of the study from its own text."""
    text = data.attrs.get("study", "")
    content = read_yaml(str(text), "study") if text else None
    return content if isinstance(content, Mapping) else {}


def _distribution(given: Mapping[str, Any]) -> str:
    for name, content in given.items():
        if name in ("uniform", "log_uniform"):
            return f"{name.replace('_', '-')}, {content[0]:g} to {content[1]:g}"
        if name == "normal":
            ends = [f"{word} {content[key]:g}" for word, key in (("from", "low"), ("up to", "high")) if key in content]
            return ", ".join([f"normal, {content['mean']:g} ± {content['deviation']:g}", *ends])
        if name == "choice":
            return f"one of {', '.join(map(str, content))}"
    return ", ".join(map(str, given))


def _success_section(data: xr.Dataset, summary: StudySummary) -> str:
    """Return how many runs succeeded, with the first that diverged."""
    from tarc.plotting.study import rate_figure

    rows = [
        [
            escape(law),
            format_count(round(interval.estimate * summary.n_runs)),
            f"{100 * interval.estimate:.4g} %",
            f"{100 * interval.low:.4g} to {100 * interval.high:.4g} %",
            f"{format_count(len(summary.diverged[law]))}",
        ]
        for law, interval in summary.success.items()
    ]
    limits = ", ".join(
        f"{MEASURES[name].label} at most {format_number(MEASURES[name].scale * limit)} {unit_of(data, name)}"
        for name, limit in summary.limits.items()
    )
    label = "runs within the limits" if limits else "runs that completed"
    parts = [
        "<h2>Success</h2>",
        f"<p>A run succeeds that does not diverge{f', with {escape(limits)}' if limits else ''}.</p>",
        html_table(["law", "succeeded", "share", f"{100 * summary.confidence:g} % interval", "diverged"], rows),
    ]
    if any(interval.estimate < 1 for interval in summary.success.values()):
        parts.append(svg_figure(rate_figure(summary.success, label), "success", f"Share of {label}, with its interval"))
    parts += [_diverged_list(data, summary, law) for law in summary.laws if len(summary.diverged[law])]
    return "\n".join(parts)


def _diverged_list(data: xr.Dataset, summary: StudySummary, law: str) -> str:
    """Return the first runs of a law that diverged, with their time and draws."""
    runs = summary.diverged[law]
    times = data["end_time"].sel(law=law).values
    heads = ["run", "until [s]", *(f"<code>{escape(key)}</code>" for key in summary.draws)]
    rows = [
        [str(int(data["run"].values[run])), format_number(float(times[run]))]
        + [format_value(column[run]) for column in summary.draws.values()]
        for run in runs[:MAX_LISTED]
    ]
    title = f"{escape(law)}: {format_count(len(runs))} runs diverged"
    title += f", the first {MAX_LISTED}" if len(runs) > MAX_LISTED else ""
    return f"<details><summary>{title}</summary>{html_table(heads, rows, 0)}</details>"


def _intervals_section(summary: StudySummary) -> str:
    """Return what the intervals mean."""
    level = f"{100 * summary.confidence:g} %"
    items = [
        f"An interval contains the true value, that of infinitely many runs, in {level} of all studies like this one.",
        "The true value is that of the distributions above. It says nothing of a robot outside them, or of a fault "
        "that the simulation does not have.",
        "Shares of runs: Clopper and Pearson's interval, which holds for any share and any number of runs.",
        "Quantiles: bootstrap, by its closed form. Runs that diverged count as worse than all others, so that a "
        "quantile may be “diverged”. An end is open where there are too few runs to bound it.",
        "Ratios: the median over the draws of one law's measure over the other's, on the same draw with the same "
        "noise. A law that diverges alone loses that draw. “Less” or “more” is written only where the interval "
        "excludes one.",
        "p: Wilcoxon's signed-rank test of the log ratios, corrected by Holm for the number of laws.",
        "What matters: the share of the variance that one draw explains alone, by bins of the runs, with bootstrap "
        "intervals. Runs that diverged are left out there.",
        "Runs of a Latin hypercube or a Sobol sequence fill the space more evenly than independent ones. The "
        "intervals take them as independent, which makes them too wide rather than too narrow for shares and means.",
    ]
    listing = "".join(f"<li>{item}</li>" for item in items)
    return f"<h2>What the intervals mean</h2><ul>{listing}</ul>"


def _reproduction_section(data: xr.Dataset) -> str:
    """Return how to run the study again."""
    text = str(data.attrs.get("study", ""))
    parts = [
        "<h2>Run it again</h2>",
        "<p>The same study gives the same draws and noise, run by run, on any computer and any number of processes. "
        "It is the file <code>study.yaml</code> in the folder of the results:</p>",
        "<pre>tarc study study.yaml</pre>",
    ]
    if text:
        parts.append(f"<details><summary>The study</summary><pre>{escape(text)}</pre></details>")
    facts = {key: value for key, value in data.attrs.items() if key != "study"}
    rows = [[escape(str(key)), escape(format_value(value))] for key, value in facts.items()]
    if rows:
        parts.append(f"<details><summary>All facts of the run</summary>{html_table(['', ''], rows, 2)}</details>")
    return "\n".join(parts)
