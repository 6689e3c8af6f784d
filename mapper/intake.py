"""From the bus into store and fleet, and the repair of gaps from the gateways' history (CONTRACT.md §4)."""

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, TypeVar

from firmware_protocol.contract.announcements import GatewayEvent, NeighbourReport
from firmware_protocol.contract.commands import CommandStage, StimulationAccount
from firmware_protocol.contract.presence import Kind
from firmware_protocol.contract.records import GatewayStatus, MissionRecord, NodeStatus, RecordBatch
from mapper.arrivals import Arrival, Presence
from mapper.bus import Bus
from mapper.changes import Changes, Topic
from mapper.command_log import CommandLog
from mapper.errors import QueryError, StoreError
from mapper.fleet import Fleet
from mapper.log import EventLog
from mapper.stimulation_accounts import StimulationAccounts
from mapper.store import Applied, Store
from mapper.store_thread import StoreThread

_log = EventLog(__name__)

_PAGE: Final = 10_000
_CHECK_PERIOD_S: Final = 0.25
# A status may overtake the records it counts; only what is still missing after this is a gap.
_GRACE_S: Final = 0.5
_MAX_BACKOFF_S: Final = 10.0
_ASKED_BEFORE_GIVING_UP: Final = 3

_ResultT = TypeVar("_ResultT")


@dataclass(slots=True)
class _Journal:
    """The journal that a gateway writes now, the newest offset it has told of, and the oldest that it still has."""

    name: str
    head_offset: int
    oldest_offset: int


