"""A robot by its own equations in a second process."""

import time
from pathlib import Path

import numpy as np
import pytest

import tarc
from live_robots import ARM_FILE
from tarc.core.errors import InvalidParameter
from tarc.plants.rigid_body import RigidBody
from tarc.runtime import PlantRobot, SafetyLimits, SimulatedClock, StartUp, run_live
from tarc.runtime.log import Log
from tarc.runtime.log_format import LogLayout
from tarc.runtime.peer import SILENCE
from tarc.runtime.sampled_plant import SampledPlant

ARM = tarc.plants.TwoLinkArm()
HOME = np.array([0.1, 1.2])
PERIOD = 2e-3
LAW = tarc.laws.TDC(
    inertia=0.1 * ARM.inertia(HOME),
    natural_frequency=12.0,
    period=PERIOD,
    estimator=tarc.estimators.Algebraic(window=0.020),
)
REFERENCE = tarc.signals.Sinusoid(amplitude=0.1, frequency=3.0, phase=np.pi / 2, offset=HOME)
QUICK = StartUp(hold_time=0.05, ramp_time=0.1, brake_time=0.02, stop_time=0.05)


@pytest.mark.parametrize("udp", [None, 0])
def test_it_moves_as_its_equations_do_and_its_brakes_hold(udp: int | None) -> None:
    logs: list[Log] = []
    with PlantRobot(ARM, PERIOD, position=HOME, in_step=True, udp=udp, priority=0) as robot:
        assert robot.applied_torque is not None
        np.testing.assert_allclose(robot.applied_torque, ARM.gravity_torque(HOME), rtol=1e-9)
        run_live(
            LAW,
            robot,
            REFERENCE,
            0.2,
            limits=SafetyLimits(error=0.2),
            start_up=QUICK,
            clock=SimulatedClock(),
            native=False,
            allow_unlimited_torque=True,
            joint_names=ARM.joint_names,
            on_log=logs.append,
        )
    rows = logs[0].ring.read()
    columns = {column.name: slice(column.start, column.start + column.size) for column in LogLayout.of(LAW).columns}
    position, torque = rows[:, columns["measured_position"]], rows[:, columns["torque"]]
    step = SampledPlant(ARM, PERIOD).function()
    state = np.concatenate([HOME, np.zeros(2)])
    first = round(QUICK.brake_time / PERIOD)  # the brakes are open from then on
    np.testing.assert_allclose(position[:first], np.tile(HOME, (first, 1)))
    for k in range(first, first + 150):
        np.testing.assert_allclose(position[k], state[:2], atol=1e-12)
        state = np.asarray(step(state, torque[k])[0]).ravel()


def test_a_loop_that_was_silent_while_it_prepared_finds_its_robot_again() -> None:
    with PlantRobot(ARM, PERIOD, position=HOME, udp=0, priority=0) as robot:
        time.sleep(1.2 * SILENCE)
        end = time.monotonic() + 120
        while np.all(np.isfinite(robot.read())):  # what was on its way
            assert time.monotonic() < end
        while not np.all(np.isfinite(position := robot.read())):
            assert time.monotonic() < end
            time.sleep(PERIOD)
        np.testing.assert_allclose(position, HOME)


def test_a_robot_without_equations_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(ARM_FILE)
    arm = tarc.plants.load_robot(file)
    assert isinstance(arm, RigidBody)
    with pytest.raises(InvalidParameter, match="needs a robot in symbols"):
        PlantRobot(arm.mujoco, PERIOD)
