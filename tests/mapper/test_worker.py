"""The computing process and the map it keeps up to date: killed, failing, or slow, the service goes on."""

import asyncio
import json
import os
import signal
import time

import numpy as np
import pytest

from mapper.changes import Topic
from mapper.errors import JobError, NoMapYetError, WorkerDiedError
from mapper.worker import Worker
from studies.ports import free_port
from tests.mapper.fake_gateway import FakeGateway, encounter
from tests.mapper.mapper_side import Side, mapper_side, until
from tests.mapper.ring import ring_records

HOURS_S = 7200
"""Whoever waits for such a job is ended by pytest's own limit."""


def test_jobs_run_in_another_process_and_answer_in_order() -> None:
    async def story() -> None:
        worker = Worker(name="test")
        assert worker.pid is None
        pids = await asyncio.gather(*(worker.run(os.getpid) for _ in range(3)))
        assert set(pids) == {worker.pid} != {os.getpid()}
        total = await worker.run(np.sum, np.arange(1_000_000))
        assert total == 499_999_500_000
        await worker.aclose()
        assert worker.pid is None

    asyncio.run(story())


def test_a_killed_worker_is_told_and_the_next_job_has_a_new_one() -> None:
    async def story() -> None:
        worker = Worker(name="test")
        first = await worker.run(os.getpid)
        job = asyncio.create_task(worker.run(time.sleep, HOURS_S))
        await asyncio.sleep(0)
        os.kill(first, signal.SIGKILL)
        with pytest.raises(WorkerDiedError, match="killed by signal 9") as caught:
            await job
        assert caught.value.exit_code == -signal.SIGKILL
        assert await worker.run(os.getpid) != first
        assert worker.n_starts == 2
        await worker.aclose()

    asyncio.run(story())


@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.3])
def test_a_cancellation_while_the_process_starts_or_works_ends_it_at_once(delay_s: float) -> None:
    async def story() -> None:
        worker = Worker(name="test")
        job = asyncio.create_task(worker.run(time.sleep, HOURS_S))
        await asyncio.sleep(delay_s)
        job.cancel()
        with pytest.raises(asyncio.CancelledError):
            await job
        await worker.aclose()
        assert worker.pid is None

    asyncio.run(story())


def test_a_job_that_raises_says_why_and_the_process_stays() -> None:
    async def story() -> None:
        worker = Worker(name="test")
        pid = await worker.run(os.getpid)
        with pytest.raises(JobError, match="ValueError: invalid literal") as caught:
            await worker.run(int, "no number")
        assert "Traceback" in caught.value.details
        assert await worker.run(os.getpid) == pid
        await worker.aclose()

    asyncio.run(story())


def test_a_job_given_up_never_answers_for_the_next_one() -> None:
    async def story() -> None:
        worker = Worker(name="test")
        pid = await worker.run(os.getpid)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await worker.run(time.sleep, HOURS_S)
        assert await worker.run(os.getpid) != pid
        await worker.aclose()

    asyncio.run(story())


def test_a_worker_can_be_closed_while_it_works() -> None:
    async def story() -> None:
        worker = Worker(name="test")
        pid = await worker.run(os.getpid)
        job = asyncio.create_task(worker.run(time.sleep, HOURS_S))
        await asyncio.sleep(0.05)
        await worker.aclose()
        with pytest.raises(WorkerDiedError):
            await job
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)

    asyncio.run(story())


async def map_of(side: Side, n_encounters: int) -> int:
    """Wait for the map of so many encounters, and return its version."""
    await until(lambda: side.current_map.latest is not None and side.current_map.latest.n_encounters == n_encounters)
    return side.current_map.require().version


def test_maps_follow_the_records_and_survive_the_death_of_the_worker() -> None:
    async def story() -> None:
        port = free_port()
        records = ring_records()
        n_encounters = sum(type(record).__name__ == "EncounterRecord" for record in records)
        with FakeGateway(port=port) as gateway:
            async with mapper_side(port, with_map=True) as side:
                await until(lambda: side.current_map.waiting_for.minimum > 0)
                with pytest.raises(NoMapYetError, match="0 of at least 2"):
                    side.current_map.require()
                gateway.journal_records(records)
                gateway.publish_status()
                first = await map_of(side, n_encounters)
                snapshot = side.current_map.require()
                document = json.loads(snapshot.map_json)
                assert document["betti_numbers"] == [1, 1]
                assert document["version"] == first
                assert len(document["landmarks"]) > 0
                diagram = json.loads(snapshot.diagram_json)
                assert sum(interval["is_real"] for interval in diagram["intervals"]["1"]) == len(document["holes"]) == 1
                # The worker dies idle: the next map is made by another one, after a fault that is told and then over.
                pid = side.current_map.worker.pid
                assert pid is not None
                os.kill(pid, signal.SIGKILL)
                last = records[-1].offset
                gateway.journal_records([encounter(last + 1, nodes=(1, 2))])
                gateway.publish([encounter(last + 1, nodes=(1, 2))])
                assert await map_of(side, n_encounters + 1) > first
                assert side.current_map.worker.pid != pid
                assert side.current_map.last_fault is None
                # What was handed out before does not change.
                assert json.loads(snapshot.map_json) == document
                svg = (await side.current_map.artist.picture("map", "svg"))[1].plain
                png = (await side.current_map.artist.picture("map", "png"))[1].plain
                assert b"<svg" in svg[:1000]
                assert png.startswith(b"\x89PNG")
                assert (await side.current_map.artist.picture("map", "svg"))[1].plain is svg

    asyncio.run(story())


def test_many_records_in_a_row_make_few_maps_and_the_last_one_has_them_all() -> None:
    async def story() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            async with mapper_side(port, with_map=True) as side:
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                for offset in range(1, 201):
                    gateway.journal_records([encounter(offset, nodes=(1, 2 + offset % 5), t_ns=(offset, offset + 1))])
                    gateway.publish(gateway.records[-1:])
                await map_of(side, 200)
                n_bumps = side.changes.versions[Topic.RECORDS]
                assert side.current_map.require().version <= min(n_bumps, 60)

    asyncio.run(story())
