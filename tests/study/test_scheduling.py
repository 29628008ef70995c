import re
import socket
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager

import numpy as np
import pytest

import study_engines
from study_engines import FakeEngine, Recipe
from tarc.core.errors import ClusterError, InvalidParameter, MissingTool
from tarc.study import scheduling
from tarc.study.scheduling import check_place, run_chunks
from tarc.study.software import check_same_software, software


def test_one_job_gives_every_chunk_once_and_counts_the_runs():
    counted: list[int] = []
    results = list(study_engines.run(FakeEngine(), 100, 16, jobs=1, advance=counted.append))
    assert [number for number, _ in results] == list(range(7))
    assert sum(counted) == 100
    found, truth = study_engines.arrays(dict(results)), study_engines.expected(100, 16)
    assert all(np.array_equal(found[name], truth[name]) for name in truth)


def test_a_short_study_starts_no_processes(monkeypatch):
    monkeypatch.delattr(scheduling, "starting_cluster")
    assert len(list(study_engines.run(FakeEngine(), 64, 16, jobs=4))) == 4


@contextmanager
def cluster_that_starts(attempts: list[None]) -> "Iterator[Future[object]]":
    """Count the attempts, and start nothing."""
    starting: Future[object] = Future()
    attempts.append(None)
    yield starting


def test_this_process_runs_parts_while_others_start(monkeypatch):
    attempts: list[None] = []
    monkeypatch.setattr(scheduling, "SERIAL_TIME", 0.0)
    monkeypatch.setattr(scheduling, "starting_cluster", lambda *_: cluster_that_starts(attempts))
    results = dict(study_engines.run(FakeEngine(), 200, 16, jobs=2))
    assert len(attempts) == 1
    assert np.array_equal(study_engines.arrays(results)["rms_error"], study_engines.expected(200, 16)["rms_error"])


def test_no_chunks():
    assert list(run_chunks(FakeEngine(), Recipe(), [], 0, jobs=1)) == []


def test_an_error_of_the_engine_comes_through():
    results = study_engines.run(FakeEngine(bad_run=20), 64, 8, jobs=1)
    with pytest.raises(InvalidParameter, match="run 20 drew 1, applied 2"):
        list(results)


@pytest.mark.parametrize("jobs", [0, -1, 1.5])
def test_jobs_below_one(jobs):
    with pytest.raises(InvalidParameter, match="jobs: got"):
        run_chunks(FakeEngine(), Recipe(), [], 0, jobs=jobs)


def test_jobs_beside_a_scheduler():
    with pytest.raises(InvalidParameter, match="leave jobs out"):
        run_chunks(FakeEngine(), Recipe(), [], 0, jobs=2, scheduler="tcp://127.0.0.1:1")


def test_several_jobs_need_dask(monkeypatch):
    monkeypatch.setattr("tarc.core.optional.is_installed", lambda module: module != "distributed")
    with pytest.raises(MissingTool, match=r"more than one job needs distributed; pip install .*\[study\]'"):
        run_chunks(FakeEngine(), Recipe(), [], 0, jobs=2)


def test_without_dask_a_study_says_that_it_has_one_process(monkeypatch):
    monkeypatch.setattr(scheduling, "is_installed", lambda module: False)
    monkeypatch.setattr(scheduling, "n_cores", lambda: 8)
    monkeypatch.setattr(scheduling, "SERIAL_TIME", 0.0)
    messages: list[str] = []
    results = list(study_engines.run(FakeEngine(), 64, 8, notify=messages.append))
    assert len(results) == 8
    assert ["Dask is not installed" in message for message in messages] == [True]


def test_versions_that_differ_are_named_with_the_worker():
    ours = software()
    check_same_software("tcp://w", {name: ours[name] for name in list(ours)[:2]}, ours)
    with pytest.raises(InvalidParameter, match=r"tcp://w has other software: numpy 1\.0 there, .* here; install"):
        check_same_software("tcp://w", {**ours, "numpy": "1.0"}, ours)


@pytest.mark.parametrize(
    "address", ["10.0.0.5:8786", "tcp://10.0.0.5", "tcp://10.0.0.5:many", "http://10.0.0.5:8786", "tcp://:8786"]
)
def test_what_is_no_address(address):
    with pytest.raises(InvalidParameter, match=rf"got '{re.escape(address)}'; needs an address such as tcp://"):
        check_place(None, address)


def test_an_address_where_nobody_listens():
    with socket.socket() as reserved:  # and does not listen
        reserved.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{reserved.getsockname()[1]}"
        with pytest.raises(ClusterError, match=f"no answer from {address} .*refused.*`dask scheduler`"):
            check_place(None, address)
