"""A wait is promised only while encounters come."""

import json

import pytest

from mapper.served_bytes import ServedBytes
from mapper.wait_promise import judge_promise


def told(wait_s: float | None, *, rate: float = 12.0) -> ServedBytes:
    data = {"is_enough": wait_s == 0, "reasons": [], "expected_wait_s": wait_s, "nothing_arrives": None}
    return ServedBytes.of(json.dumps({"rate_per_min": rate, "data": data}).encode())


@pytest.mark.parametrize(
    ("after_min", "rate", "is_connected", "are_there", "problem"),
    [
        (4.9, 12.0, True, [True], None),
        (5.1, 12.0, True, [True], "the last 5 minutes and more brought no encounter"),
        (5.1, 12.0, True, [], "the last 5 minutes and more brought no encounter"),
        (14.0, 0.2, True, [True], None),
        (16.0, 0.2, True, [True], "the last 15 minutes and more brought no encounter"),
        (0.1, 12.0, False, [True], "the mapper is not connected"),
        (0.1, 12.0, True, [False], "its gateway is away"),
        (0.1, 12.0, True, [False, False], "each of its 2 gateways is away"),
        (0.1, 12.0, True, [False, True], None),
    ],
)
def test_a_wait_is_promised_only_while_encounters_come(
    after_min: float, rate: float, is_connected: bool, are_there: list[bool], problem: str | None
) -> None:
    before = told(600.0, rate=rate)
    after = judge_promise(before, silent_s=60.0 * after_min, is_connected=is_connected, are_there=are_there)
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
    assert judge_promise(before, silent_s=6_000.0, is_connected=False, are_there=[False]) is before
