"""A wait is promised only while encounters come."""

import json

import pytest

from mapper.served_bytes import ServedBytes
from mapper.wait_promise import judge_promise

MIN_NS = 60_000_000_000
NEWEST_NS = 1_795_726_800 * 10**9


def told(wait_s: float | None, *, rate: float = 12.0) -> ServedBytes:
    biobots = [{"last_encounter_wall_ns": NEWEST_NS - MIN_NS}, {"last_encounter_wall_ns": NEWEST_NS}]
    data = {"is_enough": wait_s == 0, "reasons": [], "expected_wait_s": wait_s, "nothing_arrives": None}
    return ServedBytes.of(json.dumps({"biobots": biobots, "rate_per_min": rate, "data": data}).encode())


@pytest.mark.parametrize(
    ("after_min", "rate", "has_newer", "is_connected", "are_alive", "problem"),
    [
        (4.9, 12.0, False, True, [True], None),
        (5.1, 12.0, False, True, [True], "no encounter of the last 5 minutes"),
        (5.1, 12.0, False, True, [], "no encounter of the last 5 minutes"),
        (5.1, 12.0, True, True, [True], None),
        (14.0, 0.2, False, True, [True], None),
        (16.0, 0.2, False, True, [True], "no encounter of the last 15 minutes"),
        (0.1, 12.0, False, False, [True], "the mapper is not connected"),
        (0.1, 12.0, False, True, [False], "its gateway is away"),
        (0.1, 12.0, False, True, [False, False], "each of its 2 gateways is away"),
        (0.1, 12.0, False, True, [False, True], None),
    ],
)
def test_a_wait_is_promised_only_while_encounters_come(
    after_min: float, rate: float, has_newer: bool, is_connected: bool, are_alive: list[bool], problem: str | None
) -> None:
    before = told(600.0, rate=rate)
    now_ns = NEWEST_NS + round(after_min * MIN_NS)
    after = judge_promise(before, now_ns=now_ns, has_newer=has_newer, is_connected=is_connected, are_alive=are_alive)
    data = json.loads(after.plain)["data"]
    if problem is None:
        assert after is before
    else:
        assert data["expected_wait_s"] is None
        assert data["nothing_arrives"].startswith("nothing arrives: ")
        assert problem in data["nothing_arrives"]
        assert after.tag != before.tag


@pytest.mark.parametrize("wait_s", [None, 0.0])
def test_where_no_wait_is_promised_nothing_is_taken_back(wait_s: float | None) -> None:
    before = told(wait_s)
    assert judge_promise(before, now_ns=NEWEST_NS + 99 * MIN_NS, has_newer=False, is_connected=False, are_alive=[False]) is before
