"""Send generated requests to a mapper until there were enough, and judge every answer."""

import json
from collections.abc import Callable, Iterator, Sequence
from http import HTTPStatus
from itertools import count
from math import ceil
from random import Random
from typing import Any, Final

import requests
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from studies.rest_campaign.asked import Asked, Way, requests_of
from studies.rest_campaign.askers import STRANGE_TOKENS, Asker, Target, is_let_in
from studies.rest_campaign.judge import Fault, judge, judge_other
from studies.rest_campaign.known import learn
from studies.rest_campaign.operations import Operation, load_operations
from studies.rest_campaign.tally import NO_ANSWER, Tally

_TIMEOUT_S: Final = 60
_METHODS: Final = ("GET", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "BREW")
_NOWHERE: Final = (
    "/nothing",
    "/api",
    "/api/v1",
    "/api/v1/nothing",
    "/api/v1/map/",
    "/api/v2/map",
    "/static/nothing.js",
    "/static/..%2Fservice.py",
    "/docs",
)
_N_ROUNDS: Final = 2
"""Requests of the first make what those of the second ask about."""
_EMPTY_ROUNDS: Final = 3
_SHARE_OF_OTHERS: Final = 10
"""One request in so many, at most, is for what the document does not have."""
_LEAST_OF_GROUP: Final = 40
_SEEDS_PER_ROUND: Final = 1000


