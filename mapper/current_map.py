"""The newest finished map, kept up to date: made again when records have come, never more often than asked for."""

import asyncio
import time
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final

import msgspec

from mapper.changes import Changes, Topic
from mapper.errors import JobError, MapError, NoMapYetError, WorkerDiedError
from mapper.fleet import Fleet
from mapper.log import EventLog
from mapper.map_job import MapDocuments, TooFew, draw_map, make_map
from mapper.render import ImageFormat
from mapper.store import Store
from mapper.store_thread import StoreThread
from mapper.types import Recipe
from mapper.worker import Worker

_log = EventLog(__name__)

_MAX_BACKOFF_S: Final = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSnapshot:
    """One finished map as it is served; it never changes."""

    version: int
    etag: str
    map_json: bytes
    diagram_json: bytes
    drawing: bytes
    n_encounters: int
    computed_wall_ns: int
    computing_s: float


class CurrentMap:
    """Makes maps in a process of its own; readers get the last finished one at once."""

    def __init__(self, *, records: StoreThread, recipe: Recipe, fleet: Fleet, changes: Changes, min_interval_s: float) -> None:
        self.last_fault: str | None = None
        self._records = records
        self._recipe = recipe
        self._fleet = fleet
        self._changes = changes
        self._min_interval_s = min_interval_s
        self._latest: MapSnapshot | None = None
        self.waiting_for: NoMapYetError = NoMapYetError(n_encounters=0, minimum=0, reason="the mapper has just started")
        self.worker = Worker(name="map worker")
        self._artist = Worker(name="picture worker")
        self._pictures: dict[ImageFormat, tuple[int, bytes]] = {}
        self._picture_lock = asyncio.Lock()

    @property
    def latest(self) -> MapSnapshot | None:
        """The last finished map, None before the first."""
        return self._latest

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

    async def picture(self, image_format: ImageFormat) -> tuple[MapSnapshot, bytes]:
        """Return the last finished map and its picture, drawn at the first request.

        Raises
        ------
        NoMapYetError, WorkerDiedError, JobError
            There is no map, or it could not be drawn.
        """
        async with self._picture_lock:
            snapshot = self.require()
            version, picture = self._pictures.get(image_format, (0, b""))
            if version != snapshot.version:
                picture = await self._artist.run(draw_map, snapshot.drawing, image_format)
                self._pictures[image_format] = (snapshot.version, picture)
            return snapshot, picture

    async def run(self) -> None:
        """Make a map whenever records have come, until cancelled."""
        backoff_s = 0.0
        try:
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
        finally:
            await self.worker.aclose()
            await self._artist.aclose()

    async def _make(self) -> None:
        begun = time.monotonic()
        snapshot = await self._records.call(Store.snapshot)
        self._fleet.set_encounter_counts(snapshot.n_encounters_of)
        if self.waiting_for.minimum > 0:
            self.waiting_for = NoMapYetError(n_encounters=len(snapshot.table), minimum=self.waiting_for.minimum)
        outcome = await self.worker.run(make_map, snapshot, self._recipe)
        if isinstance(outcome, TooFew):
            self.waiting_for = NoMapYetError(n_encounters=outcome.n_encounters, minimum=outcome.minimum)
        else:
            self._publish(outcome, computing_s=time.monotonic() - begun)
        if self.last_fault is not None:
            _log.warning("map.fault_over", after=self.last_fault)
            self.last_fault = None
        self._changes.bump(Topic.MAP)

    def _publish(self, documents: MapDocuments, *, computing_s: float) -> None:
        version = self._latest.version + 1 if self._latest else 1
        computed_wall_ns = time.time_ns()
        head = msgspec.json.encode(
            {"version": version, "computed_wall_ns": computed_wall_ns, "computing_s": round(computing_s, 4)},
        )
        map_json, diagram_json = (_join_objects(head, body) for body in (documents.map_json, documents.diagram_json))
        self._latest = MapSnapshot(
            version=version,
            etag=f'"{version}-{blake2b(map_json, digest_size=8).hexdigest()}"',
            map_json=map_json,
            diagram_json=diagram_json,
            drawing=documents.drawing,
            n_encounters=documents.n_encounters,
            computed_wall_ns=computed_wall_ns,
            computing_s=computing_s,
        )
        _log.debug("map.done", version=version, encounters=documents.n_encounters, seconds=round(computing_s, 3))

    def _note_fault(self, error: MapError) -> None:
        if self.last_fault is None:
            _log.error("map.fault", reason=str(error))
        self.last_fault = str(error)
        self.waiting_for = NoMapYetError(n_encounters=self.waiting_for.n_encounters, minimum=self.waiting_for.minimum, reason=str(error))
        self._changes.bump(Topic.MAP)


def _join_objects(first: bytes, second: bytes) -> bytes:
    """Make one JSON object of two that are not empty and have no key in common."""
    return first[:-1] + b"," + second[1:]
