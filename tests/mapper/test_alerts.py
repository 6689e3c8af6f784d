"""Alerts: what rules find, how long it must hold, who has seen it, and what outlives a restart."""

import asyncio
import json
from collections.abc import Iterable
from dataclasses import replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.records import Cause, GatewayStatus, LandmarkChange, MissionPhase, Mode, RadioReport
from firmware_protocol.units import BootId, Nanoseconds, NodeId
from mapper.alert_book import MAX_ALERTS, PATIENCE, AlertBook, AlertKind, Condition, Severity
from mapper.alert_rules import AlertLimits, Situation, find_conditions
from mapper.changes import Topic
from mapper.fleet import BiobotView, GatewayView
from mapper.frames import Similarity
from mapper.hole_watch import MAPS_IN_A_ROW, TOLD_NS, HoleWatch
from mapper.recent_contacts import RecentContacts
from mapper.record_columns import EncounterRows
from tests.mapper.fake_gateway import S, mission
from tests.mapper.mapper_side import mapper_side
from tests.mapper.test_map_difference import as_served, moved, ring_map
from tests.mapper.web_side import check_against, client_of, openapi_of

STATUS = GatewayStatus(
    gateway="base1", journal="j", boot=BootId(1), head_offset=0, wall_ns=Nanoseconds(0), radios={"usb": "up"}, counters={}
)
GATEWAY = GatewayView(name="base1", is_alive=True, status=STATUS, radios_up=("usb",))
BIOBOT = BiobotView(
    node=NodeId(7), gateway="base1", is_reachable=True, mode=Mode.CRW, cause=Cause.NATURAL, radio="usb", battery_mv=3900, silence_s=1.0
)
QUIET = Situation(
    is_connected=True,
    gateways=[GATEWAY],
    biobots=[BIOBOT],
    events=[],
    faults=[],
    missions=[],
    recent_changes=[],
    contacts=RecentContacts().contacts(),
    remedies=None,
)


def look(situation: Situation, *, on: Iterable[tuple[AlertKind, str]] = ()) -> dict[tuple[AlertKind, str], Condition]:
    told = set(on)
    found = find_conditions(situation, limits=AlertLimits(), is_on=lambda kind, subject: (kind, subject) in told)
    for condition in found:
        assert condition.text.endswith((".", ")"))
    return {(condition.kind, condition.subject): condition for condition in found}


def status(**changes: Any) -> list[GatewayView]:
    return [replace(GATEWAY, status=GatewayStatus(**{name: getattr(STATUS, name) for name in STATUS.__struct_fields__} | changes))]


def test_of_a_site_where_all_is_well_nothing_is_told() -> None:
    assert look(QUIET) == {}


def test_a_biobot_is_lost_unless_its_gateway_or_radio_explains_the_silence() -> None:
    silent = replace(QUIET, biobots=[replace(BIOBOT, silence_s=61.0)])
    lost = (AlertKind.BIOBOT_LOST, "biobot 7")
    assert lost in look(silent)
    for silence_s in (59.0, None):
        assert lost not in look(replace(silent, biobots=[replace(BIOBOT, silence_s=silence_s)]))
    assert set(look(replace(silent, gateways=[replace(GATEWAY, is_alive=False)]))) == {(AlertKind.GATEWAY_AWAY, "gateway base1")}
    report = RadioReport(state="down", since_wall_ns=Nanoseconds(0), reason="unplugged 12 s ago")
    deaf = look(replace(silent, gateways=status(radios={"usb": "down"}, radio_reports={"usb": report})))
    assert set(deaf) == {(AlertKind.RADIO_DOWN, "radio usb of gateway base1")}
    (radio,) = deaf.values()
    assert radio.severity is Severity.CRITICAL
    assert "unplugged a while ago" in radio.text
    (radio,) = look(replace(QUIET, gateways=status(radios={"usb": "down", "tcp": "up"}))).values()
    assert radio.severity is Severity.WARNING
    full = "the journal gateway.sqlite takes nothing: database or disk is full; nothing is acknowledged until it does"
    assert set(look(replace(silent, gateways=status(faults=(full,))))) == {(AlertKind.GATEWAY_FAULT, "gateway base1")}
    assert lost in look(replace(silent, gateways=status(faults=("only 40 MiB are free where the journal lies; make room",))))
    assert set(look(replace(silent, is_connected=False, gateways=[replace(GATEWAY, is_alive=False)]))) == {(AlertKind.BUS_AWAY, "bus")}


