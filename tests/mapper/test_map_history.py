"""Maps of the past: which are kept, over restarts and versions of the store, and how they are asked for."""

import asyncio
import json
from contextlib import closing
from http import HTTPStatus
from itertools import accumulate
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.changes import Changes, Topic
from mapper.map_archive import PastMap, change_past_maps, pack_documents, read_documents, read_past_maps, unpack_documents
from mapper.map_history import MapHistory
from mapper.map_job import MapDocuments
from mapper.map_snapshot import FinishedMap, MapSnapshot
from mapper.named_pins import Framing
from mapper.request_errors import MapNotFoundError
from mapper.store import Store
from mapper.store_thread import StoreThread
from mapper.thinning import choose_kept, make_ladder
from tests.mapper.fake_gateway import S
from tests.mapper.mapper_side import mapper_side, until
from tests.mapper.ring import ring_records
from tests.mapper.test_store_file import write_version_1
from tests.mapper.web_side import check_against, client_of, openapi_of

LADDER = make_ladder(all_s=300, minutes_s=7200, ten_minutes_s=86_400)
RECORDS = ring_records()


@given(
    gaps_s=st.lists(st.integers(0, 4000), min_size=1, max_size=60), first_s=st.integers(0, 10**6), later_s=st.lists(st.integers(0, 10**5))
)
def test_thinning_often_keeps_what_thinning_once_keeps(gaps_s: list[int], first_s: int, later_s: list[int]) -> None:
    walls_ns = [wall_s * S for wall_s in accumulate(gaps_s, initial=first_s)]
    end_ns = walls_ns[-1] + sum(later_s) * S
    kept = walls_ns
    for now_s in accumulate(later_s, initial=walls_ns[-1] // S):
        kept = [wall_ns for wall_ns, is_kept in zip(kept, choose_kept(kept, now_ns=now_s * S, ladder=LADDER), strict=True) if is_kept]
    once = choose_kept(walls_ns, now_ns=end_ns, ladder=LADDER)
    assert kept == [wall_ns for wall_ns, is_kept in zip(walls_ns, once, strict=True) if is_kept]
    assert kept[-1] == walls_ns[-1], "the newest"
    assert all(is_kept for wall_ns, is_kept in zip(walls_ns, once, strict=True) if end_ns - wall_ns <= 300 * S)
    for rung in LADDER:
        old = [wall_ns // (rung.every_s * S) for wall_ns in kept[:-1] if end_ns - wall_ns > rung.beyond_s * S]
        assert len(old) == len(set(old)), f"one in {rung.every_s} s"


@given(map_json=st.binary(max_size=200), diagram_json=st.binary(max_size=200))
def test_unpacking_inverts_packing(map_json: bytes, diagram_json: bytes) -> None:
    assert unpack_documents(pack_documents(map_json, diagram_json)) == (map_json, diagram_json)


def a_snapshot(version: int, *, wall_ns: int, size: int = 10) -> MapSnapshot:
    body = {"betti_numbers": [1, version % 3], "hole_count": {"probability": 0.5}, "data": {"is_enough": True}, "text": "x" * size}
    documents = MapDocuments(
        map_json=json.dumps(body).encode(),
        diagram_json=b'{"betti_numbers": []}',
        barcode_json=b'{"bars": []}',
        coverage_json=b'{"per_minute": []}',
        drawing=b"",
        framing=Framing(),
        n_encounters=version,
        n_before=0,
        since_ns=None,
        last_encounter_ns=0,
        n_ahead=0,
    )
    finished = FinishedMap(version=version, begun_wall_ns=wall_ns - 1, computed_wall_ns=wall_ns, computing_s=0.1, documents=documents)
    return MapSnapshot.of(finished, change=version)


class Past:
    """A history with a clock that is set."""

    def __init__(self, records: StoreThread, *, max_bytes: int = 10**9) -> None:
        self.now_ns = 0
        self.changes = Changes()
        self.history = MapHistory(
            records=records, changes=self.changes, ladder=LADDER, max_bytes=max_bytes, made_by="test", clock=lambda: self.now_ns
        )

    async def make(self, versions: range, *, every_s: int) -> None:
        """Have maps made, one after the other, and then stop."""
        task = asyncio.create_task(self.history.run())
        for version in versions:
            self.now_ns = version * every_s * S
            snapshot = a_snapshot(version, wall_ns=self.now_ns)
            self.history.take(snapshot)
            while not self.history.page(after=version - 1)[0]:
                await self.changes.wait(seen=self.changes.versions)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    def versions(self) -> list[int]:
        return [facts.version for facts in self.history.page()[0]]


@pytest.mark.parametrize("path", ["store.db", None])
def test_all_of_the_last_minutes_and_one_a_minute_of_those_before(path: str | None, tmp_path: Path) -> None:
    async def story() -> None:
        file = None if path is None else tmp_path / path
        records = await StoreThread.open(file)
        past = Past(records)
        await past.make(range(1, 101), every_s=10)
        # Of the last five minutes all, 30 of them and the one that is just as old; before, the first of each minute: 6, 12, ...
        expected = sorted({1, *range(6, 70, 6), *range(70, 101)})
        assert past.versions() == expected
        facts, map_json, diagram_json = await past.history.documents(96)
        assert (facts.betti_numbers, facts.hole_probability, facts.is_enough, facts.n_encounters) == ((1, 0), 0.5, True, 96)
        assert json.loads(map_json)["version"] == json.loads(diagram_json)["version"] == 96
        for version in (2, 101):
            with pytest.raises(MapNotFoundError, match="of versions 1 to 100 some are kept"):
                await past.history.documents(version)
        await records.aclose()
        if file is None:
            return
        records = await StoreThread.open(file)
        again = Past(records)
        newest = await again.history.restore()
        assert newest is not None
        assert json.loads(newest)["version"] == again.history.newest_version == 100
        assert again.versions() == expected
        assert (await again.history.documents(12))[1] == a_snapshot(12, wall_ns=120 * S).map_json
        await records.aclose()

    asyncio.run(story())


def test_maps_take_no_more_room_than_they_may() -> None:
    async def story() -> None:
        records = await StoreThread.open(None)
        one = len(pack_documents(a_snapshot(1, wall_ns=1).map_json, a_snapshot(1, wall_ns=1).diagram_json))
        past = Past(records, max_bytes=8 * one)
        await past.make(range(1, 31), every_s=1)
        kept = past.history.page()[0]
        assert past.versions() == list(range(31 - len(kept), 31)), "the newest"
        assert 6 <= len(kept) <= 8
        assert sum(facts.n_bytes for facts in kept) <= 8 * one
        await records.aclose()

    asyncio.run(story())


def test_a_store_of_the_first_version_keeps_maps_and_a_damaged_one_does_not_keep_the_others(tmp_path: Path) -> None:
    write_version_1(tmp_path / "store.db")
    for is_again in (False, True):
        with closing(Store(tmp_path / "store.db")) as store:
            assert read_documents(store, 1) == (b"a" if is_again else None)
            facts = PastMap(
                version=1,
                wall_ns=5,
                begun_wall_ns=4,
                made_by="me",
                tag="1",
                betti_numbers=(1, 2),
                hole_probability=None,
                is_enough=None,
                n_encounters=7,
                n_bytes=1,
            )
            change_past_maps(store, add=[(facts, b"a")], drop=[2])
            store._db.execute("INSERT OR REPLACE INTO past_map VALUES (2, x'00', x'00')")
            assert read_past_maps(store) == [facts]


def test_maps_of_the_past_are_listed_served_and_compared_and_numbers_go_on_after_a_restart(tmp_path: Path) -> None:
    async def story() -> None:
        path = tmp_path / "records.db"
        async with mapper_side(1, with_map=True, store=path) as side, client_of(side) as client:
            document = openapi_of(side)
            seen = side.changes.versions[Topic.MAPS]
            assert (await client.get("/api/v1/maps")).json() == {"maps": [], "next": None}
            for n, records in enumerate((RECORDS[:500], RECORDS[500:]), start=1):
                await side.take_in(records)
                await until(lambda n=n: len(side.history.page()[0]) >= n)  # type: ignore[misc]
            assert side.changes.versions[Topic.MAPS] > seen
            listed = await client.get("/api/v1/maps")
            check_against(document, "/api/v1/maps", listed)
            first, *_, last = listed.json()["maps"]
            assert (last["b0"], last["b1"]) == (1, 1)
            assert last["n_encounters"] > first["n_encounters"]
            page = (await client.get("/api/v1/maps", params={"limit": 1})).json()
            assert (page["maps"], page["next"]) == ([first], first["version"])
            rest = (await client.get("/api/v1/maps", params={"after": page["next"]})).json()
            assert rest["maps"] == listed.json()["maps"][1:]
            now = await client.get("/api/v1/map")
            for part, of_now in (("", now), ("/diagram", await client.get("/api/v1/diagram"))):
                answer = await client.get(f"/api/v1/maps/{last['version']}{part}")
                check_against(document, f"/api/v1/maps/{{version}}{part}", answer)
                assert (answer.content, answer.headers["etag"]) == (of_now.content, of_now.headers["etag"])
                answer = await client.get(f"/api/v1/maps/{last['version']}{part}", headers={"If-None-Match": answer.headers["etag"]})
                assert answer.status_code == HTTPStatus.NOT_MODIFIED
            difference = await client.get(f"/api/v1/maps/{last['version']}/difference", params={"since": first["version"]})
            check_against(document, "/api/v1/maps/{version}/difference", difference)
            assert [hole["after"]["hole"] for hole in difference.json()["stayed"]] == [1]
            assert difference.json()["frames"][0]["turn_deg"] == pytest.approx(0, abs=0.5), "each map lies as the one before"
            missing = await client.get(f"/api/v1/maps/{last['version'] + 1}/difference", params={"since": 1})
            check_against(document, "/api/v1/maps/{version}/difference", missing)
            assert missing.status_code == HTTPStatus.NOT_FOUND
        with closing(Store(path)) as store:
            assert read_documents(store, last["version"]) is not None
            store._db.execute("DELETE FROM finished_map")  # as if another version of the program had made it
        async with mapper_side(1, with_map=True, store=path) as side, client_of(side) as client:
            await until(lambda: side.current_map.latest is not None)
            latest = side.current_map.require()
            assert latest.version > last["version"]
            assert json.loads(latest.map_json)["aligned"]["n_shared"] > 3
            assert (await client.get(f"/api/v1/maps/{last['version']}")).content == now.content

    asyncio.run(story())
