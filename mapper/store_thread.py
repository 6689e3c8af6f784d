"""Run the store on one thread of its own, so that the event loop never waits for a disk."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Concatenate, ParamSpec, Self, TypeVar

from mapper.gateway_clocks import SourceClock
from mapper.store import Store, StoreProgress

_P = ParamSpec("_P")
_T = TypeVar("_T")


class StoreThread:
    """A store and its thread; calls run one after another, in order. Made by `open`."""

    def __init__(self, store: Store, executor: ThreadPoolExecutor) -> None:
        self._store = store
        self._executor = executor
        self.refused_since_ns: int | None = None
        """Since when records that came could not be taken in [ns since 1970]; None while they can."""

    @classmethod
    async def open(cls, path: Path | None) -> Self:
        """Open a store as `Store` does.

        Raises
        ------
        StoreError
            See `Store`.
        """
        executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="store")
        try:
            store = await asyncio.get_running_loop().run_in_executor(executor, Store, path)
        except BaseException:
            executor.shutdown(wait=False)
            raise
        return cls(store, executor)

    @property
    def name(self) -> str | None:
        """See `Store.name`."""
        return self._store.name

    @property
    def progress(self) -> StoreProgress:
        """How far the store has come; no waiting."""
        return self._store.progress

    @property
    def arrived_ns(self) -> int:
        """When an encounter last arrived that was new [monotonic]; none yet: when the store was opened; no waiting."""
        return self._store.arrived_ns

    @property
    def clocks(self) -> tuple[SourceClock, ...]:
        """How the gateways' clocks stood when the last map was begun; no waiting."""
        return self._store.clocks

    async def call(self, method: Callable[Concatenate[Store, _P], _T], *args: _P.args, **kwargs: _P.kwargs) -> _T:
        """Call a method of the store there: ``await records.call(Store.missions)``."""
        return await asyncio.get_running_loop().run_in_executor(self._executor, lambda: method(self._store, *args, **kwargs))

    async def aclose(self) -> None:
        """Finish what was asked for, then close the file."""
        await self.call(Store.close)
        self._executor.shutdown()
