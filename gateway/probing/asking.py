"""Asks a dongle of a known family who it is, over an open port."""

import asyncio
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from firmware_protocol.dialects.choice import make_host
from firmware_protocol.dialects.interface import CoordinatorIdentified, HostEvent, PayloadHeard
from gateway.host_session import HostSession, run_until
from gateway.probing.recognition import mt_bodies, mt_request, xbee_answers, xbee_query
from gateway.transports.interface import Transport

_XBEE_QUERIES = ("AP", "VR", "HV", "SH", "SL", "AI", "OI", "CH")
_XBEE_MODES = {0: "transparent", 1: "API mode 1", 2: "API mode 2"}
_ZNP_VERSION, _ZNP_DEVICE, _ZNP_NETWORK = (0x21, 0x02), (0x27, 0x00), (0x25, 0x50)
_ZNP_COORDINATOR_UP = 9
_ZNP_PRODUCTS = {0: "Z-Stack 1.2", 1: "Z-Stack 3.x", 2: "Z-Stack 3.0"}  # as the maker's firmware for CC2531 and CC26x2 tells


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How long things are waited for [s].

    Parameters
    ----------
    answer_s
        For an answer: at 9,600 baud a frame of 60 bytes takes 63 ms, and dongles think for less than 100 ms.
    boot_s
        For a CC253x to start its firmware once it has left the boot loader: about a second.
    silence_s
        Before and after ``+++``: an XBee's guard time is 1 s from the factory (its parameter GT).
    identify_s
        For a dongle to be opened and to tell who it is.
    """

    answer_s: float = 0.4
    boot_s: float = 1.2
    silence_s: float = 1.2
    identify_s: float = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """What a dongle says of itself; empty where it says nothing."""

    firmware: str = ""
    facts: dict[str, str] = field(default_factory=dict)
    advice: str = ""


async def exchange(transport: Transport, data: bytes, *, is_enough: Callable[[bytes], bool], wait_s: float) -> bytes:
    """Write ``data`` and return what comes until it is enough, or time is up.

    Raises
    ------
    TransportClosedError
        The port has gone.
    """
    heard = bytearray()
    until_s = time.monotonic() + wait_s
    try:
        async with asyncio.timeout(wait_s):
            if data:
                await transport.write(data)
            while not is_enough(bytes(heard)) and len(heard) < 65_536 and time.monotonic() < until_s:
                heard += await transport.read()
    except TimeoutError:
        pass
    return bytes(heard)


async def ask_host(transport: Transport, pace: Pace, *, dialect: str) -> Identity:
    """Open the dongle as the gateway would, until it has told who it is.

    What it had waiting is confirmed to it, because it tells who it is behind that. Nothing is lost by it: the backpacks repeat what no
    Acknowledge has covered, and none is sent.
    """
    told: list[CoordinatorIdentified] = []
    is_told = asyncio.Event()

    def on_event(event: HostEvent, _now_ns: int) -> None:
        if isinstance(event, CoordinatorIdentified):
            told.append(event)
            is_told.set()
        elif isinstance(event, PayloadHeard):
            session.confirm(event.receipt)

    session = HostSession(transport, make_host(dialect), on_event=on_event)
    try:
        async with asyncio.timeout(pace.identify_s):
            await run_until(session, is_told)
    except TimeoutError:
        pass
    if not told:
        return Identity(advice=f"it answers in this dialect, but did not tell who it is within {pace.identify_s:g} s")
    hello = told[-1].hello
    facts = {"eui64": f"{hello.eui64:016x}", "pan": f"{hello.pan_id:04x}", "channel": str(hello.channel)}
    return Identity(firmware=told[-1].description, facts=facts)


async def ask_xbee(transport: Transport, pace: Pace) -> Identity:
    """Read an XBee's parameters; nothing is set."""
    values: dict[str, bytes] = {}
    for number, command in enumerate(_XBEE_QUERIES, start=0x21):

        def is_answered(data: bytes, command: str = command) -> bool:
            return any(one.command == command for one in xbee_answers(data))

        heard = await exchange(transport, xbee_query(command, frame_id=number), is_enough=is_answered, wait_s=pace.answer_s)
        values |= {one.command: one.value for one in xbee_answers(heard) if one.status == 0}
    number_of = {command: int.from_bytes(value, "big") for command, value in values.items()}
    facts = {}
    if "AP" in values:
        facts["mode"] = _XBEE_MODES.get(number_of["AP"], f"AP = {number_of['AP']}")
    if "SH" in values and "SL" in values:
        facts["eui64"] = f"{number_of['SH']:08x}{number_of['SL']:08x}"
    if "OI" in values:
        facts["pan"] = f"{number_of['OI']:04x}"
    if "CH" in values:
        facts["channel"] = str(number_of["CH"])
    association = number_of.get("AI", 0)
    advice = f"its network is not up: AI is 0x{association:02x}" if association else ""
    firmware = f"XBee firmware {number_of.get('VR', 0):04x}, hardware {number_of.get('HV', 0):04x}" if "VR" in values else ""
    return Identity(firmware=firmware, facts=facts, advice=advice)


