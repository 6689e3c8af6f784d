"""The web API: what it promises in its OpenAPI document, on good, bad and hostile requests."""

import asyncio
import json
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from http import HTTPStatus

import httpx
import msgspec
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from starlette.routing import Route

from firmware_protocol.contract.commands import Stage
from firmware_protocol.contract.records import MissionPhase
from mapper import errors, request_errors
from mapper.access import Role
from mapper.access import errors as access_errors
from mapper.api.app import create_unguarded_app
from mapper.api.errors import STATUS_OF
from mapper.api.event_stream import EventStream
from mapper.api.guards import MAX_BODY_BYTES
from mapper.length_shares import WHOLE
from mapper.map_snapshot import pack, unpack
from studies.ports import free_port
from tests.mapper.fake_gateway import ANCHOR_NS, FakeGateway, account, encounter, mission
from tests.mapper.mapper_side import Side, mapper_side, until
from tests.mapper.ring import ring_records
from tests.mapper.web_side import BASE, check_against, client_of, meet, openapi_of

HUGE = 2**64 - 1
UNKNOWN = {"command_id": "unknown", "biobot": 77, "number": 77, "version": 77, "job_id": "unknown"}
"""What stands for the parameters of paths: nothing of that name is there."""
_PLACES = {"from": "landmark:1001", "to": "landmark:1005"}
ASKED = {"/api/v1/route": _PLACES, "/api/v1/distance": _PLACES, "/api/v1/maps/{version}/difference": {"since": "1"}}
"""What must be asked along."""
KNOWN = {"command_id": "one", "biobot": HUGE, "number": 1, "version": 1, "job_id": "job1"}


def run(
    story: Callable[[Side, FakeGateway, httpx.AsyncClient], Awaitable[None]], *, with_map: bool = False, role: Role = Role.OPERATOR
) -> None:
    async def whole() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            async with mapper_side(port, with_map=with_map) as side, client_of(side, role=role) as client:
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                await story(side, gateway, client)

    asyncio.run(whole())


def test_every_answer_is_as_the_openapi_document_says() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        document = openapi_of(side)
        assert (await client.get("/openapi.json")).json() == document
        gets = [path for path, methods in document["paths"].items() if "get" in methods and path != "/api/v1/events"]
        await until(lambda: side.current_map.waiting_for.minimum > 0)
        for path in gets:
            check_against(document, path, await client.get(path.format(**UNKNOWN)))
        records = ring_records()
        last = records[-1].offset
        phase = mission(last + 1, phase=MissionPhase.EXPLORATION, t_ns=0, landmarks=(7, HUGE))
        gateway.journal_records([*records, phase, encounter(last + 2, nodes=(1, HUGE), is_void=True)])
        await meet(side, gateway, HUGE)
        gateway.publish_account(account(HUGE))
        await until(lambda: bool(side.history.page()[0]) and bool(side.accounts.all()))
        done = await client.post("/api/v1/commands", json={"biobot": str(HUGE), "action": "stop", "id": "one"})
        assert done.status_code == HTTPStatus.OK
        check_against(document, "/api/v1/commands", done, method="post")
        check_against(document, "/api/v1/stop", await client.post("/api/v1/stop"), method="post")
        ordered = await client.post("/api/v1/mission/orders", json={"action": "start"})
        check_against(document, "/api/v1/mission/orders", ordered, method="post")
        check_against(document, "/api/v1/jobs", await client.post("/api/v1/jobs", json={"kind": "map", "replicates": 0}), method="post")
        async with asyncio.timeout(60):
            await side.jobs.get("job1").is_done.wait()
        pinned = await client.put("/api/v1/pins/door", json={"place": "landmark:1001"})
        check_against(document, "/api/v1/pins/{name}", pinned, method="put")
        for path in gets:
            asked = ASKED.get(path, {})
            answer = await client.get(path.format(**KNOWN), params=asked)
            assert answer.status_code == HTTPStatus.OK, path
            check_against(document, path, answer)
        phases = (await client.get("/api/v1/mission")).json()
        assert phases["phase"]["landmarks"] == [7, HUGE]
        biobots = (await client.get("/api/v1/biobots")).json()["biobots"]
        assert [biobot["key"] for biobot in biobots if biobot["mode"] == "CRW"] == [str(HUGE)]
        for component in document["components"]["schemas"].values():
            assert component.get("description"), component["title"]

    run(story, with_map=True, role=Role.ADMIN)


