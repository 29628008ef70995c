"""Every refusal of ``tarc design`` says what came, what is allowed and what to do; and nothing is computed or lost."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import tarc
from tarc import TarcError, plants
from tarc.cli.main import app
from tarc.design import design_controller
from tarc.design.robot_facts import assumptions, gravity_load, joint_workspace
from tarc.plants import MujocoPlant
from tarc.signals import Encoder
from urdf_text import arm, joint, link, robot


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def forbid_search(monkeypatch):
    """Nothing that is refused may have been designed first."""

    def never(*_, **__):
        raise AssertionError("the search began")

    monkeypatch.setattr("tarc.design.synthesis.assess_candidates", never)


def refusal_message(text, *options, name="arm.urdf"):
    """Return the message for a file with this text; None for no file at all."""
    if text is not None:
        Path(name).write_text(text)
    done = CliRunner().invoke(app, ["design", name, *map(str, options)])
    assert isinstance(done.exception, TarcError), (done.output, done.exception)
    message = str(done.exception)
    assert "\n" not in message
    assert not Path("design.yaml").exists()
    return message


EFFORTLESS = '<limit lower="-2" upper="2" velocity="3"/>'
FREE = joint("base_free", "base", "upper", "floating", "")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"arm\.urdf is empty; needs MJCF or URDF"),
        ("name: arm\n", r"arm\.urdf is no XML file .*; needs MJCF or URDF"),
        ("<sdf/>", r"root <sdf>; needs <mujoco> \(MJCF\) or <robot> \(URDF\)"),
        (
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>',
            r"template of xacro; make a URDF of it first: xacro arm\.urdf > robot\.urdf",
        ),
        (robot(link("base")), "no hinge or slide joint to control"),
        (arm(elbow=joint("elbow", "upper", "fore", "hinge")), "'elbow' is of the type 'hinge'; known are revolute, "),
        (arm(elbow=joint("elbow", "uper", "fore")), "parent of joint 'elbow' is 'uper', .* Did you mean 'upper'"),
        (arm(elbow=joint("shoulder", "upper", "fore")), "name 'shoulder' stands for more than one joint; rename one"),
        (arm(upper=link("upper", mass="heavy")), r"MuJoCo cannot read arm\.urdf: .* 'mass'"),
    ],
)
def test_what_is_no_robot(text, message):
    assert re.search(message, refusal_message(text))


def test_a_file_that_is_not_there():
    message = refusal_message(None, name="amr.urdf")
    assert "'amr.urdf' not found" in message
    assert "panda, ur5e" in message


def test_a_free_base_is_fixed_with_a_note():
    Path("free.urdf").write_text(arm(shoulder=FREE, more=link("hand") + joint("wrist", "fore", "hand")))
    with pytest.warns(tarc.RobotFileWarning, match="joint base_free would let float is fixed.*--lock base_free"):
        free = tarc.plants.load_robot("free.urdf")
    assert free.joint_names == ["elbow", "wrist"]
    fixed = joint("base_free", "base", "upper", "fixed", "")
    Path("fixed.urdf").write_text(arm(shoulder=fixed, more=link("hand") + joint("wrist", "fore", "hand")))
    expected = tarc.plants.load_robot("fixed.urdf")
    np.testing.assert_allclose(free.inertia([0.3, 0.2]), expected.inertia([0.3, 0.2]))


def test_a_free_base_alone():
    text = robot(link("base"), link("upper"), FREE)
    assert "it has no hinge or slide joint to control" in refusal_message(text)


@pytest.mark.parametrize(
    ("upper", "message"),
    [
        (link("upper", mass=-1), "link 'upper' has the mass -1 kg; needs a number of at least 0. Correct"),
        (link("upper", mass="nan"), "link 'upper' has the mass nan kg"),
        (
            link("upper", moments=(0.02, -0.02, 0.02)),
            "no body has the inertia of these links: upper with -0.02, 0.02, 0.02 kg m².*must not be below 0",
        ),
        (
            link("upper", moments=(0.02, 0.5, 0.02)),
            "these links: upper with 0.02, 0.02, 0.5 kg m².*nor one more than the sum of the others. Correct",
        ),
    ],
)
def test_an_inertia_that_no_body_has(upper, message):
    assert re.search(message, refusal_message(arm(upper=upper)))


@pytest.mark.parametrize(
    "fore",
    [link("fore", mass=0, moments=(0, 0, 0)), link("fore", moments=(0, 0, 0), centre=0), '<link name="fore"/>'],
    ids=["no mass", "a point on the axis", "no inertial"],
)
def test_a_link_without_inertia(fore):
    message = refusal_message(arm(fore=fore))
    assert "link 'fore' has no inertia about its joint elbow" in message
    assert "give armature=0.1" in message


def test_mass_below_zero_in_mjcf():
    text = (
        '<mujoco><worldbody><body name="link"><joint name="hinge"/>'
        '<inertial pos="0 0 0" mass="-2" diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    assert "link 'link' has the mass -2 kg" in refusal_message(text, name="arm.xml")


def test_ranges():
    upside = '<limit lower="2" upper="-2" effort="80" velocity="3"/>'
    message = refusal_message(arm(elbow=joint("elbow", "upper", "fore", inside=upside)))
    assert "range of joint 'elbow' goes from 2 to -2; needs the lower end first" in message
    endless = joint("slide", "base", "upper", "prismatic", '<limit effort="80" velocity="3"/>')
    message = refusal_message(arm(shoulder=endless))
    assert "the slide slide [m] has no range in the file; write one there" in message
    assert "give joint_range, the distance from the home posture" in message


def test_a_reach_stands_in_for_a_range_that_is_missing(folder):
    (folder / "arm.urdf").write_text(
        arm(shoulder=joint("slide", "base", "upper", "prismatic", '<limit effort="80" velocity="3"/>'))
    )
    box = joint_workspace(MujocoPlant.from_file("arm.urdf"), 0.3)
    assert box.low.tolist() == [-0.3, -0.3]


@pytest.mark.filterwarnings("ignore::tarc.core.errors.RobotFileWarning")
@pytest.mark.parametrize("limit", [EFFORTLESS, '<limit lower="-2" upper="2" velocity="3" effort="0"/>'])
def test_torque_limits_missing(limit):
    text = arm(elbow=joint("elbow", "upper", "fore", inside=limit))
    message = refusal_message(text)
    assert message.startswith("torque_limits: none is known for joint elbow, so torque noise has no budget")
    assert "Give torque_limits, or a natural_frequency" in message


def test_noise_without_any_torque_limit():
    text = arm(
        elbow=joint("elbow", "upper", "fore", inside=EFFORTLESS),
        shoulder=joint("shoulder", "base", "upper", inside=EFFORTLESS),
    )
    message = refusal_message(text, "--noise-budget", 0.02, "--natural-frequency", 10)
    assert "noise_budget: it is a share of the torque limit, and none is known; give torque_limits too" in message


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--payload", 5, 0], r"payload: got 5 to 0 kg; needs the smallest first"),
        (["--payload", -1, 5], r"payload: got -1; needs a finite number of at least 0"),
        (["--tool", "frk"], r"tool: got 'frk'; arm.urdf has no such body or site\..* It has base, upper, fore"),
        (["--joints", "elbow,wirst"], r"no hinge or slide 'wirst'; it has shoulder, elbow"),
        (["--encoder-bits", 0], r"--encoder-bits: got 0; needs a whole number from 1 to 52"),
        (["--encoder-bits", 99], r"--encoder-bits: got 99; needs a whole number from 1 to 52"),
        (
            ["--encoder-bits", 18, "--encoder-resolution", "1e-5"],
            r"--encoder-bits, --encoder-resolution: both are given",
        ),
        (["--encoder-resolution", "1e-5,1e-5,1e-5"], r"sensor: its resolution has 3 numbers; needs one, or "),
        (["--encoder-resolution", "fine"], r"--encoder-resolution: got 'fine'; needs one number, or one per joint"),
        (["--speed", "-1"], r"speed: got \[-1.0, -1.0\]; each must be at least 0"),
        (["--speed", "1,2,3"], r"speed: got shape \(3,\); needs one number or 2 of them"),
        (["--speed", "nan"], r"speed: "),
        (["--speed", "fast"], r"--speed: got 'fast'; needs one number"),
        (["--joint-range", 0], r"joint_range: got 0; needs a finite number above 0"),
        (["--joint-range", -0.5], r"joint_range: got -0.5; needs a finite number above 0"),
        (["--control-rate", 0], r"--control-rate: got 0; needs a finite number above 0"),
        (["--natural-frequency", -3], r"natural_frequency: got -3; needs a finite number above 0"),
        (["--damping-ratio", 0], r"damping_ratio: got 0; needs a finite number above 0"),
        (["--noise-budget", 5], r"noise_budget: got 5; needs a share of the torque limit, such as 0.02 for 2 %"),
        (["--law", "pid"], r"law: got 'PID'; known are TARC, TDC"),
        (["--computation-delay", -1], r"computation_delay: got -1; needs a whole number of at least 0"),
        (["--torque-limits", "80,x"], r"--torque-limits: got '80,x'; needs one number, or one per joint with commas"),
        (["--torque-limits", "80,80,80"], r"torque_limits: got shape \(3,\); needs one number or 2 of them"),
        (["--torque-limits", "0"], r"torque_limits: got \[0.0, 0.0\]; each must be above 0"),
        (["--armature", "-0.1"], r"armature: got \[-0.1, -0.1\]; each must be at least 0"),
        (["--samples", 0], r"samples: got 0; needs a whole number of at least 1"),
        (["-o", "design.json"], r"--out: got 'design.json'; needs the name of a YAML file, such as design\.yaml"),
        (
            ["-o", "arm.urdf/design.yaml"],
            r"--out: cannot write arm\.urdf/design\.yaml: .*; free space or",
        ),
    ],
)
def test_options_at_fault(options, message):
    assert re.search(message, refusal_message(arm(), *options))


def test_one_number_for_the_payload_is_a_matter_of_usage(folder):
    (folder / "arm.urdf").write_text(arm())
    done = CliRunner().invoke(app, ["design", "arm.urdf", "--payload", "5"])
    assert done.exit_code == 2
    assert "--payload" in done.output


def test_a_perfect_encoder_needs_a_bandwidth(folder):
    (folder / "arm.urdf").write_text(arm())
    with pytest.raises(
        TarcError, match="sensor: without measurement noise .* give the encoder bits, a resolution or noise"
    ):
        design_controller(MujocoPlant.from_file("arm.urdf"), sensor=Encoder())


@dataclass(frozen=True, kw_only=True, eq=False)
class Flywheel(plants.EulerLagrange):
    """A robot of one's own that knows of no payload."""

    mass: float = 1.0

    def validate(self):
        pass

    @property
    def n_joints(self):
        return 1

    def kinetic_energy(self, q, dq, p):
        return p.mass * dq[0] ** 2 / 2

    def potential_energy(self, q, p):
        return 0.0 * q[0]


