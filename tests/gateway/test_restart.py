"""Laws of a gateway that was killed and starts again, and of one whose journal cannot be read."""

import asyncio
import time
from pathlib import Path

import pytest

from firmware_protocol.contract.records import EncounterRecord, MissionPhase, MissionRecord
from firmware_protocol.message_codec import encode_uplink
from firmware_protocol.messages import EncounterBatch, EncounterEntry, Hello, TimeSyncReply, Uplink, UplinkHeader
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.audit_log import AuditLog
from gateway.clocks import ClockBook
from gateway.config import EncounterTable, MissionTable, StimulationTable
from gateway.downlink import DownlinkSender
from gateway.health import Health
from gateway.intake import Intake, IntakeListeners
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import JournalWrite, open_journal_file
from gateway.mission import Mission
from gateway.nodes import NodeBook, NodeMemory
from gateway.radio import RadioMessage
from gateway.stimulation import StimulationGate
from tests.gateway.fake_radio import until


def _issuer_of(journal: Journal) -> RecordIssuer:
    return RecordIssuer(gateway="g", journal=journal.journal_id, boot=journal.boot, wall_anchor_ns=journal.identity.wall_anchor_ns)


def test_a_restart_at_the_end_of_dispersion_waits_for_the_biobots_it_knew(tmp_path: Path) -> None:
    async def story() -> None:
        health, nodes = Health(), NodeBook(gateway="g")
        journal = Journal.open(tmp_path / "j", health=health)
        issuer, reader = _issuer_of(journal), journal.reader()
        running = asyncio.ensure_future(journal.run())
        begun = MissionRecord(
            gateway="g",
            journal=journal.journal_id,
            offset=1,
            boot=journal.boot,
            sequence=issuer.take_sequence(),
            revision=0,
            wall_anchor_ns=issuer.wall_anchor_ns,
            phase=MissionPhase.DISPERSION,
            t_start_ns=Nanoseconds(time.monotonic_ns() - 61 * NS_PER_S),
        )
        await journal.append(JournalWrite(records=(begun,)))
        memories = [
            NodeMemory(
                node=NodeId(node),
                boot=BootId(1),
                radio="r",
                address=ShortAddress(node),
                eui64=node,
                firmware=1,
                beacon_period_ms=0,
                capabilities=1,
                is_introduced=True,
            )
            for node in range(1, 21)
        ]
        nodes.restore(memories, heard_ns={}, now_ns=time.monotonic_ns())
        gate = StimulationGate(
            gateway="g",
            config=StimulationTable(),
            sender=DownlinkSender(coordinators={}, nodes=nodes),
            nodes=nodes,
            journal=journal,
            reader=reader,
            health=health,
            instant_of=journal.identity.instant_of,
        )
        mission = Mission(
            config=MissionTable(is_enabled=True, dispersion_s=60),
            issuer=issuer,
            journal=journal,
            reader=reader,
            nodes=nodes,
            handle=gate.handle,
            health=health,
            note=AuditLog(journal=journal, reader=reader, health=health).note,
            on_event=lambda _level, _kind, _facts: None,
        )
        exploring = asyncio.ensure_future(mission.run())
        await until(lambda: journal.head_offset >= 2, what="the selection begins")
        one = nodes.find(NodeId(1))
        assert one is not None
        one.last_heard_ns, one.neighbours = time.monotonic_ns(), ()
        await asyncio.sleep(0.5)  # five ticks of the mission
        phases = [record.phase for record in reader.read_records(from_offset=1, limit=9)[0] if isinstance(record, MissionRecord)]
        assert phases == [MissionPhase.DISPERSION, MissionPhase.LANDMARK_SELECTION]
        assert "command.accepted" not in health.counters(), "nobody is stopped yet"
        for task in (exploring, running):
            task.cancel()
        await asyncio.wait({exploring, running})
        reader.close()
        journal.close()

    asyncio.run(story())


