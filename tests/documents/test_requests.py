"""Every ``curl`` of the documents is sent to a mapper, as it stands there, and is answered well."""

import asyncio

import httpx

from mapper.access import Role
from studies.ports import free_port
from tests.documents.commands import Command, block_commands
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.mapper_side import mapper_side, until
from tests.mapper.ring import ring_records
from tests.mapper.web_side import BASE, client_of, meet

REQUESTS = [one for one in block_commands() if one.program == "curl"]
_WITHOUT_VALUE = {"-OJ", "--compressed"}


def read(command: Command, *, token: str) -> httpx.Request:
    """Read the command line as curl would; only what documents need is understood."""
    words, method, headers, body, url = list(command.words[1:]), "", {}, None, ""
    while words:
        match words.pop(0):
            case "-X":
                method = words.pop(0)
            case "-H":
                name, _, value = words.pop(0).partition(": ")
                headers[name] = value.replace("$TOKEN", token)
            case "-d":
                body = words.pop(0)
            case "-o":
                words.pop(0)
            case word if word in _WITHOUT_VALUE:
                pass
            case word:
                assert not word.startswith("-"), f"{command.line}: the test does not understand {word}"
                url = word.replace("$URL", BASE).replace("http://127.0.0.1:8080", BASE)
    return httpx.Request(method or ("GET" if body is None else "POST"), url, headers=headers, content=body)


def test_the_requests_of_the_documents_are_answered() -> None:
    async def story() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            async with mapper_side(port, with_map=True) as side, client_of(side, role=None) as client:
                for biobot in (3, 7, 17):
                    await meet(side, gateway, biobot)
                await side.take_in(ring_records())
                await until(lambda: side.current_map.latest is not None)
                for command in REQUESTS:
                    answer = await client.send(read(command, token=side.tokens[Role.OPERATOR].text))
                    assert answer.is_success, (command.document, command.line, answer.status_code, answer.text[:500])

    assert REQUESTS
    asyncio.run(story())
