"""A radio's share of the event loop: what one radio floods the gateway with costs the others little time.

Bytes are handed on in pieces that are worked off within ``_ROUND_NS`` divided by the number of radios, and where more is likely to follow,
all others get a turn first: a round of all radios is short, however much each has to say. Two limits hold over longer times:

- *bytes a second*, above what any serial line carries: only a TCP port that floods meets it, and may then say a fifth until it is quiet;
- *processor time*, only while radios keep the loop busy: then each gets the same share, and what needs more waits at its own end of its
  line.

A radio that says too much floods; that is told when it begins and when it is over. Waiting for processor time is counted, no more: a
gateway that has as much to do as it can is not ill.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from math import exp

from firmware_protocol.units import NS_PER_MS, NS_PER_S
from gateway.health import Health
from gateway.log import EventLog
from gateway.transports.interface import Transport

_log = EventLog(__name__)

_ROUND_NS = 8 * NS_PER_MS
_MIN_PIECE = 256
"""Bytes: about one frame."""
_MANY = 1024
"""Bytes: what as much comes with is likely to be followed at once by more."""
_FIRST_COST_NS = 1_000.0
"""What a byte is taken to cost before it was measured; a message of some 30 bytes costs 10 to 50 us."""
_WEIGHT = 0.1
_MEASURED_EACH = 512
"""Bytes after which a piece is measured again: reading the processor's time costs some microseconds, which is much for a frame."""
_BUSY = 0.9
"""Share of the loop's time that radios may take together before each is held to its own share."""
_LOAD_NS = 100 * NS_PER_MS
_TIME_BURST_NS = 50 * NS_PER_MS
_LONGEST_PAUSE_S = 0.1
_OVER_S = 5.0
_BURST_S = 0.25
"""So much of what it may say in a second it may say at once."""
_FLOODING = 0.2
"""Of the bytes a second, what a radio may say while it floods: what says more than any line carries is ill, and the rest is not missed."""

OnFlood = Callable[[str, str, str], None]
"""Is told a radio's name, ``BEGUN`` or ``OVER``, and the circumstances."""

BEGUN, OVER = "radio.flood", "radio.flood_over"


class LoopLoad:
    """How busy all radios together keep the event loop: processor time as a share of all time, averaged over some 100 ms."""

    def __init__(self, *, n_radios: int) -> None:
        self.n_radios = max(1, n_radios)
        self._spent_ns = 0.0
        self._at_ns = 0

    def spend(self, duration_ns: int, *, now_ns: int) -> None:
        """Take note of time that a radio's bytes took."""
        self._spent_ns = self._spent_ns * exp((self._at_ns - now_ns) / _LOAD_NS) + duration_ns
        self._at_ns = now_ns

    def is_busy(self, *, now_ns: int) -> bool:
        """Return whether little is left for others."""
        self.spend(0, now_ns=now_ns)
        return self._spent_ns > _BUSY * _LOAD_NS


