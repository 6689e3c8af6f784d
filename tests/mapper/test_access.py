"""Who is let in: every route is asked, as the OpenAPI document and the application list them, so that none can be forgotten."""

import asyncio
import re
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any

import httpx
from starlette.responses import Response
from starlette.routing import Route

from firmware_protocol.contract.commands import Stage
from mapper.access import ANONYMOUS, Rate, Role, contains_token, revoke_token
from mapper.api.app import create_unguarded_app
from mapper.api.door import Door
from mapper.api.event_stream import EventStream
from mapper.api.guards import Guard
from mapper.changes import Topic
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.mapper_side import Side, mapper_side, until
from tests.mapper.web_side import BASE, check_against, client_of, meet, run_story

SAFE = {"get", "head", "options"}
OPEN = {"/", "/healthz", "/readyz", "/openapi.json"}


def operations(document: dict[str, Any]) -> Iterator[tuple[str, str, Role | None]]:
    """Yield method, path and the role that the document says is needed."""
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            is_open = operation["security"] == []
            yield method, path, None if is_open else Role(operation["x-role"])


async def described(client: httpx.AsyncClient) -> dict[str, Any]:
    document: dict[str, Any] = (await client.get("/openapi.json")).json()
    return document


def filled(path: str) -> str:
    return re.sub(r"\{[^}]*\}", "77", path)


