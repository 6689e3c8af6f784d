"""Checks that need a biobot behind the dongle: it answers, repeats what is not acknowledged, and loses nothing when the port is closed."""

import asyncio
import statistics
import time
from collections.abc import Collection

from firmware_protocol.messages import (
    Action,
    Hello,
    HelloRequest,
    Neighbours,
    StimulateReply,
    StimulationResult,
    TimeSyncReply,
    TimeSyncRequest,
)
from firmware_protocol.messages import Stimulate as StimulateMessage
from firmware_protocol.units import NodeId
from gateway.acceptance.plan import Plan
from gateway.acceptance.radio_under_test import Heard, Node, RadioUnderTest, seconds_since
from gateway.acceptance.results import Result, failed, passed, skipped
from gateway.config import StimulationTable
from gateway.errors import TransportError

_ROOM = 24
"""Neighbour reports that are acknowledged at most to make room for a Hello; they are sent again soon, with what is true then."""

_TTL_MS, _HOLD_MS = 2_000, 4_000
_N_ASKINGS = 3
_SOAK_PAUSE_S = 0.2
_SOAK_SHARE = 0.9


async def hear_biobots(radio: RadioUnderTest, plan: Plan) -> Result:
    """Wait for a biobot to be heard: the first, or the one that is named."""
    name = "hears biobots"
    patience = plan.patience
    begun_ns = time.monotonic_ns()
    if not await radio.wait(
        lambda: bool(radio.nodes) if plan.node is None else plan.node in radio.nodes, timeout_s=patience.first_payload_s
    ):
        who = "no biobot" if plan.node is None else f"not biobot {plan.node}, but {sorted(radio.nodes) or 'none'},"
        return failed(name, f"{who} was heard within {patience.first_payload_s:g} s: is a backpack switched on, in range, on this network?")
    heard = f"biobot {plan.node or next(iter(radio.nodes))}"
    return passed(name, heard, first_s=round(seconds_since(begun_ns), 2))


async def choose_biobot(radio: RadioUnderTest, plan: Plan, *, answering: Collection[NodeId]) -> Node | None:
    """Return the biobot to talk to: the one that is named, or any that answers now; None where none does.

    Biobots walk: one that was heard may be out of range a moment later. Those who answered the broadcast are asked first, then those
    heard last, and each that is heard while there is time.
    """
    begun_ns = time.monotonic_ns()
    asked: set[NodeId] = set()

    def candidates() -> list[NodeId]:
        wanted = radio.nodes.keys() if plan.node is None else radio.nodes.keys() & {plan.node}
        last_heard = {one.header.node: one.at_ns for one in radio.heard}
        return sorted(wanted - asked, key=lambda node: (node not in answering, -last_heard.get(node, 0)))

    while (left_s := plan.patience.first_payload_s - seconds_since(begun_ns)) > 0:
        if not await radio.wait(lambda: bool(candidates()), timeout_s=left_s if plan.node is None else 0):
            break
        number = candidates()[0]
        asked.add(number)
        for _ in range(plan.patience.n_round_trips if plan.node is not None else 1):
            if await measure_round_trip(radio, plan, radio.nodes[number]) is not None:
                return radio.nodes[number]
            if plan.patience.first_payload_s < seconds_since(begun_ns):
                break
    return None


async def measure_round_trip(radio: RadioUnderTest, plan: Plan, node: Node) -> float | None:
    """Return how long a time sync request and its reply take [ms]; None where no reply comes."""
    token = radio.new_token()
    begun_ns = time.monotonic_ns()
    asking = asyncio.ensure_future(radio.send(node.address, TimeSyncRequest(token=token), timeout_s=plan.patience.radio_s))
    try:
        reply = await radio.wait_for_message(
            lambda one: one.header.node == node.node and isinstance(one.message, TimeSyncReply) and one.message.token == token,
            since_ns=begun_ns,
            timeout_s=plan.patience.reply_s,
        )
    finally:
        asking.cancel()
        await asyncio.gather(asking, return_exceptions=True)
    return None if reply is None else (reply.at_ns - begun_ns) / 1e6


async def check_time_sync(radio: RadioUnderTest, plan: Plan, node: Node) -> Result:
    """A biobot tells its clock when asked."""
    name = "time sync round trip"
    n = plan.patience.n_round_trips
    trips = [trip for trip in [await measure_round_trip(radio, plan, node) for _ in range(n)] if trip is not None]
    if 2 * len(trips) < n:
        return failed(name, f"{len(trips)} of {n} requests were answered within {plan.patience.reply_s:g} s each")
    median, longest = round(statistics.median(trips), 1), round(max(trips), 1)
    return passed(name, f"{len(trips)} of {n} answered", median_ms=median, max_ms=longest)


