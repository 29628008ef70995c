"""The search for gains: one budget, one objective, one sampler for every law."""

import hashlib
import json
import os
import signal
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tarc.analysis.inertia_ratio import inverse_ratios
from tarc.analysis.linearise import require_inertia
from tarc.analysis.optimum import OptimumDistance, law_distances
from tarc.core import validation as check
from tarc.core.errors import (
    DesignWarning,
    InvalidParameter,
    JointLimitWarning,
    NotConverged,
    NotLinearisable,
    UnsupportedLaw,
)
from tarc.core.optional import require
from tarc.core.progress import Progress
from tarc.core.version import __version__
from tarc.scenario.model import Scenario
from tarc.simulation.run import Run
from tarc.study.comparison import check_comparable, run_one
from tarc.study.front import FrontPoint, TuningFront, is_on_front
from tarc.study.robust_margin import margin_law
from tarc.study.search_space import SPACES, SearchSpace
from tarc.study.trial_runs import TrialScenario
from tarc.study.trials import INSTABILITY, PENALTY, TrialOutcome, Trials

FAILURE_SCORE = 60.0
"""Objective of a run that did not complete, above that of any that did."""

RANDOM_SHARE = 1 / 3
"""Share of the trials that are drawn at random, before the sampler learns from them."""
WARM_SHARE = 1 / 6
"""Share of the trials that keep known gains, the first of the random ones, the same for every law."""
VERIFIED = 5
"""Best trials that are run again as `tarc run` runs them, until one is as good as in the search."""
VERIFIED_DIFFERENCE = 0.02
"""Largest increase of the objective in such a run."""

MIN_COMPILED = 100
"""Fewest trials for which the loops are compiled, which takes seconds for each scenario."""

REFERENCE_POSTURES = 40
"""Postures of the reference over which an inertia ratio is averaged."""

T = TypeVar("T")


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


@dataclass(frozen=True, kw_only=True)
class TuningOptions:
    """How a law is searched.

    Attributes
    ----------
    trials
        Number of sets of gains to try.
    seed
        Seed of the sampler.
    margin
        Least robust margin over the robot's inertia ratios, see `RobustMargin`; None for no certificate.
    storage
        File of the trials, from which a search that was killed goes on; processes may share it. None for none.

    Raises
    ------
    InvalidParameter
        For a number of trials below one, a negative seed, and a margin at or below −1.
    """

    trials: int = 60
    seed: int = 0
    margin: float | None = None
    storage: str | Path | None = None

    def __post_init__(self) -> None:
        check.integer("trials", self.trials, 1)
        check.integer("seed", self.seed, 0)
        if self.margin is not None:
            check.number("margin", self.margin, -1, strict=True)


def tune(
    space: SearchSpace,
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    *,
    trials: int = 60,
    seed: int = 0,
    warm_start: dict[str, Any] | None = None,
    margin: float | None = None,
    storage: str | Path | None = None,
    name: str = "",
    progress: bool | None = None,
) -> tuple[dict[str, Any], float]:
    """Search a law's gains for the least mean log RMS error over training scenarios, under limits on torque variation.

    Optuna's tree-structured Parzen estimator on logarithmic scales. A third of the trials are drawn at random first,
    half of these with the gains of a warm start. A trial that diverges in a scenario is not run in the next. Gains that
    are unstable at rest are not run, as soon as others are known that are stable and completed.

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
        A law, as a scenario writes it. A sixth of the trials keep its values where they are free here.
    margin
        Least robust margin. Only laws are taken whose loop tolerates all inertia ratios of the robot at any rate, with
        this margin. The certificate is that of `certify_varying_ratio`. None for no certificate.
    storage
        File of the trials. A search that was killed goes on from there, and several processes may share it.
    name
        Name of the search in the storage; by default the law's kind.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    law, score
        The best law as a scenario writes it, and its objective.

    Raises
    ------
    InvalidParameter
        For limits that do not match the scenarios, a law that runs in none of them, and a storage of another search.
    UnsupportedLaw
        With ``margin``: for a law to which its certificate does not apply.
    NotConverged
        With ``margin``: where no trial has it.
    MissingTool
        Without Optuna.
    """
    options = TuningOptions(trials=trials, seed=seed, margin=margin, storage=storage)
    starts = [warm_start] if warm_start else []
    found = _search(space, scenarios, limits, options, ("error",), starts, name, progress)
    return found.best()


