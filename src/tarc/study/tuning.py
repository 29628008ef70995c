"""Gains of laws by search: of one law or several, the best ones or a front."""

from collections.abc import Mapping, Sequence
from typing import Any

from tarc.scenario.model import Scenario
from tarc.study.finished_search import FinishedSearch
from tarc.study.front import TuningFront
from tarc.study.law_scores import mean_objective
from tarc.study.law_search import ERROR, ERROR_AND_VARIATION, runs_in, search_law
from tarc.study.law_searches import search_laws
from tarc.study.search_space import SPACES, SearchSpace
from tarc.study.trials import Trials
from tarc.study.tuning_options import DEFAULT_OPTIONS, TuningOptions


def default_search_spaces() -> dict[str, SearchSpace]:
    """Return the laws that are compared, by name, with the gains that are searched for."""
    return SPACES


def tune(
    space: SearchSpace,
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    options: TuningOptions = DEFAULT_OPTIONS,
    *,
    warm_start: dict[str, Any] | None = None,
    name: str = "",
) -> tuple[dict[str, Any], float]:
    """Search a law's gains for the least mean log RMS error over training scenarios, under limits on torque variation.

    On logarithmic scales, a third of the trials are drawn at random, half of these with the gains of a warm start. The
    others are drawn by Optuna's tree-structured Parzen estimator. From 200 trials on, its evolution strategy (CMA-ES)
    draws them, beginning at the best of the random ones. A trial that diverges in a scenario is not run in the next.
    Gains that are unstable at rest are not run, as soon as others are known that are stable and completed.

    Parameters
    ----------
    space
        The law and its free keys.
    scenarios, limits
        Training scenarios, each with its limit on torque variation [N m/s].
    options
        Number of trials, seed, margin, storage and progress bar.
    warm_start
        A law, as a scenario writes it. A sixth of the trials keep its values where they are free here.
    name
        Name of the search in the storage; by default the law's kind.

    Returns
    -------
    law, score
        The best law as a scenario writes it, and its objective.

    Raises
    ------
    InvalidParameter
        For limits that do not match the scenarios, a law that runs in none of them, and a storage of another search.
    UnsupportedLaw
        With a margin: for a law to which its certificate does not apply.
    NotConverged
        With a margin: where no trial has it.
    MissingTool
        Without Optuna.
    """
    starts = [warm_start] if warm_start else []
    return search_law(space, scenarios, limits, options, ERROR, starts, name).best()


def tune_front(
    space: SearchSpace,
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    options: TuningOptions = DEFAULT_OPTIONS,
    *,
    warm_starts: Sequence[dict[str, Any]] = (),
    name: str = "",
) -> TuningFront:
    """Search the gains of a law for the front of least error and least torque variation.

    The objectives are the mean log RMS error, and the mean log torque variation over its limit.

    Parameters
    ----------
    space, scenarios, limits, options, name
        As in `tune`. The limits only scale the torque variation of different scenarios.
    warm_starts
        Laws as a scenario writes them. A sixth of the trials keep their values in turn.

    Returns
    -------
    TuningFront
        Gains that completed in all scenarios, are stable at rest and that no others beat in both objectives.

    Raises
    ------
    InvalidParameter, UnsupportedLaw, MissingTool
        As in `tune`.
    NotConverged
        Where no trial is stable and completed, or none has the margin.
    """
    return search_law(space, scenarios, limits, options, ERROR_AND_VARIATION, warm_starts, name).front()


def tune_all(
    names: Sequence[str],
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    options: TuningOptions = DEFAULT_OPTIONS,
    *,
    spaces: Mapping[str, SearchSpace] | None = None,
    failures: dict[str, str] | None = None,
) -> dict[str, tuple[dict[str, Any], float]]:
    """Search the gains of several laws with `tune`, each in its own process; first those that others extend.

    Every law has the same number of warm starts. Those of a law that extends another are the best gains of that one.
    Else they are the gains of the first scenario's law. In the end a law that others extend gets their values, where
    they are better.

    Parameters
    ----------
    names
        Names out of `default_search_spaces`.
    scenarios, limits, options
        As in `tune`.
    spaces
        Further search spaces by name, such as that of `user_search_space`.
    failures
        Filled with the reasons of laws without a result, by name. Without it such a law ends the search.

    Returns
    -------
    dict
        The law and its objective, by name.

    Raises
    ------
    InvalidParameter
        For an unknown name, and for a process that was killed.
    UnsupportedLaw, NotConverged, MissingTool
        As in `tune`.
    """
    spaces = {**default_search_spaces(), **(spaces or {})}

    def starts(result: tuple[dict[str, Any], float]) -> list[dict[str, Any]]:
        return [result[0]]

    tuned = search_laws(names, spaces, scenarios, limits, options, ERROR, FinishedSearch.best, starts, failures)
    _share_gains(tuned, scenarios, limits, spaces, options.margin)
    return {name: tuned[name] for name in names if name in tuned}


def tune_fronts(
    names: Sequence[str],
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    options: TuningOptions = DEFAULT_OPTIONS,
    *,
    spaces: Mapping[str, SearchSpace] | None = None,
    failures: dict[str, str] | None = None,
) -> dict[str, TuningFront]:
    """Search the fronts of several laws with `tune_front`, in the processes and the order of `tune_all`.

    A law that extends another starts at the front of that one.

    Parameters
    ----------
    names, scenarios, limits, options, spaces, failures
        As in `tune_all`.

    Returns
    -------
    dict
        The front, by name.

    Raises
    ------
    InvalidParameter, UnsupportedLaw, NotConverged, MissingTool
        As in `tune_all`.
    """
    spaces = {**default_search_spaces(), **(spaces or {})}

    def starts(front: TuningFront) -> list[dict[str, Any]]:
        return [point.law for point in front.points]

    fronts = search_laws(
        names, spaces, scenarios, limits, options, ERROR_AND_VARIATION, FinishedSearch.front, starts, failures
    )
    return {name: fronts[name] for name in names if name in fronts}


def _share_gains(
    tuned: dict[str, tuple[dict[str, Any], float]],
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    spaces: Mapping[str, SearchSpace],
    margin: float | None,
) -> None:
    """Give each law that others extend their values of the gains that it shares with them, where these are better.

    A search among few gains may miss what one among more has met.

    Parameters
    ----------
    tuned
        Laws and their objectives by name, which this changes.
    scenarios, limits, spaces, margin
        As in `tune_all` and its options.
    """
    for base in dict.fromkeys(spaces[name].extends for name in tuned if spaces[name].extends in tuned):
        space = spaces[base]
        kept = [pair for pair in zip(scenarios, limits, strict=True) if runs_in(space, pair[0])]
        kept_scenarios, kept_limits = [scenario for scenario, _ in kept], [limit for _, limit in kept]
        tried = Trials(kept_scenarios) if margin is not None else None
        for name in [name for name in tuned if spaces[name].extends == base]:
            values = space.values(tuned[name][0])
            if set(values) != set(space.free):
                continue
            law = space.law(values, scenarios[0].period)
            score = mean_objective(kept_scenarios, law, kept_limits)
            if score < tuned[base][1] and (tried is None or tried.margin_of(law) >= (margin or 0.0)):
                tuned[base] = law, score
