"""Clocks of the loop: the machine's, and one that a test moves."""

import ctypes
import time
from collections.abc import Callable

MONOTONIC = 1
"""CLOCK_MONOTONIC of Linux, which `time.monotonic` reads."""
ABSOLUTE = 1
"""TIMER_ABSTIME."""


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


def _system_sleep() -> Callable[[float], object]:
    """Return a sleep until an instant of the monotonic clock: by ``clock_nanosleep`` where the system has it."""
    try:
        nanosleep = ctypes.CDLL(None).clock_nanosleep
    except (AttributeError, OSError, TypeError):  # macOS, Windows

        def relative(deadline: float) -> None:
            time.sleep(max(0.0, deadline - time.monotonic()))

        return relative
    until = _Timespec()
    place = ctypes.byref(until)

    def absolute(deadline: float) -> None:
        until.seconds = int(deadline)
        until.nanoseconds = int(1e9 * (deadline - int(deadline)))
        while nanosleep(MONOTONIC, ABSOLUTE, place, None) == 4:  # a signal came
            pass

    return absolute


class Clock:
    """The monotonic clock of the machine [s]."""

    is_real = True

    def __init__(self) -> None:
        self._sleep = _system_sleep()

    def now(self) -> float:
        """Return the time [s]."""
        return time.monotonic()

    def sleep_until(self, deadline: float) -> None:
        """Sleep until an instant [s]; return at once where it is past."""
        self._sleep(deadline)


class SimulatedClock(Clock):
    """A clock that moves only by sleeping, and by `advance`: for tests, and runs that are not to wait."""

    is_real = False

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """Return the time [s]."""
        return self._now

    def sleep_until(self, deadline: float) -> None:
        """Move to an instant [s]."""
        self._now = max(self._now, deadline)

    def advance(self, seconds: float) -> None:
        """Let time pass [s], as a computation or a robot that answers late does."""
        self._now += seconds
