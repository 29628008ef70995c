"""One HTML file that explains a study: what was varied, what came out and how sure it is."""

import io
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from tarc.core.files import file_in_folder, save_text
from tarc.core.formatting import format_vector
from tarc.scenario.yaml_text import read_yaml
from tarc.simulation.quantities import MEASURES, measure_unit
from tarc.study.rare_events import RareProbability
from tarc.study.sensitivity import Sensitivity
from tarc.study.statistics import Interval, PairedComparison
from tarc.study.summary import StudySummary, summarise

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_LISTED = 10
"""Runs of a list, such as that of diverged ones."""

MAX_SCATTERED = 4
"""Draws of a scatter matrix."""

PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of the figures that the page's style replaces in dark mode."""

INK = "#000000"

WORDS = {"less": "less", "more": "more", "open": "not decided"}


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
        *(_measure_section(data, summary, measure) for measure in summary.ranked),
        _other_measures(data, summary),
        _sensitivity_section(data, summary),
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
            f"<li><b>{escape(law)}</b>: {_percent(interval)} of the runs {what}"
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
    return f"{_grouped(summary.n_runs)} runs of {laws} with {varied} each{seed}."


def _comparison_sentence(measure: str, comparison: PairedComparison) -> str:
    label, law = MEASURES[measure].label, f"<b>{escape(comparison.law)}</b>"
    ratio = f"{_number(comparison.ratio.estimate)} ({_range(comparison.ratio)})"
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
        applied = f"{_number(column.min())} to {_number(column.max())}" if column.dtype.kind in "iuf" else "–"
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
    shown = "; ".join(f"{name}: {_text(value)}" for name, value in facts.items() if value not in (None, ""))
    return "\n".join(
        [
            "<h2>What was varied</h2>",
            _table(["key", "distribution", "values that ran"], rows, 2) if rows else "<p>Nothing but the noise.</p>",
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
            _grouped(round(interval.estimate * summary.n_runs)),
            f"{100 * interval.estimate:.4g} %",
            f"{100 * interval.low:.4g} to {100 * interval.high:.4g} %",
            f"{_grouped(len(summary.diverged[law]))}",
        ]
        for law, interval in summary.success.items()
    ]
    limits = ", ".join(
        f"{MEASURES[name].label} at most {_number(MEASURES[name].scale * limit)} {_unit(data, name)}"
        for name, limit in summary.limits.items()
    )
    label = "runs within the limits" if limits else "runs that completed"
    parts = [
        "<h2>Success</h2>",
        f"<p>A run succeeds that does not diverge{f', with {escape(limits)}' if limits else ''}.</p>",
        _table(["law", "succeeded", "share", f"{100 * summary.confidence:g} % interval", "diverged"], rows),
    ]
    if any(interval.estimate < 1 for interval in summary.success.values()):
        parts.append(_figure(rate_figure(summary.success, label), "success", f"Share of {label}, with its interval"))
    parts += [_diverged_list(data, summary, law) for law in summary.laws if len(summary.diverged[law])]
    return "\n".join(parts)


def _diverged_list(data: xr.Dataset, summary: StudySummary, law: str) -> str:
    """Return the first runs of a law that diverged, with their time and draws."""
    runs = summary.diverged[law]
    times = data["end_time"].sel(law=law).values
    heads = ["run", "until [s]", *(f"<code>{escape(key)}</code>" for key in summary.draws)]
    rows = [
        [str(int(data["run"].values[run])), _number(float(times[run]))]
        + [_text(column[run]) for column in summary.draws.values()]
        for run in runs[:MAX_LISTED]
    ]
    title = f"{escape(law)}: {_grouped(len(runs))} runs diverged"
    title += f", the first {MAX_LISTED}" if len(runs) > MAX_LISTED else ""
    return f"<details><summary>{title}</summary>{_table(heads, rows, 0)}</details>"


