"""The trials of a search, and what is chosen from them: the best law, or the front."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tarc.core.errors import NotConverged
from tarc.scenario.model import Scenario
from tarc.study.front import FrontPoint, TuningFront, is_on_front
from tarc.study.law_scores import mean_objective, optimum_distance
from tarc.study.search_space import SearchSpace
from tarc.study.trials import TrialOutcome

VERIFIED = 5
"""Best trials that are run again as `tarc run` runs them, until one is as good as in the search."""
VERIFIED_DIFFERENCE = 0.02
"""Largest increase of the objective in such a run."""


@dataclass(frozen=True)
class FinishedSearch:
    """Finished trials of a law: gains and outcome of each."""

    space: SearchSpace
    scenarios: Sequence[Scenario]
    limits: Sequence[float]
    margin: float | None
    trials: list[tuple[dict[str, float], TrialOutcome]]

    def law(self, gains: dict[str, float]) -> dict[str, Any]:
        """Return the law with these gains, as a scenario writes it."""
        return self.space.law(gains, self.scenarios[0].period)

    def best(self) -> tuple[dict[str, Any], float]:
        """Return the best law and its objective, in runs as `tarc run` makes them.

        The steps of the integration were those of the scenario's laws. Where a run with its own steps is worse, the
        next best is run too.
        """
        complete = [(outcome.score(self.limits), gains) for gains, outcome in self._certified() if not outcome.failure]
        if not complete:
            gains, _ = max(self._certified(), key=lambda trial: (trial[1].standing[0], -trial[1].standing[1]))
            return self.law(gains), self._objective(self.law(gains))
        verified = []
        for score, gains in sorted(complete, key=lambda pair: pair[0])[:VERIFIED]:
            law = self.law(gains)
            verified.append((self._objective(law), law))
            if verified[-1][0] <= score + VERIFIED_DIFFERENCE:
                break
        score, law = min(verified, key=lambda pair: pair[0])
        return law, score

    def front(self) -> TuningFront:
        """Return the trials that no others beat in both objectives."""
        stable = [(gains, outcome) for gains, outcome in self._certified() if outcome.is_stable]
        if not stable:
            raise NotConverged(
                f"tune: none of {len(self.trials)} sets of gains of {self.space.fixed['kind']} completed and is stable "
                f"at rest ({_counted(self.failures)}); try more, or other ranges"
            )
        values = np.array([outcome.objectives(self.limits) for _, outcome in stable])
        chosen = np.flatnonzero(is_on_front(values[:, 0], values[:, 1]))
        points = [self._point(*stable[i]) for i in chosen]
        ordered = tuple(sorted(points, key=lambda point: point.rms_error))
        return TuningFront(ordered, len(self.trials), self.failures)

    @property
    def failures(self) -> dict[str, int]:
        """Number of trials that ended early, by reason."""
        reasons = [outcome.failure for _, outcome in self.trials if outcome.failure]
        return {reason: reasons.count(reason) for reason in dict.fromkeys(reasons)}

    def _certified(self) -> list[tuple[dict[str, float], TrialOutcome]]:
        """Return the trials that have the margin."""
        margin = self.margin
        if margin is None:
            return self.trials
        kept = [trial for trial in self.trials if trial[1].margin is not None and trial[1].margin >= margin]
        if not kept:
            largest = max((outcome.margin for _, outcome in self.trials if outcome.margin is not None), default=-1.0)
            raise NotConverged(
                f"margin: none of {len(self.trials)} sets of gains of {self.space.fixed['kind']} has a robust margin "
                f"of {margin:g}; the largest is {largest:.3g}. Try more, widen the ranges, or lower the margin"
            )
        return kept

    def _objective(self, law: dict[str, Any]) -> float:
        return mean_objective(self.scenarios, law, self.limits)

    def _point(self, gains: dict[str, float], outcome: TrialOutcome) -> FrontPoint:
        error, variation = (
            float(np.exp(np.mean(np.log(values)))) for values in (outcome.rms_errors, outcome.torque_variations)
        )
        law = self.law(gains)
        distance = optimum_distance(law, self.scenarios[0])
        least = None if distance is None or not np.isfinite(distance.ratio) else error / distance.ratio
        return FrontPoint(law, gains, error, variation, outcome.margin, least)


def _counted(failures: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in failures.items()) or "none failed"
