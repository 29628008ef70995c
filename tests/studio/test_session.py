"""A session that moves for a long time."""

import asyncio
import gc
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nicegui")

from nicegui import core

from tarc.core.allocator import release_freed_memory
from tarc.studio.design_state import DesignState
from tarc.studio.robots import Robots
from tarc.studio.session import Session
from tarc.studio.worker import FACTS, LOOPS, RUNS

MOVES = 25
MEGABYTES = 3.0
"""Growth of memory by `MOVES` moves that is allowed; the runs of all of them would take ten times that."""
SLOW = 1.0
"""Time that the robot and the runs of another session take [s]."""
OBJECTS_PER_MOVE = 2
"""Objects that a move may leave: its design stays for undo."""


def held() -> float:
    """Return the memory of a process that no file backs [MB]."""
    gc.collect()
    release_freed_memory()
    lines = Path("/proc/self/status").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1024


async def held_by_all() -> float:
    """Return that of this process and of those that compute for it [MB]."""
    own = Path(__file__).stem
    return held() + sum([await worker.compute(f"{own}:held") for worker in (FACTS, LOOPS, RUNS)])


async def move(session: Session, number: int) -> None:
    """Change the design and wait for its loop and its runs."""
    seen = {topic: asyncio.Event() for topic in ("loop", "runs")}
    listeners = [(topic, event.set) for topic, event in seen.items()]
    for topic, listener in listeners:
        session.listen(topic, listener)
    session.change(
        natural_frequency=10.0 + number % 7,
        window=6 + number % 5,
        payload=float(number % 3),
        law=("TDC", "TARC")[number % 2],
    )
    await asyncio.gather(*(event.wait() for event in seen.values()))
    for topic, listener in listeners:
        session._listeners[topic].remove(listener)


async def assert_map_is_first(session: Session, *slow: Coroutine[Any, Any, None]) -> None:
    """Move the design, and see its map before another session has its robot and its runs."""
    tasks = [asyncio.create_task(work) for work in slow]
    await asyncio.sleep(0)  # they are on their way
    seen = asyncio.Event()
    session.listen("loop", seen.set)
    session.change(natural_frequency=22.0)
    await seen.wait()
    assert session.results.loop is not None
    assert not any(task.done() for task in tasks)
    await asyncio.gather(*tasks)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_moves_and_no_map_waits() -> None:
    async def move_on() -> list[tuple[float, int]]:
        core.loop = asyncio.get_running_loop()
        session = Session(Robots(), DesignState(), [])
        session.start()
        found = []
        for number in range(2 * MOVES):
            await move(session, number)
            if number % MOVES == MOVES - 1:
                found.append((await held_by_all(), len(gc.get_objects())))
        await assert_map_is_first(session, FACTS.compute("time:sleep", SLOW), RUNS.compute("time:sleep", SLOW))
        session.close()
        await RUNS.compute("time:time")  # after it forgot the session
        for worker in (FACTS, LOOPS, RUNS):
            worker.close()
        return found

    (memory, objects), (last_memory, last_objects) = asyncio.run(move_on())
    assert last_memory - memory < MEGABYTES
    assert last_objects - objects <= OBJECTS_PER_MOVE * MOVES
