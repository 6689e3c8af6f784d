"""Pictures, GeoJSON, routes and frames of the last finished map, made in a process of their own when they are first asked for."""

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from mapper.artist_jobs import NoRoutes, PictureKind, draw_picture, find_map_routes, frame_drawing, measure_map_distance, write_geojson
from mapper.errors import PlaceError, RouteError, TooManyError
from mapper.map_snapshot import MapSnapshot
from mapper.named_pins import Framing, NamedPin
from mapper.render import ImageFormat
from mapper.served_bytes import ServedBytes
from mapper.worker import Worker

MAX_SEARCHES: Final = 8
"""So many may wait for routes and distances at a time."""


class MapArtist:
    """Draws and searches maps; what it made of the last one is kept.

    Parameters
    ----------
    require
        Returns the last finished map, or raises ``NoMapYetError``.
    """

    def __init__(self, require: Callable[[], MapSnapshot]) -> None:
        self._require = require
        self._worker = Worker(name="picture worker")
        # By what was made; its tag is the map's, which a change of pins changes too.
        self._made: dict[str, ServedBytes] = {}
        self._lock = asyncio.Lock()
        self._n_searches = 0

    async def picture(self, kind: PictureKind, image_format: ImageFormat) -> tuple[MapSnapshot, ServedBytes]:
        """Return the last finished map and a picture of it, drawn at the first request.

        Raises
        ------
        NoMapYetError, WorkerDiedError, JobError
            There is no map, or it could not be drawn.
        """
        return await self._make(
            f"{kind}.{image_format}",
            lambda snapshot: self._worker.run(draw_picture, snapshot.drawing, kind, image_format, pins=snapshot.pins),
        )

    async def geojson(self) -> tuple[MapSnapshot, ServedBytes]:
        """Return the last finished map and its GeoJSON, written at the first request; raises what `picture` raises."""
        return await self._make("geojson", lambda snapshot: self._worker.run(write_geojson, snapshot.drawing, pins=snapshot.pins))

    async def routes(self, begin: str, end: str, *, classes: int) -> tuple[MapSnapshot, bytes]:
        """Return the last finished map, and routes on it between two places as JSON.

        Raises
        ------
        PlaceError, RouteError
            The map does not show a place, or no way between them.
        TooManyError
            Others wait for routes already.
        NoMapYetError, WorkerDiedError, JobError
            There is no map, or it could not be searched.
        """
        snapshot = self._require()
        with self._search():
            found = await self._worker.run(find_map_routes, snapshot.drawing, begin, end, classes=classes)
        return snapshot, _take_answer(found, begin=begin, end=end)

    async def distance(self, begin: str, end: str) -> tuple[MapSnapshot, bytes]:
        """Return the last finished map, and how far it is on it from one place to another as JSON; raises what `routes` raises."""
        snapshot = self._require()
        with self._search():
            found = await self._worker.run(measure_map_distance, snapshot.drawing, begin, end, pins=snapshot.pins)
        return snapshot, _take_answer(found, begin=begin, end=end)

    async def frame(self, snapshot: MapSnapshot, pins: Sequence[NamedPin]) -> Framing:
        """Find pins on a map, and where they put it; raises what `picture` raises."""
        return await self._worker.run(frame_drawing, snapshot.drawing, pins=tuple(pins))

    async def aclose(self) -> None:
        """End the process, whatever it does."""
        await self._worker.aclose()

    async def _make(self, name: str, make: Callable[[MapSnapshot], Awaitable[bytes]]) -> tuple[MapSnapshot, ServedBytes]:
        async with self._lock:
            snapshot = self._require()
            made = self._made.get(name)
            if made is None or made.tag != snapshot.map.tag:
                made = self._made[name] = ServedBytes(await make(snapshot), tag=snapshot.map.tag)
            return snapshot, made

    @contextmanager
    def _search(self) -> Iterator[None]:
        if self._n_searches >= MAX_SEARCHES:
            raise TooManyError(what="searches for routes", limit=MAX_SEARCHES)
        self._n_searches += 1
        try:
            yield
        finally:
            self._n_searches -= 1


def _take_answer(found: bytes | NoRoutes, *, begin: str, end: str) -> bytes:
    if isinstance(found, bytes):
        return found
    if found.place is not None:
        raise PlaceError(place=found.place, problem=found.problem, next_step=found.next_step)
    raise RouteError(begin=begin, end=end, problem=found.problem, next_step=found.next_step)
