"""`simulate` warns of a reference or a start that leaves the range of a joint, with joint, range, value and time."""

import warnings

import numpy as np
import pytest

import tarc
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
    with pytest.warns(tarc.JointRangeWarning, match=message) as caught:
        found = run(plant, swing(0.8))
    assert caught[0].filename == __file__
    assert "swivel" not in str(caught[0].message)
    assert found.data.sizes["time"] > 0


def test_a_start_beyond_the_range_is_named(plant):
    with pytest.warns(tarc.JointRangeWarning, match=r"initial position of joint rail .* -0.5 to 0.5 m: -0.6 m at 0 s"):
        run(plant, swing(0.1), 0.01, initial_position=[-0.6, 0.0])


def test_no_warning_within_the_range_and_at_its_ends(plant):
    with warnings.catch_warnings():
        warnings.simplefilter("error", tarc.JointRangeWarning)
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
    with pytest.warns(tarc.JointRangeWarning, match="reference of joint rail leaves its range .* at 0 s"):
        tarc.Scenario.parse(content).run()
