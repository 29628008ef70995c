"""Robots from files: MuJoCo against the symbolic arm, energies and Jacobians; real URDFs; bad files."""

import sysconfig
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tarc
from tarc.core.errors import InvalidParameter, RobotFileError
from tarc.plants import MujocoPlant, TwoLinkArm, find_robot, shipped_robots
from tarc.plants.base import Plant

SHIPPED = {name: MujocoPlant.from_file(name) for name in ("ur5e", "panda")}
every_robot = pytest.mark.parametrize("robot", SHIPPED.values(), ids=SHIPPED.keys())
sampled = settings(max_examples=25)


def random_posture(robot: MujocoPlant, data: st.DataObject) -> np.ndarray:
    """Return a random position inside the joint limits."""
    low, high = robot.model.jnt_range.T
    return np.array([data.draw(st.floats(a, b)) for a, b in zip(low, high, strict=True)])


def data_at_rest(robot: MujocoPlant, position: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(robot.model)
    data.qpos[:] = position
    mujoco.mj_forward(robot.model, data)
    return data


def synchronised_tdc(inertia: Any) -> tarc.laws.TDC:
    """Return a law that tolerates M̂ = M, so that any robot may be tried."""
    estimator = tarc.estimators.Algebraic(window=0.010)
    return tarc.laws.TDC(inertia=inertia, natural_frequency=10.0, period=1e-3, synchronised=True, estimator=estimator)


LAW = synchronised_tdc([[1.0, 0.2], [0.2, 0.2]])
REFERENCE = tarc.signals.Sinusoid(amplitude=0.5, frequency=[3.0, 4.0], phase=np.pi / 2)


def test_shipped_robots_are_found_by_name() -> None:
    assert shipped_robots() == [f"{name}.xml" for name in sorted(SHIPPED)]
    assert find_robot("panda") == find_robot("panda.xml")


@every_robot
@sampled
@given(data=st.data())
def test_inertia_is_symmetric_positive_definite(robot: MujocoPlant, data: st.DataObject) -> None:
    M = robot.inertia(random_posture(robot, data))
    assert np.array_equal(M, M.T)
    assert np.linalg.eigvalsh(M)[0] > 0


@every_robot
@sampled
@given(data=st.data())
def test_linearised_about_a_motion_as_from_bias_and_inertia(robot: MujocoPlant, data: st.DataObject) -> None:
    """Inverse dynamics with rotor inertia, friction and a load, against the way that serves every plant."""
    loaded = robot.with_parameters({"payload": 3.0, "armature": 0.1, "viscous": 2.0, "coulomb": 1.0})
    q = random_posture(robot, data)
    motion = st.lists(st.floats(-3.0, 3.0), min_size=robot.n_joints, max_size=robot.n_joints).map(np.array)
    dq, ddq = data.draw(motion), data.draw(motion)
    for rates in ((), (dq, ddq)):
        ours, general = loaded.linearised(q, *rates), Plant.linearised(loaded, q, *rates)
        for matrix, expected in zip(ours, general, strict=True):
            assert np.allclose(matrix, expected, rtol=1e-5, atol=1e-6 * (1 + np.abs(expected).max()))
    assert np.allclose(loaded.linearised(q)[1], 2.0 * np.eye(robot.n_joints), atol=1e-9)
    assert np.allclose(loaded.damping(q, dq), loaded.linearised(q, dq, ddq)[1], atol=1e-9)


@every_robot
def test_reading_leaves_inertia_home_and_limits_as_in_the_file(robot: MujocoPlant) -> None:
    model = mujoco.MjModel.from_xml_path(str(find_robot(robot.label)))
    data, M = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    assert np.allclose(robot.inertia(robot.home), M, rtol=1e-12, atol=1e-14)
    assert np.array_equal(robot.home, data.qpos)
    assert np.array_equal(robot.torque_limits, model.jnt_actfrcrange[:, 1])
    assert robot.joint_names == [model.joint(i).name for i in range(model.njnt)]
    assert set(robot.units) == {"rad"}


@every_robot
@sampled
@given(data=st.data())
def test_gravity_is_the_gradient_of_mujoco_s_potential(robot: MujocoPlant, data: st.DataObject) -> None:
    model, q, h = robot.copy_model(), random_posture(robot, data), 1e-5
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    scratch = mujoco.MjData(model)

    def potential(position: np.ndarray) -> float:
        scratch.qpos[:] = position
        mujoco.mj_fwdPosition(model, scratch)
        mujoco.mj_energyPos(model, scratch)
        return scratch.energy[0]

    slope = [(potential(q + h * e) - potential(q - h * e)) / (2 * h) for e in np.eye(robot.n_joints)]
    # ε·100 J/h of rounding and h²/6·100 J of curvature
    assert np.allclose(robot.gravity_torque(q), slope, rtol=0, atol=1e-7)


@every_robot
def test_free_fall_keeps_its_energy_to_the_order_of_the_integrator(robot: MujocoPlant) -> None:
    def drift(steps: int) -> float:
        model = robot.copy_model()
        model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT  # the Panda's elbow would meet its stop
        model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 0.2 / steps
        data = mujoco.MjData(model)
        data.qpos[:] = robot.home
        mujoco.mj_forward(model, data)
        before = data.energy.copy()
        mujoco.mj_step(model, data, steps)
        mujoco.mj_forward(model, data)
        assert data.energy[1] > 1  # it does fall
        return abs(data.energy.sum() - before.sum())

    coarse, fine = drift(50), drift(100)
    assert fine < 1e-8
    assert coarse == pytest.approx(16 * fine, rel=0.1)  # order four


@every_robot
@sampled
@given(data=st.data(), mass=st.floats(0.1, 10))
def test_payload_is_a_ball_of_that_mass_at_the_tool(robot: MujocoPlant, data: st.DataObject, mass: float) -> None:
    q = random_posture(robot, data)
    rest = data_at_rest(robot, q)
    move, turn = np.zeros((3, robot.n_joints)), np.zeros((3, robot.n_joints))
    mujoco.mj_jacSite(robot.model, rest, move, turn, robot.model.site("tool").id)
    ball = mass * move.T @ move + 0.4 * mass * 0.05**2 * turn.T @ turn
    loaded = MujocoPlant.from_file(robot.label, payload=mass)
    assert np.allclose(loaded.inertia(q), robot.inertia(q) + ball, rtol=1e-10, atol=1e-12)
    weight = 9.81 * mass * move[2]
    assert np.allclose(loaded.gravity_torque(q), robot.gravity_torque(q) + weight, rtol=1e-10, atol=1e-10)


@every_robot
def test_armature_and_friction_are_set_joint_by_joint(robot: MujocoPlant) -> None:
    rotor = np.linspace(0.1, 0.5, robot.n_joints)
    changed = MujocoPlant.from_file(robot.label, armature=rotor, viscous=2 * rotor, coulomb=3 * rotor)
    M = robot.inertia(robot.home) + np.diag(rotor)
    assert np.allclose(changed.inertia(robot.home), M, rtol=1e-12, atol=1e-14)
    speed = np.linspace(-1, 1, robot.n_joints)
    data = data_at_rest(changed, robot.home)
    data.qvel[:] = speed
    mujoco.mj_forward(changed.model, data)
    assert np.allclose(data.qfrc_passive, -2 * rotor * speed, rtol=1e-12)
    assert np.array_equal(changed.parameters["coulomb"], 3 * rotor)


def test_joints_that_are_not_listed_are_locked_at_home() -> None:
    robot = SHIPPED["ur5e"]
    arm = MujocoPlant.from_file("ur5e", joints=["elbow_joint", "shoulder_lift_joint"])
    free = [1, 2]  # in the order of the file
    assert arm.joint_names == [robot.joint_names[i] for i in free]
    assert np.array_equal(arm.home, robot.home[free])
    q = robot.home
    q[free] = 0.4, -1.1
    assert np.allclose(arm.inertia(q[free]), robot.inertia(q)[np.ix_(free, free)], rtol=1e-10)
    assert np.allclose(arm.gravity_torque(q[free]), robot.gravity_torque(q)[free], rtol=1e-10)


RODS: dict[str, Any] = {"masses": (1.5, 1.0), "lengths": (1.0, 0.8), "centres": (0.5, 0.4), "inertias": (0.125, 0.06)}
POINTS: dict[str, Any] = {"masses": (1.0, 1.0), "lengths": (1.0, 1.0), "centres": (1.0, 1.0), "inertias": (1e-9, 1e-9)}
VISCOUS = (0.3, 0.2)


def mjcf_arm(folder: Path, values: dict[str, Any]) -> Path:
    (m1, m2), (l1, l2), (c1, c2), (I1, I2) = values.values()
    file = folder / "arm.xml"
    file.write_text(f"""
        <mujoco model="arm"><option integrator="RK4"/><worldbody>
          <body name="upper">
            <joint name="shoulder" axis="0 -1 0" damping="{VISCOUS[0]}"/>
            <inertial pos="{c1} 0 0" mass="{m1}" diaginertia="{I1 / 2} {I1} {I1}"/>
            <body name="fore" pos="{l1} 0 0">
              <joint name="elbow" axis="0 -1 0" damping="{VISCOUS[1]}"/>
              <inertial pos="{c2} 0 0" mass="{m2}" diaginertia="{I2 / 2} {I2} {I2}"/>
              <site name="tool" pos="{l2} 0 0"/>
            </body>
          </body>
        </worldbody></mujoco>""")
    return file


def urdf_arm(folder: Path, values: dict[str, Any]) -> Path:
    (m1, m2), (l1, l2), (c1, c2), (I1, I2) = values.values()

    def link(name: str, mass: float, centre: float, inertia: float) -> str:
        return f"""
            <link name="{name}">
              <visual><geometry><mesh filename="package://nowhere/{name}.stl"/></geometry></visual>
              <inertial><origin xyz="{centre} 0 0"/><mass value="{mass}"/>
                <inertia ixx="{inertia / 2}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>
            </link>"""

    def joint(name: str, kind: str, parent: str, child: str, x: float, viscous: float) -> str:
        return f"""
            <joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>
              <axis xyz="0 -1 0"/><dynamics damping="{viscous}"/><limit effort="40" lower="-9" upper="9" velocity="1"/>
            </joint>"""

    file = folder / "arm.urdf"
    file.write_text(
        f'<robot name="arm"><link name="base"/>{link("upper", m1, c1, I1)}{link("fore", m2, c2, I2)}<link name="tip"/>'
        + joint("shoulder", "revolute", "base", "upper", 0, VISCOUS[0])
        + joint("elbow", "revolute", "upper", "fore", l1, VISCOUS[1])
        + joint("flange", "fixed", "fore", "tip", l2, 0)
        + "</robot>"
    )
    return file


def arms(file: Path, values: dict[str, Any], payload: float) -> tuple[MujocoPlant, TwoLinkArm]:
    """Return the robot of the file, and the same from its energies: the payload's ball turns with the last link."""
    ball = 0.4 * payload * 0.05**2
    inertias = (values["inertias"][0], values["inertias"][1] + ball)
    symbolic = TwoLinkArm(**{**values, "inertias": inertias}, viscous=VISCOUS, payload=payload)
    return MujocoPlant.from_file(file, payload=payload), symbolic


@pytest.mark.parametrize("write", [mjcf_arm, urdf_arm])
@pytest.mark.parametrize("values", [RODS, POINTS], ids=["rods", "point masses"])
@pytest.mark.parametrize("payload", [0.0, 2.0])
def test_a_two_link_file_is_the_symbolic_arm(
    write: Any, values: dict[str, Any], payload: float, tmp_path: Path
) -> None:
    robot, arm = arms(write(tmp_path, values), values, payload)
    data = mujoco.MjData(robot.model)
    for q, dq in np.random.default_rng(0).uniform(-3, 3, (20, 2, 2)):
        assert np.allclose(robot.inertia(q), arm.inertia(q), rtol=1e-10, atol=1e-10)
        assert np.allclose(robot.gravity_torque(q), arm.gravity_torque(q), rtol=1e-10, atol=1e-10)
        data.qpos[:], data.qvel[:] = q, dq
        mujoco.mj_forward(robot.model, data)
        bias = data.qfrc_bias - data.qfrc_passive
        assert np.allclose(bias, arm.evaluate("bias", q, dq), rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("payload", [0.0, 2.0])
def test_both_engines_give_the_same_run(payload: float, tmp_path: Path) -> None:
    robot, arm = arms(mjcf_arm(tmp_path, RODS), RODS, payload)
    push = tarc.signals.StepDisturbance(amplitude=[3.0, -2.0], start_time=0.25)
    mine, symbolic = (
        tarc.simulate(plant, LAW, REFERENCE, 1.0, substeps=4, disturbance=push, initial_torque="rest")
        for plant in (arm, robot)
    )
    assert mine.metrics()["peak_error"] < 0.05
    # Both take the same Runge–Kutta steps under the same held torque, so only rounding tells them apart: 1e-16 rad,
    # which the weights of the acceleration, of 1e5/s² and M̂ = 1 kg m², turn into 1e-11 N m.
    for name, tolerance in (("position", 1e-12), ("velocity", 1e-11), ("torque", 1e-9)):
        assert np.allclose(mine.data[name].values, symbolic.data[name].values, rtol=0, atol=tolerance), name


@pytest.mark.filterwarnings("ignore::tarc.core.errors.JointLimitWarning")
def test_mujoco_s_first_order_step_tends_to_the_symbolic_run(tmp_path: Path) -> None:
    robot, arm = arms(urdf_arm(tmp_path, RODS), RODS, 0.0)
    exact = tarc.simulate(arm, LAW, REFERENCE, 0.5, substeps=4, initial_torque="rest").data["position"].values

    def error(substeps: int) -> float:
        run = tarc.simulate(robot, LAW, REFERENCE, 0.5, substeps=substeps, initial_torque="rest")
        return float(np.max(np.abs(run.data["position"].values - exact)))

    assert error(4) == pytest.approx(2 * error(8), rel=0.1)  # a URDF states no integrator, MuJoCo's own is Euler's


@pytest.mark.filterwarnings("ignore::tarc.core.errors.JointLimitWarning")
def test_recorded_acceleration_is_the_one_just_after_the_torque_was_set(tmp_path: Path) -> None:
    robot, arm = arms(urdf_arm(tmp_path, RODS), RODS, 0.0)
    data = tarc.simulate(robot, LAW, REFERENCE, 0.5, initial_torque="rest").data
    rows = zip(*(data[name].values for name in ("position", "velocity", "torque")), strict=True)
    expected = [arm.evaluate("acceleration", *row) for row in rows]
    assert np.allclose(data["acceleration"].values, expected, rtol=0, atol=1e-9)


VALUES = {"payload": 2.0, "viscous": [5.0, 3.0], "armature": [0.5, 0.3], "coulomb": [4.0, 2.0]}


@pytest.mark.parametrize("parameter", VALUES)
def test_a_schedule_changes_the_run_from_its_instant_on_and_not_the_plant(parameter: str, tmp_path: Path) -> None:
    file = mjcf_arm(tmp_path, RODS)
    robot, value = MujocoPlant.from_file(file), VALUES[parameter]
    before = robot.parameters

    def motion(plant: MujocoPlant, *at: float) -> np.ndarray:
        events = [tarc.signals.ParameterSchedule(parameter=parameter, times=[t], values=[value]) for t in at]
        return tarc.simulate(plant, LAW, REFERENCE, 0.4, disturbance=events).data["position"].values

    plain, later = motion(robot), motion(robot, 0.2)
    assert np.array_equal(later[:201], plain[:201])  # the sample at 0.2 s is what came before it
    assert not np.allclose(later[201:], plain[201:], rtol=0, atol=1e-6)
    assert np.array_equal(motion(robot, 0.0), motion(MujocoPlant.from_file(file, **{parameter: value})))
    after = robot.parameters
    assert all(np.array_equal(before[name], after[name]) for name in before)


FOLDERS = ["ur", "panda", "kinova", "xarm", "z1", "so_arm"]
ROBOTS = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share", "example-robot-data", "robots")
URDFS = sorted(file for folder in FOLDERS for file in (ROBOTS / f"{folder}_description").rglob("*.urdf"))
EMPTY = "ur3.urdf"  # has no joints upstream


def test_all_sixteen_urdfs_were_found() -> None:
    assert len(URDFS) == 16
    assert EMPTY in [file.name for file in URDFS]


@pytest.mark.parametrize("file", [f for f in URDFS if f.name != EMPTY], ids=lambda file: file.stem)
def test_tdc_runs_on_real_urdfs(file: Path) -> None:
    robot = MujocoPlant.from_file(file, armature=0.1)
    middle = np.where(robot.model.jnt_limited, robot.model.jnt_range.mean(axis=1), 0.0)
    amplitude = [0.1 if unit == "rad" else 0.01 for unit in robot.units]  # the Panda's finger slides
    reference = tarc.signals.Sinusoid(amplitude=amplitude, frequency=3.0, phase=np.pi / 2, offset=middle.tolist())
    run = tarc.simulate(robot, synchronised_tdc(robot.inertia(middle)), reference, 0.3, initial_torque="rest")
    assert run.status.completed
    assert run.status.saturated == 0
    errors = [value for name, value in run.metrics().items() if name.startswith("peak_error")]
    assert max(errors) < 5e-3  # a tenth of what the arm moves


def test_a_urdf_without_joints_says_so() -> None:
    with pytest.raises(RobotFileError, match=r"ur3\.urdf: it has no hinge or slide joint"):
        MujocoPlant.from_file(ROBOTS / "ur_description" / "urdf" / EMPTY)


def one_joint_model(inside: str, before: str = "", joint: str = '<joint name="hinge"/>') -> str:
    return f'<mujoco>{before}<worldbody><body name="link">{joint}{inside}</body></worldbody></mujoco>'


BALL = '<geom size="0.1"/>'
INERTIAL = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
LIGHT = '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-12 1e-12 1e-12"/>'
MESH = '<asset><mesh name="shell" file="shell.stl"/></asset>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no markup", r"robot\.xml is no XML file .* needs MJCF or URDF"),
        ("<sdf/>", r"root <sdf>; needs <mujoco> \(MJCF\) or <robot> \(URDF\)"),
        (one_joint_model("<ball/>"), r"MuJoCo cannot read .*robot\.xml"),
        (one_joint_model(BALL, joint="<freejoint name='float'/>"), "no hinge or slide joint to control"),
        (one_joint_model(BALL, joint=""), "no hinge or slide joint"),
        (one_joint_model(LIGHT), "singular .* need rotor inertia: give armature=0.1"),
        (
            one_joint_model('<geom type="mesh" mesh="shell"/>', MESH),
            "inertia of body 'link' from the mesh 'shell.stl'",
        ),
    ],
)
def test_a_file_at_fault_is_refused_with_the_remedy(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(text)
    with pytest.raises(RobotFileError, match=message):
        MujocoPlant.from_file(file)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"joints": ["hing"]}, "joints: .* has no hinge or slide 'hing'; it has hinge. Did you mean 'hinge'"),
        ({"joints": []}, "joints: got none; give some of hinge"),
        ({"tool": "lnk"}, "tool: got 'lnk'; robot.xml has no such body or site. Did you mean 'link'"),
        ({"viscous": -1.0}, r"viscous: got \[-1.0\]; each must be at least 0"),
        ({"coulomb": [1.0, 2.0]}, "coulomb: got shape .* one number or 1"),
        ({"payload": -1.0}, "payload: got -1"),
    ],
)
def test_a_parameter_at_fault_is_refused(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model(BALL))
    with pytest.raises(InvalidParameter, match=message) as caught:
        MujocoPlant.from_file(file, **options)
    assert caught.value.path in options


