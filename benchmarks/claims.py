"""Laws against TDC over draws of robot, load, friction, noise and gains: ``python -m benchmarks.claims``.

Each scenario of the comparison is a study, with all tuned laws that can run in it. A study is continued where it
stopped; ``--runs`` may grow. The results stand in ``runs/claims``, and ``python -m benchmarks.numbers intervals`` takes
the tables of the pages from there.
"""

import argparse
import warnings
from pathlib import Path
from typing import Any

from tarc import Scenario
from tarc.core.errors import DesignWarning, InvalidParameter, ScenarioError
from tarc.plants import TwoLinkArm
from tarc.study import Study, StudyResult
from tarc.study.comparison import laws_for, tuned_laws

RESULTS = Path("runs/claims")

LAWS = tuple(tuned_laws())
"""Laws of the comparison, TDC first: the others are compared with it."""

ASMC_GAINS = {"adaptation_rate": 20.0, "boundary_layer": 0.2, "max_gain": 20.0}
TDARC_GAINS = {
    "rise_rate": 333.0,
    "fall_rate": 167.0,
    "state_rise_rate": 4e4,
    "state_fall_rate": 2e4,
    "boundary_layer": 0.12,
    "max_gain": 6.0,
}
BARRIER_GAINS = {"position_limit": 0.003, "velocity_limit": 0.2, "barrier_gain": 36.0}

PAPER_SCENARIO: dict[str, Any] = {
    "robot": {"kind": "TwoLinkArm", "viscous": [1.0, 1.0], "coulomb": [2.0, 1.0]},
    "law": {"kind": "TDC", "inertia": 1.0},
    "estimator": {"kind": "Algebraic", "window": 0.010},
    "reference": {
        "kind": "Sinusoid",
        "amplitude": [0.5, 0.5],
        "frequency": [1.5, 2.1],
        "phase": 1.5707963267948966,
        "offset": [0.0, 1.5],
    },
    "sensor": {"bits": 16},
    "disturbance": [{"kind": "Payload", "mass": 1.0, "start_time": 5.0}],
    "initial_torque": "rest",
    "duration": 10.0,
    "metrics_start": 1.0,
}
PAPER_DRAWS: dict[str, Any] = {
    "robot.masses.0": {"uniform": [0.8, 1.2]},
    "robot.masses.1": {"uniform": [0.8, 1.2]},
    "robot.coulomb.0": {"uniform": [1.0, 3.0]},
    "robot.coulomb.1": {"uniform": [0.5, 1.5]},
    "disturbance.0.mass": {"uniform": [0.25, 1.75]},
    "sensor.noise": {"log_uniform": [1e-6, 3e-5]},
}

MIN_RUNS = 32
"""Finished runs from which on a study is in the tables."""

GAINS = ("natural_frequency", "inertia.fraction")
GAIN_DEVIATION = 0.05
"""Standard deviation of each drawn gain, over its tuned value: no two searches end at the same one."""

TWO_LINK = {
    "robot.masses.0": {"uniform": [0.8, 1.2]},
    "robot.masses.1": {"uniform": [0.8, 1.2]},
    "sensor.noise": {"log_uniform": [1e-6, 3e-5]},
}

DRAWS: dict[str, dict[str, Any]] = {
    "two_link_payload": {
        **TWO_LINK,
        "robot.viscous.0": {"uniform": [0.25, 1.0]},
        "robot.viscous.1": {"uniform": [0.25, 1.0]},
        "disturbance.0.mass": {"uniform": [0.5, 2.5]},
    },
    "two_link_friction": {
        **TWO_LINK,
        "robot.coulomb.0": {"uniform": [5.0, 11.0]},
        "robot.coulomb.1": {"uniform": [3.0, 7.0]},
    },
    "vibration": {
        "robot.masses.0": {"uniform": [4.0, 6.0]},
        "robot.masses.1": {"uniform": [2.4, 3.6]},
        "disturbance.0.amplitude": {"uniform": [2.5, 7.5]},
        "sensor.noise": {"log_uniform": [1e-7, 3e-6]},
    },
    "coarse_encoder": {
        **TWO_LINK,
        "robot.coulomb.0": {"uniform": [0.5, 2.0]},
        "robot.coulomb.1": {"uniform": [0.25, 1.0]},
    },
    "dropout_delay": {
        **TWO_LINK,
        "robot.coulomb.0": {"uniform": [0.5, 2.0]},
        "robot.coulomb.1": {"uniform": [0.25, 1.0]},
        "sensor.dropout": {"uniform": [0.0, 0.04]},
    },
    "wheeled_figure_eight": {
        "robot.mass": {"uniform": [14.0, 20.0]},
        "disturbance.2.mass": {"uniform": [2.0, 18.0]},
        "sensor.noise": {"log_uniform": [1e-6, 1e-4]},
    },
    "underwater": {
        "robot.mass": {"uniform": [13.0, 14.0]},
        "robot.quadratic_drag.0": {"uniform": [100.0, 180.0]},
        "disturbance.1.mass": {"uniform": [0.0, 2.0]},
        "sensor.noise": {"uniform": [0.003, 0.008]},
    },
    "series_elastic": {
        "robot.spring_stiffness": {"uniform": [250.0, 550.0]},
        "robot.mass": {"uniform": [1.2, 1.8]},
        "disturbance.0.mass": {"uniform": [0.5, 1.5]},
        "sensor.noise": {"log_uniform": [1e-6, 3e-5]},
    },
    "ur5e_load": {
        "robot.coulomb": {"uniform": [1.0, 4.0]},
        "robot.viscous": {"uniform": [0.5, 2.0]},
        "disturbance.0.values.0": {"uniform": [0.0, 5.0]},
        "sensor.noise": {"log_uniform": [1e-6, 3e-5]},
    },
    "panda_multisine": {
        "robot.coulomb": {"uniform": [0.25, 1.0]},
        "robot.viscous": {"uniform": [0.5, 2.0]},
        "sensor.noise": {"log_uniform": [1e-6, 3e-5]},
    },
}
"""What is drawn in each scenario, beside the gains: about the scenario's own values."""


