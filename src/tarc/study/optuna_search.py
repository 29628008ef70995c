"""The search by Optuna: a sampler whose draws depend on seed and trial number alone, and storage that resumes.

Optuna comes with the extra ``study``.
"""

import json
import os
import time
import warnings
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.storages import BaseStorage, InMemoryStorage, JournalStorage
from optuna.storages.journal import BaseJournalBackend, JournalFileBackend
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from tarc.core.errors import InvalidParameter
from tarc.core.files import file_in_folder, writing
from tarc.study.front import is_on_front
from tarc.study.law_scores import FAILURE_SCORE
from tarc.study.trials import TrialOutcome

if os.name == "posix":
    import fcntl

MAX_BATCH = 8
"""Most trials that are drawn before the first of them is run."""
BATCHES = 25
"""Fewest batches of a search, since those of a batch learn nothing from each other."""
MAX_HISTORY = 256
"""Most finished trials from which the sampler learns."""
LOCAL_SHARE = 1 / 3
"""Share of the trials that search about the best ones, the last of a long search."""
MIN_BEFORE_LOCAL = 200
"""Fewest trials before these: of fewer, the best are not where the least is."""
LOCAL_SOURCES = 100
"""Best trials from which that begins; the tenth of them with the least objective gives its first distribution."""
MIN_LOCAL_SOURCES = 10
"""Fewest trials that ran to the end from which it begins; with fewer, the Parzen estimator goes on."""
POLL_INTERVAL = 0.3
"""Time between two looks at the trials of other processes [s]."""

Evaluate = Callable[[Sequence[dict[str, float]], bool], list[TrialOutcome]]
"""Tries sets of gains; the flag says whether loops that are unstable at rest are run all the same."""


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


def first_local(trials: int) -> int:
    """Return the number of the first trial that searches about the best ones; a short search has none."""
    return max(round((1 - LOCAL_SHARE) * trials), MIN_BEFORE_LOCAL)


