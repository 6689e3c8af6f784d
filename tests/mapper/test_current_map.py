"""The map that is served: how it stands to the records, what is sent to be mapped, and how it outlives a restart."""

import asyncio
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from http import HTTPStatus
from pathlib import Path

import msgspec.structs

import mapper
from firmware_protocol.contract.records import EncounterRecord, MissionPhase
from mapper.config import RecipeConfig
from mapper.current_map import KEEP_PERIOD_S
from mapper.map_snapshot import MapSnapshot
from mapper.store import Store
from studies.ports import free_port
from tests.mapper.fake_gateway import ANCHOR_NS, FakeGateway, S, batch, encounter, mission
from tests.mapper.mapper_side import Side, mapper_side, until
from tests.mapper.ring import ring_records
from tests.mapper.web_side import client_of

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
                await until(lambda: side.bus.is_connected and gateway.is_heard)
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
                await until(lambda: side.bus.is_connected and gateway.is_heard)
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


def test_where_too_few_encounters_are_left_the_last_map_is_served_and_said_to_be_the_last() -> None:
    async def story() -> None:
        n = len(RECORDS)
        async with mapper_side(1, with_map=True) as side, client_of(side) as client:
            await side.take_in(RECORDS)
            await level(side, change=n)
            voided = [
                msgspec.structs.replace(record, offset=n + place, revision=1, is_void=True)
                for place, record in enumerate((record for record in RECORDS if isinstance(record, EncounterRecord)), start=1)
            ]
            await side.take_in(voided)
            await until(lambda: side.current_map.status.waiting is not None)
            n += N_ENCOUNTERS
            status = (await client.get("/api/v1/map/status")).json()
            assert status["waiting"] == "no newer map: not enough encounters yet: 0 of at least 2"
            assert (status["n_encounters"], status["n_known"], status["n_waiting"], status["behind_s"]) == (N_ENCOUNTERS, 0, 0, 0)
            assert (await client.get("/healthz")).json()["waiting"] == status["waiting"]
            answer = await client.get("/api/v1/map")
            assert (answer.status_code, answer.headers["map-waiting"], float(answer.headers["map-behind"])) == (HTTPStatus.OK, "0", 0)
            await side.take_in([encounter(n + 1), encounter(n + 2)])
            await level(side, change=n + 2)
            status = (await client.get("/api/v1/map/status")).json()
            assert (status["n_encounters"], status["n_known"], status["n_waiting"], status["waiting"]) == (2, 2, 0, None)
            assert (await client.get("/healthz")).json()["waiting"] is None

    asyncio.run(story())


def test_a_new_mission_waits_for_encounters_after_its_time_zero_and_says_so(tmp_path: Path) -> None:
    async def story() -> None:
        path = tmp_path / "records.db"
        n = len(RECORDS) + 1
        later = max(record.t_end_ns for record in RECORDS if isinstance(record, EncounterRecord)) + S
        for is_again in (False, True):
            async with mapper_side(1, with_map=True, store=path) as side:
                if not is_again:
                    await side.take_in(RECORDS)
                    await level(side, change=n - 1)
                    await side.take_in([mission(n, phase=MissionPhase.EXPLORATION, t_ns=later)])
                # After a restart too: the map that was kept is of before.
                await until(lambda: side.current_map.status.waiting is not None)
                status = side.current_map.status
                assert status.waiting == "no newer map: not enough encounters since time 0 of the mission: 0 of at least 2"
                assert (status.n_known, status.n_waiting, status.behind_s) == (N_ENCOUNTERS, 0, 0)
                assert side.current_map.require().n_encounters == N_ENCOUNTERS

    asyncio.run(story())


