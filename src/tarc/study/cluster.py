"""Parts of a study on the workers of a Dask cluster."""

import hashlib
import logging
import pickle
import signal
import socket
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future as Starting
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import urlsplit
from uuid import uuid4

from tarc.core.codegen import receive_libraries, used_libraries
from tarc.core.errors import ClusterError, DesignWarning, InvalidParameter, JointLimitWarning
from tarc.core.optional import is_installed
from tarc.core.types import Array
from tarc.study.chunks import Chunk, ChunkCollector, ChunkQueue, Pace, Piece
from tarc.study.engines import ChunkResult, Engine
from tarc.study.software import check_same_software, software

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_TIMEOUT = 10.0
"""Time in which a scheduler must answer [s]."""

PROTOCOLS = ("tcp", "tls", "ucx", "ws", "wss")
"""Protocols of addresses."""

CHECK_INTERVAL = 1.0
"""Time between two looks at the cluster while no part finishes [s]."""

DASHBOARD_PORT = 8787
"""Port of Dask's dashboard on this machine."""

PARTS_PER_WORKER = 12
"""Parts that are submitted at once per thread of the workers: more than Dask needs to enlarge an adaptive cluster."""

MIN_PARTS = 32
"""Parts that are submitted at once at least."""

ENVIRONMENT = {"MUJOCO_GL": "disable", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment of local workers: matrices are small, and a worker has one core."""

IGNORE_INTERRUPT = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""Run in each local worker: Ctrl-C reaches all processes of a terminal, and the first one ends the workers."""


FORK_SERVER_MODULES = ["distributed.nanny", "distributed.worker", "tarc.study.execution"]
"""Modules that local workers need, imported once."""


@contextmanager
def starting_cluster(
    n_workers: int, recipe: Callable[[], Engine], notify: Callable[[str], object]
) -> "Iterator[Starting[Client]]":
    """Start a `local_cluster` in a thread, and let its workers make their engines there.

    The caller computes meanwhile. What is yielded is done when all workers can begin, or has the error.
    """
    with ExitStack() as stack, ThreadPoolExecutor(1, "tarc-cluster") as thread:

        def start() -> "Client":
            if hasattr(signal, "pthread_sigmask"):  # processes inherit it: they start without Ctrl-C
                from multiprocessing import resource_tracker

                resource_tracker.ensure_running()  # which would lift it
                signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            client = stack.enter_context(local_cluster(n_workers, notify))
            make_engines(client, StudyTask.from_recipe(recipe))
            return client

        yield thread.submit(start)


@contextmanager
def local_cluster(n_workers: int, notify: Callable[[str], object]) -> "Iterator[Client]":
    """Start worker processes on this machine, one thread each, and end them in the end.

    A worker that dies is started again by its nanny. On Linux the processes are forks of one that has imported what
    they need, so that each starts in a tenth of a second.
    """
    import dask.config
    from distributed import Client, LocalCluster
    from distributed.utils import get_mp_context

    settings: dict[str, Any] = {"distributed.worker.profile.enabled": False}
    if sys.platform == "linux":
        settings["distributed.worker.multiprocessing-method"] = "forkserver"
    with dask.config.set(settings), _main_module_hidden():
        if sys.platform == "linux":
            get_mp_context().set_forkserver_preload(FORK_SERVER_MODULES)
        cluster = LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            dashboard_address=cast(str, _dashboard_address() if is_installed("bokeh") else None),
            silence_logs=logging.CRITICAL,
            env=ENVIRONMENT,
            preload=[IGNORE_INTERRUPT],
        )
        # not as the default client, which would be one of the thread that starts it
        with cluster, Client(cluster, set_as_default=False) as client:
            if is_installed("bokeh"):
                notify(f"{n_workers} processes; dashboard: {client.dashboard_link}")
            yield client


def _dashboard_address() -> str:
    """Return Dask's usual address of the dashboard, or one with any port where that is taken."""
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("", DASHBOARD_PORT))
        except OSError:
            return ":0"
    return f":{DASHBOARD_PORT}"


@contextmanager
def _main_module_hidden() -> Iterator[None]:
    """Keep new processes from importing the user's script, of which they need nothing: it would run there again."""
    main = sys.modules["__main__"]
    names = [name for name in ("__file__", "__spec__") if name in vars(main)]
    hidden = {name: vars(main).pop(name) for name in names}
    main.__spec__ = None
    try:
        yield
    finally:
        vars(main).update(hidden)


def check_scheduler(address: str) -> None:
    """Check that something listens at an address.

    Raises
    ------
    InvalidParameter
        For something that is no address.
    ClusterError
        When nothing listens there.
    """
    parts = urlsplit(address)
    try:
        place = parts.hostname or "", parts.port or 0
    except ValueError:  # of the port
        place = "", 0
    if parts.scheme not in PROTOCOLS or not all(place):
        raise InvalidParameter(
            f"scheduler: got {address!r}; needs an address such as tcp://10.0.0.5:8786, which `dask scheduler` prints",
            "scheduler",
        )
    try:
        socket.create_connection(place, CONNECT_TIMEOUT).close()
    except OSError as error:
        raise _no_answer(address, error) from None


