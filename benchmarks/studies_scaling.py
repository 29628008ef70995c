"""Studies from the command to the report: ``python -m benchmarks.studies_scaling``, or ``make bench-studies``.

The case is the two-link arm under TARC, with three drawn values, encoder noise and all measures, 10 s per run. Times
are of whole commands, with the start of Python and the report. The compiler has run before.
"""

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import machine
from benchmarks.measure import Row
from benchmarks.studies import STUDY
from tarc.scenario.yaml_text import write_yaml
from tarc.study import Study, StudyResult
from tarc.study.engines import ChunkResult
from tarc.study.store import open_store

CONTENT: dict[str, Any] = {**STUDY, "name": "two_link", "runs": 10_000, "sampling": "sobol", "traces": 0}
ENGINE = "--engine", "lanes"
LARGE_STORE = 1_000_000
"""Runs of the store that is opened."""
SHORT: dict[str, Any] = {"duration": 0.5, "metrics_start": 0.1}
"""What makes the runs of the largest study short."""
TENFOLD = 100, 1_000, 10_000, 100_000, 1_000_000
"""Their numbers."""
MEASURES = 12
"""Measures of each of its runs."""


class Command(NamedTuple):
    """What a command took: time [s], and peak memory of its process [MB]."""

    seconds: float
    memory: float


def study_file(folder: Path) -> Path:
    """Write the study."""
    file = folder / "two_link.yaml"
    file.write_text(write_yaml(CONTENT), encoding="utf-8")
    return file


def arguments(file: Path, out: Path, runs: int, *options: str) -> list[str]:
    """Return the command."""
    return [sys.executable, "-m", "tarc", "study", str(file), "--runs", str(runs), "--out", str(out), *ENGINE, *options]


def command(file: Path, out: Path, runs: int, *options: str) -> Command:
    """Run the command."""
    start = time.perf_counter()
    process = subprocess.Popen(arguments(file, out, runs, *options), stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"tarc study ended with {process.returncode}")
    return Command(time.perf_counter() - start, usage.ru_maxrss / 1024)