async def ask_hello(radio: RadioUnderTest, plan: Plan, node: Node) -> Heard | None:
    """Ask a biobot for a new Hello and return its first copy; None where none comes.

    A Hello that is under way already is repeated instead of said anew (WIRE_FORMAT.md §5.1): it is acknowledged, and asked for again.
    """
    known = {one.identity for one in radio.heard if isinstance(one.message, Hello)}
    for _ in range(_N_ASKINGS):
        begun_ns = time.monotonic_ns()
        await radio.send(node.address, HelloRequest(), timeout_s=plan.patience.radio_s)
        hello = await radio.wait_for_message(
            lambda one: one.header.node == node.node and isinstance(one.message, Hello),
            since_ns=begun_ns,
            timeout_s=plan.patience.reply_s,
        )
        if hello is None:
            await _make_room(radio, plan, node)
        elif hello.identity in known:
            await acknowledge(radio, plan, node, hello)
        else:
            return hello
    return None


async def check_hello(radio: RadioUnderTest, plan: Plan, node: Node) -> tuple[Heard | None, Result]:
    """A biobot says who it is when asked."""
    name = "hello request answered"
    hello = await ask_hello(radio, plan, node)
    if hello is None:
        return None, failed(name, f"biobot {node.node} sent no new Hello within {plan.patience.reply_s:g} s, asked {_N_ASKINGS} times")
    assert isinstance(hello.message, Hello)
    firmware = hello.message.firmware
    detail = f"biobot {node.node} eui64 {hello.message.eui64:016x} firmware {firmware >> 8}.{firmware & 0xFF}"
    return hello, passed(name, detail)


async def check_repetition(radio: RadioUnderTest, plan: Plan, node: Node, hello: Heard) -> tuple[int | None, Result]:
    """A message that is not acknowledged comes again; it is acknowledged then, and ``check_silence`` looks whether it stays away."""
    name = "repeats what is not acknowledged"
    again = await _next_copy(radio, hello, timeout_s=plan.patience.repeat_s)
    if again is None:
        return None, failed(name, f"Hello #{hello.header.sequence} came once only, wanted a copy within {plan.patience.repeat_s:g} s")
    await acknowledge(radio, plan, node, hello)
    return time.monotonic_ns(), passed(name, after_s=round((again.at_ns - hello.at_ns) / 1e9, 2))


async def check_silence(radio: RadioUnderTest, plan: Plan, node: Node, hello: Heard, *, acknowledged_ns: int) -> Result:
    """An acknowledged message stays away. A copy that crossed the Acknowledge, and one lost Acknowledge, are forgiven."""
    name = "is silent once acknowledged"
    forgiven = 1
    from_ns = acknowledged_ns
    while True:
        copy = await radio.wait_for_message(
            lambda one: one.identity == hello.identity,
            since_ns=from_ns,
            timeout_s=max(0.0, plan.patience.silence_s - seconds_since(from_ns)),
        )
        if copy is None:
            return passed(name, f"no copy for {seconds_since(from_ns):.1f} s")
        if not forgiven:
            return failed(
                name, f"Hello #{hello.header.sequence} came again {(copy.at_ns - acknowledged_ns) / 1e9:.1f} s after its Acknowledge"
            )
        forgiven -= 1
        await acknowledge(radio, plan, node, hello)
        from_ns = time.monotonic_ns()


async def check_reopening(radio: RadioUnderTest, plan: Plan, node: Node) -> Result:
    """A message that was under way when the port was closed comes when it is opened again."""
    name = "nothing lost when the port is opened again"
    hello = await ask_hello(radio, plan, node)
    if hello is None:
        return failed(name, f"biobot {node.node} sent no Hello to look for")
    await radio.disconnect()
    begun_ns = time.monotonic_ns()
    try:
        await radio.connect()
    except TransportError as error:
        return failed(name, str(error))
    if not await radio.wait(lambda: radio.is_open, timeout_s=plan.patience.open_s):
        return failed(name, f"it did not open again within {plan.patience.open_s:g} s; {'; '.join(radio.said)}")
    opened_ms = round(seconds_since(begun_ns) * 1000, 1)
    again = await radio.wait_for_message(
        lambda one: one.identity == hello.identity, since_ns=begun_ns, timeout_s=plan.patience.repeat_s + plan.patience.reply_s
    )
    if again is None:
        return failed(name, f"Hello #{hello.header.sequence}, not acknowledged, did not come again", opened_ms=opened_ms)
    await acknowledge(radio, plan, node, hello)
    return passed(name, opened_ms=opened_ms)


