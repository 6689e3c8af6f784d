"""Forgetting and recalling: what is told does not depend on what is in memory. On a real journal."""

import asyncio
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.records import EncounterRecord
from firmware_protocol.message_codec import EncounterFields
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.clocks import ClockBook
from gateway.config import EncounterTable
from gateway.encounter_reports import EncounterReports
from gateway.health import Health
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import JournalFile, JournalReader, JournalWrite, SegmentBuilder, open_journal_file
from gateway.nodes import NodeBook

_SENT_MS = 1_000_000

_entries = st.tuples(
    st.sampled_from([2, 3]),
    st.integers(0, 8).map(lambda step: _SENT_MS - 900_000 + step * 1_000),
    st.sampled_from([500, 1_500]),
    st.integers(-90, -40),
    st.booleans(),
    st.none(),
)
_steps = st.lists(st.one_of(_entries, st.sampled_from(["begin", "forget", "commit"])), max_size=30)


class _Side:
    """One way of taking reports, with a journal of its own."""

    def __init__(self, path: Path, *, now_ns: int | None = None, began_s: int = 2_000, max_in_memory: int = 1_000) -> None:
        self.path = path
        self.journal = Journal.open(path, health=Health())
        self.reader = self.journal.reader()
        self.told: list[EncounterRecord] = []
        now_ns = time.monotonic_ns() if now_ns is None else now_ns
        nodes, health = NodeBook(gateway="g"), Health()
        self.reports = EncounterReports(
            issuer=RecordIssuer(
                gateway="g",
                journal="j",
                boot=self.journal.boot,
                wall_anchor_ns=self.journal.identity.wall_anchor_ns,
                earlier_anchors=self.journal.identity.earlier_anchors,
            ),
            reader=self.reader,
            nodes=nodes,
            health=health,
            config=EncounterTable(window_s=100, max_in_memory=max_in_memory),
            now_ns=now_ns - began_s * NS_PER_S,
        )
        self.node, _ = nodes.heard(
            node=NodeId(1),
            boot=BootId(1),
            radio="r",
            address=ShortAddress(1),
            rssi_dbm=RssiDbm(-50),
            lqi=1,
            sent_ms=Milliseconds(_SENT_MS),
            now_ns=now_ns,
            now_wall_ns=Nanoseconds(0),
        )
        self.now_ns = now_ns
        clocks = ClockBook(window_ns=600 * NS_PER_S)
        self.clock = clocks.observe(node=NodeId(1), boot=BootId(1), sent_ms=Milliseconds(_SENT_MS), received_ns=now_ns)

    def take(self, entry: EncounterFields) -> None:
        records = self.reports.take([entry], node=self.node, boot=BootId(1), sent_ms=_SENT_MS, clock=self.clock)
        self.told += records
        if records:
            self.journal.append(JournalWrite(records=tuple(records)))

    def close(self) -> None:
        self.reader.close()
        self.journal.close()


def _facts(records: list[EncounterRecord]) -> list[tuple[object, ...]]:
    offset_ns = min((record.t_start_ns for record in records), default=0)
    return [
        (one.sequence, one.revision, one.node_b, one.t_start_ns - offset_ns, one.t_end_ns - offset_ns, one.is_void, one.is_ongoing)
        for one in records
    ]


@settings(max_examples=25, deadline=None)
@given(steps=_steps)
def test_whatever_is_forgotten_meanwhile_the_same_is_told(steps: list[EncounterFields | str]) -> None:
    """Reports are older than the window, so each forgetting takes all that is on disk; what is not must stay."""

    async def story(directory: Path) -> None:
        forgetful, faithful = _Side(directory / "a"), _Side(directory / "b")
        running = [asyncio.ensure_future(side.journal.run()) for side in (forgetful, faithful)]
        is_begun: asyncio.Future[None] | None = None
        for step in steps:
            if step == "begin":
                if forgetful.reports.begin_forgetting(now_ns=forgetful.now_ns):
                    is_begun = forgetful.journal.barrier()
            elif step == "forget":
                if is_begun is not None:
                    await asyncio.shield(is_begun)
                    forgetful.reports.forget_old()
                    is_begun = None
            elif step == "commit":
                await forgetful.journal.drain()
            else:
                assert not isinstance(step, str)
                forgetful.take(step)
                faithful.take(step)
        for side in (forgetful, faithful):
            await side.journal.drain()
        assert _facts(forgetful.told) == _facts(faithful.told)
        for task in running:
            task.cancel()
        await asyncio.wait(running)
        forgetful.close()
        faithful.close()

    with TemporaryDirectory() as directory:
        asyncio.run(story(Path(directory)))


def test_too_many_encounters_leave_memory_whatever_the_window(tmp_path: Path) -> None:
    async def story() -> None:
        side = _Side(tmp_path / "j", max_in_memory=1_000)
        running = asyncio.ensure_future(side.journal.run())
        for at in range(2_500):
            side.take((NodeId(2 + at), _SENT_MS - 60_000 + at * 20, 1, RssiDbm(-60), False, None))
        merger = side.reports._merger
        assert len(merger) == 2_500
        assert side.reports.begin_forgetting(now_ns=side.now_ns - 3_600 * NS_PER_S), "so nothing is older than the window"
        await side.journal.drain()
        side.reports.forget_old()
        for _ in range(3):  # a thousand at each step of the loop
            await asyncio.sleep(0)
        assert len(merger) == 1_000
        running.cancel()
        await asyncio.wait([running])
        side.close()

    asyncio.run(story())


