"""Watch a run for divergence and show its progress."""

import numpy as np

from tarc.core import validation as check
from tarc.core.progress import Progress
from tarc.simulation.sampled_inputs import Plan

CHUNK = 500
"""Periods between two looks at whether the run has diverged."""


class Watch:
    """Looks at a run as it goes: shows progress, tells when it has diverged."""

    def __init__(self, plan: Plan, divergence: float, show: bool | None):
        self.limit = check.number("divergence_threshold", divergence, 0, strict=True)
        self.reference = plan.reference[0].T
        self.count = len(plan.times)
        self.progress = Progress("simulating", self.count, show)
        self.divergence_time: int | None = None

    def look(self, begin: int, positions: np.ndarray) -> bool:
        """Whether to go on after the instants from ``begin`` with these positions (k, n)."""
        self.progress.advance(len(positions))
        with np.errstate(invalid="ignore", over="ignore"):
            error = np.abs(positions - self.reference[begin : begin + len(positions)])
            fine = error.max() <= self.limit
        if not fine:
            self.divergence_time = begin + int(np.argmax(~np.all(error <= self.limit, axis=1)))
        return self.divergence_time is None

    def end(self, rows: int) -> int:
        """How many of the rows are worth keeping."""
        return rows if self.divergence_time is None else max(self.divergence_time, 1)
