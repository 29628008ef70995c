"""The search for gains: one budget, one objective, one sampler for every law."""

import os
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

import numpy as np

from tarc.analysis.inertia_ratio import inverse_ratios
from tarc.analysis.linearise import require_inertia
from tarc.analysis.optimum import OptimumDistance, law_distances
from tarc.core import validation as check
from tarc.core.errors import DesignWarning, InvalidParameter, JointLimitWarning, NotLinearisable, UnsupportedLaw
from tarc.core.optional import require
from tarc.core.progress import Progress
from tarc.scenario.model import Scenario
from tarc.simulation.run import Run
from tarc.study.comparison import check_comparable, run_one
from tarc.study.search_space import SPACES, SearchSpace

FAILURE_SCORE = 60.0
"""Objective of a run that did not complete, above that of any that did."""
INSTABILITY = 10.0
"""Added to the objective of a loop that is unstable at rest in a posture of the reference."""
PENALTY = 5.0
"""Factor of log(torque variation / limit) in the objective, where the limit is exceeded."""


REFERENCE_POSTURES = 40
"""Postures of the reference over which an inertia ratio is averaged."""


def default_search_spaces() -> dict[str, SearchSpace]:
    """Return the laws that are compared, by name, with the gains that are searched for."""
    return SPACES


def objective(scenario: Scenario, part: dict[str, Any], limit: float) -> float:
    """Return log(RMS error), plus a penalty where the torque variation [N m/s] is above a limit.

    A loop that is unstable at rest in a posture of the reference scores `INSTABILITY` more, also where dry friction or
    the motion hides it. Gains that the law refuses, and runs that diverge, score up to `FAILURE_SCORE`.
    """
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", DesignWarning)
        warnings.simplefilter("ignore", JointLimitWarning)
        try:
            trial = Scenario.parse({**scenario.model_dump(), "law": part})
            run = next(iter(trial.run(progress=False).values()))
        except InvalidParameter:
            return FAILURE_SCORE
    if not run.status.completed:
        return FAILURE_SCORE - float(run.data["time"].values[-1]) / scenario.duration
    measures = run.metrics(start_time=scenario.metrics_start)
    excess = max(0.0, float(np.log(measures["torque_variation"] / limit)))
    score = float(np.log(measures["rms_error"])) + PENALTY * excess
    return score + INSTABILITY if run.instability else score