class SeededSampler(optuna.samplers.BaseSampler):
    """Random draws, then Optuna's tree-structured Parzen estimator, then its evolution strategy (CMA-ES).

    The estimator finds where gains are good, and the strategy follows the narrow valleys there, in which gains depend
    on each other. A search for a front has no strategy. Draws depend on seed, trial number and finished trials alone,
    so a search that was killed goes on as if it had not been.

    Parameters
    ----------
    space
        Distribution of each gain.
    seed
        Seed of the search.
    n_random
        Number of trials at the start that are drawn at random.
    first_local
        Number of the first trial that the evolution strategy draws.
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
        first_local: int,
        warm_starts: Sequence[Mapping[str, float]] = (),
        n_warm: int = 0,
    ):
        self._space: dict[str, BaseDistribution] = dict(space)
        self._seed, self._n_random, self._first_local = seed, n_random, first_local
        self._warm_starts, self._n_warm = warm_starts, n_warm if warm_starts else 0
        self._parzen = optuna.samplers.TPESampler(seed=seed)
        self._chosen: tuple[int, list[FrozenTrial]] = -1, []

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
        """Draw all gains by the Parzen estimator or the evolution strategy."""
        if not search_space:
            return {}
        if trial.number >= self._first_local and len(study.directions) == 1:
            return self._local(study, trial).sample_relative(study, trial, search_space)
        if trial.number > MAX_HISTORY:
            first = trial.number - trial.number % MAX_BATCH
            if self._chosen[0] != first:
                self._chosen = first, informative_trials(study, first)
            study = RecentStudy(study, self._chosen[1])
        return self._parzen.sample_relative(study, trial, search_space)

    def _local(self, study: optuna.Study, trial: FrozenTrial) -> optuna.samplers.BaseSampler:
        """Return the evolution strategy about the best trials before its first; a failed one counts by how far it came.

        What it has learnt is kept in the trials.
        """
        before = [trial for trial in study.get_trials(deepcopy=False) if trial.number < self._first_local]
        complete = [trial for trial in before if trial.state == TrialState.COMPLETE]
        best = sorted(complete, key=lambda trial: (float(trial.value or 0.0), trial.number))[:LOCAL_SOURCES]
        if len(best) < MIN_LOCAL_SOURCES:
            return self._parzen
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            return optuna.samplers.CmaEsSampler(
                seed=self._seed_of(trial),
                source_trials=best,
                consider_pruned_trials=True,
                popsize=MAX_BATCH,
                n_startup_trials=1,
                warn_independent_sampling=False,
            )

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


def open_study(
    name: str,
    problem: dict[str, Any],
    sampler: SeededSampler,
    n_objectives: int,
    storage: BaseStorage,
) -> optuna.Study:
    """Return the study of a law in a storage, a new one or the one that is there for the same problem.

    Raises
    ------
    InvalidParameter
        For a study of another problem.
    """
    directions = [StudyDirection.MINIMIZE] * n_objectives
    study = optuna.create_study(
        study_name=name, storage=storage, sampler=sampler, directions=directions, load_if_exists=True
    )
    stored = study.user_attrs.get("problem")
    if stored is None:
        study.set_user_attr("problem", problem)
        return study
    problem = json.loads(json.dumps(problem))
    differing = [key for key in {**problem, **stored} if problem.get(key) != stored.get(key)]
    if differing:
        old, new = (json.dumps(content.get(differing[0])) for content in (stored, problem))
        raise InvalidParameter(
            f"storage: it has a search of {name} with other {', '.join(differing)} ({differing[0]}: {_short(old)} "
            f"there, {_short(new)} here); repeat the former call, or give another file"
        )
    return study


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}…"


def open_storage(path: str | Path | None) -> BaseStorage:
    """Return a storage in a file, for several processes at a time, or one in memory without a path.

    Raises
    ------
    InvalidParameter
        For a folder that does not exist, a file that cannot be written, and one that is no storage of a search.
    """
    if path is None:
        return InMemoryStorage()
    file = file_in_folder("storage", path)
    _check_journal(file)
    with writing("storage", file):
        file.touch()
        return JournalStorage(Journal(file) if os.name == "posix" else JournalFileBackend(str(file)))


class Journal(BaseJournalBackend):
    """A file of one line per change, which processes append to under a lock.

    Optuna's own waits for the disk at each line, which takes longer than a trial. Here a process that is killed loses
    nothing that it wrote, and a machine without power the last seconds. A line that was cut off is passed over.

    Parameters
    ----------
    file
        The file, which exists.
    """

    def __init__(self, file: Path):
        self._file = file
        self._ends = [0]

    def read_logs(self, log_number_from: int) -> Iterator[dict[str, Any]]:
        """Return the changes from a number on."""
        last = min(log_number_from, len(self._ends) - 1)
        with self._file.open("rb") as handle:
            end = handle.seek(self._ends[last])
            number = last
            for line in handle:
                if not line.endswith(b"\n"):
                    return
                end += len(line)
                try:
                    change = json.loads(line)
                except ValueError:
                    continue
                number += 1
                if number == len(self._ends):
                    self._ends.append(end)
                if number > log_number_from:
                    yield change

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        """Append changes."""
        lines = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs).encode()
        with writing("storage", self._file), self._file.open("ab+") as handle:
            fcntl.flock(handle, fcntl.LOCK_EX)
            if handle.seek(0, os.SEEK_END):
                handle.seek(-1, os.SEEK_END)
                lines = lines if handle.read(1) == b"\n" else b"\n" + lines
            handle.write(lines)


def _check_journal(file: Path) -> None:
    """Refuse a file that Optuna did not write, before anything is added to it."""
    if not file.exists() or file.stat().st_size == 0:
        return
    with file.open("rb") as handle:
        first = handle.readline()
    try:
        is_journal = "op_code" in json.loads(first)
    except (ValueError, TypeError):
        is_journal = False
    if not is_journal:
        raise InvalidParameter(f"storage: {file} is no storage of tarc tune; give another file, such as search.journal")


class Workers:
    """Whether other processes search the same law in the same storage.

    The system ends the claim of a process that is killed. Without POSIX locks there always may be others.

    Parameters
    ----------
    path
        The storage; None for one in memory.
    study_name
        The law.
    """

    def __init__(self, path: str | Path | None, study_name: str):
        self._handle: IO[str] | None = None
        self._in_memory = path is None
        if path is not None and os.name == "posix":
            name = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in study_name)
            lock = file_in_folder("storage", f"{path}.{name}.lock-of-workers")
            with writing("storage", lock):
                self._handle = lock.open("a")

    def claim(self) -> bool:
        """Return whether there is no other process, and claim the search for this one."""
        if self._handle is None:
            return self._in_memory
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True

    def join(self) -> None:
        """Let other processes join, and show them this one."""
        if self._handle is not None:
            fcntl.flock(self._handle, fcntl.LOCK_SH)

    def leave(self) -> None:
        """Show that this process has no trial under way."""
        if self._handle is not None:
            fcntl.flock(self._handle, fcntl.LOCK_UN)

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *_: object) -> None:
        if self._handle is not None:
            self._handle.close()


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
