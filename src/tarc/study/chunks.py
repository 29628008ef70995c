"""Chunks of runs: cut into parts of about equal time, and put together again."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.core.types import Array
from tarc.study.engines import ChunkResult

FIRST_PART = 8
"""Runs of the first part, whose time is measured: as many as the widest vector has lanes."""

PART_TIME = 0.5
"""Time that one part is to take [s]."""

PARTS_LEFT = 4
"""Parts per worker into which the remaining runs are cut at least, so that all workers end at about the same time."""

NEWEST_SHARE = 0.5
"""Share of the newest part in the mean time of a run."""


class Chunk(NamedTuple):
    """Runs that are stored together.

    Attributes
    ----------
    number
        Number of the chunk in the store.
    indices, values, seeds
        Numbers of the runs, drawn values (runs, keys) and seeds, as an engine takes them.
    """

    number: int
    indices: Array
    values: Array
    seeds: Array

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.indices)


@dataclass(frozen=True, eq=False)
class Piece:
    """Runs of a chunk that one worker runs.

    Attributes
    ----------
    chunk
        The chunk.
    start, stop
        First row in it, and the one after the last.
    """

    chunk: Chunk
    start: int
    stop: int

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return self.stop - self.start

    @property
    def runs(self) -> tuple[Array, Array, Array]:
        """Indices, values and seeds of the runs, as an engine takes them."""
        rows = slice(self.start, self.stop)
        return self.chunk.indices[rows], self.chunk.values[rows], self.chunk.seeds[rows]


class ChunkQueue:
    """Hands out the runs of chunks in order, as many at a time as the caller wants.

    Parameters
    ----------
    chunks
        Chunks that are to be run.
    n_runs
        Number of their runs.
    """

    def __init__(self, chunks: Iterable[Chunk], n_runs: int):
        self._chunks = iter(chunks)
        self._chunk: Chunk | None = None
        self._row = 0
        self.remaining = n_runs

    def take(self, n_runs: int) -> list[Piece]:
        """Return about ``n_runs`` runs: a piece of one chunk, or several whole chunks; an empty list at the end."""
        pieces: list[Piece] = []
        while n_runs > 0:
            self._chunk = self._chunk or next(self._chunks, None)
            if self._chunk is None:
                break
            stop = min(self._row + n_runs, self._chunk.n_runs)
            whole = stop == self._chunk.n_runs
            if pieces and not whole:
                break
            piece = Piece(self._chunk, self._row, stop)
            pieces.append(piece)
            n_runs -= piece.n_runs
            self.remaining -= piece.n_runs
            self._row = 0 if whole else stop
            self._chunk = None if whole else self._chunk
        return pieces


class ChunkCollector:
    """Puts the results of pieces together, and returns that of a chunk when its last piece has come."""

    def __init__(self) -> None:
        self._results: dict[int, list[tuple[Piece, ChunkResult]]] = {}

    def add(self, piece: Piece, result: ChunkResult) -> ChunkResult | None:
        """Keep the result of a piece; return that of its chunk where it is complete, else None."""
        results = self._results.setdefault(piece.chunk.number, [])
        results.append((piece, result))
        if sum(present.n_runs for present, _ in results) < piece.chunk.n_runs:
            return None
        del self._results[piece.chunk.number]
        results.sort(key=lambda pair: pair[0].start)
        return _join([result for _, result in results])


def _join(results: list[ChunkResult]) -> ChunkResult:
    """Return the results of pieces as those of a chunk."""
    if len(results) == 1:
        return results[0]
    first = results[0]
    names = dict.fromkeys(name for result in results for name in result.measures)
    return ChunkResult(
        measures={name: np.concatenate([_measure(result, name) for result in results]) for name in names},
        completed=np.concatenate([result.completed for result in results]),
        end_time=np.concatenate([result.end_time for result in results]),
        applied={key: np.concatenate([result.applied[key] for result in results]) for key in first.applied},
    )


def _measure(result: ChunkResult, name: str) -> Array:
    """Return a measure, which is NaN where all runs ended before it begins."""
    missing = np.full(result.completed.shape, np.nan)
    return result.measures.get(name, missing)


class Pace:
    """Time that a run takes, measured as parts finish, and the number of runs of the next part."""

    def __init__(self) -> None:
        self.run_time = np.nan
        """Mean time of a run [s]; NaN before the first part."""
        self._n_parts = 0

    def update(self, n_runs: int, seconds: float) -> None:
        """Take a part's runs and their time [s] into the mean; the first, which warms up, counts until the second."""
        run_time = max(seconds, 1e-9) / n_runs
        if self._n_parts < 2:
            self.run_time = run_time
        else:
            self.run_time += NEWEST_SHARE * (run_time - self.run_time)
        self._n_parts += 1

    @property
    def is_sure(self) -> bool:
        """Whether the mean has more than the first part, or this took long."""
        return self._n_parts > 1 or FIRST_PART * self.run_time > PART_TIME

    def part_size(self, remaining: int, n_workers: int) -> int:
        """Return the runs of the next part: about `PART_TIME` of work, less towards the end of the study.

        Multiples of `FIRST_PART`, so that no lanes of a vector idle, unless that many runs take longer than two parts.
        """
        if np.isnan(self.run_time) or not self.is_sure:
            return FIRST_PART
        share = -(-remaining // (PARTS_LEFT * n_workers))
        n_runs = max(1, min(int(PART_TIME / self.run_time), share))
        if FIRST_PART * self.run_time > 2 * PART_TIME:
            return n_runs
        return max(FIRST_PART, n_runs - n_runs % FIRST_PART)
