"""Joints with inner position loops: closed form, saturation, certificates in either units, the controller."""

import numpy as np
import pytest

import tarc
from tarc.analysis.workspace import Workspace
from tarc.core.errors import InvalidParameter
from tarc.plants import MassSpringDamper, PositionServo, RigidBody, TwoLinkArm, load_robot

PERIOD = 1e-3
STILL = tarc.signals.Sinusoid(amplitude=0.0, frequency=1.0, offset=0.2)


def law(inertia, **options):
    return tarc.laws.TDC(
        inertia=inertia,
        natural_frequency=10.0,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.010),
        **options,
    )


def mass(**options):
    return MassSpringDamper(masses=[2.0], springs=[0.0], dampers=[0.0], **options)


def test_one_joint_under_a_constant_command_has_the_closed_form_of_its_servo():
    """2 q̈ + 40 q̇ + 800 (q − c) = 0, damped at ζ = 0.5, from rest at zero."""
    servo = PositionServo(mass(), kp=800.0, kd=40.0)
    assert servo.torque_units == ["m"]
    command = 0.1
    run = tarc.simulate(
        servo,
        law(1e-4, torque_limit=command),
        tarc.signals.Sinusoid(amplitude=0.0, frequency=1.0, offset=100.0),
        0.5,
        initial_position=0.0,
        divergence_threshold=1e3,
    )
    assert np.all(run.data["torque"].values[1:] == command)
    start = int(np.argmax(run.data["torque"].values == command))
    time = run.data["time"].values[start:] - start * PERIOD
    decay, rate = 10.0, np.sqrt(400.0 - 100.0)
    expected = command * (1 - np.exp(-decay * time) * (np.cos(rate * time) + decay / rate * np.sin(rate * time)))
    np.testing.assert_allclose(run.data["position"].values[start:, 0], expected, atol=1e-9)
    assert run.data["torque"].attrs == {"long_name": "command of the joints", "units": "m"}
    assert run.command_unit == "m"
    assert "command variation</td><td>" in run._repr_html_()
    assert "<td>m/s</td>" in run._repr_html_()


def test_the_loops_saturate_at_the_torque_limits_of_the_robot():
    class Limited(MassSpringDamper):
        @property
        def torque_limits(self):
            return np.array([3.0])

    servo = PositionServo(Limited(masses=[2.0], springs=[0.0], dampers=[0.0]), kp=800.0)
    acceleration = servo.evaluate("acceleration", [0.0], [0.0], servo.joint_input(np.array([1.0]), np.array([0.5])))
    assert acceleration == pytest.approx((3.0 + 0.5) / 2.0)
    acceleration = servo.evaluate("acceleration", [0.0], [0.0], servo.joint_input(np.array([1e-3]), np.array([0.5])))
    assert acceleration == pytest.approx((0.8 + 0.5) / 2.0)
    assert servo.torque_limits.tolist() == [np.inf]


def test_disturbances_of_a_servo_are_torques():
    step = tarc.signals.StepDisturbance(amplitude=4.0)
    run = tarc.simulate(
        PositionServo(mass(), kp=800.0, kd=80.0),
        law(1e-4, torque_limit=1e-12),
        STILL,
        3.0,
        initial_position=0.0,
        disturbance=step,
    )
    assert float(run.data["position"][-1, 0]) == pytest.approx(4.0 / 800.0, rel=1e-6)


def test_equations_are_those_of_the_arm_and_its_loops():
    arm = TwoLinkArm()
    kp, kd = np.array([500.0, 200.0]), np.array([20.0, 5.0])
    servo = PositionServo(arm, kp, kd)
    q, v, a = np.array([0.3, 0.8]), np.array([0.5, -1.0]), np.array([2.0, 1.0])
    np.testing.assert_allclose(servo.inertia(q), arm.inertia(q) / kp[:, None])
    np.testing.assert_allclose(servo.bias(q, v), (arm.bias(q, v) + kp * q + kd * v) / kp)
    np.testing.assert_allclose(servo.holding_torque(q), q + arm.gravity_torque(q) / kp)
    command = servo.inertia(q) @ a + servo.bias(q, v)
    still = np.zeros(2)
    np.testing.assert_allclose(servo.evaluate("acceleration", q, v, servo.joint_input(command, still)), a)
    M, D, G = arm.linearised(q, v, a)
    for found, expected in zip(servo.linearised(q, v, a), (M, D + np.diag(kd), G + np.diag(kp)), strict=True):
        np.testing.assert_allclose(found, expected / kp[:, None])
    heavier = servo.with_parameters({"payload": 2.0})
    np.testing.assert_allclose(heavier.inertia(q), arm.with_parameters({"payload": 2.0}).inertia(q) / kp[:, None])


@pytest.mark.parametrize("kp", [400.0, [400.0, 900.0]])
def test_a_law_of_commands_is_certified_as_the_law_of_torques_that_it_is(kp):
    """The loop of a law with M̂ on a servo is that of a law with kp M̂ on the arm with springs kp and dampers kd."""
    arm = TwoLinkArm()
    workspace = Workspace.box([-0.5, -0.5], [0.5, 0.5])
    gains = np.broadcast_to(np.asarray(kp, dtype=float), 2)
    inertia = np.array([0.5, 0.3])
    servo = PositionServo(arm, kp, kd=30.0)
    commands = tarc.certify_law(law(inertia / gains), servo, workspace, samples=200)
    torques = tarc.certify_law(law(inertia), servo.in_torque_units(), workspace, samples=200)
    assert commands.certificates["robot"].verdict == torques.certificates["robot"].verdict
    for name in ("min_ratio", "max_ratio"):
        values = [getattr(result.certificates["robot"].evidence, name) for result in (commands, torques)]
        assert values[0] == pytest.approx(values[1], rel=1e-9)
    plain = tarc.certify_law(law(inertia), arm, workspace, samples=200)
    assert commands.certificates["robot"].evidence.max_ratio == pytest.approx(
        plain.certificates["robot"].evidence.max_ratio, rel=1e-6
    )