class FairShare:
    """One radio's share, over all the times that its port is opened.

    Parameters
    ----------
    max_bytes_per_s
        What it may say at most, on average.
    over_s
        A flood is over when it has not had to wait for so long [s].
    """

    def __init__(
        self,
        *,
        radio: str,
        load: LoopLoad,
        max_bytes_per_s: float,
        health: Health,
        on_flood: OnFlood | None = None,
        over_s: float = _OVER_S,
    ) -> None:
        self._over_s = over_s
        self._radio = radio
        self._load = load
        self._max_bytes_per_s = max_bytes_per_s
        self._health = health
        self._on_flood = on_flood
        self._cost_ns = _FIRST_COST_NS
        self._bytes_left = _BURST_S * max_bytes_per_s
        self._time_left_ns = float(_TIME_BURST_NS)
        self._filled_ns = time.monotonic_ns()
        self._n_bytes = 0
        self._waited_ns = 0
        self._began_ns: int | None = None

    def opening(self, open_port: Callable[[], Awaitable[Transport]]) -> Callable[[], Awaitable[Transport]]:
        """Return what opens the port and gives it this share."""

        async def open_shared() -> Transport:
            return _SharedTransport(await open_port(), share=self)

        return open_shared

    @property
    def piece(self) -> int:
        """How many bytes may be worked off at once."""
        return max(_MIN_PIECE, int(_ROUND_NS / self._load.n_radios / self._cost_ns))

    def charge(self, n_bytes: int, *, duration_ns: int | None, now_ns: int) -> None:
        """Take note of how long a piece took; None: it was not measured, and is taken to have cost what others did."""
        if duration_ns is None:
            duration_ns = int(n_bytes * self._cost_ns)
        else:
            self._cost_ns += _WEIGHT * (duration_ns / n_bytes - self._cost_ns)
        self._load.spend(duration_ns, now_ns=now_ns)
        self._time_left_ns -= duration_ns

    async def admit(self, n_bytes: int) -> None:
        """Return when the next piece may be handed on."""
        now_ns = time.monotonic_ns()
        passed_ns, self._filled_ns = now_ns - self._filled_ns, now_ns
        share = _BUSY / self._load.n_radios
        self._time_left_ns = min(self._time_left_ns + share * passed_ns, _TIME_BURST_NS)
        rate = self._max_bytes_per_s * (1.0 if self._began_ns is None else _FLOODING)
        self._bytes_left = min(self._bytes_left + rate * passed_ns / NS_PER_S, _BURST_S * self._max_bytes_per_s) - n_bytes
        self._n_bytes += n_bytes
        pause_s = max(0.0, -self._bytes_left / rate)
        if pause_s > 0:
            self._take_note(now_ns)
        if not self._load.is_busy(now_ns=now_ns):
            self._time_left_ns = max(self._time_left_ns, 0.0)  # time that nobody wanted is no debt
        elif self._time_left_ns < 0:
            self._health.count("radio.share_waits")
            pause_s = max(pause_s, -self._time_left_ns / share / NS_PER_S)
        if pause_s > 0:
            await asyncio.sleep(min(pause_s, _LONGEST_PAUSE_S))

    def _take_note(self, now_ns: int) -> None:
        self._health.count("radio.flood_waits")
        self._waited_ns = now_ns
        if self._began_ns is None:
            self._began_ns, self._n_bytes = now_ns, 0
            self._health.count("radio.floods")
            _log.warning(BEGUN, radio=self._radio, max_bytes_per_s=int(self._max_bytes_per_s))
            if self._on_flood is not None:
                self._on_flood(self._radio, BEGUN, "it says more than its share, and is read more slowly")
            asyncio.get_running_loop().call_later(self._over_s, self._look)

    def _look(self) -> None:
        """See whether a flood is over."""
        assert self._began_ns is not None
        now_ns = time.monotonic_ns()
        left_s = self._over_s - (now_ns - self._waited_ns) / NS_PER_S
        if left_s > 0:
            asyncio.get_running_loop().call_later(left_s, self._look)
            return
        lasted_s = round((self._waited_ns - self._began_ns) / NS_PER_S, 1)
        self._began_ns = None
        _log.info(OVER, radio=self._radio, lasted_s=lasted_s, bytes=self._n_bytes)
        if self._on_flood is not None:
            self._on_flood(self._radio, OVER, f"it lasted {lasted_s:g} s")


class _SharedTransport:
    """A transport that hands on what comes in pieces; see the module."""

    def __init__(self, transport: Transport, *, share: FairShare) -> None:
        self._transport = transport
        self._share = share
        self._rest = b""
        self._n_came = 0
        self._n_handed = 0
        self._handed_ns: int | None = None
        self._n_unmeasured = 0

    @property
    def name(self) -> str:
        """What the port is called."""
        return self._transport.name

    async def read(self) -> bytes:
        """Return the next bytes; see ``Transport``. What passes until the next call is what they took to be worked off."""
        if self._n_handed:
            took_ns = None if self._handed_ns is None else time.thread_time_ns() - self._handed_ns
            self._share.charge(self._n_handed, duration_ns=took_ns, now_ns=time.monotonic_ns())
            self._n_handed = 0
        if self._rest or self._n_came >= _MANY:
            await asyncio.sleep(0)  # a transport with much in its buffer returns at once, and would let nobody else have a turn
        if not self._rest:
            self._rest = await self._transport.read()
            self._n_came = len(self._rest)
        size = self._share.piece
        piece, self._rest = self._rest[:size], self._rest[size:]
        await self._share.admit(len(piece))
        self._n_handed, self._handed_ns = len(piece), None
        self._n_unmeasured += len(piece)
        if self._n_unmeasured >= _MEASURED_EACH:
            self._n_unmeasured, self._handed_ns = 0, time.thread_time_ns()
        return piece

    async def write(self, data: bytes) -> None:
        """Send all of ``data``; see ``Transport``."""
        await self._transport.write(data)

    def write_at_once(self, data: bytes) -> bytes:
        """Send what goes without waiting; see ``Transport``."""
        return self._transport.write_at_once(data)

    async def aclose(self) -> None:
        """Close; closing twice is no fault."""
        await self._transport.aclose()
