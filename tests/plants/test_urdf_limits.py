"""Limits of a URDF that stand for none: taken as unknown, with a warning that names the joints."""

import subprocess
import sys

import numpy as np
import pytest

from tarc.core.errors import RobotFileWarning
from tarc.design.robot_facts import velocity_limits
from tarc.plants import load_robot, shipped_robots
from urdf_text import arm, joint, link, robot


def limits(shoulder: str, elbow: str) -> str:
    shoulder, elbow = (f"<limit {text}/>" for text in (shoulder, elbow))
    return arm(
        shoulder=joint("shoulder", "base", "upper", inside=shoulder),
        elbow=joint("elbow", "upper", "fore", inside=elbow),
    )


GOOD = 'lower="-2" upper="2" effort="80" velocity="3"'
ZERO = 'lower="0" upper="0" effort="0" velocity="0"'


@pytest.fixture
def read(tmp_path):
    def load(text: str, **options):
        file = tmp_path / "arm.urdf"
        file.write_text(text)
        return load_robot(file, **options)

    return load


def test_zero_limits_are_unknown_in_one_warning(read):
    message = (
        "arm.urdf: these limits are taken as unknown: range 0 to 0 of shoulder, elbow; effort 0 of shoulder, elbow; "
        "velocity 0 of shoulder, elbow. Correct the <limit> of these joints, or give a design joint_range "
        r"\(--joint-range\), torque_limits \(--torque-limits\), speed \(--speed\)"
    )
    with pytest.warns(RobotFileWarning, match=message) as caught:
        plant = read(limits(ZERO, ZERO))
    assert len(caught) == 1
    assert np.all(np.isinf(plant.velocity_limits))
    assert np.all(np.isinf(plant.position_limits))
    assert np.all(np.isinf(plant.torque_limits))
    assert plant.home == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("velocity", ["1000", "inf", "100.5", "-1", "nan"])
def test_velocity_limits_that_no_robot_has_are_unknown(velocity, read):
    with pytest.warns(
        RobotFileWarning, match=rf"unknown: velocity {velocity} rad/s \(not within 0 and 100\) of elbow\."
    ):
        plant = read(limits(GOOD, GOOD.replace('velocity="3"', f'velocity="{velocity}"')))
    assert plant.velocity_limits.tolist() == [3.0, np.inf]
    assert velocity_limits(plant) is None


def test_a_fast_slide_is_in_metres(read):
    slide = joint("rail", "base", "cart", "prismatic", '<limit lower="-1" upper="1" effort="9" velocity="1e4"/>')
    with pytest.warns(RobotFileWarning, match="velocity 10000 m/s"):
        read(robot(link("base"), link("cart"), slide))


@pytest.mark.filterwarnings("error")
def test_limits_that_say_something_give_no_warning(read):
    plant = read(limits(GOOD, 'lower="0" upper="2" effort="80" velocity="100"'))
    assert plant.velocity_limits.tolist() == [3.0, 100.0]
    read(limits(GOOD, 'lower="-2" upper="0"'))
    assert read(limits(GOOD, ZERO), joints=["shoulder"]).n_joints == 1
    text = (
        limits(GOOD, GOOD).replace('type="revolute"', 'type="continuous"').replace('"-2"', '"0"').replace('"2"', '"0"')
    )
    read(text)
    for name in shipped_robots():
        load_robot(name)


def test_the_command_line_warns_on_one_line_and_goes_on(tmp_path):
    (tmp_path / "arm.urdf").write_text(limits(GOOD, GOOD.replace('effort="80"', 'effort="0"')))
    code = "from tarc.cli.main import main; main()"
    command = [sys.executable, "-c", code, "design", "arm.urdf", "--noise-budget", "2"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    warning, error = done.stderr.splitlines()
    assert warning.startswith("warning: arm.urdf: these limits are taken as unknown: effort 0 of elbow.")
    assert error.startswith("error: noise_budget")
    assert not done.stdout