def test_a_full_inertia_of_commands_needs_equal_gains():
    servo = PositionServo(TwoLinkArm(), [400.0, 900.0])
    full = law(np.array([[1e-3, 1e-4], [1e-4, 1e-3]]))
    with pytest.raises(InvalidParameter, match="different gains, so that a certificate needs a diagonal inertia"):
        tarc.certify_law(full, servo, Workspace.box([-0.1, -0.1], [0.1, 0.1]), samples=50)


def test_a_urdf_or_shipped_robot_follows_a_reference_through_its_loops():
    arm = load_robot("ur5e", armature=0.1)
    servo = PositionServo(arm, kp=2000.0, kd=100.0)
    assert servo.torque_units == ["rad"] * 6
    expected = np.max(np.abs(arm.position_limits), axis=1) + arm.torque_limits / 2000.0
    np.testing.assert_allclose(servo.torque_limits, expected)
    reference = tarc.signals.Sinusoid(amplitude=0.2, frequency=2.0, offset=servo.home, phase=np.pi / 2)
    run = tarc.simulate(
        servo, law(0.1 * np.diag(servo.mean_inertia(servo.home[:, None]))), reference, 0.5, initial_torque="rest"
    )
    assert run.status.completed
    assert run.metrics()["rms_error"] < 0.04


def test_the_controller_outputs_position_commands():
    servo = PositionServo(mass(), kp=800.0, kd=40.0)
    tdc = law(1e-4)
    run = tarc.simulate(servo, tdc, STILL, 0.05, initial_position=0.15, initial_torque=0.15)
    controller = tarc.Controller(tdc)
    controller.reset([0.15], 0.15)
    for measured, command in zip(run.data["measured_position"].values, run.data["torque"].values, strict=True):
        assert controller.step(measured, [0.2], [0.0], [0.0]) == pytest.approx(command, rel=1e-12)


def test_a_servo_needs_a_robot_in_symbols_and_gains():
    with pytest.raises(InvalidParameter, match="needs a robot in symbols that takes torques"):
        PositionServo(load_robot("ur5e", backend="mujoco"), kp=100.0)
    with pytest.raises(InvalidParameter, match="needs a robot in symbols that takes torques"):
        PositionServo(PositionServo(TwoLinkArm(), kp=100.0), kp=100.0)
    with pytest.raises(InvalidParameter, match="kp"):
        PositionServo(TwoLinkArm(), kp=0.0)


def test_a_servo_drives_the_motors_of_an_elastic_joint_and_not_the_other_way_round():
    gearbox = tarc.plants.Gearbox(plant=mass(), stiffness=5000.0, motor_inertia=0.5, encoder="link")
    servo = PositionServo(gearbox, kp=800.0, kd=80.0)
    assert servo.passive_joints == ["joint1"]
    run = tarc.simulate(servo, law(1e-4, torque_limit=0.2), STILL, 3.0, initial_position=0.1, initial_torque=0.2)
    assert run.data["passive_joint"].values.tolist() == ["joint1 motor"]
    with pytest.raises(InvalidParameter, match=r"PositionServo\(Gearbox"):
        tarc.plants.Gearbox(plant=PositionServo(mass(), kp=800.0), stiffness=5000.0, motor_inertia=0.5)


def test_a_scenario_gives_gains_and_runs_with_commands(tmp_path):
    file = tmp_path / "servo.yaml"
    file.write_text(
        """
robot: {file: ur5e, armature: 0.1, kp: 2000.0, kd: 100.0}
law: {kind: TDC, natural_frequency: 10.0, inertia: {fraction: 0.1, diagonal: true}}
estimator: {kind: Algebraic, window: 0.010}
reference: {kind: Sinusoid, amplitude: 0.1, frequency: 2.0, offset: [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]}
initial_torque: rest
duration: 0.2
"""
    )
    scenario = tarc.Scenario.load(file)
    (run,) = scenario.run().values()
    assert run.status.completed
    assert run.command_unit == "rad"
    assert tarc.Scenario.load(file, ["robot.kp=[1000, 1000, 1000, 500, 500, 500]"]).build().plant.command_gain[5] == 500


def test_only_what_a_file_gives_is_written_as_arguments_of_it():
    arm = load_robot("ur5e", armature=0.1)
    assert isinstance(arm, RigidBody)
    assert arm.file_options == {"file": "ur5e", "armature": 0.1}
    assert PositionServo(arm, kp=500.0).file_options == {}
    assert tarc.plants.Gearbox(plant=arm, stiffness=5000.0).file_options == {}
    loaded = load_robot("ur5e", armature=0.1, kp=500.0).with_parameters({"payload": 1.0})
    assert loaded.file_options == {"file": "ur5e", "armature": 0.1, "kp": 500.0, "payload": 1.0}
