"""The map that is served: how it stands to the records, what is sent to be mapped, and how it outlives a restart."""

import asyncio
import json
from contextlib import closing
from http import HTTPStatus
from pathlib import Path

from firmware_protocol.contract.records import EncounterRecord
from mapper.config import RecipeConfig
from mapper.store import Store
from tests.mapper.fake_gateway import ANCHOR_NS, FakeGateway, batch, encounter, free_port
from tests.mapper.mapper_side import Side, mapper_side, until
from tests.mapper.ring import ring_records
from tests.mapper.test_api import client_of

RECORDS = ring_records()
N_ENCOUNTERS = sum(isinstance(record, EncounterRecord) for record in RECORDS)


async def level(side: Side, *, change: int) -> None:
    """Wait for the map after so many changes."""
    await until(lambda: side.current_map.latest is not None and side.current_map.latest.change == change)


def test_the_status_says_what_the_map_is_of_and_what_waits(tmp_path: Path) -> None:
    async def story() -> None:
        port = free_port()
        path = tmp_path / "records.db"
        with closing(Store(path)) as store:
            store.apply([batch(RECORDS)])
        with FakeGateway(port=port) as gateway:
            # After the first map none is begun for an hour.
            async with mapper_side(port, with_map=True, store=path, min_interval_s=3600) as side, client_of(side) as client:
                before = (await client.get("/api/v1/map/status")).json()
                assert (before["version"], before["n_encounters"], before["behind_s"], before["n_waiting"]) == (None, None, 0, len(RECORDS))
                assert before["waiting"]
                await level(side, change=len(RECORDS))
                answer = await client.get("/api/v1/map")
                document, status = answer.json(), (await client.get("/api/v1/map/status")).json()
                assert (answer.headers["map-waiting"], float(answer.headers["map-behind"])) == ("0", 0)
                assert (status["n_encounters"], status["n_known"], status["n_waiting"], status["waiting"]) == (
                    N_ENCOUNTERS,
                    N_ENCOUNTERS,
                    0,
                    None,
                )
                for name in ("version", "begun_wall_ns", "computed_wall_ns", "computing_s", "n_encounters", "n_before"):
                    assert status[name] == document[name]
                assert status["begun_wall_ns"] <= status["computed_wall_ns"] <= status["now_wall_ns"]
                assert status["last_encounter_wall_ns"] / 1e9 == document["last_encounter_s"]
                await until(lambda: side.bus.is_connected)
                gateway.journal_records(
                    [*RECORDS, encounter(len(RECORDS) + 1), encounter(len(RECORDS) + 2, sequence=len(RECORDS) + 1, revision=1)]
                )
                gateway.publish_status()
                await side.until(lambda store: store.n_encounters == N_ENCOUNTERS + 1)
                answer = await client.get("/api/v1/map", headers={"If-None-Match": answer.headers["etag"]})
                assert (answer.status_code, answer.headers["map-waiting"]) == (HTTPStatus.NOT_MODIFIED, "2")
                assert float(answer.headers["map-behind"]) > 0

    asyncio.run(story())


def test_a_window_leaves_out_what_was_over_and_says_so() -> None:
    async def story() -> None:
        port = free_port()
        ends = sorted(record.t_end_ns for record in RECORDS if isinstance(record, EncounterRecord))
        window_ns = ends[-1] - ends[len(ends) // 3]
        with FakeGateway(port=port) as gateway:
            gateway.journal_records(RECORDS)
            async with mapper_side(port, with_map=True, window_ns=window_ns) as side:
                await until(lambda: side.bus.is_connected)
                gateway.publish_status()
                await level(side, change=len(RECORDS))
                document = json.loads(side.current_map.require().map_json)
                since_ns = ends[-1] - window_ns
                assert document["n_encounters"] == sum(end > since_ns for end in ends)
                assert document["n_before"] == N_ENCOUNTERS - document["n_encounters"] > 0
                assert document["window_s"] == window_ns / 1e9
                assert abs(document["since_s"] * 1e9 - since_ns - ANCHOR_NS) < 1000
                assert side.current_map.status.n_known == N_ENCOUNTERS

    asyncio.run(story())


def test_after_a_restart_the_last_map_is_there_at_once_and_is_not_made_again(tmp_path: Path) -> None:
    async def story() -> None:
        port = free_port()
        path = tmp_path / "records.db"
        with FakeGateway(port=port) as gateway:
            gateway.journal_records(RECORDS)
            async with mapper_side(port, with_map=True, store=path) as side:
                await until(lambda: side.bus.is_connected)
                gateway.publish_status()
                await level(side, change=len(RECORDS))
                first = side.current_map.require()
                drawn = await side.current_map.picture("svg")
            async with mapper_side(port, with_map=True, store=path) as side:
                assert side.current_map.require() == first
                await until(lambda: bool(side.fleet._n_encounters))
                assert await side.current_map.picture("svg") == drawn
                assert (side.current_map.worker.n_starts, side.current_map.status.n_waiting) == (0, 0)
                # The worker has nothing yet: it is sent everything, and a map of everything is what it makes.
                await until(lambda: side.bus.is_connected)
                gateway.journal_records([encounter(len(RECORDS) + 1)])
                gateway.publish_status()
                await level(side, change=len(RECORDS) + 1)
                assert side.current_map.require().n_encounters == N_ENCOUNTERS + 1
                assert side.current_map.require().version == first.version + 1
            # Another recipe's map is not taken for this one's.
            async with mapper_side(port, with_map=True, store=path, recipe=RecipeConfig(n_points=50)) as side:
                assert side.current_map.latest is None
                await level(side, change=len(RECORDS) + 1)
            async with mapper_side(port, with_map=True, store=path, window_ns=10**18, recipe=RecipeConfig(n_points=50)) as side:
                assert side.current_map.latest is None

    asyncio.run(story())


def test_a_kept_map_that_cannot_be_read_is_made_anew(tmp_path: Path) -> None:
    async def story() -> None:
        port = free_port()
        path = tmp_path / "records.db"
        with FakeGateway(port=port) as gateway:
            gateway.journal_records(RECORDS)
            async with mapper_side(port, with_map=True, store=path) as side:
                await until(lambda: side.bus.is_connected)
                gateway.publish_status()
                await level(side, change=len(RECORDS))
            spoilt = Store(path)
            spoilt._db.execute("UPDATE finished_map SET document = x'00'")
            spoilt.close()
            async with mapper_side(port, with_map=True, store=path) as side:
                assert side.current_map.latest is None
                await level(side, change=len(RECORDS))

    asyncio.run(story())
