"""Inertias of a robot file: judged where they move, by the sum of what moves as one."""

import sysconfig
import warnings
from pathlib import Path

import numpy as np
import pytest

from tarc.core.errors import RobotFileError, RobotFileWarning
from tarc.plants import RigidBody, load_robot
from tarc.plants.joint_roles import choose_joints
from tarc.plants.link_inertia import RigidInertia
from tarc.plants.robot_file import compile_model, read_specification, reduce_to_joints

DATA = Path(sysconfig.get_path("purelib")) / "cmeel.prefix/share/example-robot-data/robots"
WITHOUT_JOINTS = {"quadrotor_base", "iris_simple", "ur3"}
OPTIONS = {
    "romeo": {"armature": 0.01},
    "icub": {"armature": 0.01},
    "romeo_small": {"balance_inertia": True},
    "romeo_laas_small": {"balance_inertia": True, "armature": 0.01},
}
"""What the messages of the files that do not load as they are name."""


def arm(base: str, link: str = "", more: str = "") -> str:
    """Return a URDF of one hinge, with inertials of the base and of what hangs on it."""
    link = link or inertial("0.001", "0.01", "0.01")
    return f"""<robot name="r"><link name="base">{base}</link><link name="l1">{link}</link>{more}
    <joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>"""


def inertial(xx: str, yy: str, zz: str, xy: str = "0", mass: str = "1", place: str = "0.1 0 0") -> str:
    return (
        f'<inertial><origin xyz="{place}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" ixy="{xy}" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial>'
    )


def tip(xx: str, yy: str, zz: str, mass: str = "0.1") -> str:
    """Return a link that is fixed to the moving one."""
    return (
        f'<link name="tip">{inertial(xx, yy, zz, mass=mass, place="0 0 0")}</link><joint name="weld" type="fixed">'
        '<parent link="l1"/><child link="tip"/><origin xyz="0.3 0 0.1" rpy="0.2 0.3 0.4"/></joint>'
    )


@pytest.fixture
def read(tmp_path):
    def load(text: str, **options) -> RigidBody:
        file = tmp_path / "arm.urdf"
        file.write_text(text)
        robot = load_robot(file, **options)
        assert isinstance(robot, RigidBody)
        return robot

    return load


@pytest.mark.parametrize(
    "base",
    [
        pytest.param(inertial("0", "0", "3e-6", xy="1e-22", mass="0"), id="rounding"),
        pytest.param(inertial("0.001", "0.001", "0.01"), id="flat"),
        pytest.param(inertial("-1", "-1", "-1"), id="negative"),
    ],
)
def test_what_cannot_move_does_not_matter(read, base):
    expected = read(arm(""))
    robot = read(arm(base))
    np.testing.assert_allclose(robot.inertia([0.3]), expected.inertia([0.3]), rtol=1e-14)
    np.testing.assert_allclose(robot.gravity_torque([0.3]), expected.gravity_torque([0.3]), rtol=1e-14)


@pytest.mark.parametrize("value", ["0", "1e-20", "-1e-20"])
def test_rounding_is_zero(read, value):
    robot = read(arm("", inertial("0", "0.01", "0.01", xy=value)))
    assert robot.inertia([0.0])[0, 0] == pytest.approx(0.01 + 0.1**2)


def test_links_that_are_fixed_to_each_other_are_judged_by_their_sum(read):
    flat = tip("1e-4", "1e-4", "1e-3")
    robot = read(arm("", more=flat))
    place = np.array([0.3, 0.0, 0.1])
    about = RigidInertia(1.0, np.array([0.1, 0, 0]), np.diag([0.001, 0.01, 0.01]))
    cos, sin = np.cos([0.2, 0.3, 0.4]), np.sin([0.2, 0.3, 0.4])
    x = np.array([[1, 0, 0], [0, cos[0], -sin[0]], [0, sin[0], cos[0]]])
    y = np.array([[cos[1], 0, sin[1]], [0, 1, 0], [-sin[1], 0, cos[1]]])
    z = np.array([[cos[2], -sin[2], 0], [sin[2], cos[2], 0], [0, 0, 1]])
    turned = z @ y @ x
    rest = turned @ np.diag([1e-4, 1e-4, 1e-3]) @ turned.T
    expected = about.inertia[1, 1] + 0.1**2 + rest[1, 1] + 0.1 * (place @ place)
    assert robot.inertia([0.4])[0, 0] == pytest.approx(expected, rel=1e-12)
    assert robot.parameters["masses"].sum() == pytest.approx(1.1)


