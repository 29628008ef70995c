"""`simulate` warns of a reference or a start beyond the limits of a joint, with joint, limit, value and time."""

import warnings

import numpy as np
import pytest

import tarc
import urdf_text
from law_catalogue import make_tdc

GANTRY = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0"> <flag contact="disable"/> </option>
  <worldbody>
    <body>
      <joint name="rail" type="slide" axis="1 0 0" range="-0.5 0.5"/>
      <geom type="box" size="0.1 0.1 0.1" mass="2"/>
      <body>
        <joint name="swivel" axis="0 0 1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
STOPS = {"MujocoPlant": "MuJoCo simulates the stops", "RigidBody": "stops at the ends are not simulated in symbols"}


@pytest.fixture(params=STOPS)
def plant(request, tmp_path):
    (tmp_path / "gantry.xml").write_text(GANTRY)
    load = tarc.plants.MujocoPlant.from_file if request.param == "MujocoPlant" else tarc.plants.load_robot
    loaded = load(tmp_path / "gantry.xml")
    assert type(loaded).__name__ == request.param
    return loaded


def swing(rail):
    return tarc.signals.Sinusoid(amplitude=[rail, 3.0], frequency=np.pi)


def run(plant, reference, duration=1.0, **options):
    return tarc.simulate(plant, make_tdc(inertia=[0.15, 0.002]), reference, duration, **options)


def test_a_reference_beyond_the_range_is_named_with_its_value_and_time(plant):
    message = (
        r"reference of joint rail leaves its range from -0.5 to 0.5 m at 0.215 s, and is farthest off at 0.5 s "
        rf"with 0.8 m\. .*{STOPS[type(plant).__name__]}"
    )
    with pytest.warns(tarc.JointLimitWarning, match=message) as caught:
        found = run(plant, swing(0.8))
    assert caught[0].filename == __file__
    assert "swivel" not in str(caught[0].message)
    assert found.data.sizes["time"] > 0


def test_a_start_beyond_the_range_is_named(plant):
    with pytest.warns(tarc.JointLimitWarning, match=r"initial position of joint rail .* -0.5 to 0.5 m: -0.6 m at 0 s"):
        run(plant, swing(0.1), 0.01, initial_position=[-0.6, 0.0])


def test_no_warning_within_the_range_and_at_its_ends(plant):
    with warnings.catch_warnings():
        warnings.simplefilter("error", tarc.JointLimitWarning)
        run(plant, swing(0.5), 0.6)


def test_a_scenario_warns_too(tmp_path):
    (tmp_path / "gantry.xml").write_text(GANTRY)
    content = {
        "robot": {"file": str(tmp_path / "gantry.xml")},
        "law": {"kind": "TDC", "inertia": [0.15, 0.002], "natural_frequency": 10.0},
        "estimator": {"kind": "Algebraic", "window": 0.010},
        "reference": {"kind": "Sinusoid", "amplitude": [0.8, 0.3], "frequency": 1.0, "phase": 1.5708},
        "duration": 0.05,
    }
    with pytest.warns(tarc.JointLimitWarning, match="reference of joint rail leaves its range .* at 0 s"):
        tarc.Scenario.parse(content).run()


def limited_arm(folder, attributes):
    limit = f'<limit lower="-2" upper="2" effort="80" {attributes}/>'
    path = folder / "arm.urdf"
    path.write_text(
        urdf_text.arm(
            shoulder=urdf_text.joint("shoulder", "base", "upper", inside=limit),
            elbow=urdf_text.joint("elbow", "upper", "fore", inside=limit),
        )
    )
    return path


def limit_warnings(plant, reference, **options):
    law = make_tdc(inertia=0.1 * plant.inertia(plant.home))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tarc.simulate(plant, law, reference, 1.0, **options)
    return [str(warning.message) for warning in caught if warning.category is tarc.JointLimitWarning]


@pytest.mark.parametrize("backend", ["symbolic", "mujoco"])
def test_velocity_and_acceleration_limits_of_a_file_are_checked_in_one_warning(backend, tmp_path):
    path = limited_arm(tmp_path, 'velocity="3" acceleration="10"')
    plant = tarc.plants.load_robot(path, backend=backend)
    assert plant.acceleration_limits.tolist() == [10.0, 10.0]
    reference = tarc.signals.Sinusoid(amplitude=[0.2, 1.5], frequency=np.pi, phase=np.pi / 2)
    (text,) = limit_warnings(plant, reference)
    assert "shoulder" not in text
    assert (
        "the reference of joint elbow exceeds its velocity limit of 3 rad/s at 0.22 s, and most at 0.5 s with "
        "-4.712 rad/s; the reference of joint elbow exceeds its acceleration limit of 10 rad/s² at 0 s, and most at "
        "0 s with -14.8 rad/s². The run has no limits of velocity and acceleration" in text
    )


