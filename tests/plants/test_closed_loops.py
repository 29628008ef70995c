"""Closed loops and tendons: simulated as MuJoCo steps the file itself, refused by what needs a tree."""

import mujoco
import numpy as np
import pytest

import tarc
from tarc.analysis.workspace import Workspace
from tarc.core.errors import InvalidParameter, RobotFileError
from tarc.plants import MujocoPlant, load_robot

pytestmark = pytest.mark.filterwarnings("ignore::tarc.core.errors.RobotFileWarning")


def rod(length):
    return f'<geom type="capsule" fromto="0 0 0 {length} 0 0" size="0.01" mass="{length}"/>'


FOUR_BAR = f"""<mujoco><option><flag contact="disable"/></option><worldbody>
  <body name="crank" euler="0 -90 0"><joint name="crank" axis="0 1 0" damping="0.1"/>{rod(0.2)}
    <body name="coupler" pos="0.2 0 0" euler="0 90 0"><joint name="coupling" axis="0 1 0" damping="0.02"/>{rod(0.5)}
    </body></body>
  <body name="rocker" pos="0.5 0 0" euler="0 -90 0"><joint name="rocker" axis="0 1 0" damping="0.02"/>{rod(0.2)}
    <site name="tip" pos="0.2 0 0"/></body></worldbody>
  <equality><connect name="pin" body1="coupler" body2="rocker" anchor="0.5 0 0"/></equality>
  <actuator><motor joint="crank" ctrlrange="-20 20"/></actuator></mujoco>"""

FINGER = f"""<mujoco><option><flag contact="disable"/></option><worldbody>
  <body name="near"><joint name="near" axis="0 1 0" damping="0.05" armature="0.01"/>{rod(0.1)}
    <body name="far" pos="0.1 0 0"><joint name="far" axis="0 1 0" damping="0.02" armature="0.01"/>{rod(0.08)}</body>
  </body></worldbody>
  <tendon><fixed name="cord" {{}}><joint joint="near" coef="0.01"/><joint joint="far" coef="-0.012"/></fixed></tendon>
  {{}}<actuator><motor joint="near" ctrlrange="-5 5"/></actuator></mujoco>"""


@pytest.fixture
def write(tmp_path):
    def save(text):
        file = tmp_path / "robot.xml"
        file.write_text(text)
        return file

    return save


def law(inertia):
    estimator = tarc.estimators.Algebraic(window=0.010)
    return tarc.laws.TDC(inertia=inertia, natural_frequency=10.0, period=1e-3, estimator=estimator)


def stepped_bare(file, start, torques):
    """Positions of the file's own model under the torques of its only motor."""
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.timestep = 1e-3
    data = mujoco.MjData(model)
    data.qpos[:] = start
    positions = []
    for torque in torques:
        positions.append(data.qpos.copy())
        data.ctrl[0] = torque
        mujoco.mj_step(model, data)
    return np.array(positions)


def as_simulated(run):
    return np.hstack([run.data["position"].values, run.data["passive_position"].values])


@pytest.mark.parametrize("start", [0.0, 0.5])
def test_a_four_bar_moves_as_mujoco_steps_the_file(write, start):
    file = write(FOUR_BAR)
    robot = load_robot(file)
    assert isinstance(robot, MujocoPlant)
    assert robot.joint_names == ["crank"]
    assert robot.passive_joints == ["coupling", "rocker"]
    reference = tarc.signals.Sinusoid(amplitude=0.4, frequency=3.0, offset=start)
    run = tarc.simulate(robot, law(0.003), reference, 0.5)
    assert run.status.completed
    positions = as_simulated(run)
    bare = stepped_bare(file, positions[0], run.data["torque"].values[:, 0])
    np.testing.assert_allclose(positions, bare, atol=1e-9)
    assert np.ptp(positions[:, 0]) > 0.2
    np.testing.assert_allclose(positions[:, 2], positions[:, 0], atol=5e-3)  # a parallelogram, with MuJoCo's soft pin


