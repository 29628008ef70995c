"""Robots in symbols against MuJoCo: shipped ones, public files and generated trees."""

import copy
import pickle
import sysconfig
from pathlib import Path
from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter, RobotFileError
from tarc.plants import MujocoPlant, RigidBody, load_robot, shipped_robots

DATA = Path(sysconfig.get_path("purelib")) / "cmeel.prefix/share/example-robot-data/robots"
PUBLIC = [
    "a1_description/urdf/a1.urdf",
    "alex_description/urdf/alex_nub_hands.urdf",
    "asr_twodof_description/urdf/TwoDofs.urdf",
    "baxter_description/urdf/baxter.urdf",
    "bolt_description/robots/bolt.urdf",
    "borinot_description/urdf/borinot_flying_arm_2.urdf",
    "centauro_description/urdf/centauro.urdf",
    "double_pendulum_description/urdf/double_pendulum.urdf",
    "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "go2_description/urdf/go2.urdf",
    "hextilt_description/urdf/hextilt_flying_arm_5.urdf",
    "human_description/robots/human.urdf",
    "kinova_description/robots/kinova.urdf",
    "laikago_description/urdf/laikago.urdf",
    "panda_description/urdf/panda.urdf",
    "quadruped_description/urdf/quadruped.urdf",
    "romeo_description/urdf/romeo.urdf",
    "simple_humanoid_description/urdf/simple_humanoid.urdf",
    "so_arm_description/urdf/so101.urdf",
    "solo_description/robots/solo12.urdf",
    "talos_data/robots/talos_left_arm.urdf",
    "talos_data/robots/talos_reduced.urdf",
    "tiago_pro_description/robots/tiago_pro.urdf",
    "ur_description/urdf/ur3_gripper.urdf",
    "ur_description/urdf/ur10_robot.urdf",
    "xarm_description/urdf/xarm7.urdf",
    "z1_description/urdf/z1.urdf",
]


def symbolic(file: str | Path, **options: Any) -> RigidBody:
    """Read a robot that needs no MuJoCo."""
    robot = load_robot(file, **options)
    assert isinstance(robot, RigidBody)
    return robot


def assert_equal_to_mujoco(robot: RigidBody, seed: int, tolerance: float = 1e-9) -> None:
    """M, N, gravity and accelerations at random states, by the size of what is compared."""
    random = np.random.default_rng(seed)
    n = robot.n_joints
    for _ in range(5):
        q, dq = random.uniform(-2, 2, n), random.uniform(-2, 2, n)
        pairs = [
            (robot.inertia(q), robot.mujoco.inertia(q)),
            (robot.bias(q, dq), robot.mujoco.bias(q, dq)),
            (robot.gravity_torque(q), robot.mujoco.gravity_torque(q)),
        ]
        for ours, theirs in pairs:
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance * max(1.0, np.abs(theirs).max()))


@pytest.mark.parametrize("name", shipped_robots())
def test_shipped_robots(name):
    robot = symbolic(name, armature=0.1, viscous=0.3, coulomb=0.5, payload=2.0)
    assert_equal_to_mujoco(robot, 0)


@pytest.mark.filterwarnings("ignore::tarc.core.errors.RobotFileWarning")
@pytest.mark.parametrize("name", PUBLIC, ids=lambda name: Path(name).stem)
def test_public_robots(name):
    robot = symbolic(DATA / name, armature=0.01, payload=0.5)
    assert_equal_to_mujoco(robot, 1)