async def check_stimulation(radio: RadioUnderTest, plan: Plan, node: Node | None) -> Result:
    """The biobot starts and stops when told; only where that was asked for. The gateway's gate and journal take no part."""
    name = "starts and stops"
    if not plan.stimulates:
        return skipped(name, "not asked for: --stimulate with --node N touches a living animal")
    if node is None:
        return skipped(name, "no biobot answers", is_required=True)
    began = await _command(radio, plan, node, Action.START)
    # Whatever became of the start, a stop follows, after the shortest pause between two trains.
    await asyncio.sleep(StimulationTable().min_gap_s)
    ended = await _command(radio, plan, node, Action.STOP)
    if began is StimulationResult.DONE and ended is StimulationResult.DONE:
        return passed(name, f"biobot {node.node} did both")
    told = ", ".join(f"{word} {'unanswered' if one is None else one.name.lower()}" for word, one in (("start", began), ("stop", ended)))
    return failed(name, told)


async def soak(radio: RadioUnderTest, plan: Plan) -> Result:
    """Ask all biobots for their time, one after the other, for as long as was asked for.

    One that neither answers nor is heard otherwise has left: that is not counted.
    """
    name = "holds for long"
    if not plan.soak_s:
        return skipped(name, "not asked for: --soak-s S")
    until_s = time.monotonic() + plan.soak_s
    n_lost = radio.n_lost
    n_asked = n_answered = n_away = 0
    while time.monotonic() < until_s:
        for node in list(radio.nodes.values()):
            begun_ns = time.monotonic_ns()
            if await measure_round_trip(radio, plan, node) is not None:
                n_answered += 1
            elif not any(one.at_ns >= begun_ns and one.header.node == node.node for one in radio.heard):
                n_away += 1
            n_asked += 1
            if time.monotonic() >= until_s:
                break
            await asyncio.sleep(_SOAK_PAUSE_S)
    away = f", {n_away} were to biobots that were not heard meanwhile either" if n_away else ""
    detail = f"{n_answered} of {n_asked} requests answered in {plan.soak_s:g} s{away}; the session was lost {radio.n_lost - n_lost} times"
    is_good = radio.n_lost == n_lost and n_answered > 0 and n_answered >= _SOAK_SHARE * (n_asked - n_away)
    return passed(name, detail) if is_good else failed(name, detail)


async def acknowledge(radio: RadioUnderTest, plan: Plan, node: Node, *messages: Heard) -> None:
    """Tell a biobot that just these messages are safe."""
    sequences = [one.header.sequence for one in messages]
    message = radio.acknowledgement_of(*sequences, boot=messages[0].header.boot)
    await radio.send(node.address, message, timeout_s=plan.patience.radio_s)


async def _make_room(radio: RadioUnderTest, plan: Plan, node: Node) -> None:
    """Acknowledge the newest neighbour reports, which hold nothing that is kept, where a backpack's window is full."""
    reports = [one for one in radio.heard if one.header.node == node.node and isinstance(one.message, Neighbours)]
    current = [one for one in reports if one.header.boot == reports[-1].header.boot][-_ROOM:] if reports else []
    if current:
        await acknowledge(radio, plan, node, *current)


async def _next_copy(radio: RadioUnderTest, first: Heard, *, timeout_s: float) -> Heard | None:
    return await radio.wait_for_message(lambda one: one.identity == first.identity, since_ns=first.at_ns + 1, timeout_s=timeout_s)


async def _command(radio: RadioUnderTest, plan: Plan, node: Node, action: Action) -> StimulationResult | None:
    table = StimulationTable()
    number = radio.new_token() << 16 | radio.new_token()
    begun_ns = time.monotonic_ns()
    message = StimulateMessage(
        command=number,
        action=action,
        ttl_ms=_TTL_MS,
        hold_ms=_HOLD_MS,
        frequency_hz=table.frequency_hz,
        pulse_width_us=table.pulse_width_us,
        amplitude_mv=table.amplitude_mv,
        duration_ms=table.duration_ms,
    )
    await radio.send(node.address, message, timeout_s=plan.patience.radio_s)
    reply = await radio.wait_for_message(
        lambda one: isinstance(one.message, StimulateReply) and one.message.command == number and one.header.node == NodeId(node.node),
        since_ns=begun_ns,
        timeout_s=plan.patience.reply_s,
    )
    return None if reply is None or not isinstance(reply.message, StimulateReply) else reply.message.result
