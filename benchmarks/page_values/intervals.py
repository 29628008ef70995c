"""Tables of laws against TDC over draws, from the studies of `benchmarks.claims`."""

import numpy as np

from benchmarks.claims import LAWS, PAPER, RESULTS, results
from benchmarks.page_values.registry import NO_VALUE, DataMissingError, Value, long_source, table
from tarc.study import Interval, PairedComparison, StudyResult, compare_laws, success_rate

PEAK_LIMIT = 3e-3
"""Limit of the barrier on the page of the paper's claims [rad]."""

DIFFERENCE, WINDOW = "TARC, equal rates, difference", "TARC, equal rates, window"
FASTER = "TARC, five times the rates, window"
MEASURES = ("rms_error", "peak_error", "torque_variation", "mean_gain")
QUOTED = (
    ("coarse_encoder", "barrier"),
    ("coarse_encoder", "tdarc"),
    ("coarse_encoder", "tdc-kalman"),
    ("dropout_delay", "computed-torque-integral"),
    ("series_elastic", "asmc-tde"),
    ("two_link_friction", "computed-torque-integral"),
    ("two_link_friction", "projection"),
    ("underwater", "adrc"),
    ("two_link_payload", "pid"),
    ("two_link_payload", "tdcim"),
    ("wheeled_figure_eight", "computed-torque-integral"),
    ("wheeled_figure_eight", "projection"),
)
"""Scenarios and laws whose interval of the error stands in the text."""

MODELS = ("tdc-model", "tarc-model", "tdarc-model", "barrier-model")
GROWN = {"mean_gain": "mean gain", "rms_error": "RMS error", "torque_variation": "torque variation"}


class Measured:
    """Measures of a study, and the comparisons of its laws with the first.

    Attributes
    ----------
    laws, n_runs
        Names of the laws, and number of draws.
    values
        Measures by name, (runs, laws); NaN for runs that diverged.
    """

    def __init__(self, result: StudyResult):
        self.laws = result.laws
        self.n_runs = result.data.sizes["run"]
        completed = result.data["completed"].values
        self.values = {name: np.where(completed, result.data[name].values, np.nan) for name in MEASURES}
        self._comparisons: dict[str, list[PairedComparison]] = {}

    def comparisons(self, measure: str) -> list[PairedComparison]:
        """Return the comparisons of all laws with the first one."""
        if measure not in self._comparisons:
            self._comparisons[measure] = compare_laws(self.values[measure], self.laws)
        return self._comparisons[measure]


@long_source
def intervals() -> dict[str, Value]:
    """Return the interval of the median ratio of each law to TDC, in every scenario that has run."""
    found = results()
    if not found:
        raise DataMissingError(f"no study in {RESULTS}; python -m benchmarks.claims writes them")
    paper = found.pop(PAPER, None)
    summaries = {name: Measured(result) for name, result in found.items()}
    values: dict[str, Value] = {
        "errors": _table(summaries, "rms_error"),
        "variations": _table(summaries, "torque_variation"),
        "models": _model_table(summaries),
        "runs": table(
            ["", *(name.replace("_", " ") for name in summaries)],
            [("draws", *(f"{summary.n_runs}" for summary in summaries.values()))],
        ),
    }
    values |= _counts(summaries) | _quoted(summaries)
    if paper is not None:
        values |= _paper_values(Measured(paper))
    return values


def _table(summaries: dict[str, Measured], measure: str) -> str:
    """Return a table with one row per law and one column per scenario."""
    rows = []
    for law in LAWS[1:]:
        cells = []
        for summary in summaries.values():
            one = next((one for one in summary.comparisons(measure) if one.law == law), None)
            cells.append(NO_VALUE if one is None else _cell(one, summary))
        rows.append((law, *cells))
    return table(["law", *(name.replace("_", " ") for name in summaries)], rows)