def _nobody() -> IntakeListeners:
    return IntakeListeners(
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


def test_a_late_encounter_is_taken_where_the_journal_cannot_be_read(tmp_path: Path) -> None:
    async def story() -> None:
        health, now_ns = Health(), time.monotonic_ns()
        journal = Journal.open(tmp_path / "j", health=health)
        reader, nodes = journal.reader(), NodeBook(gateway="g")
        intake = Intake(
            issuer=_issuer_of(journal),
            journal=journal,
            reader=reader,
            nodes=nodes,
            clocks=ClockBook(window_ns=600 * NS_PER_S),
            health=health,
            config=EncounterTable(window_s=60),
            now_ns=now_ns,
        )
        intake.connect(_nobody())
        reader.close()
        running = asyncio.ensure_future(journal.run())
        heard: list[object] = []
        journal.listen(lambda committed: heard.extend(committed.records))
        entry = EncounterEntry(
            peer=NodeId(2), start_ms=Milliseconds(1), duration_ms=Milliseconds(5), rssi_dbm=RssiDbm(-60), is_ongoing=False
        )
        for at_s in (1, 70):  # the second one comes when the clock is no longer waited for
            header = UplinkHeader(node=NodeId(1), boot=BootId(1), sequence=0, sent_ms=Milliseconds(1000 * at_s + 60_000))
            message = RadioMessage(
                radio="r",
                source=ShortAddress(1),
                rssi_dbm=RssiDbm(-50),
                lqi=1,
                payload=encode_uplink(header, EncounterBatch(entries=(entry,))),
                received_ns=now_ns + at_s * NS_PER_S,
            )
            done = intake.take(message)
        assert done is not None
        await done
        assert health.counters()["encounter.unread_journal"] == 2, "neither all at once nor pair by pair"
        assert [type(record) for record in heard] == [EncounterRecord]
        running.cancel()
        await asyncio.wait({running})
        journal.close()

    asyncio.run(story())


@pytest.mark.parametrize("is_same_machine", [True, False])
def test_a_clock_is_known_after_a_restart_unless_the_machine_was_started_anew(tmp_path: Path, is_same_machine: bool) -> None:
    async def live(says: list[tuple[int, Uplink]], *, anchor_shift_ns: int = 0) -> Health:
        health, now_ns = Health(), time.monotonic_ns()
        journal = Journal.open(tmp_path / "j", health=health)
        reader, clocks = journal.reader(), ClockBook(window_ns=600 * NS_PER_S, first_token=7)
        issuer = _issuer_of(journal)
        issuer.earlier_anchors = tuple(Nanoseconds(one + anchor_shift_ns) for one in journal.identity.earlier_anchors)
        intake = Intake(
            issuer=issuer,
            journal=journal,
            reader=reader,
            nodes=NodeBook(gateway="g"),
            clocks=clocks,
            health=health,
            config=EncounterTable(window_s=60),
            now_ns=now_ns,
        )
        intake.connect(_nobody())
        running = asyncio.ensure_future(journal.run())
        token = clocks.begin_exchange(node=NodeId(1), now_ns=now_ns)
        assert token == 7
        for sequence, message in says:
            if isinstance(message, TimeSyncReply):
                message = TimeSyncReply(token=message.token, received_ms=Milliseconds(now_ns // NS_PER_MS))  # noqa: PLW2901  # it is answered at once
            header = UplinkHeader(node=NodeId(1), boot=BootId(1), sequence=sequence, sent_ms=Milliseconds(now_ns // NS_PER_MS))
            payload = encode_uplink(header, message)
            intake.take(RadioMessage(radio="r", source=ShortAddress(1), rssi_dbm=RssiDbm(-50), lqi=1, payload=payload, received_ns=now_ns))
        await journal.drain()
        running.cancel()
        await asyncio.wait({running})
        reader.close()
        journal.close()
        return health

    tick = Milliseconds(time.monotonic_ns() // NS_PER_MS)
    hello = Hello(eui64=1, firmware=1, beacon_period_ms=0, capabilities=1)
    entry = EncounterEntry(
        peer=NodeId(2), start_ms=Milliseconds(tick - 50), duration_ms=Milliseconds(5), rssi_dbm=RssiDbm(-60), is_ongoing=False
    )
    report = EncounterBatch(entries=(entry,))
    asyncio.run(live([(0, hello), (0, TimeSyncReply(token=7, received_ms=Milliseconds(tick))), (1, report)]))
    counters = asyncio.run(live([(2, report)], anchor_shift_ns=0 if is_same_machine else 1)).counters()
    assert counters.get("message.clock_unknown", 0) == (0 if is_same_machine else 1)
    assert counters.get("encounter.reports", 0) == (1 if is_same_machine else 0)


def test_a_restart_knows_when_each_biobot_was_last_heard_at_the_latest(tmp_path: Path) -> None:
    async def live(*, opened_ns: int, says: int, rest_s: int) -> NodeBook:
        health, nodes = Health(), NodeBook(gateway="g")
        clock = [opened_ns]
        file = open_journal_file(
            tmp_path / "j", now_wall_ns=opened_ns, now_ns=opened_ns, machine_boot="a", wall_clock=lambda: clock[0], clock=lambda: clock[0]
        )
        journal = Journal(path=tmp_path / "j", file=file, health=health)
        reader = journal.reader()
        intake = Intake(
            issuer=_issuer_of(journal),
            journal=journal,
            reader=reader,
            nodes=nodes,
            clocks=ClockBook(window_ns=600 * NS_PER_S),
            health=health,
            config=EncounterTable(window_s=60),
            now_ns=opened_ns,
        )
        intake.connect(_nobody())
        running = asyncio.ensure_future(journal.run())
        for node in range(1, says + 1):
            clock[0] += rest_s * NS_PER_S
            header = UplinkHeader(node=NodeId(node), boot=BootId(1), sequence=0, sent_ms=Milliseconds(1))
            payload = encode_uplink(header, Hello(eui64=node, firmware=1, beacon_period_ms=0, capabilities=1))
            intake.take(
                RadioMessage(radio="r", source=ShortAddress(node), rssi_dbm=RssiDbm(-50), lqi=1, payload=payload, received_ns=clock[0])
            )
            await journal.drain()
        running.cancel()
        await asyncio.wait({running})
        reader.close()
        journal.close()
        return nodes

    begun_ns, rest_s, away_s = 10**15, 200, 7 * 86_400
    asyncio.run(live(opened_ns=begun_ns, says=3, rest_s=rest_s))
    opened_ns = begun_ns + (3 * rest_s + away_s) * NS_PER_S
    nodes = asyncio.run(live(opened_ns=opened_ns, says=0, rest_s=0))
    ages_s = [(opened_ns - node.heard_before_ns) / NS_PER_S for node in nodes.all()]
    assert ages_s == [400, 200, 0], "no week without a gateway makes them older"
    assert all(node.last_heard_ns == 0 for node in nodes.all())
