"""Where the chunks of a study run: in this process, in processes of this machine, or on a Dask cluster."""

import os
import sys
import time
from collections.abc import Callable, Generator, Iterable

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.optional import install_command, is_installed, require
from tarc.study.chunks import Chunk, ChunkCollector, ChunkQueue, Pace
from tarc.study.cluster import check_scheduler, remote_cluster, run_parts, send_libraries, starting_cluster
from tarc.study.engines import ChunkResult, Engine

SERIAL_TIME = 4.0
"""Time of the remaining runs [s] below which processes of their own would cost more than they save."""


def run_chunks(
    engine: Engine,
    recipe: Callable[[], Engine],
    chunks: Iterable[Chunk],
    n_runs: int,
    *,
    jobs: int | None = None,
    scheduler: str = "",
    advance: Callable[[int], object] | None = None,
    notify: Callable[[str], object] | None = None,
) -> Generator[tuple[Chunk, ChunkResult], None, None]:
    """Run chunks and yield each with its result, in the order in which they are complete.

    Unless there is a scheduler, the first runs are timed in this process, and it goes on while further ones start. What
    remains is cut into parts of about half a second, whatever the size of the chunks. A worker that is killed costs its
    part a second try.

    Close the iterator where it is left early (`contextlib.closing`): that cancels what runs and ends the processes.

    Parameters
    ----------
    engine
        Runs the first part, or all, in this process.
    recipe
        Makes the same engine in a worker: something that can be pickled, such as a frozen dataclass with ``__call__``.
        It is called once per process, and the engine serves many parts.
    chunks
        The runs, in chunks that are stored at once.
    n_runs
        Number of runs of all chunks.
    jobs
        Number of processes; None for one per core, or fewer where the study is short.
    scheduler
        Address of a Dask scheduler, such as ``tcp://10.0.0.5:8786``; empty for this machine.
    advance
        Called with the number of runs of a part when it has finished.
    notify
        Called with messages, such as the address of the dashboard; by default they go to standard error.

    Raises
    ------
    InvalidParameter
        For ``jobs`` below one, ``jobs`` beside a scheduler, something that is no address, and a worker with other
        software than this process.
    ClusterError
        When the scheduler cannot be reached or is lost, and when the workers on a part were killed again and again.
    MissingTool
        For several jobs or a scheduler without Dask.
    """
    check_place(jobs, scheduler)
    return _run(engine, recipe, ChunkQueue(chunks, n_runs), jobs, scheduler, advance or _nothing, notify or _to_stderr)


def check_place(jobs: int | None, scheduler: str) -> None:
    """Check where a study is to run, before anything else is done for it.

    Raises
    ------
    InvalidParameter
        For ``jobs`` below one, ``jobs`` beside a scheduler, and something that is no address.
    ClusterError
        When nothing listens at the address.
    MissingTool
        For several jobs or a scheduler without Dask.
    """
    if jobs is not None:
        check.integer("jobs", jobs, 1)
        if scheduler:
            raise InvalidParameter(
                f"jobs: got {jobs} beside the scheduler {scheduler}, all workers of which are used; leave jobs out",
                "jobs",
            )
    if scheduler:
        require("study", "a scheduler", "dask", "distributed")
        check_scheduler(scheduler)
    elif jobs is not None and jobs > 1:
        require("study", "more than one job", "dask", "distributed")


def _run(
    engine: Engine,
    recipe: Callable[[], Engine],
    queue: ChunkQueue,
    jobs: int | None,
    scheduler: str,
    advance: Callable[[int], object],
    notify: Callable[[str], object],
) -> Generator[tuple[Chunk, ChunkResult], None, None]:
    collector = ChunkCollector()
    pace = Pace()
    if scheduler:
        with remote_cluster(scheduler, notify) as client:
            send_libraries(client)
            yield from run_parts(client, recipe, queue, collector, pace, advance, notify)
        return
    if not queue.remaining:
        return
    count = n_cores() if jobs is None else jobs
    yield from _run_here(engine, queue, collector, pace, advance, np.inf if count == 1 else SERIAL_TIME)
    if queue.remaining and not is_installed("distributed"):
        notify(f"one process: Dask is not installed; to use all cores, {install_command('study')}")
        yield from _run_here(engine, queue, collector, pace, advance)
    if queue.remaining:
        with starting_cluster(count, recipe, notify) as starting:
            yield from _run_here(engine, queue, collector, pace, advance, is_enough=starting.done)
            if queue.remaining:
                yield from run_parts(starting.result(), recipe, queue, collector, pace, advance, notify)


def _run_here(
    engine: Engine,
    queue: ChunkQueue,
    collector: ChunkCollector,
    pace: Pace,
    advance: Callable[[int], object],
    max_time: float = np.inf,
    is_enough: Callable[[], bool] = bool,
) -> Generator[tuple[Chunk, ChunkResult], None, None]:
    """Run parts in this process, until the remaining ones would take longer than a time [s], or it is enough."""
    while not is_enough() and (pieces := queue.take(pace.part_size(queue.remaining, 1))):
        for piece in pieces:
            start = time.perf_counter()
            result = engine.run(*piece.runs)
            pace.update(piece.n_runs, time.perf_counter() - start)
            advance(piece.n_runs)
            complete = collector.add(piece, result)
            if complete is not None:
                yield piece.chunk, complete
        if pace.is_sure and queue.remaining * pace.run_time > max_time:
            return


def n_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _nothing(n_runs: int) -> None:
    """Count no runs."""


def _to_stderr(message: str) -> None:
    print(message, file=sys.stderr)