def sizes(folder: Path, runs: int) -> list[Row]:
    """Time per run and peak memory of studies of 1, 10 and 100 % of the runs."""
    file, rows = study_file(folder), []
    command(file, folder / "warm", 16, "--jobs", "1")
    results = [(n, command(file, folder / f"size-{n}", n, "--jobs", "1")) for n in (runs // 100, runs // 10, runs)]
    for n, result in results:
        rows.append(
            Row(
                f"{n} runs, one process",
                f"{result.seconds:.1f} s, {1e3 * result.seconds / n:.2f} ms per run, {result.memory:.0f} MB",
            )
        )
    (fewer, middle), (most, large) = results[1:]
    slope = (large.seconds - middle.seconds) / (most - fewer)
    first = (results[1][1].seconds - results[0][1].seconds) / (results[1][0] - results[0][0])
    rows.append(
        Row(
            "time of a further run: last tenfold step against the one before",
            f"{1e3 * slope:.2f} ms",
            f"{1e3 * first:.2f} ms",
            slope / first,
            "≤ 1.1",
            slope <= 1.1 * first,
        )
    )
    growth = large.memory - middle.memory
    rows.append(Row("memory: growth over the last tenfold step", f"{growth:.0f} MB", "", None, "≤ 30 MB", growth <= 30))
    return rows


def million(folder: Path, runs: int) -> list[Row]:
    """Studies of short runs, from a hundred to a million on all cores, and the store of the last one."""
    del runs
    file = folder / "short.yaml"
    content = {**CONTENT, "scenario": {**CONTENT["scenario"], **SHORT}}
    file.write_text(write_yaml(content), encoding="utf-8")
    command(file, folder / "warm-short", 16, "--jobs", "1")
    results = {n: command(file, folder / f"short-{n}", n) for n in TENFOLD}
    rows = [
        Row(
            f"{n} runs of {SHORT['duration']} s, all processes",
            f"{result.seconds:.1f} s, {result.memory:.0f} MB in the command's process",
        )
        for n, result in results.items()
    ]
    fewest, fewer, most = TENFOLD[0], TENFOLD[-2], TENFOLD[-1]
    slopes = {n: (results[n].seconds - results[fewest].seconds) / (n - fewest) for n in (fewer, most)}
    ratio = slopes[most] / slopes[fewer]
    rows.append(
        Row(
            f"time of a further run: up to {most} against up to {fewer}",
            f"{1e3 * slopes[most]:.3f} ms",
            f"{1e3 * slopes[fewer]:.3f} ms",
            ratio,
            "≤ 1.1",
            ratio <= 1.1,
        )
    )
    opened, read = open_times(folder / f"short-{most}")
    rows.append(
        Row(f"its store: opened; and one column read, {read:.2f} s", f"{opened:.2f} s", "", None, "≤ 1 s", opened <= 1)
    )
    return rows


def cores(folder: Path, runs: int) -> list[Row]:
    """Two processes against one: the whole study on all cores, and a further run of a study four times as long."""
    file = study_file(folder)
    command(file, folder / "warm-cores", 16, "--jobs", "1")
    sizes = runs, 4 * runs
    times = {
        (jobs, n): command(file, folder / f"{jobs}-{n}", n, "--jobs", str(jobs)).seconds
        for n in sizes
        for jobs in (1, 2)
    }
    same = same_results(folder / f"1-{runs}", folder / f"2-{runs}")
    whole = times[1, runs] / times[2, runs]
    one, two = ((times[jobs, sizes[1]] - times[jobs, runs]) / (sizes[1] - runs) for jobs in (1, 2))
    return [
        Row(
            f"{runs} runs, command to report: two processes against one",
            f"{times[2, runs]:.1f} s",
            f"{times[1, runs]:.1f} s",
            whole,
            "≤ 15 s",
            times[2, runs] <= 15,
        ),
        Row(
            f"a further run, from {sizes[1]} runs: two processes against one",
            f"{1e3 * two:.2f} ms",
            f"{1e3 * one:.2f} ms",
            one / two,
            "≥ 1.8",
            one >= 1.8 * two,
        ),
        Row("equal, bit for bit", str(same), "", None, "True", same),
    ]


def large_store(folder: Path, runs: int) -> list[Row]:
    """Write and open the store of a million runs with made-up results."""
    del runs
    study = Study.parse({**CONTENT, "runs": LARGE_STORE, "sampling": "independent"})
    rng, begin = np.random.default_rng(0), time.perf_counter()
    draws = study.draw()
    with open_store(folder / "large", study) as store:
        for chunk in store.pending(draws):
            shape = len(chunk.indices), 1
            measures = {f"measure_{number}": rng.random(shape) for number in range(MEASURES)}
            applied = {key: chunk.values[:, column] for column, key in enumerate(draws.keys)}
            store.write(chunk, draws, ChunkResult(measures, np.ones(shape, bool), np.full(shape, 10.0), applied))
    written = time.perf_counter() - begin
    opened, read = open_times(folder / "large")
    size = sum(file.stat().st_size for file in (folder / "large").rglob("*") if file.is_file()) / 1e6
    return [
        Row("store of 10^6 runs: written", f"{written:.0f} s, {size:.0f} MB"),
        Row("opened", f"{opened:.2f} s", "", None, "≤ 1 s", opened <= 1),
        Row("opened, and one column read", f"{read:.2f} s"),
    ]


def open_times(folder: Path) -> tuple[float, float]:
    """Return the time [s] in which a new process opens a complete study, and that with one column read."""
    code = (
        "import time; from tarc.study import StudyResult; begin = time.perf_counter();"
        f"result = StudyResult.open({str(folder)!r}); opened = time.perf_counter() - begin;"
        "assert result.is_complete; rate = float(result.data['completed'].mean());"
        "print(opened, time.perf_counter() - begin)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    opened, read = map(float, done.stdout.split())
    return opened, read


@contextmanager
def dask(module: str, *options: str) -> "Iterator[subprocess.Popen[bytes]]":
    """Run a scheduler or a worker, and end it."""
    process = subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{module}", *options, "--no-dashboard"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def start(file: Path, out: Path, runs: int, address: str) -> "subprocess.Popen[bytes]":
    """Start the command on a cluster."""
    return subprocess.Popen(arguments(file, out, runs, "--scheduler", address), stdout=subprocess.DEVNULL)


def wait_for_marks(process: "subprocess.Popen[bytes]", folder: Path, n_marks: int) -> None:
    """Wait until a study has finished some chunks."""
    marks = folder / "done"
    while process.poll() is None and (not marks.is_dir() or len(list(marks.iterdir())) < n_marks):
        time.sleep(0.02)


def same_results(first: Path, second: Path) -> bool:
    """Return whether two studies are complete and equal, bit for bit."""
    one, two = StudyResult.open(first), StudyResult.open(second)
    return one.is_complete and two.is_complete and one.data.load().identical(two.data.load())


def free_port() -> int:
    """Return a port that nobody has."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def killed(folder: Path, runs: int) -> list[Row]:
    """Kill one of two workers of a study; kill the scheduler of another one, and start it again."""
    file, n = study_file(folder), max(runs // 5, 64)
    command(file, folder / "undisturbed", n, "--jobs", "1")
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    scheduler_options = f"--port={port}", "--host=127.0.0.1"
    with (
        dask("scheduler", *scheduler_options),
        dask("worker", address, *WORKER),
        dask("worker", address, *WORKER) as victim,
    ):
        process = start(file, folder / "worker", n, address)
        wait_for_marks(process, folder / "worker", n // 32)
        victim.kill()
        worker_status = process.wait()
    same_worker = worker_status == 0 and same_results(folder / "undisturbed", folder / "worker")
    with dask("scheduler", *scheduler_options) as scheduler, dask("worker", address, *WORKER):
        process = start(file, folder / "scheduler", n, address)
        wait_for_marks(process, folder / "scheduler", n // 32)
        scheduler.kill()
        scheduler_status = process.wait()
    kept = StudyResult.open(folder / "scheduler").data.sizes["run"]
    with dask("scheduler", *scheduler_options), dask("worker", address, *WORKER):
        resumed = start(file, folder / "scheduler", n, address).wait()
    same_scheduler = resumed == 0 and same_results(folder / "undisturbed", folder / "scheduler")
    return [
        Row(
            f"{n} runs, one of two workers killed: equal, bit for bit", str(same_worker), "", None, "True", same_worker
        ),
        Row("scheduler killed: status, runs kept", f"{scheduler_status}, {kept} of {n}"),
        Row("started again: equal, bit for bit", str(same_scheduler), "", None, "True", same_scheduler),
    ]


WORKER = "--nthreads=1", "--no-nanny"
BENCHMARKS: dict[str, Callable[[Path, int], list[Row]]] = {
    "sizes": sizes,
    "million": million,
    "cores": cores,
    "large_store": large_store,
    "killed": killed,
}


def main() -> None:
    """Run some or all benchmarks and print one table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.studies_scaling", description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*BENCHMARKS, []], help="some of the benchmarks")
    parser.add_argument("--runs", type=int, default=CONTENT["runs"], help="runs of the largest study")
    options = parser.parse_args()
    table = Table("what", "measured", "against", "ratio", "target", "met", caption=machine())
    for name in options.names or list(BENCHMARKS):
        with tempfile.TemporaryDirectory() as folder:
            for row in BENCHMARKS[name](Path(folder), options.runs):
                ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
                met = "" if row.met is None else str(row.met)
                table.add_row(row.what, row.measured, row.against, ratio, row.target, met)
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
