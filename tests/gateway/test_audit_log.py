"""Laws of what is put on record besides the stages of commands."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.messages import Limits
from firmware_protocol.units import NodeId
from gateway.audit_log import AuditLog, facts_of
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import AuditEntry, AuditSelection, read_audit_rows, verify_audit_of

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


@given(facts=_facts, operator=st.text(st.characters(), max_size=99), node=st.none() | st.integers(0, 1 << 64))
@settings(max_examples=25)
def test_whatever_is_noted_is_on_record_and_nothing_raises(
    tmp_path_factory: pytest.TempPathFactory, facts: dict[str, object], operator: str, node: int | None
) -> None:
    path = tmp_path_factory.mktemp("noted") / "j"
    number = None if node is None else NodeId(node)
    (entry,) = _written(path, lambda audit, _: audit.note("order", facts=facts, operator=operator, node=number))
    assert entry.kind == "order"
    assert entry.operator == operator.encode("utf-8", "backslashreplace").decode()[:64]
    said = facts_of(entry.body)
    assert set(said) in ({"cut"}, set(facts))