def random_tree(random: np.random.Generator, n_bodies: int) -> str:
    """Return an MJCF of a random tree: hinges and slides off the origin, up to two on a body, ref, rotated inertias."""
    spec = mujoco.MjSpec()
    spec.option.gravity = random.uniform(-10, 10, 3)
    bodies = [spec.worldbody]
    for number in range(n_bodies):
        parent = bodies[random.integers(len(bodies))]
        quaternion = random.normal(size=4)
        body = parent.add_body(
            name=f"body{number}",
            pos=random.uniform(-0.5, 0.5, 3),
            quat=quaternion / np.linalg.norm(quaternion),
            mass=random.uniform(0.5, 2.0),
            ipos=random.uniform(-0.1, 0.1, 3),
            inertia=random.uniform(0.02, 0.03, 3),
            iquat=(axis := random.normal(size=4)) / np.linalg.norm(axis),
            explicitinertial=True,
        )
        for place in range(random.integers(0 if number else 1, 3)):
            joint = body.add_joint(name=f"joint{number}_{place}")
            joint.type = [mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE][random.integers(2)]
            joint.axis = random.normal(size=3)
            joint.pos = random.uniform(-0.2, 0.2, 3)
            joint.ref = random.uniform(-0.5, 0.5)
            stiffness = random.choice([0.0, 3.0])
            joint.stiffness = stiffness if np.ndim(joint.stiffness) == 0 else [stiffness, 0.0, 0.0]
            joint.springref = random.uniform(-0.3, 0.3)
            joint.armature = 0.05
        bodies.append(body)
    spec.compile()
    return spec.to_xml()


@pytest.mark.parametrize("seed", range(12))
def test_generated_trees(seed, tmp_path):
    random = np.random.default_rng(seed)
    file = tmp_path / "tree.xml"
    file.write_text(random_tree(random, 2 + seed % 6))
    robot = symbolic(file, payload=0.7)
    assert_equal_to_mujoco(robot, seed)


def test_equations_of_an_arm_are_short():
    """Customised equations of six joints take about a thousand operations; the machine takes 1 to 2 ns for each."""
    robot = symbolic("ur5e", armature=0.1, viscous=1.0)
    assert robot._functions.get("acceleration").n_instructions() < 1200, "with the parameters as symbols"
    q, dq, torque = (ca.SX.sym(name, 6) for name in ("q", "dq", "torque"))
    expression = robot.evaluate("acceleration", q, dq, torque)
    assert ca.Function("f", [q, dq, torque], [expression], {"cse": True}).n_instructions() < 900


def test_midpoint_step_reuses_the_inertia_of_its_start_to_second_order():
    robot = symbolic("ur5e", armature=0.1, viscous=1.0)
    q, dq, torque = robot.home, np.linspace(-1.0, 1.0, 6), np.linspace(20.0, -20.0, 6)
    errors = []
    for step in (4e-4, 2e-4):
        a1, a2 = np.split(robot.evaluate("midpoint", q, dq, torque, step), 2)
        np.testing.assert_allclose(a1, robot.evaluate("acceleration", q, dq, torque), rtol=1e-12)
        middle = q + step / 2 * dq + step**2 / 8 * a1
        exact = robot.evaluate("acceleration", middle, dq + step / 2 * a1, torque)
        errors.append(np.abs(a2 - exact).max())
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_linearisation_is_that_of_finite_differences():
    robot = symbolic("panda", armature=0.1, viscous=1.0, coulomb=2.0)
    random = np.random.default_rng(3)
    q, dq, ddq = random.uniform(-1, 1, (3, 7))
    for exact, differences in zip(robot.linearised(q, dq, ddq), robot.mujoco.linearised(q, dq, ddq), strict=True):
        np.testing.assert_allclose(exact, differences, atol=1e-6)
    np.testing.assert_allclose(robot.damping(q, dq), robot.linearised(q, dq)[1], atol=1e-12)


def test_dry_friction_is_smoothed_over_a_stated_width():
    robot = symbolic("ur5e", armature=0.1, coulomb=2.0)
    assert robot.parameters["coulomb_width"] == pytest.approx(np.full(6, 0.01))
    friction = robot.evaluate("friction", robot.home, np.full(6, 0.01))
    np.testing.assert_allclose(friction, 2.0 * np.tanh(1.0))


@pytest.mark.parametrize("name", ["payload", "armature", "viscous", "coulomb", "masses"])
def test_parameters_are_inputs_of_the_equations(name):
    robot = symbolic("ur5e", armature=0.1, payload=1.0)
    value = robot.parameters[name] * 1.5 + 0.1
    changed = robot.with_parameters({name: value})
    assert changed._functions is robot._functions, "no new equations"
    q = np.full(6, 0.3)
    given = robot.evaluate("acceleration", q, q, q, parameters={name: value})
    np.testing.assert_array_equal(changed.evaluate("acceleration", q, q, q), given)
    assert not np.allclose(robot.evaluate("acceleration", q, q, q), given)
    assert robot.parameters[name] == pytest.approx((value - 0.1) / 1.5)


