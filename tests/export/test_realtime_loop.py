"""The loop in C, against the robot in MuJoCo over UDP."""

import os
import re
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import tarc
from live_robots import ARM_FILE
from tarc.cli.main import app
from tarc.core.errors import InvalidParameter
from tarc.export import export_c
from tarc.export.verification import BASE_FLAGS, WARNINGS
from tarc.runtime import MujocoRobot
from tarc.runtime.packets import Kind, encode
from tarc.runtime.transports import UdpTransport
from tarc.signals import read_log

PERIOD = 1e-3
QUICK = ["-DRAMP_TIME=0.3", "-DHOLD_TIME=0.05", "-DSTOP_TIME=0.1", "-DMAX_ERROR=0.5"]
NAMES = ("shoulder", "elbow")
CC = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")

pytestmark = pytest.mark.skipif(CC is None, reason="no C compiler")


def folder_of(root: Path, **changes: Any) -> Path:
    law = tarc.laws.TDC(
        inertia=[0.03, 0.006],
        natural_frequency=15.0,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.010),
        torque_limit=[40.0, 20.0],
        max_missing=100_000,
        safe_torque="hold",
    )
    reference = tarc.signals.Sinusoid(amplitude=[0.1, 0.2], frequency=[3.0, 4.0])
    options: dict[str, Any] = {"name": "arm", "joint_names": NAMES, "parts": True, "reference": reference} | changes
    export_c(law, root, realtime=True, **options)
    return root


def compiled(root: Path, *flags: str, reference: bool = True) -> Path:
    sources = ["../src/arm.c", *(["../src/arm_parts.c"] if reference else [])]
    command = [str(CC), *BASE_FLAGS, *WARNINGS, "-Werror", "-O1", *flags, "-I../src", "loop.c", *sources, "-lm"]
    subprocess.run([*command, "-o", "loop"], cwd=root / "realtime", check=True)
    return root / "realtime" / "loop"


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    return folder_of(tmp_path_factory.mktemp("loop"))


@pytest.fixture
def arm(tmp_path) -> tarc.plants.MujocoPlant:
    (tmp_path / "arm.xml").write_text(ARM_FILE)
    return tarc.plants.MujocoPlant.from_file(tmp_path / "arm.xml")


def test_commands_of_inner_loops_have_no_loop(tmp_path):
    with pytest.raises(InvalidParameter, match=r"realtime: .* in rad, and the loop writes torques"):
        folder_of(tmp_path, commands=["rad", "rad"], parts=False, reference=None)


def port_of(robot: MujocoRobot) -> str:
    """Return the port of the robot, and leave it to the loop in C."""
    return str(robot.release_port())