def test_a_four_bar_starts_assembled_and_knows_its_inertia(write):
    robot = load_robot(write(FOUR_BAR))
    assert robot.coordinates([0.5]) == pytest.approx([0.5, -0.5, 0.5], abs=1e-8)
    uniform = 0.2**3 / 3
    capsule = robot.inertia(robot.coordinates([0.0]))[2, 2]
    assert capsule == pytest.approx(uniform, rel=0.05)
    expected = 2 * capsule + 0.5 * 0.2**2  # crank and rocker turn, the coupler of 0.5 kg only shifts
    for angle in (0.0, 0.5):
        assert robot.joint_inertia([angle]) == pytest.approx(expected, rel=1e-6)
    weight = 9.81 * (0.2 * 0.1 * 2 + 0.5 * 0.2) * np.cos(np.pi / 2 + 0.5)
    assert robot.holding_torque(robot.coordinates([0.5])) == pytest.approx(weight, rel=1e-6)
    with pytest.raises(InvalidParameter, match="give the inertia of the law as numbers, or drive fewer joints"):
        load_robot(write(FOUR_BAR), joints=["crank", "rocker"]).joint_inertia([0.0, 0.0])


@pytest.mark.parametrize(
    ("tendon", "equality", "name"),
    [
        ('stiffness="500" damping="1"', "", "the tendon 'cord', which has stiffness and damping"),
        ('range="-0.001 0.001"', "", "the tendon 'cord', which has limits"),
        ("", '<equality><tendon name="hold" tendon1="cord"/></equality>', "the tendon constraint 'hold', which holds"),
    ],
)
def test_a_finger_with_a_tendon_moves_as_mujoco_steps_the_file(write, tendon, equality, name):
    file = write(FINGER.format(tendon, equality))
    robot = load_robot(file)
    assert robot.passive_joints == ["far"]
    run = tarc.simulate(robot, law(0.002), tarc.signals.Sinusoid(amplitude=0.4, frequency=4.0), 0.5)
    positions = as_simulated(run)
    bare = stepped_bare(file, positions[0], run.data["torque"].values[:, 0])
    np.testing.assert_allclose(positions, bare, atol=1e-9)
    assert np.ptp(positions[:, 1]) > 0.1
    with pytest.raises(RobotFileError, match=f"it has {name}.*which only MuJoCo simulates; use backend='mujoco'"):
        load_robot(file, backend="symbolic")
    with pytest.raises(
        InvalidParameter, match=f"a certificate needs joints that move independently.*{name}.*Simulate it only"
    ):
        tarc.certify_law(law(0.01), robot, Workspace.box([-0.5], [0.5]))


def test_driven_joints_that_constraints_couple_are_simulated_and_not_certified(write):
    equality = '<equality><joint name="gear" joint1="far" joint2="near" polycoef="0 0.8 0 0 0"/></equality>'
    file = write(FINGER.format("", equality))
    assert load_robot(file).locked == {"far": "mimics near"}
    robot = load_robot(file, joints=["near", "far"])
    assert robot.is_fully_driven
    assert robot.constraints == [
        "the joint constraint 'gear', which determines the position of 'far' from that of 'near'"
    ]
    with pytest.raises(
        InvalidParameter, match="a design needs joints that move independently, and robot.xml has the jo"
    ):
        tarc.design.design_controller(robot)
    tdc = law([0.002, 0.002])
    reference = tarc.signals.Sinusoid(amplitude=[0.3, 0.24], frequency=4.0)
    run = tarc.simulate(robot, tdc, reference, 0.3)
    np.testing.assert_allclose(run.data["position"][:, 1], 0.8 * run.data["position"][:, 0], atol=2e-3)


GRIPPER = f"""<mujoco><compiler angle="radian"/><option><flag contact="disable"/></option><worldbody>
  <body name="arm"><joint name="arm" axis="0 1 0" range="-1 1" armature="0.1"/>{rod(0.4)}
    <body name="hand" pos="0.4 0 0">
      <body name="crank" euler="0 -1.5708 0"><joint name="crank" axis="0 1 0"/>{rod(0.05)}
        <body name="coupler" pos="0.05 0 0" euler="0 1.5708 0"><joint name="coupler" axis="0 1 0"/>{rod(0.1)}</body>
      </body>
      <body name="rocker" pos="0.1 0 0" euler="0 -1.5708 0"><joint name="rocker" axis="0 1 0"/>{rod(0.05)}</body>
      <body name="left" pos="0 0.03 0"><joint name="left" type="slide" axis="0 1 0"/>{rod(0.03)}</body>
      <body name="right" pos="0 -0.03 0"><joint name="right" type="slide" axis="0 -1 0"/>{rod(0.03)}</body>
    </body></body></worldbody>
  <tendon><fixed name="split"><joint joint="left" coef="0.5"/><joint joint="right" coef="0.5"/></fixed>
    <fixed name="pull"><joint joint="crank" coef="1"/></fixed></tendon>
  <equality><joint joint1="right" joint2="left"/><connect body1="coupler" body2="rocker" anchor="0.1 0 0"/></equality>
  <actuator><general joint="arm" gainprm="4500" biastype="affine" biasprm="0 -4500 -450" ctrlrange="-1 1"/>
    <general tendon="split" gainprm="0.016" biastype="affine" biasprm="0 -100 -10"/>
    <position tendon="pull" kp="1"/></actuator></mujoco>"""
