"""The search for the gains of one law: one budget, one objective, one sampler for every law."""

import hashlib
import json
from collections.abc import Sequence
from typing import Any

from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.optional import require
from tarc.core.progress import Progress
from tarc.core.version import __version__
from tarc.scenario.model import Scenario
from tarc.study.comparison import check_comparable
from tarc.study.finished_search import FinishedSearch
from tarc.study.robust_margin import margin_law
from tarc.study.search_space import SearchSpace
from tarc.study.trial_runs import TrialScenario
from tarc.study.trials import TrialOutcome, Trials
from tarc.study.tuning_options import TuningOptions

ERROR = ("error",)
"""Objective of the search for the best law."""
ERROR_AND_VARIATION = ("error", "variation")
"""Objectives of the search for a front."""

RANDOM_SHARE = 1 / 3
"""Share of the trials that are drawn at random, before the sampler learns from them."""
WARM_SHARE = 1 / 6
"""Share of the trials that keep known gains, the first of the random ones, the same for every law."""

MIN_COMPILED = 100
"""Fewest trials for which the loops are compiled, which takes seconds for each scenario."""


def search_law(
    space: SearchSpace,
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    options: TuningOptions,
    objectives: Sequence[str],
    warm_starts: Sequence[dict[str, Any]],
    name: str = "",
) -> FinishedSearch:
    """Search the gains of a law; return all trials.

    Raises
    ------
    InvalidParameter
        For limits that do not match the scenarios, a law that runs in none of them, and a storage of another search.
    UnsupportedLaw
        With a margin: for a law to which its certificate does not apply.
    MissingTool
        Without Optuna.
    """
    if not scenarios or len(limits) != len(scenarios):
        raise InvalidParameter(f"limits: got {len(limits)} for {len(scenarios)} scenarios; needs one each")
    for scenario in scenarios:
        check_comparable(scenario)
    pairs = [pair for pair in zip(scenarios, limits, strict=True) if runs_in(space, pair[0])]
    if not pairs:
        raise InvalidParameter(f"scenarios: {space.fixed['kind']} cannot run in any of the scenarios")
    kept, kept_limits = [scenario for scenario, _ in pairs], [limit for _, limit in pairs]
    require("study", "tune", "cmaes", "optuna")
    import optuna

    from tarc.study.optuna_search import Search
    from tarc.study.search_sampler import LONG_SEARCH, SeededSampler
    from tarc.study.search_storage import Workers, open_storage, open_study

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    examples = [space.law(values, kept[0].period) for values in space.examples()] if space.free else []
    tried = Trials(kept, options.margin, examples if options.trials >= MIN_COMPILED else ())
    if options.margin is not None:
        _require_margin(space, tried.scenarios[0])
    gains = {key: optuna.distributions.FloatDistribution(*ends, log=True) for key, ends in space.free.items()}
    trials = options.trials if gains else 1
    n_random = max(round(RANDOM_SHARE * options.trials), 1)
    starts = [values for law in warm_starts if (values := space.values(law))]
    n_warm, is_long = int(WARM_SHARE * options.trials), trials >= LONG_SEARCH
    sampler = SeededSampler(gains, options.seed, n_random, is_long, starts, n_warm)
    problem = _problem(space, kept, kept_limits, options, objectives)
    name = name or str(space.fixed["kind"])

    def evaluate(sets: Sequence[dict[str, float]], run_unstable: bool) -> list[TrialOutcome]:
        return tried.evaluate([space.law(values, kept[0].period) for values in sets], run_unstable)

    with Workers(options.storage, name) as workers, Progress(f"tuning {name}", trials, options.progress) as bar:
        study = open_study(name, problem, sampler, len(objectives), open_storage(options.storage))
        search = Search(study, gains, trials, kept_limits, evaluate, options.margin, workers, bar.advance)
        finished = [(dict(trial.params), TrialOutcome.from_dict(trial.user_attrs["outcome"])) for trial in search.run()]
    return FinishedSearch(space, kept, kept_limits, options.margin, finished)


def _problem(
    space: SearchSpace,
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    options: TuningOptions,
    objectives: Sequence[str],
) -> dict[str, Any]:
    """Return what a storage must agree in, so that its trials are those of this search."""
    contents = json.dumps([scenario.model_dump(mode="json") for scenario in scenarios], sort_keys=True)
    return {
        "version": __version__,
        "scenarios": [scenario.name for scenario in scenarios],
        "contents of the scenarios": hashlib.sha256(contents.encode()).hexdigest()[:16],
        "limits": [float(limit) for limit in limits],
        "objectives": list(objectives),
        "margin": options.margin,
        "seed": options.seed,
        "law": space.fixed,
        "ranges": {key: list(ends) for key, ends in space.free.items()},
    }


def _require_margin(space: SearchSpace, scenario: TrialScenario) -> None:
    """Refuse a law to which the certificate of the margin does not apply, by gains in the middle of the ranges."""
    law = scenario.build_law(space.law(space.middle, scenario.scenario.period))
    if law is None:
        raise UnsupportedLaw(f"margin: {space.fixed['kind']} cannot be built in the middle of its ranges")
    margin_law(law)


def runs_in(space: SearchSpace, scenario: Scenario) -> bool:
    """Return whether the law suits the scenario's robot: some laws need parameters that not every robot has."""
    try:
        trial = Scenario.parse({**scenario.model_dump(), "law": space.law(space.middle, scenario.period)})
        trial.build()
    except InvalidParameter:
        return False
    return True
