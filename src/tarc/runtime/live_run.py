"""`run_live`: run a law on a robot."""

import json
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tarc.control.controller import Controller
from tarc.control.watch import Watch, Watcher, WatchFlag
from tarc.core import validation as check
from tarc.core.errors import CompilationError, InvalidParameter, MissingTool, UnsupportedLaw
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.runtime.clock import Clock
from tarc.runtime.gain_changes import GainChanges
from tarc.runtime.limits import SafetyLimits, require_torque_limit
from tarc.runtime.live_loop import OVERRUN_POLICIES, LiveLoop, LoopParts, StartUp
from tarc.runtime.log import Log
from tarc.runtime.log_format import LogLayout, LogSubject, header
from tarc.runtime.motion import Motion, sampled
from tarc.runtime.online import OnlineReference
from tarc.runtime.push import PushResponse
from tarc.runtime.real_time import check_period, real_time
from tarc.runtime.robot import Robot
from tarc.runtime.watchdog import Watchdog
from tarc.signals.references import Reference
from tarc.signals.trajectory_message import BAG
from tarc.simulation.run import Run
from tarc.simulation.run_bag import require_bag_writer
from tarc.simulation.sampled_inputs import MAX_PERIODS

PERCENTILES = (50.0, 90.0, 99.0, 99.9, 100.0)
HISTOGRAM_EDGES = np.concatenate([[0.0], np.logspace(-6, -1, 26)])
"""Ends of the bins of a jitter histogram [s]: five per decade from 1 µs to 0.1 s."""


@dataclass(frozen=True, eq=False)
class LiveRun:
    """A run on a robot.

    Attributes
    ----------
    ended
        Why it ended: ``completed``, ``stopped on request``, or the reason of a safe stop.
    is_safe_stop
        Whether it ended in a safe stop.
    log
        The netCDF file; None without.
    n_periods, overruns
        Periods in all, and those that were missed.
    lateness, computation_time
        How late each period began, and how long it took until its torque was written [s].
    counts
        Events of the robot, and ``rejected`` readings of joints that jumped.
    facts
        What was got of the operating system, how the law runs, and why a log is not complete.
    push
        What the pushes at the start showed.
    flags_seen
        What left the range that was certified.
    """

    ended: str
    is_safe_stop: bool
    log: Path | None
    n_periods: int
    overruns: int
    lateness: Array
    computation_time: Array
    counts: Mapping[str, int]
    facts: Mapping[str, str]
    push: tuple[PushResponse, ...]
    flags_seen: WatchFlag

    def percentiles(self) -> dict[str, Array]:
        """Return the percentiles 50, 90, 99, 99.9 and 100 of lateness and computation time [s]."""
        return {
            name: np.percentile(values, PERCENTILES) if len(values) else np.full(len(PERCENTILES), np.nan)
            for name, values in (("lateness", self.lateness), ("computation_time", self.computation_time))
        }

    def histogram(self) -> tuple[Array, Array]:
        """Return how many periods began how late, and the ends of the bins [s], five bins per decade from 1 µs on."""
        return np.histogram(self.lateness, HISTOGRAM_EDGES)

    def load(self) -> Run:
        """Return the log as a run.

        Raises
        ------
        InvalidParameter
            For a run without a log.
        """
        if self.log is None:
            raise InvalidParameter("log: this run has none; give run_live(log=…)")
        return Run.load(self.log)

    def __repr__(self) -> str:
        return f"<LiveRun: {self.ended}, {self.n_periods} periods, {self.overruns} missed>"