"""An arm that takes positions, with fingers on a tendon and a linkage whose crank another tendon drives."""


def test_a_gripper_s_linkage_is_simulated_or_locked_as_the_message_says(write):
    file = write(GRIPPER)
    robot = load_robot(file)
    assert isinstance(robot, MujocoPlant)
    assert robot.joint_names == ["arm"]
    assert robot.torque_units == ["rad"]
    assert robot.passive_joints == ["coupler", "rocker"]
    assert robot.locked == {
        "crank": "driven through the tendon pull",
        "left": "driven through the tendon split",
        "right": "mimics left",
    }
    with pytest.raises(InvalidParameter, match=r"the connect constraint.*lock=\['coupler', 'rocker'\] in Python"):
        tarc.certify_law(law(1e-5), robot, Workspace.box([-0.5], [0.5]))
    rigid = load_robot(file, lock=["coupler", "rocker"])
    assert rigid.constraints == []
    assert not isinstance(rigid, MujocoPlant)
    assert rigid.is_fully_driven


def test_a_start_where_constraints_cannot_hold_is_refused(write):
    short = FOUR_BAR.replace(rod(0.5), rod(0.3)).replace('anchor="0.5 0 0"', 'anchor="0.5 0 0.0"')
    robot = load_robot(write(short.replace('pos="0.5 0 0" euler', 'pos="0.62 0 0.2" euler')))
    with pytest.raises(InvalidParameter, match=r"with the driven joints of robot.xml at \(-2\.5\) its constraints are"):
        robot.coordinates([-2.5])


@pytest.mark.parametrize("kind", ["connect", "weld"])
def test_bodies_stay_held_where_the_file_holds_them_when_a_joint_between_is_locked(write, kind):
    """The arm's base is locked away from zero, and the constraint is that of the file's zero."""
    equality = {
        "connect": '<connect body1="hand" body2="door" anchor="0.1 0 0"/>',
        "weld": '<weld body1="hand" body2="door"/>',
    }[kind]
    text = f"""<mujoco><worldbody><body name="base" pos="0 0 0.1"><joint name="turn" axis="0 0 1"/>{rod(0.3)}
      <body name="arm" pos="0.3 0 0"><joint name="lift" axis="0 1 0"/>{rod(0.3)}
        <body name="hand" pos="0.3 0 0"><joint name="wrist" axis="0 0 1"/>{rod(0.1)}</body></body></body>
      <body name="door" pos="0.7 0.1 0.1"><joint name="x" type="slide" axis="1 0 0"/>{rod(0.2)}</body></worldbody>
      <equality>{equality}</equality></mujoco>"""
    file = write(text)
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, 0.2, -0.4, 0.1]
    mujoco.mj_forward(model, data)
    expected = data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    robot = MujocoPlant.from_file(file, lock={"turn": 0.3}, joints=["lift", "wrist", "x"])
    data = mujoco.MjData(robot.model)
    data.qpos[:] = [0.2, -0.4, 0.1]
    mujoco.mj_forward(robot.model, data)
    found = data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_joint_whose_leader_is_locked_is_held_where_the_leader_puts_it(write):
    equality = '<equality><joint joint1="far" joint2="near" polycoef="0.1 0.8 0 0 0"/></equality>'
    text = FINGER.format("", equality).replace('joint="near" ctrlrange', 'joint="far" ctrlrange')
    robot = MujocoPlant.from_file(write(text), joints=["far"], lock={"near": 0.5})
    data = mujoco.MjData(robot.model)
    data.qpos[:] = 0.1 + 0.8 * 0.5
    mujoco.mj_forward(robot.model, data)
    assert data.efc_pos[0] == pytest.approx(0.0, abs=1e-12)