def test_a_robot_that_carries_no_payload():
    with pytest.raises(TarcError, match="payload: .* has no such parameter; leave it out, or use a robot from a file"):
        design_controller(Flywheel(), payload=(0.0, 2.0), torque_limits=30.0)


# stretched out to the side at home: 1 kg at 0.2 m and at 0.6 m on the shoulder, 1 kg at 0.2 m on the elbow
SIDEWAYS = arm().replace('<origin xyz="0 0 0.4"/>', '<origin xyz="0 0 0.4" rpy="0 1.5707963 0"/>', 1)


def test_too_weak_for_its_own_weight_at_home():
    message = refusal_message(SIDEWAYS, "--torque-limits", "7,5")
    assert (
        "torque_limits: the robot cannot hold itself in its home posture q = (0, 0): joint shoulder needs 7.85"
        in message
    )
    assert "its limit is 7 N m" in message
    assert "a torque limit above 7.85" in message
    assert "payload" not in message


def test_too_weak_for_the_payload_at_home():
    """Each kilogram at the tool, the origin of the last link 0.4 m out, adds 3.92 N m: 15.7 at 2 kg, 10 at 0.548 kg."""
    message = refusal_message(SIDEWAYS, "--torque-limits", 10, "--payload", 0, 2)
    assert "with 2 kg at the tool: joint shoulder needs 15.7 and its limit is 10 N m" in message
    assert "a payload of at most 0.54 kg; a torque limit above 15.7" in message


