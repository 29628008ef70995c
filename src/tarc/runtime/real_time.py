"""What a loop needs of its operating system, as far as it is allowed; and whether a period can be kept."""

import ctypes
import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.runtime.clock import Clock

MEMORY_NOW_AND_LATER = 3
"""MCL_CURRENT | MCL_FUTURE of Linux."""
SWITCH_INTERVAL = 1e-4
"""Time after which another thread of Python may run [s]."""
TRIALS = 60
"""Periods that are tried before a run."""
MAX_TRIAL_TIME = 0.5
"""Longest time of the trial [s]."""


@contextmanager
def real_time(priority: int) -> Iterator[dict[str, str]]:
    """Give this thread a real-time priority and locked memory, and switch the garbage collector off; undo it after.

    Parameters
    ----------
    priority
        Of SCHED_FIFO, 1 to 99; 0 for the ordinary scheduler and memory that is not locked.

    Yields
    ------
    dict
        What was got, in words, by name.
    """
    facts = {"scheduler": "ordinary", "memory": "not locked"}
    had_collector, interval = gc.isenabled(), sys.getswitchinterval()
    undo: list[Callable[[], object]] = []
    if priority:
        facts["scheduler"] = _take_priority(priority, undo)
        facts["memory"] = _lock_memory(undo)
    gc.collect()
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL)
    facts["garbage collector"] = "off"
    try:
        yield facts
    finally:
        for action in reversed(undo):
            action()
        sys.setswitchinterval(interval)
        if had_collector:
            gc.enable()


def _take_priority(priority: int, undo: list[Callable[[], object]]) -> str:
    if not hasattr(os, "sched_setscheduler"):
        return "ordinary: this system has no SCHED_FIFO"
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return f"ordinary: SCHED_FIFO is refused ({error.strerror}); allow it by ulimit -r or CAP_SYS_NICE"
    undo.append(lambda: os.sched_setscheduler(0, policy, parameter))
    return f"SCHED_FIFO, priority {priority}"


def _lock_memory(undo: list[Callable[[], object]]) -> str:
    try:
        library = ctypes.CDLL(None, use_errno=True)
        lock, unlock = library.mlockall, library.munlockall
    except (AttributeError, OSError, TypeError):
        return "not locked: this system has no mlockall"
    if lock(MEMORY_NOW_AND_LATER):
        reason = os.strerror(ctypes.get_errno())
        return f"not locked: refused ({reason}); allow it by ulimit -l or CAP_IPC_LOCK"
    undo.append(unlock)
    return "locked"


def check_period(step: Callable[[], object], period: float, clock: Clock) -> dict[str, float]:
    """Try some periods and refuse one that this machine cannot hold.

    Parameters
    ----------
    step
        What is computed in a period.
    period
        [s].
    clock
        The clock of the loop.

    Returns
    -------
    dict
        Medians of the time of a step and of the lateness of waking up [s].

    Raises
    ------
    InvalidParameter
        Where half of the steps with their wake-up take longer than the period; it says what was measured.
    """
    steps, late = np.zeros(TRIALS), np.zeros(TRIALS)
    start = deadline = clock.now()
    count = 0
    while count < TRIALS and (clock.now() - start < MAX_TRIAL_TIME or count < 3):
        deadline = max(deadline, clock.now()) + min(period, 1e-3)
        clock.sleep_until(deadline)
        begin = clock.now()
        step()
        steps[count], late[count] = clock.now() - begin, begin - deadline
        count += 1
    measured = {"step_time": float(np.median(steps[:count])), "wake_up_time": float(np.median(late[:count]))}
    needed = sum(measured.values())
    if needed > period:
        raise InvalidParameter(
            f"period: got {period:g} s, which this machine cannot hold: it wakes up "
            f"{1e6 * measured['wake_up_time']:.0f} µs late and takes {1e6 * measured['step_time']:.0f} µs for a period "
            f"(medians of {count}); give {2 * needed:.2g} s or more, or run the loop in C (tarc export c --realtime)",
            "period",
        )
    return measured
