"""Values of the page on intervals, from its own code; its figures are kept."""

import numpy as np

from benchmarks.page_values.registry import ROOT, Value, long_source, run_page, table
from tarc.plotting.study import (
    distribution_figure,
    levels_figure,
    scatter_figure,
    sensitivity_figure,
    worst_case_figure,
)
from tarc.study import Interval, StudySummary, failure_probability

IMAGES = ROOT / "docs" / "images"
LIMIT, SAMPLES, REPETITIONS = 1.7e-3, 400, 5
ERROR = "RMS error [mrad]"


@long_source
def how_sure() -> dict[str, Value]:
    """Values of the page, with the rare event, which its test leaves out."""
    names = run_page("explanation/how-sure.md").names
    summary, worst, result = names["summary"], names["worst"], names["result"]
    ratios = summary.values["rms_error"][:, 1] / summary.values["rms_error"][:, 0]
    (comparison,) = summary.comparisons["rms_error"]
    rare = failure_probability(names["study"], law="TDC", limit=LIMIT, samples=SAMPLES, repetitions=REPETITIONS, seed=1)
    errors = {
        label: (run.data["time"].values, 1e3 * np.linalg.norm(run.data["position"] - run.data["reference"], axis=1))
        for label, run in (("every draw at its median", worst.trace(np.full(4, 0.5))), ("worst case", worst.run))
    }
    worst_case_figure(errors, "‖error‖ [mrad]", 5000.0).savefig(IMAGES / "how-sure-worst.png", dpi=110)
    levels_figure(rare, ERROR, lambda level: 1e3 * float(np.exp(level))).savefig(
        IMAGES / "how-sure-levels.png", dpi=110
    )
    _draw(summary)
    return {
        "one_run": names["one_run"]["TARC"] / names["one_run"]["TDC"],
        "success": _success(summary),
        "quantiles": _quantiles(summary),
        "matters": _matters(summary),
        "ratio": comparison.ratio.estimate,
        "ratio_low": comparison.ratio.low,
        "ratio_high": comparison.ratio.high,
        "losses": float(comparison.losses),
        "largest_ratio": float(np.max(ratios)),
        "worst": 1e3 * worst.measures["rms_error"],
        "worst_draw": 1e3 * float(result.data["rms_error"].sel(law="TARC").max()),
        "steps": float(worst.search.n_steps),
        "periods": float(worst.run.data.sizes["time"]),
        "rare": rare.probability.estimate,
        "rare_low": rare.probability.low,
        "rare_high": rare.probability.high,
        "rare_runs": float(rare.n_runs),
        "repetitions": float(REPETITIONS),
    }


def _draw(summary: StudySummary) -> None:
    """Draw the figures of the runs."""
    error = 1e3 * summary.values["rms_error"]
    quantiles = {
        law: {p: _scaled(interval) for p, interval in by_p.items()}
        for law, by_p in summary.quantiles["rms_error"].items()
    }
    values = {law: error[:, place] for place, law in enumerate(summary.laws)}
    distribution_figure(values, quantiles, ERROR).savefig(IMAGES / "how-sure-distribution.png", dpi=110)
    found = summary.sensitivities["rms_error"]
    keys = found["TARC"].order
    sensitivity_figure(found, keys).savefig(IMAGES / "how-sure-matters.png", dpi=110)
    chosen = {key: summary.draws[key] for key in keys[:3]}
    scatter_figure(chosen, values["TARC"], ERROR).savefig(IMAGES / "how-sure-scatter.png", dpi=110)


def _success(summary: StudySummary) -> str:
    rows = [
        (
            law,
            f"{round(interval.estimate * summary.n_runs)} of {summary.n_runs}",
            f"{100 * interval.low:.4g} to {100 * interval.high:.4g} %",
        )
        for law, interval in summary.success.items()
    ]
    return table(["law", "within 1.5 mrad", "95 % interval"], rows)


def _quantiles(summary: StudySummary) -> str:
    rows = [
        (law, *(_cell(_scaled(interval)) for interval in by_p.values()))
        for law, by_p in summary.quantiles["rms_error"].items()
    ]
    return table(["law", "median [mrad]", "95 % of the runs [mrad]", "99 % of the runs [mrad]"], rows)


def _matters(summary: StudySummary) -> str:
    found = summary.sensitivities["rms_error"]
    rows = [(f"`{key}`", *(_share(found[law].first_order[key]) for law in summary.laws)) for key in found["TARC"].order]
    return table(["draw", *(f"{law}: share of the variance" for law in summary.laws)], rows)


def _share(interval: Interval) -> str:
    return f"{100 * interval.estimate:.0f} % ({100 * interval.low:.0f} to {100 * interval.high:.0f})"


def _scaled(interval: Interval) -> Interval:
    return Interval(*(1e3 * end for end in interval))


def _cell(interval: Interval) -> str:
    return f"{interval.estimate:.3g} ({interval.low:.3g} to {interval.high:.3g})"