def _measure_section(data: xr.Dataset, summary: StudySummary, measure: str) -> str:
    """Return distribution and comparisons of a measure."""
    from tarc.plotting.study import distribution_figure, ratio_figure

    info, unit = MEASURES[measure], _unit(data, measure)
    scaled = {law: info.scale * summary.values[measure][:, place] for place, law in enumerate(summary.laws)}
    quantiles = {
        law: {p: Interval(*(info.scale * end for end in interval)) for p, interval in by_p.items()}
        for law, by_p in summary.quantiles[measure].items()
    }
    label = f"{info.label} [{unit}]"
    parts = [
        f"<h2>{escape(_capital(info.label))}</h2>",
        _quantile_table(quantiles, unit, summary.confidence),
        _figure(
            distribution_figure(scaled, quantiles, label),
            measure,
            f"Share of the runs up to each value of {info.label}",
        ),
    ]
    comparisons = summary.comparisons.get(measure)
    if comparisons:
        parts += [
            f"<h3>Against {escape(comparisons[0].reference)}, draw by draw</h3>",
            _comparison_table(comparisons, summary.confidence),
            _figure(ratio_figure(comparisons, info.label), f"{measure}-ratio", f"Median ratio of {info.label}"),
        ]
    return "\n".join(parts)


def _quantile_table(
    quantiles: Mapping[str, Mapping[float, Interval]], unit: str, confidence: float, caption: str = ""
) -> str:
    probabilities = list(next(iter(quantiles.values())))
    names = ["median" if p == 0.5 else f"{100 * p:g} % of the runs" for p in probabilities]
    heads = ["law", *(f"{name} [{escape(unit)}]" for name in names)]
    rows = [
        [
            escape(law),
            *(f"{_number(interval.estimate)} <small>{_range(interval)}</small>" for interval in by_p.values()),
        ]
        for law, by_p in quantiles.items()
    ]
    note = f'<p class="note">{caption or "Smaller print"}: {100 * confidence:g} % interval.</p>'
    return _table(heads, rows) + ("" if caption == "none" else note)


def _comparison_table(comparisons: Sequence[PairedComparison], confidence: float) -> str:
    heads = ["law", "ratio", "interval", "less on", "more on", "diverged alone", "p, Holm", "verdict"]
    rows = []
    for one in comparisons:
        alone = f"{one.only_law_diverged}, {escape(one.reference)} {one.only_reference_diverged}"
        rows.append(
            [
                escape(one.law),
                _number(one.ratio.estimate),
                _range(one.ratio),
                _grouped(one.wins),
                _grouped(one.losses),
                alone,
                "&lt; 1e-6" if one.adjusted_p_value < 1e-6 else f"{one.adjusted_p_value:.2g}",
                f'<b class="{one.verdict}">{WORDS[one.verdict]}</b>',
            ]
        )
    count = len(comparisons)
    each = f"each at {100 * comparisons[0].confidence:.4g} %, so that " if count > 1 else ""
    note = f'<p class="note">Intervals: {each}all hold at once with {100 * confidence:g} % confidence.</p>'
    return _table(heads, rows) + note


def _other_measures(data: xr.Dataset, summary: StudySummary) -> str:
    """Return the quantiles of all further measures, folded."""
    others = [name for name in summary.values if name not in summary.ranked]
    if not others:
        return ""
    parts = []
    for name in others:
        info = MEASURES[name]
        quantiles = {
            law: {p: Interval(*(info.scale * end for end in interval)) for p, interval in by_p.items()}
            for law, by_p in summary.quantiles[name].items()
        }
        parts.append(f"<h3>{escape(_capital(info.label))}</h3>")
        parts.append(_quantile_table(quantiles, _unit(data, name), summary.confidence, "none"))
    return f"<details><summary>All other measures</summary>{''.join(parts)}</details>"


