"""Tables of docs/reference.md that are read from the code: REST, its errors, refusals of commands, metrics of the gateway."""

import ast
import inspect
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from firmware_protocol.contract.commands import Refusal
from firmware_protocol.contract.mission_orders import MissionAction
from gateway.health import Health, RadioState
from gateway.monitor.exposition import DURATIONS, make_registry
from gateway.vitals import DiskUse, Vitals
from mapper.api.app import create_unguarded_app
from mapper.api.errors import STATUS_OF
from mapper.api.event_stream import EventStream
from mapper.api.services import Services
from mapper.changes import Changes


def openapi_document() -> dict[str, Any]:
    """Return the OpenAPI document of a mapper that may be read without a token on its own machine, as it is by default."""
    # The application asks its services when it is asked itself; its document says of them no more than who may read.
    services = cast("Services", SimpleNamespace(access=SimpleNamespace(allows_anonymous_reading=True, register=None)))
    return create_unguarded_app(services, stream=EventStream(Changes())).openapi()


def operations() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield method, path and description of every operation of the mapper's API."""
    for path, methods in openapi_document()["paths"].items():
        for method, operation in methods.items():
            yield method.upper(), path, operation


def metrics() -> Iterator[tuple[str, str, tuple[str, ...], str]]:
    """Yield name, type, labels and meaning of every metric of the gateway's own, of a gateway that has and knows all it can."""
    health = Health()
    health.set_radio("serial:/dev/ttyACM0", RadioState.UP)
    health.of_radio("serial:/dev/ttyACM0").count("of.another")
    health.set_level("journal.waiting", 1)
    health.set_level("of.another", 1)
    for name in DURATIONS:
        health.observe(name, 0.0)
    vitals = Vitals(health=health, journal=Path("gateway.sqlite"))
    vitals.disk, vitals.head_offset, vitals.n_links = DiskUse(journal_bytes=0, free_bytes=0), 0, 0
    vitals.watermarks["map1"] = 0
    health.count("of.another")
    for family in make_registry(vitals).collect():
        if not family.name.startswith("biobot_"):
            continue
        labels = tuple(dict.fromkeys(label for sample in family.samples for label in sample.labels if label != "le"))
        name = f"{family.name}_total" if family.type == "counter" else family.name
        yield name, family.type, labels, family.documentation


def members(kind: type[Enum]) -> Iterator[tuple[str, str]]:
    """Yield each value of an enumeration and what the line below it in the source says of it.

    Raises
    ------
    LookupError
        A value has no such line.
    """
    (tree,) = ast.parse(inspect.cleandoc("\n" + inspect.getsource(kind))).body
    body = cast("ast.ClassDef", tree).body
    for at, one in enumerate(body):
        if isinstance(one, ast.Assign):
            value = str(ast.literal_eval(one.value))
            match body[at + 1 : at + 2]:
                case [ast.Expr(value=ast.Constant(value=str(said)))]:
                    yield value, " ".join(said.split())
                case _:
                    msg = f"{kind.__name__}: nothing says what {value} means; write it as a docstring below the value"
                    raise LookupError(msg)


def code_tables() -> list[str]:
    """Return the lines of all these tables."""
    lines = [
        "## REST",
        "",
        "What each answers, and with which fields, is in `/openapi.json` of the mapper ([rest.md](rest.md)). Role: the least that may.",
        "",
    ]
    lines += ["| request | operation | query | role | |", "|---|---|---|---|---|"]
    for method, path, operation in operations():
        asked = ", ".join(f"`{one['name']}`" for one in operation.get("parameters", []) if one["in"] == "query")
        about = operation["description"].split("\n\nFor: ")[0].split("\n\n")[0]
        lines += [table_row(f"`{method} {path}`", f"`{operation['operationId']}`", asked, operation.get("x-role", "-"), about)]
    lines += [
        "",
        "### Errors",
        "",
        "As `application/problem+json`; several causes share a status, `detail` says which it is and what to do.",
        "",
    ]
    lines += ["| status | when |", "|---|---|"]
    for kind, status in sorted(STATUS_OF.items(), key=lambda one: (one[1].value, one[0].__name__)):
        lines += [table_row(f"{status.value} {status.phrase}", (inspect.getdoc(kind) or "").split("\n\n")[0])]
    lines += [
        "",
        "## Refusals of commands",
        "",
        "`refusal` of a stage, on the bus and over REST; its `reason` says value, limit and next step.",
        "",
    ]
    lines += ["| `refusal` | |", "|---|---|", *(table_row(f"`{value}`", about) for value, about in members(Refusal))]
    lines += [
        "",
        "## Orders to a mission",
        "",
        "| `action` | |",
        "|---|---|",
        *(table_row(f"`{value}`", about) for value, about in members(MissionAction)),
    ]
    lines += [
        "",
        "## Metrics of the gateway",
        "",
        "At `/metrics` of `--monitor` ([operation.md](operation.md)), beside `process_*` and `python_*`.",
        "",
    ]
    lines += ["| metric | type | labels | |", "|---|---|---|---|"]
    lines += [table_row(f"`{name}`", kind, ", ".join(f"`{one}`" for one in labels), about) for name, kind, labels, about in metrics()]
    return lines


def table_row(*cells: str) -> str:
    """Return a row of a table; what would end a cell, or the row, is put otherwise."""
    return f"| {' | '.join(' '.join(cell.replace('``', '`').replace('|', '/').split()) for cell in cells)} |"