def test_the_map_is_sent_once_for_a_version() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        gateway.journal_records(ring_records())
        gateway.publish_status()
        await until(lambda: side.current_map.latest is not None)
        for path in ("/api/v1/map", "/api/v1/diagram", "/api/v1/map.geojson", "/api/v1/map.svg", "/api/v1/map.png"):
            first = await client.get(path)
            etag = first.headers["etag"]
            assert first.headers["cache-control"] == "no-cache"
            for tags in (etag, f'"other", {etag}', f"W/{etag}", "*"):
                again = await client.get(path, headers={"If-None-Match": tags})
                assert (again.status_code, again.content, again.headers["etag"]) == (HTTPStatus.NOT_MODIFIED, b"", etag)
            assert (await client.get(path, headers={"If-None-Match": '"other"'})).content == first.content
            head = await client.head(path)
            assert (head.status_code, head.content) == (HTTPStatus.OK, b"")
            assert head.headers["content-length"] == first.headers["content-length"]

    run(story, with_map=True)


def test_lengths_between_points_come_with_a_map_and_for_no_other() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        gateway.journal_records(ring_records())
        gateway.publish_status()
        await until(lambda: side.current_map.latest is not None)
        snapshot = side.current_map.require()
        n_points = len((await client.get("/api/v1/map")).json()["points"])
        newest = await client.get("/api/v1/map/lengths", params={"version": snapshot.version})
        assert len(newest.content) == n_points * (n_points - 1)
        assert (await client.get("/api/v1/map/lengths")).content == newest.content
        assert max(np.frombuffer(newest.content, dtype="<u2")) == WHOLE
        other = await client.get("/api/v1/map/lengths", params={"version": snapshot.version + 1})
        assert (other.status_code, "is not the newest" in other.json()["detail"]) == (HTTPStatus.CONFLICT, True)
        kept = unpack(pack(snapshot.finished))
        assert kept is not None
        assert msgspec.structs.replace(kept.documents, lengths=newest.content) == snapshot.finished.documents

    run(story, with_map=True)


def test_routes_go_both_ways_round_the_ring_or_say_why_not() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        gateway.journal_records(ring_records())
        gateway.publish_status()
        await until(lambda: side.current_map.latest is not None)

        async def ask(begin: str, end: str) -> httpx.Response:
            return await client.get("/api/v1/route", params={"from": begin, "to": end, "classes": 5})

        found = (await ask("landmark:1001", "landmark:1005")).json()
        (first, second) = found["routes"]
        assert found["is_complete"]
        assert first["length"] <= second["length"]
        assert first["passes"][0]["turns"] * second["passes"][0]["turns"] < 0
        landmarks = (await client.get("/api/v1/map")).json()["landmarks"]
        (x, y) = next((0.7 * one["x"], 0.7 * one["y"]) for one in landmarks if one["id"] == 1001)
        for begin, end, status in (
            ("landmark:7", "point:0", HTTPStatus.UNPROCESSABLE_ENTITY),
            ("nowhere", "point:0", HTTPStatus.UNPROCESSABLE_ENTITY),
            ("landmark:1001", "xy:0,0", HTTPStatus.UNPROCESSABLE_ENTITY),  # the middle of the hole, far from where anybody walked
            ("landmark:1001", f"xy:{x},{y}", HTTPStatus.NOT_FOUND),  # in the hole, near its edge
        ):
            answer = await ask(begin, end)
            assert answer.status_code == status
            assert answer.headers["content-type"] == "application/problem+json"

    run(story, with_map=True)


def test_before_the_first_map_the_answer_says_what_is_awaited() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        gateway.journal_records([encounter(1)])
        gateway.publish_status()
        await until(lambda: side.current_map.waiting_for.n_encounters == 1 and side.current_map.waiting_for.minimum > 0)
        for path in ("map", "diagram", "map.geojson", "map.svg", "map.png", "route?from=point:0&to=point:1"):
            answer = await client.get(f"/api/v1/{path}")
            assert answer.status_code == HTTPStatus.SERVICE_UNAVAILABLE
            assert answer.headers["retry-after"] == "1"
            assert answer.json()["detail"] == "not enough encounters yet: 1 of at least 2"
        assert (await client.get("/healthz")).json()["waiting"] == "not enough encounters yet: 1 of at least 2"

    run(story, with_map=True)