def test_too_weak_elsewhere_is_a_warning(folder):
    (folder / "arm.urdf").write_text(arm())  # upright at home
    plant = MujocoPlant.from_file("arm.urdf")
    limits = np.array([7.0, 5.0])
    held = gravity_load([plant], joint_workspace(plant), limits)
    assert held is not None
    assert held.at_home == pytest.approx(0, abs=1e-9)
    assert 1 < held.load < 7.85 / 7 + 1e-6
    assert 0 < held.share_beyond_limit < 0.5
    choice = assumptions([plant], joint_workspace(plant), limits, held, own=False)[-1]
    value, why = choice.value, choice.reason
    assert re.fullmatch(r"at most 1\d\d % of the torque limit", value)
    assert why.startswith("WARNING: joint shoulder takes 7.")
    assert "which the certificate excludes: keep away" in why


def test_friction_that_takes_the_torque_is_a_warning(folder):
    (folder / "arm.urdf").write_text(arm())
    limits = np.array([7.0, 5.0])
    for coulomb, is_named in (([4.0, 4.9], True), ([4.0, 3.0], False)):
        plant = MujocoPlant.from_file("arm.urdf", coulomb=coulomb)
        held = gravity_load([plant], joint_workspace(plant), limits)
        last = assumptions([plant], joint_workspace(plant), limits, held, own=False)[-1]
        assert (last.label == "friction") is is_named
        if is_named:
            assert last.value == "98 % of the torque limit"
            assert last.reason.startswith("WARNING: dry friction takes 4.9 of 5 N m of joint elbow")