def _sensitivity_section(data: xr.Dataset, summary: StudySummary) -> str:
    """Return which draws matter."""
    from tarc.plotting.study import sensitivity_figure

    if not summary.sensitivities:
        return ""
    parts = ["<h2>What matters</h2>"]
    for measure, by_law in summary.sensitivities.items():
        info = MEASURES[measure]
        first = next(iter(by_law.values()))
        keys = first.order
        parts.append(f"<h3>{escape(_capital(info.label))}</h3>")
        parts.append(f"<p>{_sensitivity_sentence(info.label, by_law)}</p>")
        parts.append(_figure(sensitivity_figure(by_law, keys), f"{measure}-matters", f"What {info.label} depends on"))
    parts.append(_scatter(data, summary))
    return "\n".join(parts)


def _sensitivity_sentence(label: str, by_law: Mapping[str, Sensitivity]) -> str:
    parts = []
    for law, found in by_law.items():
        key = found.order[0]
        share = found.first_order[key]
        rest = 1 - sum(interval.estimate for interval in found.first_order.values())
        parts.append(
            f"<b>{escape(law)}</b>: <code>{escape(key)}</code> alone explains {_percent(share)} of the variance of the "
            f"{'logarithm of the ' if found.is_log else ''}{label}; noise and interactions leave "
            f"{100 * max(rest, 0):.0f} %. The rank regression explains {100 * found.explained:.0f} %."
        )
    return "<br>".join(parts)


def _scatter(data: xr.Dataset, summary: StudySummary) -> str:
    """Return the scatter matrix of what matters most, for the law that diverged most often."""
    from tarc.plotting.study import scatter_figure

    measure = summary.ranked[0]
    by_law = summary.sensitivities.get(measure, {})
    if not by_law:
        return ""
    law = max(by_law, key=lambda name: len(summary.diverged[name]))
    numeric = {key: summary.draws[key] for key in by_law[law].order if summary.draws[key].dtype.kind in "biuf"}
    chosen = dict(list(numeric.items())[:MAX_SCATTERED])
    if not chosen:
        return ""
    info = MEASURES[measure]
    values = info.scale * summary.values[measure][:, summary.laws.index(law)]
    picture = scatter_figure(chosen, values, f"{info.label} [{_unit(data, measure)}]")
    caption = (
        f"{law}: {info.label} over what matters most, above, and the draws over each other, below. "
        "Yellow has more of it; crosses diverged."
    )
    return _figure(picture, "scatter", caption)


def rare_event_section(found: RareProbability, event: str, label: str) -> str:
    """Return the section about a rare event, for `write_report`.

    Parameters
    ----------
    found
        The result of `tarc.study.rare_events.rare_probability`.
    event
        The event in words, such as ``TDC diverges``.
    label
        Of the performance whose levels were split.
    """
    from tarc.plotting.study import levels_figure

    probability = found.probability
    return "\n".join(
        [
            "<h2>Rare event</h2>",
            f"<p>{escape(event)} with probability <b>{probability.estimate:.2g}</b> "
            f"({probability.low:.2g} to {probability.high:.2g}), from {_grouped(found.n_runs)} runs in "
            f"{len(found.estimates)} independent estimates by importance splitting. "
            f"Plain sampling needs {_grouped(round(100 / probability.estimate))} runs to see it a hundred times.</p>"
            if probability.estimate
            else "",
            _figure(levels_figure(found, label), "levels", "Probability over the levels of each estimate"),
        ]
    )


