"""Trials of one scenario side by side in machine code: one compilation for all gains of a law."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tarc.core.errors import CompilationError, MissingTool, UnsupportedLaw
from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic
from tarc.estimators.base import TorqueAverage, WindowedEstimator
from tarc.laws.base import Law
from tarc.scenario.user_law import is_from_file
from tarc.simulation.batch import BatchLoop, BatchResult
from tarc.simulation.batch_inputs import LoopCase, RunInputs
from tarc.simulation.integration import Integration


@dataclass(frozen=True, kw_only=True, eq=False)
class PaddedWindow(WindowedEstimator):
    """An estimator over a window that is longer than its weights, which are zero for the oldest samples.

    Estimators of different windows so have the same number of states.

    Parameters
    ----------
    rows
        Weights of prediction, velocity and acceleration, shape (3, samples).
    torque_weights
        Weights of the past torques in synchronised time-delay estimation, shape (samples − 1,).
    """

    rows: Array
    torque_weights: Array

    @classmethod
    def from_estimator(cls, estimator: Algebraic, samples: int) -> "PaddedWindow":
        """Return the same estimator over a window of more samples."""
        rows = np.zeros((3, samples))
        for row, weights in zip(rows, estimator.sums.T, strict=True):
            row[: len(weights)] = weights
        torque_weights = np.zeros(samples - 1)
        own = estimator.matched_torque_filter().weights
        torque_weights[: len(own)] = own
        return cls(period=estimator.period, rows=rows, torque_weights=torque_weights)

    @property
    def max_derivative(self) -> int:
        """Return two."""
        return 2

    def weights(self, derivative: int) -> Array:
        """Return the weights [s^−derivative] of the samples, newest first."""
        return self.rows[self._order(derivative)]

    @property
    def prediction(self) -> Array:
        """Return the weights over the past window that predict the next sample."""
        return self.rows[0]

    def matched_torque_filter(self) -> TorqueAverage:
        """Return the average with the weights given, which may be symbols."""
        average = TorqueAverage(np.zeros(len(self.rows[0]) - 1))
        average.weights = self.torque_weights
        return average


class TrialLanes:
    """Runs laws that differ in their gains alone, several at a time, by `BatchLoop`.

    Parameters
    ----------
    examples
        Laws whose gains differ in all that may differ, those with the shortest and the longest window among them.
    case_of
        Returns the loop of a law.
    integration
        Method and steps.
    duration, metrics_start, divergence_threshold
        As in `tarc.Scenario`.
    seed
        Seed of the noise of all runs.

    Raises
    ------
    UnsupportedLaw
        For a law that has no C, or whose gains enter what is computed when it is built.
    MissingTool, CompilationError
        Without a C compiler, and where it fails.
    """

    def __init__(
        self,
        examples: Sequence[Law],
        case_of: Callable[[Law], LoopCase],
        integration: Integration,
        *,
        duration: float,
        metrics_start: float,
        divergence_threshold: float,
        seed: int,
    ):
        self._case_of = case_of
        self._samples = longest_window(examples)
        cases = [self._case(law) for law in examples]
        self._loop = BatchLoop(
            cases,
            integration,
            duration,
            metrics_start=metrics_start,
            divergence_threshold=divergence_threshold,
        )
        self._inputs: RunInputs = self._loop.sample(cases[:1], [seed])[0]

    def run(self, laws: Sequence[Law]) -> tuple[list[int], BatchResult | None]:
        """Run those of some laws that the machine code covers; return their places and results."""
        cases = [self._case(law) for law in laws]
        covered = [place for place, case in enumerate(cases) if self._loop.covers(case)]
        if not covered:
            return [], None
        return covered, self._loop.run([cases[place] for place in covered], [self._inputs] * len(covered))

    def _case(self, law: Law) -> LoopCase:
        return self._case_of(pad_window(law, self._samples))


def longest_window(laws: Sequence[Law]) -> int:
    """Return the number of samples of the longest window that can be padded; zero for none."""
    estimators = [estimator for law in laws if (estimator := _window_of(law)) is not None]
    return max((len(estimator.sums) for estimator in estimators), default=0)


L = TypeVar("L", bound=Law)


def pad_window(law: L, samples: int) -> L:
    """Return a law with a window of this length, and all that it has computed; or itself where that cannot be."""
    estimator = _window_of(law)
    if estimator is None or len(estimator.sums) > samples:
        return law
    padded = copy.copy(law)
    object.__setattr__(padded, "estimator", PaddedWindow.from_estimator(estimator, samples))
    return padded


def _window_of(law: Law) -> Algebraic | None:
    """Return the estimator of a law in which nothing depends on the window but its weights; None for a user's law."""
    estimator = law.estimator
    if not isinstance(estimator, Algebraic) or estimator.max_derivative != 2 or is_from_file(law):
        return None
    return estimator


def lanes_or_none(make: Callable[[], TrialLanes]) -> TrialLanes | None:
    """Return what ``make`` returns, or None where a law or the machine has no machine code."""
    try:
        return make()
    except (UnsupportedLaw, MissingTool, CompilationError):
        return None