@pytest.mark.parametrize(
    ("battery_mv", "was_low", "severity"),
    [(0, True, None), (None, False, None), (2450, False, None), (2450, True, "info"), (2399, False, "info"), (2199, False, "warning")],
)
def test_a_battery_that_is_low_must_be_well_above_to_be_told_no_more(battery_mv: int | None, was_low: bool, severity: str | None) -> None:
    key = (AlertKind.BATTERY_LOW, "biobot 7")
    found = look(replace(QUIET, biobots=[replace(BIOBOT, battery_mv=battery_mv)]), on=[key] if was_low else [])
    assert {condition.severity.value for condition in found.values()} == ({severity} if severity else set())


@pytest.mark.parametrize(
    ("free_mb", "was_low", "severity"), [(600, False, None), (600, True, "warning"), (700, True, None), (100, False, "critical")]
)
def test_a_disk_that_fills_is_told_in_time(free_mb: int, was_low: bool, severity: str | None) -> None:
    key = (AlertKind.DISK_FULL, "gateway base1")
    gateways = status(disk_free_bytes=free_mb * 2**20, faults=("only 100 MiB are free where the journal lies; make room",))
    found = look(replace(QUIET, gateways=gateways), on=[key] if was_low else [])
    assert {condition.severity.value for condition in found.values()} == ({severity} if severity else set())


def test_faults_and_events_of_gateways_and_of_the_mapper_are_told_without_numbers_that_run() -> None:
    gateways = status(faults=("the journal has been writing for 12 s; its disk hangs",))
    event = GatewayEvent(gateway="base1", wall_ns=Nanoseconds(5), level="warning", kind="node.duplicate", facts={"node": "9"})
    other = GatewayEvent(gateway="base1", wall_ns=Nanoseconds(5), level="info", kind="radio.up", facts={})
    found = look(replace(QUIET, gateways=gateways, events=[event, other], faults=["the map has been computed for 40 s"]))
    assert set(found) == {
        (AlertKind.GATEWAY_FAULT, "gateway base1"),
        (AlertKind.GATEWAY_EVENT, "gateway base1, node.duplicate, biobot 9"),
        (AlertKind.MAPPER_FAULT, "mapper"),
    }
    assert "writing for a while" in found[AlertKind.GATEWAY_FAULT, "gateway base1"].text


def rows(pairs: Iterable[tuple[int, int]], *, end_ns: int = 100 * S, first_row: int = 1) -> EncounterRows:
    ids = np.array(list(pairs), dtype=np.int64).reshape(-1, 2)
    ends = np.full(len(ids), end_ns)
    return EncounterRows(
        row=np.arange(first_row, first_row + len(ids)),
        t_start_ns=ends - S,
        t_end_ns=ends,
        id1=ids[:, 0],
        id2=ids[:, 1],
        counts=np.ones(len(ids), dtype=np.bool_),
    )


def test_a_walker_that_meets_always_the_same_is_stuck_and_one_that_gets_around_is_not() -> None:
    everybody = [(a, b) for a in range(1, 9) for b in range(a + 1, 9)]
    recent = RecentContacts()
    recent.take(rows([*everybody, *[(9, 1)] * 4, *[(9, 2)] * 4]), since_ns=0)
    walkers = [replace(BIOBOT, node=NodeId(node)) for node in range(1, 10)]
    situation = replace(QUIET, biobots=walkers, contacts=recent.contacts())
    stuck = (AlertKind.BIOBOT_STUCK, "biobot 9")
    assert set(look(situation)) == {stuck}
    recent.take(rows([(9, 3)], first_row=500), since_ns=0)
    situation = replace(situation, contacts=recent.contacts())
    assert set(look(situation)) == set(), "three others"
    assert set(look(situation, on=[stuck])) == {stuck}, "but that is not yet free"
    standing = [replace(walker, mode=Mode.S) if walker.node == 9 else walker for walker in walkers]
    assert set(look(replace(situation, biobots=standing), on=[stuck])) == set()


def test_a_swarm_that_came_apart_is_told_until_most_of_it_hangs_together() -> None:
    recent = RecentContacts()
    recent.take(rows([(1, 2), (2, 3), (3, 1), (11, 12), (12, 13), (13, 11)] * 3), since_ns=0)
    assert recent.contacts().groups == ((1, 2, 3), (11, 12, 13))
    split = (AlertKind.SWARM_SPLIT, "swarm")
    situation = replace(QUIET, biobots=[], contacts=recent.contacts())
    assert "11, 12, 13" in look(situation)[split].text
    recent.take(rows([(1, 11)], first_row=500, end_ns=200 * S), since_ns=0)
    assert set(look(replace(situation, contacts=recent.contacts()), on=[split])) == set()
    recent.take(rows([], first_row=600), since_ns=150 * S)
    assert recent.contacts().groups == ((1, 11),), "what was before is forgotten"


