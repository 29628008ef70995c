"""Searches of several laws in processes; those that others extend come first."""

import os
import signal
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any, Generic, TypeVar

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, NotConverged, UnsupportedLaw
from tarc.core.progress import Progress
from tarc.scenario.model import Scenario
from tarc.study.finished_search import FinishedSearch
from tarc.study.law_search import search_law
from tarc.study.search_space import SearchSpace
from tarc.study.tuning_options import TuningOptions

T = TypeVar("T")


@dataclass(frozen=True)
class LawTask(Generic[T]):
    """Search of one law in a process of its own.

    Attributes
    ----------
    name, space
        The law.
    contents, limits
        Contents of the scenarios, each with its limit on torque variation [N m/s].
    options, objectives, starts
        How it is searched, and laws to start from.
    choose
        What to return of the finished search.
    """

    name: str
    space: SearchSpace
    contents: Sequence[dict[str, Any]]
    limits: Sequence[float]
    options: TuningOptions
    objectives: Sequence[str]
    starts: Sequence[dict[str, Any]]
    choose: Callable[[FinishedSearch], T]

    def __call__(self) -> T:
        """Search, and return what is chosen."""
        scenarios = [Scenario.parse(content) for content in self.contents]
        options = replace(self.options, progress=False)
        finished = search_law(self.space, scenarios, self.limits, options, self.objectives, self.starts, self.name)
        return self.choose(finished)


def search_laws(
    names: Sequence[str],
    spaces: Mapping[str, SearchSpace],
    scenarios: Sequence[Scenario],
    limits: Sequence[float],
    options: TuningOptions,
    objectives: Sequence[str],
    choose: Callable[[FinishedSearch], T],
    starts_of: Callable[[T], list[dict[str, Any]]],
    failures: dict[str, str] | None,
) -> dict[str, T]:
    """Search laws in processes, each after the law that it extends; return what is chosen of each, by name.

    Parameters
    ----------
    names, spaces, scenarios, limits, options, objectives
        As in `search_law`, for laws by name.
    choose
        What to return of a finished search.
    starts_of
        Laws from which those start that extend this one.
    failures
        Filled with the reasons of laws without a result, by name; without it the first is raised.

    Raises
    ------
    InvalidParameter
        For an unknown name, and for a process that was killed.
    UnsupportedLaw, NotConverged, MissingTool
        As in `search_law` and by the choice.
    """
    for name in names:
        check.one_of("laws", name, spaces)
    waiting = _with_bases(names, spaces)
    total = len(waiting)
    contents = [scenario.model_dump() for scenario in scenarios]
    jobs = min(os.cpu_count() or 1, len(names)) if options.jobs is None else options.jobs
    results: dict[str, T] = {}
    with (
        ProcessPoolExecutor(max(jobs, 1), mp_context=get_context("spawn"), initializer=_end_at_interrupt) as pool,
        Progress(f"tuning {total} laws, {options.trials} trials each", total, options.progress) as bar,
    ):
        futures: dict[Future[T], str] = {}
        while waiting or futures:
            under_way = {*waiting, *futures.values()}
            for name in [name for name in waiting if spaces[name].extends not in under_way]:
                base = spaces[name].extends
                starts = starts_of(results[base]) if base in results else [_own_law(scenarios[0])]
                task = LawTask(name, spaces[name], contents, list(limits), options, objectives, starts, choose)
                futures[pool.submit(task)] = name
                waiting.remove(name)
            try:
                for future in wait(futures, return_when=FIRST_COMPLETED).done:
                    _collect(futures.pop(future), future, results, failures)
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


def _with_bases(names: Sequence[str], spaces: Mapping[str, SearchSpace]) -> list[str]:
    """Return the laws and those that they extend, first those that many wait for."""
    found: list[str] = []

    def place(name: str) -> None:
        if name and name not in found:
            place(spaces[name].extends)
            found.append(name)

    for name in names:
        place(name)
    bases = [spaces[name].extends for name in found]
    return sorted(found, key=lambda name: -bases.count(name))


def _own_law(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario's first law with its estimator."""
    return {"estimator": scenario.estimator, **next(iter(scenario.laws.values()), {})}