@settings(max_examples=15, deadline=None)
@given(before=st.lists(_entries, max_size=12), after=st.lists(_entries, max_size=12), limit=st.sampled_from([1, 3, 20_000]))
def test_after_a_start_late_reports_make_the_same_encounters_as_without_it(
    before: list[EncounterFields], after: list[EncounterFields], limit: int
) -> None:
    """Whether all that the journal has comes back at once, a part of it, or nothing."""

    async def story(directory: Path) -> None:
        faithful = _Side(directory / "a")
        first = _Side(directory / "b", now_ns=faithful.now_ns)
        for entry in before:
            first.take(entry)
        for entry in [*before, *after]:
            faithful.take(entry)
        running = [asyncio.ensure_future(side.journal.run()) for side in (faithful, first)]
        await first.journal.drain()
        await faithful.journal.drain()
        for task in running:
            task.cancel()
        await asyncio.wait(running)
        first.close()
        second = _Side(directory / "b", now_ns=faithful.now_ns, began_s=0)
        second.told += first.told
        second.reports.max_brought_back = limit
        for entry in after:
            second.take(entry)
        assert _newest(second.told) == _newest(faithful.told)
        second.close()
        faithful.close()

    with TemporaryDirectory() as directory:
        asyncio.run(story(Path(directory)))


def _newest(records: list[EncounterRecord]) -> list[tuple[object, ...]]:
    """What a mapper keeps; each record came with a revision of its own."""
    names = [(one.boot, one.sequence, one.revision) for one in records]
    assert len(names) == len(set(names))
    newest = {(one.boot, one.sequence): one for one in sorted(records, key=lambda one: one.revision)}
    kept = [one for one in newest.values() if not one.is_void]
    return sorted((one.node_b, round(one.t_start_ns, -6), round(one.t_end_ns, -6)) for one in kept)


class _Start:
    """One start of a gateway on a journal, when the wall clock says ``wall_ns``; the monotonic clock is that of one boot of the machine."""

    def __init__(self, path: Path, *, wall_ns: int) -> None:
        now_ns, nodes = _SENT_MS * NS_PER_MS, NodeBook(gateway="g")
        self.file: JournalFile = open_journal_file(path, now_wall_ns=wall_ns, now_ns=now_ns, machine_boot="m")
        self.reader = JournalReader(path)
        is_of = self.file.identity
        self.issuer = RecordIssuer(
            gateway="g", journal=is_of.journal, boot=is_of.boot, wall_anchor_ns=is_of.wall_anchor_ns, earlier_anchors=is_of.earlier_anchors
        )
        self.reports = EncounterReports(
            issuer=self.issuer, reader=self.reader, nodes=nodes, health=Health(), config=EncounterTable(window_s=100), now_ns=now_ns
        )
        self.clocks, self.nodes, self.now_ns = ClockBook(window_ns=600 * NS_PER_S), nodes, now_ns
        self.next_offset = is_of.head_offset + 1

    def take(self, node: int, *entries: EncounterFields) -> list[EncounterRecord]:
        """Take reports of a biobot, and commit what they bring about."""
        sent_ms = Milliseconds(_SENT_MS)
        known, _ = self.nodes.heard(
            node=NodeId(node),
            boot=BootId(1),
            radio="r",
            address=ShortAddress(node),
            rssi_dbm=RssiDbm(-50),
            lqi=1,
            sent_ms=sent_ms,
            now_ns=self.now_ns,
            now_wall_ns=Nanoseconds(0),
        )
        clock = self.clocks.observe(node=NodeId(node), boot=BootId(1), sent_ms=sent_ms, received_ns=self.now_ns)
        records = self.reports.take(entries, node=known, boot=BootId(1), sent_ms=_SENT_MS, clock=clock)
        segment = SegmentBuilder(first_offset=self.next_offset, windows=self.file.windows)
        segment.add(JournalWrite(records=tuple(records)))
        self.file.commit(segment)
        self.next_offset = segment.next_offset
        return records

    def close(self) -> None:
        self.reader.close()
        self.file.close()


@pytest.mark.parametrize("step_s", [3_600, -3_600, 60, -60])
@pytest.mark.parametrize("is_recalled", [True, False])
def test_a_wall_clock_set_between_two_starts_does_not_bring_back_a_stale_revision(tmp_path: Path, step_s: int, is_recalled: bool) -> None:
    """A third start hears the other side, after an older encounter or not: it has to go on from the second start's revision."""
    wall_ns, begin_ms = 1_790_000_000 * NS_PER_S, _SENT_MS - 700_000
    told: list[EncounterRecord] = []
    others: tuple[EncounterFields, ...] = ((NodeId(2), begin_ms - 200_000, 5_000, RssiDbm(-50), False, None),) if is_recalled else ()
    for at_ns, node, entries in (
        (wall_ns, 1, ((NodeId(2), begin_ms, 20_000, RssiDbm(-50), True, None),)),
        (wall_ns + step_s * NS_PER_S, 1, ((NodeId(2), begin_ms, 60_000, RssiDbm(-50), True, None),)),
        (wall_ns + step_s * NS_PER_S, 1, others),
        (wall_ns + step_s * NS_PER_S, 2, ((1, begin_ms, 90_000, -50, False, None),)),
    ):
        start = _Start(tmp_path / "j", wall_ns=at_ns)
        told += start.take(node, *entries)
        start.close()
    ours = [record for record in told if record.identity == told[0].identity]
    assert [record.revision for record in ours] == [0, 1, 2]
    assert [side.node for side in ours[-1].sides] == [1, 2]
