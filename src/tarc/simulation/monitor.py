"""Stop a run that diverges, and show its progress."""

import numpy as np

from tarc.core import validation as check
from tarc.core.progress import Progress
from tarc.simulation.sampled_inputs import SampledInputs

DIVERGENCE_CHECK_INTERVAL = 512
"""Control periods between two checks for divergence."""


class DivergenceMonitor:
    """Compares the position with the reference while a run goes on, and shows its progress.

    Parameters
    ----------
    inputs
        With the reference.
    threshold
        Tracking error [rad or m] above which a run has diverged.
    show_progress
        Whether to show a progress bar; None for when standard error is a terminal.

    Attributes
    ----------
    divergence_index
        Index of the first sample whose error is above the threshold; None if there is none so far.
    """

    def __init__(self, inputs: SampledInputs, threshold: float, show_progress: bool | None):
        self.threshold = check.number("divergence_threshold", threshold, 0, strict=True)
        self.reference = inputs.reference[0].T
        self.progress = Progress("simulating", len(inputs.times), show_progress)
        self.divergence_index: int | None = None

    def update(self, first: int, positions: np.ndarray) -> bool:
        """Check the positions (k, n) from sample ``first`` on; return whether the run may go on."""
        self.progress.advance(len(positions))
        with np.errstate(invalid="ignore", over="ignore"):
            error = np.abs(positions - self.reference[first : first + len(positions)])
            is_bounded = error.max() <= self.threshold
        if not is_bounded:
            self.divergence_index = first + int(np.argmax(~np.all(error <= self.threshold, axis=1)))
        return self.divergence_index is None

    def valid_rows(self, n_rows: int) -> int:
        """Return the number of rows before the divergence, at least one."""
        return n_rows if self.divergence_index is None else max(self.divergence_index, 1)
