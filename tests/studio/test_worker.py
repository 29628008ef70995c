"""Processes that compute for all sessions; the server itself leaves CasADi alone."""

import asyncio
import os
import subprocess
import sys

import pytest

pytest.importorskip("nicegui")

from tarc.studio.jobs import JobError
from tarc.studio.worker import Worker


def test_the_server_does_not_import_what_computes():
    code = "import sys, tarc.studio.server; print(sorted({'casadi', 'mujoco', 'scipy', 'xarray'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_a_worker_that_ends_is_started_again():
    worker = Worker("test")

    async def use():
        assert await asyncio.gather(*(worker.compute("math:sqrt", x) for x in (4.0, 9.0))) == [2.0, 3.0]
        first = worker.pid
        assert await worker.compute("os:getpid") == first != os.getpid()
        with pytest.raises(JobError, match="ended with code 3; the next move starts it again"):
            await worker.compute("os:_exit", 3)
        assert await worker.compute("os:getpid") not in (first, os.getpid())
        with pytest.raises(JobError, match=r"robot: got .nothing."):
            await worker.compute("tarc.core.validation:one_of", "robot", "nothing", ["arm"])

    try:
        asyncio.run(use())
    finally:
        worker.close()


@pytest.mark.slow
def test_a_move_that_was_left_does_not_shift_the_answers():
    worker = Worker("test")

    async def use():
        left = asyncio.create_task(worker.compute("time:sleep", 0.2))
        await asyncio.sleep(0.1)
        left.cancel()
        assert await worker.compute("math:sqrt", 16.0) == 4.0

    try:
        asyncio.run(use())
    finally:
        worker.close()