def test_a_missing_file_names_where_it_looked_and_the_nearest_robot() -> None:
    with pytest.raises(RobotFileError) as caught:
        MujocoPlant.from_file("ur5")
    for part in ("'ur5' not found", str(Path("ur5").resolve()), "panda, ur5e", "Did you mean 'ur5e'?"):
        assert part in str(caught.value)


def test_a_light_link_loads_with_rotor_inertia(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model(LIGHT))
    assert MujocoPlant.from_file(file, armature=0.1).inertia([0.0]) == pytest.approx(0.1)


def test_a_missing_mesh_does_no_harm_to_a_body_that_states_its_inertia(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model(f'{INERTIAL}<geom type="mesh" mesh="shell"/>', MESH))
    assert MujocoPlant.from_file(file).inertia([0.0]) == pytest.approx(1.0)


def test_a_free_body_may_be_locked_by_listing_the_joints(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    arm = '<body name="arm"><joint name="hinge"/><geom size="0.1" mass="2"/></body>'
    file.write_text(one_joint_model(BALL + arm, joint='<freejoint name="float"/>'))
    robot = MujocoPlant.from_file(file, joints=["hinge"])
    assert robot.joint_names == ["hinge"]
    assert robot.inertia([0.0]) == pytest.approx(0.4 * 2 * 0.1**2)


def test_force_limits_of_motors_become_torque_limits(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    motor = '<actuator><motor joint="hinge" forcerange="-7 7"/></actuator>'
    file.write_text(one_joint_model(BALL, motor))
    robot = MujocoPlant.from_file(file)
    assert robot.torque_limits.tolist() == [7.0]
    assert robot.model.nu == 0


@pytest.mark.parametrize(
    ("actuator", "limit"),
    [
        ('<motor joint="hinge"/>', np.inf),
        ('<motor joint="hinge" gear="50" ctrlrange="-1 1"/>', 50.0),
        ('<position joint="hinge" kp="100"/>', np.inf),
        ('<motor joint="hinge" gear="50" forcerange="-2 2"/>', 100.0),
        ('<motor joint="hinge" forcerange="-3 8"/>', 3.0),
    ],
)
def test_actuators_are_replaced_by_the_torque(actuator: str, limit: float, tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model(BALL).replace("</mujoco>", f"<actuator>{actuator}</actuator></mujoco>"))
    robot = MujocoPlant.from_file(file, actuators="torque")
    assert robot.model.nu == 0
    assert robot.torque_limits == limit


def test_the_narrower_side_of_a_lopsided_range_is_the_limit(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model(BALL, joint='<joint name="hinge" actuatorfrcrange="-9 5"/>'))
    assert MujocoPlant.from_file(file).torque_limits == 5.0


@pytest.mark.parametrize(
    ("joint", "body", "torque"),
    [
        ('<joint name="hinge" axis="0 1 0" stiffness="20"/>', "", 20 * 0.5 - 9.81 * np.cos(0.5)),
        ('<joint name="hinge" axis="0 1 0"/>', ' gravcomp="1"', 0.0),
    ],
)
def test_springs_and_compensated_gravity_count_at_rest(joint: str, body: str, torque: float, tmp_path: Path) -> None:
    """A point mass of 1 kg at 1 m along x, turned by 0.5 rad about y, that is downwards."""
    point = '<inertial pos="1 0 0" mass="1" diaginertia="1e-6 1e-6 1e-6"/>'
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model(point, joint=joint).replace('<body name="link"', f'<body name="link"{body}'))
    assert MujocoPlant.from_file(file).gravity_torque([0.5]) == pytest.approx(torque, abs=1e-9)


def test_recorded_acceleration_under_rk4_is_that_of_its_start(tmp_path: Path) -> None:
    """q̈ = τ/I − g cos q for a point mass: known at every instant from the recorded position and torque."""
    point = '<inertial pos="1 0 0" mass="1" diaginertia="0 0 0"/>'
    file = tmp_path / "robot.xml"
    arm = one_joint_model(point, '<option integrator="RK4"/>', '<joint name="hinge" axis="0 -1 0" armature="1e-9"/>')
    file.write_text(arm.replace('diaginertia="0 0 0"', 'diaginertia="1e-12 1e-12 1e-12"'))
    law = synchronised_tdc(0.5)
    reference = tarc.signals.Sinusoid(amplitude=[0.5], frequency=5.0)
    data = tarc.simulate(MujocoPlant.from_file(file), law, reference, 0.5).data
    expected = data["torque"] - 9.81 * np.cos(data["position"])
    np.testing.assert_allclose(data["acceleration"], expected, rtol=1e-6, atol=1e-6)


def test_links_without_mass_are_borne_by_rotor_inertia(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    chain = f'<body name="second"><joint name="other"/>{INERTIAL}</body>'
    file.write_text(one_joint_model(chain))
    robot = MujocoPlant.from_file(file, armature=0.1)
    assert np.linalg.eigvalsh(robot.inertia(np.zeros(2)))[0] > 0.04


def test_numbers_follow_the_order_in_which_joints_are_listed(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model(f'{INERTIAL}<body name="second"><joint name="other"/>{INERTIAL}</body>'))
    robot = MujocoPlant.from_file(file, joints=["other", "hinge"], armature=[1.0, 2.0])
    assert robot.joint_names == ["hinge", "other"]
    assert robot.parameters["armature"].tolist() == [2.0, 1.0]
    assert MujocoPlant.from_file(file, joints="other").joint_names == ["other"]


def test_home_is_inside_the_joint_limits() -> None:
    for file in URDFS:
        if file.name != EMPTY:
            robot = MujocoPlant.from_file(file, armature=0.1)
            low, high = robot.model.jnt_range.T
            free = ~robot.model.jnt_limited.astype(bool)
            assert np.all(free | ((low < robot.home) & (robot.home < high))), file.name


def test_missing_textures_and_pictures_of_the_room_do_no_harm(tmp_path: Path) -> None:
    assets = (
        '<asset><mesh name="room" file="room.stl"/><texture name="t" type="2d" file="gone.png"/>'
        '<material name="m" texture="t"/></asset>'
    )
    room = '<worldbody><geom type="mesh" mesh="room"/>'
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model('<geom size="0.1" material="m"/>', assets).replace("<worldbody>", room))
    assert MujocoPlant.from_file(file).n_joints == 1


@pytest.mark.filterwarnings("ignore::tarc.core.errors.JointLimitWarning")
def test_divergence_leaves_no_log_file_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    robot, _ = arms(urdf_arm(tmp_path, RODS), RODS, 0.0)
    law = tarc.laws.TDC(
        inertia=[50.0, 50.0],
        natural_frequency=50.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.01),
        torque_limit=1e9,
    )
    run = tarc.simulate(robot, law, REFERENCE, 1.0)
    assert not run.status.completed
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_joints_without_names_get_all_their_parameters(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model(f"{INERTIAL}<body><joint/>{INERTIAL}</body>", joint="<joint/>"))
    robot = MujocoPlant.from_file(file, armature=[0.1, 0.2])
    assert robot.joint_names == ["joint1", "joint2"]
    assert robot.parameters["armature"].tolist() == [0.1, 0.2]
    with pytest.raises(InvalidParameter, match="names a joint of robot.xml twice"):
        MujocoPlant.from_file(file, joints=["joint1", "joint1"])


def test_home_is_in_radians_whatever_the_file_counts_in(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(one_joint_model(BALL, joint='<joint name="hinge" range="10 90"/>'))
    assert MujocoPlant.from_file(file).home == pytest.approx(np.deg2rad(50.0))


def test_negative_masses_cannot_be_scheduled() -> None:
    robot = SHIPPED["ur5e"]
    reference = tarc.signals.Sinusoid(amplitude=0.1, frequency=1.0, offset=robot.home)
    with pytest.raises(InvalidParameter, match=r"payload: got \[-5.0\]; each must be at least 0"):
        tarc.simulate(
            robot,
            synchronised_tdc(robot.inertia(robot.home)),
            reference,
            0.1,
            disturbance=tarc.signals.ParameterSchedule(parameter="payload", times=[0.0], values=[-5.0]),
        )
