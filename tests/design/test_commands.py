"""Designs for joints that take positions."""

import numpy as np
import pytest

import tarc
from tarc.analysis.workspace import Workspace
from tarc.design import design_controller, try_design
from tarc.plants import PositionServo, TwoLinkArm

ARM = TwoLinkArm(viscous=(0.5, 0.5))
WORKSPACE = Workspace.box([-0.5, -0.5], [0.5, 0.5], speed=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("kp", [[60.0, 60.0], [60.0, 25.0]])
def test_a_design_for_position_loops_is_certified_and_runs_as_predicted(kp):
    servo = PositionServo(ARM, kp, kd=4.0)
    design = design_controller(
        servo, workspace=WORKSPACE, sensor=tarc.signals.Encoder(bits=18), torque_limits=[3.0, 3.0], law="TDC"
    )
    assert design.certificates["robot"].verdict == "certified"
    assert design.plants[0] is servo
    assert np.all(design.law.torque_limits == 3.0)
    is_diagonal = np.count_nonzero(design.law.M - np.diag(np.diag(design.law.M))) == 0
    assert is_diagonal == (kp[0] != kp[1])
    # the derivative gain of the servo is friction, which may be there or not
    again = (
        tarc.certify_law(design.law, servo, WORKSPACE, samples=200).strengthened(servo, WORKSPACE, samples=200).verdict
    )
    assert again.verdict == "certified"
    assert again.margin == pytest.approx(design.certificates["robot"].margin, rel=0.1)
    trial = try_design(design, 2.0)
    assert trial.status.startswith("completed")
    assert np.all(trial.torque_noise < 1.5 * design.torque_noise)
