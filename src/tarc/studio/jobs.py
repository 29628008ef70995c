"""Processes that compute for the page, and that the next move ends."""

import asyncio
import multiprocessing
import os
import pkgutil
import signal
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from typing import Any

from tarc.core.errors import (
    ClusterError,
    CompilationError,
    InvalidParameter,
    MissingTool,
    NoStableRatio,
    NotConverged,
    NotLinearisable,
    RobotFileError,
    ScenarioError,
    UnsupportedLaw,
)

DESIGN_ERRORS = (
    ClusterError,
    CompilationError,
    InvalidParameter,
    MissingTool,
    NoStableRatio,
    NotConverged,
    NotLinearisable,
    RobotFileError,
    ScenarioError,
    UnsupportedLaw,
)
"""Errors of a design that the page shows."""
METHODS = ("forkserver", "spawn")
PRELOADED = [
    "tarc.studio.analysis",
    "tarc.studio.certifying",
    "tarc.studio.runs",
    "scipy.optimize",
    "clarabel",
    "flint",
    "highspy",
]
"""Modules that the process has imported of which others are copies; they share its memory."""

EXIT_TIME = 5.0
"""Longest wait for a process that has sent all to leave [s]."""

_WAITING = ThreadPoolExecutor(max_workers=64, thread_name_prefix="studio-job")

Sender = Callable[[object], None]


class JobError(Exception):
    """An error of a design in another process, with its message."""


class Job:
    """A function that runs in a process of its own and sends results.

    Making one waits for the process of which it is a copy, which takes seconds at the first.

    Parameters
    ----------
    function
        A function of a module, or its name as ``module:function``; its first argument sends a result.
    arguments
        The others.
    """

    def __init__(self, function: Callable[..., None] | str, *arguments: Any) -> None:
        context = process_context()
        self._receiver, sender = context.Pipe(duplex=False)
        self._process = context.Process(target=_run_and_send, args=(function, arguments, sender), daemon=True)
        self._process.start()
        self._is_cancelled = False
        sender.close()

    async def results(self) -> AsyncIterator[Any]:
        """Yield what the function sends, until it is done or cancelled.

        Raises
        ------
        JobError
            For an error of the design, and for a process that ended on its own.
        """
        loop = asyncio.get_running_loop()
        try:
            while True:
                message = await loop.run_in_executor(_WAITING, self._receiver.recv)
                if isinstance(message, JobError):
                    raise message
                yield message
        except (EOFError, OSError):
            code = None if self._is_cancelled else await loop.run_in_executor(_WAITING, self._exit_code)
            if code:
                raise JobError(f"the process that computes ended with code {code}; try again") from None
        finally:
            self.cancel()

    def interrupt(self) -> None:
        """Ask the function to end, as Ctrl-C does."""
        if self._process.is_alive() and self._process.pid is not None:
            os.kill(self._process.pid, signal.SIGINT)

    def cancel(self) -> None:
        """End the process at once."""
        self._is_cancelled = True
        if self._process.is_alive():
            self._process.kill()

    def _exit_code(self) -> int | None:
        """Return the exit code once the process has closed its end, or None where it takes long to leave."""
        self._process.join(EXIT_TIME)
        return self._process.exitcode


async def first_result(function: str, *arguments: Any) -> Any:
    """Return the first message that a function sends in a process of its own.

    Raises
    ------
    JobError
        For an error of the design, and for a process that ended on its own.
    """
    job = await asyncio.to_thread(Job, function, *arguments)
    async for message in job.results():
        return message
    raise JobError("the process that computes sent nothing; try again")


def _run_and_send(function: Callable[..., None] | str, arguments: tuple[Any, ...], connection: Connection) -> None:
    try:
        call = pkgutil.resolve_name(function) if isinstance(function, str) else function
        call(connection.send, *arguments)
    except DESIGN_ERRORS as error:
        connection.send(JobError(str(error)))
    finally:
        connection.close()


def start_first_process() -> None:
    """Start the process of which others are copies, where the system has that."""
    if process_context().get_start_method() == "forkserver":
        forkserver.ensure_running()


@cache
def process_context() -> Any:
    """Return the context of new processes: copies of one that has imported all, where the system has that."""
    available = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context(next(method for method in METHODS if method in available))
    if context.get_start_method() == "forkserver":
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        context.set_forkserver_preload(PRELOADED)
    return context
