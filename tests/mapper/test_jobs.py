"""Jobs: maps of other times and methods, ordered, watched, cancelled, and fetched."""

import asyncio
import contextlib
import os
import signal
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from typing import Any

import httpx

from mapper.config import RecipeConfig, make_recipe
from mapper.jobs import MAX_ENDED, MAX_WAITING, Job, JobState
from mapper.period_job import PeriodMap, make_period_map
from mapper.store import Store
from mapper.worker import Worker
from tests.mapper.fake_gateway import ANCHOR_NS, S
from tests.mapper.mapper_side import PATIENCE_S, Side, mapper_side, until
from tests.mapper.ring import ring_records
from tests.mapper.web_side import check_against, client_of, openapi_of

JOBS = "/api/v1/jobs"


def run(story: Callable[[Side, httpx.AsyncClient], Awaitable[None]]) -> None:
    async def whole() -> None:
        async with mapper_side(1) as side, client_of(side) as client:
            await side.take_in(ring_records())
            await story(side, client)

    asyncio.run(whole())


async def order(client: httpx.AsyncClient, **body: object) -> dict[str, Any]:
    answer = await client.post(JOBS, json={"kind": "map", **body})
    assert answer.status_code == HTTPStatus.ACCEPTED, answer.text
    job: dict[str, Any] = answer.json()
    assert answer.headers["location"] == f"{JOBS}/{job['id']}"
    return job


async def at_work(side: Side, client: httpx.AsyncClient) -> tuple[str, int]:
    """Order a job, and return it and its own process while it runs; one that was over before anybody looked is ordered again."""
    while True:
        job_id = str((await order(client))["id"])
        job = side.jobs.get(job_id)

        def has_process(job: Job = job) -> bool:
            # Only then has the process of the job before gone.
            return job.has_ended or (job.state is JobState.RUNNING and side.jobs.worker.pid is not None)

        await until(has_process)
        pid = side.jobs.worker.pid
        if not job.has_ended and pid is not None:
            return job_id, pid


async def ended(side: Side, job_id: str) -> None:
    async with asyncio.timeout(PATIENCE_S):
        await side.jobs.get(job_id).is_done.wait()


def test_a_job_makes_the_map_of_its_time() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        document = openapi_of(side)
        since_ns, until_ns = ANCHOR_NS + 20 * S, ANCHOR_NS + 50 * S
        job = await order(client, from_wall_ns=since_ns, until_wall_ns=until_ns, replicates=0, n_points=100, speed_mps=0.02)
        early = await client.get(f"{JOBS}/{job['id']}/result")
        assert early.status_code == HTTPStatus.CONFLICT
        await ended(side, job["id"])
        told = (await client.get(f"{JOBS}/{job['id']}")).json()
        assert (told["state"], told["progress"], told["problem"]) == ("done", 1, None)
        answer = await client.get(told["result_url"])
        check_against(document, JOBS + "/{job_id}/result", answer)
        result = answer.json()
        assert (result["since_s"], result["until_s"], result["job"]) == (since_ns / 1e9, until_ns / 1e9, job["id"])
        assert result["betti_numbers"] == [1, 1]
        assert (result["parameters"]["n_points"], result["parameters"]["length_unit"]) == (100, "m")
        known = await side.records.call(lambda store: store.delta(after=0).encounters)
        assert result["n_encounters"] == int(((known.t_end_ns > since_ns) & (known.t_start_ns < until_ns)).sum())
        assert result["n_before"] == int((known.t_end_ns <= since_ns).sum())
        assert all(since_ns / 1e9 <= point["t"] <= until_ns / 1e9 for point in result["points"])
        again = await client.get(told["result_url"], headers={"If-None-Match": answer.headers["etag"]})
        assert again.status_code == HTTPStatus.NOT_MODIFIED
        assert side.jobs.worker.pid is None, "its memory is given back"

    run(story)


