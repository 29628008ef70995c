"""What `tarc design` prints of the simulation of its own scenario."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from tarc.cli.tables.design import _print_trial
from tarc.design import StressRun
from tarc.plants import TwoLinkArm


def printed(**changes: Any) -> str:
    design: Any = SimpleNamespace(plants=(TwoLinkArm(),), torque_noise=np.array([0.1, 0.2]))
    values = {
        "value": np.nan,
        "stable": True,
        "status": "completed",
        "rms_error": 2e-3,
        "torque_noise": np.array([0.05, 0.16]),
        "saturation_share": 0.0,
        "torque_rate": np.array([300.0, 200.0]),
    }
    console = Console(width=300)
    with console.capture() as capture:
        _print_trial(console, design, StressRun(**{**values, **changes}), 1.5e-3)
    return capture.get()


def test_a_run_as_predicted():
    assert printed() == (
        "predicted RMS error for the motion of the file: 1.5 mrad\n"
        "tried in simulation: completed, RMS error 2 mrad, torque noise at most 0.8 of the predicted one\n"
        "torque rate reached: 300 N m/s, at joint1\n"
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"saturation_share": 0.144}, "this motion needs more than the torque limits in 14.40% of the samples"),
        ({"torque_noise": np.array([0.21, 0.1])}, "the torque noise of joint1 is above twice the predicted one"),
        ({"rms_error": 3.1e-3}, "the error is above twice the predicted one"),
        ({"rms_error": np.nan, "status": "diverged at 1 s"}, "diverged at 1 s, which is not as predicted"),
    ],
)
def test_what_is_not_as_predicted_is_said(changes, message):
    assert message in printed(**changes)
