"""Ctrl-C during a study on several processes: the message, no process left behind, and the same bits after resuming."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from swing_study import SCENARIO, STUDY
from tarc.scenario.yaml_text import write_yaml
from tarc.study.specification import Study

CONTENT = {
    **STUDY,
    "scenario": {**SCENARIO, "duration": 1.0},
    "draws": {**STUDY["draws"], "sensor.noise": {"uniform": [0.0, 1e-4]}},
    "runs": 1800,
    "traces": 0,
}
COMMAND = """
import signal
import time
from concurrent.futures import wait
from contextlib import contextmanager

from tarc.cli.main import main
from tarc.study import scheduling

signal.signal(signal.SIGINT, signal.default_int_handler)  # processes in a shell's background start without Ctrl-C


@contextmanager
def started(*options):
    with starting_cluster(*options) as starting:
        wait([starting])
        yield starting


def slowly(*arguments):
    for finished in run(*arguments):
        yield finished
        time.sleep(0.3)


scheduling.SERIAL_TIME = 0.0
run, scheduling._run = scheduling._run, slowly
starting_cluster, scheduling.starting_cluster = scheduling.starting_cluster, started
main()
"""
"""The command, with processes that run the study from its first part on, and slow enough for a signal in its midst."""
ENGINE = "virtual machine"


def wait_for_marks(folder: Path, n_marks: int) -> None:
    """Wait until chunks are finished."""
    for _ in range(2400):
        if folder.is_dir() and len(list(folder.iterdir())) >= n_marks:
            return
        time.sleep(0.05)
    raise AssertionError("no chunk was finished in two minutes")


def is_gone(group: int) -> bool:
    """Return whether all processes of a group end within two minutes."""
    for _ in range(1200):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_finished_and_the_rest_follows(tmp_path):
    (tmp_path / "study.yaml").write_text(write_yaml(CONTENT), encoding="utf-8")
    arguments = "study", "study.yaml", "--engine", ENGINE, "--jobs", "2"
    with subprocess.Popen(
        [sys.executable, "-c", COMMAND, *arguments],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        # the command computes while its workers start, and a fast machine is done before they are all there
        wait_for_marks(tmp_path / "runs" / "swings.study" / "done", 4)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to the workers as well
        _, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    *before, last = errors.splitlines()
    assert all(line.startswith("2 processes; dashboard") for line in before)
    assert last.startswith("interrupted: ")
    assert last.endswith("the same command goes on from there")
    assert is_gone(process.pid)

    study = Study.load(tmp_path / "study.yaml")
    finished = int(last.split()[1])
    assert 32 <= finished < CONTENT["runs"]
    resumed = study.run(tmp_path / "runs" / "swings.study", engine=ENGINE, jobs=1)
    undisturbed = study.run(tmp_path / "undisturbed", engine=ENGINE, jobs=1)
    assert resumed.is_complete
    assert resumed.data.load().identical(undisturbed.data.load())