def tune_front(
    space: SearchSpace,
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    *,
    trials: int = 60,
    seed: int = 0,
    warm_starts: Sequence[dict[str, Any]] = (),
    margin: float | None = None,
    storage: str | Path | None = None,
    name: str = "",
    progress: bool | None = None,
) -> TuningFront:
    """Search the gains of a law for the front of least error and least torque variation.

    The objectives are the mean log RMS error, and the mean log torque variation over its limit.

    Parameters
    ----------
    space, scenarios, limits, trials, seed, margin, storage, name, progress
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
    options = TuningOptions(trials=trials, seed=seed, margin=margin, storage=storage)
    found = _search(space, scenarios, limits, options, ("error", "variation"), warm_starts, name, progress)
    return found.front()


@dataclass(frozen=True)
class _Found:
    """Finished trials of a law: gains and outcome of each."""

    space: SearchSpace
    scenarios: Sequence[Scenario]
    limits: Sequence[float]
    margin: float | None
    trials: list[tuple[dict[str, float], TrialOutcome]]

    def law(self, gains: dict[str, float]) -> dict[str, Any]:
        return self.space.law(gains, self.scenarios[0].period)

    def best(self) -> tuple[dict[str, Any], float]:
        """Return the best law and its objective, in runs as `tarc run` makes them.

        The steps of the integration were those of the scenario's laws. Where a run with its own steps is worse, the
        next best is run too.
        """
        complete = [(outcome.score(self.limits), gains) for gains, outcome in self._certified() if not outcome.failure]
        if not complete:
            gains, _ = max(self._certified(), key=lambda trial: (trial[1].standing[0], -trial[1].standing[1]))
            return self.law(gains), self._objective(self.law(gains))
        verified = []
        for score, gains in sorted(complete, key=lambda pair: pair[0])[:VERIFIED]:
            law = self.law(gains)
            verified.append((self._objective(law), law))
            if verified[-1][0] <= score + VERIFIED_DIFFERENCE:
                break
        score, law = min(verified, key=lambda pair: pair[0])
        return law, score

    def front(self) -> TuningFront:
        """Return the trials that no others beat in both objectives."""
        stable = [(gains, outcome) for gains, outcome in self._certified() if outcome.is_stable]
        if not stable:
            raise NotConverged(
                f"tune: none of {len(self.trials)} sets of gains of {self.space.fixed['kind']} completed and is stable "
                f"at rest ({_counted(self.failures)}); try more, or other ranges"
            )
        values = np.array([outcome.objectives(self.limits) for _, outcome in stable])
        chosen = np.flatnonzero(is_on_front(values[:, 0], values[:, 1]))
        points = [self._point(*stable[i]) for i in chosen]
        ordered = tuple(sorted(points, key=lambda point: point.rms_error))
        return TuningFront(ordered, len(self.trials), self.failures)

    @property
    def failures(self) -> dict[str, int]:
        """Number of trials that ended early, by reason."""
        reasons = [outcome.failure for _, outcome in self.trials if outcome.failure]
        return {reason: reasons.count(reason) for reason in dict.fromkeys(reasons)}

    def _certified(self) -> list[tuple[dict[str, float], TrialOutcome]]:
        """Return the trials that have the margin."""
        margin = self.margin
        if margin is None:
            return self.trials
        kept = [trial for trial in self.trials if trial[1].margin is not None and trial[1].margin >= margin]
        if not kept:
            largest = max((outcome.margin for _, outcome in self.trials if outcome.margin is not None), default=-1.0)
            raise NotConverged(
                f"margin: none of {len(self.trials)} sets of gains of {self.space.fixed['kind']} has a robust margin "
                f"of {margin:g}; the largest is {largest:.3g}. Try more, widen the ranges, or lower the margin"
            )
        return kept

    def _objective(self, law: dict[str, Any]) -> float:
        pairs = zip(self.scenarios, self.limits, strict=True)
        return float(np.mean([objective(scenario, law, limit) for scenario, limit in pairs]))

    def _point(self, gains: dict[str, float], outcome: TrialOutcome) -> FrontPoint:
        error, variation = (
            float(np.exp(np.mean(np.log(values)))) for values in (outcome.rms_errors, outcome.torque_variations)
        )
        law = self.law(gains)
        distance = optimum_distance(law, self.scenarios[0])
        least = None if distance is None or not np.isfinite(distance.ratio) else error / distance.ratio
        return FrontPoint(law, gains, error, variation, outcome.margin, least)


def _counted(failures: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in failures.items()) or "none failed"


def _search(
    space: SearchSpace,
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    options: TuningOptions,
    objectives: Sequence[str],
    warm_starts: Sequence[dict[str, Any]],
    name: str,
    progress: bool | None,
) -> _Found:
    """Search the gains of a law; return all trials."""
    if not scenarios or len(limits) != len(scenarios):
        raise InvalidParameter(f"limits: got {len(limits)} for {len(scenarios)} scenarios; needs one each")
    for scenario in scenarios:
        check_comparable(scenario)
    pairs = [pair for pair in zip(scenarios, limits, strict=True) if _fits(space, pair[0])]
    if not pairs:
        raise InvalidParameter(f"scenarios: {space.fixed['kind']} cannot run in any of the scenarios")
    kept, kept_limits = [scenario for scenario, _ in pairs], [limit for _, limit in pairs]
    require("study", "tune", "optuna")
    import optuna

    from tarc.study.optuna_search import Search, SeededSampler, Workers, open_storage, open_study

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    examples = [space.law(values, kept[0].period) for values in space.examples()] if space.free else []
    tried = Trials(kept, options.margin, examples if options.trials >= MIN_COMPILED else ())
    if options.margin is not None:
        _require_margin(space, tried.scenarios[0])
    gains = {key: optuna.distributions.FloatDistribution(*ends, log=True) for key, ends in space.free.items()}
    trials = options.trials if gains else 1
    n_random = max(round(RANDOM_SHARE * options.trials), 1)
    starts = [values for law in warm_starts if (values := space.values(law))]
    sampler = SeededSampler(gains, options.seed, n_random, starts, int(WARM_SHARE * options.trials))
    problem = _problem(space, kept, kept_limits, options, objectives)
    name = name or str(space.fixed["kind"])

    def evaluate(sets: Sequence[dict[str, float]], run_unstable: bool) -> list[TrialOutcome]:
        return tried.evaluate([space.law(values, kept[0].period) for values in sets], run_unstable)

    with Workers(options.storage, name) as workers, Progress(f"tuning {name}", trials, progress) as bar:
        study = open_study(name, problem, sampler, len(objectives), open_storage(options.storage))
        search = Search(study, gains, trials, kept_limits, evaluate, options.margin, workers, bar.advance)
        finished = [(dict(trial.params), TrialOutcome.from_dict(trial.user_attrs["outcome"])) for trial in search.run()]
    return _Found(space, kept, kept_limits, options.margin, finished)


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
    try:
        trial = Scenario.parse({**scenario.model_dump(), "law": space.law(space.middle, scenario.period)})
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
    margin: float | None = None,
    storage: str | Path | None = None,
    failures: dict[str, str] | None = None,
    progress: bool | None = None,
) -> dict[str, tuple[dict[str, Any], float]]:
    """Search the gains of several laws with `tune`, each in its own process; first those that others extend.

    Every law has the same number of warm starts. Those of a law that extends another are the best gains of that one.
    Else they are the gains of the first scenario's law. In the end a law that others extend gets their values, where
    they are better.

    Parameters
    ----------
    names
        Names out of `default_search_spaces`.
    scenarios, limits, trials, seed, margin, storage, progress
        As in `tune`.
    jobs
        Number of processes; None for one per core.
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
    options = TuningOptions(trials=trials, seed=seed, margin=margin, storage=storage)

    def starts(found: tuple[dict[str, Any], float]) -> list[dict[str, Any]]:
        return [found[0]]

    tuned = _in_rounds(names, spaces, scenarios, limits, options, jobs, progress, _tune_one, starts, failures)
    share_gains(tuned, scenarios, limits, spaces, margin)
    return {name: tuned[name] for name in names if name in tuned}