@given(batches=st.lists(st.lists(st.tuples(st.integers(1, 5), st.integers(6, 9), st.integers(1, 20)), max_size=8), max_size=5))
@settings(max_examples=30)
def test_contacts_are_those_of_the_newest_revision_of_each_row(batches: list[list[tuple[int, int, int]]]) -> None:
    recent = RecentContacts()
    newest: dict[int, tuple[int, int]] = {}
    for taken in batches:
        of_row = {row: (a, b) for a, b, row in taken}
        newest |= of_row
        made = rows(of_row.values())
        recent.take(replace(made, row=np.array(list(of_row), dtype=np.int64)), since_ns=0)
    found = recent.contacts()
    assert sum(found.n_encounters.values()) == 2 * len(newest)
    assert found.partners == {node: len({pair for pair in newest.values() if node in pair}) for node in found.n_encounters}
    assert sorted(node for group in found.groups for node in group) == sorted(found.n_encounters)


def test_a_landmark_that_was_lost_is_told_as_long_as_nobody_stands_there() -> None:
    def changed(phase: MissionPhase, replacement: int | None) -> Situation:
        change = LandmarkChange(
            node=NodeId(4), replacement=None if replacement is None else NodeId(replacement), reason="not heard", wall_ns=Nanoseconds(0)
        )
        record = mission(1, phase=phase, t_ns=0, landmarks=(5, 6))
        facts = {name: getattr(record, name) for name in record.__struct_fields__} | {"changes": (change,)}
        return replace(QUIET, missions=[type(record)(**facts)], recent_changes=[("gateway1", change)])

    (lost,) = look(changed(MissionPhase.EXPLORATION, None)).values()
    assert (lost.severity, lost.subject) == (Severity.WARNING, "landmark 4 of gateway gateway1")
    (replaced,) = look(changed(MissionPhase.EXPLORATION, 9)).values()
    assert replaced.severity is Severity.INFO
    assert "biobot 9 took its place" in replaced.text
    assert look(changed(MissionPhase.DONE, None)) == {}


def test_too_few_data_are_told_with_what_would_help() -> None:
    (found,) = look(replace(QUIET, remedies=["let 3 more biobots stand still"])).values()
    assert "It would help to let 3 more biobots stand still." in found.text


CONDITIONS = [
    Condition(kind=kind, subject=subject, severity=severity, text=f"{severity} {subject}")
    for kind in (AlertKind.BIOBOT_LOST, AlertKind.RADIO_DOWN, AlertKind.SWARM_SPLIT)
    for subject in ("a", "b")
    for severity in (Severity.WARNING, Severity.CRITICAL)
]


@given(looks=st.lists(st.tuples(st.sets(st.sampled_from(CONDITIONS), max_size=4), st.integers(1, 50)), max_size=30))
@settings(max_examples=60)
def test_an_alert_begins_and_ends_only_after_its_patience(looks: list[tuple[set[Condition], int]]) -> None:
    """Against a slow and obvious version: for each key the times at which it held."""
    book, now_s = AlertBook(), 0
    since: dict[Any, int] = {}
    gone: dict[Any, int] = {}
    expected: set[Any] = set()
    for held, step_s in looks:
        now_s += step_s
        by_key = {(condition.kind, condition.subject): condition for condition in held}
        changed, _ = book.take(by_key.values(), now_ns=now_s * S, wall_ns=now_s)
        for kind in (AlertKind.BIOBOT_LOST, AlertKind.RADIO_DOWN, AlertKind.SWARM_SPLIT):
            for key in ((kind, "a"), (kind, "b")):
                if key in by_key:
                    gone.pop(key, None)
                    if now_s - since.setdefault(key, now_s) >= PATIENCE[kind].on_after_s:
                        expected.add(key)
                else:
                    since.pop(key, None)
                    if key in expected and now_s - gone.setdefault(key, now_s) >= PATIENCE[kind].off_after_s:
                        expected.discard(key)
        on = [(alert.kind, alert.subject) for alert in book.alerts.values() if alert.is_on]
        assert sorted(on) == sorted(expected), "no two for one thing"
        assert all(book.alerts[alert.id] == alert for alert in changed)
        again = AlertBook()
        again.restore(book.alerts.values())
        assert again.alerts == book.alerts
        assert all(again.is_on(*key) for key in expected)


