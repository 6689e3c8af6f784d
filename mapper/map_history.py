"""Maps of the past: every finished one of the last minutes, fewer of the time before, over restarts.

The newest are in memory; the file gets those that will be kept longer, and all that are there when the service stops: a map is some
hundred kilobytes, and flash memory wears.
"""

import asyncio
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final

import msgspec

from mapper.changes import Changes, Topic
from mapper.errors import StoreError
from mapper.log import EventLog
from mapper.map_archive import PastMap, change_past_maps, pack_documents, read_documents, read_past_maps, unpack_documents
from mapper.map_difference import MapDifference, compare_maps
from mapper.map_snapshot import MapSnapshot
from mapper.request_errors import MapNotFoundError
from mapper.store_thread import StoreThread
from mapper.thinning import Rung, choose_kept

_log = EventLog(__name__)

WRITE_PERIOD_S: Final = 30.0
"""The file is written no sooner than this after the time before [s]."""
_MAX_PENDING: Final = 16
"""Maps that wait to be taken in; of more, the oldest are left out."""
_MAX_FRESH_BYTES: Final = 32 * 2**20
"""Of compressed maps that are in memory alone; of more, the oldest go."""


class _Count(msgspec.Struct, frozen=True):
    probability: float


class _Data(msgspec.Struct, frozen=True):
    is_enough: bool


class _Facts(msgspec.Struct, frozen=True):
    betti_numbers: tuple[int, int]
    hole_count: _Count | None
    data: _Data | None


_decoder = msgspec.json.Decoder(_Facts)


