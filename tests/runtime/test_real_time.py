"""What is taken from the operating system, and what is said where it is refused."""

import gc
import os
import sys
import time

import numpy as np
import pytest

from tarc.core.errors import InvalidParameter
from tarc.runtime.clock import Clock, SimulatedClock
from tarc.runtime.real_time import check_period, real_time
from tarc.runtime.robot import Robot
from tarc.runtime.watchdog import Watchdog


def test_everything_is_given_back():
    before = gc.isenabled(), sys.getswitchinterval(), os.sched_getscheduler(0)
    with real_time(1) as facts:
        assert not gc.isenabled()
        is_fifo = os.sched_getscheduler(0) == os.SCHED_FIFO
        assert facts["scheduler"].startswith("SCHED_FIFO" if is_fifo else "ordinary")
        assert "locked" in facts["memory"]
    assert (gc.isenabled(), sys.getswitchinterval(), os.sched_getscheduler(0)) == before


def test_a_refusal_says_what_to_allow(monkeypatch):
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with real_time(50) as facts:
        assert facts["scheduler"] == (
            "ordinary: SCHED_FIFO is refused (Operation not permitted); allow it by ulimit -r or CAP_SYS_NICE"
        )


def test_without_a_priority_nothing_is_taken():
    with real_time(0) as facts:
        assert facts == {"scheduler": "ordinary", "memory": "not locked", "garbage collector": "off"}


def test_a_period_is_held_or_refused_by_what_was_measured():
    clock = SimulatedClock()
    measured = check_period(lambda: clock.advance(0.4e-3), 1e-3, clock)
    assert measured["step_time"] == pytest.approx(0.4e-3)
    assert measured["wake_up_time"] == pytest.approx(0, abs=1e-9)
    with pytest.raises(
        InvalidParameter, match=r"wakes up 0 µs late and takes 2000 µs for a period .* 0\.004 s or more"
    ):
        check_period(lambda: clock.advance(2e-3), 1e-3, clock)


def test_the_clock_sleeps_until_an_instant_and_not_after_a_past_one():
    clock = Clock()
    start = clock.now()
    clock.sleep_until(start + 0.01)
    assert clock.now() >= start + 0.01
    clock.sleep_until(start)


def test_the_watchdog_acts_once_and_only_after_a_beat():
    class Counted(Robot):
        stops = 0

        def read(self) -> np.ndarray:
            return np.zeros(1)

        def write(self, torque: np.ndarray) -> None: ...

        def engage_brakes(self) -> None:
            self.stops += 1

    robot = Counted()
    with Watchdog(robot, 0.02, Clock()) as guard:
        time.sleep(0.1)
        assert not guard.has_fired  # the loop has not begun
        guard.beat()
        end = time.monotonic() + 120
        while not guard.has_fired and time.monotonic() < end:
            time.sleep(0.01)
        time.sleep(0.05)
    assert guard.has_fired
    assert robot.stops == 1