def run_live(
    law: Law,
    robot: Robot,
    reference: Reference,
    duration: float,
    *,
    limits: SafetyLimits | None = None,
    start_up: StartUp | None = None,
    watchdog: float = 0.05,
    overrun: str = "bridge",
    watch: Watch | None = None,
    priority: int = 80,
    native: bool | None = None,
    allow_unlimited_torque: bool = False,
    log: str | Path | None = None,
    joint_names: Sequence[str] = (),
    units: Sequence[str] = (),
    label: str = "robot",
    scenario: Mapping[str, Any] | None = None,
    certificate: Mapping[str, Any] | None = None,
    changes: GainChanges | None = None,
    clock: Clock | None = None,
    on_log: Callable[[Log], object] | None = None,
) -> LiveRun:
    """Run a law on a robot: one read, one step and one write per period, at absolute deadlines.

    The torque of the brakes is taken over, they open, and the law holds the first measured position. A ramp leads to
    the start of the reference. At the end, and by Ctrl-C, the reference comes to rest and the brakes close. A fault is
    a safe stop: the law's ``safe_torque``, and the brakes at once.

    Parameters
    ----------
    law
        Any law of `tarc.laws`, or your own; its period is that of the loop.
    robot
        The robot. It stays open.
    reference, duration
        The reference, and for how long it is followed [s].
    limits
        Limits, each with its reaction; None for those of the law alone.
    start_up
        How the run starts and ends.
    watchdog
        Longest time without a sample, and longest time that the loop may stand still [s]; then a safe stop. Two
        periods at least.
    overrun
        What a missed period is. By ``bridge`` the law goes through it without a sample, by ``skip`` it does not know
        of it, and ``stop`` is a safe stop. By ``shift`` all later deadlines move: for a robot that waits for commands,
        such as `MujocoRobot` with ``in_step``.
    watch
        The certificate's assumptions, as `tarc.analysis.watch_workspace` returns them. They are recorded.
    priority
        Of SCHED_FIFO, 1 to 99; 0 for the ordinary scheduler.
    native
        Compile the law; None to do so where there is a C compiler.
    allow_unlimited_torque
        Start although a joint has no torque limit.
    log
        File of the log, netCDF; None for none. With the suffix ``.mcap`` a bag of ROS 2, beside the netCDF file that
        is written while the loop runs.
    joint_names
        Names of the law's joints, which are compared with those of the robot; empty to compare none.
    units, label, scenario, certificate
        For the log: units of the joints, name of the robot, scenario and certificate ready for JSON.
    changes
        Gains of this law that may change meanwhile, within what is certified; None for none.
    clock
        A clock of your own, such as `SimulatedClock`.
    on_log
        Called with the log before the start, for a display.

    Raises
    ------
    InvalidParameter
        For a period that this machine cannot hold, and joints in another order than the robot's. For a law without a
        torque limit, a robot without a valid position, and changes of another law. The robot's brakes stay closed.
    MissingTool
        For a bag without the libraries that write it, the extra ``logs``.
    """
    limits, start_up, clock = limits or SafetyLimits(), start_up or StartUp(), clock or Clock()
    check.one_of("overrun", overrun, OVERRUN_POLICIES)
    check.number("watchdog", watchdog, 2 * law.period)
    check.integer("priority", priority, 0, 99)
    check.number("duration", duration, law.period, high=MAX_PERIODS * law.period)
    if not allow_unlimited_torque:
        require_torque_limit(limits, law)
    target, bag = _log_files(log)
    names = _checked_names(law, robot, reference, joint_names)
    controller, facts = _controller(law, limits, native)
    motion = _motion(reference, duration, law.period)
    layout = LogLayout.of(law)
    watcher = None if watch is None else Watcher(watch)
    subject = LogSubject(
        law, reference, limits, names, units or ["rad"] * law.n_joints, label, scenario, certificate, watchdog
    )
    with real_time(priority if clock.is_real else 0) as got:
        facts |= got
        if clock.is_real:
            check_period(_trial(controller, robot), law.period, clock)
        record = Log(header(layout, subject, facts), target)
        guard = Watchdog(robot, watchdog, clock)
        parts = LoopParts(
            controller, robot, limits, start_up, layout, record.ring, clock, guard, watchdog, overrun, watcher, changes
        )
        loop = LiveLoop(parts, motion)
        if on_log is not None:
            on_log(record)
        with _changing(changes, controller, limits, record):
            _run(loop, robot, guard, record)
    result = _result(loop, robot, record, facts)
    if bag is not None and not record.error:
        result.load().save(bag)
    return result


