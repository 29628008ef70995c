"""Joints of a file without an actuator: simulated, not driven; or locked."""

from typing import Any

import mujoco
import numpy as np
import pytest

import tarc
from tarc.cli.options import names_or_positions, posture_of
from tarc.core.errors import InvalidParameter, RobotFileError, RobotFileWarning
from tarc.plants import MujocoPlant, RigidBody, load_robot

ROD = '<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.01" mass="0.3"/>'
CART = f"""<mujoco><worldbody><body name="cart">
  <joint name="rail" type="slide" axis="1 0 0" range="-2 2"/><geom type="box" size="0.1 0.1 0.05" mass="1"/>
  <body name="pole"><joint name="pivot" axis="0 1 0" damping="0.01"/>{ROD}</body></body></worldbody>
  <actuator><motor joint="rail" gear="2" ctrlrange="-10 10" ctrllimited="true"/></actuator>
  <keyframe><key name="home" qpos="0.1 0.4"/></keyframe></mujoco>"""
SCENARIO = """
name: cart
robot: {{file: {file}}}
law: {{kind: TDC, natural_frequency: 10.0, inertia: {{fraction: 0.1}}}}
estimator: {{kind: Algebraic, window: 0.010}}
reference: {{kind: Sinusoid, amplitude: 0.2, frequency: 2.0, offset: 0.1}}
period: 0.001
duration: 0.5
"""
passive = pytest.mark.filterwarnings("ignore::tarc.core.errors.RobotFileWarning")


@pytest.fixture
def cart(tmp_path):
    file = tmp_path / "cart.xml"
    file.write_text(CART)
    return file


def law(inertia):
    estimator = tarc.estimators.Algebraic(window=0.010)
    return tarc.laws.TDC(inertia=inertia, natural_frequency=10.0, period=1e-3, estimator=estimator)


def test_a_joint_without_an_actuator_is_passive_and_named(cart):
    message = (
        r"cart.xml: No actuator drives joint pivot: simulated as passive.*lock=\['pivot'\] in Python, --lock pivot of "
        r"tarc design, --set robot.lock=\[pivot\] for a scenario"
    )
    for joints, backend in ((None, "auto"), (["rail"], "auto"), (None, "mujoco")):
        with pytest.warns(RobotFileWarning, match=message):
            robot = load_robot(cart, joints=joints, backend=backend)
        assert robot.joint_names == ["rail"]
        assert robot.units == ["m"]
        assert robot.torque_limits.tolist() == [20.0]
        assert robot.position_limits.tolist() == [[-2.0, 2.0]]
        assert robot.coordinate_names == ["rail", "pivot"]
        assert robot.coordinate_units == ["m", "rad"]
        assert robot.passive_joints == ["pivot"]
        assert robot.home == pytest.approx([0.1])
        assert robot.coordinates([0.2]) == pytest.approx([0.2, 0.4])
        assert robot.locked == {}
    driven = load_robot(cart, joints=["rail", "pivot"])
    assert driven.is_fully_driven


@passive
def test_passive_joints_move_as_in_mujoco_stepped_bare(cart):
    robot = load_robot(cart, backend="mujoco")
    assert isinstance(robot, MujocoPlant)
    run = tarc.simulate(robot, law(0.1), tarc.signals.Sinusoid(amplitude=0.2, frequency=2.0, offset=0.1), 1.0)
    model = mujoco.MjModel.from_xml_path(str(cart))
    model.opt.timestep = 1e-3
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    positions = []
    for torque in run.data["torque"].values[:, 0]:
        positions.append(data.qpos.copy())
        data.ctrl[0] = torque / 2
        mujoco.mj_step(model, data)
    positions = np.array(positions)
    np.testing.assert_allclose(run.data["position"].values[:, 0], positions[:, 0], atol=1e-12)
    np.testing.assert_allclose(run.data["passive_position"].values[:, 0], positions[:, 1], atol=1e-12)
    assert np.ptp(positions[:, 1]) > 0.3


