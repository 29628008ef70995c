"""The robot in a second process: the same motion as in a simulation, and what happens where it stalls or ends."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import tarc
from live_robots import ARM_FILE
from tarc.core.errors import InvalidParameter
from tarc.runtime import LiveRun, MujocoRobot, SimulatedClock, StartUp, run_live
from tarc.runtime.log import Log
from tarc.runtime.log_format import ENDED_BY_FORCE, Phase

PERIOD = 1e-3
REFERENCE = tarc.signals.Sinusoid(amplitude=[0.3, 0.4], frequency=[3.0, 4.0], phase=np.pi / 2)


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> tarc.plants.MujocoPlant:
    file = tmp_path_factory.mktemp("arm") / "arm.xml"
    file.write_text(ARM_FILE)
    return tarc.plants.MujocoPlant.from_file(file)


def law(**changes: Any) -> tarc.laws.TDC:
    parameters: dict[str, Any] = {"torque_limit": [40.0, 20.0], "max_missing": 100_000} | changes
    return tarc.laws.TDC(
        inertia=[0.03, 0.006],
        natural_frequency=15.0,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.010),
        **parameters,
    )


def test_in_step_the_motion_is_that_of_mujoco_under_the_torques_that_were_written(arm, tmp_path):
    with MujocoRobot(arm, PERIOD, in_step=True) as robot:
        assert robot.joint_names == ("shoulder", "elbow")
        result = run_live(
            law(),
            robot,
            REFERENCE,
            0.3,
            clock=SimulatedClock(),
            start_up=StartUp(ramp_time=0.3),
            log=tmp_path / "log.nc",
            label="arm",
            scenario={"law": "TDC"},
            certificate={"verdict": "certified"},
            native=False,
        )
    data = result.load().data
    model = arm.copy_model()
    model.opt.timestep = PERIOD
    bare = mujoco.MjData(model)
    bare.qpos[:] = arm.home
    moving = np.flatnonzero(np.any(np.abs(np.diff(data["position"].values, axis=0)) > 0, axis=1))
    for k in range(moving[0], int(np.flatnonzero(data["phase"] == Phase.STOP)[0])):
        np.testing.assert_array_equal(bare.qpos, data["position"].values[k])
        bare.qfrc_applied[:] = data["torque"].values[k]
        mujoco.mj_step(model, bare)
    check_log(result)


def check_log(result: LiveRun) -> None:
    """Check that the log is a run."""
    run = result.load()
    assert run.title == "TDC on arm"
    assert run.data.sizes == {"time": result.n_periods, "joint": 2}
    assert run.data["joint"].values.tolist() == ["shoulder", "elbow"]
    np.testing.assert_allclose(run.data["time"], PERIOD * np.arange(result.n_periods))
    np.testing.assert_array_equal(run.data["torque_limit"], [40.0, 20.0])
    assert run.data["torque"].attrs["units"] == "N m"
    attributes = run.data.attrs
    assert attributes["ended"] == "completed"
    assert attributes["duration"] == pytest.approx(result.n_periods * PERIOD)
    assert '"certified"' in attributes["certificate"]
    metrics = run.metrics(float(attributes["tracking_start"]))
    assert metrics["rms_error"] < 0.01
    assert run.status.completed
    assert set(run.data.data_vars) >= {"measured_position", "velocity_estimate", "lateness", "overrun", "phase"}


@pytest.mark.parametrize(
    ("udp", "harm"),
    [
        (0, signal.SIGKILL),
        (None, signal.SIGSTOP),
        pytest.param(None, signal.SIGKILL, marks=pytest.mark.slow),
        pytest.param(0, signal.SIGSTOP, marks=pytest.mark.slow),
    ],
)
def test_a_peer_that_stalls_or_ends_leads_to_a_safe_stop_and_the_log_survives(arm, tmp_path, udp, harm):
    watchdog = 0.3
    with MujocoRobot(arm, PERIOD, udp=udp, watchdog=5.0) as robot:
        write, torques = robot.write, []

        def write_and_harm(torque):
            write(torque)
            torques.append(torque.copy())
            if len(torques) == 300:
                os.kill(robot.process.pid, harm)

        robot.write = write_and_harm
        result = run_live(law(), robot, REFERENCE, 30.0, watchdog=watchdog, log=tmp_path / "log.nc", native=False)
    assert "watchdog" in result.ended
    data = result.load().data
    assert data.attrs["ended"] == result.ended
    measured = np.isfinite(data["measured_position"].values[:, 0])
    last_sample = data["period_start"].values[measured][-1]
    stopped = np.flatnonzero(data["phase"].values == Phase.SAFE_STOP)
    # the last period before the watchdog's time is that of the stop, or the first one after a loop that was late
    before = data["period_start"].values[stopped[0] - 1]
    assert np.isnan(before) or before - last_sample <= watchdog - PERIOD + 1e-9
    np.testing.assert_array_equal(data["torque"].values[stopped], 0)


@pytest.mark.slow
def test_udp_and_shared_memory_run_in_real_time(arm):
    for udp in (None, 0):
        with MujocoRobot(arm, PERIOD, udp=udp, watchdog=5.0) as robot:
            result = run_live(law(), robot, REFERENCE, 0.2, watchdog=5.0, start_up=StartUp(ramp_time=0.2), native=False)
        assert result.ended == "completed"
        assert result.counts["malformed"] == 0
        assert len(result.lateness) == result.n_periods - result.overruns
        assert np.all(np.diff(result.percentiles()["lateness"]) >= 0)
        counts, edges = result.histogram()
        assert len(edges) == len(counts) + 1


@pytest.mark.slow
def test_a_loop_that_stands_still_gets_its_brakes_closed(arm):
    with MujocoRobot(arm, PERIOD, watchdog=30.0) as robot:
        read, calls = robot.read, []

        def stuck() -> np.ndarray:
            calls.append(0)
            if len(calls) == 300:
                time.sleep(1.5)
            return read()

        robot.read = stuck
        result = run_live(law(), robot, REFERENCE, 30.0, watchdog=0.5, native=False)
    assert result.ended == "the loop stood still for longer than the watchdog's time"


@pytest.mark.slow
def test_a_log_survives_its_loop(arm, tmp_path):
    """Also where the loop's process is killed."""
    (tmp_path / "arm.xml").write_text(ARM_FILE)
    program = """
        import numpy as np, tarc
        from tarc.runtime import MujocoRobot, run_live
        arm = tarc.plants.MujocoPlant.from_file("arm.xml")
        law = tarc.laws.TDC(inertia=[0.03, 0.006], natural_frequency=15.0, period=1e-3, torque_limit=40.0,
                            estimator=tarc.estimators.Algebraic(window=0.010), max_missing=100_000)
        reference = tarc.signals.Sinusoid(amplitude=[0.3, 0.4], frequency=[3.0, 4.0])
        robot = MujocoRobot(arm, 1e-3, watchdog=5.0)
        run_live(law, robot, reference, 60.0, watchdog=5.0, log="log.nc", native=False,
                 on_log=lambda _: print("started", flush=True))
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    time.sleep(0.7)
    process.kill()
    process.wait()
    process.stdout.close()
    run = finished_log(tmp_path / "log.nc")
    assert run.data.attrs["ended"] == ENDED_BY_FORCE
    assert run.data.sizes["time"] > 100


def finished_log(file: Path) -> tarc.Run:
    """Return the log, once its process has finished it."""
    end = time.monotonic() + 20
    while time.monotonic() < end:
        time.sleep(0.1)
        try:
            run = tarc.Run.load(file)
        except InvalidParameter:  # still being written
            continue
        if "duration" in run.data.attrs:
            return run
    pytest.fail("the log was not finished")


def test_a_run_goes_on_without_the_writer_of_its_log(arm, tmp_path):
    def kill(log: Log) -> None:
        assert log._process is not None
        log._process.kill()

    options = {"clock": SimulatedClock(), "native": False, "log": tmp_path / "log.nc", "on_log": kill}
    with MujocoRobot(arm, PERIOD, in_step=True) as robot:
        result = run_live(law(), robot, REFERENCE, 0.1, start_up=StartUp(ramp_time=0.3), **options)
    assert result.ended == "completed"
    assert result.facts["log"] == "its process failed: it says nothing"


@pytest.mark.slow
def test_a_process_that_cannot_listen_is_refused(arm):
    with MujocoRobot(arm, PERIOD, udp=0) as first:
        port = first._transport._peer[1]  # type: ignore[attr-defined]
        with pytest.raises(InvalidParameter, match=f"cannot listen at .*{port}"):
            MujocoRobot(arm, PERIOD, udp=port)


def test_robots_that_are_not_from_a_file_are_refused():
    with pytest.raises(InvalidParameter, match="which is not from a file"):
        MujocoRobot(tarc.plants.Pendulum(), PERIOD)


def test_a_log_without_a_folder_is_refused(arm, tmp_path):
    with MujocoRobot(arm, PERIOD, in_step=True) as robot, pytest.raises(InvalidParameter, match="log: got"):
        run_live(law(), robot, REFERENCE, 0.1, log=tmp_path / "no" / "log.nc", clock=SimulatedClock(), native=False)
