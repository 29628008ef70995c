"""The process that traces and compiles laws, so that the loop does not wait for it.

Run as ``python -m tarc.runtime.law_preparer``; it reads laws from standard input and writes steps to standard output.
"""

import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import casadi as ca

from tarc.control.controller import Controller
from tarc.core.codegen import callable_library
from tarc.core.errors import CompilationError, InvalidParameter, MissingTool, UnsupportedLaw
from tarc.laws.base import Law
from tarc.signals.torque_limits import TorqueLimits

LOWEST_PRIORITY = 19
"""Niceness of the process and of its compiler: the loop, its robot and its log go first."""
READY = b"ready"
"""What the process writes once it has imported all."""


class LawPreparer:
    """A process that prepares laws one after the other.

    Parameters
    ----------
    limits
        Torque limits of the controller that will run them.
    is_native
        Whether to compile them.
    """

    def __init__(self, limits: TorqueLimits | None, is_native: bool):
        self._options = limits, is_native

    def __enter__(self) -> "LawPreparer":
        command = [sys.executable, "-m", "tarc.runtime.law_preparer"]
        # a group of its own, which Ctrl-C does not reach, but not a session: Linux shares the processor among sessions
        # first, whatever the priorities are
        self._process = subprocess.Popen(
            command, process_group=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        assert self._process.stdout is not None
        self._process.stdout.read(len(READY))  # so that its start takes no time from the loop
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()

    def prepare(self, law: Law) -> ca.Function:
        """Return the traced step of a law, in machine code where that is wanted.

        Raises
        ------
        InvalidParameter
            For a law that another process cannot load, such as one of the script that runs.
        """
        try:
            content = pickle.dumps((law, *self._options))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InvalidParameter(_refusal(error), "law") from error
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(content)
            self._process.stdin.flush()
            name, step = pickle.load(self._process.stdout)
        except (EOFError, OSError) as error:
            raise InvalidParameter(_refusal(error), "law") from error
        if name == "error":
            raise InvalidParameter(_refusal(step), "law")
        return ca.external(name, str(step)) if isinstance(step, Path) else ca.Function.deserialize(step)


def _refusal(reason: object) -> str:
    return (
        f"law: another process cannot prepare it ({reason}); its class and its functions must be in a module that can "
        "be imported"
    )


def serve(source: IO[bytes], target: IO[bytes]) -> None:
    """Answer each law with the name of its step, and the library or the serialised function; until the source ends."""
    while True:
        try:
            answer = _prepared(*pickle.load(source))
        except EOFError:
            return
        except (InvalidParameter, UnsupportedLaw, CompilationError, MissingTool, AttributeError, ImportError) as error:
            answer = "error", str(error)
        pickle.dump(answer, target)
        target.flush()


def _prepared(law: Law, limits: TorqueLimits | None, is_native: bool) -> tuple[str, Any]:
    function = Controller(law, torque_limits=limits).function
    step = callable_library(function) if is_native else function.serialize()
    return function.name(), step


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(LOWEST_PRIORITY)
    sys.stdout.buffer.write(READY)
    sys.stdout.buffer.flush()
    serve(sys.stdin.buffer, sys.stdout.buffer)
