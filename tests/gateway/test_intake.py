"""Laws of the intake, on a real journal: what an uplink message may change, and what it may not."""

import asyncio
import contextlib
import sqlite3
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from firmware_protocol.contract.records import Cause, Mode, NodeStatus
from firmware_protocol.message_codec import encode_uplink
from firmware_protocol.messages import (
    EncounterBatch,
    EncounterEntry,
    Hello,
    Status,
    StimulateReply,
    StimulationResult,
    TimeSyncReply,
    Uplink,
    UplinkHeader,
    WireCause,
    WireMode,
)
from firmware_protocol.units import NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.clocks import ClockBook
from gateway.config import EncounterTable
from gateway.health import Health
from gateway.intake import Intake, IntakeListeners
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import JournalWrite
from gateway.modes import ModeReport, ModeTracker
from gateway.nodes import NodeBook
from gateway.radio import RadioMessage

_BEGUN_NS = time.monotonic_ns()
"""When messages come, but for those that are late: however long a test takes, a backpack's clock and the gateway's go alike."""


@dataclass(kw_only=True)
class _Desk:
    """An intake, and what it tells."""

    intake: Intake
    nodes: NodeBook
    clocks: ClockBook
    journal: Journal
    health: Health
    committed: list[int] = field(default_factory=list)
    statuses: list[NodeStatus] = field(default_factory=list)
    answers: list[tuple[str, int]] = field(default_factory=list)
    """Of stimulation: when they were told of, and the command's number."""

    def take(
        self, message: Uplink, *, sequence: int, boot: int = 1, sent_ms: int = 1000, radio: str = "r", source: int = 0x1007, late_s: int = 0
    ) -> "asyncio.Future[None] | None":
        header = UplinkHeader(node=NodeId(7), boot=BootId(boot), sequence=sequence, sent_ms=Milliseconds(sent_ms))
        return self.intake.take(
            RadioMessage(
                radio=radio,
                source=ShortAddress(source),
                rssi_dbm=RssiDbm(-50),
                lqi=1,
                payload=encode_uplink(header, message),
                received_ns=_BEGUN_NS + late_s * NS_PER_S,
            )
        )


def _with_desk(path: Path, story: Callable[[_Desk], Awaitable[None]]) -> None:
    async def run() -> None:
        health = Health()
        journal = Journal.open(path, health=health)
        reader, nodes, clocks = journal.reader(), NodeBook(gateway="g"), ClockBook(window_ns=600 * NS_PER_S)
        intake = Intake(
            issuer=RecordIssuer(gateway="g", journal=journal.journal_id, boot=journal.boot, wall_anchor_ns=journal.identity.wall_anchor_ns),
            journal=journal,
            reader=reader,
            nodes=nodes,
            clocks=clocks,
            health=health,
            config=EncounterTable(window_s=60),
            now_ns=time.monotonic_ns(),
        )
        desk = _Desk(intake=intake, nodes=nodes, clocks=clocks, journal=journal, health=health)
        intake.connect(
            IntakeListeners(
                on_committed=desk.committed.append,
                on_status=desk.statuses.append,
                on_neighbours=lambda _: None,
                on_reply=lambda _node, reply: desk.answers.append(("on disk", reply.command)),
                on_answer=lambda _node, reply: desk.answers.append(("at once", reply.command)),
                on_duplicate=lambda _node, _before, _after: None,
                on_diagnostic=lambda _node, _diagnostic: None,
                on_configuration=lambda _node, _report: None,
                on_limits=lambda _node, _limits: None,
                on_unknown_clock=lambda _: None,
            )
        )
        try:
            await story(desk)
        finally:
            reader.close()
            journal.close()

    asyncio.run(run())


def _a_hello(firmware: int) -> Hello:
    return Hello(eui64=7, firmware=firmware, beacon_period_ms=1000, capabilities=1)


@pytest.mark.parametrize("source", [0xFFF8, 0xFFFC, 0xFFFD, 0xFFFE, 0xFFFF])
def test_a_message_from_an_address_of_many_or_of_nobody_is_counted_and_dropped(tmp_path: Path, source: int) -> None:
    async def story(desk: _Desk) -> None:
        assert desk.take(_a_hello(1), sequence=0, source=source) is None
        assert desk.nodes.all() == []
        assert desk.health.counters() == {"message.impossible_source": 1}
        assert desk.take(_a_hello(1), sequence=0, source=0xFFF7) is not None, "it comes again, and is new"
        assert desk.nodes.all()[0].address == 0xFFF7

    _with_desk(tmp_path / "j", story)


