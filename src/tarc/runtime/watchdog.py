"""A thread that engages the brakes where the loop stands still."""

import threading

import numpy as np

from tarc.runtime.clock import Clock
from tarc.runtime.robot import Robot


class Watchdog:
    """Engages the brakes of a robot when no beat came for a time after the last one, once.

    Parameters
    ----------
    robot
        The robot.
    timeout
        [s].
    clock
        That of the loop; a simulated one gets no thread.

    Attributes
    ----------
    has_fired
        Whether it engaged the brakes.
    """

    def __init__(self, robot: Robot, timeout: float, clock: Clock):
        self._robot, self._timeout, self._clock = robot, timeout, clock
        self._beat = np.inf
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="tarc-watchdog", daemon=True)
        self.has_fired = False

    def __enter__(self) -> "Watchdog":
        if self._clock.is_real:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        if self._clock.is_real:
            self._thread.join()

    def beat(self) -> None:
        """Say that the loop moves."""
        self._beat = self._clock.now()

    def _watch(self) -> None:
        while not self._end.wait(self._timeout / 4):
            if self._clock.now() - self._beat > self._timeout:
                self.has_fired = True
                self._robot.engage_brakes()
                return
