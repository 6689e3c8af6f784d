"""A gateway without radios, for `studies.bench_live`: it journals and publishes a recorded life at a rate that no radio brings.

``python -m studies.live_feeder``. What it says goes through the gateway's own journal and bus: nothing is published before it is on disk,
and history queries are answered.
"""

import argparse
import asyncio
import time
from collections.abc import Sequence
from pathlib import Path

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationRequest
from firmware_protocol.contract.records import GatewayStatus
from firmware_protocol.units import Nanoseconds
from gateway.bus import Bus
from gateway.bus_commands import CommandAnswer
from gateway.config import GatewayConfig
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import JournalWrite
from studies.live_life import Life, make_record

NAME = "feeder"
_TICK_S = 0.05
_STATUS_PERIOD_S = 1.0
# A report of a backpack has a few encounters.
_RECORDS_PER_WRITE = 4


def main(arguments: Sequence[str] | None = None) -> int:
    """Publish rows of a life from ``--first`` on, then stay for history queries until killed or told to end by a signal."""
    parser = argparse.ArgumentParser(prog="python -m studies.live_feeder", description=__doc__)
    parser.add_argument("--life", type=Path, required=True, metavar="FILE.npz")
    parser.add_argument("--journal", type=Path, required=True, metavar="FILE")
    parser.add_argument("--listen", required=True, metavar="EP", help="Zenoh endpoint")
    parser.add_argument("--first", type=int, required=True, help="row of the life to begin with")
    parser.add_argument("--anchor-ns", type=int, required=True, help="begin of the life on the wall clock")
    parser.add_argument("--rate", type=float, required=True, help="encounters a second")
    parser.add_argument("--revised-share", type=float, default=0.1, help="of them are corrected a second later (default: %(default)s)")
    parser.add_argument("--wait-s", type=float, default=3.0, help="before the first, so that all are connected (default: %(default)s)")
    parser.add_argument("--done-file", type=Path, required=True, help="written with the newest offset when all is on disk")
    options = parser.parse_args(arguments)
    try:
        asyncio.run(_run(options))
    except KeyboardInterrupt:
        return 0
    return 0


async def _run(options: argparse.Namespace) -> None:
    health = Health()
    journal = Journal.open(options.journal, health=health)
    config = GatewayConfig(name=NAME, journal=str(options.journal), listen=(options.listen,))
    bus = await asyncio.to_thread(Bus.open, config, health=health)
    journal.listen(bus.publish_records)

    def refuse(request: StimulationRequest, answer: CommandAnswer) -> None:
        stage = CommandStage(
            command_id=request.command_id,
            gateway=NAME,
            node=request.node,
            action=request.action,
            stage=Stage.REFUSED,
            wall_ns=Nanoseconds(time.time_ns()),
            reason="this gateway has no radio",
        )
        answer.tell(stage)

    try:
        async with asyncio.TaskGroup() as group:
            group.create_task(journal.run())
            bus.start(on_command=refuse, open_reader=journal.reader, journal=journal.journal_id)
            group.create_task(_tell_status(bus, journal, health))
            await asyncio.sleep(options.wait_s)
            await _feed(journal, Life.load(options.life), options)
            await journal.drain()
            options.done_file.write_text(str(journal.head_offset))
    finally:
        await asyncio.to_thread(bus.close)
        await asyncio.to_thread(journal.close)


async def _tell_status(bus: Bus, journal: Journal, health: Health) -> None:
    while True:
        status = GatewayStatus(
            gateway=NAME,
            journal=journal.journal_id,
            boot=journal.boot,
            head_offset=journal.head_offset,
            wall_ns=Nanoseconds(time.time_ns()),
            radios={},
            counters=health.counters(),
        )
        bus.publish_gateway_status(status)
        await asyncio.sleep(_STATUS_PERIOD_S)


async def _feed(journal: Journal, life: Life, options: argparse.Namespace) -> None:
    """Append what is due at every tick: new encounters, and corrections of those of a second ago."""
    begun = time.monotonic()
    n_rows, n_sent, n_looked_at = len(life) - options.first, 0, 0
    every = round(1 / options.revised_share) if options.revised_share > 0 else n_rows + 1
    while n_sent < n_rows or n_looked_at < n_rows:
        elapsed_s = time.monotonic() - begun
        due = [(row, 0) for row in range(n_sent, min(n_rows, int(elapsed_s * options.rate)))]
        late = range(n_looked_at, min(n_sent, n_rows, int(max(0.0, elapsed_s - 1.0) * options.rate)))
        n_sent, n_looked_at = n_sent + len(due), n_looked_at + len(late)
        due += [(row, 1) for row in late if row % every == 0]
        for first in range(0, len(due), _RECORDS_PER_WRITE):
            records = tuple(
                make_record(
                    life,
                    options.first + row,
                    gateway=NAME,
                    journal=journal.journal_id,
                    boot=journal.boot,
                    offset=1,  # the journal numbers what it commits
                    sequence=row,
                    revision=revision,
                    anchor_ns=options.anchor_ns,
                )
                for row, revision in due[first : first + _RECORDS_PER_WRITE]
            )
            journal.append(JournalWrite(records=records))
        await asyncio.sleep(_TICK_S)


if __name__ == "__main__":
    raise SystemExit(main())