async def ask_znp(transport: Transport, pace: Pace) -> Identity:
    """Read a Z-Stack dongle's version, address and network; nothing is set."""
    answers: dict[tuple[int, int], bytes] = {}
    for cmd0, cmd1 in (_ZNP_VERSION, _ZNP_DEVICE, _ZNP_NETWORK):
        wanted = bytes((cmd0 | 0x40, cmd1))

        def is_answered(data: bytes, wanted: bytes = wanted) -> bool:
            return any(body[:2] == wanted or body[0] == 0x60 for body in mt_bodies(data))

        heard = await exchange(transport, mt_request(cmd0, cmd1), is_enough=is_answered, wait_s=pace.answer_s)
        for body in mt_bodies(heard):
            if body[:2] == wanted:
                answers[cmd0, cmd1] = body[2:]
    version = answers.get(_ZNP_VERSION, b"")
    firmware = ""
    if len(version) >= 5:
        _, product, major, minor, maintenance = version[:5]
        revision = f", build {int.from_bytes(version[5:9], 'little')}" if len(version) >= 9 else ""
        firmware = f"{_ZNP_PRODUCTS.get(product, f'Z-Stack product {product}')} ({major}.{minor}.{maintenance}{revision})"
    facts: dict[str, str] = {}
    advice = ""
    device = answers.get(_ZNP_DEVICE, b"")
    if len(device) >= 13:
        _, eui64, short, _, state = struct.unpack_from("<BQHBB", device)
        facts |= {"eui64": f"{eui64:016x}", "short_address": f"{short:04x}"}
        if state != _ZNP_COORDINATOR_UP:
            advice = f"its network is not up (state {state}); the gateway forms one when it opens the dongle"
    network = answers.get(_ZNP_NETWORK, b"")
    if len(network) in {23, 24}:  # a later Z-Stack has the device's state behind the short address
        at = len(network) - 21
        facts |= {"pan": f"{int.from_bytes(network[at : at + 2], 'little'):04x}", "channel": str(network[-1])}
    return Identity(firmware=firmware, facts=facts, advice=advice)


async def ask_transparent_xbee(transport: Transport, pace: Pace) -> Identity | None:
    """Look for an XBee in transparent mode: silence, ``+++``, and its command mode left again. None: there is none.

    An XBee that is not in command mode sends the characters over the air.
    """
    await exchange(transport, b"", is_enough=lambda _: False, wait_s=pace.silence_s)
    heard = await exchange(transport, b"+++", is_enough=lambda data: b"OK\r" in data, wait_s=pace.silence_s + pace.answer_s)
    if b"OK\r" not in heard:
        return None
    values = {}
    for command in ("VR", "HV", "AP"):
        answer = await exchange(transport, f"AT{command}\r".encode(), is_enough=lambda data: b"\r" in data, wait_s=pace.answer_s)
        values[command] = answer.strip().decode("latin-1")
    await exchange(transport, b"ATCN\r", is_enough=lambda data: b"OK\r" in data, wait_s=pace.answer_s)
    return Identity(firmware=f"XBee firmware {values['VR']}, hardware {values['HV']}", facts={"mode": "transparent"})