THREE = f"""<mujoco><option><flag contact="disable"/></option><worldbody>
  <body name="a"><joint name="a" axis="0 1 0" armature="0.01" springref="20"/>{rod(0.1)}
    <body name="b" pos="0.1 0 0"><joint name="b" axis="0 1 0" armature="0.01" ref="10" springref="-15"/>{rod(0.1)}
      <body name="c" pos="0.1 0 0"><joint name="c" axis="0 1 0" armature="0.01"/>{rod(0.08)}
        <site name="tip" pos="0 0 0.05"/></body></body></body><site name="post" pos="0 0 0.3"/></worldbody>
  <tendon>
    <fixed name="t" {{}}><joint joint="a" coef="1"/><joint joint="b" coef="-0.7"/></fixed>
    <fixed name="u"><joint joint="c" coef="0.5"/><joint joint="b" coef="0.2"/></fixed>
    <fixed name="w"><joint joint="b" coef="2"/></fixed>
    <spatial name="rope" {{}}><site site="post"/><site site="tip"/></spatial>
  </tendon>{{}}</mujoco>"""
STATE = {"a": 0.3, "b": -0.4, "c": 0.5}


@pytest.mark.parametrize(
    ("fixed", "rope", "equality"),
    [
        ('stiffness="5"', "", ""),
        ('stiffness="5" springlength="0.1 0.2" damping="0.3"', "", ""),
        ('range="-0.1 0.2" armature="0.02"', "", ""),
        ('frictionloss="0.2"', "", ""),
        ("", 'stiffness="9" springlength="0.1"', ""),
        ("", 'range="0 0.1"', ""),
        ("", "", '<tendon tendon1="t" polycoef="0.1 1 0 0 0"/>'),
        ("", "", '<tendon tendon1="t" tendon2="u" polycoef="0.1 0.8 0.5 -0.3 0.2"/>'),
        ("", "", '<tendon tendon1="t" tendon2="w" polycoef="0.1 0.8 0.5 0 0"/>'),
        ("", "", '<tendon tendon1="w" tendon2="t" polycoef="0.1 0.8 0 0 0"/>'),
    ],
)
def test_a_tendon_keeps_its_force_where_some_of_its_joints_are_locked(write, fixed, rope, equality):
    """Against the file itself: forces of springs and dampers, and errors of limits and constraints."""
    file = write(THREE.format(fixed, rope, f"<equality>{equality}</equality>"))
    model = mujoco.MjModel.from_xml_path(str(file))
    robot = MujocoPlant.from_file(file, joints=["a", "c"], lock={"b": STATE["b"]})
    assert robot.constraints
    assert robot.joint_names == ["a", "c"]
    results = []
    for each, names in ((model, "abc"), (robot.model, "ac")):
        data = mujoco.MjData(each)
        data.qpos[:] = [STATE[name] for name in names]
        data.qvel[:] = [0.7 * (name == "a") - 0.4 * (name == "c") for name in names]
        mujoco.mj_forward(each, data)
        is_moving = [name != "b" for name in names]
        rows = data.efc_J.reshape(data.nefc, each.nv)[:, is_moving]
        results.append((data.qfrc_passive[is_moving], rows, data.efc_pos.copy()))
    (force, rows, errors), (our_force, our_rows, our_errors) = results
    scale = rows[0, 0] / our_rows[0, 0] if equality.startswith('<tendon tendon1="w"') else 1.0
    np.testing.assert_allclose(our_force, force, atol=1e-12)
    np.testing.assert_allclose(our_rows * scale, rows, atol=1e-12)
    np.testing.assert_allclose(our_errors * scale, errors, atol=1e-12)
    assert np.any(force) or len(errors)


def test_tendons_that_depend_on_the_file_s_own_posture_are_refused(write):
    for rope, equality, reason in (
        ('stiffness="9"', "", "its spring has no springlength"),
        ("", '<equality><tendon tendon1="rope"/></equality>', "an equality constraint holds it"),
    ):
        with pytest.raises(RobotFileError, match=f"'rope' goes through space, and {reason}.*but b would be locked"):
            load_robot(write(THREE.format("", rope, equality)), joints=["a", "c"])
    bent = '<equality><tendon name="hold" tendon1="w" tendon2="t" polycoef="0 1 1 0 0"/></equality>'
    with pytest.raises(RobotFileError, match="'hold' holds the tendon 'w', all of whose joints are locked, by a func"):
        load_robot(write(THREE.format("", "", bent)), joints=["a", "c"])
