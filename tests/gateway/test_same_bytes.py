"""Whatever is made faster: the same messages give the same bytes, in the journal and on the bus."""

import asyncio
import hashlib
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import pytest

from firmware_protocol.contract.records import encode_record
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId
from gateway.clocks import ClockBook
from gateway.config import EncounterTable
from gateway.health import Health
from gateway.intake import Intake, IntakeListeners
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import Committed, JournalReader
from gateway.nodes import NodeBook
from gateway.radio import RadioMessage
from gateway.record_batches import batches_of
from tests.gateway.random_traffic import BEGUN_NS, N_NODES, random_messages

_TOGETHER = 37
"""Messages that come before the disk has its turn."""

_CASES = [(1, False), (2, True), (3, False), (4, True)]

_DIGESTS = {1: "f7646de3fc1da010", 2: "3ad6393c68c65dac", 3: "ff12b250ac4ab787", 4: "75ed7e171951c7ea"}
"""The first 16 digits of the SHA-256 of what the gateway made of each case. Without what sides say on their own
clocks they are those of commit f9e4b40."""


async def _take(path: Path, messages: Sequence[RadioMessage]) -> tuple[list[bytes], dict[str, int]]:
    """Return the publications, and how often what happened."""
    health = Health()
    with closing(Journal.open(path, health=health)) as journal, closing(journal.reader()) as reader:
        clocks = ClockBook(window_ns=600 * NS_PER_S)
        issuer = RecordIssuer(gateway="base1", journal="0123abcd", boot=BootId(7), wall_anchor_ns=Nanoseconds(1_700_000_000 * NS_PER_S))
        intake = Intake(
            issuer=issuer, journal=journal, reader=reader, nodes=NodeBook(gateway="base1"), clocks=clocks, health=health,
            config=EncounterTable(window_s=8), now_ns=BEGUN_NS,
        )  # fmt: skip
        intake.connect(_NOBODY)
        for node in range(1, N_NODES + 1):
            clocks.observe(
                node=NodeId(node), boot=BootId(1), sent_ms=Milliseconds(60_000), received_ns=BEGUN_NS + 3 * NS_PER_MS
            ).bound_below(requested_ns=BEGUN_NS - 9 * NS_PER_MS, arrived_ms=Milliseconds(60_000))
        publications: list[bytes] = []

        def publish(committed: Committed) -> None:
            publications.extend(encode_record(batch) for _, batch in batches_of(committed, gateway="base1"))

        journal.listen(publish)
        running = asyncio.ensure_future(journal.run())
        for at in range(0, len(messages), _TOGETHER):
            for message in messages[at : at + _TOGETHER]:
                intake.take(message)
            await journal.drain()
            if at % 7 == 0:
                intake.forget_old(now_ns=messages[at].received_ns)
        running.cancel()
        return publications, health.counters()


_NOBODY = IntakeListeners(
    on_committed=lambda _: None,
    on_status=lambda _: None,
    on_neighbours=lambda _: None,
    on_reply=lambda _node, _reply: None,
    on_answer=lambda _node, _reply: None,
    on_duplicate=lambda _node, _before, _after: None,
    on_diagnostic=lambda _node, _diagnostic: None,
    on_configuration=lambda _node, _report: None,
    on_limits=lambda _node, _limits: None,
    on_unknown_clock=lambda _: None,
)


@pytest.mark.parametrize(("seed", "has_beacons"), _CASES)
def test_the_same_messages_give_the_same_bytes(seed: int, has_beacons: bool, tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    publications, counters = asyncio.run(_take(path, list(random_messages(seed, n=1500, has_beacons=has_beacons))))
    digest = hashlib.sha256()
    with closing(JournalReader(path)) as reader:
        page = reader.read_page(from_offset=1, limit=100_000)
        for part in (*page.bodies, *(repr(report).encode() for report in reader.read_reports()), *publications):
            digest.update(len(part).to_bytes(4, "little") + part)
    with closing(sqlite3.connect(path)) as database:
        for row in database.execute("SELECT node, boot, next, above, wall_ns FROM windows ORDER BY node, boot"):
            digest.update(repr(row).encode())
        digest.update(b"".join(body for (body,) in database.execute("SELECT body FROM nodes ORDER BY node")))
        digest.update(b"".join(pairs for (pairs,) in database.execute("SELECT pairs FROM contents ORDER BY segment")))
        spans = database.execute("SELECT min(min_start), max(max_end) FROM segments").fetchone()
        digest.update(repr(spans).encode())
    assert min(counters[name] for name in ("message.repeated", "message.status", "message.encounterbatchwithpaths")) > 20
    assert digest.hexdigest()[:16] == _DIGESTS[seed]
