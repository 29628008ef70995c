"""Actuators of an MJCF: the command of the law is the control input of the file."""

import mujoco
import numpy as np
import pytest

import tarc
from tarc.analysis.workspace import Workspace
from tarc.core.errors import InvalidParameter, RobotFileError, RobotFileWarning
from tarc.plants import MujocoPlant, PositionServo, RigidBody, ServoedPlant, load_robot

ARM = """<mujoco><compiler angle="radian"/><option><flag contact="disable"/></option><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.5" armature="0.05"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="1"/>
    <body name="fore" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0" range="-2.5 2.5" damping="0.2" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body></body></worldbody>
  <actuator>{}</actuator></mujoco>"""
POSITIONS = """<position name="s" joint="shoulder" kp="200" kv="8" ctrlrange="-1.8 1.5" forcerange="-30 30"/>
  <position name="e" joint="elbow" kp="50" kv="2" gear="2"/>"""


@pytest.fixture
def read(tmp_path):
    def load(text, **options):
        file = tmp_path / "arm.xml"
        file.write_text(ARM.format(text))
        return load_robot(file, **options)

    return load


def law(inertia):
    estimator = tarc.estimators.Algebraic(window=0.010)
    return tarc.laws.TDC(inertia=inertia, natural_frequency=8.0, period=1e-3, estimator=estimator)


def stepped_bare(actuators, start, controls, steps=1, disturbance=0.0):
    """Positions of the file's own model under its own control inputs."""
    model = mujoco.MjModel.from_xml_string(ARM.format(actuators))
    model.opt.timestep = 1e-3 / steps
    data = mujoco.MjData(model)
    data.qpos[:] = start
    positions = []
    for control in controls:
        positions.append(data.qpos.copy())
        data.ctrl[: len(control)] = control
        data.qfrc_applied[0] = disturbance
        mujoco.mj_step(model, data, steps)
    return np.array(positions)


def test_position_actuators_make_the_command_a_position(read):
    robot = read(POSITIONS)
    assert isinstance(robot, ServoedPlant)
    assert isinstance(robot.plant, RigidBody)
    assert robot.torque_units == ["rad", "rad"]
    servo = robot.servo
    assert servo.kinds == ("position", "position")
    assert servo.gain.tolist() == [200.0, 200.0]
    assert servo.stiffness.tolist() == [200.0, 200.0]
    assert servo.damping.tolist() == [8.0, 8.0]
    assert servo.torque_limits.tolist() == [30.0, np.inf]
    assert robot.torque_limits[0] == 1.8
    assert robot.torque_limits[1] == np.inf
    by_hand = PositionServo(read(POSITIONS, actuators="torque"), 200.0, 8.0)
    q, v = np.array([0.3, -0.5]), np.array([1.0, 2.0])
    np.testing.assert_allclose(robot.inertia(q), by_hand.inertia(q))
    np.testing.assert_allclose(robot.bias(q, v), by_hand.bias(q, v))
    in_mujoco = read(POSITIONS, backend="mujoco")
    np.testing.assert_allclose(robot.inertia(q), in_mujoco.inertia(q), rtol=1e-12)
    np.testing.assert_allclose(robot.bias(q, v), in_mujoco.bias(q, v), rtol=1e-12)
    np.testing.assert_allclose(robot.gravity_torque(q), in_mujoco.gravity_torque(q), rtol=1e-12)
    for ours, theirs in zip(robot.linearised(q, v, v), in_mujoco.linearised(q, v, v), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-8)
    assert in_mujoco.torque_units == ["rad", "rad"]


@pytest.mark.parametrize(
    ("actuators", "scale"),
    [
        (POSITIONS, [1.0, 2.0]),
        ('<velocity joint="shoulder" kv="20"/><velocity joint="elbow" kv="5" gear="3"/>', [1.0, 3.0]),
        (
            '<general joint="shoulder" gainprm="400" biastype="affine" biasprm="0 -200 -8"/>'
            '<position joint="elbow" kp="100"/><velocity name="damper" joint="elbow" kv="3"/>',
            [0.5, 1.0],
        ),
        (
            '<position joint="shoulder" kp="200" dampratio="1" inheritrange="0.9"/><position joint="elbow" kp="100"/>',
            [1.0, 1.0],
        ),
    ],
)
@pytest.mark.parametrize("drive", [None, tarc.signals.Drive()])
def test_runs_in_mujoco_are_those_of_the_file_s_own_actuators(read, actuators, scale, drive):
    robot = read(actuators, backend="mujoco")
    assert isinstance(robot, MujocoPlant)
    inertia = 0.1 * np.diag(robot.inertia(np.zeros(2)))
    reference = tarc.signals.Sinusoid(amplitude=[0.3, 0.4], frequency=3.0)
    run = tarc.simulate(
        robot, law(inertia), reference, 0.3, disturbance=tarc.signals.StepDisturbance(amplitude=[1.0, 0.0]), drive=drive
    )
    commands = run.data["torque"].values
    positions = run.data["position"].values
    bare = stepped_bare(actuators, positions[0], commands * scale, disturbance=1.0)
    np.testing.assert_allclose(positions, bare, atol=1e-9)
    assert np.ptp(positions[:, 0]) > 0.1