class MapHistory:
    """Keeps finished maps, and tells what there is.

    Parameters
    ----------
    ladder
        Which are kept, by age; see `mapper.thinning`.
    max_bytes
        The compressed maps take no more than this [bytes]: the oldest go.
    clock
        Tells the wall clock [ns since 1970].
    """

    def __init__(
        self,
        *,
        records: StoreThread,
        changes: Changes,
        ladder: Sequence[Rung],
        max_bytes: int,
        made_by: str,
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self.fault: str | None = None
        self._records = records
        self._changes = changes
        self._ladder = ladder
        self._max_bytes = max_bytes
        self._made_by = made_by
        self._clock = clock
        self._facts: dict[int, PastMap] = {}
        """By version, ascending."""
        self._fresh: dict[int, bytes] = {}
        """Compressed documents that are not in the store."""
        self._pending: deque[MapSnapshot] = deque(maxlen=_MAX_PENDING)
        self._has_pending = asyncio.Event()
        self._comparing = asyncio.Lock()

    @property
    def newest_version(self) -> int:
        """Number of the newest map that is kept; 0: none."""
        return max((*self._facts, *(snapshot.version for snapshot in self._pending)), default=0)

    def page(self, *, after: int = 0, limit: int | None = None) -> tuple[list[PastMap], bool]:
        """Return the maps with a higher version, the newest last, and whether there are more than the limit."""
        versions = list(self._facts)
        wanted = versions[bisect_right(versions, after) :]
        chosen = wanted if limit is None else wanted[:limit]
        return [self._facts[version] for version in chosen], len(chosen) < len(wanted)

    def facts(self, version: int) -> PastMap:
        """Return what is told of one.

        Raises
        ------
        MapNotFoundError
            It is not kept.
        """
        if version not in self._facts:
            raise MapNotFoundError(version=version, oldest=min(self._facts, default=None), newest=max(self._facts, default=None))
        return self._facts[version]

    async def documents(self, version: int) -> tuple[PastMap, bytes, bytes]:
        """Return the facts of a map, and its map and diagram as JSON.

        Raises
        ------
        MapNotFoundError, StoreError
            It is not kept, or cannot be read.
        """
        facts = self.facts(version)
        packed = self._fresh.get(version)
        if packed is None:
            packed = await self._records.call(read_documents, version)
        if packed is None:
            raise MapNotFoundError(version=version, oldest=min(self._facts, default=None), newest=max(self._facts, default=None))
        return facts, *await asyncio.to_thread(unpack_documents, packed)

    async def difference(self, *, since: int, version: int) -> MapDifference:
        """Say what is different in a map from another one; one is computed at a time.

        Raises
        ------
        MapNotFoundError, StoreError, MapDocumentError
            One of them is not kept, or cannot be read.
        """
        async with self._comparing:
            _, before, _ = await self.documents(since)
            _, after, _ = await self.documents(version)
            return await asyncio.to_thread(compare_maps, before, after)

    async def restore(self) -> bytes | None:
        """Find what was kept before the last end; return the newest map of it as JSON, None where there is none."""
        try:
            found = await self._records.call(read_past_maps)
            self._facts = {facts.version: facts for facts in found}
            return None if not found else (await self.documents(found[-1].version))[1]
        except (StoreError, MapNotFoundError) as error:
            _log.error("history.unreadable", reason=str(error))
            self.fault = str(error)
            return None

    def take(self, snapshot: MapSnapshot) -> None:
        """Take a finished map; it is there for others a moment later."""
        self._pending.append(snapshot)
        self._has_pending.set()

    async def run(self) -> None:
        """Take maps in, and keep the store up to date, until cancelled; then write all that is not there."""
        written = time.monotonic()
        try:
            while True:
                await self._has_pending.wait()
                await self._take_in()
                if time.monotonic() - written >= WRITE_PERIOD_S:
                    await self._write()
                    written = time.monotonic()
        finally:
            await self._take_in()
            await self._write(is_last=True)

    async def _take_in(self) -> None:
        self._has_pending.clear()
        while self._pending:
            snapshot = self._pending[0]
            facts, packed = await asyncio.to_thread(_pack, snapshot, self._made_by)
            self._facts[facts.version], self._fresh[facts.version] = facts, packed
            if self._pending and self._pending[0] is snapshot:
                self._pending.popleft()
        self._forget_fresh()
        self._changes.bump(Topic.MAPS)

    def _forget_fresh(self) -> None:
        """Let go of the oldest that are in memory alone, where they are too many or too old."""
        kept = self._chosen()
        total = sum(map(len, self._fresh.values()))
        for version, packed in list(self._fresh.items())[:-1]:
            if version in kept and total <= _MAX_FRESH_BYTES:
                continue
            total -= len(packed)
            del self._fresh[version], self._facts[version]

    def _chosen(self) -> set[int]:
        walls_ns = [facts.wall_ns for facts in self._facts.values()]
        chosen = choose_kept(walls_ns, now_ns=self._clock(), ladder=self._ladder)
        return {version for version, is_kept in zip(self._facts, chosen, strict=True) if is_kept}

    async def _write(self, *, is_last: bool = False) -> None:
        """Put into the store what will be kept longer, and all at the last; take out what is too old."""
        kept = self._chosen()
        total = 0
        for version in reversed(list(self._facts)):
            total += self._facts[version].n_bytes
            if total > self._max_bytes and version != max(self._facts):
                kept.discard(version)
        finest_s = min((rung.every_s for rung in self._ladder), default=0)
        lasting = set(self._fresh) if is_last else self._firsts(finest_s)
        add = [(self._facts[version], packed) for version, packed in self._fresh.items() if version in kept and version in lasting]
        drop = [version for version in self._facts if version not in kept]
        if add or drop:
            try:
                await self._records.call(change_past_maps, add=add, drop=drop)
            except StoreError as error:
                if self.fault is None:
                    _log.error("history.not_kept", reason=str(error))
                self.fault = str(error)
                return
        self.fault = None
        for facts, _ in add:
            del self._fresh[facts.version]
        for version in drop:
            self._fresh.pop(version, None)
            del self._facts[version]

    def _firsts(self, every_s: int) -> set[int]:
        """Return the first version of each period: what outlives the finest rung."""
        found: dict[int, int] = {}
        for version, facts in self._facts.items():
            found.setdefault(facts.wall_ns // (max(every_s, 1) * 1_000_000_000), version)
        return set(found.values())


def _pack(snapshot: MapSnapshot, made_by: str) -> tuple[PastMap, bytes]:
    told = _decoder.decode(snapshot.map_json)
    packed = pack_documents(snapshot.map_json, snapshot.diagram_json)
    facts = PastMap(
        version=snapshot.version,
        wall_ns=snapshot.finished.computed_wall_ns,
        begun_wall_ns=snapshot.begun_wall_ns,
        made_by=made_by,
        tag=snapshot.map.tag,
        betti_numbers=told.betti_numbers,
        hole_probability=None if told.hole_count is None else told.hole_count.probability,
        is_enough=None if told.data is None else told.data.is_enough,
        n_encounters=snapshot.n_encounters,
        n_bytes=len(packed),
    )
    return facts, packed
