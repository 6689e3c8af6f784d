"""What is said of requests that do not fit: the field, what was sent, the limit and the next step; and nothing passes unnoticed."""

import re
from http import HTTPStatus
from typing import Any

import httpx
import pytest

from mapper.api.refusals import describe_fault, nearest_first
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.mapper_side import Side
from tests.mapper.test_api import run
from tests.mapper.web_side import check_against, meet, openapi_of

_TOKEN = "biobot_1f0c93aa_" + "ab" * 32
_STOP = "/api/v1/stop"


def test_no_operation_passes_over_a_query_parameter_that_it_does_not_have() -> None:
    """But a stop, which nothing refuses, and what monitors ask."""

    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        await meet(side, gateway, 5)
        document = openapi_of(side)
        for path, operations in document["paths"].items():
            for method, operation in operations.items():
                names = {one["name"] for one in operation.get("parameters", []) if one["in"] == "query"}
                asked = {"versoin": "3"}
                body = {"action": "start", "biobot": 5} if path.endswith("/commands") else {"action": "stop", "place": "point:1"}
                kwargs: dict[str, Any] = {"json": body} if method in {"post", "put"} and path != _STOP else {}
                answer = await client.request(method, re.sub(r"\{.*?\}", "1", path), params=asked, **kwargs)
                if not path.startswith("/api/") or path == _STOP:
                    assert answer.status_code != HTTPStatus.UNPROCESSABLE_ENTITY, path
                    continue
                if answer.status_code == HTTPStatus.FORBIDDEN:
                    continue  # not for operators
                assert answer.status_code == HTTPStatus.UNPROCESSABLE_ENTITY, (path, answer.text)
                told = answer.json()
                if "parameter" not in told:
                    continue  # its body was looked at first
                assert (told["parameter"], set(told["parameters"])) == ("versoin", names), path
                assert "'versoin'" in told["detail"]
                check_against(document, path, answer, method=method)
        nearest = (await client.get("/api/v1/encounters", params={"limmit": 3})).json()["parameters"]
        assert nearest == ["limit", "after"]
        stop = await client.post("/api/v1/commands", params={"wait": 0}, json={"biobot": 5, "action": "stop"})
        assert stop.status_code == HTTPStatus.OK, "a stop is never refused"
        assert (await client.get("/api/v1/map?")).status_code == HTTPStatus.SERVICE_UNAVAILABLE, "an empty query is none"

    run(story, with_map=False)


REFUSED: tuple[tuple[str, str, dict[str, Any], str], ...] = (
    ("get", "encounters", {"limit": 5000}, 'query.limit is "5000", but should be less than or equal to 1000; give 1000 or less'),
    ("get", "encounters", {"after": "x" * 99}, f'query.after is "{"x" * 59}… (101 characters), but should be a valid integer'),
    ("get", "route", {"from": "point:1"}, "query.to is missing; give it"),
    ("get", "holes/0", {}, 'path.number is "0", but should be greater than or equal to 1; give 1 or more'),
    ("post", "jobs", {"kind": "map", "n_points": 3}, "body.n_points is 3, but should be greater than or equal to 4; give 4 or more"),
    ("post", "jobs", {"n_pionts": 9}, "body.n_pionts is no field of this request; leave it out, or give one of: n_points"),
    ("post", "commands", {"biobot": 5, "action": "jump"}, "body.action is \"jump\", but should be 'start', 'stop'"),
    ("post", "commands", {"action": "stop"}, "body: biobot must be left out for stop_all"),
    (
        "post",
        "stop",
        {"wait_s": 1e9},
        "nothing was stopped (a POST without a body stops all): body.wait_s is 1000000000.0, but should be less",
    ),
)


def test_a_refusal_names_the_field_the_value_the_limit_and_the_next_step() -> None:
    async def story(side: Side, gateway: FakeGateway, client: httpx.AsyncClient) -> None:
        for method, name, sent, told in REFUSED:
            path = f"/api/v1/{name}"
            answer = await (client.get(path, params=sent) if method == "get" else client.post(path, json=sent))
            assert answer.status_code == HTTPStatus.UNPROCESSABLE_ENTITY, name
            assert told in answer.json()["detail"]

    run(story)


@pytest.mark.parametrize(
    "fault",
    [
        {"loc": ("body", "name"), "type": "string_too_long", "msg": "Input should be short", "input": _TOKEN, "ctx": {"max_length": 1}},
        {"loc": ("body", "name"), "type": "string_type", "msg": "Input should be text", "input": {"a": [_TOKEN]}},
        {"loc": ("body", "password"), "type": "string_type", "msg": "Input should be text", "input": "hunter2" + _TOKEN},
        {"loc": ("body", _TOKEN), "type": "extra_forbidden", "msg": "Extra inputs are not permitted", "input": _TOKEN},
    ],
)
def test_no_secret_is_repeated(fault: dict[str, object]) -> None:
    told = describe_fault(fault)
    assert "(not repeated here)" in told
    assert "ab" * 8 not in told
    assert "hunter2" not in told


@pytest.mark.parametrize("value", ["\ud800", "\0\n", 10**400, float("nan"), {1: {2}}, ["x"] * 10_000])
def test_whatever_was_sent_is_shown_as_short_plain_text(value: object) -> None:
    told = describe_fault({"loc": ("body", "\ud800\n" * 99), "type": "int_type", "msg": "Input should be a valid integer", "input": value})
    assert told.isprintable()
    assert len(told) < 400
    assert told.endswith("give a whole number, as 12")


def test_the_nearest_name_comes_first() -> None:
    assert nearest_first("form", ("until", "to", "from")) == ("from", "to", "until")
    assert nearest_first("x" * 10_000, ()) == ()
