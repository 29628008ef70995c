"""Further runs of a study: its worst case, the probability of failure, and Sobol indices."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.plants.symbolic import SymbolicPlant
from tarc.simulation.quantities import MEASURES, measure_unit
from tarc.simulation.run import Run
from tarc.study.cases import Cases
from tarc.study.engines import Simulator
from tarc.study.loop_gradient import LoopGradient
from tarc.study.objective import StudyObjective
from tarc.study.rare_events import RareProbability, rare_probability
from tarc.study.report_searches import worst_case_section
from tarc.study.sensitivity import SobolIndices, sobol_indices
from tarc.study.specification import Study
from tarc.study.study_result import StudyResult
from tarc.study.worst_case import WorstPoint, search_worst_point

N_STARTS = 10
"""Worst runs of a study at which a search begins."""

FIRST_RUNS = 64
"""Draws of a study that are run where there are no results to begin with."""


@dataclass(frozen=True, eq=False)
class WorstCase:
    """The worst run that was found within the draws of a study.

    Attributes
    ----------
    law, measure
        Of which law, by which measure.
    draws
        Drawn values by key.
    measures
        Measures of the run, by name.
    completed, end_time
        Whether it came to its end; time of divergence, or the duration [s].
    search
        How it was found, in severities of `tarc.study.objective`.
    study
        The study of this run alone, with the same noise: `save` writes it, and ``tarc study`` replays it.
    objective
        The objective of the search.
    """

    law: str
    measure: str
    draws: dict[str, float | int | str]
    measures: dict[str, float]
    completed: bool
    end_time: float
    search: WorstPoint
    study: Study
    objective: StudyObjective

    @cached_property
    def run(self) -> Run:
        """The run with its trajectories."""
        return self.trace(self.search.point)

    def trace(self, point: Array) -> Run:
        """Simulate the run at a point of the unit cube (keys,), with the noise of the search."""
        objective = self.objective
        simulator = Simulator(Cases(objective.study), objective.integration, [self.law])
        return simulator.trace(objective.study.values_at(point[None])[0], objective.seed, self.law)

    def section(self) -> str:
        """Return the section of a report, with the error over time of a typical run and of the worst one."""
        threshold = self.objective.study.undrawn_scenario.divergence_threshold
        unit = self.run.joint_units[0]
        name, scale = MEASURES[self.measure].label, MEASURES[self.measure].scale
        shown = f"{scale * self.measures[self.measure]:.4g} {measure_unit(self.measure, self.run.joint_units)}"
        found = f"has {shown} {name}" if self.completed else f"diverges after {self.end_time:.4g} s"
        steps = f", and {self.search.n_steps} steps along gradients" if self.search.n_steps else ""
        text = (
            f"The worst run of {self.law} that a search found in {self.search.n_runs} runs{steps} {found}. "
            f"The worst draw of the study has {self._ratio(self.search.start_value)} of that severity with the same "
            "noise. A search finds a bad case, and does not prove that there is no worse one."
        )
        middle = np.full(len(self.draws), 0.5)
        runs = {"every draw at its median": self.trace(middle), "worst case": self.run}
        errors = {key: _error_norm(run) for key, run in runs.items()}
        return worst_case_section(text, self.draws, errors, f"error [m{unit}]", 1e3 * threshold)

    def _ratio(self, severity: float) -> str:
        """Return the share of the severity, as a ratio of the measures."""
        return f"{np.exp(severity - self.search.value):.3g}"

    def save(self, path: str | Path) -> Path:
        """Write the study of this run alone; ``tarc study`` runs it again and keeps its trajectories.

        Raises
        ------
        InvalidParameter
            For a folder that does not exist, and a file that cannot be written.
        """
        return self.study.save(path)


def find_worst_case(
    study: Study,
    result: StudyResult | None = None,
    *,
    law: str = "",
    measure: str = "rms_error",
    engine: str = "auto",
    generations: int = 30,
    population: int = 0,
    gradients: bool = True,
    seed: int = 0,
    progress: bool | None = None,
) -> WorstCase:
    """Search the draws of a study for the worst run of a law.

    The search is `search_worst_point` over the distributions, without the outer 0.1 % of each draw, and with
    correlations. All runs have the noise of the study's first run. The objective is the logarithm of the measure; a run
    that diverges is worse than all that complete, the earlier the worse. Gradients are those of the loop without
    quantisation, through the whole run.

    Parameters
    ----------
    study
        The study.
    result
        Its results, at whose worst runs the search begins; None for its first 64 draws.
    law
        Name of the law; the first without one.
    measure
        Name of the measure.
    engine
        Engine that runs the loops, as in `Study.run`.
    generations, population
        As in `search_worst_point`.
    gradients
        Whether to step along gradients; without effect in MuJoCo, for another measure, and once a run diverges.
    seed
        Of the search.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Raises
    ------
    InvalidParameter
        For an unknown law or measure.
    """
    per_generation = max(population, 20, 5 * len(study.draws))
    objective = StudyObjective(
        study, law, measure, engine=engine, expected_runs=FIRST_RUNS + per_generation * (generations + 2)
    )
    points = study.points()
    if result is None:
        points = points[:FIRST_RUNS]
        severities = objective(points)
    else:
        data = result.data.sel(law=objective.law)
        points = points[data["run"].values]
        check.one_of("measure", measure, result.measures)
        severities = objective.severity(data[measure].values, data["completed"].values, data["end_time"].values)
    starts = points[np.argsort(-severities, kind="stable")[:N_STARTS]]
    is_symbolic = isinstance(Cases(objective.study).nominal.simulated, SymbolicPlant)
    has_texts = any(distribution.texts for distribution in study.distributions.values())
    has_gradient = is_symbolic and not has_texts and measure == "rms_error"
    gradient = LoopGradient(objective) if gradients and has_gradient else None
    found = search_worst_point(
        objective,
        starts,
        gradient=gradient,
        generations=generations,
        population=population,
        seed=seed,
        progress=progress,
    )
    return _worst_case(objective, found)


def _error_norm(run: Run) -> tuple[Array, Array]:
    """Return time [s] and the norm of the error over the joints [mrad or mm]."""
    error = (run.data["position"] - run.data["reference"]).values
    return run.data["time"].values, 1e3 * np.linalg.norm(error, axis=1)


def _worst_case(objective: StudyObjective, found: WorstPoint) -> WorstCase:
    """Return what was found, with its measures and the study that replays it."""
    study, law = objective.study, objective.law
    chunk = objective.run(found.point[None])
    column = study.law_names.index(law)
    values = [
        distribution.plain(float(value))
        for distribution, value in zip(study.distributions.values(), study.values_at(found.point[None])[0], strict=True)
    ]
    replay = {
        "name": f"{study.name}_worst",
        "draws": {key: {"choice": [value]} for key, value in zip(study.draws, values, strict=True)},
        "runs": 1,
        "traces": 1,
        "sampling": "independent",
        "correlation": None,
    }
    return WorstCase(
        law,
        objective.measure,
        dict(zip(study.draws, values, strict=True)),
        {name: float(block[0, column]) for name, block in chunk.measures.items()},
        bool(chunk.completed[0, column]),
        float(chunk.end_time[0, column]),
        found,
        study.model_copy(update=replay),
        objective,
    )


def failure_probability(
    study: Study,
    *,
    law: str = "",
    measure: str = "rms_error",
    limit: float | None = None,
    engine: str = "auto",
    samples: int = 1000,
    level_probability: float = 0.1,
    repetitions: int = 10,
    max_levels: int = 15,
    seed: int = 0,
    progress: bool | None = None,
) -> RareProbability:
    """Estimate the probability that a law diverges within the draws of a study, or that a measure exceeds a limit.

    Draws and noise are both random, as in the study. The levels are values of the measure, and a run that diverges is
    above all of them: see `rare_probability`. The threshold of the result is the logarithm of the limit, and for
    divergence that of ten times the divergence threshold.

    Parameters
    ----------
    study
        The study.
    law
        Name of the law; the first without one.
    measure
        Name of the measure whose values are the levels.
    limit
        Its largest allowed value [SI units]; None for the probability of divergence.
    engine
        Engine that runs the loops, as in `Study.run`.
    samples, level_probability, repetitions, max_levels, seed, progress
        As in `rare_probability`.

    Raises
    ------
    InvalidParameter
        For an unknown law or measure, and a limit that is no positive number.
    NotConverged
        Where the levels do not reach the event.
    """
    from scipy.stats import norm

    objective = StudyObjective(study, law, measure, engine=engine, expected_runs=5 * samples * repetitions)
    threshold = objective.divergence_level
    if limit is not None:
        threshold = float(np.log(check.number("limit", limit, 0, strict=True)))

    def performance(points: Array, seeds: Array) -> Array:
        return objective(norm.cdf(points), seeds)

    return rare_probability(
        performance,
        len(objective.keys),
        threshold,
        samples=samples,
        level_probability=level_probability,
        repetitions=repetitions,
        max_levels=max_levels,
        seed=seed,
        progress=progress,
    )


def study_sobol_indices(
    study: Study, n: int = 1024, *, law: str = "", measure: str = "rms_error", engine: str = "auto", seed: int = 0
) -> SobolIndices:
    """Compute the Sobol indices of a measure by further runs of a study, n (k + 2) of them for k keys.

    All runs have the noise of the study's first run, so that the draws alone explain the variance. It is that of the
    measure's logarithm, with the severity of `StudyObjective` for runs that diverge.

    Parameters
    ----------
    study
        A study without correlation: the indices of correlated draws are not defined.
    n
        Number of base points, a power of two.
    law
        Name of the law; the first without one.
    measure
        Name of the measure.
    engine
        Engine that runs the loops, as in `Study.run`.
    seed
        Of the points.

    Raises
    ------
    InvalidParameter
        For a study with correlated draws, an unknown law or measure, and an n that is no power of two.
    """
    if study.correlation is not None:
        raise InvalidParameter(
            "correlation: Sobol indices need independent draws; leave it out, or use estimate_sensitivity on the runs",
            "correlation",
        )
    objective = StudyObjective(study, law, measure, engine=engine, expected_runs=n * (len(study.draws) + 2))
    return sobol_indices(objective, objective.keys, n, seed=seed)
