"""Tells each gateway how far this mapper has all of its records on disk, so that it may drop them (CONTRACT.md §3)."""

import asyncio
from typing import Final

from mapper.bus import Bus
from mapper.errors import StoreError
from mapper.log import EventLog
from mapper.store import Store
from mapper.store_thread import StoreThread

_log = EventLog(__name__)

_PERIOD_S: Final = 3.0


class Watermarks:
    """Publishes what the store has, under a name that is this mapper's alone; ``run`` is its task.

    A store in memory has nothing: it tells nobody.
    """

    def __init__(self, *, bus: Bus, records: StoreThread, name: str, period_s: float = _PERIOD_S) -> None:
        self._bus = bus
        self._records = records
        self._name = name
        self._period_s = period_s

    async def run(self) -> None:
        """Be alive under the name of this mapper, and tell every few seconds, until cancelled.

        Raises
        ------
        BusError
            Another mapper is alive under that name.
        """
        await self._bus.claim(self._name)
        is_faulty = False
        while True:
            await asyncio.sleep(self._period_s)
            try:
                marks = await self._records.call(Store.durable_watermarks)
            except StoreError as error:
                if not is_faulty:
                    _log.warning("watermarks.fault", reason=str(error))
                is_faulty = True
                continue
            is_faulty = False
            for (gateway, journal), offset in marks.items():
                await self._bus.publish_watermark(gateway=gateway, journal=journal, mapper=self._name, offset=offset)
