"""`tarc run-live`: a run on the robot of a second process, and what it refuses."""

import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from rich.console import Console
from typer.testing import CliRunner

import tarc
from live_robots import ARM_FILE
from tarc.cli.live_display import Display
from tarc.cli.main import app
from tarc.core.errors import InvalidParameter
from tarc.runtime.ring import Ring

SCENARIO = {
    "name": "arm",
    "robot": {"file": "arm.xml"},
    "law": {
        "kind": "TDC",
        "inertia": [0.03, 0.006],
        "natural_frequency": 15.0,
        "torque_limit": [40.0, 20.0],
        "max_missing": 100000,
    },
    "estimator": {"kind": "Algebraic", "window": 0.01},
    "reference": {"kind": "Sinusoid", "amplitude": [0.1, 0.1], "frequency": 3.0, "phase": 1.5707963},
    "duration": 0.3,
    "initial_torque": "rest",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.xml").write_text(ARM_FILE)
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(SCENARIO))
    return tmp_path


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tarc", "run-live", "arm.yaml", "--watchdog", "5", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_a_run_is_shown_in_lines_and_ends_with_its_percentiles(folder: Path):
    done = call(folder, "--duration", "1.5", "--push", "0.1")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "track" in done.stdout
    assert "completed" in done.stdout
    assert "99.9 %" in done.stdout
    assert "periods missed" in done.stdout
    run = tarc.Run.load(folder / "runs" / "arm" / "TDC-live.nc")
    assert run.data.attrs["ended"] == "completed"
    assert json.loads(run.data.attrs["scenario"])["law"] == "TDC"
    assert len(json.loads(run.data.attrs["push"])) == 2


@pytest.mark.slow
def test_ctrl_c_lets_the_robot_come_to_rest(folder: Path):
    command = [sys.executable, "-m", "tarc", "run-live", "arm.yaml", "--watchdog", "5", "--duration", "60"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    while "track" not in process.stdout.readline():
        pass
    os.kill(process.pid, signal.SIGINT)
    text = process.stdout.read()
    assert process.wait() == 0
    process.stdout.close()
    assert "stopped on request" in text
    data = tarc.Run.load(folder / "runs" / "arm" / "TDC-live.nc").data
    np.testing.assert_allclose(data["velocity_reference"].values[-1], 0, atol=1e-9)


@pytest.mark.slow
def test_results_as_json(folder: Path):
    done = call(folder, "--json", "--robot", "mujoco:udp", "--log", "log.nc")
    result = json.loads(done.stdout)
    assert result["ended"] == "completed"
    assert len(result["lateness"]) == len(result["percentiles"]) == 5
    assert (folder / "log.nc").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--robot", "gazebo"], "needs mujoco, mujoco:udp or udp://host:port"),
        (["--robot", "udp://nowhere"], r"needs udp://host:port"),
        (["--error-limit", "-1"], "needs one number above 0"),
    ],
)
def test_bad_options(folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str):
    monkeypatch.chdir(folder)
    result = CliRunner().invoke(app, ["run-live", "arm.yaml", *arguments])
    assert isinstance(result.exception, InvalidParameter)
    assert message in str(result.exception)


def test_the_display_shows_the_newest_row(tmp_path: Path):
    names = ("phase", "lateness", "measured_position", "reference", "torque")
    starts = {"phase": (1, 1), "lateness": (2, 1), "measured_position": (3, 2), "reference": (5, 2), "torque": (7, 2)}
    head = {
        "variables": [{"name": name, "start": starts[name][0], "size": starts[name][1]} for name in names],
        "joint_names": ["shoulder", "elbow"],
        "position_unit": "rad",
        "torque_unit": "N m",
        "period": 1e-3,
    }
    ring = Ring.create(tmp_path / "ring", 4, 9)
    display = Display(head, ring)
    assert "waiting" in str(display.table().title)
    ring.append(np.array([1500.0, 3.0, 25e-6, 0.1, 0.2, 0.1, 0.203, -4.0, 1.0]))
    values = display.values()
    assert values is not None
    line = display.line(values)
    assert "1.50 s  track" in line
    assert "error 3.000 mrad  torque 4.00 N m  late 25 µs" in line
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(display.table())
    shown = console.export_text()
    for text in ("position [rad]", "error [mrad]", "torque [N m]", "0.2000", "-3.000"):
        assert text in shown