def test_encounters_come_in_pages() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        gateway.journal_records([encounter(n) for n in range(1, 251)])
        gateway.publish_status()
        await side.until(lambda store: store.n_encounters == 250)
        seen: list[int] = []
        after: int | None = 0
        while after is not None:
            page = (await client.get("/api/v1/encounters", params={"after": after, "limit": 100})).json()
            seen += [item["sequence"] for item in page["encounters"]]
            after = page["next"]
        assert seen == list(range(1, 251))
        assert page["encounters"][0]["t_start_wall_ns"] == ANCHOR_NS
        for bad in ({"limit": 0}, {"limit": 1001}, {"after": -1}, {"after": "x"}, {"after": 2**63}, {"limit": "1e2"}):
            answer = await client.get("/api/v1/encounters", params=bad)
            assert answer.status_code == HTTPStatus.UNPROCESSABLE_ENTITY
            assert next(iter(bad)) in answer.json()["detail"]

    run(story)


def test_a_command_answers_with_its_stages_and_its_refusals_with_their_reason() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        stop = {"biobot": 5, "action": "stop"}
        unknown = await client.post("/api/v1/commands", json={**stop, "action": "start"})
        assert unknown.status_code == HTTPStatus.NOT_FOUND
        assert "biobot 5" in unknown.json()["detail"]
        await meet(side, gateway, 5)
        done = (await client.post("/api/v1/commands", json={**stop, "biobot": "5", "ttl_ms": 700, "id": "a.b-c_1"})).json()
        assert [stage["stage"] for stage in done["stages"]] == ["accepted", "radio_confirmed", "biobot_confirmed"]
        assert (done["outcome"], done["biobot"], done["operator"], done["stages"][-1]["mode"]) == ("biobot_confirmed", 5, "anna", "S")
        assert (gateway.commands[0].ttl_ms, gateway.commands[0].node) == (700, 5)
        again = (await client.post("/api/v1/commands", json={**stop, "id": "a.b-c_1"})).json()
        assert again == done
        assert len(gateway.commands) == 1
        clash = await client.post("/api/v1/commands", json={**stop, "action": "start", "id": "a.b-c_1"})
        assert clash.status_code == HTTPStatus.CONFLICT
        gateway.answer = lambda _request: (Stage.REFUSED,)
        refused = await client.post("/api/v1/commands", json=stop)
        assert refused.status_code == HTTPStatus.CONFLICT
        assert (refused.json()["reason"], refused.json()["refusal"]) == ("too soon after the train before", "gap")
        gateway.answer = lambda _request: (Stage.ACCEPTED, Stage.FAILED)
        failed = await client.post("/api/v1/commands", json=stop)
        assert (failed.status_code, failed.json()["outcome"]) == (HTTPStatus.OK, "failed")
        listed = (await client.get("/api/v1/commands", params={"limit": 2})).json()["commands"]
        assert [command["outcome"] for command in listed] == ["failed", "refused"]
        assert (await client.get("/api/v1/commands/a.b-c_1")).json() == done
        assert (await client.get("/api/v1/commands/none")).status_code == HTTPStatus.NOT_FOUND

    run(story)


