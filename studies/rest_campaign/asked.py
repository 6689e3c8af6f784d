"""Requests of one operation: as its description allows, with what the mapper knows, as it forbids, and as no client would write them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final
from urllib.parse import quote

from hypothesis import strategies as st
from schemathesis import Case, GenerationMode

from mapper.access import Role
from studies.rest_campaign.askers import STRANGE_TOKENS, Asker, is_let_in
from studies.rest_campaign.known import Known
from studies.rest_campaign.odd_values import BODIES, FIELDS, KINDS, QUERIES, SEGMENTS
from studies.rest_campaign.operations import Operation

_LONGEST_WAIT_S: Final = 0.02


class Way(StrEnum):
    """How a request was made up."""

    VALID = "valid"
    """As the description allows."""
    KNOWN = "known"
    """The same, with ids and places that the mapper knows."""
    INVALID = "invalid"
    """As the description forbids."""
    RAW = "raw"
    """Bytes that are no valid path, query, body or header."""
    HEAD = "head"
    """A GET as HEAD."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """A request to be sent."""

    way: Way
    asker: Asker
    case: Case[Any]
    headers: Mapping[str, str]
    strange_token: str = ""
    path: str | None = None
    """In the place of the case's, already quoted."""
    query: str | None = None
    body: bytes | None = None
    is_chunked: bool = False


_QUERY_TEXT: Final = st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="#")
_SHARES: Final = {Way.VALID: 4, Way.KNOWN: 5, Way.INVALID: 4, Way.RAW: 3, Way.HEAD: 1}


@st.composite
def requests_of(draw: st.DrawFn, operation: Operation, known: Known) -> Asked:
    """Draw a request of an operation, and who sends it."""
    way = draw(st.sampled_from(_ways(operation)))
    asker = draw(st.sampled_from(_askers(operation.needed)))
    headers = dict(draw(st.lists(_field(known.etags), max_size=2)))
    mode = GenerationMode.NEGATIVE if way is Way.INVALID else GenerationMode.POSITIVE
    case: Case[Any] = draw(operation.api.as_strategy(generation_mode=mode))
    if way is Way.KNOWN:
        for given in (case.path_parameters, case.query, case.body):
            if isinstance(given, dict):
                known.replace(given, lambda values: draw(st.sampled_from(values)), operation=operation.name)
    for given in (case.query, case.body):
        _hurry(given)
    strange_token = draw(st.sampled_from(STRANGE_TOKENS)) if asker is Asker.STRANGER else ""
    if way is not Way.RAW:
        return Asked(way=way, asker=asker, case=case, headers=headers, strange_token=strange_token)
    odd_bodies = st.sampled_from(BODIES) | st.binary(max_size=60)
    return Asked(
        way=way,
        asker=asker,
        case=case,
        headers={**headers, **({"Content-Type": draw(st.sampled_from(KINDS))} if operation.has_body else {})},
        strange_token=strange_token,
        path=operation.fill_path(lambda: draw(_segments())),
        query=draw(st.sampled_from(QUERIES) | st.text(_QUERY_TEXT, max_size=40)),
        body=draw(odd_bodies if operation.has_body else st.none() | odd_bodies),
        is_chunked=draw(st.booleans()),
    )


def _ways(operation: Operation) -> list[Way]:
    able = {Way.INVALID: operation.has_input, Way.KNOWN: operation.has_input, Way.HEAD: operation.method == "GET"}
    return [way for way, share in _SHARES.items() if able.get(way, True) for _ in range(share)]


def _askers(needed: Role | None) -> list[Asker]:
    """Everybody, and those who are let in three times: the others' requests end at the door."""
    return [asker for asker in Asker for _ in range(3 if is_let_in(asker, needed=needed) else 1)]


def _field(etags: Sequence[str]) -> st.SearchStrategy[tuple[str, str]]:
    made_up = [(name, value) for name, values in FIELDS.items() for value in values]
    return st.sampled_from([*made_up, *[("If-None-Match", etag) for etag in etags for _ in range(8)]])


def _segments() -> st.SearchStrategy[str]:
    # A slash would make it the path of another operation, and dots are resolved by clients.
    return st.sampled_from(SEGMENTS) | st.text(min_size=1, max_size=12).map(lambda text: quote(text, safe="")).filter(_is_one_segment)


def _is_one_segment(quoted: str) -> bool:
    return "%2F" not in quoted and quoted not in {".", ".."}


def _hurry(given: Any) -> None:
    """Wait for nothing for long: the campaign has other requests to make."""
    if isinstance(given, dict) and isinstance(given.get("wait_s"), int | float) and given["wait_s"] > _LONGEST_WAIT_S:
        given["wait_s"] = _LONGEST_WAIT_S
