"""A session of the page: the design, its history, and what is computed of it while it moves."""

import asyncio
import importlib
import os
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from nicegui import background_tasks

from tarc.studio.design_state import DesignState, History
from tarc.studio.jobs import DESIGN_ERRORS, Job, JobError
from tarc.studio.robots import Robots

if TYPE_CHECKING:
    from tarc.studio.analysis import LoopAnalysis, RobotFacts
    from tarc.studio.certifying import CertificateRow
    from tarc.studio.runs import RunPair

CERTIFICATE_PAUSE = 0.4
"""Pause after the last move before the certificates start [s]."""
RUN_PAUSE = 0.05
"""Pause after the last move before the runs start [s]."""
COMPUTING = ("tarc.studio.analysis", "tarc.studio.runs", "tarc.studio.scene")
"""Modules that compute. They take longer to import than the page, which is up before."""
MAX_FACTS = 32
"""Robots and payloads whose facts a session keeps."""

_CERTIFYING = asyncio.Semaphore(os.cpu_count() or 1)
"""Certificates of all sessions that are computed at the same time; each takes a process and its memory."""
_COMPUTING = ThreadPoolExecutor(max_workers=1, thread_name_prefix="studio")
"""One thread for all sessions: CasADi fails where two threads use it."""

T = TypeVar("T")
Listener = Callable[[], object]


@dataclass
class Results:
    """What is known of the present design; None for what is being computed or cannot be.

    Attributes
    ----------
    facts, loop
        Of the robot and the loop.
    runs
        Of the design and its rival; those of an earlier design stay until the new ones are there.
    certificates
        Rows; None while they are computed.
    certificate_problem, problem
        Messages where certificates, or the rest, cannot be computed.
    times
        Wall time of the last loop, runs and certificates [s].
    """

    facts: "RobotFacts | None" = None
    loop: "LoopAnalysis | None" = None
    runs: "RunPair | None" = None
    certificates: "list[CertificateRow] | None" = None
    certificate_problem: str = ""
    problem: str = ""
    times: dict[str, float] = field(default_factory=dict)


class Session:
    """One open page.

    Attributes
    ----------
    robots, history, results
        Of the session.
    notes
        What of the scenario or the URL the page leaves out.
    is_closed
        Whether the page is closed.
    """

    def __init__(self, robots: Robots, state: DesignState, notes: list[str]) -> None:
        self.robots = robots
        self.history = History(state)
        self.notes = notes
        self.results = Results()
        self._listeners: dict[str, list[Listener]] = {"state": [], "loop": [], "runs": [], "certificates": []}
        self.is_closed = False
        self._at_end: list[Listener] = []
        self._facts: dict[tuple[str, float], RobotFacts] = {}
        self._job: Job | None = None
        self._moved = {name: asyncio.Event() for name in ("loop", "runs", "certificates")}
        self._tasks: list[asyncio.Task] = []

    @property
    def state(self) -> DesignState:
        """Return the present design."""
        return self.history.state

    def listen(self, topic: str, listener: Listener) -> None:
        """Call a function after each change of ``state``, ``loop``, ``runs`` or ``certificates``."""
        self._listeners[topic].append(listener)

    def start(self) -> None:
        """Start computing, unless the page was closed before it was there."""
        if self.is_closed:
            return
        steps = {"loop": self._update_loop, "runs": self._update_runs, "certificates": self._update_certificates}
        self._tasks = [background_tasks.create(self._follow(name, step)) for name, step in steps.items()]
        self._announce_move()

    def at_end(self, listener: Listener) -> None:
        """Call a function when the page is closed."""
        self._at_end.append(listener)

    def close(self) -> None:
        """End all that is being computed."""
        self.is_closed = True
        for listener in self._at_end:
            listener()
        for task in self._tasks:
            task.cancel()
        if self._job is not None:
            self._job.cancel()

    def change(self, merge_key: str = "", **changes: Any) -> None:
        """Move the design."""
        self.move(self.state.with_changes(**changes), merge_key)

    def move(self, state: DesignState, merge_key: str = "") -> None:
        """Make a design the present one."""
        if state != self.state:
            self.history.move(state, merge_key)
            self._announce_move()

    def undo(self) -> None:
        """Return to the design before."""
        if self.history.can_undo:
            self.history.undo()
            self._announce_move()

    def redo(self) -> None:
        """Return to the design that was undone."""
        if self.history.can_redo:
            self.history.redo()
            self._announce_move()

    def _announce_move(self) -> None:
        if self._job is not None:
            self._job.cancel()
        self.results.certificates = None
        self.results.certificate_problem = ""
        self._tell("state")
        self._tell("certificates")
        for event in self._moved.values():
            event.set()

    def _tell(self, topic: str) -> None:
        if self.is_closed:
            return
        for listener in self._listeners[topic]:
            listener()

    async def _follow(self, name: str, step: Callable[[DesignState], Awaitable[None]]) -> None:
        """Compute a part for the newest design, again and again; designs that were left at once are skipped."""
        await in_thread(load_computing)
        pause = {"loop": 0.0, "runs": RUN_PAUSE, "certificates": CERTIFICATE_PAUSE}[name]
        while True:
            await self._moved[name].wait()
            self._moved[name].clear()
            if pause:
                await asyncio.sleep(pause)
                if self._moved[name].is_set():
                    continue
            start = time.perf_counter()
            await step(self.state)
            self.results.times[name] = time.perf_counter() - start

    async def _update_loop(self, state: DesignState) -> None:
        from tarc.studio.analysis import analyse_loop, robot_facts

        try:
            key = state.robot, state.payload
            if key not in self._facts:
                if len(self._facts) >= MAX_FACTS:
                    self._facts.clear()
                self._facts[key] = await in_thread(robot_facts, state, self.robots)
            self.results.facts = self._facts[key]
            self.results.loop = await in_thread(analyse_loop, state, self.results.facts)
            self.results.problem = ""
        except DESIGN_ERRORS as error:
            self.results.problem = str(error)
        self._tell("loop")

    async def _update_runs(self, state: DesignState) -> None:
        from tarc.studio.runs import run_pair

        try:
            self.results.runs = await in_thread(run_pair, state, self.robots, self.results.runs)
        except DESIGN_ERRORS as error:
            self.results.problem = str(error)
        self._tell("runs")

    async def _update_certificates(self, state: DesignState) -> None:
        from tarc.studio.certifying import send_certificates

        rows: list[CertificateRow] | None = None
        problem = ""
        async with _CERTIFYING:
            if state != self.state or self.is_closed:
                return
            content = state.to_content(self.robots.content(state.robot))
            self._job = await in_thread(Job, send_certificates, content)
            if state != self.state or self.is_closed:
                self._job.cancel()
            try:
                async for message in self._job.results():
                    rows = message
            except JobError as error:
                problem = str(error)
        if state != self.state or (rows is None and not problem):
            return
        self.results.certificates = rows
        self.results.certificate_problem = problem
        self._tell("certificates")


async def in_thread(function: Callable[..., T], *arguments: Any) -> T:
    """Return what a function computes in a thread, so that the page stays responsive."""
    return await asyncio.get_running_loop().run_in_executor(_COMPUTING, partial(function, *arguments))


def load_computing() -> None:
    """Import the modules that compute, unless they are."""
    for name in COMPUTING:
        importlib.import_module(name)