def test_who_acknowledges_first_stays_until_it_gets_worse() -> None:
    book = AlertBook()
    low = Condition(kind=AlertKind.DISK_FULL, subject="gateway a", severity=Severity.WARNING, text="low")
    ((alert,), _) = book.take([low], now_ns=0, wall_ns=10)
    assert (alert.since_wall_ns, alert.is_on, alert.acknowledged_by) == (10, True, None)
    assert (
        book.acknowledge(alert.id, person="anna", wall_ns=11)
        == book.acknowledge(alert.id, person="ben", wall_ns=12)
        == book.alerts[alert.id]
    )
    assert (book.alerts[alert.id].acknowledged_by, book.alerts[alert.id].acknowledged_wall_ns) == ("anna", 11)
    assert book.take([low], now_ns=S, wall_ns=13) == ([], [])
    ((worse,), _) = book.take([replace(low, severity=Severity.CRITICAL, text="full")], now_ns=S, wall_ns=14)
    assert (worse.id, worse.acknowledged_by, worse.text) == (alert.id, None, "full")
    assert book.acknowledge(77, person="anna", wall_ns=0) is None


def test_of_too_many_alerts_the_oldest_that_are_over_are_forgotten() -> None:
    book, forgotten = AlertBook(), set()
    stays = Condition(kind=AlertKind.NEW_HOLE, subject="stays", severity=Severity.INFO, text="")
    for n in range(MAX_ALERTS + 10):
        passing = Condition(kind=AlertKind.NEW_HOLE, subject=str(n), severity=Severity.INFO, text="")
        forgotten |= set(book.take([stays, passing], now_ns=n, wall_ns=n)[1])
    assert len(book.alerts) == MAX_ALERTS
    assert forgotten == set(range(2, 13))
    assert book.is_on(AlertKind.NEW_HOLE, "stays")


def test_a_hole_is_told_when_three_maps_show_it_and_when_three_do_not() -> None:
    base = as_served(ring_map())
    (hole,) = base["holes"]
    small = hole | {"centre": [3.2, 0.0], "area": 0.5, "outline_xy": [[3.0, 0.0], [3.4, 0.0], [3.2, 0.3], [3.0, 0.0]]}

    def served(version: int, probability: float | None) -> bytes:
        holes = [hole] if probability is None else [small | {"probability": probability}, hole]
        return json.dumps(base | {"version": version, "holes": holes}).encode()

    watch, told = HoleWatch(sure=0.8), []
    for version, probability in enumerate([None, 0.9, 0.9, None, 0.9, 0.5, 0.9, 0.9, 0.9, 0.9, None, None, 0.4, None, None, None], start=1):
        watch.take(served(version, probability), now_ns=0)
        told.append([condition.kind.value for condition in watch.conditions(now_ns=TOLD_NS - 1)])
    news = ["new_hole"]
    assert told == [*[[]] * 8, *[news] * 6, news, [*news, "hole_vanished"]]
    assert MAPS_IN_A_ROW == 3
    assert watch.conditions(now_ns=TOLD_NS) == []
    other = moved(base, Similarity(scale=1.0, turn_rad=1.0, is_mirrored=True, shift=(5.0, 0.0)))
    watch.take(json.dumps(other).encode(), now_ns=0)
    assert watch.conditions(now_ns=0) == [], "in another frame nothing is new"


def test_alerts_are_served_acknowledged_and_kept_over_a_restart(tmp_path: Path) -> None:
    async def story() -> None:
        path = tmp_path / "records.db"
        async with mapper_side(1, store=path) as side, client_of(side) as client:
            document = openapi_of(side)
            event = GatewayEvent(gateway="base1", wall_ns=Nanoseconds(5), level="warning", kind="journal.damaged", facts={})
            side.fleet.events.append(event)
            seen = side.changes.versions[Topic.ALERTS]
            await side.alerts.look()
            assert side.changes.versions[Topic.ALERTS] > seen
            answer = await client.get("/api/v1/alerts")
            check_against(document, "/api/v1/alerts", answer)
            (alert,) = answer.json()["alerts"]
            assert (alert["kind"], alert["subject"], alert["is_on"]) == ("gateway_event", "gateway base1, journal.damaged", True)
            told = await client.post(f"/api/v1/alerts/{alert['id']}/acknowledgement")
            check_against(document, "/api/v1/alerts/{alert_id}/acknowledgement", told, method="post")
            assert told.json()["acknowledged_by"] == "anna"
            missing = await client.post("/api/v1/alerts/77/acknowledgement")
            check_against(document, "/api/v1/alerts/{alert_id}/acknowledgement", missing, method="post")
            assert missing.status_code == HTTPStatus.NOT_FOUND
        async with mapper_side(1, store=path) as side, client_of(side) as client:
            (kept,) = (await client.get("/api/v1/alerts", params={"state": "on"})).json()["alerts"]
            assert kept == told.json()
            await side.alerts.look()
            assert (await client.get("/api/v1/alerts", params={"state": "on"})).json()["n_on"] == 0, "the gateway has not told it again"
            (over,) = (await client.get("/api/v1/alerts")).json()["alerts"]
            assert over == kept | {"is_on": False, "ended_wall_ns": over["ended_wall_ns"]}

    asyncio.run(story())
