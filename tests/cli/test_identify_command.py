"""`tarc identify`: its tables, files and refusals."""

import json

import numpy as np
import pytest

from tarc.logs.model_check import model_torque
from tarc.plants import load_robot
from tarc_command import run_tarc

ARMATURE = [0.4, 0.35, 0.3, 0.08, 0.07, 0.06]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a log of a UR5e with rotors and a load, without noise."""
    place = tmp_path_factory.mktemp("log")
    arm = load_robot("ur5e", armature=ARMATURE).with_parameters({"payload": 0.7})
    times = 0.002 * np.arange(2500)
    tones = np.linspace(1.0, 3.1, 6) * np.array([[1.0], [2.37]])
    phases = times[:, None, None] * tones
    q = arm.home + np.sum(0.3 * np.sin(phases), axis=1)
    dq = np.sum(0.3 * tones * np.cos(phases), axis=1)
    ddq = np.sum(-0.3 * tones**2 * np.sin(phases), axis=1)
    columns = [*(f"q{i + 1}" for i in range(6)), *(f"tau{i + 1}" for i in range(6))]
    table = np.column_stack([times, q, model_torque(arm, q, dq, ddq)])
    np.savetxt(place / "log.csv", table, delimiter=",", header=",".join(["time", *columns]), comments="")
    return place


def test_table_and_numbers(folder):
    done = run_tarc("identify", "log.csv", "ur5e", "--no-links", cwd=folder)
    assert "load at the tool: 0.7 ±" in done.stdout
    assert "design: tarc design ur5e --armature" in done.stdout
    done = run_tarc("identify", "log.csv", "ur5e", "--no-links", "--json", cwd=folder)
    found = json.loads(done.stdout)
    assert found["armature"]["value"] == pytest.approx(ARMATURE, rel=0.02)
    assert found["actuation_delay"]["value"] == pytest.approx(0.0, abs=2e-5)


def test_a_motion_that_does_not_show_the_inertia(folder):
    error = run_tarc("identify", "log.csv", cwd=folder, status=2).stderr
    assert error.startswith("error: ")