PAPER = "paper_claims"
"""Study of the arm and the laws of the page on the paper's claims."""


def paper_study(runs: int) -> Study:
    """Return the study of the page on the paper's claims: its arm, reference and gains, with draws about them."""
    arm = TwoLinkArm(viscous=[1.0, 1.0], coulomb=[2.0, 1.0])
    common = {"inertia": (0.06 * arm.inertia([0.0, 1.5])).tolist(), "natural_frequency": 12.0}
    adaptive = {**common, "boundary_layer": 0.01, "max_gain": 6.0}
    equal = {**adaptive, "kind": "TARC", "rise_rate": 4000.0, "fall_rate": 4000.0}
    filtered = {"kind": "FilteredDifference", "cutoff": 300.0}
    laws: dict[str, dict[str, Any]] = {
        "TDC": {"kind": "TDC", **common},
        "TARC": {"kind": "TARC", **adaptive, "rise_rate": 4000.0, "fall_rate": 2000.0},
        "TARC, equal rates, difference": {**equal, "growth": "difference"},
        "TARC, equal rates, window": {**equal, "growth": "window"},
        "TARC, five times the rates, window": {**equal, "growth": "window", "rise_rate": 2e4, "fall_rate": 2e4},
        "ASMC, 0.003": {"kind": "ASMC", **ASMC_GAINS, **common, "threshold": 0.003},
        "ASMC, 0.03": {"kind": "ASMC", **ASMC_GAINS, **common, "threshold": 0.03},
        "filtered differences": {"kind": "TDC", **common, "estimator": filtered},
        "computed torque": {"kind": "ComputedTorque", "natural_frequency": 12.0, "model": "robot"},
        "TDARC": {"kind": "TDARC", **TDARC_GAINS, **common},
        "barrier at 3 mrad": {"kind": "BarrierTDARC", **BARRIER_GAINS, **common},
    }
    return Study.parse(
        {
            "name": PAPER,
            "scenario": PAPER_SCENARIO,
            "laws": [{**law, "label": name} for name, law in laws.items()],
            "runs": runs,
            "sampling": "independent",
            "draws": PAPER_DRAWS,
        }
    )


def study_of(scenario: str, runs: int) -> Study:
    """Return the study of a scenario."""
    if scenario == PAPER:
        return paper_study(runs)
    described = Scenario.load(scenario)
    laws = [{**law, "label": name} for name, law in laws_for(described).items() if can_run(described, law)]
    return Study.parse(
        {
            "name": scenario,
            "scenario": scenario,
            "laws": laws,
            "runs": runs,
            "sampling": "independent",
            "draws": {**DRAWS[scenario], **gain_draws(laws)},
        }
    )


def can_run(scenario: Scenario, law: dict[str, Any]) -> bool:
    """Return whether a scenario can build a law; some need a model of a kind that its robot lacks."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DesignWarning)  # an unstable loop is a result of the study
        try:
            Scenario.parse({**scenario.model_dump(), "law": law}).build()
        except (InvalidParameter, ScenarioError):
            return False
    return True


def gain_draws(laws: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the distributions of the laws' gains."""
    draws = {}
    for number, law in enumerate(laws):
        for name in GAINS:
            first, _, second = name.partition(".")
            value = law.get(first, {}).get(second) if second else law.get(first)
            if isinstance(value, float):
                spread = GAIN_DEVIATION * value
                draws[f"law.{number}.{name}"] = {
                    "normal": {
                        "mean": value,
                        "deviation": spread,
                        "low": value - 3 * spread,
                        "high": value + 3 * spread,
                    }
                }
    return draws


def results() -> dict[str, StudyResult]:
    """Return the studies of which enough runs are finished, by scenario."""
    opened = {name: StudyResult.open(RESULTS / name) for name in (*DRAWS, PAPER) if (RESULTS / name).is_dir()}
    return {name: result for name, result in opened.items() if result.data.sizes["run"] >= MIN_RUNS}


def main() -> None:
    """Run or continue the studies."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", default=[*DRAWS, PAPER], help=f"some of {', '.join(DRAWS)}, {PAPER}")
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=None)
    options = parser.parse_args()
    RESULTS.mkdir(parents=True, exist_ok=True)
    for name in options.scenarios:
        result = study_of(name, options.runs).run(RESULTS / name, jobs=options.jobs)
        print(f"{name}: {result.data.sizes['run']} runs; {result.report()}", flush=True)


if __name__ == "__main__":
    main()
