"""Logs of simulated robots whose parameters are known, and of a real one."""

from pathlib import Path

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter, NotIdentifiable
from tarc.logs.identified_model import identify_model, inertia_from_log
from tarc.plants import load_robot
from tarc.signals import Encoder, RobotLog

T = 0.001
N = 6
PANDA = Path(__file__).parents[3] / "shared" / "data" / "panda"
PANDA_COLUMNS = {
    "time": "exciting_traj_time.txt",
    "position": "exciting_traj_positions.txt",
    "torque": "exciting_traj_torques.txt",
}
TRUTH = {
    "armature": np.array([0.4, 0.35, 0.3, 0.08, 0.07, 0.06]),
    "viscous": np.array([2.0, 1.5, 1.0, 0.4, 0.3, 0.2]),
    "coulomb": np.array([5.0, 4.0, 3.0, 1.0, 0.8, 0.6]),
}
LOAD = 1.3
DELAY = 0.004
NOISE = 5e-6


@pytest.fixture(scope="module")
def log():
    """Record of a UR5e with rotors, friction and a load that its file does not know, torques 4 ms ahead."""
    arm = load_robot("ur5e").with_parameters({**TRUTH, "payload": LOAD, "coulomb_width": np.full(N, 0.03)})
    reference = tarc.design.excitation_reference(arm.home, duration=10.0, amplitude=0.5, band=(2.0, 18.0), tones=2)
    law = tarc.laws.TDC(
        inertia=0.3 * np.diag(np.diag(arm.inertia(arm.home))),
        natural_frequency=20.0,
        period=T,
        estimator=tarc.estimators.Algebraic(window=0.010),
        synchronised=True,
    )
    data = tarc.simulate(arm, law, reference, 10.0, sensor=Encoder(noise=NOISE), initial_torque="rest").data
    late = round(DELAY / T)
    torque = data["torque"].values
    return RobotLog(
        times=data["time"].values[:-late], position=data["measured_position"].values[:-late], torque=torque[late:]
    )


@pytest.fixture(scope="module")
def found(log):
    return identify_model(log, "ur5e", links=False, progress=False)


@pytest.mark.parametrize("name", ["armature", "viscous", "coulomb"])
def test_rotors_and_friction_are_found_within_their_intervals(found, name):
    interval = getattr(found, name)
    np.testing.assert_allclose(interval.value, TRUTH[name], rtol=0.1)
    half = (interval.high - interval.low) / 2
    assert np.all(np.abs(interval.value - TRUTH[name]) < 2 * half + 0.02 * TRUTH[name])


def test_load_delay_and_noise_are_found(found):
    assert float(found.payload.value) == pytest.approx(LOAD, rel=0.02)
    # a torque that is held over a period acts half a period later on average
    assert float(found.actuation_delay.value) == pytest.approx(DELAY + T / 2, abs=0.2 * T)
    np.testing.assert_allclose(found.encoder_noise.value, NOISE, rtol=0.1)


def test_the_identified_model_explains_the_torque_and_the_file_does_not(found):
    assert not found.has_links
    assert np.all(found.explained > 0.98)
    assert np.all(found.explained_by_file < 0.95)
    assert found.inertia_ratio[1] > 1.2
    assert found.design_options()[0].startswith("--armature 0.")


def test_a_record_without_torques_and_other_robots_are_refused(log):
    bare = RobotLog(times=log.times, position=log.position)
    with pytest.raises(NotIdentifiable, match="it has no torques"):
        identify_model(bare, "ur5e")
    with pytest.raises(InvalidParameter, match="needs a robot from a file in symbols with the 6 joints"):
        identify_model(log, "panda")
    with pytest.raises(InvalidParameter, match="TwoLinkArm; needs a robot from a file in symbols"):
        identify_model(log, tarc.plants.TwoLinkArm())
    with pytest.raises(NotIdentifiable, match="needs 400: record for longer"):
        identify_model(log, "ur5e", stop_time=0.3)


@pytest.fixture(scope="module")
def panda():
    if not PANDA.is_dir():
        pytest.skip(f"no record of the Panda at {PANDA}")
    return identify_model(PANDA, "panda", columns=PANDA_COLUMNS, progress=False)


@pytest.mark.slow
def test_the_real_panda_is_explained_on_a_part_that_was_not_used(panda):
    assert np.all(panda.explained[:6] > 0.95)
    assert np.all(panda.explained > panda.explained_by_file)
    assert any("rotor inertia below zero" in remark for remark in panda.remarks())


@pytest.mark.slow
def test_the_real_panda_says_why_its_record_does_not_show_the_inertia():
    if not PANDA.is_dir():
        pytest.skip(f"no record of the Panda at {PANDA}")
    with pytest.raises(NotIdentifiable, match=r"move in 1\d directions, and 14 would tell inertia from gravity"):
        inertia_from_log(PANDA, columns=PANDA_COLUMNS)


def test_inertia_without_a_file(log):
    arm = load_robot("ur5e").with_parameters({"armature": TRUTH["armature"], "payload": LOAD})
    found = inertia_from_log(RobotLog(times=log.times[4:], position=log.position[4:], torque=log.torque[:-4]))
    mean = arm.mean_inertia(log.position[::500].T)
    np.testing.assert_allclose(np.diag(found.inertia)[:4], np.diag(mean)[:4], rtol=0.3)
