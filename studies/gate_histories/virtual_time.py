"""True time that passes only when nobody has anything to do, and event loops that live in it.

Whatever waits, waits for an instant of true time; when all wait, time jumps to the first of those instants. A loop's own clock is the
machine's monotonic clock: it counts from the boot of the machine, so it begins anew where true time goes on.
"""

import asyncio
import heapq
import math
import selectors
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from firmware_protocol.units import NS_PER_S

_ResultT = TypeVar("_ResultT")


class TrueTime:
    """The one time [ns] in which all happens, and what is going to happen outside of the event loops."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._n_entries = 0
        self._agenda: list[tuple[int, int, Callable[[], None]]] = []

    def at(self, when_ns: int, act: Callable[[], None]) -> None:
        """Let something happen at an instant; of the same instant, in the order in which it was asked for."""
        self._n_entries += 1
        heapq.heappush(self._agenda, (max(when_ns, self.now_ns), self._n_entries, act))

    def after(self, delay_ns: int, act: Callable[[], None]) -> None:
        """Let something happen after a while."""
        self.at(self.now_ns + delay_ns, act)

    def pass_until(self, limit_ns: int | None) -> None:
        """Let time pass until the next thing happens, and let it happen; at most until ``limit_ns``."""
        next_ns = self._agenda[0][0] if self._agenda else None
        if limit_ns is None and next_ns is None:
            raise RuntimeError("everybody waits, and for nothing: a wait without a deadline")
        if next_ns is None or (limit_ns is not None and limit_ns < next_ns):
            self.now_ns = max(self.now_ns, limit_ns or 0)
            return
        self.now_ns = next_ns
        while self._agenda and self._agenda[0][0] <= self.now_ns:
            heapq.heappop(self._agenda)[2]()


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop in true time; ``boot_ns`` is the instant at which its machine's monotonic clock showed nothing."""

    def __init__(self, true_time: TrueTime, *, boot_ns: int) -> None:
        super().__init__(_Jumping(true_time))
        self._true_time = true_time
        self._boot_ns = boot_ns

    def time(self) -> float:
        """Return the machine's monotonic clock [s]."""
        return (self._true_time.now_ns - self._boot_ns) / NS_PER_S

    def run_in_executor(self, executor: Any, func: Callable[..., _ResultT], *args: Any) -> asyncio.Future[_ResultT]:  # type: ignore[override]  # noqa: ARG002  # the loop's own signature
        """Do it at once: a thread would take real time."""
        done: asyncio.Future[_ResultT] = self.create_future()
        try:
            done.set_result(func(*args))
        except Exception as error:  # noqa: BLE001  # whoever waits for the future gets it
            done.set_exception(error)
        return done

    def run_until(self, when_ns: int) -> None:
        """Let everybody act until an instant of true time."""
        reached = self.create_future()
        self._true_time.at(when_ns, lambda: reached.set_result(None))
        self.run_until_complete(reached)


class _Jumping(selectors.BaseSelector):
    """Waits for no descriptor: lets true time pass instead."""

    def __init__(self, true_time: TrueTime) -> None:
        self._true_time = true_time
        self._keys: dict[int, selectors.SelectorKey] = {}

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        fd = fileobj if isinstance(fileobj, int) else fileobj.fileno()
        key = self._keys[fd] = selectors.SelectorKey(fileobj, fd, events, data)
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return self._keys.pop(fileobj if isinstance(fileobj, int) else fileobj.fileno())

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is None or timeout > 0:
            limit_ns = None if timeout is None else self._true_time.now_ns + math.ceil(timeout * NS_PER_S)
            self._true_time.pass_until(limit_ns)
        return []

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._keys