def test_an_old_message_of_a_life_that_is_over_is_kept_and_says_nothing_of_the_biobot_now(tmp_path: Path) -> None:
    async def story(desk: _Desk) -> None:
        running = asyncio.ensure_future(desk.journal.run())
        done = [
            desk.take(_a_hello(1), sequence=0, boot=3, radio="native", source=0x1000),
            desk.take(_a_hello(2), sequence=0, boot=4, radio="xbee", source=0x2222),
            desk.take(_a_hello(1), sequence=1, boot=3, sent_ms=9000, radio="native", source=0x1000),
        ]
        assert None not in done
        await asyncio.gather(*(one for one in done if one is not None))
        node = desk.nodes.all()[0]
        assert (node.boot, node.radio, node.address, node.firmware, node.is_introduced) == (4, "xbee", 0x2222, 2, True)
        window = desk.intake.window_of(NodeId(7))
        assert window is not None
        assert window[0] == 4, "the life that goes on is the one that is acknowledged"
        status = Status(mode=WireMode.S, cause=WireCause.NATURAL, mode_since_ms=Milliseconds(0), battery_mv=1, buffered=0, dropped=0)
        # Its clock was never asked for; six seconds after its first message it is believed as it is.
        kept = desk.take(status, sequence=2, boot=3, sent_ms=9001, radio="native", source=0x1000, late_s=6)
        assert kept is not None
        await kept
        await asyncio.sleep(0)
        assert desk.journal.head_offset == 1, "the mode it was in is a record"
        assert desk.statuses == []
        assert node.status is None
        running.cancel()

    _with_desk(tmp_path / "j", story)


def test_what_is_repeated_while_the_disk_waits_is_told_once_when_it_is_there(tmp_path: Path) -> None:
    async def story(desk: _Desk) -> None:
        first = desk.take(_a_hello(1), sequence=0)
        repeats = [desk.take(_a_hello(1), sequence=0, sent_ms=1000 + index) for index in range(5_000)]
        assert len({id(one) for one in repeats}) == 1, "all wait for one write"
        assert desk.committed == []
        running = asyncio.ensure_future(desk.journal.run())
        assert first is not None
        await first
        await desk.journal.drain()
        await asyncio.sleep(0)
        assert desk.committed == [7, 7], "of the message, and of all its repetitions"
        again = desk.take(_a_hello(1), sequence=0, sent_ms=9000)
        assert again is not None
        await again
        await asyncio.sleep(0)
        assert desk.committed == [7, 7, 7]
        running.cancel()

    _with_desk(tmp_path / "j", story)


def test_an_animal_s_answer_is_told_at_once_and_again_when_it_is_on_disk(tmp_path: Path) -> None:
    async def story(desk: _Desk) -> None:
        reply = StimulateReply(command=9, result=StimulationResult.DONE, executed_ms=Milliseconds(1), mode=WireMode.S)
        done = desk.take(reply, sequence=0)
        desk.take(reply, sequence=0)
        await asyncio.sleep(0)
        assert desk.answers == [("at once", 9)], "the disk takes nothing yet"
        assert desk.committed == []
        running = asyncio.ensure_future(desk.journal.run())
        assert done is not None
        await done
        await asyncio.sleep(0)
        assert desk.answers == [("at once", 9), ("on disk", 9)]
        running.cancel()

    _with_desk(tmp_path / "j", story)


def _a_batch(*, peer: int, start_ms: int) -> EncounterBatch:
    entry = EncounterEntry(
        peer=NodeId(peer), start_ms=Milliseconds(start_ms), duration_ms=Milliseconds(500), rssi_dbm=RssiDbm(-50), is_ongoing=False
    )
    return EncounterBatch(entries=(entry,))


def _a_status(mode: WireMode, *, since_ms: int) -> Status:
    return Status(mode=mode, cause=WireCause.NATURAL, mode_since_ms=Milliseconds(since_ms), battery_mv=1, buffered=0, dropped=0)


def test_a_late_encounter_of_a_pair_whose_records_are_damaged_is_taken(tmp_path: Path) -> None:
    async def before(desk: _Desk) -> None:
        running = asyncio.ensure_future(desk.journal.run())
        desk.take(_a_hello(1), sequence=0, sent_ms=100_000)
        done = desk.take(_a_batch(peer=9, start_ms=95_000), sequence=1, sent_ms=161_000, late_s=61)
        assert done is not None
        await done
        running.cancel()

    async def after(desk: _Desk) -> None:
        running = asyncio.ensure_future(desk.journal.run())
        desk.take(_a_hello(1), sequence=0, sent_ms=100_000)
        done = desk.take(_a_batch(peer=9, start_ms=96_000), sequence=2, sent_ms=161_000, late_s=61)
        assert done is not None
        await done
        assert desk.health.counters()["encounter.unread_journal"] >= 1
        assert desk.journal.head_offset == 2
        running.cancel()

    _with_desk(tmp_path / "j", before)
    with contextlib.closing(sqlite3.connect(tmp_path / "j")) as connection, connection:
        segment, records = connection.execute("SELECT segment, records FROM contents WHERE length(records) > 0").fetchone()
        damaged = records[:8] + b"\xc1" + records[9:]  # an octet that MessagePack never uses
        connection.execute("UPDATE contents SET records = ? WHERE segment = ?", (damaged, segment))
    _with_desk(tmp_path / "j", after)


