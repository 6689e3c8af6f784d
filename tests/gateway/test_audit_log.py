"""Laws of what is put on record besides the stages of commands."""

import asyncio
import contextlib
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gateway.journal
from firmware_protocol.messages import Limits
from firmware_protocol.units import NodeId
from gateway.audit_log import AuditLog, facts_of
from gateway.config import StimulationTable
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import AuditEntry, JournalReader

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


def _written(path: Path, work: Callable[[AuditLog, Health], None], *, is_run: bool = True) -> list[AuditEntry]:
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
    with contextlib.closing(JournalReader(path)) as reader:
        return reader._audit("ORDER BY id", ())
