"""Studies on Dask: worker processes of this machine, and a scheduler with workers that are started by hand."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import nullcontext
from itertools import islice
from pathlib import Path
from typing import Any

import dask.config
import numpy as np
import pytest
from distributed import Client

import study_engines
from study_engines import CompiledFakeEngine, FakeEngine
from tarc.core.errors import ClusterError, InvalidParameter
from tarc.core.types import Array
from tarc.study import scheduling
from tarc.study.cluster import local_cluster

pytestmark = [
    pytest.mark.slow,
    # Dask leaves a socket open where the port of its dashboard is taken
    pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
ROOT = Path(__file__).resolve().parents[2]
RUNS, SIZE = 512, 32


class HandMadeCluster:
    """A scheduler and workers, each a process of its own."""

    def __init__(self, folder: Path, port: int = 0):
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._start("distributed.cli.dask_scheduler", f"--port={port}", "--no-dashboard")
        self.address = self.wait_for("Scheduler at:")[0].split()[-1]
        self.port = int(self.address.rpartition(":")[2])

    def _start(
        self, module: str, *arguments: str, path: Path = ROOT / "src", **variables: str
    ) -> "subprocess.Popen[bytes]":
        environment = {**os.environ, **variables, "PYTHONPATH": os.pathsep.join([str(path), str(ROOT / "tests")])}
        command = [sys.executable, "-m", module, *arguments]
        with (self.folder / f"{len(self.processes)}.log").open("wb") as log:
            process = subprocess.Popen(command, cwd=self.folder, env=environment, stdout=log, stderr=log)
        self.processes.append(process)
        return process

    def wait_for(self, text: str, times: int = 1) -> list[str]:
        """Return the lines of the scheduler's log with a text, when there are enough."""
        log = ""
        for _ in range(1200):
            log = (self.folder / "0.log").read_text()
            lines = [line for line in log.splitlines() if text in line]
            if len(lines) >= times:
                return lines
            time.sleep(0.1)
        raise AssertionError(log)

    def add_worker(self, *arguments: str, path: Path = ROOT / "src", **variables: str) -> "subprocess.Popen[bytes]":
        """Start one that has one thread and no dashboard."""
        options = "--nthreads=1", "--no-dashboard", f"--local-directory={self.folder}"
        return self._start("distributed.cli.dask_worker", self.address, *options, *arguments, path=path, **variables)

    def stop(self) -> None:
        """End all processes."""
        for process in self.processes[::-1]:
            process.terminate()
        for process in self.processes:
            try:
                process.wait(2)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[HandMadeCluster]:
    made = HandMadeCluster(tmp_path)
    yield made
    made.stop()


@pytest.fixture(scope="module")
def truth() -> dict[str, Array]:
    return study_engines.expected(RUNS, SIZE)


def study(engine: FakeEngine, **options: Any) -> tuple[dict[str, Array], list[str]]:
    """Run the study; return its arrays and the messages."""
    messages: list[str] = []
    results = study_engines.run(engine, RUNS, SIZE, notify=messages.append, **options)
    return study_engines.arrays(dict(results)), messages


def equal(found: dict[str, Array], truth: dict[str, Array]) -> bool:
    return found.keys() == truth.keys() and all(np.array_equal(found[name], truth[name]) for name in truth)


@pytest.fixture(scope="module")
def two_processes() -> Iterator[Client]:
    with dask.config.set({"distributed.scheduler.allowed-failures": 1}), local_cluster(2, print) as client:
        yield client


@pytest.fixture
def on_two_processes(monkeypatch, two_processes: Client) -> dict[str, int]:
    monkeypatch.setattr(scheduling, "SERIAL_TIME", 0.0)
    started: Future[Client] = Future()
    started.set_result(two_processes)
    monkeypatch.setattr(scheduling, "starting_cluster", lambda *_: nullcontext(started))
    return {"jobs": 2}


def test_two_processes_give_the_same_bits(on_two_processes, truth):
    found, _ = study(FakeEngine(), **on_two_processes)
    assert equal(found, truth)


def test_a_script_is_not_run_again_in_the_processes(tmp_path):
    """It needs no ``if __name__ == "__main__"``."""
    script = tmp_path / "script.py"
    lines = [
        "import study_engines",
        "from tarc.study import scheduling",
        "scheduling.SERIAL_TIME = 0.0",
        "print(len(dict(study_engines.run(study_engines.FakeEngine(), 256, 32, jobs=2))))",
    ]
    script.write_text("\n".join(lines), encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT / "tests")])}
    command = [sys.executable, str(script)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=600)
    assert done.stdout == "8\n", done.stderr


