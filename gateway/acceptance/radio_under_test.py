"""A dongle under test: its port held open, all that it says kept for the checks to look at and to wait for.

Payloads are confirmed to the dongle as they come, so that it goes on; to backpacks nothing is acknowledged but what a check names, so
that no record is lost for the gateway that comes later.
"""

import asyncio
import contextlib
import random
import time
from collections import Counter, deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from firmware_protocol.dialects.interface import (
    CoordinatorIdentified,
    CoordinatorSaid,
    Host,
    HostEvent,
    HostLost,
    HostOpened,
    NodeSeen,
    PayloadHeard,
    SendSettled,
)
from firmware_protocol.envelope import RadioReceived
from firmware_protocol.errors import LinkFullError
from firmware_protocol.message_codec import decode_uplink, encode_downlink
from firmware_protocol.messages import Acknowledge, Downlink, MessageFault, Uplink, UplinkHeader
from firmware_protocol.units import BootId, NodeId, ShortAddress
from gateway.errors import TransportError
from gateway.host_session import HostSession
from gateway.transports.interface import Transport

_NS_PER_S = 1_000_000_000
_KEPT = 10_000
_BITMAP_BITS = 32
_MODULUS = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """An uplink message, and when it came [monotonic ns]."""

    header: UplinkHeader
    message: Uplink
    at_ns: int

    @property
    def identity(self) -> tuple[NodeId, BootId, int]:
        """What all copies of a message share."""
        return self.header.node, self.header.boot, self.header.sequence


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """A biobot that was heard."""

    node: NodeId
    boot: BootId
    address: ShortAddress


