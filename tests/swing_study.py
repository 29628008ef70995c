"""A study of a pendulum that swings, as the command runs it."""

from typing import Any

SCENARIO: dict[str, Any] = {
    "robot": {"kind": "Pendulum"},
    "law": {"kind": "TDC", "inertia": 0.05, "natural_frequency": 10.0},
    "estimator": {"kind": "Algebraic", "window": 0.010},
    "reference": {"kind": "Sinusoid", "amplitude": [0.5], "frequency": 2.0},
    "duration": 0.05,
    "substeps": 1,
}

STUDY: dict[str, Any] = {
    "name": "swings",
    "scenario": SCENARIO,
    "draws": {"robot.payload": {"uniform": [0.0, 1.0]}},
    "runs": 10,
}
