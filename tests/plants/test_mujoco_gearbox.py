"""Gearboxes of robots in MuJoCo: against closed forms, and against the same robot in symbols."""

import mujoco
import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.plants import Gearbox, MujocoPlant, load_robot
from tarc.plants.mujoco_gearbox import MujocoGearbox
from tarc.signals import Encoder, ParameterSchedule, Sinusoid
from tarc.simulation.mujoco_gears import Gears

SLIDE = """<mujoco><option gravity="0 0 0"/><worldbody><body name="cart">
<joint name="x" type="slide" axis="1 0 0"/><inertial mass="2" pos="0 0 0" diaginertia="0.1 0.1 0.1"/>
</body></worldbody></mujoco>"""

TWO_LINKS = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="upper">
<joint name="q1" axis="0 1 0"/><inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.05 0.05"/>
<body name="fore" pos="0.4 0 0"><joint name="q2" axis="0 1 0"/>
<inertial mass="1.5" pos="0.15 0 0" diaginertia="0.01 0.03 0.03"/></body></body></worldbody></mujoco>"""

ELASTIC = {"stiffness": 2000.0, "twist_damping": 4.0, "motor_inertia": [0.4, 0.2]}
FRICTION = {"coulomb": 0.5, "breakaway": 0.8, "viscous": 0.3, "friction_width": 0.05, "ripple": 0.2}


@pytest.fixture
def two_links(tmp_path):
    file = tmp_path / "two.xml"
    file.write_text(TWO_LINKS)
    return file


def geared(file, backend, **options):
    return Gearbox(plant=load_robot(file, backend=backend), **options)


def run(plant, duration=0.25, **options):
    law = tarc.laws.TDC(
        inertia=[0.04, 0.02],
        natural_frequency=8.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.01),
    )
    reference = Sinusoid(amplitude=[0.2, 0.3], frequency=4.0)
    return tarc.simulate(plant, law, reference, duration, initial_torque="rest", **options).data


def test_two_masses_swing_at_their_frequency(tmp_path):
    """The twist is x(t) = x₀ cos ωt with ω² = K (1/J + 1/m), and the momentum stays."""
    (tmp_path / "cart.xml").write_text(SLIDE)
    plant = geared(tmp_path / "cart.xml", "mujoco", stiffness=800.0, motor_inertia=0.5)
    assert isinstance(plant, MujocoGearbox)
    frequency = np.sqrt(800.0 * (1 / 0.5 + 1 / 2.0))
    M, D, G = plant.linearised(np.zeros(2))
    assert not D.any()
    assert np.sqrt(np.max(np.linalg.eigvals(np.linalg.solve(M, G)))) == pytest.approx(frequency, rel=1e-6)
    model = plant.copy_model()
    model.opt.timestep = 1e-5
    gears = Gears(plant, model, mujoco.MjData(model), np.array([0.0, 0.1]), np.zeros(2))
    times = 1e-5 * np.arange(1, 30_001)
    twists = np.empty(len(times))
    for k in range(len(times)):
        gears.step()
        twists[k] = gears.position[1] - gears.position[0]
    np.testing.assert_allclose(twists, 0.1 * np.cos(frequency * times), atol=5e-5)
    assert 2.0 * gears.velocity[0] + 0.5 * gears.velocity[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "options",
    [
        {"motor_inertia": [0.4, 0.2], **FRICTION},
        {**ELASTIC, **FRICTION},
        {**ELASTIC, "stiffness": 3e4, "twist_damping": 20.0, "encoder": "link"},
    ],
    ids=["rigid", "elastic", "encoders at the links"],
)
def test_both_backends_move_alike(two_links, options):
    """The steps of MuJoCo and of the motors are of first order: their error halves with them."""
    exact = run(geared(two_links, "symbolic", **options))
    errors = []
    for substeps in (8, 16):
        ours = run(geared(two_links, "mujoco", **options), substeps=substeps)
        assert ours.attrs["integrator"] == "MuJoCo"
        names = ["position", "velocity", *(["passive_position"] if "stiffness" in options else [])]
        errors.append(max(float(np.abs(ours[name] - exact[name]).max()) for name in names))
    assert errors[1] < 2e-3
    assert errors[1] < 0.6 * errors[0]


def test_an_arm_of_the_catalogue_moves_alike():
    options = {"stiffness": 5e3, "twist_damping": 0.5, "motor_inertia": 0.3}
    law = tarc.laws.TDC(
        inertia=np.full(6, 0.02),
        natural_frequency=6.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.01),
    )
    ends = []
    for backend in ("symbolic", "mujoco"):
        plant = geared("ur5e", backend, **options)
        reference = Sinusoid(amplitude=0.1, frequency=3.0, offset=plant.home)
        data = tarc.simulate(plant, law, reference, 0.1, initial_torque="rest", sensor=Encoder()).data
        ends.append(data["position"].values)
    assert data.attrs["substeps"] > 8, "the mode of the last wrist is fast"
    np.testing.assert_allclose(ends[1], ends[0], atol=2e-4)


def test_teeth_leave_the_link_behind_the_motor(two_links):
    data = run(geared(two_links, "mujoco", **ELASTIC, backlash=0.01), 0.5)
    twist = np.abs(data["passive_position"].values - data["position"].values)
    assert 0.004 < twist.max() < 0.03


def test_a_schedule_changes_gears_and_robot(two_links):
    plant = geared(two_links, "mujoco", **ELASTIC)
    wear = ParameterSchedule(parameter="gearbox_backlash", times=[0.0, 0.1], values=[[0.0, 0.0], [0.04, 0.04]])
    load = tarc.signals.Payload(mass=1.0, start_time=0.1)
    worn = run(plant, disturbance=[wear, load])
    fresh = run(plant, disturbance=[load])
    light = run(plant)
    np.testing.assert_array_equal(worn["position"][:100], light["position"][:100])
    assert float(np.abs(worn["passive_position"] - fresh["passive_position"]).max()) > 0.01
    assert float(np.abs(light["position"] - fresh["position"]).max()) > 1e-4


def test_an_oracle_and_a_drive_see_the_motors(two_links):
    law = tarc.laws.TDC(
        inertia=[0.3, 0.15], natural_frequency=8.0, period=1e-3, estimator=tarc.estimators.TrueDerivatives()
    )
    ends = []
    for backend in ("symbolic", "mujoco"):
        plant = geared(two_links, backend, **ELASTIC)
        reference = Sinusoid(amplitude=[0.1, 0.1], frequency=4.0)
        drive = tarc.signals.Drive(time_constant=1e-3)
        data = tarc.simulate(plant, law, reference, 0.15, initial_torque="rest", drive=drive).data
        ends.append(data["position"].values)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-3)


def test_what_makes_no_gearbox_is_refused(two_links):
    plant = MujocoPlant.from_file(two_links)
    with pytest.raises(InvalidParameter, match=r"rotor inertia of two.xml is \[0.0, 0.0\]"):
        Gearbox(plant=plant, stiffness=1e3)
    geared_plant = Gearbox(plant=plant, **ELASTIC)
    with pytest.raises(InvalidParameter, match="needs a robot of tarc.plants"):
        Gearbox(plant=geared_plant.plant.joint_names)  # pyright: ignore[reportArgumentType]
    assert geared_plant.with_parameters({"gearbox_backlash": 0.01}).parameters["gearbox_backlash"] == pytest.approx(
        [0.01, 0.01]
    )
