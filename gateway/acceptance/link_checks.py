"""Checks of the dongle itself: its port, its session, its radio's answers, and its line under garbage."""

import asyncio
import time
from collections.abc import Awaitable, Callable

from firmware_protocol.envelope import BROADCAST_ADDRESS, RadioStatus
from firmware_protocol.errors import EncodeError
from firmware_protocol.messages import MAX_RADIO_PAYLOAD, TimeSyncReply, TimeSyncRequest
from firmware_protocol.units import NodeId, ShortAddress
from gateway.acceptance.plan import Plan
from gateway.acceptance.radio_under_test import Node, RadioUnderTest, seconds_since
from gateway.acceptance.results import Result, failed, passed, skipped
from gateway.errors import TransportClosedError, TransportOpenError
from gateway.transports.interface import Transport

GARBAGE = bytes(range(256)) + bytes.fromhex("7e7e00fefe00117d13ff") + bytes(range(255, -1, -1))
"""All byte values both ways, and starts of frames of every dialect; no sound frame of any."""

_IN_FLIGHT = 4
_N_TRIES = 5
_LAST_UNICAST = 0xFFF7


async def check_exclusive(open_again: Callable[[], Awaitable[Transport]] | None) -> Result:
    """Nobody else can open the port while we have it."""
    name = "opens exclusively"
    if open_again is None:
        return skipped(name, "not a serial port: who may connect is the server's business")
    try:
        second = await open_again()
    except TransportOpenError as error:
        return passed(name, error.reason)
    await second.aclose()
    return failed(name, "a second program could open the port at the same time: answers would go to either")


async def check_identity(radio: RadioUnderTest, plan: Plan, *, opened_ns: int) -> Result:
    """It opens, and says who it is."""
    name = "opens and identifies itself"
    patience = plan.patience
    if not await radio.wait(lambda: radio.is_open, timeout_s=patience.open_s):
        said = f"; it said: {'; '.join(radio.said)}" if radio.said else ""
        return failed(name, f"it did not open within {patience.open_s:g} s: is it this dialect, at this speed? `probe` tells{said}")
    opened_ms = seconds_since(opened_ns) * 1000
    await radio.wait(lambda: radio.identified is not None, timeout_s=patience.open_s)
    identified = radio.identified
    if identified is None:
        return failed(name, f"it opened but did not say who it is within {patience.open_s:g} s")
    hello = identified.hello
    detail = f"{identified.description or 'firmware not told'}, eui64 {hello.eui64:016x}, pan {hello.pan_id:04x}, channel {hello.channel}"
    return passed(name, detail, opened_ms=round(opened_ms, 1), identified_ms=round(seconds_since(opened_ns) * 1000, 1))


async def check_unknown_address(radio: RadioUnderTest, plan: Plan) -> Result:
    """The radio tells that nobody has an address."""
    name = "tells that an address is nobody's"
    known = {node.address for node in radio.nodes.values()}
    address = next(ShortAddress(one) for one in range(_LAST_UNICAST, 0, -1) if one not in known)
    begun_ns = time.monotonic_ns()
    status = await radio.send(address, TimeSyncRequest(token=radio.new_token()), timeout_s=plan.patience.radio_s)
    took_ms = round(seconds_since(begun_ns) * 1000, 1)
    if status is None:
        return failed(
            name, f"nothing was told within {plan.patience.radio_s:g} s of a payload to {address:04x}, which nobody was heard with"
        )
    if status == RadioStatus.SENT:
        return failed(name, f"a payload to {address:04x}, which nobody was heard with, was called sent", took_ms=took_ms)
    return passed(name, f"status {_status_name(status)}", took_ms=took_ms)


async def check_broadcast(radio: RadioUnderTest, plan: Plan) -> tuple[set[NodeId], Result]:
    """A broadcast goes out, and biobots hear it; returns those who answered."""
    name = "broadcasts"
    token = radio.new_token()
    begun_ns = time.monotonic_ns()
    status = await radio.send(BROADCAST_ADDRESS, TimeSyncRequest(token=token), timeout_s=plan.patience.radio_s)
    if status != RadioStatus.SENT:
        return set(), failed(name, f"status {_status_name(status)}, wanted sent")

    def answering() -> set[NodeId]:
        return {
            one.header.node
            for one in radio.heard
            if one.at_ns >= begun_ns and isinstance(one.message, TimeSyncReply) and one.message.token == token
        }

    await radio.wait(lambda: len(answering()) >= len(radio.nodes), timeout_s=plan.patience.broadcast_s)
    n_answers = len(answering())
    detail = f"{n_answers} of {len(radio.nodes)} biobots answered"
    if n_answers or not radio.nodes:
        return answering(), passed(name, detail, answers=n_answers)
    return set(), failed(name, f"called sent, but {detail}")


