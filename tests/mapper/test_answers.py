"""Answers are compressed for those who ask, named by what they are, and the short way to the map is the long way's answer."""

import asyncio
import gzip
from http import HTTPStatus

import httpx
import pytest

from mapper.api.app import create_unguarded_app
from mapper.api.event_stream import EventStream
from mapper.api.quick_answers import accepts_gzip
from mapper.served_bytes import LEAST_PACKED, ServedBytes
from tests.mapper.fake_gateway import encounter
from tests.mapper.mapper_side import mapper_side, until
from tests.mapper.ring import ring_records
from tests.mapper.web_side import BASE, client_of

IDENTITY = {"Accept-Encoding": "identity"}
PATHS = ("map", "diagram", "barcode", "holes", "betti", "coverage", "map.geojson", "barcode.svg")


@pytest.mark.parametrize(
    ("accepted", "is_wanted"),
    [
        (None, False),
        ("", False),
        ("gzip", True),
        ("GZIP;q=0.5, br", True),
        ("gzip;q=0", False),
        ("gzip; q=0.000", False),
        ("*", True),
        ("*;q=0", False),
        ("gzip;q=0, *", False),
        ("br, deflate", False),
        ("xgzip", False),
        ("gzip;q=x", False),
        ("identity;q=0, *;q=0.1", True),
    ],
)
def test_a_client_says_whether_it_takes_gzip(accepted: str | None, is_wanted: bool) -> None:
    assert accepts_gzip(accepted) is is_wanted


def test_versioned_answers_are_compressed_once_named_in_both_forms_and_the_same_by_the_short_way() -> None:
    async def story() -> None:
        async with mapper_side(1, with_map=True) as side, client_of(side) as client:
            inner = create_unguarded_app(side.services, stream=EventStream(side.changes))
            async with httpx.AsyncClient(transport=httpx.ASGITransport(app=inner), base_url=BASE) as long_way:
                for status in (HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.OK):
                    short, long = await client.get("/api/v1/map"), await long_way.get("/api/v1/map")
                    assert short.status_code == long.status_code == status
                    assert short.content == long.content
                    assert set(long.headers.items()) - set(short.headers.items()) <= {("map-behind", long.headers.get("map-behind"))}
                    if status != HTTPStatus.OK:
                        await until(lambda: side.current_map.waiting_for.minimum > 0)
                        await side.take_in(ring_records())
                        await until(lambda: side.current_map.latest is not None and not side.current_map.status.is_computing)
            for path in PATHS:
                plain = await client.get(f"/api/v1/{path}", headers=IDENTITY)
                packed = await client.get(f"/api/v1/{path}", headers={"Accept-Encoding": "br;q=1, gzip"})
                assert packed.content == plain.content, path
                assert plain.headers["vary"] == packed.headers["vary"] == "Accept-Encoding"
                assert "content-encoding" not in plain.headers
                is_long = len(plain.content) >= LEAST_PACKED
                assert (packed.headers.get("content-encoding") == "gzip") is is_long, path
                assert (packed.headers["etag"] != plain.headers["etag"]) is is_long
                for known in (plain, packed):
                    for coding in ("identity", "gzip"):
                        asked = {"If-None-Match": known.headers["etag"], "Accept-Encoding": coding}
                        again = await client.get(f"/api/v1/{path}", headers=asked)
                        assert (again.status_code, again.content) == (HTTPStatus.NOT_MODIFIED, b"")
                        assert again.headers["etag"] == (plain if coding == "identity" else packed).headers["etag"]
            body = side.current_map.require().map
            assert body.packed is not None
            assert gzip.decompress(body.packed) == body.plain
            assert body.packed is await body.pack()
            # Pictures of points do not get shorter.
            assert "content-encoding" not in (await client.get("/api/v1/barcode.png", headers={"Accept-Encoding": "gzip"})).headers

    asyncio.run(story())


def test_other_long_answers_are_compressed_too_but_no_stream_of_events() -> None:
    async def story() -> None:
        async with mapper_side(1) as side, client_of(side) as client:
            await side.take_in([encounter(n) for n in range(1, 60)])
            for path in ("/api/v1/encounters", "/openapi.json", "/static/main.js", "/api/v1/encounters.csv"):
                plain = await client.get(path, headers=IDENTITY)
                packed = await client.get(path, headers={"Accept-Encoding": "gzip"})
                assert packed.headers["content-encoding"] == "gzip", path
                assert packed.content == plain.content
                assert packed.headers["vary"] == plain.headers["vary"] == "Accept-Encoding"
                if "content-length" in packed.headers:
                    assert int(packed.headers["content-length"]) < int(plain.headers["content-length"])
                head = await client.head(path, headers={"Accept-Encoding": "gzip"})
                assert head.content == b""
            static = await client.get("/static/main.js", headers={"Accept-Encoding": "gzip"})
            assert static.headers["etag"].startswith("W/")
            again = await client.get("/static/main.js", headers={"Accept-Encoding": "gzip", "If-None-Match": static.headers["etag"]})
            assert again.status_code == HTTPStatus.NOT_MODIFIED
            for path in ("/api/v1/missions", "/api/v1/map/status"):
                assert "content-encoding" not in (await client.get(path, headers={"Accept-Encoding": "gzip"})).headers
            response = EventStream(side.changes).open()
            assert response.headers["content-type"].startswith("text/event-stream")
            assert "content-encoding" not in response.headers

    asyncio.run(story())


def test_equal_bytes_have_equal_names() -> None:
    assert ServedBytes.of(b"x" * 2000) == ServedBytes.of(b"x" * 2000) != ServedBytes.of(b"y" * 2000)