class Intake:
    """Keeps store, fleet, commands and accounts in step with the bus.

    ``counters``: records ``new``, ``revised``, ``repeated``, ``unfit``; ``repaired`` ones that history brought;
    ``given_up`` offsets that a gateway does not have itself; ``expired`` ones that it has dropped of age or for want of room before
    they were here; ``store_faults`` writes that failed (history repeats them).
    """

    def __init__(
        self,
        *,
        bus: Bus,
        records: StoreThread,
        fleet: Fleet,
        changes: Changes,
        commands: CommandLog,
        accounts: StimulationAccounts,
    ) -> None:
        self.counters: Counter[str] = Counter()
        self.store_fault: str | None = None
        self.losses: dict[tuple[str, str], str] = {}
        """Gateway's name and the counter to what will never be here of its journal, in words: what expired, of a journal of which this
        store had a part already, and what was given up."""
        self._bus = bus
        self._records = records
        self._fleet = fleet
        self._changes = changes
        self._commands = commands
        self._accounts = accounts
        self._journals: dict[str, _Journal] = {}
        self._waits: dict[str, asyncio.Timeout] = {}

    async def run(self) -> None:
        """Take in what comes, until cancelled."""
        self._fleet.take_modes(await self._records.call(Store.latest_modes))
        async with asyncio.TaskGroup() as group:
            while True:
                arrivals = await self._bus.receive()
                known = set(self._journals)
                await self._take(arrivals)
                for gateway in self._journals.keys() - known:
                    group.create_task(self._follow(gateway), name=f"repair {gateway}")

    async def _take(self, arrivals: Sequence[Arrival]) -> None:
        batches: list[RecordBatch] = []
        has_news = False
        for arrival in arrivals:
            match arrival:
                case RecordBatch():
                    batches.append(arrival)
                    self._note_head(arrival)
                case CommandStage():
                    self._commands.take(arrival)
                case _:
                    self._note(arrival)
                    has_news = True
        if has_news:
            self._changes.bump(Topic.BIOBOTS)
        if batches:
            await self._apply(batches)

    def _note(self, arrival: GatewayStatus | NodeStatus | NeighbourReport | GatewayEvent | StimulationAccount | Presence) -> None:
        match arrival:
            case GatewayStatus():
                self._note_head(arrival)
                self._fleet.take_gateway_status(arrival, now_ns=time.monotonic_ns())
            case NodeStatus():
                self._fleet.take_node_status(arrival)
            case NeighbourReport():
                self._fleet.take_neighbours(arrival)
            case GatewayEvent():
                self._fleet.events.append(arrival)
            case StimulationAccount():
                self._accounts.take(arrival)
            case Presence():
                token, verb = arrival.token, "on_the_bus" if arrival.is_alive else "left_the_bus"
                facts = {"name": token.name} if token.radio is None else {"gateway": token.name, "radio": token.radio}
                _log.info(f"{token.kind.name.lower()}.{verb}", **facts)
                self._fleet.take_presence(token, is_alive=arrival.is_alive, now_ns=time.monotonic_ns())
                if token.kind is Kind.GATEWAY and arrival.is_alive and token.name in self._waits:
                    self._waits.pop(token.name).reschedule(asyncio.get_running_loop().time())

    async def _write(self, writing: Awaitable[_ResultT]) -> _ResultT | None:
        """Wait until the store has written something; None where it could not, which is a fault until it has written again."""
        try:
            written = await writing
        except StoreError as error:
            self.counters["store_faults"] += 1
            if self.store_fault is None:
                _log.error("store.fault", reason=str(error))
                self._records.refused_since_ns = time.time_ns()
            self.store_fault = str(error)
            return None
        if self.store_fault is not None:
            _log.warning("store.fault_over", faults=self.counters["store_faults"])
            self.store_fault = None
            self._records.refused_since_ns = None
        return written

    async def _apply(self, batches: Sequence[RecordBatch]) -> Applied:
        if not any(batch.records for batch in batches):
            return Applied()  # a store that had nothing to write has not shown that it can
        applied = await self._write(self._records.call(Store.apply, batches))
        if applied is None:
            return Applied()
        self.counters.update(new=applied.n_new, revised=applied.n_revised, repeated=applied.n_repeated, unfit=applied.n_unfit)
        if applied.has_changed:
            self._tell(batches)
            self._fleet.take_modes(applied.modes)
        return applied

    def _tell(self, batches: Sequence[RecordBatch]) -> None:
        kinds = {type(record) for batch in batches for record in batch.records}
        # A phase of the mission moves the beginning of what counts.
        self._changes.bump(Topic.RECORDS)
        if MissionRecord in kinds:
            self._changes.bump(Topic.MISSION)

    def _note_head(self, told: RecordBatch | GatewayStatus) -> None:
        known = self._journals.get(told.gateway)
        if known is not None and known.name == told.journal:
            known.head_offset = max(known.head_offset, told.head_offset)
            known.oldest_offset = max(known.oldest_offset, told.oldest_offset)
            return
        if known is not None:
            _log.info("journal.new", gateway=told.gateway, before=known.name, now=told.journal)
        self._journals[told.gateway] = _Journal(name=told.journal, head_offset=told.head_offset, oldest_offset=told.oldest_offset)

    async def _hole(self, gateway: str) -> tuple[int, int] | None:
        journal = self._journals[gateway]
        return await self._records.call(Store.first_hole, gateway=gateway, journal=journal.name, head_offset=journal.head_offset)

    async def _follow(self, gateway: str) -> None:
        """Watch one gateway's journal and fetch what stays missing, until cancelled."""
        backoff_s = _CHECK_PERIOD_S
        before, since = None, time.monotonic()
        while True:
            with suppress(TimeoutError):
                await self._unless_back(gateway, asyncio.sleep(backoff_s))
            backoff_s = _CHECK_PERIOD_S
            hole = await self._hole(gateway)
            missing = (self._journals[gateway].name, hole[0]) if hole else None
            if missing != before:
                before, since = missing, time.monotonic()
            if hole is None or time.monotonic() - since < _GRACE_S:
                continue
            backoff_s = await self._repair(gateway)

    async def _give_up(self, gateway: str, journal: str, first: int, last: int) -> bool:
        """Have the store look for offsets no more; say whether it could write that."""
        return await self._write(self._records.call(Store.give_up, gateway=gateway, journal=journal, first=first, last=last)) is not None

    async def _expire(self, gateway: str) -> tuple[int, int] | None:
        """Count what is missing and no longer in the gateway's journal as expired; return what is missing then."""
        journal = self._journals[gateway]
        name, oldest = journal.name, journal.oldest_offset
        while (hole := await self._hole(gateway)) is not None and hole[0] < oldest:
            first, last = hole[0], min(hole[1], oldest - 1)
            n_before = await self._records.call(Store.watermark, gateway=gateway, journal=name)
            if not await self._give_up(gateway, name, first, last):
                break
            self.counters["expired"] += last - first + 1
            _log.error("history.expired", gateway=gateway, journal=name, first=first, last=last)
            if n_before:  # a store that is new to a journal has missed its beginning, and knows it
                self.losses[gateway, "expired"] = (
                    f"records {first} to {last} of gateway {gateway} left its journal before they were here; "
                    "give its [retention] more days or more room"
                )
        return hole

    async def _unless_back(self, gateway: str, work: Awaitable[_ResultT]) -> _ResultT:
        """Wait for something, but not on when the gateway comes back to the bus: an answer that was under way is lost then.

        Raises
        ------
        TimeoutError
            It has come back.
        """
        async with asyncio.timeout(None) as limit:
            self._waits[gateway] = limit
            try:
                return await work
            finally:
                self._waits.pop(gateway, None)

    async def _repair(self, gateway: str) -> float:
        """Ask for history until nothing is missing, or nothing comes; return how long to wait then."""
        journal = self._journals[gateway].name
        n_asked_in_vain = 0
        wait_s = 1.0
        n_before = self.counters["repaired"]
        while (hole := await self._expire(gateway)) and self._journals[gateway].name == journal:
            if hole[0] < self._journals[gateway].oldest_offset:
                return wait_s  # they have expired, and the store could not write that
            try:
                # One more than what is missing: if that comes and the missing do not, the gateway does not have them.
                asked = self._bus.fetch_history(gateway, from_offset=hole[0], limit=min(_PAGE, hole[1] - hole[0] + 2))
                batches = await self._unless_back(gateway, asked)
            except TimeoutError:
                continue
            except QueryError as error:
                _log.warning("history.fault", gateway=gateway, reason=str(error))
                batches = []
            batches = [batch for batch in batches if batch.journal == journal]
            for batch in batches:
                self._note_head(batch)
            applied = await self._apply(batches)
            self.counters["repaired"] += applied.n_new + applied.n_revised
            if await self._hole(gateway) != hole:
                n_asked_in_vain, wait_s = 0, 1.0
                continue
            n_asked_in_vain += 1
            last = max((record.offset for batch in batches for record in batch.records), default=0)
            # A gateway that has what follows, but not these, will not bring them when it is asked again.
            is_in_vain = last > hole[1] and n_asked_in_vain >= _ASKED_BEFORE_GIVING_UP and self.store_fault is None
            if is_in_vain and await self._give_up(gateway, journal, *hole):
                _log.warning("history.hole", gateway=gateway, journal=journal, first=hole[0], last=hole[1])
                self.counters["given_up"] += hole[1] - hole[0] + 1
                self.losses[gateway, "given_up"] = (
                    f"records {hole[0]} to {hole[1]} of gateway {gateway} cannot be had from its journal; "
                    "`biobot-gateway journal check` says there what is wrong with it"
                )
                n_asked_in_vain = 0
                continue
            if not batches:
                return min(wait_s * n_asked_in_vain, _MAX_BACKOFF_S)
            with suppress(TimeoutError):
                await self._unless_back(gateway, asyncio.sleep(wait_s))
            wait_s = min(2 * wait_s, _MAX_BACKOFF_S)
        if self.counters["repaired"] > n_before:
            _log.info("history.level", gateway=gateway, records=self.counters["repaired"] - n_before)
        return _CHECK_PERIOD_S
