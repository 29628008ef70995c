"""Engines: one study of many kinds of keys has the same results in the virtual machine and in machine code."""

import numpy as np
import pytest

from tarc.simulation.integration import Integration
from tarc.study.execution import build_engine
from tarc.study.specification import Study

SCENARIO = {
    "robot": {"kind": "TwoLinkArm", "viscous": [0.5, 0.5]},
    "law": [{"kind": "TDC", "inertia": {"fraction": 0.08}, "natural_frequency": 15.0}],
    "estimator": {"kind": "Algebraic", "window": 0.01, "degree": 2},
    "reference": {"kind": "Multisine", "amplitude": [0.3, 0.25], "frequency": [1.0, 2.3], "offset": [0.0, 1.5]},
    "sensor": {"noise": 1e-6},
    "disturbance": [
        {"kind": "Payload", "mass": 1.0, "start_time": 0.5},
        {"kind": "StepDisturbance", "amplitude": [1.0, 2.0], "start_time": 0.3},
    ],
    "initial_torque": "rest",
    "duration": 1.0,
    "metrics_start": 0.2,
}
DRAWS = {
    "robot.masses.1": {"uniform": [0.8, 1.2]},
    "law.inertia.fraction": {"uniform": [0.05, 0.09]},
    "disturbance.0.mass": {"uniform": [0.0, 2.0]},
    "disturbance.1.amplitude.0": {"uniform": [0.0, 3.0]},
    "initial_position.0": {"uniform": [-0.2, -0.1]},
    "reference.offset.1": {"uniform": [1.4, 1.6]},
    "estimator.window": {"choice": [0.008, 0.012]},
}


@pytest.mark.slow
def test_all_engines_have_the_same_results():
    study = Study.parse({"scenario": SCENARIO, "runs": 20, "draws": DRAWS, "known": ["robot.masses.1"]})
    draws = study.draw()
    results = {
        name: build_engine(study, Integration("Runge–Kutta", 1), name).run(np.arange(20), draws.values, draws.seeds)
        for name in ("virtual machine", "compiled", "lanes")
    }
    reference = results["virtual machine"]
    for name in ("compiled", "lanes"):
        result = results[name]
        assert set(result.measures) == set(reference.measures)
        np.testing.assert_array_equal(result.completed, reference.completed)
        np.testing.assert_array_equal(result.end_time, reference.end_time)
        for key, applied in reference.applied.items():
            np.testing.assert_array_equal(result.applied[key], applied, err_msg=key)
        for measure, values in reference.measures.items():
            np.testing.assert_allclose(result.measures[measure], values, rtol=1e-9, atol=1e-15, err_msg=measure)
            np.testing.assert_array_equal(result.measures[measure], results["compiled"].measures[measure])