def _counts(summaries: dict[str, Measured]) -> dict[str, Value]:
    """Return in how many scenarios each law has less, more or an undecided error and torque variation."""
    values: dict[str, Value] = {"scenarios": float(len(summaries))}
    for short, measure in (("error", "rms_error"), ("variation", "torque_variation")):
        for law in LAWS[1:]:
            verdicts = [
                one.verdict for summary in summaries.values() for one in summary.comparisons(measure) if one.law == law
            ]
            values[f"{short}.{law}.of"] = float(len(verdicts))
            values |= {f"{short}.{law}.{word}": float(verdicts.count(word)) for word in ("less", "more", "open")}
    return values


def _quoted(summaries: dict[str, Measured]) -> dict[str, Value]:
    """Return the ends of the intervals of the error that the text quotes."""
    values: dict[str, Value] = {}
    for scenario, law in QUOTED:
        if scenario in summaries:
            (one,) = [one for one in summaries[scenario].comparisons("rms_error") if one.law == law]
            values |= {f"{scenario}.{law}.low": one.ratio.low, f"{scenario}.{law}.high": one.ratio.high}
    return values


def _model_table(summaries: dict[str, Measured]) -> str:
    """Return a table of the laws with M̂(q) that add to TDC with M̂(q), over that one."""
    able = {name: summary for name, summary in summaries.items() if MODELS[0] in summary.laws}
    rows = []
    for law in MODELS[1:]:
        for measure in ("rms_error", "torque_variation"):
            cells = []
            for summary in able.values():
                cells.append(_against(summary, measure, law, MODELS[0]))
            rows.append((f"{law}, {measure.replace('_', ' ').replace('rms', 'RMS')}", *cells))
    return table(["law and measure", *(name.replace("_", " ") for name in able)], rows)


def _cell(one: PairedComparison, summary: Measured) -> str:
    """Return the interval of a comparison, with the share of the draws on which the law diverged."""
    lost = one.only_law_diverged + one.both_diverged
    return f"{shown(one)}, {100 * lost / summary.n_runs:.3g} % diverged" if lost else shown(one)


def shown(one: PairedComparison) -> str:
    """Return the ends of an interval, bold where it is below one and slanted where it contains one."""
    text = _ends(one.ratio)
    return {"less": f"**{text}**", "open": f"*{text}*", "more": text}[one.verdict]


def _ends(interval: Interval) -> str:
    low, high = (f"{end:.3g}" if np.isfinite(end) else "∞" for end in (interval.low, interval.high))
    return f"{low} to {high}"


def _against(summary: Measured, measure: str, law: str, reference: str) -> str:
    """Return the interval of a law's measure over that of another."""
    chosen = [summary.laws.index(name) for name in (reference, law)]
    (one,) = compare_laws(summary.values[measure][:, chosen], (reference, law))
    return shown(one)


def _paper_values(summary: Measured) -> dict[str, Value]:
    """Return the values of the page on the paper's claims."""
    errors, variations = summary.comparisons("rms_error"), summary.comparisons("torque_variation")
    rows = [(error.law, shown(error), shown(variation)) for error, variation in zip(errors, variations, strict=True)]
    inside = {
        law: success_rate(summary.values["peak_error"][:, place] <= PEAK_LIMIT)
        for place, law in enumerate(summary.laws)
        if law in ("TDC", "TARC", "TDARC", "barrier at 3 mrad")
    }
    kept = [
        (law, f"{100 * one.estimate:.3g} %", f"{100 * one.low:.3g} to {100 * one.high:.3g} %")
        for law, one in inside.items()
    ]
    growth = [
        (law.removeprefix("TARC, "), *(_against(summary, measure, law, DIFFERENCE) for measure in GROWN))
        for law in (WINDOW, FASTER)
    ]
    return {
        "paper": table(["law", "RMS error over TDC's", "torque variation over TDC's"], rows),
        "paper_growth": table(["rates", *(f"{name} over difference's" for name in GROWN.values())], growth),
        "paper_peaks": table(["law", "peak below 3 mrad", "95 % interval"], kept),
        "paper_runs": float(summary.n_runs),
    }