def bearer(text: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {text}"}


def test_every_operation_admits_its_role_and_nobody_below_it() -> None:
    async def story() -> None:
        async with mapper_side(1, writes=Rate(per_s=10.0, burst=1e6)) as side, client_of(side, role=None) as client:
            document = await described(client)
            # A token of each role, one that was revoked, and what is none.
            revoked = side.tokens[Role.ADMIN].text
            admin = (await side.access.register.add(name="eve", role=Role.ADMIN)).text
            me = await client.get("/api/v1/me")
            assert me.json() == {"name": "anonymous", "role": "viewer", "is_anonymous": True}
            texts = {**{role: made.text for role, made in side.tokens.items()}, Role.ADMIN: admin}
            await side.access.register.revoke(side.tokens[Role.ADMIN].record.id)
            flipped = admin[:-1] + ("0" if admin[-1] != "0" else "1")
            none = [f"Bearer {text}" for text in (revoked, flipped, admin[:-1], "", "x" * 5000)]
            none += [f"Basic {admin}", admin, f"Bearer {admin} {admin}"]

            async def ask(method: str, path: str, **how: Any) -> httpx.Response:
                if path == "/api/v1/events" and method == "get":
                    method = "head"  # an endless answer; refused or not, it is told at once
                return await client.request(method, filled(path), **how)

            n_writes = 0
            for method, path, needed in operations(document):
                assert needed is not None or (method in SAFE and path in OPEN)
                assert needed is None or method in SAFE or needed.covers(Role.OPERATOR), (method, path)
                if needed is None:
                    assert (await ask(method, path, headers=bearer(flipped))).status_code != HTTPStatus.UNAUTHORIZED
                    continue
                for shown in none if needed is not Role.VIEWER else none[:1]:
                    answer = await ask(method, path, headers={"Authorization": shown})
                    assert answer.status_code in {HTTPStatus.UNAUTHORIZED, HTTPStatus.TOO_MANY_REQUESTS}, (method, path, shown)
                twice = await ask(method, path, headers=[("Authorization", f"Bearer {admin}")] * 2)
                assert twice.status_code in {HTTPStatus.UNAUTHORIZED, HTTPStatus.TOO_MANY_REQUESTS}
                anonymous = await ask(method, path)
                if needed is not Role.VIEWER:
                    n_writes += method not in SAFE
                    assert anonymous.status_code == HTTPStatus.UNAUTHORIZED, (method, path)
                    assert anonymous.headers["www-authenticate"].startswith("Bearer")
                    check_against(document, path, anonymous, method=method)
                for role, text in texts.items():
                    answer = await ask(method, path, headers=bearer(text))
                    assert (answer.status_code == HTTPStatus.FORBIDDEN) == (not role.covers(needed)), (method, path, role)
                    assert answer.status_code not in {HTTPStatus.UNAUTHORIZED, HTTPStatus.TOO_MANY_REQUESTS}
                    if answer.status_code == HTTPStatus.FORBIDDEN:
                        assert answer.json()["role_needed"] == needed
                        check_against(document, path, answer, method=method)
            assert n_writes >= 5

    asyncio.run(story())


def test_a_route_that_nobody_thought_of_is_closed_and_none_is_open_by_mistake() -> None:
    async def story() -> None:
        async with mapper_side(1) as side:
            app = create_unguarded_app(side.services, stream=EventStream(side.changes))
            asked = []

            async def note(request: Any) -> Response:
                asked.append(request.method)
                return Response()

            app.router.routes.insert(0, Route("/api/v1/new", note, methods=["GET", "POST", "PATCH"]))
            transport = httpx.ASGITransport(app=Door(app, access=side.access))
            async with httpx.AsyncClient(transport=transport, base_url=BASE) as client:
                for role in (None, *Role):
                    headers = {} if role is None else bearer(side.tokens[role].text)
                    for method in ("POST", "PATCH", "GET"):
                        await client.request(method, "/api/v1/new", headers=headers)
                for route in app.routes:
                    path = getattr(route, "path", "")
                    for method in ("POST", "PUT", "PATCH", "DELETE"):
                        assert (await client.request(method, filled(path) or "/static/x")).status_code == HTTPStatus.UNAUTHORIZED, path
            assert asked == ["GET", "GET", "POST", "PATCH", "GET", "POST", "PATCH", "GET"]

    asyncio.run(story())


def test_where_others_may_come_in_whoever_looks_needs_a_token_too() -> None:
    async def story() -> None:
        async with mapper_side(1, allows_anonymous_reading=False) as side, client_of(side, role=None) as client:
            document = await described(client)
            for method, path, needed in operations(document):
                answer = await client.request("head" if path == "/api/v1/events" else method, filled(path))
                assert (answer.status_code == HTTPStatus.UNAUTHORIZED) == (needed is not None), path
            for path in ("/", "/static/main.js", "/openapi.json", "/healthz"):
                assert (await client.get(path)).status_code == HTTPStatus.OK
            assert (await client.get("/api/v1/none")).status_code == HTTPStatus.UNAUTHORIZED
            viewer = bearer(side.tokens[Role.VIEWER].text)
            assert (await client.get("/api/v1/biobots", headers=viewer)).status_code == HTTPStatus.OK
            for role, name in ((Role.VIEWER, "vera"), (Role.OPERATOR, "anna"), (Role.ADMIN, "ada")):
                me = await client.get("/api/v1/me", headers=bearer(side.tokens[role].text))
                check_against(document, "/api/v1/me", me)
                assert me.json() == {"name": name, "role": str(role), "is_anonymous": False}

    asyncio.run(story())


def test_tokens_are_made_used_and_revoked_over_http() -> None:
    async def story() -> None:
        async with mapper_side(1) as side, client_of(side, role=Role.ADMIN) as client:
            document, path = await described(client), "/api/v1/tokens"
            made = await client.post(path, json={"name": " bert ", "role": "operator"})
            check_against(document, path, made, method="post")
            assert (made.status_code, made.json()["name"], made.headers["cache-control"]) == (HTTPStatus.CREATED, "bert", "no-store")
            bert = bearer(made.json()["token"])
            assert (await client.get("/api/v1/me", headers=bert)).json()["name"] == "bert"
            listed = await client.get(path)
            check_against(document, path, listed)
            tokens = listed.json()["tokens"]
            assert [(one["name"], one["role"], one["is_own"]) for one in tokens] == [
                ("vera", "viewer", False),
                ("anna", "operator", False),
                ("ada", "admin", True),
                ("bert", "operator", False),
            ]
            assert tokens[-1]["last_used_wall_ns"] is not None
            assert tokens[0]["last_used_wall_ns"] is None
            assert not contains_token(listed.text)
            own = made.headers["location"]
            person = side.access.register.identify(made.json()["token"])
            assert person is not None
            streams = [
                EventStream(side.changes).open(is_welcome=lambda: side.access.register.is_welcome(person)).body_iterator,
                EventStream(side.changes).open(is_welcome=lambda: side.access.register.is_welcome(ANONYMOUS)).body_iterator,
            ]
            assert all([await anext(aiter(stream)) for stream in streams])
            gone = await client.delete(own)
            check_against(document, f"{path}/{{token_id}}", gone, method="delete")
            assert gone.json()["revoked_wall_ns"] is not None
            assert (await client.get("/api/v1/me", headers=bert)).status_code == HTTPStatus.UNAUTHORIZED
            side.changes.bump(Topic.MAP)
            assert [event async for event in streams[0]] == []  # it ends with the token
            assert await anext(aiter(streams[1]))
            assert (await client.delete(own)).json() == gone.json()
            last = await client.delete(f"{path}/{side.tokens[Role.ADMIN].record.id}")
            assert last.status_code == HTTPStatus.CONFLICT
            for bad in (
                {},
                {"name": "x"},
                {"name": "", "role": "admin"},
                {"name": "dead-man", "role": "viewer"},
                {"name": "x", "role": "king"},
            ):
                refused = await client.post(path, json=bad)
                assert refused.status_code == HTTPStatus.UNPROCESSABLE_ENTITY, bad
                check_against(document, path, refused, method="post")
            assert (await client.delete(f"{path}/00000000")).status_code == HTTPStatus.NOT_FOUND
            assert (await client.delete(f"{path}/xyz")).status_code == HTTPStatus.UNPROCESSABLE_ENTITY
            # Somebody else's change of the file is heeded, and a file that is damaged locks nobody out.
            file = side.access.register._path
            anna = bearer(side.tokens[Role.OPERATOR].text)
            revoke_token(file, token_id=side.tokens[Role.VIEWER].record.id, keeps_admin=False)
            vera = side.tokens[Role.VIEWER].text
            await until(lambda: side.access.register.identify(vera) is None)
            file.write_text("{")
            await until(lambda: side.access.register.fault is not None)
            assert (await client.get("/api/v1/me", headers=anna)).json()["name"] == "anna"
            broken = await client.post(path, json={"name": "carl", "role": "viewer"})
            assert broken.status_code == HTTPStatus.SERVICE_UNAVAILABLE
            check_against(document, path, broken, method="post")

    asyncio.run(story())


def test_a_token_in_a_url_is_refused_and_not_repeated() -> None:
    async def story() -> None:
        async with mapper_side(1) as side, client_of(side) as client:
            token = side.tokens[Role.OPERATOR].text
            ways = ["?token=x", f"?a=1&access_token={token}", f"?q={token}", "?TOKEN", f"?q={token.replace('_', '%5F')}", f"/{token}"]
            for path in ("", "/api/v1/map", "/api/v1/stop", "/static/main.js"):
                for way in ways:
                    answer = await client.request("POST" if path.endswith("stop") else "GET", f"{path}{way}")
                    assert answer.status_code == HTTPStatus.BAD_REQUEST, (path, way)
                    assert "Authorization: Bearer" in answer.json()["detail"]
                    assert token not in answer.text

    asyncio.run(story())


def test_who_writes_too_often_waits_but_no_stop_does() -> None:
    async def story() -> None:
        seldom = Rate(per_s=0.01, burst=3.0)  # on a busy machine a few requests take a second
        async with mapper_side(1, writes=seldom) as side, client_of(side) as client:
            document, orders = await described(client), "/api/v1/mission/orders"
            start, stop = {"biobot": 5, "action": "start"}, {"biobot": 5, "action": "stop", "wait_s": 0}
            answers = [await client.post("/api/v1/commands", json=start) for _ in range(8)]
            assert HTTPStatus.TOO_MANY_REQUESTS in {answer.status_code for answer in answers}
            answers = [await client.post(orders, json={}) for _ in range(8)]
            late = [answer for answer in answers if answer.status_code == HTTPStatus.TOO_MANY_REQUESTS]
            assert late
            assert int(late[0].headers["retry-after"]) >= 1
            check_against(document, orders, late[0], method="post")
            for body, path in ((None, "/api/v1/stop"), (stop, "/api/v1/commands")):
                for _ in range(40):
                    given = await client.post(path, json=body or {"wait_s": 0})
                    assert given.status_code not in {HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.UNAUTHORIZED}
            # Wrong tokens are slowed down, but neither for stops nor for whoever has a right one.
            wrong = bearer("biobot_00000000_" + "0" * 64)
            told = [(await client.post(orders, headers=wrong)).status_code for _ in range(20)]
            assert told[0] == HTTPStatus.UNAUTHORIZED
            assert told[-1] == HTTPStatus.TOO_MANY_REQUESTS
            assert (await client.post("/api/v1/stop", headers=wrong)).status_code == HTTPStatus.UNAUTHORIZED
            assert (await client.get("/api/v1/me")).json()["name"] == "anna"
            assert side.access.refused["refused_rate"] > 0

    asyncio.run(story())


def test_a_command_bears_the_name_of_the_tokens_holder_and_no_other() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        (gateway,) = gateways
        await meet(side, gateway, 5)
        gateway.answer = lambda _request: (Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)
        stop = {"biobot": 5, "action": "stop"}
        for path, body in (("/api/v1/commands", stop), ("/api/v1/stop", {}), ("/api/v1/mission/orders", {"action": "start"})):
            refused = await client.post(path, json={**body, "operator": "bert"})
            assert refused.status_code == HTTPStatus.UNPROCESSABLE_ENTITY
            assert "the name of the token's holder; leave it out" in refused.json()["detail"]
        assert (gateway.commands, gateway.orders) == ([], [])
        await client.post("/api/v1/commands", json=stop)
        await client.post("/api/v1/stop")
        await client.post("/api/v1/mission/orders", json={"action": "start"})
        assert {one.operator for one in gateway.commands} | {one.operator for one in gateway.orders} == {"anna"}

    run_story(story)


def test_what_keeps_the_page_to_itself_over_tls_too() -> None:
    async def story() -> None:
        for is_tls in (False, True):
            app = Guard(Response("fine"), allowed_hosts=None, is_tls=is_tls)
            async with httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url=BASE) as client:
                headers = (await client.get("/")).headers
            assert ("strict-transport-security" in headers) == is_tls
            assert "geolocation=()" in headers["permissions-policy"]

    asyncio.run(story())