class RadioUnderTest:
    """See the module.

    Parameters
    ----------
    open_port
        Opens the transport; raises ``TransportError``.
    make_host
        Makes the base station's end of the dialect.
    """

    def __init__(self, *, open_port: Callable[[], Awaitable[Transport]], make_host: Callable[[], Host]) -> None:
        self.nodes: dict[NodeId, Node] = {}
        self.heard: deque[Heard] = deque(maxlen=_KEPT)
        self.identified: CoordinatorIdentified | None = None
        self.said: deque[str] = deque(maxlen=20)
        """What the dongle reported, and how it was lost."""
        self.faults: Counter[str] = Counter()
        self.n_payloads = self.n_lost = 0
        self.transport: Transport | None = None
        self._open_port = open_port
        self._make_host = make_host
        self._session: HostSession | None = None
        self._running: asyncio.Task[None] | None = None
        self._sendings: dict[int, asyncio.Future[int | None]] = {}
        self._pulse = asyncio.Event()
        self._sequence = 0

    @property
    def is_open(self) -> bool:
        """The dongle is open: payloads can be sent."""
        return self._session is not None and self._session.host.is_open

    async def connect(self) -> None:
        """Open the port and begin to open the dongle; ``wait`` for ``is_open``.

        Raises
        ------
        TransportError
            The port cannot be opened.
        """
        self.transport = await self._open_port()
        self._session = HostSession(self.transport, self._make_host(), on_event=self._take)
        self._running = asyncio.ensure_future(self._session.run())

    async def disconnect(self) -> None:
        """Close the port; what was not settled is given up."""
        if self._running is not None:
            self._running.cancel()
            with contextlib.suppress(asyncio.CancelledError, TransportError):
                await self._running
        if self._session is not None:
            self.faults.update({f"line.{name}": count for name, count in self._session.host.faults.items()})
        if self.transport is not None:
            await self.transport.aclose()
        self._give_up()
        self.transport = self._session = self._running = None

    async def wait(self, is_so: Callable[[], bool], *, timeout_s: float) -> bool:
        """Wait until something is so; False where it is not in time, or the port has gone."""
        until_s = time.monotonic() + timeout_s
        while not is_so():
            left_s = until_s - time.monotonic()
            if left_s <= 0 or self._running is None or self._running.done():
                return False
            self._pulse.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(left_s):
                    await self._pulse.wait()
        return True

    async def wait_for_message(self, is_it: Callable[[Heard], bool], *, since_ns: int, timeout_s: float) -> Heard | None:
        """Return the first message that came after ``since_ns`` and is it; None where none comes in time."""

        def find() -> Heard | None:
            return next((one for one in self.heard if one.at_ns >= since_ns and is_it(one)), None)

        await self.wait(lambda: find() is not None, timeout_s=timeout_s)
        return find()

    async def send(self, address: ShortAddress, message: Downlink, *, timeout_s: float) -> int | None:
        """Send a message; returns the radio's status, or None where it is not told in time or nothing can be sent."""
        self._sequence = (self._sequence + 1) % _MODULUS
        return await self.send_payload(address, encode_downlink(self._sequence, message), timeout_s=timeout_s)

    async def send_payload(self, address: ShortAddress, payload: bytes, *, timeout_s: float) -> int | None:
        """Send a radio payload; see ``send``.

        Raises
        ------
        EncodeError
            The payload is too long.
        """
        if self._session is None or not self.is_open:
            return None
        try:
            ticket = self._session.send(destination=address, payload=payload)
        except LinkFullError:
            return None
        future: asyncio.Future[int | None] = asyncio.get_running_loop().create_future()
        self._sendings[ticket] = future
        try:
            async with asyncio.timeout(timeout_s):
                return await future
        except TimeoutError:
            self._session.host.forget(ticket)
            return None
        finally:
            self._sendings.pop(ticket, None)

    def acknowledgement_of(self, *sequences: int, boot: BootId) -> Acknowledge:
        """Return an Acknowledge that covers just these sequence numbers, at most 32 apart.

        It calls done what is more than 32 before the newest of them, and that a backpack takes for done anyway (WIRE_FORMAT.md §5.1).
        """
        newest = max(sequences, key=lambda one: (one - sequences[0] + _MODULUS // 2) % _MODULUS)
        following = (newest - _BITMAP_BITS) % _MODULUS
        bitmap = 0
        for sequence in sequences:
            ahead = (sequence - following) % _MODULUS
            if 1 <= ahead <= _BITMAP_BITS:
                bitmap |= 1 << (ahead - 1)
        return Acknowledge(boot=boot, next_sequence=following, bitmap=bitmap)

    def new_token(self) -> int:
        """Return a number for a request that no other request had of late."""
        return random.randrange(_MODULUS)

    def _take(self, event: HostEvent, now_ns: int) -> None:
        match event:
            case PayloadHeard(received=received, receipt=receipt):
                self._take_payload(received, now_ns)
                assert self._session is not None
                self._session.confirm(receipt)
            case SendSettled(ticket=ticket, status=status):
                future = self._sendings.get(ticket)
                if future is not None and not future.done():
                    future.set_result(status)
            case CoordinatorIdentified():
                self.identified = event
            case CoordinatorSaid(name=name, text=text):
                self.said.append(f"{name} {text}".rstrip())
            case HostLost(why=why, detail=detail):
                self.n_lost += 1
                self.said.append(f"lost: {detail or why.value}")
                self._give_up()
            case HostOpened() | NodeSeen():
                pass
        self._pulse.set()

    def _take_payload(self, received: RadioReceived, now_ns: int) -> None:
        self.n_payloads += 1
        decoded = decode_uplink(received.payload)
        if isinstance(decoded, MessageFault):
            self.faults[f"message.{decoded.value}"] += 1
            return
        header, message = decoded
        self.nodes[header.node] = Node(node=header.node, boot=header.boot, address=received.source)
        self.heard.append(Heard(header=header, message=message, at_ns=now_ns))

    def _give_up(self) -> None:
        for future in self._sendings.values():
            if not future.done():
                future.set_result(None)


def seconds_since(at_ns: int) -> float:
    """Return how long ago a monotonic instant was [s]."""
    return (time.monotonic_ns() - at_ns) / _NS_PER_S