@passive
def test_both_backends_agree(cart):
    robot = load_robot(cart)
    assert isinstance(robot, RigidBody)
    q = np.array([0.3, 1.1])
    np.testing.assert_allclose(robot.inertia(q), robot.mujoco.inertia(q), atol=1e-14)
    np.testing.assert_allclose(robot.bias(q, [0.5, 2.0]), robot.mujoco.bias(q, [0.5, 2.0]), atol=1e-12)
    reference = tarc.signals.Sinusoid(amplitude=0.2, frequency=2.0, offset=0.1)
    runs = [tarc.simulate(robot, law(0.1), reference, 0.5)]
    runs.append(tarc.simulate(robot.mujoco, law(0.1), reference, 0.5, substeps=50))
    first, second = (run.data["passive_position"].values for run in runs)
    np.testing.assert_allclose(first, second, atol=1e-3)


def test_passive_joints_are_locked_on_request(cart):
    whole = load_robot(cart, joints=["rail", "pivot"])
    robot = load_robot(cart, lock=["pivot"])
    assert robot.is_fully_driven
    assert robot.locked == {"pivot": "as given"}
    assert robot.file_options["lock"] == ["pivot"]
    assert load_robot(cart, lock="pivot").file_options["lock"] == ["pivot"]
    assert robot.inertia([0.0]) == pytest.approx(whole.inertia([0.0, 0.4])[:1, :1])
    turned = load_robot(cart, lock={"pivot": 1.2})
    assert turned.file_options["lock"] == {"pivot": 1.2}
    assert turned.is_fully_driven


def test_a_locked_joint_is_where_the_lock_has_it(tmp_path):
    file = tmp_path / "arm.urdf"
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for i in range(3)
    )
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/><origin xyz="0.4 0 0"/>'
        '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="10" velocity="2"/></joint>'
        for i in (1, 2)
    )
    file.write_text(f'<robot name="arm">{links}{joints}</robot>')
    whole = load_robot(file)
    assert whole.is_fully_driven
    for lock, angle in ((["j2"], 0.0), ({"j2": 0.7}, 0.7)):
        robot = load_robot(file, lock=lock)
        assert robot.joint_names == ["j1"]
        assert robot.gravity_torque([0.3]) == pytest.approx(whole.gravity_torque([0.3, angle])[:1])
    with pytest.raises(InvalidParameter, match="lock: got 3 for joint j2 of arm.urdf; its range is -2 to 2"):
        load_robot(file, lock={"j2": 3.0})
    with pytest.raises(InvalidParameter, match="lock: arm.urdf has no joint 'j3'; it has j1, j2"):
        load_robot(file, lock=["j3"])
    with pytest.raises(InvalidParameter, match="lock: joint j2 of arm.urdf is listed in joints too"):
        load_robot(file, joints=["j1", "j2"], lock=["j2"])
    with pytest.raises(RobotFileError, match="mimic others or are locked"):
        load_robot(file, lock=["j1", "j2"])


def test_a_floating_base_is_fixed_with_a_note(tmp_path):
    file = tmp_path / "floating.xml"
    body = f'<body name="base" pos="0 0 1"><freejoint name="float"/>{ROD}'
    file.write_text(
        CART.replace('<body name="cart">', f'{body}<body name="cart">')
        .replace("</body></body>", "</body>" * 3)
        .replace("0.1 0.4", "0 0 2 1 0 0 0 0.1 0.4")
    )
    with pytest.warns(
        RobotFileWarning, match="What joint float would let float is fixed.*No actuator drives joint piv"
    ):
        robot = load_robot(file)
    assert robot.coordinate_names == ["rail", "pivot"]
    assert robot.locked == {"float": "free or a ball"}
    assert load_robot(file, lock=["float", "pivot"]).locked == {"float": "as given", "pivot": "as given"}
    with pytest.raises(InvalidParameter, match="lock: joint float of floating.xml is free or a ball, which a number"):
        load_robot(file, lock={"float": 0.0})
    file.write_text(
        file.read_text()
        .replace('<freejoint name="float"/>', '<joint type="ball" name="ball"/>')
        .replace("0 0 2 1 0 0 0 0.1 0.4", "1 0 0 0 0.1 0.4")
    )
    with pytest.raises(
        RobotFileError, match=r"joint 'ball' is a ball.*lock=\['ball'\], on the command line --lock ball"
    ):
        load_robot(file)
    assert load_robot(file, lock=["ball", "pivot"]).joint_names == ["rail"]


