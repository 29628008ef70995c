"""Engines of studies that compute little, as the tests of the scheduling need them; workers import them from here."""

import ctypes
import os
import signal
import time
from collections.abc import Container, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tarc.core.codegen import compiled_library
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.study.chunks import Chunk
from tarc.study.engines import ChunkResult
from tarc.study.scheduling import run_chunks

FACTORS = np.array([1.0, 3.0])
"""One per law."""


@dataclass(frozen=True)
class FakeEngine:
    """Measures that follow from seed and drawn value by numbers of the seed's own stream.

    Attributes
    ----------
    run_time
        Time of a run [s].
    kill_once
        A file: the process that finds it not there makes it, and kills itself in the middle of a chunk.
    bad_run
        Number of a run that raises an error.
    deadly_run
        Number of a run that kills its process.
    """

    run_time: float = 0.0
    kill_once: Path | None = None
    bad_run: int = -1
    deadly_run: int = -1
    name = "virtual machine"

    def run(self, indices: Array, values: Array, seeds: Array) -> ChunkResult:
        """Run a chunk."""
        if self.bad_run in indices:
            raise InvalidParameter(f"robot.payload: run {self.bad_run} drew 1, applied 2")
        if self.deadly_run in indices or (self.kill_once is not None and _first(self.kill_once)):
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(self.run_time * len(indices))
        noise = np.array([np.random.default_rng(int(seed)).standard_normal(5).sum() for seed in seeds])
        error = np.sin(values[:, :1] + noise[:, None]) * FACTORS
        return ChunkResult(
            measures={"rms_error": error},
            completed=error < 2.0,
            end_time=np.full(error.shape, 1.0),
            applied={"robot.payload": values[:, 0], "law.natural_frequency": values[:, :1] * FACTORS},
        )


class CompiledFakeEngine(FakeEngine):
    """The same with three times the measures in machine code."""

    def run(self, indices: Array, values: Array, seeds: Array) -> ChunkResult:
        """Run a chunk."""
        library = ctypes.CDLL(str(compiled_library("double triple(double x) { return 3.0 * x; }\n")))
        library.triple.restype = ctypes.c_double
        library.triple.argtypes = [ctypes.c_double]
        result = super().run(indices, values, seeds)
        result.measures["rms_error"][:] = np.vectorize(library.triple)(result.measures["rms_error"])
        return result


@dataclass(frozen=True)
class Recipe:
    """Makes the fake engine: what is pickled for the workers."""

    engine: FakeEngine = FakeEngine()

    def __call__(self) -> FakeEngine:
        """Return the engine."""
        return self.engine


def _first(file: Path) -> bool:
    try:
        file.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def chunks(n_runs: int, size: int) -> list[Chunk]:
    """Return the chunks of a study with one drawn key."""
    indices = np.arange(n_runs)
    values = np.random.default_rng(0).random((n_runs, 1))
    seeds = np.random.default_rng(1).integers(2**63, size=n_runs)
    parts = [slice(start, start + size) for start in range(0, n_runs, size)]
    return [Chunk(number, indices[part], values[part], seeds[part]) for number, part in enumerate(parts)]


def run(
    engine: FakeEngine, n_runs: int, size: int, skip: Container[int] = (), **options: Any
) -> Iterator[tuple[int, ChunkResult]]:
    """Run the study but for some chunks; yield numbers of chunks and their results."""
    left = [chunk for chunk in chunks(n_runs, size) if chunk.number not in skip]
    with closing(run_chunks(engine, Recipe(engine), left, sum(chunk.n_runs for chunk in left), **options)) as results:
        for chunk, result in results:
            yield chunk.number, result


def arrays(results: dict[int, ChunkResult]) -> dict[str, Array]:
    """Return the results of chunks as arrays over all runs."""
    ordered = [results[number] for number in sorted(results)]
    names = {
        "rms_error": [result.measures["rms_error"] for result in ordered],
        "completed": [result.completed for result in ordered],
        "end_time": [result.end_time for result in ordered],
        **{key: [result.applied[key] for result in ordered] for key in ordered[0].applied},
    }
    return {name: np.concatenate(parts) for name, parts in names.items()}


def expected(n_runs: int, size: int) -> dict[str, Array]:
    """Return what the study must give, computed at once."""
    engine = FakeEngine()
    return arrays(
        {chunk.number: engine.run(chunk.indices, chunk.values, chunk.seeds) for chunk in chunks(n_runs, size)}
    )