def tune_fronts(
    names: Sequence[str],
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    *,
    trials: int = 60,
    seed: int = 0,
    jobs: int | None = None,
    spaces: Mapping[str, SearchSpace] | None = None,
    margin: float | None = None,
    storage: str | Path | None = None,
    failures: dict[str, str] | None = None,
    progress: bool | None = None,
) -> dict[str, TuningFront]:
    """Search the fronts of several laws with `tune_front`, in the processes and the order of `tune_all`.

    A law that extends another starts at the front of that one.

    Parameters
    ----------
    names, scenarios, limits, trials, seed, jobs, spaces, margin, storage, failures, progress
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
    options = TuningOptions(trials=trials, seed=seed, margin=margin, storage=storage)

    def starts(front: TuningFront) -> list[dict[str, Any]]:
        return [point.law for point in front.points]

    fronts = _in_rounds(names, spaces, scenarios, limits, options, jobs, progress, _front_of_one, starts, failures)
    return {name: fronts[name] for name in names if name in fronts}


Task = tuple[str, SearchSpace, list[dict[str, Any]], list[float], TuningOptions, list[dict[str, Any]]]
"""Name, space, contents of the scenarios, limits, options and warm starts of one law."""


def _in_rounds(
    names: Sequence[str],
    spaces: Mapping[str, SearchSpace],
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    options: TuningOptions,
    jobs: int | None,
    progress: bool | None,
    work: Callable[[Task], T],
    starts_of: Callable[[T], list[dict[str, Any]]],
    failures: dict[str, str] | None,
) -> dict[str, T]:
    """Search laws in processes, each after the law that it extends; return the results by name.

    Reasons of laws without a result are put into the ``failures``; without these the first is raised.
    """
    for name in names:
        check.one_of("laws", name, spaces)
    rounds = _rounds(names, spaces)
    total = sum(map(len, rounds))
    contents = [scenario.model_dump() for scenario in scenarios]
    count = check.integer("jobs", min(os.cpu_count() or 1, len(names)) if jobs is None else jobs, 1)
    results: dict[str, T] = {}
    with (
        ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_end_at_interrupt) as pool,
        Progress(f"tuning {total} laws, {options.trials} trials each", total, progress) as bar,
    ):
        for group in rounds:
            futures = {}
            for name in group:
                base = spaces[name].extends
                starts = starts_of(results[base]) if base in results else [_own_law(scenarios[0])]
                futures[pool.submit(work, (name, spaces[name], contents, list(limits), options, starts))] = name
            try:
                for future in as_completed(futures):
                    name = futures[future]
                    _collect(name, future, results, failures)
                    bar.advance()
            except (KeyboardInterrupt, InvalidParameter, UnsupportedLaw, NotConverged):
                # without the laws that no process has begun
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return results


def _end_at_interrupt() -> None:
    """Let Ctrl-C end a process at once; its storage loses nothing."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _collect(name: str, future: Future[T], results: dict[str, T], failures: dict[str, str] | None) -> None:
    """Keep the result of a law, or the reason why there is none."""
    try:
        results[name] = future.result()
    except (UnsupportedLaw, NotConverged) as error:
        if failures is None:
            raise
        failures[name] = str(error)
    except BrokenProcessPool:
        raise InvalidParameter("jobs: a process was killed, perhaps for lack of memory; use fewer jobs") from None


