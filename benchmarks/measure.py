"""A row of the table, and the stopwatches that fill it."""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

import tarc
from tarc.simulation.monitor import DivergenceMonitor
from tarc.simulation.sampled_inputs import SampledInputs


class Row(NamedTuple):
    """One result; a ratio is against / measured."""

    what: str
    measured: str
    against: str = ""
    ratio: float | None = None
    target: str = ""
    met: bool | None = None


def law(inertia: np.ndarray, window: int, rise: float, limit: np.ndarray | None = None) -> tarc.laws.TARC:
    """Return TARC at 1 kHz with a window [periods]."""
    estimator = tarc.estimators.Algebraic(window=window * 1e-3, degree=2)
    return tarc.laws.TARC(
        inertia=inertia,
        natural_frequency=10.0,
        period=1e-3,
        estimator=estimator,
        rise_rate=rise,
        fall_rate=rise / 2,
        torque_limit=limit,
    )


def best(calls: list[Callable[[], object]], repeat: int, rounds: int = 15) -> list[float]:
    """Least time [s] of one call of each function, taken in turns of ``repeat`` calls."""
    least = [np.inf] * len(calls)
    for _ in range(rounds):
        for i, call in enumerate(calls):
            begin = time.perf_counter()
            for _ in range(repeat):
                call()
            least[i] = min(least[i], (time.perf_counter() - begin) / repeat)
    return least


class Stopwatch(DivergenceMonitor):
    """Times what an engine simulates: ``times``, a period [s] in each stretch of four looks, without its set-up.

    ``between`` is called after every stretch, off the clock, with the number of the next period. It lets two engines
    take turns, in stretches so long that the state of the caches does not matter.
    """

    def __init__(self, plan: SampledInputs, between: Callable[[int], object] = lambda at: None):
        super().__init__(plan, 100.0, False)
        self.times: list[float] = []
        self.between = between
        self._looks, self._at, self._clock = 0, 0, 0.0

    def update(self, first: int, positions: np.ndarray) -> bool:
        """As it was, with the time taken; the first stretch began with the set-up and is left out."""
        go_on = super().update(first, positions)
        self._looks += 1
        if self._looks % 4 == 0:
            now, end = time.perf_counter(), first + len(positions)
            if self._at:
                self.times.append((now - self._clock) / (end - self._at))
            self.between(end)
            self._at, self._clock = end, time.perf_counter()
        return go_on