def _log_files(log: str | Path | None) -> tuple[Path | None, Path | None]:
    """Return the netCDF file to write, and the bag beside it; None for none."""
    target = None if log is None else Path(log)
    if target is None or target.suffix.lower() != BAG:
        return target, None
    require_bag_writer()
    return target.with_suffix(".nc"), target


def _changing(
    changes: GainChanges | None, controller: Controller, limits: SafetyLimits, record: Log
) -> AbstractContextManager[object]:
    """Return the time in which gains may change."""
    if changes is None:
        return nullcontext()
    return changes.start(controller, limits.interface, record.add_change)


def _motion(reference: Reference, duration: float, period: float) -> Motion:
    """Return a reference in every period of a duration [s]."""
    if isinstance(reference, OnlineReference):
        return reference.motion(max(1, round(duration / period)), period)
    return sampled(reference, duration, period)


def _result(loop: LiveLoop, robot: Robot, record: Log, facts: Mapping[str, str]) -> LiveRun:
    return LiveRun(
        loop.ended,
        loop.is_safe_stop,
        record.target,
        loop.n_periods,
        loop.overruns,
        loop.lateness.copy(),
        loop.computation_time.copy(),
        {**robot.counts, "rejected": loop.rejected},
        {**facts, **({"log": record.error} if record.error else {})},
        loop.push,
        WatchFlag(loop.flags_seen),
    )


def _run(loop: LiveLoop, robot: Robot, guard: Watchdog, record: Log) -> None:
    """Run the loop; leave the brakes closed and the log complete, whatever happens."""
    ended = "an error in the loop"
    try:
        with guard, _interrupted_by(loop):
            loop.run()
        ended = loop.ended
    finally:
        robot.engage_brakes()
        record.close(
            {
                "ended": ended,
                "counts": json.dumps({**robot.counts, "rejected": loop.rejected}),
                "push": json.dumps([response.to_dict() for response in loop.push]) if loop.push else "",
                "tracking_start": loop.tracking_start,
            }
        )


@contextmanager
def _interrupted_by(loop: LiveLoop) -> Iterator[None]:
    """Let Ctrl-C stop a loop in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, loop.interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _checked_names(law: Law, robot: Robot, reference: Reference, joint_names: Sequence[str]) -> list[str]:
    """Return the names of the joints.

    Raises
    ------
    InvalidParameter
        For another number of joints, and other joints or another order than the robot's.
    """
    n, ours, theirs = law.n_joints, list(joint_names), list(robot.joint_names)
    if reference.n_joints != n:
        raise InvalidParameter(f"reference: it has {reference.n_joints} joints, the law {n}", "reference")
    for label, names in (("joint_names", ours), ("robot", theirs)):
        if names and len(names) != n:
            raise InvalidParameter(f"{label}: it has {len(names)} joints ({', '.join(names)}), the law {n}", label)
    if ours and theirs and ours != theirs:
        is_order = sorted(ours) == sorted(theirs)
        raise InvalidParameter(
            f"robot: its joints are {', '.join(theirs)}, those of the law {', '.join(ours)}"
            + ("; the order differs: " if is_order else ": ")
            + "give the law's parameters in the order of the robot",
            "robot",
        )
    return theirs or ours or [f"joint{i + 1}" for i in range(n)]


def _controller(law: Law, limits: SafetyLimits, native: bool | None) -> tuple[Controller, dict[str, str]]:
    """Return the controller, and how it runs."""
    if native is not False:
        try:
            return Controller(law, native=True, torque_limits=limits.interface), {"law": "compiled C"}
        except (MissingTool, CompilationError, UnsupportedLaw) as error:
            if native:
                raise
            reason = f"virtual machine: {error}"
    else:
        reason = "virtual machine"
    return Controller(law, torque_limits=limits.interface), {"law": reason}


def _trial(controller: Controller, robot: Robot) -> Callable[[], object]:
    """Return a period without a robot that moves: the law at rest."""
    zero = np.zeros(controller.law.n_joints)
    controller.reset(zero)

    def step() -> None:
        robot.read()
        controller.step(zero, zero, zero, zero)

    return step
