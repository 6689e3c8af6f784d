"""Several base stations: what the study of them looks for is found where it is, and its shortest topology holds on real sessions."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from studies.sites.orders import CONFIRMED, Order, find_lies
from studies.sites.plan import BETWEEN_ROUTERS, MEADOW, MOVED, find_cut_off
from studies.sites.run import counted
from studies.sites.strangers import problems_with_stranger

ALL = [one.name for one in MEADOW.gateways]


@pytest.mark.parametrize(
    ("cut", "dead", "moved_to", "names"),
    [
        ((), (), "r1", []),
        ((("a1", "r1"),), (), "r1", ["base1"]),
        ((BETWEEN_ROUTERS,), (), "r1", ["base1", "base2"]),
        ((BETWEEN_ROUTERS,), (), "r2", ["base1"]),
        (((MEADOW.mapper_host, MEADOW.mapper_router),), (), "r1", ALL),
        ((), ("r1",), "r1", ["base1", "base2"]),
        ((), ("r1",), "r2", ["base1"]),
        ((), ("r2",), "r1", ALL),
        (((MOVED.host, "r1"),), (), "r2", []),
    ],
)
def test_who_is_cut_off_follows_from_cables_and_routers(cut: Any, dead: Any, moved_to: str, names: list[str]) -> None:
    routers = {one.host: one.router for one in MEADOW.gateways} | {MOVED.host: moved_to}
    assert find_cut_off(MEADOW, routers=routers, cut=cut, dead=dead) == names


def _order(action: str, last: str | None) -> Order:
    return Order(
        biobot=7, gateway="base1", action=action, occasion="cut", is_cut=True, status=200, command_id="one", first=None, last=last
    )  # fmt: skip


def _done(action: str, *, biobot: int = 7, gave_train: bool = True) -> dict[str, Any]:
    return {"id": biobot, "action": action, "responded": True if gave_train else None}


@pytest.mark.parametrize(
    ("last", "commands", "words"),
    [
        (CONFIRMED, [], "was not carried out"),
        ("undelivered", [_done("stop")], "was carried out"),
        ("refused", [_done("stop")], "was carried out"),
        (None, [_done("stop")], "has no end"),
        (CONFIRMED, [_done("stop"), _done("stop")], "gave 2 trains"),
        (CONFIRMED, [_done("stop"), _done("turn_left", biobot=8)], "nobody ordered it"),
    ],
)
def test_an_order_that_ended_otherwise_than_it_was_told_is_found(last: str | None, commands: list[dict[str, Any]], words: str) -> None:
    (lie,) = find_lies([_order("stop", last)], commands)
    assert words in lie


@pytest.mark.parametrize(
    ("last", "commands"),
    [
        (CONFIRMED, [_done("stop"), _done("stop", gave_train=False)]),
        ("undelivered", []),
        ("unknown", []),
        ("unknown", [_done("stop"), {"id": 7, "action": None, "responded": None}]),
    ],
)
def test_an_order_that_ended_as_it_was_told_is_no_lie(last: str, commands: list[dict[str, Any]]) -> None:
    assert find_lies([_order("stop", last)], commands) == []


def test_an_encounter_of_several_records_counts_once_and_a_void_one_never() -> None:
    def record(start: int, *, is_void: bool = False, joint: dict[str, Any] | None = None) -> dict[str, Any]:
        return {"is_void": is_void, "joint": joint, "t_start_wall_ns": start, "t_end_wall_ns": start + 1}

    joint = {"t_start_wall_ns": 10, "t_end_wall_ns": 40}
    records = [
        record(1),
        record(5, is_void=True),
        record(11, joint={**joint, "is_counted": True}),
        record(12, joint={**joint, "is_counted": False}),
    ]
    assert [(one["t_start_wall_ns"], one["t_end_wall_ns"]) for one in counted(records)] == [(1, 2), (10, 40)]


@pytest.mark.parametrize("got", [{"n_answers": 1}, {"asked": ["key"]}, {"heard": ["key"]}])
def test_a_stranger_who_got_something_is_found(got: dict[str, Any]) -> None:
    told = {"name": "eve", "is_connected": True, "n_answers": 0, "asked": [], "heard": []}
    assert problems_with_stranger(told, may_hear=False) == []
    assert len(problems_with_stranger({**told, **got}, may_hear=False)) == 1


@pytest.mark.e2e
def test_two_routers_heal_and_strangers_get_nothing(tmp_path: Path) -> None:
    """Real routers, TLS and access control in namespaces: a cable swallows, a router is killed, and the store has all in the end."""
    out = tmp_path / "out"
    command = [sys.executable, "-m", "studies.sites", "--short", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    if "skipped" in done.stderr:
        pytest.skip(done.stderr.strip())
    facts = json.loads(done.stdout)
    assert facts["stored"] >= facts["published"] >= 150
    assert [one["is_connected"] for one in facts["strangers"]] == [True, True]
