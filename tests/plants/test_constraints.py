"""What couples joints beyond the tree of bodies: left to MuJoCo and refused in symbols by name, or without effect."""

import numpy as np
import pytest

from tarc.core.errors import RobotFileError, RobotFileWarning
from tarc.plants import MujocoPlant, load_robot

ROD = '<geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.01" mass="0.2"/>'
FIVE_BAR = f"""<mujoco><worldbody>
  <body name="left" pos="-0.1 0 0"><joint name="motor_left" axis="0 1 0"/>{ROD}<site name="near" pos="0 0 0.1"/>
    <body name="left_fore" pos="0 0 0.2"><joint name="elbow_left" axis="0 1 0"/>{ROD}<site name="tip" pos="0 0 0.2"/>
      <body name="plate"/></body></body>
  <body name="right" pos="0.1 0 0"><joint name="motor_right" axis="0 1 0"/>{ROD}
    <body name="right_fore" pos="0 0 0.2"><joint name="elbow_right" axis="0 1 0"/>{ROD}<site name="top"/></body></body>
  </worldbody>"""


@pytest.fixture
def read(tmp_path):
    def load(more: str, **options):
        file = tmp_path / "bars.xml"
        file.write_text(f"{FIVE_BAR}{more}</mujoco>")
        return load_robot(file, **options)

    return load


@pytest.mark.parametrize(
    ("constraint", "message"),
    [
        (
            '<connect name="hinge" body1="left_fore" body2="right_fore" anchor="0.1 0 0.2"/>',
            "bars.xml: it has the connect constraint 'hinge', which holds the bodies 'left_fore' and 'right_fore' "
            "together, which only MuJoCo simulates; use backend='mujoco'",
        ),
        (
            '<connect site1="tip" site2="top"/>',
            "connect constraint 'equality1', which holds the bodies 'left_fore' and 'right_fore'",
        ),
        ('<weld body1="left_fore"/>', "weld constraint 'equality1', which holds the bodies 'left_fore' and 'world'"),
        (
            '<weld body1="left" body2="plate"/>',
            "weld constraint 'equality1', which holds the bodies 'left' and 'plate'",
        ),
    ],
)
def test_closed_loops_are_left_to_mujoco(constraint, message, read):
    more = f"<equality>{constraint}</equality>"
    robot = read(more)
    assert isinstance(robot, MujocoPlant)
    assert robot.model.neq == 1
    with pytest.raises(RobotFileError, match=message):
        read(more, backend="symbolic")


@pytest.mark.parametrize(
    "constraint",
    [
        '<weld body1="left_fore" body2="plate"/>',
        '<connect body1="left_fore" body2="right_fore" anchor="0.1 0 0.2" active="false"/>',
    ],
)
def test_constraints_without_effect_go(constraint, read):
    expected = read("")
    robot = read(f"<equality>{constraint}</equality>")
    q = np.array([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(robot.inertia(q), expected.inertia(q))
    assert not robot.mujoco.model.neq


def test_a_loop_of_locked_joints_goes(read):
    weld = '<equality><weld body1="left" body2="left_fore"/></equality>'
    robot = read(weld, joints=["motor_left", "motor_right"])
    assert robot.joint_names == ["motor_left", "motor_right"]
    (constraint,) = read(weld, joints=["motor_left", "elbow_left"]).constraints
    assert constraint.endswith("holds the bodies 'left' and 'left_fore' together")


def test_a_joint_that_mimics_another_is_locked_and_not_driven(read):
    coupling = '<equality><joint joint1="elbow_right" joint2="elbow_left" polycoef="0 1 0 0 0"/></equality>'
    robot = read(coupling)
    assert robot.locked == {"elbow_right": "mimics elbow_left"}
    (constraint,) = read(coupling, joints=["elbow_right", "elbow_left"]).constraints
    assert constraint.endswith("determines the position of 'elbow_right' from that of 'elbow_left'")
    assert read(coupling.replace("joint1", 'active="false" joint1')).n_joints == 4


TENDON = '<tendon><fixed name="belt" {}><joint joint="elbow_left" coef="1"/></fixed></tendon>'
STRING = '<tendon><spatial name="string" {}><site site="{}"/><site site="top"/></spatial></tendon>'


@pytest.mark.parametrize(
    ("tendon", "message"),
    [
        (TENDON.format('stiffness="20"'), "the tendon 'belt', which has stiffness"),
        (TENDON.format('range="0 1"'), "the tendon 'belt', which has limits"),
        (TENDON.format('damping="1" frictionloss="2"'), "the tendon 'belt', which has damping and friction"),
        (STRING.format('stiffness="20"', "tip"), "the tendon 'string', which has stiffness"),
        (
            f'{TENDON.format("")}<equality><tendon name="hold" tendon1="belt"/></equality>',
            "the tendon constraint 'hold', which holds the tendon 'belt'",
        ),
    ],
)
def test_tendons_that_act_are_left_to_mujoco(tendon, message, read):
    assert read(tendon).model.ntendon == 1
    with pytest.raises(RobotFileError, match=message):
        read(tendon, backend="symbolic")


def test_tendons_without_effect_go(read):
    for tendon in (TENDON.format(""), STRING.format("", "near")):
        assert read(tendon).n_joints == 4
    assert read(TENDON.format('stiffness="20"'), joints=["motor_left"]).n_joints == 1
    assert read(STRING.format('stiffness="20"', "near"), joints=["elbow_left"]).n_joints == 1


CART = f"""<mujoco><worldbody><body name="cart"><joint name="rail" type="slide" axis="1 0 0" range="-2 2"/>{ROD}
  <body name="pole"><joint name="pivot" axis="0 1 0"/>{ROD}</body></body></worldbody>{{}}</mujoco>"""
MOTOR = '<actuator><motor joint="rail" ctrlrange="-20 20"/></actuator>'
BELT = '<tendon><fixed name="belt"><joint joint="{}" coef="1"/></fixed></tendon>'


@pytest.fixture
def read_cart(tmp_path):
    def load(more: str, **options):
        file = tmp_path / "cart.xml"
        file.write_text(CART.format(more))
        return load_robot(file, **options)

    return load


def test_a_tendon_s_actuator_is_not_a_joint_s(read_cart):
    more = f'{BELT.format("pivot")}<actuator><motor joint="rail"/><motor tendon="belt"/></actuator>'
    with pytest.warns(RobotFileWarning, match="A tendon drives joint pivot, and no law does: locked in the home"):
        robot = read_cart(more)
    assert robot.joint_names == ["rail"]
    assert robot.locked == {"pivot": "driven through the tendon belt"}
    assert read_cart(more, lock=["pivot"]).locked == {"pivot": "as given"}
    with pytest.raises(RobotFileError, match=r"no actuator of the file drives a hinge or slide.*it has rail, pivot"):
        read_cart(f'{BELT.format("pivot")}<actuator><motor tendon="belt"/></actuator>')


def test_a_file_without_actuators_of_joints_drives_all(read_cart):
    assert read_cart("").n_joints == 2
    assert read_cart('<actuator><adhesion body="pole" ctrlrange="0 1"/></actuator>').n_joints == 2


def test_a_joint_that_mimics_another_needs_no_actuator(read_cart):
    coupling = '<equality><joint joint1="pivot" joint2="rail"/></equality>'
    assert read_cart(MOTOR + coupling).joint_names == ["rail"]