def test_a_clock_that_is_ahead_does_not_take_the_window_away_from_the_others() -> None:
    async def story() -> None:
        n, n_more = len(RECORDS), 50
        end = max(record.t_end_ns for record in RECORDS if isinstance(record, EncounterRecord))
        now = [ANCHOR_NS + end]
        year = 365 * 24 * 3600 * S
        async with mapper_side(1, with_map=True, window_ns=3600 * S, clock=lambda: now[0]) as side, client_of(side) as client:
            await side.take_in(RECORDS)
            await level(side, change=n)
            assert (await client.get("/healthz")).json()["faults"] == []
            # One is a year ahead, one within what clocks of several machines may differ by.
            await side.take_in([encounter(n + 1, t_ns=(year, year + S)), encounter(n + 2, t_ns=(end, end + 60 * S))])
            await side.take_in([encounter(n + 3 + i, nodes=(1 + i % 5, 1001), t_ns=(end, end + i)) for i in range(n_more)])
            n += 2 + n_more
            await level(side, change=n)
            document = (await client.get("/api/v1/map")).json()
            assert (document["n_encounters"], document["n_ahead"], document["n_before"]) == (N_ENCOUNTERS + 1 + n_more, 1, 0)
            assert abs(document["since_s"] * S - (ANCHOR_NS + end + 60 * S - 3600 * S)) < 1000
            (fault,) = (await client.get("/healthz")).json()["faults"]
            assert fault.startswith("encounters dated ahead of this machine's clock: 1;")
            assert (await client.get("/api/v1/map/status")).json()["n_ahead"] == 1
            # In a year it is the newest, and the window is its.
            now[0] += year
            await side.take_in([encounter(n + 1, sequence=n, revision=1)])
            await until(lambda: side.current_map.status.waiting is not None)
            assert side.current_map.status.waiting == "no newer map: not enough encounters in the window: 1 of at least 2"
            assert side.current_map.faults == ()

    asyncio.run(story())


def test_where_all_clocks_are_ahead_it_is_this_one_that_is_behind() -> None:
    async def story() -> None:
        async with mapper_side(1, with_map=True, window_ns=3600 * S, clock=lambda: 0) as side:
            await side.take_in(RECORDS)
            await level(side, change=len(RECORDS))
            assert side.current_map.require().n_encounters == N_ENCOUNTERS
            (fault,) = side.current_map.faults
            assert f": {N_ENCOUNTERS};" in fault

    asyncio.run(story())


def test_after_a_restart_the_last_map_is_there_at_once_and_is_not_made_again(tmp_path: Path) -> None:
    async def story() -> None:
        port = free_port()
        path = tmp_path / "records.db"
        with FakeGateway(port=port) as gateway:
            gateway.journal_records(RECORDS)
            async with mapper_side(port, with_map=True, store=path) as side:
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.publish_status()
                await level(side, change=len(RECORDS))
                first = side.current_map.require()
                _, drawn = await side.current_map.artist.picture("map", "svg")
            async with mapper_side(port, with_map=True, store=path) as side:
                kept = side.current_map.require()
                # The lengths between points are most of a map, and are not kept.
                assert (kept.lengths, kept.finished.documents.lengths) == (None, None)
                documents = msgspec.structs.replace(kept.finished.documents, lengths=first.finished.documents.lengths)
                assert MapSnapshot.of(msgspec.structs.replace(kept.finished, documents=documents), change=kept.change) == first
                await until(lambda: bool(side.fleet._n_encounters))
                assert (await side.current_map.artist.picture("map", "svg"))[1] == drawn
                assert (side.current_map.worker.n_starts, side.current_map.status.n_waiting) == (0, 0)
                # The worker has nothing yet: it is sent everything, and a map of everything is what it makes.
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.journal_records([encounter(len(RECORDS) + 1)])
                gateway.publish_status()
                await level(side, change=len(RECORDS) + 1)
                assert side.current_map.require().n_encounters == N_ENCOUNTERS + 1
                # Numbers given after the map was kept, and lost with a crash, do not come again.
                assert side.current_map.require().version > first.version + KEEP_PERIOD_S / 0.1
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
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.publish_status()
                await level(side, change=len(RECORDS))
            spoilt = Store(path)
            spoilt._db.execute("UPDATE finished_map SET document = x'00'")
            spoilt.close()
            async with mapper_side(port, with_map=True, store=path) as side:
                assert side.current_map.latest is None
                await level(side, change=len(RECORDS))

    asyncio.run(story())


def test_a_damaged_page_of_the_kept_map_costs_no_more_than_the_map(tmp_path: Path) -> None:
    async def story() -> None:
        path = tmp_path / "records.db"
        async with mapper_side(1, with_map=True, store=path) as side:
            await side.take_in(RECORDS)
            await level(side, change=len(RECORDS))
        with closing(sqlite3.connect(path)) as database:
            (page,) = database.execute("SELECT rootpage FROM sqlite_schema WHERE name = 'finished_map'").fetchone()
            (size,) = database.execute("PRAGMA page_size").fetchone()
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        with path.open("r+b") as file:
            file.seek((page - 1) * size)
            file.write(b"\xa5" * size)
        async with mapper_side(1, with_map=True, store=path) as side:
            (fault,) = side.current_map.faults
            assert "malformed" in fault
            await level(side, change=len(RECORDS))
            assert side.current_map.require().n_encounters == N_ENCOUNTERS

    asyncio.run(story())


