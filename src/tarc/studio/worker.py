"""Processes that compute for all sessions, one request after another.

CasADi fails where two threads use it, even where one of them only frees what it made. So no thread of the server does:
the page holds plain numbers, and a process of one thread computes them.
"""

import asyncio
import faulthandler
import pkgutil
import signal
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any

from tarc.core.allocator import release_freed_memory
from tarc.core.errors import DesignWarning
from tarc.studio.jobs import DESIGN_ERRORS, JobError, process_context

RELEASE_PERIOD = 20.0
"""Time after which freed memory is given back to the system [s]."""


class Worker:
    """A process that calls functions one after another; where it ended, the next call starts it again.

    Parameters
    ----------
    name
        Of the thread that waits for it.
    """

    def __init__(self, name: str) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._process: Any = None
        self._connection: Connection | None = None
        self._is_closed = False

    async def compute(self, function: str, *arguments: Any) -> Any:
        """Return what a function returns in the process; it is named as ``module:function``, and imported there.

        Raises
        ------
        JobError
            For an error of the design, and for a process that ended meanwhile.
        """
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._exchange, function, arguments)

    @property
    def pid(self) -> int | None:
        """Return the number of the process; None before the first call."""
        return None if self._process is None else self._process.pid

    def close(self) -> None:
        """End the process at once."""
        self._is_closed = True
        if self._process is not None:
            self._process.kill()

    def _exchange(self, function: str, arguments: tuple[Any, ...]) -> Any:
        if self._connection is None or not self._process.is_alive():
            self._connection = self._start()
        try:
            self._connection.send((function, arguments))
            answer = self._connection.recv()
        except (EOFError, OSError):
            self._process.join()
            raise JobError(
                f"the process that computes ended with code {self._process.exitcode}; the next move starts it again"
            ) from None
        if isinstance(answer, JobError):
            raise answer
        return answer

    def _start(self) -> Connection:
        if self._is_closed:
            raise JobError("the server is stopping")
        context = process_context()
        own, other = context.Pipe()
        self._process = context.Process(target=_answer, args=(other,), daemon=True)
        self._process.start()
        other.close()
        return own


LOOPS = Worker("studio-loops")
"""Loops and maps alone, so that the map of a user follows while others load robots and runs are computed."""
FACTS = Worker("studio-facts")
"""Facts of robots, which take longer than a map."""
RUNS = Worker("studio-runs")
"""Runs and the scenes of them."""


def _answer(connection: Connection) -> None:
    """Call the functions that come, until the server ends."""
    faulthandler.enable()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the server, and the server this process
    warnings.filterwarnings("ignore", category=DesignWarning)  # the page says it
    released = time.monotonic()
    while True:
        try:
            if connection.poll(RELEASE_PERIOD):
                function, arguments = connection.recv()
                try:
                    answer = pkgutil.resolve_name(function)(*arguments)
                except DESIGN_ERRORS as error:
                    answer = JobError(str(error))
                connection.send(answer)
        except (EOFError, OSError):
            return
        if time.monotonic() > released + RELEASE_PERIOD:
            release_freed_memory()
            released = time.monotonic()
