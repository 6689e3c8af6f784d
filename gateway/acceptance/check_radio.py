"""The acceptance check from beginning to end: every check in its order, those that cannot be tried told as such."""

import random
import time
from collections.abc import Callable, Iterable
from functools import partial

from firmware_protocol.dialects.choice import make_host
from firmware_protocol.messages import MAX_RADIO_PAYLOAD
from gateway.acceptance import biobot_checks, link_checks
from gateway.acceptance.plan import Plan
from gateway.acceptance.radio_under_test import Node, RadioUnderTest
from gateway.acceptance.results import Outcome, Report, Result, failed, passed, skipped
from gateway.errors import TransportError
from gateway.transports.spec import PortSpec, SerialSpec, open_transport

_OF_A_BIOBOT = (
    "time sync round trip",
    "hello request answered",
    "repeats what is not acknowledged",
    "is silent once acknowledged",
    "nothing lost when the port is opened again",
    f"takes {MAX_RADIO_PAYLOAD} bytes and refuses more",
    "carries payloads down",
    "survives garbage on the line",
)
_NO_BIOBOT = "no biobot was heard"


async def check_radio(spec: PortSpec, plan: Plan, *, on_result: Callable[[Result], None]) -> Report:
    """Check a dongle; ``on_result`` is told each result as it comes."""
    report = Report(port=spec.name)

    def tell(results: Iterable[Result]) -> None:
        for result in results:
            report.results.append(result)
            on_result(result)

    radio = RadioUnderTest(
        open_port=partial(open_transport, spec),
        make_host=lambda: make_host(spec.dialect, first_handle=random.randrange(1 << 16), network=spec.network),
    )
    opened_ns = time.monotonic_ns()
    try:
        await radio.connect()
    except TransportError as error:
        tell([failed("opens the port", str(error))])
        return report
    try:
        tell([passed("opens the port", spec.name)])
        tell([await link_checks.check_exclusive(partial(open_transport, spec) if isinstance(spec, SerialSpec) else None)])
        tell([await link_checks.check_identity(radio, plan, opened_ns=opened_ns)])
        if report.results[-1].outcome is Outcome.PASSED:
            await _check_open_dongle(radio, plan, tell)
    finally:
        await radio.disconnect()
    return report


async def _check_open_dongle(radio: RadioUnderTest, plan: Plan, tell: Callable[[Iterable[Result]], None]) -> None:
    heard = await biobot_checks.hear_biobots(radio, plan)
    tell([heard, await link_checks.check_unknown_address(radio, plan)])
    answering, broadcast = await link_checks.check_broadcast(radio, plan)
    node: Node | None = None
    if heard.outcome is Outcome.PASSED:
        node = await biobot_checks.choose_biobot(radio, plan, answering=answering)
    tell([_excused(broadcast) if node is None and radio.nodes and not answering else broadcast])
    if node is not None:
        await _check_biobot(radio, plan, node, tell)
    else:
        why = _none_answers(plan, len(radio.nodes)) if heard.outcome is Outcome.PASSED else _NO_BIOBOT
        tell(skipped(name, why, is_required=True) for name in _OF_A_BIOBOT)
    tell(
        [
            await biobot_checks.check_stimulation(radio, plan, node),
            await biobot_checks.soak(radio, plan),
            link_checks.check_understood(radio),
        ]
    )


def _none_answers(plan: Plan, n_heard: int) -> str:
    who = f"biobot {plan.node} was heard, but does not answer" if plan.node is not None else f"none of {n_heard} heard biobots answers"
    return f"{who}: none is in range now, or this dongle carries nothing down"


def _excused(broadcast: Result) -> Result:
    """A broadcast that went out proves nothing where nobody hears anything else either."""
    if broadcast.outcome is Outcome.FAILED and broadcast.detail.startswith("called sent"):
        return skipped(
            broadcast.name, f"{broadcast.detail}, and none answers when called by its number: none is in range now", is_required=True
        )
    return broadcast


async def _check_biobot(radio: RadioUnderTest, plan: Plan, node: Node, tell: Callable[[Iterable[Result]], None]) -> None:
    tell([await biobot_checks.check_time_sync(radio, plan, node)])
    hello, result = await biobot_checks.check_hello(radio, plan, node)
    tell([result])
    acknowledged_ns: int | None = None
    if hello is not None:
        acknowledged_ns, result = await biobot_checks.check_repetition(radio, plan, node, hello)
        tell([result])
    else:
        tell([skipped("repeats what is not acknowledged", "no Hello came", is_required=True)])
    tell([await link_checks.check_sizes(radio, plan, node)])
    tell([await link_checks.check_throughput(radio, plan, node)])
    tell([await link_checks.check_garbage(radio, plan, partial(biobot_checks.measure_round_trip, radio, plan, node))])
    if hello is not None and acknowledged_ns is not None:
        # Late, because what goes on meanwhile costs no time of its own.
        tell([await biobot_checks.check_silence(radio, plan, node, hello, acknowledged_ns=acknowledged_ns)])
    else:
        tell([skipped("is silent once acknowledged", "nothing was acknowledged", is_required=True)])
    tell([await biobot_checks.check_reopening(radio, plan, node)])