@passive
def test_the_payload_is_at_the_last_driven_body(tmp_path):
    file = tmp_path / "gripper.xml"
    file.write_text(CART.replace("</body></body>", f'</body><body name="flange" pos="0 0 0.1">{ROD}</body></body>'))
    assert load_robot(file).payload_place == "at link flange, the last one"


@passive
def test_a_scenario_with_a_passive_joint_runs_and_its_certificates_say_what_to_lock(cart, tmp_path):
    scenario = tmp_path / "cart.yaml"
    scenario.write_text(SCENARIO.format(file=cart))
    (run,) = tarc.Scenario.load(scenario).run().values()
    assert run.status.completed
    assert run.data["passive_joint"].values.tolist() == ["pivot"]
    locked = tarc.Scenario.load(scenario, ["robot.lock=[pivot]"])
    assert locked.build().plant.is_fully_driven
    (certification,) = locked.certify(samples=50).values()
    assumptions = certification.certificates["robot"].assumptions
    assert assumptions[-1] == "these joints are locked and do not move: pivot (as given)"
    message = r"no torque acts on the joint pivot of cart.xml.*--set robot.lock=\[pivot\] for a scenario"
    with pytest.raises(InvalidParameter, match=message):
        tarc.Scenario.load(scenario).certify()


def test_the_command_line_locks_by_name_or_at_positions():
    assert names_or_positions("--lock", "") is None
    assert names_or_positions("--lock", "pivot, rail") == ["pivot", "rail"]
    assert names_or_positions("--lock", "pivot=0.3,rail=0") == {"pivot": 0.3, "rail": 0.0}
    with pytest.raises(InvalidParameter, match="--lock: got 'pivot=0.3,rail'; needs names.*or a position for each"):
        names_or_positions("--lock", "pivot=0.3,rail")
    assert posture_of("--home", "pivot=0.3") == {"pivot": 0.3}
    assert posture_of("--home", "0.3,1") == [0.3, 1.0]
    assert posture_of("--home", "") is None


def test_joints_are_passive_on_request_in_any_file(tmp_path):
    text = CART.replace(CART[CART.index("<actuator>") : CART.index("<keyframe>")], "")
    file = tmp_path / "cart.xml"
    file.write_text(text)
    assert load_robot(file).is_fully_driven
    robot = load_robot(file, passive=["pivot"])
    assert robot.joint_names == ["rail"]
    assert robot.passive_joints == ["pivot"]
    assert robot.file_options["passive"] == ["pivot"]
    cases: Any = (
        ({"passive": ["pole"]}, "passive: cart.xml has no hinge or slide 'pole'"),
        ({"passive": ["pivot"], "lock": ["pivot"]}, "passive: joint pivot of cart.xml is in lock too"),
        ({"passive": ["pivot"], "joints": ["rail", "pivot"]}, "passive: joint pivot of cart.xml is listed in joints"),
    )
    for options, message in cases:
        with pytest.raises(InvalidParameter, match=message):
            load_robot(file, **options)
    mimic = '<equality><joint joint1="pivot" joint2="rail" polycoef="0 2 0 0 0"/></equality>'
    file.write_text(text.replace("<keyframe>", f"{mimic}<keyframe>").replace("0.1 0.4", "0.1 0.2"))
    assert load_robot(file).locked == {"pivot": "mimics rail"}
    follower = load_robot(file, passive=["pivot"])
    assert isinstance(follower, MujocoPlant)
    assert follower.coordinates([0.3]) == pytest.approx([0.3, 0.6])
    run = tarc.simulate(
        follower, law(0.1), tarc.signals.Sinusoid(amplitude=0.2, frequency=2.0, offset=0.1), 0.3, initial_torque="rest"
    )
    np.testing.assert_allclose(run.data["passive_position"].values, 2 * run.data["position"].values, atol=0.02)