def test_what_the_file_leaves_open_is_said(folder):
    endless = joint("shoulder", "base", "upper", "continuous", '<limit effort="80" velocity="3"/>')
    mimic = joint("finger", "fore", "tip", inside='<limit lower="0" upper="1" effort="9"/><mimic joint="elbow"/>')
    fixed = joint("flange", "fore", "plate", "fixed", "")
    (folder / "arm.urdf").write_text(arm(shoulder=endless, more=link("tip") + mimic + link("plate", 0.1) + fixed))
    plant = MujocoPlant.from_file("arm.urdf", joints=None)
    assert plant.joint_names == ["shoulder", "elbow"]
    box = joint_workspace(plant)
    found = {
        choice.label: (choice.value, choice.reason)
        for choice in assumptions([plant], box, plant.torque_limits, None, own=True)
    }
    assert found["robot"][0] == "arm.urdf, 2 joints"
    assert "driven: shoulder, elbow; locked at home: finger (mimics elbow)" in found["robot"][1]
    assert "no rotor inertia is known" in found["robot"][1]
    assert found["workspace"][0] == "all that the joints reach"
    assert "shoulder -3.142 to 3.142; elbow -2 to 2" in found["workspace"][1]
    assert "no range is known for shoulder, which is taken to ±π, a whole turn" in found["workspace"][1]
    near = {
        choice.label: choice.reason
        for choice in assumptions([plant], joint_workspace(plant, 0.5), plant.torque_limits, None, own=True)
    }
    assert "each joint -0.5 to 0.5" in near["workspace"]


def test_where_the_payload_hangs_is_said(folder):
    (folder / "arm.urdf").write_text(arm())
    for tool, words in ((None, "link fore, the last one"), ("upper", "link upper")):
        plant = MujocoPlant.from_file("arm.urdf", tool=tool)
        heavy = [plant.with_parameters({"payload": mass}) for mass in (0.0, 3.0)]
        found = {
            choice.label: (choice.value, choice.reason)
            for choice in assumptions(heavy, joint_workspace(plant), plant.torque_limits, None, own=True)
        }
        assert found["payload"][0] == "0 to 3 kg"
        assert found["payload"][1].startswith(f"at {words};")
