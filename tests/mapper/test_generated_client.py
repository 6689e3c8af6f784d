"""A client that a generator made of the OpenAPI document alone calls every operation of a real server, and so do the examples."""

import argparse
import asyncio
import importlib
import inspect
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from http import HTTPStatus
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import httpx
import pytest

from studies.ports import free_port
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.mapper_side import mapper_side
from tests.mapper.ring import ring_records
from tests.mapper.serving import serving, token_of, until
from tests.mapper.web_side import openapi_of

ROOT: Final = Path(__file__).parent.parent.parent
_CONFIG: Final = {
    "post_hooks": [],
    # What the generator does not know by name.
    "content_type_overrides": {
        "image/png": "application/octet-stream",
        "image/svg+xml": "text/plain",
        "application/geo+json": "application/json",
        "application/vnd.apache.parquet": "application/octet-stream",
    },
}
_KNOWN: Final[dict[str, object]] = {
    "from_": "landmark:1001",
    "to": "landmark:1005",
    "number": 1,
    "name": "door",
    "biobot": "1001",
}
_PERIOD: Final = {"get_encounters_csv", "get_encounters_parquet"}
_NOT_CALLED: Final = {"get_events"}
"""An endless answer."""


@pytest.fixture
def package(tmp_path: Path) -> Iterator[str]:
    """Name the package that is generated, and forget it afterwards."""
    sys.path.insert(0, str(tmp_path))
    yield "biobot_client"
    sys.path.remove(str(tmp_path))
    for name in [name for name in sys.modules if name.partition(".")[0] == "biobot_client"]:
        del sys.modules[name]


def generate(directory: Path, document: dict[str, Any], *, package: str) -> None:
    """Have the client made; a warning of the generator is a fault of the document."""
    (directory / "openapi.json").write_text(json.dumps(document))
    (directory / "config.json").write_text(json.dumps(_CONFIG))
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--path", "openapi.json", "--config", "config.json"]
    command += ["--meta", "none", "--output-path", package, "--fail-on-warning"]
    made = subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=120, check=False)
    assert made.returncode == 0, made.stdout + made.stderr


def operations(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield method, path, operation


def find(package: str, operation: dict[str, Any]) -> ModuleType:
    tag = operation["tags"][0]
    return importlib.import_module(f"{package}.api.{tag + '_' if tag == 'map' else tag}.{operation['operationId']}")


def examples() -> list[str]:
    """Return the calls of curl in docs/rest.md."""
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "docs" / "rest.md").read_text(), re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


def run_example(example: str, *, url: str, token: str) -> httpx.Response:
    """Send what curl would."""
    program, *rest = shlex.split(example.replace("$URL", url).replace("$TOKEN", token))
    assert program == "curl"
    parser = argparse.ArgumentParser()
    parser.add_argument("url")
    parser.add_argument("-X", dest="method", default="GET")
    parser.add_argument("-H", dest="headers", action="append", default=[])
    parser.add_argument("-d", dest="content")
    parser.add_argument("-o", dest="output")
    parser.add_argument("--compressed", action="store_true")
    asked = parser.parse_args(rest)
    headers = dict(one.split(": ", 1) for one in asked.headers)
    return httpx.request(asked.method, asked.url, headers=headers, content=asked.content, timeout=60)


def test_a_generated_client_calls_every_operation(tmp_path: Path, package: str) -> None:
    port = free_port()
    with ExitStack() as stack, FakeGateway(port=port) as gateway:
        gateway.journal_records(ring_records())
        with serving(tmp_path, connect=port) as (url, _process):
            document = httpx.get(url + "openapi.json", timeout=60).json()
            generate(tmp_path, document, package=package)
            until(lambda: httpx.get(url + "readyz", timeout=60).json()["is_connected"])
            gateway.publish_status()
            gateway.publish_node(1001)
            client = importlib.import_module(f"{package}.client").AuthenticatedClient(
                base_url=url.rstrip("/"), token=token_of(tmp_path), raise_on_unexpected_status=True
            )
            stack.callback(client.get_httpx_client().close)
            models = importlib.import_module(f"{package}.models")
            until(lambda: httpx.get(url + "api/v1/maps", timeout=60).json()["maps"] != [])

            def call(called: str, /, **arguments: object) -> Any:
                operation = next(one for _, _, one in operations(document) if one["operationId"] == called)
                return find(package, operation).sync_detailed(client=client, **arguments)

            made = call("put_pin", name="door", body=models.PinBody.from_dict({"place": "landmark:1001", "x": 0.0, "y": 0.0}))
            assert (made.status_code, made.parsed.name, made.parsed.component) == (HTTPStatus.CREATED, "door", 0)
            job = call("post_job", body=models.JobBody.from_dict({"kind": "map", "replicates": 0})).parsed
            until(lambda: call("get_job", job_id=job.id).parsed.state == "done")
            known = _KNOWN | {"job_id": job.id, "version": call("get_map").parsed.version}
            done = set(_NOT_CALLED)
            for method, path, operation in operations(document):
                name = operation["operationId"]
                if method != "get" or name in done:
                    continue
                wanted = inspect.signature(find(package, operation).sync_detailed).parameters
                chosen = {one: known[one] for one in wanted if one in known and not (one == "from_" and name in _PERIOD)}
                if "since" in wanted and "since" not in chosen and wanted["since"].default is inspect.Parameter.empty:
                    chosen["since"] = known["version"]
                missing = {one for one, about in wanted.items() if about.default is inspect.Parameter.empty} - {"client", *chosen}
                if missing == {"command_id"}:
                    chosen["command_id"] = call("post_stop", body=models.StopBody.from_dict({})).parsed.answers[0].command_id
                answer = find(package, operation).sync_detailed(client=client, **chosen)
                if operation.get("x-role") == "admin":
                    assert (answer.status_code, type(answer.parsed)) == (HTTPStatus.FORBIDDEN, models.Problem), path
                else:
                    assert answer.status_code == HTTPStatus.OK, (path, answer.content)
                    assert answer.parsed is not None, path
                done.add(name)
            assert call("get_betti").parsed.hole_count.value == call("get_holes").parsed.holes[0].number == 1
            assert call("delete_pin", name="door").status_code == HTTPStatus.NO_CONTENT
            told = examples()
            assert len(told) >= 10
            for example in told:
                answer = run_example(example, url=url.rstrip("/"), token=token_of(tmp_path))
                assert answer.is_success, (example, answer.text)
            unknown = call("delete_pin", name="door")
            assert (unknown.status_code, unknown.parsed.status) == (HTTPStatus.NOT_FOUND, 404)


def test_the_document_names_and_explains_what_it_has() -> None:
    """The names are what clients call: whoever changes one breaks them."""

    async def ask() -> dict[str, Any]:
        async with mapper_side(1) as side:
            return openapi_of(side)

    document = asyncio.run(ask())
    tags = {tag["name"] for tag in document["tags"]}
    names = [operation["operationId"] for _, _, operation in operations(document)]
    assert len(names) == len(set(names))
    assert {"get_map", "get_betti", "get_holes", "get_distance", "get_coverage", "put_pin", "post_job", "post_stop"} <= set(names)
    assert document["servers"] == [{"url": "/", "description": "This mapper"}]
    for _, path, operation in operations(document):
        assert set(operation["tags"]) <= tags, path
        assert operation["description"], path
        for parameter in operation.get("parameters", []):
            assert parameter.get("description") or parameter["schema"].get("description"), (path, parameter)
        for status, answer in operation["responses"].items():
            kinds = set(answer.get("content", {}))
            assert len(kinds) <= 1, (path, status, kinds)
            assert answer["description"], (path, status)