def worst_case_section(
    text: str,
    draws: Mapping[str, float],
    errors: Mapping[str, tuple[np.ndarray, np.ndarray]],
    label: str,
    threshold: float,
) -> str:
    """Return the section about a worst case, for `write_report`; `WorstCase.section` makes it.

    Parameters
    ----------
    text
        What was searched and found, in words.
    draws
        Drawn values of the worst run, by key.
    errors
        Time [s] and norm of the error of some runs, by their names.
    label
        Of the error, with its unit.
    threshold
        Error beyond which a run has diverged, in the same unit.
    """
    from tarc.plotting.study import worst_case_figure

    rows = [[f"<code>{escape(key)}</code>", _number(value)] for key, value in draws.items()]
    picture = worst_case_figure(errors, label, threshold)
    return "\n".join(
        [
            "<h2>Worst case</h2>",
            f"<p>{escape(text)}</p>",
            _table(["key", "value"], rows),
            _figure(picture, "worst-case", f"{label} over time: {', '.join(errors)}"),
        ]
    )


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
    rows = [[escape(str(key)), escape(_text(value))] for key, value in facts.items()]
    if rows:
        parts.append(f"<details><summary>All facts of the run</summary>{_table(['', ''], rows, 2)}</details>")
    return "\n".join(parts)


def _figure(figure: "Figure", name: str, caption: str) -> str:
    """Return a figure as SVG in the page, whose colours follow the page's, with its caption."""
    from matplotlib import rc_context

    stream = io.StringIO()
    with rc_context({"svg.hashsalt": name}):
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None, "Creator": None}, dpi=150)
    picture = stream.getvalue()
    picture = picture[picture.index("<svg") :]
    picture = re.sub(r"<metadata>.*?</metadata>", "", picture, flags=re.DOTALL)
    picture = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', picture)
    picture = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", picture)
    for number, colour in enumerate(PALETTE):
        picture = picture.replace(colour, f"var(--c{number})")
    picture = picture.replace(INK, "currentColor")
    for side in ("width", "height"):
        picture = re.sub(rf'(<svg [^>]*?){side}="[^"]*"', r"\1", picture, count=1)
    picture = picture.replace("<svg ", f'<svg role="img" aria-label="{escape(caption)}" ', 1)
    return f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]], n_texts: int = 1) -> str:
    """Return a table; all columns but the first ones hold numbers."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{'' if place < n_texts else ' class=number'}>{cell}</{tag}>" for place, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    head = f"<thead><tr>{cells('th', heads)}</tr></thead>" if any(heads) else ""
    return f'<div class="wide"><table>{head}<tbody>{body}</tbody></table></div>'


def _unit(data: xr.Dataset, measure: str) -> str:
    return measure_unit(measure, data.attrs.get("joint_units", ["rad"]), str(data.attrs.get("command_unit", "")))


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _number(value: float) -> str:
    """Return four significant digits; words for what is infinite."""
    value = float(value)
    if np.isnan(value):
        return "–"
    if np.isinf(value):
        return "diverged" if value > 0 else "none"
    if value != 0 and not 1e-3 <= abs(value) < 1e7:
        mantissa, exponent = f"{value:.3e}".split("e")
        return f"{float(mantissa):g}e{int(exponent)}"
    return _grouped(round(value)) if abs(value) >= 10_000 else f"{value:.4g}"


def _range(interval: Interval) -> str:
    """Return the ends of an interval; an open end in words."""
    low, high = interval.low, interval.high
    if low == np.inf:
        return "diverged"
    if np.isinf(low) and np.isinf(high):
        return "too few runs"
    if np.isinf(high):
        return f"at least {_number(low)}"
    if np.isinf(low):
        return f"at most {_number(high)}"
    return f"{_number(low)} to {_number(high)}"


def _percent(interval: Interval) -> str:
    estimate, low, high = (100 * end for end in interval)
    return f"{estimate:.4g} % ({low:.4g} to {high:.4g} %)"


def _grouped(count: int) -> str:
    return f"{count:,}".replace(",", "\N{NARROW NO-BREAK SPACE}") if count >= 10_000 else str(count)


def _text(value: object) -> str:
    if isinstance(value, np.ndarray | list | tuple):
        return format_vector(value) if np.asarray(value).dtype.kind in "biuf" else ", ".join(map(str, value))
    return _number(float(value)) if isinstance(value, float | np.floating) else str(value)
