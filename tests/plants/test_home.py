"""Home posture of a robot file, by joint, and joints that are locked in it."""

import mujoco
import numpy as np
import pytest

from tarc.core.errors import InvalidParameter, RobotFileError
from tarc.plants import MujocoPlant, load_robot
from tarc.scenario.schema import check_component

BALL = '<geom type="sphere" size="0.05" pos="0 0 -0.1" mass="0.5"/>'
LEG = f"""<mujoco><worldbody>
  <body name="trunk" pos="0 0 0.5"><freejoint name="base"/><geom type="box" size="0.1 0.1 0.05" mass="5"/>
    <body name="thigh"><joint name="hip" axis="0 1 0" range="-2 2"/>{BALL}
      <body name="shank" pos="0 0 -0.2"><joint name="knee" axis="0 1 0" range="-2.6 -0.5"/>{BALL}</body></body></body>
  </worldbody><compiler angle="radian" autolimits="true"/>
  <keyframe><key name="home" qpos="0 0 0.3 0.6 0.8 0 0 0.9 -1.8"/></keyframe></mujoco>"""

MIXED = """<mujoco><compiler angle="degree" eulerseq="zyx"/><option gravity="1 2 -9"/><worldbody>
  <frame pos="0.1 0.2 0.3" euler="20 0 10"><body name="b1" pos="0 0.1 0.2" euler="10 20 30">
    <inertial pos="0.1 0.02 0" mass="1" diaginertia="0.03 0.02 0.02"/>
    <frame euler="0 15 0" pos="0.05 0 0"><joint name="j1" axis="1 0.2 0" pos="0.1 0 0.03"/></frame>
    <joint name="j2" type="slide" axis="0 1 0.3" ref="0.1"/>
    <joint name="j3" axis="0 0.3 1" pos="0 0.2 0" ref="12"/>
    <joint name="j4" axis="1 1 1" pos="0.04 0 0.1"/>
    <body name="b2" pos="0.3 0 0" quat="0.9 0.1 0.2 0">
      <inertial pos="0 0.1 0" mass="2" diaginertia="0.03 0.02 0.02"/>
      <joint name="ball" type="ball" pos="0.02 0.03 0.04"/>
      <frame axisangle="0 1 0 30"><body name="b3" pos="0.2 0.1 0">
        <inertial pos="0.1 0 0" mass="1.5" diaginertia="0.03 0.02 0.02"/>
        <joint name="j5" axis="0 1 0" pos="0 0.1 0"/></body></frame></body></body></frame></worldbody>
  <keyframe><key name="home" qpos="0.3 0.25 -0.4 0.7 0.5 0.5 -0.5 0.5 0.6"/></keyframe></mujoco>"""
"""Angles in degrees, frames, four joints on one body, a ball, references."""


@pytest.fixture
def write(tmp_path):
    def save(text: str):
        file = tmp_path / "robot.xml"
        file.write_text(text)
        return file

    return save


def test_keyframe_counts_by_joint_beside_a_free_body(write):
    robot = MujocoPlant.from_file(write(LEG), joints=["knee", "hip"])
    assert robot.joint_names == ["hip", "knee"]
    assert robot.home == pytest.approx([0.9, -1.8])


def test_a_free_body_is_locked_where_the_keyframe_has_it(write):
    file = write(LEG)
    robot = MujocoPlant.from_file(file, joints=["hip", "knee"])
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(robot.gravity_torque(robot.home), data.qfrc_bias[6:], atol=1e-12)


