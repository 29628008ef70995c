"""What the runs of a study say: rates, quantiles, comparisons of laws and what matters."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from tarc.core import validation as check
from tarc.core.types import Array
from tarc.simulation.quantities import MEASURES
from tarc.study.sensitivity import Sensitivity, estimate_sensitivity
from tarc.study.statistics import (
    CONFIDENCE,
    Interval,
    PairedComparison,
    compare_laws,
    quantile_interval,
    success_rate,
)

PROBABILITIES = (0.5, 0.95, 0.99)
"""Probabilities of the quantiles."""

RANKED = ("rms_error", "torque_variation")
"""Measures that laws are compared by, with their variants for revolute and prismatic joints."""

DRAWN = "drawn:"
"""Beginning of the names of drawn variables."""


@dataclass(frozen=True, eq=False)
class StudySummary:
    """Statistics of a study.

    Attributes
    ----------
    laws
        Their names.
    n_runs
        Number of draws.
    draws
        Drawn values by key, each of shape (runs,).
    values
        Measures by name, each of shape (runs, laws); NaN for runs that diverged.
    completed
        Whether each run completed, shape (runs, laws).
    success
        Share of runs that completed within the limits, by law.
    limits
        Largest allowed value by measure; empty where completing is success.
    quantiles
        By measure, law and probability.
    comparisons
        By measure: every law against the first, or against the reference.
    sensitivities
        By measure and law.
    confidence
        Confidence of the intervals.
    """

    laws: tuple[str, ...]
    n_runs: int
    draws: dict[str, Array]
    values: dict[str, Array]
    completed: Array
    success: dict[str, Interval]
    limits: dict[str, float]
    quantiles: dict[str, dict[str, dict[float, Interval]]]
    comparisons: dict[str, list[PairedComparison]]
    sensitivities: dict[str, dict[str, Sensitivity]]
    confidence: float

    @property
    def ranked(self) -> list[str]:
        """Measures by which laws are compared and draws are judged."""
        return ranked_measures(self.values)

    @property
    def diverged(self) -> dict[str, Array]:
        """Indices of the runs that diverged, by law."""
        return {name: np.flatnonzero(~self.completed[:, place]) for place, name in enumerate(self.laws)}


def ranked_measures(names: Mapping[str, object]) -> list[str]:
    """Return those of the measures by which laws are compared."""
    return [name for name in names if name.startswith(RANKED)]


def summarise(
    data: xr.Dataset,
    *,
    reference: str | None = None,
    limits: Mapping[str, float] | None = None,
    confidence: float = CONFIDENCE,
) -> StudySummary:
    """Compute the statistics of a study.

    Parameters
    ----------
    data
        Results with dimensions ``run`` and ``law``, as `tarc.study.StudyResult` has them.
    reference
        Name of the law that the others are compared with; the first without a name.
    limits
        Largest allowed value by measure [SI units]: a run that exceeds one is no success.
    confidence
        Probability with which each interval contains the true value.

    Raises
    ------
    InvalidParameter
        For an unknown law or measure, and for a study without runs.
    """
    laws = tuple(str(name) for name in data["law"].values)
    completed = np.asarray(data["completed"].transpose("run", "law").values, dtype=bool)
    values = {
        name: np.where(completed, data[name].transpose("run", "law").values, np.nan)
        for name in MEASURES
        if name in data and not np.all(np.isnan(data[name].values))
    }
    limits = dict(limits or {})
    succeeded = completed.copy()
    for name, limit in limits.items():
        check.one_of("limits", name, values)
        with np.errstate(invalid="ignore"):
            succeeded &= values[name] <= check.number(f"limits.{name}", limit)
    draws = {str(name).removeprefix(DRAWN): data[name].values for name in data if str(name).startswith(DRAWN)}
    quantiles = {
        name: {
            law: {p: quantile_interval(table[:, place], p, confidence) for p in PROBABILITIES}
            for place, law in enumerate(laws)
        }
        for name, table in values.items()
    }
    ranked = ranked_measures(values)
    comparisons = {name: compare_laws(values[name], laws, reference, confidence) for name in ranked}
    return StudySummary(
        laws,
        len(completed),
        draws,
        values,
        completed,
        {law: success_rate(succeeded[:, place], confidence) for place, law in enumerate(laws)},
        limits,
        quantiles,
        comparisons if len(laws) > 1 else {},
        _sensitivities(draws, {name: values[name] for name in ranked}, laws, confidence),
        confidence,
    )


def _sensitivities(
    draws: Mapping[str, Array], values: Mapping[str, Array], laws: tuple[str, ...], confidence: float
) -> dict[str, dict[str, Sensitivity]]:
    """Return the sensitivities by measure and law, where they are defined."""
    varied = {key: column for key, column in draws.items() if np.any(column != column[0])}
    if not varied:
        return {}
    sensitivities = {
        name: {
            law: sensitivity
            for place, law in enumerate(laws)
            if (sensitivity := estimate_sensitivity(varied, table[:, place], confidence=confidence)) is not None
        }
        for name, table in values.items()
    }
    return {name: by_law for name, by_law in sensitivities.items() if by_law}
