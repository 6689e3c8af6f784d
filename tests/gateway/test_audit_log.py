"""Laws of what is put on record besides the stages of commands."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.commands import StimulationAction, StimulationRequest
from firmware_protocol.messages import Limits
from firmware_protocol.units import NS_PER_S, Nanoseconds, NodeId
from gateway.audit_log import AuditLog, facts_of
from gateway.commands.audit_lines import line_of, shown
from gateway.config import StimulationTable
from gateway.health import Health
from gateway.journal import MAX_WAITING, Journal
from gateway.journal_file import AuditEntry, AuditSelection, JournalWrite, read_audit_rows, verify_audit_of

LIMITS = Limits(
    channels=3,
    waveforms=1,
    max_frequency_hz=100,
    max_pulse_width_us=9000,
    max_amplitude_mv=2000,
    max_duration_ms=500,
    min_gap_ms=2000,
    max_on_ms_per_minute=9000,
    battery_mv=4000,
    battery_empty_mv=3200,
    encounter_capacity=9,
)


def _written(path: Path, work: Callable[[AuditLog, Health], None]) -> list[AuditEntry]:
    """Let one start of a gateway put things on record; return all that is on disk."""

    async def story() -> None:
        health = Health()
        journal = Journal.open(path, health=health)
        reader = journal.reader()
        audit = AuditLog(journal=journal, reader=reader, health=health)
        running = asyncio.ensure_future(journal.run())
        work(audit, health)
        await journal.drain()
        running.cancel()
        reader.close()
        journal.close()

    asyncio.run(story())
    assert verify_audit_of(path, tell=lambda _: None).fault is None
    return [row for row in read_audit_rows(path, AuditSelection()) if isinstance(row, AuditEntry)]


_facts = st.dictionaries(
    st.text(max_size=9),
    st.one_of(st.none(), st.booleans(), st.integers(-(1 << 70), 1 << 70), st.floats(), st.text(max_size=9), st.binary(max_size=9)),
    max_size=4,
)
_notes = st.tuples(_facts, st.text(st.characters(exclude_categories=()), max_size=99), st.none() | st.integers(0, 1 << 64))


@given(notes=st.lists(_notes, min_size=5, max_size=30))
@settings(max_examples=10)
def test_whatever_is_noted_is_on_record_and_nothing_raises(
    tmp_path_factory: pytest.TempPathFactory, notes: list[tuple[dict[str, object], str, int | None]]
) -> None:
    def work(audit: AuditLog, _health: Health) -> None:
        for facts, operator, node in notes:
            audit.note("order", facts=facts, operator=operator, node=None if node is None else NodeId(node))

    entries = _written(tmp_path_factory.mktemp("noted") / "j", work)
    assert len(entries) == len(notes)
    for entry, (facts, operator, node) in zip(entries, notes, strict=True):
        assert entry.kind == "order"
        assert entry.operator == operator.encode("utf-8", "backslashreplace").decode()[:64]
        assert entry.node == (None if node is None else min(node, (1 << 63) - 1))
        assert set(facts_of(entry.body)) in ({"cut"}, set(facts))
        json.dumps(shown(entry), allow_nan=False)
        assert line_of(entry).isprintable()


def test_facts_that_are_too_large_are_cut_and_facts_that_are_none_of_ours_are_told_in_words(tmp_path: Path) -> None:
    def work(audit: AuditLog, _health: Health) -> None:
        audit.note("landmark", facts={"graph": "x" * 200_000})
        audit.note("landmark", facts={"where": Path("/a"), "phase": {3, 4}})

    large, strange = _written(tmp_path / "j", work)
    assert len(large.body) < 40_000
    assert set(facts_of(large.body)) == {"cut"}
    assert facts_of(strange.body)["where"] == "/a"


def test_limits_are_on_record_once_for_each_change(tmp_path: Path) -> None:
    strict = StimulationTable(min_gap_s=4.0)

    def start(table: StimulationTable) -> int:
        return len(_written(tmp_path / "j", lambda audit, _: audit.note_limits(table)))

    assert [start(table) for table in (StimulationTable(), StimulationTable(), strict, strict, StimulationTable())] == [1, 1, 2, 2, 3]
    last = list(read_audit_rows(tmp_path / "j", AuditSelection(kind="limits")))[1]
    assert isinstance(last, AuditEntry)
    assert facts_of(last.body)["min_gap_s"] == 4.0


def test_what_a_backpack_announces_is_on_record_where_it_changed_also_since_the_last_start(tmp_path: Path) -> None:
    stricter = msgspec.structs.replace(LIMITS, min_gap_ms=5000)

    def start(*said: tuple[int, Limits]) -> list[tuple[int | None, object]]:
        def work(audit: AuditLog, _health: Health) -> None:
            for node, limits in said:
                audit.note_announced(NodeId(node), limits)

        return [(entry.node, facts_of(entry.body)["min_gap_ms"]) for entry in _written(tmp_path / "j", work)]

    one, two = (3, LIMITS), (4, LIMITS)
    assert start(one, two, one, (3, msgspec.structs.replace(LIMITS, battery_mv=1))) == [(3, 2000), (4, 2000)]
    assert start(one, two, (4, stricter), (4, stricter)) == [(3, 2000), (4, 2000), (4, 5000)]


def test_queries_that_are_no_commands_are_counted_in_one_row(tmp_path: Path) -> None:
    def work(audit: AuditLog, _health: Health) -> None:
        for number in range(1000):
            audit.turn_away(b"\xff" * number, "no MessagePack" * 99)
        audit.end("asked to stop")

    turned_away, end = _written(tmp_path / "j", work)
    facts = facts_of(turned_away.body)
    assert (facts["n"], facts["octets"], facts["size"]) == (1000, b"", 0)
    assert len(turned_away.body) < 400
    assert facts_of(end.body) == {"event": "stopping", "reason": "asked to stop"}


def test_what_does_not_fit_before_the_disk_is_counted_and_a_later_row_says_how_much_it_was(tmp_path: Path) -> None:
    filling = JournalWrite(node=(NodeId(1), b""))

    async def story() -> None:
        health = Health()
        journal = Journal.open(tmp_path / "j", health=health)
        reader = journal.reader()
        audit = AuditLog(journal=journal, reader=reader, health=health)
        for _ in range(MAX_WAITING):
            journal.append(filling)
        for number in range(3):
            audit.note("order", facts={"number": number})
        assert health.own_counters()["audit.lost"] == 3
        running = asyncio.ensure_future(journal.run())
        await journal.drain()
        audit.note("order", facts={"number": -1})
        await journal.drain()
        running.cancel()
        reader.close()
        journal.close()

    asyncio.run(story())
    (lost,) = read_audit_rows(tmp_path / "j", AuditSelection(kind="lost"))
    assert isinstance(lost, AuditEntry)
    assert (lost.id, facts_of(lost.body)) == (1, {"n": 3})
    found = verify_audit_of(tmp_path / "j", tell=lambda _: None)
    assert (found.fault, found.n_rows) == (None, 2)


def test_a_flood_of_repetitions_is_some_rows_and_a_count(tmp_path: Path) -> None:
    request = StimulationRequest(
        command_id="c1", node=NodeId(3), action=StimulationAction.START, operator="ann", issued_wall_ns=Nanoseconds(1)
    )
    now_ns = 0

    async def story() -> None:
        nonlocal now_ns
        journal = Journal.open(tmp_path / "j", health=Health())
        reader = journal.reader()
        audit = AuditLog(journal=journal, reader=reader, health=Health(), clock=lambda: now_ns)
        running = asyncio.ensure_future(journal.run())
        for _ in range(1000):
            audit.note_repeated(request)
        now_ns = 60 * NS_PER_S
        audit.note_repeated(request)
        await journal.drain()
        running.cancel()
        reader.close()
        journal.close()

    asyncio.run(story())
    rows = list(read_audit_rows(tmp_path / "j", AuditSelection(kind="repeated", node=3, operator="ann")))
    assert [facts_of(row.body)["others_before"] for row in rows if isinstance(row, AuditEntry)] == [0] * 60 + [940]