def test_the_process_tells_every_stage_in_order() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        delta = await side.records.call(Store.delta, after=0)
        worker, told = Worker(name="test", niceness=15), list[tuple[str, float]]()
        async with contextlib.AsyncExitStack() as stack:
            stack.push_async_callback(worker.aclose)
            made = await worker.run_watched(
                make_period_map,
                lambda stage, share: told.append((stage, share)),
                delta,
                make_recipe(RecipeConfig(replicates=0)),
                since_ns=None,
                until_ns=None,
                n_before=0,
                pins=(),
            )
            assert worker.pid is not None
            assert os.getpriority(os.PRIO_PROCESS, worker.pid) == min(19, os.getpriority(os.PRIO_PROCESS, 0) + 15)
        assert isinstance(made, PeriodMap)
        stages = list(dict.fromkeys(stage for stage, _ in told))
        assert stages[:7] == ["taking in", "graph", "metric", "outliers", "subsample", "persistence", "embedding"]
        assert stages[7:] == ["confidence", "done", "writing"]
        shares = [share for _, share in told]
        assert shares == sorted(shares)
        assert 0 <= shares[0] <= shares[-1] == 1

    run(story)


def test_one_job_runs_few_wait_and_each_can_be_cancelled() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        document = openapi_of(side)
        running = await order(client)
        await until(lambda: side.jobs.worker.pid is not None)
        assert side.jobs.worker.pid is not None
        os.kill(side.jobs.worker.pid, signal.SIGSTOP)  # so that it runs until it is cancelled
        waiting = [await order(client, method="paper") for _ in range(MAX_WAITING)]
        refused = await client.post(JOBS, json={"kind": "map"})
        assert refused.status_code == HTTPStatus.TOO_MANY_REQUESTS
        check_against(document, JOBS, refused, method="post")
        states = {one["id"]: one["state"] for one in (await client.get(JOBS)).json()["jobs"]}
        assert list(states.values()) == ["running"] + ["waiting"] * MAX_WAITING
        ids = []
        for _ in range(MAX_ENDED + 2):
            (await client.delete(f"{JOBS}/{waiting.pop()['id']}")).raise_for_status()
            waiting.append(await order(client, method="paper"))
            ids.append(waiting[-1]["id"])
        ended_ids = [job.id for job in side.jobs.all() if job.has_ended]
        assert len(ended_ids) == MAX_ENDED, "the last ones that ended are kept"
        assert ended_ids == ids[-MAX_ENDED - 1 : -1]
        for job in (*waiting[1:], running):
            answer = await client.delete(f"{JOBS}/{job['id']}")
            check_against(document, JOBS + "/{job_id}", answer, method="delete")
            assert answer.json()["state"] == "cancelled"
        await ended(side, waiting[0]["id"])
        assert side.jobs.get(waiting[0]["id"]).state is JobState.DONE
        forgotten = await client.delete(f"{JOBS}/{running['id']}")
        assert (forgotten.status_code, forgotten.content) == (HTTPStatus.NO_CONTENT, b"")
        assert (await client.get(f"{JOBS}/{running['id']}")).status_code == HTTPStatus.NOT_FOUND
        result = (await client.get(f"{JOBS}/{waiting[0]['id']}/result")).json()
        assert result["parameters"]["method"] == "paper"

    run(story)


def test_a_job_that_cannot_be_done_says_why_and_the_next_one_is() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        empty = await order(client, until_wall_ns=1)
        await ended(side, empty["id"])
        told = (await client.get(f"{JOBS}/{empty['id']}")).json()
        assert (told["state"], told["result_url"]) == ("failed", None)
        assert "0 encounters in that time" in told["problem"]
        job_id, pid = await at_work(side, client)
        os.kill(pid, signal.SIGKILL)
        await ended(side, job_id)
        assert "was killed by signal 9" in str(side.jobs.get(job_id).problem)

    run(story)


def test_no_bad_order_becomes_a_job() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        document = openapi_of(side)
        for body in (
            {},
            {"kind": "film"},
            {"kind": "map", "from_wall_ns": 5, "until_wall_ns": 5},
            {"kind": "map", "from_wall_ns": -1},
            {"kind": "map", "from_wall_ns": 2**63},
            {"kind": "map", "from_wall_ns": "5"},
            {"kind": "map", "n_points": 3},
            {"kind": "map", "n_points": 1001},
            {"kind": "map", "speed_mps": 0},
            {"kind": "map", "method": "best"},
            {"kind": "map", "more": 1},
        ):
            answer = await client.post(JOBS, json=body)
            assert answer.status_code == HTTPStatus.UNPROCESSABLE_ENTITY, body
            check_against(document, JOBS, answer, method="post")
        assert side.jobs.all() == []

    run(story)
