"""Sections of a report about its measures: distribution, comparison of laws, and what each depends on."""

from collections.abc import Mapping, Sequence
from html import escape

import xarray as xr

from tarc.simulation.quantities import MEASURES
from tarc.study.report_html import (
    capitalised,
    format_count,
    format_number,
    format_percent,
    format_range,
    html_table,
    svg_figure,
    unit_of,
)
from tarc.study.sensitivity import Sensitivity
from tarc.study.statistics import Interval, PairedComparison
from tarc.study.summary import StudySummary

MAX_SCATTERED = 4
"""Draws of a scatter matrix."""
WORDS = {"less": "less", "more": "more", "open": "not decided"}


def measure_section(data: xr.Dataset, summary: StudySummary, measure: str) -> str:
    """Return distribution and comparisons of a measure."""
    from tarc.plotting.study import distribution_figure, ratio_figure

    info, unit = MEASURES[measure], unit_of(data, measure)
    scaled = {law: info.scale * summary.values[measure][:, place] for place, law in enumerate(summary.laws)}
    quantiles = _scaled_quantiles(summary, measure)
    label = f"{info.label} [{unit}]"
    parts = [
        f"<h2>{escape(capitalised(info.label))}</h2>",
        _quantile_table(quantiles, unit),
        f'<p class="note">Smaller print: {100 * summary.confidence:g} % interval.</p>',
        svg_figure(
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
            svg_figure(ratio_figure(comparisons, info.label), f"{measure}-ratio", f"Median ratio of {info.label}"),
        ]
    return "\n".join(parts)


def _scaled_quantiles(summary: StudySummary, measure: str) -> dict[str, dict[float, Interval]]:
    """Return the quantiles of a measure in the unit that is shown, by law and probability."""
    scale = MEASURES[measure].scale
    return {
        law: {p: Interval(*(scale * end for end in interval)) for p, interval in by_p.items()}
        for law, by_p in summary.quantiles[measure].items()
    }


def _quantile_table(quantiles: Mapping[str, Mapping[float, Interval]], unit: str) -> str:
    probabilities = list(next(iter(quantiles.values())))
    names = ["median" if p == 0.5 else f"{100 * p:g} % of the runs" for p in probabilities]
    heads = ["law", *(f"{name} [{escape(unit)}]" for name in names)]
    rows = [
        [
            escape(law),
            *(
                f"{format_number(interval.estimate)} <small>{format_range(interval)}</small>"
                for interval in by_p.values()
            ),
        ]
        for law, by_p in quantiles.items()
    ]
    return html_table(heads, rows)


def _comparison_table(comparisons: Sequence[PairedComparison], confidence: float) -> str:
    heads = ["law", "ratio", "interval", "less on", "more on", "diverged alone", "p, Holm", "verdict"]
    rows = []
    for comparison in comparisons:
        alone = f"{comparison.only_law_diverged}, {escape(comparison.reference)} {comparison.only_reference_diverged}"
        rows.append(
            [
                escape(comparison.law),
                format_number(comparison.ratio.estimate),
                format_range(comparison.ratio),
                format_count(comparison.wins),
                format_count(comparison.losses),
                alone,
                "&lt; 1e-6" if comparison.adjusted_p_value < 1e-6 else f"{comparison.adjusted_p_value:.2g}",
                f'<b class="{comparison.verdict}">{WORDS[comparison.verdict]}</b>',
            ]
        )
    count = len(comparisons)
    each = f"each at {100 * comparisons[0].confidence:.4g} %, so that " if count > 1 else ""
    note = f'<p class="note">Intervals: {each}all hold at once with {100 * confidence:g} % confidence.</p>'
    return html_table(heads, rows) + note


def other_measures(data: xr.Dataset, summary: StudySummary) -> str:
    """Return the quantiles of all further measures, folded."""
    others = [name for name in summary.values if name not in summary.ranked]
    if not others:
        return ""
    parts = []
    for name in others:
        parts.append(f"<h3>{escape(capitalised(MEASURES[name].label))}</h3>")
        parts.append(_quantile_table(_scaled_quantiles(summary, name), unit_of(data, name)))
    return f"<details><summary>All other measures</summary>{''.join(parts)}</details>"


def sensitivity_section(data: xr.Dataset, summary: StudySummary) -> str:
    """Return which draws matter."""
    from tarc.plotting.study import MAX_LAWS, sensitivity_figure

    if not summary.sensitivities:
        return ""
    parts = ["<h2>What matters</h2>"]
    for measure, by_law in summary.sensitivities.items():
        info = MEASURES[measure]
        first = next(iter(by_law.values()))
        keys = first.order
        parts.append(f"<h3>{escape(capitalised(info.label))}</h3>")
        parts.append(f"<p>{_sensitivity_sentence(info.label, by_law)}</p>")
        if len(by_law) > MAX_LAWS:
            parts.append(f"<p>The figure has the first {MAX_LAWS} laws, and of many draws those that matter.</p>")
        parts.append(
            svg_figure(sensitivity_figure(by_law, keys), f"{measure}-matters", f"What {info.label} depends on")
        )
    parts.append(_scatter(data, summary))
    return "\n".join(parts)


def _sensitivity_sentence(label: str, by_law: Mapping[str, Sensitivity]) -> str:
    parts = []
    for law, sensitivity in by_law.items():
        key = sensitivity.order[0]
        share = sensitivity.first_order[key]
        unexplained = 1 - sum(interval.estimate for interval in sensitivity.first_order.values())
        parts.append(
            f"<b>{escape(law)}</b>: <code>{escape(key)}</code> alone explains {format_percent(share)} of the variance "
            f"of the {'logarithm of the ' if sensitivity.is_log else ''}{label}; noise and interactions leave "
            f"{100 * max(unexplained, 0):.0f} %. The rank regression explains {100 * sensitivity.explained:.0f} %."
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
    picture = scatter_figure(chosen, values, f"{info.label} [{unit_of(data, measure)}]")
    caption = (
        f"{law}: {info.label} over what matters most, above, and the draws over each other, below. "
        "Yellow has more of it; crosses diverged."
    )
    return svg_figure(picture, "scatter", caption)
