"""A session of the page: the design, its history, and what is computed of it while it moves."""

import asyncio
import os
import secrets
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

from nicegui import background_tasks

from tarc.studio.design_state import DesignState, History
from tarc.studio.jobs import Job, JobError
from tarc.studio.results import CertificateRow, CurvePair, LoopAnalysis, RobotFacts
from tarc.studio.robots import Robots
from tarc.studio.worker import FACTS, LOOPS, RUNS

CERTIFICATE_PAUSE = 0.4
"""Pause after the last move before the certificates start [s]."""
RUN_PAUSE = 0.05
"""Pause after the last move before the runs start [s]."""
MAX_FACTS = 32
"""Robots and payloads whose facts a session keeps."""

_CERTIFYING = asyncio.Semaphore(os.cpu_count() or 1)
"""Certificates of all sessions that are computed at the same time; each takes a process and its memory."""

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
    certificate_problem, run_problem, problem
        Messages where certificates, runs, or the rest, cannot be computed.
    times
        Wall time of the last loop, runs and certificates [s].
    """

    facts: RobotFacts | None = None
    loop: LoopAnalysis | None = None
    runs: CurvePair | None = None
    certificates: list[CertificateRow] | None = None
    certificate_problem: str = ""
    run_problem: str = ""
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
        self._name = secrets.token_hex(8)
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
        if self._tasks:
            background_tasks.create(RUNS.compute("tarc.studio.runs:forget_runs", self._name))

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

    async def newest_scene(self, shown_robot: str) -> tuple[str, dict[str, Any] | None, dict[str, Any]] | None:
        """Return what `tarc.studio.runs.newest_scene` does.

        Raises
        ------
        JobError
            For a robot without bodies in space.
        """
        return await RUNS.compute("tarc.studio.runs:newest_scene", self._name, shown_robot)

    async def _update_loop(self, state: DesignState) -> None:
        try:
            key = state.robot, state.payload
            if key not in self._facts:
                if len(self._facts) >= MAX_FACTS:
                    self._facts.clear()
                self._facts[key] = await FACTS.compute("tarc.studio.analysis:robot_facts", state, self.robots)
            self.results.facts = self._facts[key]
            self.results.loop = await LOOPS.compute("tarc.studio.analysis:analyse_loop", state, self.results.facts)
            self.results.problem = ""
        except JobError as error:
            self.results.problem = str(error)
        self._tell("loop")

    async def _update_runs(self, state: DesignState) -> None:
        try:
            self.results.runs = await RUNS.compute("tarc.studio.runs:newest_runs", self._name, state, self.robots)
            self.results.run_problem = ""
        except JobError as error:
            self.results.run_problem = str(error)
        self._tell("runs")

    async def _update_certificates(self, state: DesignState) -> None:
        rows: list[CertificateRow] | None = None
        problem = ""
        async with _CERTIFYING:
            if state != self.state or self.is_closed:
                return
            self._job = await asyncio.to_thread(Job, "tarc.studio.certifying:send_certificates", state, self.robots)
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
