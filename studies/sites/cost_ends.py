"""The ends of `studies.sites.costs`: ``python -m studies.sites.cost_ends FILE``, in a process each.

A publisher has a gateway's own journal and bus, and writes encounters of two sides at a steady rate once the file ``go`` is there. A
subscriber has a mapper's own bus, intake and store on disk, without map and web server. Each notes how far it is in a file, a publisher
also how far a mapper says to be. FILE is JSON.
"""

import asyncio
import sys
import time
from pathlib import Path
from typing import Final, Literal

import msgspec

from firmware_protocol.contract.records import EncounterRecord, EncounterSide
from firmware_protocol.contract.sessions import TlsTable
from firmware_protocol.units import NS_PER_S, Nanoseconds, NodeId, RssiDbm
from gateway.bus import Bus as GatewayBus
from gateway.config import GatewayConfig
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import JournalWrite
from mapper.bus import Bus as MapperBus
from mapper.changes import Changes
from mapper.command_log import CommandLog
from mapper.fleet import Fleet
from mapper.intake import Intake
from mapper.stimulation_accounts import StimulationAccounts
from mapper.store import Store
from mapper.store_thread import StoreThread

_TURN_S: Final = 0.02
_LOOK_S: Final = 0.25
_MARGIN_NS: Final = 40_000_000
_ERROR_NS: Final = 5_000_000
_N_BIOBOTS: Final = 150


class EndPlan(msgspec.Struct, frozen=True, kw_only=True):
    """What an end is to do; ``rate`` [records/s], ``n_records`` and ``go`` are for publishers, ``journals`` for subscribers."""

    role: Literal["publisher", "subscriber"]
    site: str
    name: str
    endpoint: str
    tls: TlsTable
    file: str
    told: str
    rate: float = 0.0
    n_records: int = 0
    go: str = ""
    gateways: tuple[str, ...] = ()


async def publish(plan: EndPlan) -> None:
    """Journal and publish as many encounters as the plan says, and stay."""
    health = Health()
    journal = Journal.open(Path(plan.file), health=health)
    config = GatewayConfig(site=plan.site, name=plan.name, journal=plan.file, listen=(), connect=(plan.endpoint,), tls=plan.tls)
    bus = await asyncio.to_thread(GatewayBus.open, config, health=health)
    journal.listen(bus.publish_records)
    async with asyncio.TaskGroup() as group:
        group.create_task(journal.run())
        bus.start(
            on_command=lambda _request, _answer: None,
            open_reader=journal.reader,
            journal=journal.journal_id,
            on_watermark=lambda _mapper, offset: _write(Path(plan.told).with_suffix(".mark"), journal=journal.journal_id, done=offset),
        )
        _tell(plan, journal=journal.journal_id, done=0)
        while not Path(plan.go).exists():  # noqa: ASYNC110, ASYNC240  # another process makes it
            await asyncio.sleep(_TURN_S)
        begun_s, done = time.monotonic(), 0
        while done < plan.n_records:
            wanted = min(plan.n_records, int((time.monotonic() - begun_s) * plan.rate))
            if wanted > done:
                journal.append(JournalWrite(records=tuple(_record(plan, journal, number) for number in range(done, wanted))))
                done = wanted
            await asyncio.sleep(_TURN_S)
        _tell(plan, journal=journal.journal_id, done=done)
        await asyncio.Event().wait()


def _record(plan: EndPlan, journal: Journal, number: int) -> EncounterRecord:
    node_a, node_b = 1 + number % _N_BIOBOTS, 1 + _N_BIOBOTS + number * 7 % _N_BIOBOTS
    end_ns = time.monotonic_ns()
    start_ns = end_ns - 3 * NS_PER_S - number % 1000
    sides = tuple(
        EncounterSide(
            node=NodeId(node),
            t_start_ns=Nanoseconds(start_ns + at),
            t_end_ns=Nanoseconds(end_ns - at),
            rssi_dbm=RssiDbm(-60 - at),
            error_ns=Nanoseconds(_ERROR_NS),
        )
        for at, node in enumerate((node_a, node_b))
    )
    return EncounterRecord(
        gateway=plan.name,
        journal=journal.journal_id,
        offset=1,  # the journal numbers what it commits
        boot=journal.boot,
        sequence=number,
        revision=0,
        wall_anchor_ns=Nanoseconds(time.time_ns() - time.monotonic_ns()),
        node_a=NodeId(node_a),
        node_b=NodeId(node_b),
        t_start_ns=Nanoseconds(start_ns),
        t_end_ns=Nanoseconds(end_ns),
        error_ns=Nanoseconds(_ERROR_NS),
        is_reciprocal=True,
        margin_ns=_MARGIN_NS,
        sides=sides,
    )


async def subscribe(plan: EndPlan) -> None:
    """Store what comes, and note how much of it there is."""
    bus = await MapperBus.open(site=plan.site, connect=(plan.endpoint,), listen=(), tls=plan.tls, name=plan.name)
    records = await StoreThread.open(Path(plan.file))
    changes = Changes()
    intake = Intake(
        bus=bus,
        records=records,
        fleet=Fleet(),
        changes=changes,
        commands=CommandLog(changes=changes),
        accounts=StimulationAccounts(),
    )
    async with asyncio.TaskGroup() as group:
        group.create_task(intake.run())
        _tell(plan, journal="", done=0)
        while True:
            await asyncio.sleep(_LOOK_S)
            done = 0
            for gateway in plan.gateways:
                told = Path(plan.told).with_name(f"{gateway}.told")
                if told.exists():
                    done += await records.call(Store.watermark, gateway=gateway, journal=read_told(told)[0])
            _tell(plan, journal="", done=done)


def _tell(plan: EndPlan, *, journal: str, done: int) -> None:
    _write(Path(plan.told), journal=journal, done=done)


def _write(path: Path, *, journal: str, done: int) -> None:
    unfinished = path.with_name(f"{path.name}.part")
    unfinished.write_bytes(msgspec.json.encode((journal, done)))
    unfinished.replace(path)


def read_told(path: Path) -> tuple[str, int]:
    """Return what an end has noted: its journal's name, and how many records it has published or stored."""
    return msgspec.json.decode(path.read_bytes(), type=tuple[str, int])


def main() -> int:
    """Be one of the ends, until killed."""
    plan = msgspec.json.decode(Path(sys.argv[1]).read_bytes(), type=EndPlan)
    asyncio.run(publish(plan) if plan.role == "publisher" else subscribe(plan))
    return 0


if __name__ == "__main__":
    sys.exit(main())
