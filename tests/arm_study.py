"""The scenario of an arm of two links, whose draws the tests of studies vary."""

from typing import Any

TARC: dict[str, Any] = {
    "kind": "TARC",
    "inertia": {"fraction": 0.08},
    "natural_frequency": 15.0,
    "rise_rate": 2000.0,
    "fall_rate": 1000.0,
    "boundary_layer": 0.015,
    "max_gain": 5.0,
}

TDC: dict[str, Any] = {"kind": "TDC", "inertia": {"fraction": 0.08}, "natural_frequency": 15.0}

SCENARIO: dict[str, Any] = {
    "robot": {"kind": "TwoLinkArm", "viscous": [0.5, 0.5]},
    "law": [TARC, TDC],
    "estimator": {"kind": "Algebraic", "window": 0.01, "degree": 2},
    "reference": {"kind": "Sinusoid", "amplitude": [0.3, 0.4], "frequency": [2.0, 3.0], "offset": [0.0, 1.5]},
    "initial_torque": "rest",
    "duration": 0.3,
    "metrics_start": 0.1,
    "substeps": 2,
}