BAD_BODIES: list[tuple[str, bytes]] = [
    ("empty", b""),
    ("no json", b"stop 5"),
    ("cut off", b'{"biobot": 5, "action": "st'),
    ("array", b"[]"),
    ("null", b"null"),
    ("not utf-8", b'{"biobot": 5, "action": "stop", "id": "\xff\xfe"}'),
    ("lone surrogate", b'{"biobot": 5, "action": "stop", "id": "\\ud800"}'),
    ("nan", b'{"biobot": NaN, "action": "stop"}'),
    ("infinity", b'{"biobot": 1e999, "action": "stop"}'),
    ("endless number", b'{"biobot": ' + b"9" * 6000 + b', "action": "stop"}'),
    ("deep", b"[" * 30_000 + b"]" * 30_000),
    ("fraction", b'{"biobot": 5.0, "action": "stop"}'),
    ("truth", b'{"biobot": true, "action": "stop"}'),
    ("negative", b'{"biobot": -1, "action": "stop"}'),
    ("too high", b'{"biobot": 18446744073709551616, "action": "stop"}'),
    ("too high, as text", b'{"biobot": "99999999999999999999", "action": "stop"}'),
    ("other digits", '{"biobot": "٥", "action": "stop"}'.encode()),
    ("no action", b'{"biobot": 5}'),
    ("other action", b'{"biobot": 5, "action": "explode"}'),
    ("who gives it", b'{"biobot": 5, "action": "stop", "operator": "a"}'),
    ("extra", b'{"biobot": 5, "action": "stop", "amplitude_mv": 9000}'),
    ("text for a number", b'{"biobot": 5, "action": "stop", "ttl_ms": "100"}'),
    ("no time", b'{"biobot": 5, "action": "stop", "ttl_ms": 0}'),
    ("too long", b'{"biobot": 5, "action": "stop", "ttl_ms": 60001}'),
    ("nobody to start", b'{"action": "start"}'),
    ("one of all", b'{"biobot": 5, "action": "stop_all"}'),
    ("strange pulse", b'{"biobot": 5, "action": "start", "pulse": {"volts": 9}}'),
    ("no frequency", b'{"biobot": 5, "action": "start", "pulse": {"frequency_hz": 0}}'),
    ("other waveform", b'{"biobot": 5, "action": "start", "pulse": {"waveform": "saw"}}'),
    ("endless wait", b'{"biobot": 5, "action": "stop", "wait_s": 61}'),
    ("id with a slash", b'{"biobot": 5, "action": "stop", "id": "../x"}'),
    ("id with a line break", b'{"biobot": 5, "action": "stop", "id": "x\\n"}'),
]


def test_no_bad_body_reaches_a_gateway() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        await meet(side, gateway, 5)
        document = openapi_of(side)
        for name, body in BAD_BODIES:
            answer = await client.post("/api/v1/commands", content=body, headers={"Content-Type": "application/json"})
            assert answer.status_code in {HTTPStatus.BAD_REQUEST, HTTPStatus.UNPROCESSABLE_ENTITY}, name
            check_against(document, "/api/v1/commands", answer, method="post")
        for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"):
            fine = b'{"biobot": 5, "action": "stop"}'
            answer = await client.post("/api/v1/commands", content=fine, headers={"Content-Type": kind})
            assert answer.status_code == HTTPStatus.UNPROCESSABLE_ENTITY, kind
        assert gateway.commands == []

    run(story)


def test_requests_from_elsewhere_and_requests_too_large_are_refused() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        await meet(side, gateway, 5)
        stop = {"biobot": 5, "action": "stop"}
        for host in ("evil.example", "127.0.0.1.evil.example", "", "[", "localhost@evil.example:80"):
            answer = await client.get("/api/v1/biobots", headers={"Host": host})
            assert answer.status_code == HTTPStatus.MISDIRECTED_REQUEST, host
        for host in ("localhost", "LOCALHOST:8080", "127.0.0.1:1"):
            assert (await client.get("/api/v1/biobots", headers={"Host": host})).status_code == HTTPStatus.OK
        for origin in ("http://evil.example", "null", "http://127.0.0.1:9999"):
            answer = await client.post("/api/v1/commands", json=stop, headers={"Origin": origin})
            assert answer.status_code == HTTPStatus.FORBIDDEN, origin
        large = b'{"id": "' + b"a" * MAX_BODY_BYTES + b'"}'
        announced = await client.post("/api/v1/commands", content=large, headers={"Content-Type": "application/json"})

        async def trickle() -> AsyncIterator[bytes]:
            for _ in range(100):
                yield b" " * 1000

        unannounced = await client.post("/api/v1/commands", content=trickle(), headers={"Content-Type": "application/json"})
        for answer in (announced, unannounced):
            assert answer.status_code == HTTPStatus.REQUEST_ENTITY_TOO_LARGE
            assert answer.headers["content-type"] == "application/problem+json"
        assert gateway.commands == []
        assert (await client.post("/api/v1/commands", json=stop, headers={"Origin": BASE})).status_code == HTTPStatus.OK

    run(story)


