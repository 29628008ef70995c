"""The search by Optuna: trials are drawn in batches, tried, and stored with what came of them.

Optuna comes with the extra ``study``.
"""

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.trial import FrozenTrial, TrialState

from tarc.study.law_scores import FAILURE_SCORE
from tarc.study.search_sampler import MAX_BATCH
from tarc.study.search_storage import Workers
from tarc.study.trials import TrialOutcome

BATCHES = 25
"""Fewest batches of a search, since those of a batch learn nothing from each other."""
POLL_INTERVAL = 0.3
"""Time between two looks at the trials of other processes [s]."""

Evaluate = Callable[[Sequence[dict[str, float]], bool], list[TrialOutcome]]
"""Tries sets of gains; the flag says whether loops that are unstable at rest are run all the same."""


@dataclass(frozen=True)
class Search:
    """A search of gains: draws trials in batches and tries them.

    Attributes
    ----------
    study, space
        The study, and the distribution of each gain.
    trials
        Number of trials of the study, those of other processes included.
    limits
        Largest torque variation in each scenario [N m/s or N/s].
    evaluate
        Tries a batch.
    min_margin
        Least robust margin; None for none.
    workers
        The processes that share the study.
    advance
        Called with the number of trials that are finished.
    """

    study: optuna.Study
    space: Mapping[str, FloatDistribution]
    trials: int
    limits: Sequence[float]
    evaluate: Evaluate
    min_margin: float | None
    workers: Workers
    advance: Callable[[int], object] = lambda steps: None

    @property
    def batch_size(self) -> int:
        """Return the number of trials that are drawn before the first of them is run."""
        return min(max(self.trials // BATCHES, 1), MAX_BATCH)

    def run(self) -> list[FrozenTrial]:
        """Search until the study has its number of trials, and return those that are finished.

        Trials that a killed process left under way are tried first. In the end it waits for those of other processes.
        """
        batch = self._left_open() if self.workers.claim() else []
        self.workers.join()
        self.advance(sum(trial.state.is_finished() for trial in self._all()))
        while batch := self._filled(batch):
            self._try(batch)
            batch = []
        self.workers.leave()
        while self._open():
            if self.workers.claim():
                self._try(self._left_open())
                self.workers.leave()
            else:
                time.sleep(POLL_INTERVAL)
        return [trial for trial in self._all() if trial.state.is_finished() and "outcome" in trial.user_attrs]

    def _all(self, *states: TrialState) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False, states=states or None)

    def _open(self) -> list[FrozenTrial]:
        return sorted(self._all(TrialState.RUNNING), key=lambda trial: trial.number)

    def _left_open(self) -> list[optuna.Trial]:
        """Return the trials that are under way, with the gains that they lack drawn as they would have been."""
        trials = []
        for open_trial in self._open():
            trial = optuna.Trial(self.study, open_trial._trial_id)
            for key, distribution in self.space.items():
                trial.suggest_float(key, distribution.low, distribution.high, log=True)
            trials.append(trial)
        return trials

    def _filled(self, batch: list[optuna.Trial]) -> list[optuna.Trial]:
        """Return a batch with further trials drawn, up to a whole number of batches or the number of trials."""
        distributions: dict[str, BaseDistribution] = dict(self.space)
        while (not batch or (batch[-1].number + 1) % self.batch_size) and len(self._all()) < self.trials:
            batch.append(self.study.ask(distributions))
        beyond = [trial for trial in batch if trial.number >= self.trials]  # two processes may draw the last one
        for trial in beyond:
            self.study.tell(trial, state=TrialState.FAIL)
        return [trial for trial in batch if trial.number < self.trials]

    def _try(self, batch: list[optuna.Trial]) -> None:
        if not batch:
            return
        outcomes = self.evaluate([trial.params for trial in batch], not self._stable_before(batch[0].number))
        for trial, outcome in zip(batch, outcomes, strict=True):
            with suppress(optuna.exceptions.UpdateFinishedTrialError):  # another process was quicker
                self._tell(trial, outcome)
        self.advance(len(batch))

    def _stable_before(self, number: int) -> bool:
        """Return whether a trial before the batch of a number ran to the end, with a loop that is stable at rest."""
        first = number - number % self.batch_size
        return any(
            trial.number < first and TrialOutcome.from_dict(trial.user_attrs["outcome"]).is_stable
            for trial in self._all(TrialState.COMPLETE)
        )

    def _tell(self, trial: optuna.Trial, outcome: TrialOutcome) -> None:
        """Store the outcome of a trial: its objectives, or for a failure how far it came."""
        several = len(self.study.directions) > 1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of a trial that was killed when it had stored a part of this
            trial.set_user_attr("outcome", outcome.to_dict())
            if self.min_margin is not None and outcome.margin is not None:
                trial.set_constraint("margin", self.min_margin - outcome.margin)
            if outcome.failure and not several:
                step, value = outcome.standing
                trial.report(FAILURE_SCORE + value, step)
        if outcome.failure:
            self.study.tell(trial, state=TrialState.PRUNED, skip_if_finished=True)
            return
        values = list(outcome.objectives(self.limits)) if several else outcome.score(self.limits)
        self.study.tell(trial, values, skip_if_finished=True)
