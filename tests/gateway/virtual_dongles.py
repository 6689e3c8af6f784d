"""Virtual dongles of every dialect on loopback TCP ports and pseudo-terminals, with payloads to hand over, for tests of tools."""

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from firmware_protocol.envelope import RadioReceived
from firmware_protocol.message_codec import encode_uplink
from firmware_protocol.messages import EncounterBatch, EncounterEntry, Status, Uplink, UplinkHeader, WireCause, WireMode
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm, ShortAddress
from simulator.dongles.choice import make_dongle
from simulator.dongles.interface import Dongle
from simulator.lines.line import SerialEnd
from simulator.lines.tcp_port import TcpEnd
from simulator.lines.virtual_serial import PtyEnd

_EUI64 = 0x00124B0000001000


def some_payloads(n: int) -> list[bytes]:
    """Uplink payloads of one biobot, each another message."""
    messages: list[Uplink] = [
        Status(mode=WireMode.CRW, cause=WireCause.NATURAL, mode_since_ms=Milliseconds(1), battery_mv=3000, buffered=0, dropped=0),
        EncounterBatch(
            entries=(
                EncounterEntry(
                    peer=NodeId(9), start_ms=Milliseconds(5), duration_ms=Milliseconds(700), rssi_dbm=RssiDbm(-60), is_ongoing=False
                ),
            )
        ),
    ]
    return [
        encode_uplink(
            UplinkHeader(node=NodeId(7), boot=BootId(3), sequence=sequence, sent_ms=Milliseconds(1000 + sequence)),
            messages[sequence % len(messages)],
        )
        for sequence in range(n)
    ]


def hand_over(dongle: Dongle, payload: bytes) -> bool:
    """Let a dongle hear a payload from the air."""
    received = RadioReceived(source=ShortAddress(0x1007), rssi_dbm=RssiDbm(-61), lqi=190, payload=payload)
    return dongle.take_from_radio(received, eui64=_EUI64, now_ns=time.monotonic_ns())


@asynccontextmanager
async def dongle_on_tcp(dialect: str, *, payloads: Sequence[bytes] = ()) -> AsyncIterator[tuple[Dongle, str]]:
    """Serve a virtual dongle on a TCP port; yields it and the port's specification. It hears the payloads as soon as it is open."""
    line = await TcpEnd.listen("127.0.0.1", 0)
    async with _served(dialect, line, payloads) as dongle:
        yield dongle, f"{line.address}?dialect={dialect}"


@asynccontextmanager
async def dongle_on_pty(dialect: str, path: Path, *, payloads: Sequence[bytes] = ()) -> AsyncIterator[Dongle]:
    """Serve a virtual dongle on a pseudo-terminal."""
    async with _served(dialect, PtyEnd(path), payloads) as dongle:
        yield dongle


@asynccontextmanager
async def _served(dialect: str, line: SerialEnd, payloads: Sequence[bytes]) -> AsyncIterator[Dongle]:
    dongle = make_dongle(dialect, index=0)
    dongle.start(now_ns=time.monotonic_ns())
    pumping = asyncio.ensure_future(_pump(dongle, line, deque(payloads)))
    try:
        yield dongle
    finally:
        pumping.cancel()
        await asyncio.gather(pumping, return_exceptions=True)
        await line.aclose()


async def _pump(dongle: Dongle, line: SerialEnd, payloads: deque[bytes]) -> None:
    reading = asyncio.ensure_future(line.read())
    try:
        while True:
            while payloads and dongle.is_open and hand_over(dongle, payloads[0]):
                payloads.popleft()
            if data := dongle.take_bytes():
                await line.write(data)
            await asyncio.wait({reading}, timeout=0.01)
            now_ns = time.monotonic_ns()
            if reading.done():
                dongle.feed(reading.result(), now_ns=now_ns)
                reading = asyncio.ensure_future(line.read())
            due_ns = dongle.next_deadline_ns()
            if due_ns is not None and now_ns >= due_ns:
                dongle.handle_deadline(now_ns=now_ns)
    finally:
        reading.cancel()
