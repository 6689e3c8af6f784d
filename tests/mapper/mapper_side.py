"""The mapper's parts, put together as the service does, without the web server."""

import asyncio
import itertools
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.records import JournalRecord
from mapper.access import Access, NewToken, Rate, RateLimits, Role, TokenRegister, add_token
from mapper.alert_rules import AlertLimits
from mapper.alert_watch import AlertWatch
from mapper.api.services import Engines, Services
from mapper.bus import Bus
from mapper.changes import Changes, Topic
from mapper.command_log import CommandLog
from mapper.commander import Commander
from mapper.commands import CommandDesk
from mapper.config import RecipeConfig, make_recipe
from mapper.current_map import CurrentMap
from mapper.emergency_stop import EmergencyStop
from mapper.encounter_export import Exports
from mapper.fleet import Fleet
from mapper.intake import Intake
from mapper.jobs import JobDesk
from mapper.kernels import choose_kernels
from mapper.map_history import MapHistory
from mapper.mission_orders import MissionDesk
from mapper.pin_board import PinBoard
from mapper.rips_engines import name_engine
from mapper.stimulation_accounts import StimulationAccounts
from mapper.store import Store
from mapper.store_thread import StoreThread
from mapper.thinning import make_ladder
from mapper.worker import Worker
from tests.mapper.fake_gateway import SITE, batch

DEADLINE_S = 60.0
PATIENCE_S = 150.0
"""For what computes, or waits for it, on a busy machine."""

PERIOD_S = 0.02
_WRITES = Rate(per_s=10.0, burst=100.0)


async def until(is_met: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not is_met():  # noqa: ASYNC110  # what is watched changes on other threads and in other processes
            await asyncio.sleep(PERIOD_S)


@dataclass(frozen=True)
class Side:
    bus: Bus
    records: StoreThread
    fleet: Fleet
    intake: Intake
    changes: Changes
    desk: CommandDesk
    commander: Commander
    accounts: StimulationAccounts
    current_map: CurrentMap
    history: MapHistory
    alerts: AlertWatch
    access: Access
    tokens: Mapping[Role, NewToken]
    pins: PinBoard
    jobs: JobDesk

    @property
    def services(self) -> Services:
        return Services(
            bus=self.bus,
            records=self.records,
            fleet=self.fleet,
            current_map=self.current_map,
            history=self.history,
            alerts=self.alerts,
            commands=self.desk,
            emergency_stop=EmergencyStop(self.desk),
            mission=MissionDesk(bus=self.bus),
            accounts=self.accounts,
            access=self.access,
            pins=self.pins,
            jobs=self.jobs,
            exports=Exports(self.records),
            changes=self.changes,
            is_connected=lambda: self.bus.is_connected,
            counters=lambda: self.intake.counters,
            faults=lambda: list(self.current_map.faults),
            engines=Engines(kernels=choose_kernels().name, persistence=name_engine()),
        )

    async def take_in(self, records: Sequence[JournalRecord]) -> None:
        """Put records into the store, as if they had come from a gateway."""
        await self.records.call(Store.apply, [batch(records)])
        self.changes.bump(Topic.RECORDS)

    async def until(self, is_met: Callable[[Store], bool]) -> None:
        """Wait until the store is as wanted."""
        async with asyncio.timeout(PATIENCE_S):
            while not await self.records.call(is_met):  # noqa: ASYNC110  # same
                await asyncio.sleep(PERIOD_S)

    async def n_encounters(self) -> int:
        return await self.records.call(lambda store: store.n_encounters)


PEOPLE = {Role.VIEWER: "vera", Role.OPERATOR: "anna", Role.ADMIN: "ada"}


def make_access(path: Path, *, allows_anonymous_reading: bool = True, writes: Rate = _WRITES) -> tuple[Access, dict[Role, NewToken]]:
    """Make a file of tokens, one for each role, and open it."""
    tokens = {role: add_token(path, name=name, role=role) for role, name in PEOPLE.items()}
    limits = RateLimits(reads=Rate(per_s=50.0, burst=500.0), writes=writes)
    return Access(register=TokenRegister.open(path), limits=limits, allows_anonymous_reading=allows_anonymous_reading), tokens


@asynccontextmanager
async def mapper_side(
    port: int,
    *,
    with_map: bool = False,
    store: Path | None = None,
    recipe: RecipeConfig | None = None,
    window_ns: int | None = None,
    min_interval_s: float = 0.1,
    clock: Callable[[], int] = time.time_ns,
    more_ports: Sequence[int] = (),
    allows_anonymous_reading: bool = True,
    writes: Rate = _WRITES,
) -> AsyncIterator[Side]:
    records = await StoreThread.open(store)
    bus = await Bus.open(site=SITE, connect=tuple(f"tcp/127.0.0.1:{one}" for one in (port, *more_ports)), listen=())
    fleet, changes = Fleet(), Changes()
    log, accounts = CommandLog(changes=changes), StimulationAccounts()
    log.listen(fleet.take_stage)
    intake = Intake(bus=bus, records=records, fleet=fleet, changes=changes, commands=log, accounts=accounts)
    commander = Commander(bus=bus, name="mapper1")
    desk = CommandDesk(bus=bus, fleet=fleet, log=log, commander=commander)
    pins = PinBoard(records=records, changes=changes)
    await pins.restore()
    history = MapHistory(
        records=records,
        changes=changes,
        ladder=make_ladder(all_s=300, minutes_s=7200, ten_minutes_s=86_400),
        max_bytes=100_000_000,
        made_by="test",
        clock=clock,
    )
    current_map = CurrentMap(
        history=history,
        records=records,
        recipe=make_recipe(recipe or RecipeConfig()),
        fleet=fleet,
        changes=changes,
        pins=pins,
        min_interval_s=min_interval_s,
        window_ns=window_ns,
        clock=clock,
    )
    names = itertools.count(1)
    jobs = JobDesk(
        records=records, changes=changes, pins=pins, recipe=recipe or RecipeConfig(), new_id=lambda: f"job{next(names)}", clock=clock
    )
    # Other tests are to wait for these no longer than for anything else.
    current_map.worker, jobs.worker = Worker(name="map worker", niceness=0), Worker(name="job worker", niceness=0)
    alerts = AlertWatch(
        records=records,
        fleet=fleet,
        changes=changes,
        current_map=current_map,
        limits=AlertLimits(),
        sure=0.8,
        is_connected=lambda: bus.is_connected,
        faults=lambda: list(current_map.faults),
    )
    await alerts.restore()
    if with_map:
        await current_map.restore()
    folder = tempfile.TemporaryDirectory()
    access, tokens = make_access(Path(folder.name) / "tokens.json", allows_anonymous_reading=allows_anonymous_reading, writes=writes)
    runs = [
        intake.run(),
        desk.run(),
        commander.run(),
        jobs.run(),
        access.register.run(),
        *([current_map.run(), history.run()] if with_map else []),
    ]
    tasks = [asyncio.create_task(run) for run in runs]
    await asyncio.sleep(0)
    try:
        yield Side(
            bus=bus,
            records=records,
            fleet=fleet,
            intake=intake,
            changes=changes,
            desk=desk,
            commander=commander,
            accounts=accounts,
            current_map=current_map,
            history=history,
            alerts=alerts,
            access=access,
            tokens=tokens,
            pins=pins,
            jobs=jobs,
        )
        assert not any(task.done() for task in tasks)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await bus.aclose()
        await records.aclose()
        folder.cleanup()