def test_every_answer_has_the_headers_that_keep_the_page_to_itself() -> None:
    async def story(_side: Side, _gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        for path in ("/", "/static/main.js", "/static/none.js", "/healthz", "/readyz", "/api/v1/map", "/none", "/openapi.json"):
            answer = await client.get(path)
            assert answer.headers["content-security-policy"].startswith("default-src 'self'")
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert "cache-control" in answer.headers
            assert "access-control-allow-origin" not in answer.headers
            if answer.status_code >= HTTPStatus.BAD_REQUEST and path != "/readyz":
                assert answer.headers["content-type"] == "application/problem+json", path
                assert answer.json()["status"] == answer.status_code
        for path in ("/docs", "/redoc", "/static/../service.py", "/static/%2e%2e/service.py"):
            assert (await client.get(path)).status_code == HTTPStatus.NOT_FOUND
        for method in ("PUT", "DELETE", "PATCH"):
            answer = await client.request(method, "/api/v1/commands")
            assert answer.status_code == HTTPStatus.METHOD_NOT_ALLOWED
            assert answer.headers["content-type"] == "application/problem+json"
        assert (await client.head("/api/v1/events")).status_code == HTTPStatus.METHOD_NOT_ALLOWED

    run(story)


def test_the_page_refers_to_nothing_outside_and_to_nothing_missing() -> None:
    async def story(_side: Side, _gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        page = (await client.get("/")).text
        assert not re.findall(r"(?:src|href)=\"(?:https?:)?//", page)
        for path in re.findall(r"(?:src|href)=\"(/static/[^\"]+)\"", page):
            assert (await client.get(path)).status_code == HTTPStatus.OK, path
        assert "style=" not in page
        assert "<script>" not in page

    run(story)


def test_every_error_of_the_mapper_that_can_reach_the_web_has_a_status() -> None:
    offline = {
        "InputFileError",
        "MapDocumentError",
        "PinsError",
        "OutOfMemoryError",
        "UnknownBiobotError",
        "OutputFileError",
        "TooFewEncountersError",
        "TooManyEncountersError",
        "BusError",
    }
    offline |= {"QueryError", "ListenError", "KernelsError", "SelfTestError", "MapError", "UnlikeMapsError"}
    both = {**vars(errors), **vars(access_errors), **vars(request_errors)}
    leaves = {name for name, value in both.items() if isinstance(value, type) and issubclass(value, errors.MapError)}
    assert leaves - offline == {error.__name__ for error in STATUS_OF}


def test_an_unforeseen_error_tells_nothing_of_the_inside() -> None:
    async def story(side: Side, _gateway: FakeGateway, _client: httpx.AsyncClient) -> None:
        app = create_unguarded_app(side.services, stream=EventStream(side.changes))

        async def fail(_request: object) -> None:
            raise RuntimeError("a secret of the inside")

        app.router.routes.insert(0, Route("/fail", fail))
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app=app, raise_app_exceptions=False), base_url=BASE) as client:
            answer = await client.get("/fail")
        assert answer.status_code == HTTPStatus.INTERNAL_SERVER_ERROR
        assert answer.headers["content-type"] == "application/problem+json"
        assert "secret" not in answer.text

    run(story)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)
command_like = st.fixed_dictionaries(
    {},
    optional={
        "biobot": json_values | st.integers(0, 9),
        "action": json_values | st.sampled_from(["start", "stop"]),
        "ttl_ms": json_values | st.integers(-1, 60_001),
        "id": json_values | st.from_regex(r"\A[A-Za-z0-9._-]{1,8}\Z"),
    },
)


@settings(max_examples=4)
@given(requests=st.lists(command_like | json_values, min_size=40, max_size=40))
def test_no_json_value_makes_the_command_endpoint_fail(requests: list[object]) -> None:
    async def story() -> None:
        async with mapper_side(1) as side, client_of(side) as client:
            document = openapi_of(side)
            for body in requests:
                answer = await client.post("/api/v1/commands", content=json.dumps(body), headers={"Content-Type": "application/json"})
                assert answer.status_code < HTTPStatus.INTERNAL_SERVER_ERROR
                check_against(document, "/api/v1/commands", answer, method="post")

    asyncio.run(story())