def test_a_killed_process_costs_a_second_try(on_two_processes, tmp_path, truth):
    (tmp_path / "killed").touch()
    engine = FakeEngine(run_time=2e-3, kill_once=tmp_path / "killed")
    results = study_engines.run(engine, RUNS, SIZE, **on_two_processes)
    found = dict(islice(results, 1))
    (tmp_path / "killed").unlink()
    found |= dict(results)
    assert (tmp_path / "killed").exists()
    assert equal(study_engines.arrays(found), truth)


def test_an_error_of_the_engine_comes_from_a_worker(on_two_processes):
    with pytest.raises(InvalidParameter, match="run 300 drew 1, applied 2"):
        study(FakeEngine(bad_run=300), **on_two_processes)


def test_runs_that_kill_every_worker_end_the_study(on_two_processes):
    with pytest.raises(ClusterError, match="2 workers died on them.*perhaps for lack of memory"):
        study(FakeEngine(deadly_run=300), **on_two_processes)


def test_workers_by_hand_one_killed_another_late(cluster, tmp_path, truth):
    cluster.add_worker()
    cluster.add_worker("--no-nanny")
    cluster.wait_for("Register worker", 2)
    found, messages = study(FakeEngine(run_time=2e-3, kill_once=tmp_path / "killed"), scheduler=cluster.address)
    assert equal(found, truth)
    assert (tmp_path / "killed").exists()
    assert messages[0].startswith(f"cluster {cluster.address}; dashboard: http://")


def test_scheduler_killed_and_started_again(cluster, truth):
    worker = cluster.add_worker()
    engine = FakeEngine(run_time=5e-3)
    stored = {}
    results = study_engines.run(engine, RUNS, SIZE, scheduler=cluster.address)
    stored.update(islice(results, 3))
    cluster.scheduler.kill()
    with pytest.raises(ClusterError, match="lost the connection .* repeat the command"):
        stored.update(results)
    assert 3 <= len(stored) < RUNS // SIZE
    worker.wait(300)
    cluster.folder = cluster.folder / "again"
    cluster.folder.mkdir()
    again = HandMadeCluster(cluster.folder, cluster.port)
    try:
        again.add_worker()
        left = dict(study_engines.run(engine, RUNS, SIZE, skip=stored, scheduler=again.address))
    finally:
        again.stop()
    assert not stored.keys() & left.keys()
    assert equal(study_engines.arrays(stored | left), truth)


def test_machine_code_is_sent_to_a_worker_without_compiler(cluster, tmp_path, monkeypatch, truth):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "here"))
    engine = CompiledFakeEngine()
    engine.run(*study_engines.chunks(1, 1)[0][1:])
    cluster.add_worker("--no-nanny", CC="/no/compiler", XDG_CACHE_HOME=str(tmp_path / "there"))
    found, _ = study(engine, scheduler=cluster.address)
    assert np.array_equal(found["rms_error"], 3.0 * truth["rms_error"])
    assert not (tmp_path / "there").exists()


def test_worker_with_another_version(cluster):
    other = cluster.folder / "other"
    shutil.copytree(ROOT / "src" / "tarc", other / "tarc")
    file = other / "tarc" / "core" / "version.py"
    file.write_text(file.read_text() + '__version__ = "0.0.9"\n')
    cluster.add_worker("--no-nanny", path=other)
    cluster.wait_for("Register worker")
    with pytest.raises(InvalidParameter, match=r"has other software: tarc-control 0\.0\.9, source .* there, .* here"):
        study(FakeEngine(), scheduler=cluster.address)


@pytest.mark.parametrize("late", [False, True])
def test_worker_without_the_package(cluster, late):
    empty = cluster.folder / "empty"
    (empty / "tarc").mkdir(parents=True)
    (empty / "tarc" / "__init__.py").touch()
    cluster.add_worker("--no-nanny", path=empty)
    if not late:
        cluster.wait_for("Register worker")
    with pytest.raises(InvalidParameter, match=r"cannot import the package .* pip install 'tarc-control\[study\]'"):
        study(FakeEngine(), scheduler=cluster.address)
