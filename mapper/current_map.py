"""The newest finished map, kept up to date: made again when records have come, never more often than asked for, kept over a restart."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil
from typing import Final

from mapper.changes import Changes, Topic
from mapper.clock_watch import ClockWatch, clock_shifts
from mapper.errors import JobError, MapError, NoMapYetError, StoreError, WorkerDiedError
from mapper.fleet import Fleet
from mapper.log import EventLog
from mapper.map_artist import MapArtist
from mapper.map_history import MapHistory
from mapper.map_job import MapDocuments, OutOfStep, TooFew, make_map
from mapper.map_snapshot import FinishedMap, MapSnapshot, fingerprint, pack, unpack
from mapper.pin_board import PinBoard
from mapper.served_bytes import ServedBytes
from mapper.store import KeptMap, Store
from mapper.store_thread import StoreThread
from mapper.types import Recipe
from mapper.worker import Worker

_log = EventLog(__name__)

_MAX_BACKOFF_S: Final = 30.0
# A map is told to be slow after this, if it also takes so many times as long as the last.
_SLOW_S: Final = 30.0
_SLOW_TIMES: Final = 10.0
# A map is some hundred kilobytes: flash memory wears.
KEEP_PERIOD_S: Final = 30.0
"""A finished map is kept in the store no sooner than this after the one before [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapStatus:
    """How the newest finished map stands to the records that have come.

    ``n_waiting`` records, each revision counted as one, have come since it was begun, ``behind_s`` ago (0 where nothing waits): no record
    that it lacks came earlier. Where later records left too few encounters for another map, both count from those, and ``waiting`` says
    why there is no newer map; before the first it says what that waits for. ``is_computing``: another one is being made.
    """

    snapshot: MapSnapshot | None
    n_known: int
    n_waiting: int
    behind_s: float
    is_computing: bool
    waiting: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Standstill:
    """Up to ``change``, taken from the store at ``begun_wall_ns``, there are too few encounters for a map newer than the last."""

    change: int
    begun_wall_ns: int
    reason: str


class CurrentMap:
    """Makes maps in a process of its own; readers get the last finished one at once.

    Parameters
    ----------
    window_ns
        Only encounters not over so long before the end of the newest one count; None: no limit.
    min_interval_s
        A map is begun no earlier than this after the one before was begun.
    clock
        Tells the wall clock [ns since 1970].
    """

    def __init__(
        self,
        *,
        records: StoreThread,
        recipe: Recipe,
        fleet: Fleet,
        changes: Changes,
        pins: PinBoard,
        history: MapHistory,
        min_interval_s: float,
        window_ns: int | None = None,
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self.last_fault: str | None = None
        self.keeping_fault: str | None = None
        self.dating_fault: str | None = None
        self.framing_fault: str | None = None
        self._clock = clock
        self._clock_watch = ClockWatch()
        self._records = records
        self._recipe = recipe
        self._window_ns = window_ns
        self._made_by = fingerprint(recipe, window_ns=window_ns)
        self._fleet = fleet
        self._changes = changes
        self._pins = pins
        self._framing = asyncio.Lock()
        self._min_interval_s = min_interval_s
        self._history = history
        self._before: bytes | None = None
        self._latest: MapSnapshot | None = None
        self._coverage: ServedBytes | None = None
        self._standstill: _Standstill | None = None
        self.waiting_for: NoMapYetError = NoMapYetError(n_encounters=0, minimum=0, reason="the mapper has just started")
        self.worker = Worker(name="map worker")
        # Up to which change the worker has been sent everything; 0: nothing.
        self._n_sent = 0
        # On the monotonic clock; None while no map is computed.
        self._computing_since: float | None = None
        # Maps made after the kept one was kept had numbers that may not come again.
        self._n_skipped = 0
        self._unkept = asyncio.Event()
        self.artist = MapArtist(self.require)

    @property
    def latest(self) -> MapSnapshot | None:
        """The last finished map, None before the first."""
        return self._latest

    @property
    def _newest_version(self) -> int:
        return max(self._history.newest_version, 0 if self._latest is None else self._latest.version)

    @property
    def status(self) -> MapStatus:
        """How the last finished map stands to the records that have come, right now."""
        latest, standstill, progress = self._latest, self._standstill, self._records.progress
        n_waiting, behind_s = (progress.change, 0.0) if latest is None else self.lag_of(latest)
        waiting = None if standstill is None else f"no newer map: {standstill.reason}"
        return MapStatus(
            snapshot=latest,
            n_known=progress.n_encounters,
            n_waiting=n_waiting,
            behind_s=behind_s,
            is_computing=self._computing_since is not None,
            waiting=str(self.waiting_for) if latest is None else waiting,
        )

    def lag_of(self, snapshot: MapSnapshot) -> tuple[int, float]:
        """Return how many records wait for a map after this one, and for how long at most [s], right now, as in `MapStatus`."""
        counted = self._standstill if self._standstill is not None and snapshot is self._latest else snapshot
        n_waiting = self._records.progress.change - counted.change
        refused_since_ns = self._records.refused_since_ns
        since_ns = [counted.begun_wall_ns] if n_waiting else []
        # What the store could not take in cannot be counted, but it waits.
        since_ns += [refused_since_ns] if refused_since_ns is not None else []
        return n_waiting, max(0.0, (self._clock() - min(since_ns)) / 1e9) if since_ns else 0.0

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong with the making, keeping and dating of maps, and with the gateways' clocks."""
        own = (self.last_fault, self.keeping_fault, self.dating_fault, self.framing_fault, self._slowness())
        return (*(fault for fault in own if fault is not None), *self._clock_watch.faults)

    def _slowness(self) -> str | None:
        """Say that a map takes far longer than the one before; a process that is stopped gives no other sign."""
        if self._computing_since is None:
            return None
        taken_s = time.monotonic() - self._computing_since
        usual_s = self._latest.finished.computing_s if self._latest is not None else 0.0
        if taken_s < max(_SLOW_S, _SLOW_TIMES * usual_s):
            return None
        return (
            f"the map has been computed for {taken_s:.0f} s, the last one took {usual_s:.1f} s; see whether process {self.worker.pid} runs"
        )

    def require(self) -> MapSnapshot:
        """Return the last finished map.

        Raises
        ------
        NoMapYetError
            There is none; the error says what is awaited.
        """
        if self._latest is None:
            raise self.waiting_for
        return self._latest

    def require_coverage(self) -> ServedBytes:
        """Return how well the encounters cover the place, as JSON; also where they are too few for a map.

        Raises
        ------
        NoMapYetError
            They have not been looked at yet.
        """
        if self._coverage is None:
            raise self.waiting_for
        return self._coverage

    async def frame_again(self) -> None:
        """Put the last finished map into the frame of the pins that there are now; where it cannot be, the fault is told.

        The map keeps its version and has another ETag.
        """
        async with self._framing:
            while (latest := self._latest) is not None and latest.pins != self._pins.pins:
                try:
                    framing = await self.artist.frame(latest, self._pins.pins)
                except (WorkerDiedError, JobError) as error:
                    self.framing_fault = str(error)
                    return
                if latest is self._latest:
                    self._latest = latest.framed(framing)
                    self._unkept.set()
                    self._changes.bump(Topic.MAP)
            self.framing_fault = None

    async def restore(self) -> None:
        """Serve the map that was kept before the last end, if this recipe and program made it and it can be read."""
        self._look_at_clocks()
        self._before = await self._history.restore()
        self._n_skipped = ceil(KEEP_PERIOD_S / self._min_interval_s) if self._history.newest_version else 0
        try:
            kept = await self._records.call(Store.kept_map, made_by=self._made_by)
        except StoreError as error:
            _log.error("map.kept_unreadable", reason=str(error))
            self.keeping_fault = str(error)
            return
        finished = None if kept is None else unpack(kept.document)
        if kept is None or kept.change > self._records.progress.change:
            return
        if finished is None:
            _log.warning("map.kept_unreadable", change=kept.change)
            return
        self._latest = MapSnapshot.of(finished, change=kept.change)
        self._coverage = self._latest.coverage
        self._n_skipped = ceil(KEEP_PERIOD_S / self._min_interval_s)
        self._note_dates(finished.documents.n_ahead)
        self._changes.bump(Topic.MAP)
        _log.info("map.restored", version=finished.version, encounters=finished.documents.n_encounters)

    async def run(self) -> None:
        """Make a map whenever records have come, until cancelled."""
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._keep_maps(), name="keep maps")
                group.create_task(self.frame_again(), name="frame the kept map")
                await self._make_maps()
        finally:
            await self.worker.aclose()
            await self.artist.aclose()
            await self._keep()

    async def _make_maps(self) -> None:
        backoff_s = 0.0
        seen = {Topic.RECORDS: self._changes.versions[Topic.RECORDS]}
        if self._latest is not None and self._latest.change == self._records.progress.change:
            self._fleet.set_encounter_counts(await self._records.call(Store.count_by_node))
            await self._changes.wait(seen=seen)
        while True:
            seen = {Topic.RECORDS: self._changes.versions[Topic.RECORDS]}
            begun = time.monotonic()
            try:
                await self._make()
            except (WorkerDiedError, JobError) as error:
                backoff_s = min(max(1.0, 2 * backoff_s), _MAX_BACKOFF_S)
                self._note_fault(error)
                await asyncio.sleep(backoff_s)
                continue
            backoff_s = 0.0
            await self._changes.wait(seen=seen)
            await asyncio.sleep(max(0.0, self._min_interval_s - (time.monotonic() - begun)))

    async def _make(self) -> None:
        begun, begun_wall_ns = time.monotonic(), self._clock()
        if self.waiting_for.minimum > 0:
            self.waiting_for = NoMapYetError(n_encounters=self._records.progress.n_encounters, minimum=self.waiting_for.minimum)
        self._computing_since = begun
        try:
            outcome, change = await self._compute(after=self._n_sent)
            if isinstance(outcome, OutOfStep):
                outcome, change = await self._compute(after=0)
        finally:
            self._computing_since = None
        if isinstance(outcome, TooFew):
            self.waiting_for = NoMapYetError(n_encounters=outcome.n_encounters, minimum=outcome.minimum, where=outcome.where)
            self._coverage = ServedBytes.of(outcome.coverage_json)
            self._note_dates(outcome.n_ahead)
            self._stand_still(change=change, begun_wall_ns=begun_wall_ns)
        elif isinstance(outcome, MapDocuments):
            self._note_dates(outcome.n_ahead)
            self._publish(outcome, change=change, begun_wall_ns=begun_wall_ns, computing_s=time.monotonic() - begun)
        if self.last_fault is not None:
            _log.warning("map.fault_over", after=self.last_fault)
            self.last_fault = None
        await self.frame_again()  # pins may have come while it was computed
        self._changes.bump(Topic.MAP)

    async def _compute(self, *, after: int) -> tuple[MapDocuments | TooFew | OutOfStep, int]:
        delta, n_encounters_of = await self._records.call(lambda store: (store.delta(after=after), store.count_by_node()))
        self._fleet.set_encounter_counts(n_encounters_of)
        self._look_at_clocks()
        # Whatever ends this job early ends the worker's copy with it, or leaves it in doubt: the next one gets everything.
        self._n_sent = 0
        previous = self._before if self._latest is None else self._latest.map_json
        outcome = await self.worker.run(
            make_map, delta, self._recipe, window_ns=self._window_ns, now_ns=self._clock(), pins=self._pins.pins, previous=previous
        )
        self._n_sent = delta.change
        return outcome, delta.change

    def _look_at_clocks(self) -> None:
        self._clock_watch.look(self._records.clocks)
        self._fleet.set_clock_shifts(clock_shifts(self._records.clocks))

    def _publish(self, documents: MapDocuments, *, change: int, begun_wall_ns: int, computing_s: float) -> None:
        finished = FinishedMap(
            version=self._newest_version + 1 + self._n_skipped,
            begun_wall_ns=begun_wall_ns,
            computed_wall_ns=self._clock(),
            computing_s=round(computing_s, 4),
            documents=documents,
        )
        self._latest = MapSnapshot.of(finished, change=change)
        self._coverage = self._latest.coverage
        self._history.take(self._latest)
        self._n_skipped = 0
        if self._standstill is not None:
            _log.info("map.goes_on", after=self._standstill.reason)
            self._standstill = None
        self._unkept.set()
        _log.debug("map.done", version=finished.version, encounters=documents.n_encounters, seconds=finished.computing_s)

    def _stand_still(self, *, change: int, begun_wall_ns: int) -> None:
        """Note that the last map, if there is one, stays the last for want of encounters."""
        if self._latest is None:
            return
        if self._standstill is None:
            _log.warning("map.stands_still", version=self._latest.version, reason=str(self.waiting_for))
        self._standstill = _Standstill(change=change, begun_wall_ns=begun_wall_ns, reason=str(self.waiting_for))

    def _note_dates(self, n_ahead: int) -> None:
        before = self.dating_fault
        self.dating_fault = (
            f"encounters dated ahead of this machine's clock: {n_ahead}; set the clocks of all machines" if n_ahead else None
        )
        if before is None and n_ahead:
            _log.error("map.dated_ahead", encounters=n_ahead)
        elif before is not None and not n_ahead:
            _log.warning("map.dated_ahead_over", after=before)

    async def _keep_maps(self) -> None:
        while True:
            await self._unkept.wait()
            await self._keep()
            await asyncio.sleep(KEEP_PERIOD_S)

    async def _keep(self) -> None:
        """Keep the last finished map in the store, unless it is there."""
        latest = self._latest
        if latest is None or not self._unkept.is_set():
            return
        self._unkept.clear()

        def keep(store: Store) -> None:
            store.keep_map(KeptMap(made_by=self._made_by, change=latest.change, document=pack(latest.finished)))

        try:
            await self._records.call(keep)
        except StoreError as error:
            if self.keeping_fault is None:
                _log.error("map.not_kept", reason=str(error))
            self.keeping_fault = str(error)
            self._unkept.set()
        else:
            self.keeping_fault = None

    def _note_fault(self, error: MapError) -> None:
        if self.last_fault is None:
            _log.error("map.fault", reason=str(error))
        self.last_fault = str(error)
        self.waiting_for = NoMapYetError(n_encounters=self.waiting_for.n_encounters, minimum=self.waiting_for.minimum, reason=str(error))
        self._changes.bump(Topic.MAP)