def _rounds(names: Sequence[str], spaces: Mapping[str, SearchSpace]) -> list[list[str]]:
    """Return the laws and those that they extend, in groups of which each extends only laws of the groups before."""
    depth: dict[str, int] = {}

    def place(name: str) -> int:
        if name not in depth:
            base = spaces[name].extends
            depth[name] = place(base) + 1 if base else 0
        return depth[name]

    for name in names:
        place(name)
    return [[name for name in depth if depth[name] == level] for level in range(max(depth.values(), default=-1) + 1)]


def _own_law(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario's first law with its estimator."""
    return {"estimator": scenario.estimator, **next(iter(scenario.laws.values()), {})}


def share_gains(
    tuned: dict[str, tuple[dict[str, Any], float]],
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    spaces: Mapping[str, SearchSpace],
    margin: float | None = None,
) -> None:
    """Give each law that others extend their values of the gains that it shares with them, where these are better.

    A search among few gains may miss what one among more has met.

    Parameters
    ----------
    tuned
        Laws and their objectives by name, which this changes.
    scenarios, limits, spaces, margin
        As in `tune_all`.
    """
    for base in dict.fromkeys(spaces[name].extends for name in tuned if spaces[name].extends in tuned):
        space = spaces[base]
        kept = [pair for pair in zip(scenarios, limits, strict=True) if _fits(space, pair[0])]
        tried = Trials([scenario for scenario, _ in kept]) if margin is not None else None
        for name in [name for name in tuned if spaces[name].extends == base]:
            values = space.values(tuned[name][0])
            if set(values) != set(space.free):
                continue
            law = space.law(values, scenarios[0].period)
            score = float(np.mean([objective(scenario, law, limit) for scenario, limit in kept]))
            if score < tuned[base][1] and (tried is None or tried.margin_of(law) >= (margin or 0.0)):
                tuned[base] = law, score


def _tune_one(task: Task) -> tuple[dict[str, Any], float]:
    name, space, contents, limits, options, starts = task
    scenarios = [Scenario.parse(content) for content in contents]
    return _search(space, scenarios, limits, options, ("error",), starts, name, False).best()


def _front_of_one(task: Task) -> TuningFront:
    name, space, contents, limits, options, starts = task
    scenarios = [Scenario.parse(content) for content in contents]
    return _search(space, scenarios, limits, options, ("error", "variation"), starts, name, False).front()
