"""How good a law is in runs of scenarios: score, stability at rest, distance from the best linear controller."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from tarc.analysis.inertia_ratio import inverse_ratios
from tarc.analysis.linearise import require_inertia
from tarc.analysis.optimum import OptimumDistance, law_distances
from tarc.core.errors import DesignWarning, InvalidParameter, JointLimitWarning, NotLinearisable, UnsupportedLaw
from tarc.scenario.model import Scenario
from tarc.simulation.run import Run
from tarc.study.comparison import run_one
from tarc.study.trials import INSTABILITY, PENALTY

FAILURE_SCORE = 60.0
"""Objective of a run that did not complete, above that of any that did."""

REFERENCE_POSTURES = 40
"""Postures of the reference over which an inertia ratio is averaged."""


def objective(scenario: Scenario, part: dict[str, Any], limit: float) -> float:
    """Return log(RMS error), plus a penalty where the torque variation [N m/s] is above a limit.

    A loop that is unstable at rest in a posture of the reference scores `INSTABILITY` more, also where dry friction or
    the motion hides it. Gains that the law refuses, and runs that diverge, score up to `FAILURE_SCORE`.
    """
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", DesignWarning)
        warnings.simplefilter("ignore", JointLimitWarning)
        try:
            trial = Scenario.parse({**scenario.model_dump(), "law": part})
            run = next(iter(trial.run(progress=False).values()))
        except InvalidParameter:
            return FAILURE_SCORE
    if not run.status.completed:
        return FAILURE_SCORE - float(run.data["time"].values[-1]) / scenario.duration
    measures = run.metrics(start_time=scenario.metrics_start)
    excess = max(0.0, float(np.log(measures["torque_variation"] / limit)))
    score = float(np.log(measures["rms_error"])) + PENALTY * excess
    return score + INSTABILITY if run.instability else score


def mean_objective(scenarios: Sequence[Scenario], law: dict[str, Any], limits: Sequence[float]) -> float:
    """Return the mean of the `objective` over scenarios, each with its limit on torque variation [N m/s]."""
    pairs = zip(scenarios, limits, strict=True)
    return float(np.mean([objective(scenario, law, limit) for scenario, limit in pairs]))


def unstable_scenarios(law: dict[str, Any], scenarios: Sequence[Scenario]) -> list[str]:
    """Return the names of the scenarios in which a law is unstable at rest in a posture of the reference."""
    names = []
    for scenario in scenarios:
        result = run_one(scenario.model_dump(), "law", law)
        if isinstance(result, Run) and result.instability:
            names.append(scenario.name)
    return names


def optimum_distance(law: dict[str, Any], scenario: Scenario) -> OptimumDistance | None:
    """Return how far a law is from the best linear controller, at the mean inertia along the reference.

    None for a law without a loop of single joints, such as one with coupled gains or with a nonlinear estimator.
    """
    built = Scenario.parse({**scenario.model_dump(), "law": law}).build()
    (tuned,) = built.laws.values()
    positions, _, _ = built.reference.sample(np.linspace(0.0, scenario.duration, REFERENCE_POSTURES))
    try:
        tuned = require_inertia(tuned, "its distance from the optimum")
        inertias = np.array([built.plant.inertia(position) for position in positions.T])
        ratio = float(np.exp(-np.mean(np.log(inverse_ratios(inertias, tuned.M)))))
        return max(law_distances(tuned, [ratio]), key=lambda distance: distance.ratio, default=None)
    except (UnsupportedLaw, NotLinearisable):
        return None