def test_all_impossible_links_are_named_at_once(read):
    text = arm("", inertial("0.001", "0.001", "0.01")).replace(
        "</robot>",
        f'<link name="l2">{inertial("-0.1", "0.1", "0.1")}</link><joint name="j2" type="revolute"><parent link="l1"/>'
        '<child link="l2"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>',
    )
    with pytest.raises(
        RobotFileError, match=r"(?s)l1 with 0.001, 0.001, 0.01 kg m².*l2 with -0.1, 0.1, 0.1 kg m².*balance_inertia"
    ):
        read(text)
    with pytest.warns(RobotFileWarning, match=r"(?s)replaced by their mean.*l1 .*l2 "):
        robot = read(text, balance_inertia=True)
    assert robot.file_options["balance_inertia"] is True
    assert robot.inertia([0.0, 0.0])[1, 1] == pytest.approx(0.1 / 3 + 0.1**2)


def public_files():
    """Yield all files, those slow that have the robot of a file before them and neither options nor a refusal."""
    seen = set()
    for file in sorted(DATA.rglob("*.urdf")):
        robot = file.relative_to(DATA).parts[0]
        is_slow = robot in seen and file.stem not in WITHOUT_JOINTS | OPTIONS.keys()
        seen.add(robot)
        marks = pytest.mark.slow if is_slow else ()
        yield pytest.param(file, id=f"{file.parents[1].name}-{file.stem}", marks=marks)


@pytest.mark.parametrize("file", list(public_files()))
def test_outcome_of_every_public_file(file):
    if file.stem in WITHOUT_JOINTS:
        with pytest.raises(RobotFileError, match="it has no hinge or slide joint to control"):
            load_robot(file)
        return
    options = OPTIONS.get(file.stem, {})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)
        if options:
            with pytest.raises(RobotFileError, match="|".join(f"{name}=" for name in options)):
                load_robot(file)
        robot = load_robot(file, **options)
    assert isinstance(robot, RigidBody)
    assert np.all(np.linalg.eigvalsh(robot.inertia(robot.home)) > 0)


def test_counts_of_the_public_files():
    names = [file.stem for file in DATA.rglob("*.urdf")]
    assert len(names) == 69
    assert len(set(names) & WITHOUT_JOINTS) == 3
    assert sum(name not in WITHOUT_JOINTS and name not in OPTIONS for name in names) >= 56


@pytest.mark.parametrize(
    "name", ["talos_data/robots/talos_reduced", "so_arm_description/urdf/so101", "ur_description/urdf/ur5_gripper"]
)
def test_merging_changes_no_motion(name):
    file = DATA / f"{name}.urdf"
    robot = load_robot(file)
    assert isinstance(robot, RigidBody)
    spec = read_specification(file)
    locked = choose_joints(spec).locked
    for joint in list(spec.joints):
        if joint.name in locked:
            spec.delete(joint)
    reduce_to_joints(spec)
    model = compile_model(spec, file.name)
    unmerged = robot.mujoco.with_parameters({})
    unmerged.model, own = model, unmerged.model
    assert np.count_nonzero(model.body_mass) > np.count_nonzero(own.body_mass)
    unmerged._scratch = type(unmerged._scratch)(model)
    q = np.random.default_rng(0).uniform(-1, 1, robot.n_joints)
    np.testing.assert_allclose(robot.inertia(q), unmerged.inertia(q), rtol=0, atol=1e-9)
    np.testing.assert_allclose(robot.gravity_torque(q), unmerged.gravity_torque(q), rtol=0, atol=1e-9)


def test_links_within_a_frame_keep_their_inertia(tmp_path):
    """Their places are relative to the frame, so they are not merged."""
    file = tmp_path / "arm.xml"
    file.write_text(
        """<mujoco><worldbody><body name="l1"><joint name="j1" axis="0 1 0"/>
        <inertial pos="0.1 0 0" mass="1" diaginertia="0.001 0.01 0.01"/>
        <frame pos="0 0 0.5"><body name="tip" pos="0.3 0 0">
        <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body></frame></body></worldbody></mujoco>"""
    )
    inertia = load_robot(file).inertia([0.2])[0, 0]
    assert inertia == pytest.approx(0.01 + 0.1**2 + 1e-4 + 0.1 * (0.3**2 + 0.5**2), rel=1e-9)