def _no_answer(address: str, error: OSError) -> ClusterError:
    return ClusterError(
        f"scheduler: no answer from {address} ({error}); check the address, start one with `dask scheduler`, or leave "
        "the scheduler out to use this machine"
    )


@contextmanager
def remote_cluster(address: str, notify: Callable[[str], object]) -> "Iterator[Client]":
    """Connect to a Dask scheduler.

    Raises
    ------
    ClusterError
        When what listens at the address is no scheduler.
    """
    from distributed import Client
    from distributed.utils import silence_logging_cmgr

    try:
        client = Client(address, timeout=CONNECT_TIMEOUT, name="tarc-study")
    except OSError as error:
        raise _no_answer(address, error) from None
    try:
        client.scheduler_info()  # asks for the dashboard's port
        notify(f"cluster {address}; dashboard: {client.dashboard_link}")
        with silence_logging_cmgr(logging.CRITICAL):  # what matters comes as an error
            yield client
    finally:
        client.close(timeout=2)


@dataclass(frozen=True)
class StudyTask:
    """What a worker needs for each part of a study.

    Attributes
    ----------
    recipe
        The pickled function that makes the engine.
    key
        Hash of it, by which a worker knows the engine that it has.
    software
        Versions that a worker must have.
    """

    recipe: bytes
    key: str
    software: dict[str, str]

    @classmethod
    def from_recipe(cls, recipe: Callable[[], Engine]) -> "StudyTask":
        """Pickle a recipe."""
        content = pickle.dumps(recipe)
        return cls(content, hashlib.sha256(content).hexdigest(), software())


class _Call:
    """A call that is made when it is unpickled.

    Workers are sent `pickle.loads` and bytes. The scheduler unpickles what it hands on, and so needs not have this
    package. A worker without it raises an error that comes back.
    """

    def __init__(self, function: Callable[..., object], *arguments: object):
        self._call = function, arguments

    def __reduce__(self) -> tuple[Callable[..., object], tuple[object, ...]]:
        return self._call


_thread = threading.local()
"""Key and engine of the study that this thread of a worker is on: engines need not be safe in several threads."""


def run_part(task: StudyTask, pieces: list[tuple[Array, Array, Array]]) -> tuple[float, list[ChunkResult]]:
    """Run pieces on a worker; return the time [s] without that for making the engine, and the results.

    Parameters
    ----------
    task
        What makes the engine.
    pieces
        Indices, values and seeds of the runs of each piece.

    Raises
    ------
    InvalidParameter
        When the worker has other software.
    """
    from distributed import get_worker

    if getattr(_thread, "key", None) != task.key:
        check_same_software(get_worker().address, software(), task.software)
        for category in (DesignWarning, JointLimitWarning):  # the results show it
            warnings.simplefilter("ignore", category)
        receive_libraries(Path(get_worker().local_directory))
        _thread.engine = pickle.loads(task.recipe)()
        _thread.key = task.key
    engine: Engine = _thread.engine
    start = time.perf_counter()
    results = [engine.run(*runs) for runs in pieces]
    return time.perf_counter() - start, results


def make_engines(client: "Client", task: StudyTask) -> None:
    """Let each worker make the engine of a study, and wait for that; an error comes again with its first part."""
    call = pickle.dumps(_Call(run_part, task, []))
    futures = [
        client.submit(pickle.loads, call, key=f"engine-{uuid4().hex}", workers=[worker], allow_other_workers=True)
        for worker in cast("dict[str, int]", client.nthreads())
    ]
    for future in futures:
        future.exception()


def send_libraries(client: "Client") -> None:
    """Send the machine code that this process has compiled to all workers, also those that come later.

    A worker with another processor or C library finds none of them, and compiles its own.
    """
    from distributed.diagnostics.plugin import UploadFile

    for key, library in used_libraries().items():
        plugin = UploadFile(str(library), load=False)
        plugin.filename = f"{key}.so"
        client.register_plugin(plugin, name=f"tarc-{key}")


def check_workers(client: "Client") -> None:
    """Check that all workers have this package, and the software of this process.

    Raises
    ------
    InvalidParameter
        For a worker without the package, or with other software.
    """
    call = pickle.dumps(_Call(software))
    answers = cast("dict[str, Any]", client.run(pickle.loads, call, on_error="return"))
    for worker, theirs in answers.items():
        if isinstance(theirs, ModuleNotFoundError):
            raise InvalidParameter(_cannot_import(worker, theirs))
        if isinstance(theirs, Exception):
            raise theirs
        check_same_software(worker, theirs, software())


def _cannot_import(worker: str, error: Exception) -> str:
    return (
        f"scheduler: the worker {worker} cannot import the package ({error}); "
        "pip install 'tarc-control[study]' there, in the same version as here, and start it again"
    )