def run_campaign(target: Target, *, n_cases: int, seed_number: int, tell: Callable[[str], None] = lambda _line: None) -> Tally:
    """Ask ``n_cases`` times, as evenly over the operations as they have different requests."""
    with requests.Session() as session:
        session.trust_env = False
        document: dict[str, Any] = session.get(target.url + "/openapi.json", timeout=_TIMEOUT_S).json()
        operations = load_operations(document)
        tally = Tally()
        for operation in operations:
            if operation.is_endless:
                _ask_endless(target, operation, tally)
        _ask_others(target, session, document, tally, n_most=n_cases // _SHARE_OF_OTHERS, seed_number=seed_number)
        n_before = tally.n_cases
        asked = [operation for operation in operations if not operation.is_endless]
        n_empty = 0
        for number in count():
            left = n_cases - (tally.n_cases - n_before)
            if left <= 0 or n_empty == _EMPTY_ROUNDS:
                return tally
            share = ceil(left / len(asked) / max(_N_ROUNDS - number, 1))
            # What is asked little is asked together with others, for the first example of a group is always its plainest.
            size = max(_LEAST_OF_GROUP // share, 1)
            for first in range(0, len(asked), size):
                group = asked[first : first + size]
                seed_of_group = seed_number + _SEEDS_PER_ROUND * number + first
                _ask(target, session, group, tally, n_cases=share * len(group), seed_number=seed_of_group)
                tell(f"{tally.n_cases - n_before:,} of {n_cases:,} requests, {len(tally.failures)} rules broken; {group[-1].name}")
            n_empty = n_empty + 1 if tally.n_cases - n_before == n_cases - left else 0
    raise AssertionError("unreachable")


def _ask(
    target: Target, session: requests.Session, operations: Sequence[Operation], tally: Tally, *, n_cases: int, seed_number: int
) -> None:
    known = learn(target, session)

    @seed(seed_number)
    @settings(max_examples=n_cases, deadline=None, database=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))
    @given(data=st.data())
    def ask(data: st.DataObject) -> None:
        operation = data.draw(st.sampled_from(operations))
        asked = data.draw(requests_of(operation, known))
        prepared = _prepare(target, session, asked)
        try:
            answer = session.send(prepared, timeout=_TIMEOUT_S, allow_redirects=False)
            faults = judge(operation, asked, answer)
        except requests.RequestException as error:
            answer, faults = requests.Response(), [Fault("an answer comes, and is whole", str(error))]
            answer.status_code, answer.request = NO_ANSWER, prepared
        if asked.way is Way.RAW:
            # One that is sent in pieces has been used up.
            answer.request.body = asked.body
        tally.count(operation.name, answer, faults, kinds=(asked.asker, asked.way), target=target)

    ask()


def _prepare(target: Target, session: requests.Session, asked: Asked) -> requests.PreparedRequest:
    headers = dict(asked.headers)
    shown = asked.strange_token if asked.asker is Asker.STRANGER else target.shown_by(asked.asker)
    wanted = requests.Request(**asked.case.as_transport_kwargs(base_url=target.url, headers=headers))
    prepared = session.prepare_request(wanted)
    if asked.way is Way.HEAD:
        prepared.method = "HEAD"
    if asked.path is not None:
        prepared.url = f"{target.url}{asked.path}{'?' + asked.query if asked.query else ''}"
    if asked.way is Way.RAW:
        prepared.headers.pop("Content-Length", None)
        prepared.prepare_body(iter([asked.body]) if asked.is_chunked and asked.body else asked.body, None)
    if shown is not None:
        prepared.headers["Authorization"] = shown.encode() if not shown.isascii() else shown
    return prepared


def _ask_endless(target: Target, operation: Operation, tally: Tally) -> None:
    """Follow the event stream up to its first event, as everybody."""
    for asker in Asker:
        shown = target.shown_by(asker) or (STRANGE_TOKENS[-2] if asker is Asker.STRANGER else None)
        headers = {} if shown is None else {"Authorization": shown}
        with requests.get(target.url + operation.path, headers=headers, stream=True, timeout=_TIMEOUT_S) as answer:
            faults = list(_judge_events(answer) if answer.ok else judge_other(answer))
            if answer.ok != is_let_in(asker, needed=operation.needed):
                faults.append(Fault("whoever may, and nobody else, is let in", f"{asker} gets {answer.status_code}"))
            if str(answer.status_code) not in operation.answers:
                faults.append(Fault("Undocumented status code", str(answer.status_code)))
            tally.count(operation.name, answer, faults, kinds=(asker, Way.VALID), target=target)


def _judge_events(answer: requests.Response) -> Iterator[Fault]:
    if answer.headers["Content-Type"].partition(";")[0] != "text/event-stream":
        yield Fault("events are an event stream", answer.headers["Content-Type"])
    fields: dict[str, str] = {}
    for line in answer.iter_lines(chunk_size=1, decode_unicode=False):
        if not line and "data" in fields:
            break
        name, _, value = line.decode().partition(": ")
        fields[name] = value
    versions = json.loads(fields.get("data", "null"))
    is_versions = isinstance(versions, dict) and bool(versions) and all(type(one) is int and one >= 0 for one in versions.values())
    if fields.get("event") != "change" or not is_versions:
        yield Fault("an event tells the versions of all that changes", str(fields))


def _ask_others(
    target: Target, session: requests.Session, document: dict[str, Any], tally: Tally, *, n_most: int, seed_number: int
) -> None:
    """Ask by methods, and for paths, that the document does not have: nothing is there, and errors are problems."""
    described = document["paths"]
    others = [
        (asker, method, path)
        for asker in Asker
        if asker is not Asker.STRANGER
        for path in (*described, *_NOWHERE)
        for method in _METHODS
        if method.lower() not in described.get(path, {})
    ]
    for asker, method, path in Random(seed_number).sample(others, min(n_most, len(others))):
        shown = target.shown_by(asker)
        url = target.url + path.replace("{", "").replace("}", "")
        wanted = requests.Request(method, url, headers={} if shown is None else {"Authorization": shown})
        answer = session.send(session.prepare_request(wanted), timeout=_TIMEOUT_S, allow_redirects=False)
        faults = list(judge_other(answer))
        if answer.status_code < HTTPStatus.BAD_REQUEST:
            faults.append(Fault("what is not described is not there", f"{method} {path} gets {answer.status_code}"))
        if answer.status_code == HTTPStatus.METHOD_NOT_ALLOWED and "Allow" not in answer.headers:
            faults.append(Fault("405 says which methods there are", "without Allow"))
        tally.count("(not described)", answer, faults, kinds=(asker, Way.RAW), target=target)