def tune(
    space: SearchSpace,
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    *,
    trials: int = 60,
    seed: int = 0,
    warm_start: dict[str, Any] | None = None,
    progress: bool | None = None,
) -> tuple[dict[str, Any], float]:
    """Search a law's gains for the least mean log RMS error over training scenarios, under limits on torque variation.

    Optuna's tree-structured Parzen estimator on logarithmic scales; a third of the trials are drawn at random first.

    Parameters
    ----------
    space
        The law and its free keys.
    scenarios, limits
        Training scenarios, each with its limit on torque variation [N m/s].
    trials
        Number of sets of gains to try.
    seed
        Seed of the sampler.
    warm_start
        A law, as a scenario writes it. Half of the random trials keep its values where they are free here.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    law, score
        The best law as a scenario writes it, and its objective.

    Raises
    ------
    InvalidParameter
        For limits that do not match the scenarios, and a law that runs in none of them.
    MissingTool
        Without Optuna.
    """
    if not scenarios or len(limits) != len(scenarios):
        raise InvalidParameter(f"limits: got {len(limits)} for {len(scenarios)} scenarios; needs one each")
    check.integer("trials", trials, 1)
    for scenario in scenarios:
        check_comparable(scenario)
    fits = [_fits(space, scenario) for scenario in scenarios]
    if not any(fits):
        raise InvalidParameter(f"scenarios: {space.fixed['kind']} cannot run in any of the scenarios")
    pairs = [pair for pair, fit in zip(zip(scenarios, limits, strict=True), fits, strict=True) if fit]
    require("study", "tune")
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    period = scenarios[0].period

    def score(trial: "optuna.Trial") -> float:
        values = {key: trial.suggest_float(key, low, high, log=True) for key, (low, high) in space.free.items()}
        part = space.law(values, period)
        return float(np.mean([objective(scenario, part, limit) for scenario, limit in pairs]))

    sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=max(trials // 3, 1))
    study = optuna.create_study(sampler=sampler)
    for _ in range(trials // 6 if warm_start else 0):
        study.enqueue_trial(space.values(warm_start or {}))
    with Progress("tuning", trials, progress) as bar:
        study.optimize(score, n_trials=trials if space.free else 1, callbacks=[lambda *_: bar.advance()])
    return space.law(study.best_params, period), float(study.best_value)


def unstable_scenarios(law: dict[str, Any], scenarios: Sequence[Scenario]) -> list[str]:
    """Return the names of the scenarios in which a law is unstable at rest in a posture of the reference."""
    names = []
    for scenario in scenarios:
        result = run_one(scenario.model_dump(), "law", law)
        if isinstance(result, Run) and result.instability:
            names.append(scenario.name)
    return names


def optimum_distance(law: dict[str, Any], scenario: Scenario) -> OptimumDistance | None:
    """Return how far a law is from the best linear controller, at the mean inertia along the reference.

    None for a law without a loop of single joints, such as one with coupled gains or with a nonlinear estimator.
    """
    built = Scenario.parse({**scenario.model_dump(), "law": law}).build()
    (tuned,) = built.laws.values()
    positions, _, _ = built.reference.sample(np.linspace(0.0, scenario.duration, REFERENCE_POSTURES))
    try:
        tuned = require_inertia(tuned, "its distance from the optimum")
        inertias = np.array([built.plant.inertia(position) for position in positions.T])
        ratio = float(np.exp(-np.mean(np.log(inverse_ratios(inertias, tuned.M)))))
        return max(law_distances(tuned, [ratio]), key=lambda distance: distance.ratio, default=None)
    except (UnsupportedLaw, NotLinearisable):
        return None


def _fits(space: SearchSpace, scenario: Scenario) -> bool:
    """Return whether the law suits the scenario's robot: some laws need parameters that not every robot has."""
    middle = {key: float(np.sqrt(low * high)) for key, (low, high) in space.free.items()}
    try:
        trial = Scenario.parse({**scenario.model_dump(), "law": space.law(middle, scenario.period)})
        trial.build()
    except InvalidParameter:
        return False
    return True


def tune_all(
    names: Sequence[str],
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    *,
    trials: int = 60,
    seed: int = 0,
    jobs: int | None = None,
    spaces: Mapping[str, SearchSpace] | None = None,
    progress: bool | None = None,
) -> dict[str, tuple[dict[str, Any], float]]:
    """Search the gains of several laws with `tune`, each in its own process; first those that others extend.

    These get the values of the laws that extend them in the end, where they are better.

    Parameters
    ----------
    names
        Names out of `default_search_spaces`.
    scenarios, limits, trials, seed, progress
        As in `tune`.
    jobs
        Number of processes; None for one per core.
    spaces
        Further search spaces by name, such as that of `user_search_space`.

    Returns
    -------
    dict
        The law and its objective, by name.

    Raises
    ------
    InvalidParameter
        For an unknown name, and for a process that was killed.
    """
    spaces = {**default_search_spaces(), **(spaces or {})}
    for name in names:
        check.one_of("laws", name, spaces)
    contents = [scenario.model_dump() for scenario in scenarios]
    tuned: dict[str, tuple[dict[str, Any], float]] = {}
    order = dict.fromkeys(base for name in names if (base := spaces[name].extends))
    rounds = [[*order, *(n for n in names if not spaces[n].extends and n not in order)]]
    rounds.append([name for name in names if spaces[name].extends])
    total = sum(map(len, rounds))
    count = check.integer("jobs", min(os.cpu_count() or 1, len(names)) if jobs is None else jobs, 1)
    with (
        ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool,
        Progress(f"tuning {total} laws, {trials} trials each", total, progress) as bar,
    ):
        for group in rounds:
            futures = {}
            for name in group:
                warm_start = tuned[spaces[name].extends][0] if spaces[name].extends else None
                futures[pool.submit(_tune_one, spaces[name], contents, list(limits), trials, seed, warm_start)] = name
            for future in as_completed(futures):
                try:
                    tuned[futures[future]] = future.result()
                except BrokenProcessPool:
                    raise InvalidParameter(
                        "jobs: a process was killed, perhaps for lack of memory; use fewer jobs"
                    ) from None
                bar.advance()
    share_gains(tuned, [Scenario.parse(content) for content in contents], limits, spaces)
    return {name: tuned[name] for name in names}


def share_gains(
    tuned: dict[str, tuple[dict[str, Any], float]],
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    spaces: Mapping[str, SearchSpace],
) -> None:
    """Give each law that others extend their values of the gains that it shares with them, where these are better.

    A search among few gains may miss what one among more has met.

    Parameters
    ----------
    tuned
        Laws and their objectives by name, which this changes.
    scenarios, limits, spaces
        As in `tune_all`.
    """
    for base in dict.fromkeys(spaces[name].extends for name in tuned if spaces[name].extends in tuned):
        space = spaces[base]
        for name in [name for name in tuned if spaces[name].extends == base]:
            values = space.values(tuned[name][0])
            if set(values) != set(space.free):
                continue
            law = space.law(values, scenarios[0].period)
            scores = [objective(one, law, limit) for one, limit in zip(scenarios, limits, strict=True)]
            if float(np.mean(scores)) < tuned[base][1]:
                tuned[base] = law, float(np.mean(scores))


def _tune_one(
    space: SearchSpace,
    contents: list[dict[str, Any]],
    limits: list[float],
    trials: int,
    seed: int,
    warm_start: dict[str, Any] | None,
) -> tuple[dict[str, Any], float]:
    scenarios = [Scenario.parse(content) for content in contents]
    return tune(
        space,
        scenarios,
        limits,
        trials=trials,
        seed=seed,
        warm_start=warm_start,
        progress=False,
    )
