import asyncio
import os
import time

import pytest

pytest.importorskip("nicegui")

from tarc.core.errors import InvalidParameter
from tarc.studio.certifying import certificate_rows, send_certificates
from tarc.studio.design_state import DesignState
from tarc.studio.jobs import Job, JobError
from tarc.studio.robots import Robots

pytestmark = pytest.mark.slow


def count(send, n):
    for number in range(n):
        send(number)


def wait(send):
    send("started")
    time.sleep(60)


def fail(send):
    raise InvalidParameter("window: too short")


def die(send):
    os._exit(3)


async def collect(job):
    return [result async for result in job.results()]


def test_job_sends_its_results():
    assert asyncio.run(collect(Job(count, 3))) == [0, 1, 2]


def test_job_that_is_cancelled_ends_at_once():
    async def cancelled():
        job, found = Job(wait), []
        async for result in job.results():
            found.append(result)
            job.cancel()
        return found

    start = time.monotonic()
    assert asyncio.run(cancelled()) == ["started"]
    assert time.monotonic() - start < 30


def test_job_gives_the_message_of_an_error():
    with pytest.raises(JobError, match="window: too short"):
        asyncio.run(collect(Job(fail)))


def test_job_whose_process_ends_on_its_own_says_so():
    with pytest.raises(JobError, match="ended with code 3"):
        asyncio.run(collect(Job(die)))


def test_certificates_follow_the_inertia_share():
    robots = Robots()
    certified = {}
    for share in (0.08, 0.6):
        state = DesignState(inertia_share=share)
        rows = certificate_rows(state.to_content(robots.content(state.robot)))
        certified[share] = {row.kind: str(row.verdict) for row in rows}
        assert all(row.reason and "\n" not in row.reason for row in rows)
    assert certified[0.08]["robot"] == "certified"
    assert certified[0.6]["robot"] == "refuted"
    sent = []
    send_certificates(sent.append, DesignState(), robots)
    assert {row.kind for row in sent[0]} == set(certified[0.08])


def test_known_inertia_has_a_certificate_of_its_own():
    state = DesignState(model_known=True, inertia_share=0.1)
    rows = certificate_rows(state.to_content(Robots().content(state.robot)))
    assert [row.kind for row in rows] == ["known_inertia"]
