"""A serial cable between a device and a pty of its own, which damages what passes when it is told to."""

import os
import random
import select
import threading
import tty
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

_WAIT_S = 0.05


@dataclass(slots=True, kw_only=True)
class TroubledLine:
    """Passes bytes both ways for as long as this context.

    ``damage`` is the share of bytes of which a bit is turned over; it may be changed at any time.
    """

    device: str
    seed: int
    damage: float = 0.0
    port: str = ""
    """Device of the other end."""
    n_damaged: int = 0
    """Bytes from the device that were damaged; those to it are not counted, for only the device sees them."""
    _ends: list[int] = field(default_factory=list)
    _injected: dict[int, bytes] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _is_over: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        near = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(near)
        far, own = os.openpty()
        tty.setraw(own)
        os.set_blocking(far, False)
        self.port = os.ttyname(own)
        self._ends = [near, far, own]  # our own end keeps the pty alive while nobody else has it open
        self._thread = threading.Thread(target=self._pass, name="troubled line")
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._is_over.set()
        if self._thread is not None:
            self._thread.join()
        for end in self._ends:
            os.close(end)

    def inject(self, noise: bytes) -> None:
        """Put noise on the line both ways, between what passes."""
        with self._lock:
            for end in self._ends[:2]:
                self._injected[end] = self._injected.get(end, b"") + noise

    def _pass(self) -> None:
        near, far, _ = self._ends
        rng = random.Random(self.seed)
        waiting = {near: b"", far: b""}
        while not self._is_over.is_set():
            readable, _, _ = select.select([near, far], [], [], _WAIT_S if not any(waiting.values()) else 0.001)
            for source in readable:
                waiting[far if source == near else near] += self._worn(os.read(source, 4096), rng, is_counted=source == near)
            with self._lock:
                injected, self._injected = self._injected, {}
            for target, held in waiting.items():
                data = held + injected.get(target, b"")
                try:
                    waiting[target] = data[os.write(target, data) :] if data else b""
                except BlockingIOError:
                    waiting[target] = data

    def _worn(self, data: bytes, rng: random.Random, *, is_counted: bool) -> bytes:
        damage = self.damage
        if not damage:
            return data
        worn = bytearray(data)
        for at in range(len(worn)):
            if rng.random() < damage:
                worn[at] ^= 1 << rng.randrange(8)
                self.n_damaged += is_counted
        return bytes(worn)
