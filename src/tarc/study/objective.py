"""How bad a run is, as a function of where its draws lie in the unit cube: what searches and splitting evaluate."""

from typing import TYPE_CHECKING

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.simulation.integration import Integration
from tarc.study.cases import Cases
from tarc.study.draws import run_seeds
from tarc.study.execution import build_engine, choose_study_integration

if TYPE_CHECKING:
    from tarc.study.engines import ChunkResult
    from tarc.study.specification import Study

DIVERGED = 10.0
"""Factor of the divergence threshold that a run which diverges counts as, at least."""

LEAST = 1e-12
"""Least measure of which the logarithm is taken."""


class StudyObjective:
    """Severity of the runs of one law of a study, at points of the unit cube.

        log of the measure for a run that completed,
        log(10 × divergence threshold) + 1 − t/T for one that diverged at t of T

    So a run that diverges is worse than every run that completes, and one that diverges earlier is worse still. A point
    has one coordinate for each key: the probability with which its draw is less, before correlation.

    Parameters
    ----------
    study
        The study.
    law
        Name of the law; the first without one.
    measure
        Name of the measure, such as ``rms_error``.
    engine
        Engine that runs the loops, as in `Study.run`.
    integration
        Method and steps; None to choose them as the study does.
    expected_runs
        About how many runs there will be: more of them pay for machine code.

    Attributes
    ----------
    keys
        Drawn keys.
    law
        Name of the law.
    seed
        Seed of the noise of a run without its own: that of the study's first run.
    divergence_level
        Severity from which on a run has diverged.
    """

    def __init__(
        self,
        study: "Study",
        law: str = "",
        measure: str = "rms_error",
        *,
        engine: str = "auto",
        integration: Integration | None = None,
        expected_runs: int = 0,
    ):
        self.law = check.one_of("law", law or study.law_names[0], study.law_names)
        self.study = with_one_law(study, self.law)
        self.measure = measure
        self.keys = tuple(study.distributions)
        self.seed = int(run_seeds(study.seed, np.zeros(1, dtype=int))[0])
        scenario = study.undrawn_scenario
        self._duration = scenario.duration
        self.divergence_level = float(np.log(DIVERGED * scenario.divergence_threshold))
        self.integration = integration or choose_study_integration(Cases(self.study), self.study.draw())
        many = self.study.model_copy(update={"runs": max(self.study.runs, expected_runs)})
        self._engine = build_engine(many, self.integration, engine)
        self._column = self.study.law_names.index(self.law)

    def __call__(self, points: Array, seeds: Array | None = None) -> Array:
        """Return the severity of runs at points (k, keys), with one seed of the noise each, shape (k,)."""
        result = self.run(points, seeds)
        completed, end_time = result.completed[:, self._column], result.end_time[:, self._column]
        if self.measure not in result.measures and np.any(completed):
            raise InvalidParameter(
                f"measure: got {self.measure!r}; the runs have {', '.join(result.measures)}", "measure"
            )
        values = (
            result.measures[self.measure][:, self._column] if self.measure in result.measures else end_time * np.nan
        )
        return self.severity(values, completed, end_time)

    def severity(self, values: Array, completed: Array, end_time: Array) -> Array:
        """Return the severity of runs with these measures and ends, each of shape (k,)."""
        with np.errstate(invalid="ignore"):
            severity = np.minimum(np.log(np.maximum(values, LEAST)), self.divergence_level - 1e-9)
        return np.where(completed, severity, self.divergence_level + 1 - end_time / self._duration)

    def run(self, points: Array, seeds: Array | None = None) -> "ChunkResult":
        """Return the results of runs at points (k, keys)."""
        count = len(points)
        chosen = np.full(count, self.seed) if seeds is None else seeds
        return self._engine.run(np.arange(count), self.study.values_at(points), chosen)


def with_one_law(study: "Study", law: str) -> "Study":
    """Return the study with one of its laws alone; with all where a draw is that of a law by its number."""
    names = study.law_names
    if len(names) == 1 or any(key.startswith("law.") and key.split(".")[1].isdigit() for key in study.draws):
        return study
    content = study.scenario
    assert isinstance(content, dict)
    laws = study.laws if study.laws is not None else content["law"]
    return study.model_copy(update={"laws": [laws[names.index(law)]]})