def started(command: list[str]) -> "subprocess.Popen[str]":
    """Start the loop; return it when it has met the robot and catches Ctrl-C."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    while not (line := process.stdout.readline()).startswith("scheduler: "):
        assert line, "the loop ended before it met the robot"
    return process


def test_it_compiles_without_warnings_in_both_precisions(exported, tmp_path):
    compiled(exported)
    compiled(folder_of(tmp_path, real="float", parts=False, reference=None, joint_names=()), reference=False)


@pytest.mark.slow
def test_its_makefile_builds_it(exported):
    if shutil.which("make"):
        subprocess.run(["make", "-C", str(exported / "realtime"), f"CC={CC}"], check=True, capture_output=True)


def test_it_runs_for_a_second_on_mujoco_and_writes_a_log(exported, arm, tmp_path):
    loop = compiled(exported, *QUICK, "-DWATCHDOG=10.0", "-DLOG_PERIODS=300L")
    log = tmp_path / "log.csv"
    with MujocoRobot(arm, PERIOD, udp=0, watchdog=5.0) as robot:
        command = [str(loop), "127.0.0.1", port_of(robot), "0.5", "0", str(log)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "completed" in done.stdout
    assert " 0 packets malformed" in done.stdout
    assert "scheduler: " in done.stdout
    recorded = read_log(log)
    assert recorded.position.shape == (300, 2)
    assert recorded.torque is not None
    assert recorded.reference is not None
    assert np.nanmax(np.abs(recorded.position - recorded.reference)) < 0.5
    assert np.max(np.abs(recorded.torque)) <= 40.0


def test_it_says_what_left_the_certified_range_and_that_a_log_cannot_be_written(arm, tmp_path):
    root = folder_of(tmp_path, watch=tarc.Watch(n_joints=2, tube=1e-6, speed=1e3, period=PERIOD))
    loop = compiled(root, "-DRAMP_TIME=0.05", "-DHOLD_TIME=0.02", "-DSTOP_TIME=0.02", "-DWATCHDOG=2.0")
    with MujocoRobot(arm, PERIOD, udp=0, watchdog=5.0) as robot:
        command = [str(loop), "127.0.0.1", port_of(robot), "0.05", "0", str(tmp_path / "none" / "log.csv")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "cannot write the log" in done.stderr
    assert re.search(r"left what was certified: error( timing)?$", done.stdout, re.MULTILINE)


@pytest.mark.slow
def test_a_robot_that_stalls_is_a_safe_stop(exported, arm):
    loop = compiled(exported, *QUICK, "-DWATCHDOG=0.3")
    with MujocoRobot(arm, PERIOD, udp=0, watchdog=5.0) as robot:
        command = [str(loop), "127.0.0.1", port_of(robot), "30"]
        process = started(command)
        os.kill(robot.process.pid, signal.SIGSTOP)
        text, _ = process.communicate(timeout=300)
    assert process.returncode == 3
    assert "no sample came for the time of the watchdog" in text


@pytest.mark.slow
def test_ctrl_c_lets_it_come_to_rest(exported, arm):
    loop = compiled(exported, *QUICK, "-DWATCHDOG=10.0")
    with MujocoRobot(arm, PERIOD, udp=0, watchdog=20.0) as robot:
        process = started([str(loop), "127.0.0.1", port_of(robot), "30"])
        process.send_signal(signal.SIGINT)
        text, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    assert "stopped on request" in text


@pytest.mark.slow
def test_joints_in_another_order_are_refused(tmp_path, arm):
    loop = compiled(folder_of(tmp_path / "other", joint_names=("elbow", "shoulder")), *QUICK)
    with MujocoRobot(arm, PERIOD, udp=0) as robot:
        done = subprocess.run(
            [str(loop), "127.0.0.1", port_of(robot), "1"], capture_output=True, text=True, check=False
        )
    assert done.returncode == 1
    assert "another order" in done.stderr


@pytest.mark.slow
def test_it_ignores_and_counts_nonsense(exported):
    """Packets of a robot in this test: valid ones, changed ones, and none of the first kind in the end."""
    loop = compiled(exported, *QUICK, "-DWATCHDOG=0.2", "-DBRAKE_TIME=0.02")
    robot = UdpTransport(None, ("127.0.0.1", 0))
    process = subprocess.Popen([str(loop), "127.0.0.1", str(robot.port), "30"], stdout=subprocess.PIPE, text=True)
    rng = np.random.default_rng(0)
    sequence = 0
    while process.poll() is None:
        for _ in robot.receive():
            sequence += 1
            if sequence == 1:
                robot.send(encode(Kind.NAMES, 0, 0.0, names=NAMES))
            data = encode(Kind.STATE, sequence, 0.0, [np.zeros(2), np.zeros(2)])
            robot.send(data if sequence < 100 else rng.bytes(int(rng.integers(0, 100))))
    text = process.communicate()[0]
    robot.close()
    assert process.returncode == 3
    assert re.search(r" [1-9]\d* packets malformed", text)


def test_the_command_writes_it_with_the_reference_of_the_scenario(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["export", "c", "train_two_link", "--realtime", "-o", "arm"])
    assert done.exit_code == 0, done.output
    assert "arm_reference((real)time" in (tmp_path / "arm" / "realtime" / "loop.c").read_text()
    refused = CliRunner().invoke(app, ["export", "ros2", "train_two_link", "--realtime"])
    assert isinstance(refused.exception, InvalidParameter)
    assert "--realtime: only with the format c" in str(refused.exception)
