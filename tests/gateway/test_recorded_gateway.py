"""``run --record``: a gateway's lines are recorded beside its work, over every time that a port is opened."""

import asyncio
from collections import Counter
from pathlib import Path

import msgspec
import zenoh

from firmware_protocol.contract.keys import ANY, Stream, build_key
from firmware_protocol.contract.recordings import RecordingList
from firmware_protocol.contract.records import EncounterRecord, decode_record
from firmware_protocol.units import NodeId
from gateway.config import RecordingTable
from gateway.recordings.dialects import make_line_dissector
from gateway.recordings.printing import LinePrinter
from gateway.recordings.replaying import open_recording
from gateway.transports.recording import LineRecord, RecordKind
from gateway.transports.spec import parse_port_spec
from tests.gateway.fake_radio import a_dongle, on_pty, until
from tests.gateway.harness import a_config, listening, peer_config, running


def _ask_for_recordings(session: zenoh.Session) -> RecordingList:
    """Ask until the gateway is found."""
    key = build_key(site="test", stream=Stream.RECORDINGS, gateway=ANY)
    while True:
        for reply in session.get(key, timeout=5.0):
            assert reply.ok is not None
            return decode_record(reply.ok.payload.to_bytes(), RecordingList)


def test_a_recorded_gateway_works_as_ever_and_the_recording_tells_all_of_it(tmp_path: Path) -> None:
    dongle = a_dongle(7, 9)
    config = a_config(tmp_path, f"serial:{tmp_path}/dongle")
    config = msgspec.structs.replace(config, recording=RecordingTable(directory=str(tmp_path / "lines")))

    listed: list[RecordingList] = []

    async def run() -> int:
        with listening(config) as peer:
            async with running(config):
                for ago_ms in (900, 800):
                    async with on_pty(dongle, tmp_path / "dongle"):
                        n_before = len(peer.of(EncounterRecord))
                        dongle.backpacks[NodeId(7)].say_encounter(NodeId(9), ago_ms=ago_ms, duration_ms=20)
                        await until(lambda n=n_before: len(peer.of(EncounterRecord)) > n, what="the encounter is published")  # type: ignore[misc]
                        await until(lambda: dongle.backpacks[NodeId(7)].is_level, what="it is acknowledged")
                with zenoh.open(peer_config(config.listen[0])) as asking:
                    lists = await asyncio.to_thread(_ask_for_recordings, asking)
                listed.append(lists)
            return len(peer.of(EncounterRecord))

    n_published = asyncio.run(run())
    (path,) = (tmp_path / "lines").iterdir()
    (told,) = listed
    assert (told.gateway, told.is_recording, told.n_left_out) == ("base1", True, 0)
    (entry,) = told.recordings
    assert (entry.name, entry.radio) == (path.name, parse_port_spec(config.ports[0]).name)
    with open_recording(path) as recording:
        records: list[LineRecord] = list(recording.records)
        assert not recording.n_damages
        assert entry.begin_wall_ns == recording.header.wall_ns
        assert entry.end_wall_ns in {record.wall_ns for record in records}
        assert 0 < entry.n_bytes <= path.stat().st_size
        assert (recording.header.port, recording.header.dialect) == (config.ports[0], "native")
    printer = LinePrinter(make_line_dissector("native", path="x"))
    events = [event for record in records for event in printer.take(record)]
    kinds = Counter(record.kind for record in records)
    heard = {str(event["says"]) for event in events if event.get("message") == "EncounterBatch"}

    assert n_published == len(heard) == 2
    assert kinds[RecordKind.OPENED] == kinds[RecordKind.LOST] + kinds[RecordKind.CLOSED] >= 2
    assert printer.counts["message.Acknowledge"] >= 2
    assert not any("fault" in event for event in events)
