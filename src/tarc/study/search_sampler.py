"""The sampler of a search of gains: random, then a Parzen estimator, then an evolution strategy.

Its draws depend on seed, trial number and finished trials alone. Optuna comes with the extra ``study``.
"""

import copy
import warnings
from collections.abc import Container, Mapping, Sequence
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.trial import FrozenTrial, TrialState

from tarc.study.front import is_on_front

MAX_BATCH = 8
"""Most trials that are drawn before the first of them is run."""
MAX_HISTORY = 256
"""Most finished trials from which the Parzen estimator learns."""
LONG_SEARCH = 200
"""Fewest trials of a search by the evolution strategy; with fewer, the Parzen estimator finds better gains."""
GENERATION = 3 * MAX_BATCH
"""Trials of a generation of the evolution strategy; of fewer, it stops on the edge that a limit makes."""
REMEMBERED = 10 * GENERATION
"""Trials among which the strategy looks for its last generation."""
SOURCES = 100
"""Best trials from which the strategy begins; the tenth of them with the least objective gives its distribution."""
MIN_SOURCES = 10
"""Fewest trials that ran to the end from which it begins; with fewer, the Parzen estimator draws."""


class RecentStudy(optuna.Study):
    """A study of which the sampler sees some trials: those under way, and the finished ones that were chosen.

    Parameters
    ----------
    study
        The study.
    chosen
        Finished trials, by `informative_trials`.
    """

    def __init__(self, study: optuna.Study, chosen: Sequence[FrozenTrial]):
        super().__init__(study.study_name, study._storage, study.sampler)
        running = study.get_trials(deepcopy=False, states=[TrialState.RUNNING])
        self._seen = [*chosen, *running]

    def get_trials(self, deepcopy: bool = True, states: Container[TrialState] | None = None) -> list[FrozenTrial]:
        """Return the trials that are seen."""
        return [trial for trial in self._seen if states is None or trial.state in states]

    def _get_trials(
        self, deepcopy: bool = True, states: Container[TrialState] | None = None, use_cache: bool = False
    ) -> list[FrozenTrial]:
        return self.get_trials(deepcopy, states)


