"""The mapper's parts behind its web application, for a story with gateways."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import ExitStack, asynccontextmanager
from typing import Any

import httpx
from jsonschema_rs import Draft202012Validator

from firmware_protocol.units import NodeId
from mapper.access import Role
from mapper.api.app import create_app, create_unguarded_app
from mapper.api.event_stream import EventStream
from studies.ports import free_port
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.mapper_side import Side, mapper_side, until

BASE = "http://127.0.0.1"


@asynccontextmanager
async def client_of(side: Side, *, role: Role | None = Role.OPERATOR) -> AsyncIterator[httpx.AsyncClient]:
    """Yield a client that shows the token of a role's holder (anna is the operator), or none."""
    app = create_app(side.services, stream=EventStream(side.changes), allowed_hosts={"127.0.0.1", "localhost"})
    headers = {} if role is None else {"Authorization": f"Bearer {side.tokens[role].text}"}
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url=BASE, headers=headers) as client:
        yield client


def openapi_of(side: Side) -> dict[str, Any]:
    return create_unguarded_app(side.services, stream=EventStream(side.changes)).openapi()


def check_against(document: dict[str, Any], path: str, answer: httpx.Response, *, method: str = "get") -> None:
    """The status is a documented one, and the body is as described."""
    described = document["paths"][path][method]["responses"][str(answer.status_code)]
    content = described.get("content", {})
    media_type = answer.headers.get("content-type", "").split(";")[0]
    if answer.status_code == httpx.codes.NOT_MODIFIED:
        assert answer.content == b""
        return
    assert media_type in content
    if "json" in media_type:
        schema = {**content[media_type]["schema"], "components": document["components"]}
        Draft202012Validator(schema).validate(answer.json())


Story = Callable[[Side, list[FakeGateway], httpx.AsyncClient], Awaitable[None]]


def run_story(story: Story, *, n_gateways: int = 1) -> None:
    """Run a story with gateways that are known to the mapper, and hear it."""

    async def whole() -> None:
        ports = [free_port() for _ in range(n_gateways)]
        with ExitStack() as stack:
            gateways = [stack.enter_context(FakeGateway(port=port, name=f"gateway{n}")) for n, port in enumerate(ports, 1)]
            async with mapper_side(ports[0], more_ports=ports[1:]) as side, client_of(side) as client:
                await until(lambda: all(gateway.is_heard and side.fleet.is_on_bus(gateway.name) for gateway in gateways))
                await story(side, gateways, client)

    asyncio.run(whole())


async def meet(side: Side, gateway: FakeGateway, node: int) -> None:
    """Have a mapper learn of a biobot."""
    gateway.publish_status()
    gateway.publish_node(node)
    await until(lambda: side.fleet.gateway_of(NodeId(node)) is not None)