def test_what_was_told_before_a_clock_was_known_is_dated_anew_when_it_is(tmp_path: Path) -> None:
    """All comes 4 s late until the time is asked: twice as late as is assumed of the fastest. A status brings the right date."""

    async def story(desk: _Desk) -> None:
        running = asyncio.ensure_future(desk.journal.run())
        desk.take(_a_hello(1), sequence=0, sent_ms=100_000, late_s=4)
        desk.take(_a_batch(peer=9, start_ms=95_000), sequence=1, sent_ms=161_000, late_s=65)
        asked_ns = _BEGUN_NS + 62 * NS_PER_S
        token = desk.clocks.begin_exchange(node=NodeId(7), now_ns=asked_ns)
        desk.take(TimeSyncReply(token=token, received_ms=Milliseconds(162_000)), sequence=0, sent_ms=162_000, late_s=62)
        for sequence in (2, 3):
            desk.take(_a_status(WireMode.S, since_ms=90_000), sequence=sequence, sent_ms=163_000 + sequence, late_s=64)
        await desk.journal.drain()
        with contextlib.closing(desk.journal.reader()) as reader:
            records = list(reader.read_encounters(from_wall_ns=0, to_wall_ns=(1 << 63) - 1))
        late_ns = [record.sides[0].t_start_ns - _BEGUN_NS - (95 - 100) * NS_PER_S for record in records]
        assert [(record.revision, round(late / NS_PER_S)) for record, late in zip(records, late_ns, strict=True)] == [(0, 4), (1, 0)]
        assert [abs(late) <= (record.sides[0].error_ns or 0) for record, late in zip(records, late_ns, strict=True)] == [False, True]
        running.cancel()

    _with_desk(tmp_path / "j", story)


def test_a_message_at_whose_records_the_gateway_fails_is_on_disk_before_it_is_acknowledged(tmp_path: Path) -> None:
    """The failure here is that of a node book which forgot to be asked only for numbers; any other would do."""

    async def story(desk: _Desk) -> None:
        running = asyncio.ensure_future(desk.journal.run())
        desk.take(_a_hello(1), sequence=0, sent_ms=100_000)
        desk.nodes.all()[0].beacon_period_ms = None  # type: ignore[assignment]
        with pytest.raises(TypeError):
            desk.take(_a_batch(peer=9, start_ms=95_000), sequence=1, sent_ms=161_000, late_s=61)
        assert desk.committed == []
        await desk.journal.drain()
        await asyncio.sleep(0)
        assert desk.committed == [7, 7]
        with contextlib.closing(desk.journal.reader()) as reader:
            assert [report.number for report in reader.read_reports()] == [0, 1]
        running.cancel()

    _with_desk(tmp_path / "j", story)


def test_a_mode_that_stands_longer_than_all_that_is_read_at_the_start_is_no_second_spell(tmp_path: Path) -> None:
    async def before(desk: _Desk) -> None:
        running = asyncio.ensure_future(desk.journal.run())
        desk.take(_a_hello(1), sequence=0, sent_ms=100_000)
        done = desk.take(_a_status(WireMode.S, since_ms=90_000), sequence=1, sent_ms=161_000, late_s=61)
        assert done is not None
        await done
        assert desk.journal.head_offset == 1
        other = RecordIssuer(gateway="g", journal=desk.journal.journal_id, boot=BootId(9), wall_anchor_ns=Nanoseconds(0))
        crowd = ModeTracker(issuer=other)
        spells = []
        for second in range(10_001):
            spells += crowd.observe(
                ModeReport(
                    node=NodeId(8),
                    boot=BootId(second),
                    since_ms=Milliseconds(0),
                    t_start_ns=Nanoseconds(second * NS_PER_S),
                    error_ns=Nanoseconds(1),
                    mode=Mode.S,
                    cause=Cause.NATURAL,
                    is_from_reply=False,
                )
            )
        await desk.journal.append(JournalWrite(records=tuple(spells)))
        running.cancel()

    async def after(desk: _Desk) -> None:
        running = asyncio.ensure_future(desk.journal.run())
        desk.take(_a_hello(1), sequence=0, sent_ms=100_000)
        head_offset = desk.journal.head_offset
        again = desk.take(_a_status(WireMode.S, since_ms=90_000), sequence=2, sent_ms=161_000, late_s=61)
        assert again is not None
        await again
        assert desk.journal.head_offset == head_offset, "the same spell"
        done = desk.take(_a_status(WireMode.CRW, since_ms=160_000), sequence=3, sent_ms=161_000, late_s=61)
        assert done is not None
        await done
        with contextlib.closing(desk.journal.reader()) as reader:
            first, closed, begun = (record for record in reader.read_recent_modes(limit=100_000) if record.node == 7)
        assert (closed.identity, closed.revision) == (first.identity, 1)
        assert closed.t_end_ns == begun.t_start_ns
        running.cancel()

    _with_desk(tmp_path / "j", before)
    _with_desk(tmp_path / "j", after)
