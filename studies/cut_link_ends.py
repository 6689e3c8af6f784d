"""The programs at both ends of a link, each in a namespace of its own; started by `studies.cut_links` and `studies.sites`.

A publisher: the gateway's own journal and bus without a radio, which writes a record every few milliseconds. A subscriber: the mapper's
bus, intake and store. Each appends ``[offset, monotonic time in s]`` to a file, the subscriber the offset up to which it has
everything, one a line: the clock is the same for all of this machine. A fifth argument is a JSON file with the TLS table of the end.
"""

import asyncio
import json
import sys
import time
from pathlib import Path
from typing import TextIO

import msgspec

from firmware_protocol.contract.records import MissionPhase, MissionRecord
from firmware_protocol.contract.sessions import TlsTable
from firmware_protocol.units import Nanoseconds
from gateway.bus import Bus as GatewayBus
from gateway.config import GatewayConfig
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import Committed, JournalWrite
from mapper.bus import Bus as MapperBus
from mapper.changes import Changes
from mapper.command_log import CommandLog
from mapper.fleet import Fleet
from mapper.intake import Intake
from mapper.stimulation_accounts import StimulationAccounts
from mapper.store_thread import StoreThread

SITE = "cut"
MAPPER = "map1"
JOURNAL_NAME = "journal.txt"
_LOOK_S = 0.01


def main() -> int:
    """Run the role named by the first argument until killed."""
    role, endpoint, path, period_s = sys.argv[1], sys.argv[2], Path(sys.argv[3]), float(sys.argv[4])
    tls = msgspec.json.decode(Path(sys.argv[5]).read_bytes(), type=TlsTable) if len(sys.argv) > 5 else TlsTable()
    with path.open("w", buffering=1, encoding="utf-8") as file:
        if role == "publisher":
            asyncio.run(_publish(endpoint, file, tls=tls, journal_path=path.with_suffix(".sqlite"), period_s=period_s))
        else:
            asyncio.run(_subscribe(endpoint, file, tls=tls, journal=path.with_name(JOURNAL_NAME).read_text(encoding="utf-8")))
    return 0


async def _publish(endpoint: str, file: TextIO, *, tls: TlsTable, journal_path: Path, period_s: float) -> None:
    health = Health()
    journal = Journal.open(journal_path, health=health)
    config = GatewayConfig(site=SITE, journal=str(journal_path), listen=(), connect=(endpoint,), tls=tls)
    bus = await asyncio.to_thread(GatewayBus.open, config, health=health)

    def note(committed: Committed) -> None:
        for record in committed.records:
            file.write(json.dumps([record.offset, time.monotonic()]) + "\n")

    journal.listen(bus.publish_records)
    journal.listen(note)
    journal_path.with_name(JOURNAL_NAME).write_text(journal.journal_id, encoding="utf-8")
    async with asyncio.TaskGroup() as group:
        group.create_task(journal.run())
        bus.start(on_command=lambda _request, _answer: None, open_reader=journal.reader, journal=journal.journal_id)
        print("up", flush=True)
        sequence = 0
        while True:
            sequence += 1
            record = MissionRecord(
                gateway=config.name,
                journal=journal.journal_id,
                offset=1,  # the journal numbers what it commits
                boot=journal.boot,
                sequence=sequence,
                revision=0,
                wall_anchor_ns=Nanoseconds(0),
                phase=MissionPhase.EXPLORATION,
                t_start_ns=Nanoseconds(time.monotonic_ns()),
            )
            journal.append(JournalWrite(records=(record,)))
            await asyncio.sleep(period_s)


async def _subscribe(endpoint: str, file: TextIO, *, tls: TlsTable, journal: str) -> None:
    bus = await MapperBus.open(site=SITE, connect=(endpoint,), listen=(), tls=tls, name=MAPPER)
    records = await StoreThread.open(None)
    changes = Changes()
    commands, accounts = CommandLog(changes=changes), StimulationAccounts()
    intake = Intake(bus=bus, records=records, fleet=Fleet(), changes=changes, commands=commands, accounts=accounts)
    async with asyncio.TaskGroup() as group:
        group.create_task(intake.run())
        print("up", flush=True)
        level = -1
        while True:
            newest = await records.call(lambda store: store.watermark(gateway=GatewayConfig().name, journal=journal))
            if newest != level:
                level = newest
                file.write(json.dumps([level, time.monotonic()]) + "\n")
            await asyncio.sleep(_LOOK_S)


if __name__ == "__main__":
    raise SystemExit(main())