def test_masses_scale_the_inertia_of_their_links():
    robot = symbolic("ur5e")
    q = robot.home
    doubled = robot.with_parameters({"masses": 2 * robot.parameters["masses"]})
    np.testing.assert_allclose(doubled.inertia(q), 2 * robot.inertia(q), rtol=1e-12)
    np.testing.assert_allclose(doubled.gravity_torque(q), 2 * robot.gravity_torque(q), rtol=1e-12)


def test_run_agrees_with_mujoco_in_the_limit():
    """Semi-implicit Euler of MuJoCo is of first order: its error against ours halves with its steps."""
    robot = symbolic("ur5e", armature=0.1, viscous=1.0)
    law = tarc.laws.TDC(
        inertia=0.05 * np.diag(robot.inertia(robot.home)),
        natural_frequency=8.0,
        period=2e-3,
        estimator=tarc.estimators.Algebraic(window=0.02, degree=2),
        synchronised=True,
    )
    reference = tarc.signals.Sinusoid(amplitude=0.2, frequency=2.0, offset=robot.home)
    ours = tarc.simulate(robot, law, reference, 0.4, initial_torque="rest").data["position"]
    errors = [
        float(
            np.abs(
                tarc.simulate(robot.mujoco, law, reference, 0.4, initial_torque="rest", substeps=k).data["position"]
                - ours
            ).max()
        )
        for k in (4, 8)
    ]
    assert errors[0] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def test_copies_and_pickles():
    robot = symbolic("ur5e", armature=0.1)
    q = robot.home
    expected = robot.inertia(q)
    for other in (copy.copy(robot), pickle.loads(pickle.dumps(robot))):
        np.testing.assert_array_equal(other.inertia(q), expected)


def test_backends():
    assert isinstance(load_robot("ur5e", backend="mujoco"), MujocoPlant)
    assert isinstance(load_robot("ur5e", contact=True), MujocoPlant)
    with pytest.raises(
        RobotFileError, match="ur5e.xml: it has contacts, which only MuJoCo simulates; use backend='mujoco'"
    ):
        load_robot("ur5e", contact=True, backend="symbolic")
    with pytest.raises(InvalidParameter, match="backend: .*'symbol'.*Did you mean 'symbolic'"):
        load_robot("ur5e", backend="symbol")


def test_a_law_has_its_model_and_compiles():
    robot = symbolic("ur5e", armature=0.1)
    law = tarc.laws.ComputedTorque(
        model=robot, natural_frequency=10.0, period=1e-3, estimator=tarc.estimators.Algebraic(window=0.01, degree=2)
    )
    reference = tarc.signals.Sinusoid(amplitude=0.2, frequency=2.0, offset=robot.home)
    runs = [tarc.simulate(robot, law, reference, 0.3, initial_torque="rest", native=native) for native in (False, True)]
    np.testing.assert_array_equal(runs[0].data["torque"], runs[1].data["torque"])
    assert runs[0].status.completed


@pytest.mark.parametrize("name", ["ur5e", "panda"])
def test_the_regressor_of_the_links_gives_the_torque_of_the_file(name):
    """Y(q, q̇, q̈) p = M(q) q̈ + N(q, q̇) without rotor inertia and friction."""
    arm = load_robot(name)
    assert isinstance(arm, RigidBody)
    n = arm.n_joints
    bare = arm.with_parameters({"armature": np.zeros(n), "viscous": np.zeros(n), "coulomb": np.zeros(n)})
    regressor, parameters = arm.link_regressor()
    rng = np.random.default_rng(1)
    for _ in range(3):
        q, dq, ddq = arm.home + rng.normal(size=n), rng.normal(size=n), rng.normal(size=n)
        torque = np.array(regressor(q, dq, ddq)) @ parameters
        np.testing.assert_allclose(torque, bare.inertia(q) @ ddq + bare.bias(q, dq), atol=1e-10)