def informative_trials(study: optuna.Study, before: int) -> list[FrozenTrial]:
    """Return the best finished trials before a number, and others evenly spaced in time, `MAX_HISTORY` in all.

    The time of a draw grows with the number of trials, and its densities hardly change with more.
    """
    finished = [trial for trial in study.get_trials(deepcopy=False) if trial.number < before]
    finished = [trial for trial in finished if trial.state in (TrialState.COMPLETE, TrialState.PRUNED)]
    complete = [trial for trial in finished if trial.state == TrialState.COMPLETE]
    if len(study.directions) > 1:
        values = np.array([trial.values for trial in complete]).reshape(-1, 2)
        best = [complete[i] for i in np.flatnonzero(is_on_front(values[:, 0], values[:, 1]))]
        best = [best[i] for i in _evenly(len(best), MAX_HISTORY // 2)]
    else:
        best = sorted(complete, key=lambda trial: float(trial.value or 0.0))[: MAX_HISTORY // 8]
    numbers = {trial.number for trial in best}
    others = [trial for trial in finished if trial.number not in numbers]
    numbers |= {others[i].number for i in _evenly(len(others), MAX_HISTORY - len(best))}
    return [trial for trial in finished if trial.number in numbers]


def _evenly(count: int, most: int) -> list[int]:
    """Return numbers from 0 to the count, evenly spaced, at most this many."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)).tolist() if count else []


def _counted(trial: FrozenTrial) -> FrozenTrial:
    """Return a trial as a complete one; a failed one has the value that it reported, by how far it came."""
    if trial.state == TrialState.COMPLETE:
        return trial
    counted = copy.copy(trial)
    counted.state, counted.value = TrialState.COMPLETE, max(trial.intermediate_values.items())[1]
    return counted


class SeededSampler(optuna.samplers.BaseSampler):
    """Random draws, then Optuna's evolution strategy (CMA-ES) in a long search, else its Parzen estimator (TPE).

    The estimator learns from few trials where gains are good. The strategy needs many, and follows the narrow valleys
    in which gains depend on each other. A search for a front has no strategy. Draws depend on seed, trial number and
    finished trials alone, so a search that was killed goes on as if it had not been.

    Parameters
    ----------
    space
        Distribution of each gain.
    seed
        Seed of the search.
    n_random
        Number of trials at the start that are drawn at random.
    is_long
        Whether the search has trials enough for the evolution strategy, `LONG_SEARCH`.
    warm_starts
        Gains to keep in the first trials; the others are drawn at random. They are taken in turn.
    n_warm
        Number of trials with such gains, the first ones.
    """

    def __init__(
        self,
        space: Mapping[str, FloatDistribution],
        seed: int,
        n_random: int,
        is_long: bool,
        warm_starts: Sequence[Mapping[str, float]] = (),
        n_warm: int = 0,
    ):
        self._space: dict[str, BaseDistribution] = dict(space)
        self._seed, self._n_random, self._is_long = seed, n_random, is_long
        self._warm_starts, self._n_warm = warm_starts, n_warm if warm_starts else 0
        self._parzen = optuna.samplers.TPESampler(seed=seed)
        self._chosen: tuple[int, list[FrozenTrial]] = -1, []
        self._sources: list[FrozenTrial] = []

    def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Seed the sampler anew by the number of the trial."""
        seed = self._seed_of(trial)
        self._parzen = optuna.samplers.TPESampler(seed=seed, n_startup_trials=1, constant_liar=True)
        self._parzen.before_trial(study, trial)

    def infer_relative_search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """Return all gains, or none for a trial that is drawn at random."""
        return {} if trial.number < self._n_random else self._space

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Draw all gains by the evolution strategy or the Parzen estimator."""
        if not search_space:
            return {}
        if self._is_long and len(study.directions) == 1:
            trials = study.get_trials(deepcopy=False)
            sources = self._sources_of(trials[: self._n_random])
            if len(sources) >= MIN_SOURCES:
                return self._evolved(study, trial, trials, sources)
        if trial.number > MAX_HISTORY:
            first = trial.number - trial.number % MAX_BATCH
            if self._chosen[0] != first:
                self._chosen = first, informative_trials(study, first)
            study = RecentStudy(study, self._chosen[1])
        return self._parzen.sample_relative(study, trial, search_space)

    def _sources_of(self, random_trials: Sequence[FrozenTrial]) -> list[FrozenTrial]:
        """Return the best of the random trials that ran to the end, the same once all are finished."""
        if self._sources:
            return self._sources
        complete = [one for one in random_trials if one.state == TrialState.COMPLETE]
        sources = sorted(complete, key=lambda one: (float(one.value or 0.0), one.number))[:SOURCES]
        if all(one.state.is_finished() for one in random_trials):
            self._sources = sources
        return sources

    def _evolved(
        self, study: optuna.Study, trial: FrozenTrial, trials: Sequence[FrozenTrial], sources: list[FrozenTrial]
    ) -> dict[str, Any]:
        """Draw gains by the evolution strategy, which keeps what it has learnt in its trials."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            strategy = optuna.samplers.CmaEsSampler(
                seed=self._seed_of(trial),
                source_trials=sources,
                popsize=GENERATION,
                n_startup_trials=0,
                warn_independent_sampling=False,
            )
        first = max(self._n_random, trial.number - REMEMBERED)
        states = TrialState.COMPLETE, TrialState.PRUNED
        own = [_counted(one) for one in trials[first : trial.number] if one.state in states]
        return strategy.sample_relative(RecentStudy(study, own), trial, self._space)

    def _seed_of(self, trial: FrozenTrial) -> int:
        return int(np.random.SeedSequence([self._seed, trial.number]).generate_state(1)[0])

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> float:
        """Return the gain of a warm start, or draw it at random."""
        assert isinstance(param_distribution, FloatDistribution)
        low, high = param_distribution.low, param_distribution.high
        if trial.number < self._n_warm:
            kept = self._warm_starts[trial.number % len(self._warm_starts)]
            if param_name in kept:
                return float(np.clip(kept[param_name], low, high))
        place = list(self._space).index(param_name)
        share = np.random.default_rng([self._seed, trial.number, place]).random()
        return float(np.clip(low * (high / low) ** share, low, high))
