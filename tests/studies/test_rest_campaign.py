"""What the OpenAPI document says holds for a hundred generated requests to a real mapper; and the campaign finds what does not hold."""

from http import HTTPStatus
from pathlib import Path

import httpx
import pytest
import requests
from urllib3 import HTTPResponse

from mapper.access import Role, add_token
from studies.ports import free_port
from studies.rest_campaign.asked import Asked, Way
from studies.rest_campaign.askers import Asker, Target, is_let_in
from studies.rest_campaign.campaign import run_campaign
from studies.rest_campaign.judge import judge
from studies.rest_campaign.operations import Operation, load_operations
from studies.rest_campaign.tally import Tally, write_command, write_report
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.ring import ring_records
from tests.mapper.serving import serving, until

TARGET = Target(url="http://127.0.0.1:1", tokens={role: f"biobot_{role}" for role in Role})
SIZED = {"type": "object", "required": ["size"], "properties": {"size": {"type": "integer"}}}
GET_THING = {
    "operationId": "get_thing",
    "x-role": "viewer",
    "parameters": [{"name": "name", "in": "path", "required": True, "schema": {"type": "string"}}],
    "responses": {"200": {"description": "It", "content": {"application/json": {"schema": SIZED}}}},
}
DOCUMENT = {"openapi": "3.1.0", "info": {"title": "a service", "version": "1"}, "paths": {"/things/{name}": {"get": GET_THING}}}
NOT_DESCRIBED = "nothing is told that is not described"
STRICT = {"Content-Security-Policy": "", "X-Content-Type-Options": "", "X-Frame-Options": "", "Referrer-Policy": ""}


@pytest.mark.campaign
def test_what_the_document_says_holds_for_a_hundred_requests(tmp_path: Path) -> None:
    port = free_port()
    tokens = {role: add_token(tmp_path / "tokens.json", name=f"the {role}", role=role).text for role in Role}
    with FakeGateway(port=port) as gateway:
        gateway.journal_records(ring_records())
        with serving(tmp_path, connect=port) as (url, _process):
            until(lambda: httpx.get(url + "readyz", timeout=60).json()["is_connected"])
            gateway.publish_status()
            gateway.publish_node(1)
            until(lambda: httpx.get(url + "api/v1/maps", timeout=60).json()["maps"] != [])
            tally = run_campaign(Target(url=url.rstrip("/"), tokens=tokens), n_cases=100, seed_number=1)
    assert not tally.failures, write_report(tally, {})
    assert tally.n_cases >= 100
    assert set(tally.kinds) >= set(Asker)
    answered = {status for counts in tally.statuses.values() for status in counts}
    assert answered >= {HTTPStatus.OK, HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.NOT_FOUND, HTTPStatus.METHOD_NOT_ALLOWED}


def the_operation() -> Operation:
    (operation,) = load_operations(DOCUMENT)
    return operation


def answered(status: int, body: bytes, kind: str = "application/json", **fields: str) -> requests.Response:
    answer = requests.Response()
    answer.status_code = status
    answer._content = body
    answer.headers.update({**STRICT, "Content-Type": kind, **fields})
    answer.raw = HTTPResponse(body, headers=answer.headers, status=status)
    answer.request = requests.Request("GET", TARGET.url + "/things/a", headers={"Authorization": "Bearer biobot_viewer"}).prepare()
    answer.url = str(answer.request.url)
    return answer


def faults_of(answer: requests.Response, *, asker: Asker = Asker.VIEWER, way: Way = Way.VALID) -> set[str]:
    operation = the_operation()
    case = operation.api.Case(path_parameters={"name": "a"})
    return {fault.rule for fault in judge(operation, Asked(way=way, asker=asker, case=case, headers={}), answer)}


def test_an_answer_as_described_breaks_no_rule() -> None:
    assert faults_of(answered(200, b'{"size": 1}')) == set()
    assert faults_of(answered(200, b""), way=Way.HEAD) == set()


@pytest.mark.parametrize(
    ("answer", "rules"),
    [
        (answered(500, b'{"size": 1}'), {"no server error", "Undocumented status code"}),
        (answered(200, b'{"size": "x"}'), {"Response violates schema", NOT_DESCRIBED}),
        (answered(200, b"{}"), {"Response violates schema", NOT_DESCRIBED}),
        (answered(200, b'{"size": 1, "colour": "red"}'), {NOT_DESCRIBED}),
        (answered(200, b'{"size": 1}', "text/plain"), {"Undocumented Content-Type"}),
        (answered(404, b"{}"), {"Undocumented status code"}),
        (answered(401, b"{}"), {"whoever may is let in", "Undocumented status code"}),
    ],
)
def test_each_rule_that_is_broken_is_told(answer: requests.Response, rules: set[str]) -> None:
    assert faults_of(answer) == rules


def test_whoever_may_not_must_be_refused() -> None:
    assert "whoever may not is refused" in faults_of(answered(200, b'{"size": 1}'), asker=Asker.STRANGER)
    assert "whoever may not is refused" in faults_of(answered(404, b"{}"), asker=Asker.STRANGER)
    assert "401 says how to be let in" in faults_of(answered(401, b"{}"), asker=Asker.STRANGER)
    assert "HEAD has no body" in faults_of(answered(200, b"{}"), way=Way.HEAD)


@pytest.mark.parametrize("asker", Asker)
def test_who_is_let_in(asker: Asker) -> None:
    ranks = {Asker.STRANGER: 0, Asker.ANONYMOUS: 1, Asker.VIEWER: 1, Asker.OPERATOR: 2, Asker.ADMIN: 3}
    allowed = [is_let_in(asker, needed=needed) for needed in (None, Role.VIEWER, Role.OPERATOR, Role.ADMIN)]
    assert allowed == [rank <= ranks[asker] for rank in range(4)]


def test_a_failure_is_told_once_with_the_shortest_request_and_without_a_token() -> None:
    tally = Tally()
    long, short = answered(500, b"{}"), answered(500, b"{}")
    long.request = requests.Request("GET", TARGET.url + "/things/abcdef", headers={"Authorization": "Bearer biobot_viewer"}).prepare()
    operation = the_operation()
    asked = Asked(way=Way.VALID, asker=Asker.VIEWER, case=operation.api.Case(path_parameters={"name": "a"}), headers={})
    for answer in (long, short, long):
        tally.count("get_thing", answer, judge(operation, asked, answer)[:1], kinds=(asked.asker,), target=TARGET)
    (failure,) = tally.failures.values()
    assert (failure.count, failure.command) == (3, "curl -si -X GET -H 'Authorization: Bearer $VIEWER' $URL/things/a")
    report = write_report(tally, {"seed": 1})
    assert "biobot_viewer" not in report
    assert failure.command in report
    assert "| `get_thing` | 3 | 500 ×3 |" in report


def test_a_body_that_is_no_text_is_written_as_bytes() -> None:
    request = requests.Request("POST", TARGET.url + "/things", data=b"\x00'\xff").prepare()
    assert write_command(request, target=TARGET).startswith(r"printf '\x00\x27\xff' | curl -si -X POST")