def test_deceleration_limits_hold_while_a_joint_slows_down(tmp_path):
    """q = sin(2t): it slows down until π/4 s with q̈ = −4 sin 2t, and speeds up again to −4 sin 2t at the most."""
    reference = tarc.signals.Sinusoid(amplitude=[0.0, 1.0], frequency=2.0)
    plant = tarc.plants.load_robot(limited_arm(tmp_path, 'velocity="5" acceleration="10" deceleration="2"'))
    assert plant.acceleration_limits.tolist() == [10.0, 10.0]
    assert plant.deceleration_limits.tolist() == [2.0, 2.0]
    (text,) = limit_warnings(plant, reference)
    assert "elbow exceeds its deceleration limit of 2 rad/s² at 0.262 s, and most at 0.785 s with -4 rad/s²" in text
    assert "its acceleration limit" not in text
    plant = tarc.plants.load_robot(limited_arm(tmp_path, 'velocity="5" acceleration="3" deceleration="10"'))
    (text,) = limit_warnings(plant, reference)
    assert "elbow exceeds its acceleration limit of 3 rad/s² at 0.786 s" in text
    assert "deceleration limit" not in text
    plant = tarc.plants.load_robot(limited_arm(tmp_path, 'velocity="5" acceleration="3"'))
    assert plant.deceleration_limits.tolist() == [3.0, 3.0], "that of acceleration holds for both"
    (text,) = limit_warnings(plant, reference)
    assert "elbow exceeds its acceleration limit of 3 rad/s² at 0.425 s" in text


@pytest.mark.parametrize("backend", ["symbolic", "mujoco"])
def test_jerk_limits_hold_between_samples(backend, tmp_path):
    """The jerk of sin(2t) is −8 cos 2t, largest at the start."""
    plant = tarc.plants.load_robot(limited_arm(tmp_path, 'velocity="5" jerk="6"'), backend=backend)
    assert plant.jerk_limits.tolist() == [6.0, 6.0]
    (text,) = limit_warnings(plant, tarc.signals.Sinusoid(amplitude=[0.0, 1.0], frequency=2.0))
    assert "elbow exceeds its jerk limit of 6 rad/s³ at 0 s, and most at 0 s with -8 rad/s³" in text
    assert not limit_warnings(plant, tarc.signals.Sinusoid(amplitude=[0.0, 0.7], frequency=2.0))


def test_given_acceleration_limits_replace_those_of_the_file(tmp_path):
    plant = tarc.plants.load_robot(limited_arm(tmp_path, 'velocity="5"'))
    assert np.all(np.isinf(plant.acceleration_limits))
    reference = tarc.signals.Sinusoid(amplitude=[0.2, 1.5], frequency=np.pi, phase=np.pi / 2)
    assert limit_warnings(plant, reference) == []
    (text,) = limit_warnings(plant, reference, acceleration_limits=[1.0, 20.0])
    assert "shoulder exceeds its acceleration limit of 1 rad/s² at 0 s" in text
    assert "elbow" not in text
    with pytest.raises(tarc.core.errors.InvalidParameter, match="acceleration_limits: .* needs one number or 2"):
        limit_warnings(plant, reference, acceleration_limits=[1.0, 2.0, 3.0])


def test_units_of_a_slide_and_a_scenario_s_limits(tmp_path):
    (tmp_path / "gantry.xml").write_text(GANTRY)
    content = {
        "robot": {"file": str(tmp_path / "gantry.xml")},
        "law": {"kind": "TDC", "inertia": [0.15, 0.002], "natural_frequency": 10.0},
        "estimator": {"kind": "Algebraic", "window": 0.010},
        "reference": {"kind": "Sinusoid", "amplitude": [0.4, 0.3], "frequency": 1.0, "phase": 1.5708},
        "acceleration_limits": 0.35,
        "duration": 0.05,
    }
    with pytest.warns(
        tarc.JointLimitWarning, match="joint rail exceeds its acceleration limit of 0.35 m/s² at 0 s"
    ) as c:
        tarc.Scenario.parse(content).run()
    assert "swivel" not in str(c[0].message)
