"""A loop of the virtual machine that is traced once, with the numbers of its law and sensor that vary as inputs."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from tarc.core.errors import UnsupportedLaw
from tarc.core.tracing import TRACE_ERRORS
from tarc.core.trees import pack
from tarc.core.types import Array
from tarc.simulation.casadi_backend import TracedLoop
from tarc.simulation.closed_loop import ClosedLoop
from tarc.simulation.sampled_inputs import InitialConditions, SampledInputs
from tarc.simulation.varying import Path, VaryingParts, are_close

TRIAL_PERIODS = 25
"""Periods in which a loop with symbols is compared with one that was built with its numbers."""


class TrialRun(NamedTuple):
    """Loop, start and inputs of a short run."""

    loop: ClosedLoop
    initial: InitialConditions
    inputs: SampledInputs

    @property
    def parts(self) -> tuple[Any, Any]:
        """Return controller and drive."""
        return self.loop.controller, self.loop.drive

    def trajectory(self, traced: TracedLoop, parts: tuple[Any, Any] | None) -> Array:
        """Return states and outputs of all periods, by a traced loop, (periods, numbers)."""
        loop, initial, inputs = self
        state = pack(loop.init(initial.position, initial.velocity, initial.torque, inputs.noise[:, 0]))
        rows = []
        for row in traced.input_rows(loop.plant, inputs, parts):
            state, output = (np.array(one)[:, 0] for one in traced.function(state, row))
            rows.append(np.concatenate([state, output]))
        return np.array(rows)


class VariedLoop:
    """A loop that is traced once for all runs that differ from some examples in numbers.

    Parameters
    ----------
    runs
        The examples.
    parameters
        Plant parameters that differ from run to run.

    Attributes
    ----------
    traced
        The loop.

    Raises
    ------
    UnsupportedLaw
        For a number that has no symbol, or enters what is computed when a part is built. For examples of different
        structure.
    """

    def __init__(self, runs: Sequence[TrialRun], parameters: Iterable[str]):
        names = list(parameters)
        first = runs[0]
        built = [TracedLoop(*run, names) for run in runs]  # which computes what the parts keep
        self._varying = VaryingParts([run.parts for run in runs])
        self._inputs = first.inputs
        self.traced = _traced(first, names, self._varying)
        for run, theirs in zip(runs, built, strict=True):
            if not are_close(run.trajectory(self.traced, run.parts), run.trajectory(theirs, None)):
                raise UnsupportedLaw("a number that varies enters what is computed when a part is built")

    def covers(self, parts: tuple[Any, Any], inputs: SampledInputs) -> bool:
        """Return whether controller and drive differ from the examples in what varies alone."""
        same_inputs = all(
            (getattr(inputs, name) is None) == (getattr(self._inputs, name) is None) for name in ("periods", "age")
        )
        return same_inputs and self._varying.covers(parts)


def _traced(run: TrialRun, names: list[str], varying: VaryingParts) -> TracedLoop:
    """Trace with symbols for as much of what varies as can be."""
    try:
        return TracedLoop(*run, names, varying)
    except TRACE_ERRORS:
        taken: list[Path] = []
        for path in varying.paths:
            with suppress(*TRACE_ERRORS):
                TracedLoop(*run, names, varying.with_paths([*taken, path]))
                taken.append(path)
        return TracedLoop(*run, names, varying.with_paths(taken))