def test_a_picture_that_a_newer_map_overtook_says_how_far_its_own_map_is_behind() -> None:
    async def story() -> None:
        n = len(RECORDS)
        async with mapper_side(1, with_map=True) as side, client_of(side) as client:
            await side.take_in(RECORDS)
            await level(side, change=n)
            assert (await client.get("/api/v1/map.png")).headers["map-waiting"] == "0"
            artist = side.current_map.artist._worker.pid
            assert artist is not None
            os.kill(artist, signal.SIGSTOP)
            drawing = asyncio.create_task(client.get("/api/v1/map.svg"))
            await until(side.current_map.artist._worker._lock.locked)
            await side.take_in([encounter(n + 1)])
            await level(side, change=n + 1)
            os.kill(artist, signal.SIGCONT)
            answer = await drawing
            assert int(answer.headers["etag"].strip('"').split("-")[0]) < side.current_map.require().version
            assert answer.headers["map-waiting"] == "1"
            assert float(answer.headers["map-behind"]) > 0

    asyncio.run(story())


def test_the_fingerprint_of_a_map_is_another_after_any_change_of_what_makes_it(tmp_path: Path) -> None:
    """A copy of the package is asked in a process of its own, where it is what is imported."""
    source = Path(mapper.__file__).parent
    shutil.copytree(source, tmp_path / "mapper", ignore=shutil.ignore_patterns("__pycache__", "web"))
    program = """
from mapper.config import RecipeConfig, make_recipe
from mapper.map_snapshot import fingerprint
print(fingerprint(make_recipe(RecipeConfig()), window_ns=None))
"""

    def ask() -> str:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(source.parent)])}
        return subprocess.run(
            [sys.executable, "-P", "-c", program], env=environment, cwd=tmp_path, check=True, capture_output=True, text=True
        ).stdout

    names = [ask(), ask()]
    assert names[0] == names[1]
    for name in ("data/classifier.json", "kernels/sweep.c", "betti.py"):
        with (tmp_path / "mapper" / name).open("a", encoding="utf-8") as file:
            file.write("\n")
        names.append(ask())
    assert len(set(names)) == 4


def test_what_a_full_disk_does_not_take_in_waits(tmp_path: Path) -> None:
    async def story() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            async with mapper_side(port, with_map=True, store=tmp_path / "records.db") as side:
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.journal_records(RECORDS)
                gateway.publish_status()
                await level(side, change=len(RECORDS))
                assert side.current_map.status.behind_s == 0
                (n_pages,) = await side.records.call(lambda store: store._db.execute("PRAGMA page_count").fetchone())
                await side.records.call(lambda store: store._db.execute(f"PRAGMA max_page_count = {n_pages}").fetchone())
                more = [encounter(len(RECORDS) + 1 + i) for i in range(500)]
                gateway.journal_records(more)
                gateway.publish_status()
                await until(lambda: side.intake.store_fault is not None)
                assert side.current_map.status.n_known == N_ENCOUNTERS
                await until(lambda: side.current_map.status.behind_s > 0)
                await side.records.call(lambda store: store._db.execute("PRAGMA max_page_count = 1000000").fetchone())
                gateway.publish_status()
                await level(side, change=len(RECORDS) + len(more))
                await until(lambda: side.intake.store_fault is None)
                assert side.current_map.status.behind_s == 0

    asyncio.run(story())


def test_a_map_that_takes_far_longer_than_the_last_is_told(tmp_path: Path) -> None:
    async def story() -> None:
        port = free_port()
        async with mapper_side(port, with_map=True, store=tmp_path / "records.db", min_interval_s=3600) as side:
            await side.take_in(RECORDS)
            side.current_map._computing_since = time.monotonic() - 20
            early = list(side.current_map.faults)
            side.current_map._computing_since = time.monotonic() - 40
            (fault,) = list(side.current_map.faults)
            assert not early
            assert "the map has been computed for 40 s, the last one took 0.0 s" in fault

    asyncio.run(story())