class _Flight:
    """Parts that are submitted and have not come back.

    Parameters
    ----------
    client
        The cluster.
    recipe
        Makes the engine.
    queue
        The runs.
    pace
        Time of a run.
    notify
        Called with messages.
    """

    def __init__(
        self,
        client: "Client",
        recipe: Callable[[], Engine],
        queue: ChunkQueue,
        pace: Pace,
        notify: Callable[[str], object],
    ):
        assert client.scheduler is not None
        self.client = client
        self.address = str(client.scheduler.address)
        self.task = StudyTask.from_recipe(recipe)
        self.queue = queue
        self.pace = pace
        self.notify = notify
        self.parts: dict[Future, list[Piece]] = {}
        self._done: SimpleQueue[Future] = SimpleQueue()
        self._group = f"runs-{uuid4().hex}"
        self._numbers = count()
        self._n_threads = 0
        self._next_look = 0.0

    def fill(self) -> None:
        """Submit parts up to the limit."""
        self._look()
        measured = self.pace.run_time > 0
        limit = max(MIN_PARTS, PARTS_PER_WORKER * self._n_threads) if measured else max(1, self._n_threads)
        while len(self.parts) < limit:
            pieces = self.queue.take(self.pace.part_size(self.queue.remaining, max(1, self._n_threads)))
            if not pieces:
                return
            call = pickle.dumps(_Call(run_part, self.task, [piece.runs for piece in pieces]))
            future = self.client.submit(pickle.loads, call, key=(self._group, next(self._numbers)))
            self.parts[future] = pieces
            future.add_done_callback(self._done.put)

    def next(self) -> "tuple[list[Piece], float, list[ChunkResult]]":
        """Wait for a part; return its pieces, its time [s] and its results."""
        while True:
            try:
                future = self._done.get(timeout=CHECK_INTERVAL)
                break
            except Empty:
                self._look()
        pieces = self.parts.pop(future)
        seconds, results = self._result(future, pieces)
        return pieces, seconds, results

    def _look(self) -> None:
        """Count the workers' threads, at most once per interval; complain when the scheduler is lost."""
        if self.client.status != "running":
            raise self._lost()
        if time.monotonic() < self._next_look:
            return
        try:
            n_threads = sum(cast("dict[str, int]", self.client.nthreads()).values())
        except (OSError, TimeoutError):
            raise self._lost() from None
        if n_threads == 0 and (self._n_threads or not self._next_look):
            self.notify(f"no workers at {self.address}: waiting for the first")
        self._n_threads = n_threads
        self._next_look = time.monotonic() + CHECK_INTERVAL

    def _result(self, future: "Future", pieces: list[Piece]) -> tuple[float, list[ChunkResult]]:
        from distributed import CancelledError, KilledWorker

        try:
            return future.result()
        except KilledWorker as error:
            first, last = pieces[0].runs[0][0], pieces[-1].runs[0][-1]
            raise ClusterError(
                f"runs {first} to {last}: {error.allowed_failures + 1} workers died on them, the last was "
                f"{error.last_worker.address}; perhaps for lack of memory: use fewer jobs or more memory per worker. "
                "Repeat the command to go on with what is left"
            ) from None
        except ModuleNotFoundError as error:
            raise InvalidParameter(_cannot_import("of the study", error)) from None
        except CancelledError:
            raise self._lost() from None
        except OSError:
            if future.status == "error":  # of the engine
                raise
            raise self._lost() from None

    def _lost(self) -> ClusterError:
        return ClusterError(
            f"scheduler: lost the connection to {self.address}; finished chunks are stored. Start the scheduler and "
            "its workers again, and repeat the command to go on with what is left"
        )

    def cancel(self) -> None:
        """Cancel what has not come back."""
        if self.parts and self.client.status == "running":
            with suppress(OSError, TimeoutError):
                self.client.cancel(list(self.parts))


def run_parts(
    client: "Client",
    recipe: Callable[[], Engine],
    queue: ChunkQueue,
    collector: ChunkCollector,
    pace: Pace,
    advance: Callable[[int], object],
    notify: Callable[[str], object],
) -> Generator[tuple[Chunk, ChunkResult], None, None]:
    """Run what is in the queue on a cluster, and yield each chunk with its result as it is complete.

    Parameters
    ----------
    client
        The cluster.
    recipe, advance, notify
        As in `tarc.study.scheduling.run_chunks`.
    queue, collector, pace
        The runs that are left, the pieces that have come, and the time of a run so far.

    Raises
    ------
    InvalidParameter
        For a worker without this package, or with other software.
    ClusterError
        When the scheduler is lost, and when all workers that had a part died.
    """
    check_workers(client)
    flight = _Flight(client, recipe, queue, pace, notify)
    try:
        flight.fill()
        while flight.parts:
            pieces, seconds, results = flight.next()
            n_runs = sum(piece.n_runs for piece in pieces)
            pace.update(n_runs, seconds)
            flight.fill()
            advance(n_runs)
            for piece, result in zip(pieces, results, strict=True):
                complete = collector.add(piece, result)
                if complete is not None:
                    yield piece.chunk, complete
    finally:
        flight.cancel()
