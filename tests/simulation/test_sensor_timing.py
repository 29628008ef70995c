"""Jitter, stale readings and lost packets of the encoder, in both backends."""

import numpy as np
import pytest

from tarc import estimators, laws, plants, simulate
from tarc.scenario.model import Scenario
from tarc.signals import Encoder, Sinusoid

T = 1e-3
SENSOR = Encoder(noise=1e-6, timing_jitter=0.5, stale=0.05, packet_loss=0.05)


def run(backend: str):
    arm = plants.load_robot("ur5e", backend=backend, joints=["shoulder_pan_joint", "elbow_joint"], armature=0.1)
    reference = Sinusoid(amplitude=[0.4, 0.3], frequency=4.0, offset=arm.home)
    law = laws.PID(inertia=[1.0, 0.5], natural_frequency=10.0, period=T, estimator=estimators.Algebraic(window=0.020))
    options = {"initial_torque": "rest", "substeps": 8, "native": False, "progress": False, "seed": 4}
    return simulate(arm, law, reference, 0.5, sensor=SENSOR, **options)


def test_backends_agree_and_readings_are_those_of_the_clock():
    symbols, mujoco = run("symbolic").data, run("mujoco").data
    measured = symbols["measured_position"].values
    assert np.array_equal(np.isnan(measured), np.isnan(mujoco["measured_position"].values))
    assert np.nanmax(np.abs(measured - mujoco["measured_position"].values)) < 1e-4
    lost = np.isnan(measured)
    assert np.array_equal(lost, np.tile(lost[:, :1], (1, 2)))
    assert 0.02 < lost[:, 0].mean() < 0.09
    held = np.all(measured[1:] == measured[:-1], axis=1)
    assert 0.02 < held.mean() < 0.09
    # what is left is the motion a uniform age before
    velocity, position = symbols["velocity"].values, symbols["position"].values
    fresh = np.concatenate([[False], ~held]) & ~lost[:, 0] & (np.abs(velocity[:, 0]) > 0.1)
    age = (position - measured)[fresh, 0] / velocity[fresh, 0] / T
    assert age.min() > -0.03
    assert age.max() < 0.53
    assert np.mean(age) == pytest.approx(0.25, abs=0.03)


def test_certificates_name_these_effects_as_not_covered():
    scenario = Scenario.load("ur5e", ["sensor.packet_loss=0.1", "sensor.stale=0.05", "sensor.timing_jitter=0.2"])
    assert {"sensor.packet_loss", "sensor.stale", "sensor.timing_jitter"} <= set(scenario.not_certified)
