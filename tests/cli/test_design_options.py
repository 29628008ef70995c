"""Options of `tarc design` become requirements."""

import inspect
from types import SimpleNamespace
from typing import Any

import numpy as np

from tarc.cli.design import design, workspace_of
from tarc.cli.design_options import requirements_of


def options(**given):
    """Every option at its default, but the given ones."""
    parameters = inspect.signature(design).parameters.values()
    own = (
        "robot",
        "out",
        "joints",
        "armature",
        "viscous",
        "coulomb",
        "tool",
        "trajectory",
        "tube",
        "stress_test",
        "as_json",
        "figures",
    )
    defaults = {
        p.name: p.default for p in parameters if p.name not in (*own, "balance_inertia", "home", "lock", "actuators")
    }
    return {**defaults, **given}


def test_the_encoder_is_given_by_bits_or_by_its_step_per_joint():
    assert requirements_of(options()).sensor.bits == 17
    assert requirements_of(options(encoder_bits="20")).sensor.bits == 20
    np.testing.assert_array_equal(requirements_of(options(encoder_bits="20,17")).sensor.bits, [20, 17])
    sensor = requirements_of(options(encoder_resolution="5e-6,2e-5")).sensor
    assert sensor.bits is None
    np.testing.assert_array_equal(sensor.step_size, [5e-6, 2e-5])


def test_numbers_per_joint_and_the_rate():
    requirements = requirements_of(options(speed="1,2", control_rate=500.0, payload=(0.0, 2.0), law="tdc"))
    assert requirements.speed == [1.0, 2.0]
    assert requirements.period == 0.002
    assert requirements.law == "TDC"


def test_the_model_and_its_intervals():
    requirements = requirements_of(options(model="known", armature_error=0.2, friction_width="0.05,0.1"))
    assert requirements.model == "known"
    assert requirements.armature_error == 0.2
    assert requirements.friction_width == [0.05, 0.1]
    assert requirements_of(options()).model == "none"


def test_a_trajectory_with_velocities_may_be_csv_or_yaml(tmp_path):
    (tmp_path / "motion.csv").write_text("time,a,a/velocity\n0,0.1,0\n2,0.7,0\n", encoding="utf-8")
    (tmp_path / "motion.yaml").write_text(
        "joint_names: [a]\npoints:\n"
        "  - {positions: [0.1], velocities: [0], time_from_start: {sec: 0, nanosec: 0}}\n"
        "  - {positions: [0.7], velocities: [0], time_from_start: {sec: 2, nanosec: 0}}\n",
        encoding="utf-8",
    )
    arm: Any = SimpleNamespace(joint_names=["a"])
    spaces = [workspace_of(tmp_path / f"motion.{kind}", 0.05, arm) for kind in ("csv", "yaml")]
    for space in spaces:
        assert space.speed is not None
        np.testing.assert_allclose(space.speed, 1.2 * 0.45, rtol=0.01)