def test_symbolic_runs_tend_to_those_of_the_file_s_own_actuators(read):
    robot = read(POSITIONS)
    inertia = 0.1 * np.diag(robot.inertia(np.zeros(2)))
    run = tarc.simulate(robot, law(inertia), tarc.signals.Sinusoid(amplitude=[0.3, 0.4], frequency=3.0), 0.3)
    bare = stepped_bare(POSITIONS, run.data["position"].values[0], run.data["torque"].values * [1.0, 2.0], steps=100)
    np.testing.assert_allclose(run.data["position"].values, bare, atol=2e-4)


def test_commands_beyond_the_file_s_range_and_torques_beyond_its_limits_are_clipped(read):
    robot = read(POSITIONS)
    still, none = np.zeros(2), np.zeros(2)
    for command, torque in (([3.0, 0.0], 30.0), ([0.1, 0.0], 20.0), ([-5.0, 0.0], -30.0)):
        found = robot.evaluate("acceleration", still, still, robot.joint_input(np.array(command), none))
        expected = robot.plant.evaluate("acceleration", still, still, np.array([torque, 0.0]))
        np.testing.assert_allclose(found, expected)


def test_motors_with_gear_have_limits_at_the_joint(read):
    robot = read(
        '<motor joint="shoulder" gear="50" ctrlrange="-0.5 0.5"/><motor joint="elbow" ctrlrange="-9 9" '
        'forcerange="-4 4" gear="2"/>'
    )
    assert isinstance(robot, RigidBody)
    assert robot.torque_limits.tolist() == [25.0, 8.0]


def test_motors_and_positions_mix(read):
    actuators = '<motor joint="shoulder" gear="10" ctrlrange="-3 3"/><position joint="elbow" kp="60" kv="3"/>'
    robot = read(actuators)
    assert robot.torque_units == ["N m", "rad"]
    assert robot.torque_limits[0] == 30.0
    run = tarc.simulate(
        read(actuators, backend="mujoco"),
        law([0.02, 1e-4]),
        tarc.signals.Sinusoid(amplitude=[0.3, 0.4], frequency=3.0),
        0.2,
    )
    bare = stepped_bare(actuators, run.data["position"].values[0], run.data["torque"].values * [0.1, 1.0])
    np.testing.assert_allclose(run.data["position"].values, bare, atol=1e-9)
    assert run.data["torque"].attrs["units"] == "N m or rad"


def test_torques_on_request(read):
    robot = read(POSITIONS, actuators="torque")
    assert isinstance(robot, RigidBody)
    assert robot.torque_limits.tolist() == [30.0, np.inf]
    assert robot.file_options["actuators"] == "torque"
    with pytest.raises(InvalidParameter, match="actuators: got 'motor'"):
        read(POSITIONS, actuators="motor")


def test_position_loops_are_added_to_a_file_by_their_gains(read):
    robot = load_robot("ur5e", armature=0.1, kp=2000.0, kd=100.0)
    assert isinstance(robot, PositionServo)
    assert robot.file_options == {"file": "ur5e", "armature": 0.1, "kp": 2000.0, "kd": 100.0}
    with pytest.raises(InvalidParameter, match="kd: got 3.0 without kp"):
        load_robot("ur5e", kd=3.0)
    with pytest.raises(InvalidParameter, match="kp: ur5e.xml is simulated by MuJoCo"):
        load_robot("ur5e", kp=3.0, backend="mujoco")
    with pytest.raises(InvalidParameter, match="kp"):
        read(POSITIONS, kp=[1.0, 2.0, 3.0])


def test_what_a_law_cannot_command_is_refused_or_named(read):
    two = '<position name="a" joint="shoulder" kp="1"/><position name="b" joint="shoulder" kp="2"/>'
    with pytest.raises(RobotFileError, match="a and b both command the position of joint shoulder. actuators='torque'"):
        read(two, lock=["elbow"])
    with pytest.raises(RobotFileError, match="'i' of joint 'shoulder' is none of torque, position or velocity"):
        read('<intvelocity name="i" joint="shoulder" kp="4" actrange="-1 1"/>', lock=["elbow"])
    slow = '<position name="slow" joint="shoulder" kp="9" timeconst="0.1"/><motor joint="elbow"/>'
    assert isinstance(read(slow), MujocoPlant)
    with pytest.raises(RobotFileError, match="it has the dynamics of actuator slow, which only MuJoCo simulates"):
        read(slow, backend="symbolic")
    lagging = '<motor joint="elbow"/><general name="lag" joint="shoulder" dyntype="filter" dynprm="0.1"/>'
    with pytest.warns(RobotFileWarning, match="the torque of lag acts at once: the actuator's own dynamics are left"):
        assert isinstance(read(lagging), RigidBody)


def test_a_law_of_commands_is_certified_in_mujoco_too(read):
    workspace = Workspace.box([-0.3, -0.3], [0.3, 0.3])
    different = POSITIONS.replace('kp="50"', 'kp="20"')
    results = []
    for backend in ("symbolic", "mujoco"):
        robot = read(different, backend=backend)
        assert robot.command_gain.tolist() == [200.0, 80.0]
        results.append(tarc.certify_law(law([2e-4, 4e-4]), robot, workspace, samples=50))
    first, second = (result.certificates["robot"].evidence for result in results)
    assert first.max_ratio == pytest.approx(second.max_ratio, rel=1e-4)