async def check_sizes(radio: RadioUnderTest, plan: Plan, node: Node) -> Result:
    """The longest payload goes, a longer one is refused; neither is a message, so the biobot drops it."""
    name = f"takes {MAX_RADIO_PAYLOAD} bytes and refuses more"
    try:
        status = await radio.send_payload(node.address, bytes(MAX_RADIO_PAYLOAD + 1), timeout_s=plan.patience.radio_s)
    except EncodeError:
        pass
    else:
        if status not in {RadioStatus.TOO_LONG, RadioStatus.OTHER}:
            return failed(name, f"{MAX_RADIO_PAYLOAD + 1} bytes: status {_status_name(status)}, wanted a refusal")
    payload = bytes(MAX_RADIO_PAYLOAD - 2) + b"\xff\xff"  # not its CRC, which is that of zeros
    status = await radio.send_payload(node.address, payload, timeout_s=plan.patience.radio_s)
    if status != RadioStatus.SENT:
        return failed(name, f"{MAX_RADIO_PAYLOAD} bytes: status {_status_name(status)}, wanted sent")
    return passed(name)


async def check_garbage(radio: RadioUnderTest, plan: Plan, answers: Callable[[], Awaitable[float | None]]) -> Result:
    """Garbage on the line is survived; a payload or two may be lost on the way."""
    name = "survives garbage on the line"
    if radio.transport is None:
        return failed(name, "the port has gone")
    for _ in range(_N_TRIES):
        if await answers() is not None:
            break
    else:
        return skipped(name, "the biobot answers no more, before any garbage: has it left?", is_required=True)
    n_lost = radio.n_lost
    try:
        await radio.transport.write(GARBAGE)
    except TransportClosedError as error:
        return failed(name, str(error))
    for attempt in range(1, _N_TRIES + 1):
        await radio.wait(lambda: radio.is_open, timeout_s=plan.patience.open_s)
        if await answers() is not None:
            return passed(name, f"answers again, attempt {attempt}; the session was lost {radio.n_lost - n_lost} times")
    said = "".join(f"; {one}" for one in radio.said)
    if radio.is_open:
        return failed(name, f"after {len(GARBAGE)} bytes of garbage it is open, but no answer comes from the biobot{said}")
    return failed(name, f"after {len(GARBAGE)} bytes of garbage it did not open again{said}")


async def check_throughput(radio: RadioUnderTest, plan: Plan, node: Node) -> Result:
    """As many payloads as go are sent to one biobot, a few at a time."""
    name = "carries payloads down"
    until_s = time.monotonic() + plan.patience.throughput_s
    statuses: list[int | None] = []

    async def keep_sending() -> None:
        while time.monotonic() < until_s:
            statuses.append(await radio.send(node.address, TimeSyncRequest(token=radio.new_token()), timeout_s=plan.patience.radio_s))

    begun_ns = time.monotonic_ns()
    await asyncio.gather(*(keep_sending() for _ in range(_IN_FLIGHT)))
    n_sent = sum(status == RadioStatus.SENT for status in statuses)
    n_untold = sum(status is None for status in statuses)
    rate = round(n_sent / seconds_since(begun_ns), 1)
    detail = f"{n_sent} of {len(statuses)} sent, {n_untold} of unknown fate"
    if n_untold or not n_sent:
        return failed(name, detail, payloads_per_s=rate)
    return passed(name, detail, payloads_per_s=rate)


def check_understood(radio: RadioUnderTest) -> Result:
    """Every radio payload that came was a message of this version, and its CRC fitted."""
    name = "every payload decodes"
    bad = {fault: count for fault, count in radio.faults.items() if fault.startswith("message.")}
    if not radio.n_payloads:
        return skipped(name, "no payload came", is_required=True)
    if bad:
        return failed(name, f"of {radio.n_payloads} payloads: {', '.join(f'{fault} {count}' for fault, count in bad.items())}")
    return passed(name, f"{radio.n_payloads} payloads from {len(radio.nodes)} biobots")


def _status_name(status: int | None) -> str:
    if status is None:
        return "not told"
    try:
        return RadioStatus(status).name.lower()
    except ValueError:
        return str(status)
