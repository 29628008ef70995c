"""The simulated plant is the one that was certified: zero-order hold, integrated to a stated error."""

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.plants import RigidBody, load_robot
from tarc.simulation.integration import Integration, choose_integration, max_error

LIGHT_ARM = """<robot name="light"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.06 0 0"/><mass value="0.5"/>
<inertia ixx="4e-4" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.05 0 0"/><mass value="0.4"/>
<inertia ixx="3e-4" iyy="8e-4" izz="8e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="q1" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="30" velocity="1"/></joint>
<joint name="q2" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.12 0 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="30" velocity="1"/></joint></robot>"""


@pytest.fixture
def light_arm(tmp_path) -> RigidBody:
    file = tmp_path / "light.urdf"
    file.write_text(LIGHT_ARM)
    robot = load_robot(file)
    assert isinstance(robot, RigidBody)
    return robot


def certified_law() -> tarc.laws.TARC:
    """Return the law that `tarc design` certifies for the light arm, with a margin of 0.17."""
    return tarc.laws.TARC(
        inertia=[[4.2573497e-3, 7.4440828e-4], [7.4440828e-4, 7.3718339e-4]],
        natural_frequency=130.0,
        synchronised=True,
        torque_limit=30.0,
        rise_rate=6.591e6,
        fall_rate=2.197e6,
        boundary_layer=9.785e-5,
        min_gain=0.01654,
        max_gain=1.6535,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.004, degree=3),
    )


def run(plant, law, **options):
    reference = tarc.signals.Sinusoid(amplitude=0.4, frequency=[1.5, 1.8], phase=np.pi / 2)
    sensor = tarc.signals.Encoder(bits=17)
    return tarc.simulate(plant, law, reference, 2.0, sensor=sensor, initial_torque="rest", **options)


def test_a_certified_design_runs_as_certified(light_arm):
    measures = run(light_arm, certified_law()).metrics(1.0)
    assert measures["rms_error"] < 5e-5
    assert measures["saturated"] == 0


def test_one_semi_implicit_step_is_another_plant(light_arm):
    """Which is why the robot in symbols is not integrated so."""
    measures = run(light_arm.mujoco, certified_law()).metrics(1.0)
    assert measures["saturated"] > 0.1


def test_run_says_how_it_was_integrated(light_arm):
    attributes = run(light_arm, certified_law()).data.attrs
    assert attributes["integrator"] == "midpoint"
    assert attributes["substeps"] == 1
    assert 0 < attributes["integration_error"] <= max_error(tarc.signals.Encoder(bits=17))
    assert run(light_arm, certified_law(), substeps=3).data.attrs["integrator"] == "Runge–Kutta"
    assert run(light_arm.mujoco, certified_law()).data.attrs["integrator"] == "MuJoCo"


def test_stated_error_is_that_of_a_finer_run():
    """Over a single period from the same state, so that no feedback is in between."""
    pendulum = tarc.plants.Pendulum()
    law = tarc.laws.TDC(
        inertia=0.1, natural_frequency=5.0, period=0.05, estimator=tarc.estimators.Algebraic(window=0.1, degree=2)
    )
    reference = tarc.signals.Sinusoid(amplitude=0.5, frequency=1.0)
    runs = {k: tarc.simulate(pendulum, law, reference, 0.1, initial_position=1.0, substeps=k) for k in (1, 2, 16)}
    ends = {k: run.data["position"].values[1, 0] for k, run in runs.items()}
    speeds = {k: run.data["velocity"].values[1, 0] for k, run in runs.items()}
    for k in (1, 2):
        true = abs(ends[k] - ends[16]) + law.period * abs(speeds[k] - speeds[16])
        stated = runs[k].data.attrs["integration_error"]
        assert stated >= 0.9 * true > 0


def test_the_cheapest_method_that_suffices_is_chosen():
    order = {"midpoint": 1e-4, "Runge–Kutta": 1e-6}

    def trial(method: Integration) -> tuple[float, bool]:
        return order[method.integrator] / method.substeps ** (2 if method.integrator == "midpoint" else 4), False

    assert choose_integration(trial, 1e-3) == Integration("midpoint", 1)
    assert choose_integration(trial, 1e-5) == Integration("Runge–Kutta", 1)
    assert choose_integration(trial, 1e-8) == Integration("Runge–Kutta", 4)
    assert choose_integration(lambda method: (float("nan"), False), 1e-8).substeps == 64


def test_a_run_that_diverges_is_refined_only_as_long_as_that_may_be_the_integration():
    assert choose_integration(lambda method: (1.0, True), 1e-8) == Integration("Runge–Kutta", 8)
    coarse = choose_integration(lambda method: (method.substeps**-4.0, method.substeps < 5), 1e-6)
    assert coarse.substeps == 32


def test_the_tolerance_follows_the_encoder():
    assert max_error(tarc.signals.Encoder()) == 1e-9
    assert max_error(tarc.signals.Encoder(resolution=[1e-3, 1e-4])) == pytest.approx(2e-6)


def test_bad_substeps(light_arm):
    with pytest.raises(InvalidParameter, match="substeps: got 0"):
        run(light_arm, certified_law(), substeps=0)
