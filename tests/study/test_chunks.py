import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import study_engines
from tarc.study import chunks as chunks_module
from tarc.study.chunks import FIRST_PART, PART_TIME, ChunkCollector, ChunkQueue, Pace


@settings(max_examples=30)
@given(
    n_runs=st.integers(1, 300),
    size=st.integers(1, 64),
    parts=st.lists(st.integers(1, 200), min_size=1, max_size=10),
)
def test_pieces_make_the_chunks_again_however_they_are_cut(n_runs: int, size: int, parts: list[int]):
    chunks = study_engines.chunks(n_runs, size)
    queue = ChunkQueue(chunks, n_runs)
    engine = study_engines.FakeEngine()
    taken = []
    while pieces := queue.take(parts[len(taken) % len(parts)]):
        taken.append(pieces)
    assert queue.remaining == 0
    assert [index for pieces in taken for piece in pieces for index in piece.runs[0]] == list(range(n_runs))
    collector = ChunkCollector()
    results = {}
    for pieces in taken[::-1]:
        for piece in pieces:
            complete = collector.add(piece, engine.run(*piece.runs))
            if complete is not None:
                results[piece.chunk.number] = complete
    found, truth = study_engines.arrays(results), study_engines.expected(n_runs, size)
    assert all(np.array_equal(found[name], truth[name]) for name in truth)


def test_a_part_has_pieces_of_one_chunk_or_whole_chunks():
    queue = ChunkQueue(study_engines.chunks(40, 8), 40)
    assert [piece.n_runs for piece in queue.take(5)] == [5]
    assert [piece.n_runs for piece in queue.take(20)] == [3, 8, 8]
    assert [piece.n_runs for piece in queue.take(100)] == [8, 8]
    assert queue.take(1) == []


@pytest.mark.parametrize(("run_time", "runs"), [(1e-3, 496), (1e-2, 48), (0.055, 8), (0.25, 2), (10.0, 1)])
def test_a_part_takes_about_its_time(run_time: float, runs: int):
    pace = Pace()
    assert pace.part_size(10**6, 2) == FIRST_PART
    pace.update(8, 1.0)
    pace.update(8, 8 * run_time)
    assert pace.part_size(10**6, 2) == runs
    assert runs * run_time <= max(PART_TIME, run_time)


def test_parts_get_smaller_towards_the_end():
    pace = Pace()
    pace.update(8, 8e-3)
    pace.update(8, 8e-3)
    sizes, remaining = [], 4000
    while remaining > 0:
        sizes.append(min(remaining, pace.part_size(remaining, 2)))
        remaining -= sizes[-1]
    assert sizes[0] == 496
    assert max(sizes[-8:]) <= 2 * FIRST_PART
    assert sizes == sorted(sizes, reverse=True)
    assert all(size % FIRST_PART == 0 for size in sizes)


def test_time_of_a_run_follows_the_newest_parts():
    pace = Pace()
    for seconds in (80.0, 8.0, 1.0, 1.0, 1.0, 1.0, 1.0):
        pace.update(8, seconds)
    assert pace.run_time == pytest.approx(0.125 + 0.875 * chunks_module.NEWEST_SHARE**5)


def test_a_measure_that_no_run_of_a_piece_has_is_nan():
    (chunk,) = study_engines.chunks(16, 16)
    queue, collector = ChunkQueue([chunk], 16), ChunkCollector()
    early, late = queue.take(8), queue.take(8)
    result = study_engines.FakeEngine().run(*late[0].runs)
    assert collector.add(late[0], result) is None
    joined = collector.add(early[0], dataclasses.replace(result, measures={}))
    assert joined is not None
    assert np.isnan(joined.measures["rms_error"][:8]).all()
    assert np.array_equal(joined.measures["rms_error"][8:], result.measures["rms_error"])