@pytest.mark.parametrize("driven", [["j1"], ["j2"], ["j4"], ["j1", "j3"], ["j2", "j5"], ["j5"], ["j1", "j2", "j5"]])
def test_locked_joints_are_where_mujoco_has_them(driven, write):
    file = write(MIXED)
    robot = load_robot(file, joints=driven)
    model = mujoco.MjModel.from_xml_path(str(file))
    data, matrix = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    np.testing.assert_allclose(robot.home, [data.joint(name).qpos[0] for name in driven])
    for seed in range(3):
        q = np.random.default_rng(seed).uniform(-1, 1, len(driven))
        for name, value in zip(driven, q, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        rows = [int(model.joint(name).dofadr[0]) for name in driven]
        np.testing.assert_allclose(robot.inertia(q), matrix[np.ix_(rows, rows)], atol=1e-10)
        np.testing.assert_allclose(robot.gravity_torque(q), data.qfrc_bias[rows], atol=1e-10)


HINGES = f"""<mujoco><compiler angle="radian"/><worldbody>
  <body><joint name="a" axis="0 1 0" range="0 1"/>{BALL}
    <body pos="0 0 -0.3"><joint name="b" axis="0 1 0" range="0 0.8"/>{BALL}
      <body pos="0 0 -0.3"><joint name="c" axis="0 1 0" range="0.5 0.7"/>{BALL}</body></body></body>
  </worldbody></mujoco>"""


def test_without_keyframe_a_locked_joint_is_at_zero_or_in_the_middle_of_its_range(write):
    file = write(HINGES)
    whole = load_robot(file)
    assert whole.home == pytest.approx([0.5, 0.4, 0.6])
    robot = load_robot(file, joints=["a"])
    assert robot.home == pytest.approx([0.5])
    np.testing.assert_allclose(robot.gravity_torque([0.3]), whole.gravity_torque([0.3, 0.0, 0.6])[:1], atol=1e-12)


def test_home_is_given_in_the_order_of_the_listed_joints_or_by_name(write):
    file = write(HINGES)
    assert load_robot(file, home=[0.1, 0.2, 0.55]).home == pytest.approx([0.1, 0.2, 0.55])
    assert load_robot(file, joints=["b", "a"], home=[0.2, 0.1]).home == pytest.approx([0.1, 0.2])
    robot = load_robot(file, joints=["a"], home={"a": 0.3, "b": 0.7})
    assert robot.home == pytest.approx([0.3])
    assert robot.file_options["home"] == {"a": 0.3, "b": 0.7}
    expected = load_robot(file).gravity_torque([0.3, 0.7, 0.6])[:1]
    np.testing.assert_allclose(robot.gravity_torque([0.3]), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("home", "message"),
    [
        ([0.1, 0.2], "home: got shape"),
        ([0.1, 0.9, 0.6], "home: got 0.9 for joint b of robot.xml; its range is 0 to 0.8"),
        ({"d": 0.1}, "home: robot.xml has no hinge or slide 'd'; it has a, b, c"),
        ({"a": np.nan}, "home: joint a: got nan"),
        ({"a": "high"}, "home: joint a: got 'high'; needs one number"),
    ],
)
def test_impossible_home_postures(home, message, write):
    with pytest.raises(InvalidParameter, match=message):
        load_robot(write(HINGES), home=home)


def test_a_keyframe_of_another_robot_is_refused(write):
    text = HINGES.replace("</mujoco>", '<keyframe><key name="home" qpos="0 0"/></keyframe></mujoco>')
    with pytest.raises(RobotFileError, match="keyframe home has 2 positions; needs 3"):
        load_robot(write(text))


def test_a_scenario_gives_the_home_posture_by_name_or_in_order(write):
    file = str(write(HINGES))
    for home in ([0.1, 0.2, 0.6], {"a": 0.1, "b": 0.2}):
        robot = check_component("robot", {"file": file, "home": home}).build()
        assert robot.home == pytest.approx([0.1, 0.2, 0.6])
    with pytest.raises(InvalidParameter, match=r"robot\.home: got 2 for joint a"):
        check_component("robot", {"file": file, "home": {"a": 2.0}}).build()


WEAK = """<robot name="weak"><link name="base"/>{links}{joints}</robot>"""


def weak_arm(effort):
    """Return a URDF of two links that hang horizontally at zero."""
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0.3 0 0"/><mass value="2"/>'
        '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for i in (1, 2)
    )
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="{parent}"/><child link="l{i}"/><origin xyz="{x} 0 0"/>'
        f'<axis xyz="0 1 0"/><limit lower="-1.5" upper="3" effort="{effort}" velocity="2"/></joint>'
        for i, parent, x in ((1, "base", 0), (2, "l1", 0.6))
    )
    return WEAK.format(links=links, joints=joints)


def test_a_robot_without_a_home_starts_where_its_torque_limits_hold_it(tmp_path):
    file = tmp_path / "weak.urdf"
    file.write_text(weak_arm(100))
    assert load_robot(file).home.tolist() == [0.0, 0.0]
    file.write_text(weak_arm(8))
    robot = load_robot(file)
    assert np.any(np.abs(robot.gravity_torque(np.zeros(2))) > 8)
    assert np.all(np.abs(robot.gravity_torque(robot.home)) <= 0.8 * 8)
    assert np.all(robot.home > -1.5)
    assert np.all(robot.home < 3)
    np.testing.assert_array_equal(load_robot(file).home, robot.home)
    assert load_robot(file, home=[0.1, 0.2]).home.tolist() == [0.1, 0.2]


def test_a_robot_that_nothing_holds_starts_where_it_did(tmp_path):
    file = tmp_path / "weak.urdf"
    file.write_text(weak_arm(8).replace('lower="-1.5" upper="3"', 'lower="-0.2" upper="0.2"'))
    assert load_robot(file).home.tolist() == [0.0, 0.0]


def test_a_joint_that_mimics_is_locked_where_its_leader_puts_it(tmp_path):
    file = tmp_path / "weak.urdf"
    mimic = '<mimic joint="j1" multiplier="-0.5" offset="0.3"/></joint></robot>'
    file.write_text(weak_arm(100).replace("</joint></robot>", mimic))
    free = tmp_path / "free.urdf"
    free.write_text(weak_arm(100))
    whole = load_robot(free)
    for home, angle in ((None, 0.3), ({"j1": 0.8}, -0.1), ({"j1": 0.8, "j2": 0.7}, 0.7)):
        robot = load_robot(file, home=home)
        assert robot.locked == {"j2": "mimics j1"}
        expected = whole.gravity_torque([0.2, angle])[:1]
        assert robot.gravity_torque([0.2]) == pytest.approx(expected)
