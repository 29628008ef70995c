"""The error that a design predicts, against the run of its own scenario."""

import sysconfig
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tarc
from tarc.core.errors import RobotFileWarning
from tarc.design import design_controller, predict_design_error
from tarc.design.prediction import predict_error

DATA = Path(sysconfig.get_path("purelib")) / "cmeel.prefix/share/example-robot-data/robots"
PANDA_JOINTS = [f"panda_joint{i}" for i in range(1, 8)]
TIAGO_JOINTS = [f"arm_{i}_joint" for i in range(1, 8)]
BAXTER_JOINTS = [f"left_{name}" for name in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]
TALOS_JOINTS = [f"arm_left_{i}_joint" for i in range(2, 8)]
CASES = {
    "bolt": ("bolt_description/robots/bolt.urdf", {"armature": 0.02}, {}),
    "tiago": ("tiago_description/robots/tiago.urdf", {"armature": 0.03, "joints": TIAGO_JOINTS}, {}),
    "baxter": ("baxter_description/urdf/baxter.urdf", {"armature": 0.05, "joints": BAXTER_JOINTS}, {}),
    # without the gripper, whose dry friction in the file is its whole torque limit
    "talos": ("talos_data/robots/talos_left_arm.urdf", {"armature": 0.02, "joints": TALOS_JOINTS}, {}),
    # with the rotor inertia that the refusal names: their links are light beside the viscous friction
    "pendulum": ("double_pendulum_description/urdf/double_pendulum.urdf", {"armature": 0.012}, {"torque_limits": 20.0}),
    "simple": (
        "double_pendulum_description/urdf/double_pendulum_simple.urdf",
        {"armature": 0.012},
        {"torque_limits": 20.0},
    ),
    "two_dofs": ("asr_twodof_description/urdf/TwoDofs.urdf", {}, {"torque_limits": 50.0}),
    "so101": ("so_arm_description/urdf/so101.urdf", {"armature": 0.028}, {"payload": (0.0, 0.3), "speed": 1.0}),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", {"armature": 0.1}, {"payload": (0.0, 5.0), "speed": 1.0}),
    "panda": (
        "panda_description/urdf/panda.urdf",
        {"armature": 0.1, "joints": PANDA_JOINTS},
        {"payload": (0.0, 3.0), "speed": 0.5},
    ),
    "kinova": ("kinova_description/robots/kinova.urdf", {"armature": 0.1}, {"payload": (0.0, 2.0), "speed": 1.0}),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", {"armature": 0.1}, {"payload": (0.0, 3.5), "speed": 1.0}),
    "z1": ("z1_description/urdf/z1.urdf", {"armature": 0.1}, {"payload": (0.0, 2.0), "speed": 1.0}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_certified_design_runs_with_the_error_that_it_predicts(name):
    file, options, requirements = CASES[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)
        robot = tarc.plants.load_robot(DATA / file, **options)
        if "speed" in requirements:
            requirements = {**requirements, "speed": np.minimum(robot.velocity_limits, requirements["speed"])}
        design = design_controller(robot, progress=False, **requirements)
        (run,) = design.scenario().run(progress=False).values()
    assert design.certificates["robot"].certified
    assert run.status.completed
    measured, predicted = run.metrics(1.0)["rms_error"], predict_design_error(design)
    assert predicted / 2 <= measured <= 2 * predicted


ARM = tarc.plants.TwoLinkArm()
REFERENCE = tarc.signals.Sinusoid(amplitude=[0.3, 0.4], frequency=[2.0, 3.0], phase=np.pi / 2, offset=[0.2, 1.0])


def make_law(kind: Any = tarc.laws.TDC, **options: Any) -> Any:
    given = {
        "inertia": 0.3 * ARM.mean_inertia(REFERENCE.sample(np.linspace(0, 4, 50))[0]),
        "natural_frequency": 12.0,
        "synchronised": True,
        "period": 1e-3,
        "estimator": tarc.estimators.Algebraic(window=0.010, degree=2),
    }
    return kind(**{**given, **options})


def simulated(law, **options):
    run = tarc.simulate(ARM, law, REFERENCE, 4.0, initial_torque="rest", progress=False, **options)
    assert run.status.completed
    return np.array(list(run.joint_errors(1.0).values()))


@pytest.mark.parametrize("delay", [0, 1])
def test_the_error_of_a_linear_law(delay):
    law = make_law(actuation_delay=delay)
    predicted = predict_error(law, [ARM], REFERENCE, 4.0, computation_delay=delay).rms(1.0)
    np.testing.assert_allclose(predicted, simulated(law, computation_delay=delay), rtol=0.01)


def test_gains_that_couple_the_joints():
    gains = {"position_gain": [[150.0, 20.0], [20.0, 200.0]], "velocity_gain": [[24.0, 2.0], [2.0, 28.0]]}
    law = make_law(natural_frequency=None, **gains)
    predicted = predict_error(law, [ARM], REFERENCE, 4.0).rms(1.0)
    np.testing.assert_allclose(predicted, simulated(law), rtol=0.01)


def test_the_robust_term_counts_at_its_largest_gain():
    law = make_law(
        tarc.laws.TARC,
        rise_rate=1e5,
        fall_rate=1e3,
        boundary_layer=0.01,
        min_gain=0.999,
        initial_gain=1.0,
        max_gain=1.0,
    )
    predicted = predict_error(law, [ARM], REFERENCE, 4.0).rms(1.0)
    np.testing.assert_allclose(predicted, simulated(law), rtol=0.01)
    assert np.all(predicted < predict_error(make_law(), [ARM], REFERENCE, 4.0).rms(1.0))


def test_the_error_of_noise():
    mass = tarc.plants.MassSpringDamper(masses=[1.0], springs=[0.0], dampers=[0.0])
    still = tarc.signals.Sinusoid(amplitude=[0.0], frequency=1.0)
    law, sensor = make_law(inertia=0.1), tarc.signals.Encoder(noise=3e-4)
    predicted = predict_error(law, [mass], still, 1.0, sensor=sensor, mean_ratio=0.1).noise
    run = tarc.simulate(mass, law, still, 60.0, sensor=sensor, progress=False)
    np.testing.assert_allclose(predicted, list(run.joint_errors(1.0).values()), rtol=0.05)


def test_an_unstable_loop_has_no_error_of_noise():
    law = make_law()
    found = predict_error(law, [ARM], REFERENCE, 0.1, sensor=tarc.signals.Encoder(bits=16), mean_ratio=100.0)
    assert np.all(np.isinf(found.noise))


def test_the_load_that_comes_half_way_counts():
    loaded = ARM.with_parameters({"payload": 2.0})
    first = predict_error(make_law(), [ARM], REFERENCE, 2.0).error
    half = predict_error(make_law(), [ARM, loaded], REFERENCE, 2.0).error
    np.testing.assert_array_equal(first[:, :1000], half[:, :1000])
    assert np.abs(half[:, 1001:]).max() > 3 * np.abs(first[:, 1001:]).max()
