"""Sets the network of a coordinator dongle, while no gateway has its port: PAN id, channel, who may join."""

import asyncio
import contextlib
import random
import time
from collections import deque
from typing import Protocol

from firmware_protocol.dialects.choice import FORMING_DIALECTS
from firmware_protocol.dialects.configurator import Configurator
from firmware_protocol.envelope import LEAVE_CHANNEL, LEAVE_JOINING, LEAVE_PAN_ID, ConfigureCoordinator, CoordinatorConfigured
from firmware_protocol.errors import ConfigurationError
from firmware_protocol.units import NS_PER_S
from gateway.errors import TransportClosedError, TransportSpecError
from gateway.transports.can_spec import CanSpec
from gateway.transports.interface import Transport
from gateway.transports.spec import PortSpec, open_transport

TIMEOUT_S = 10.0


class _Exchange(Protocol):
    """One question and its answer over an open port."""

    answer: CoordinatorConfigured | None
    faults: deque[str]

    def feed(self, chunk: bytes, *, now_ns: int) -> None: ...

    def take_frames(self) -> list[bytes]: ...

    def next_deadline_ns(self) -> int | None: ...

    def handle_deadline(self, *, now_ns: int) -> None: ...


def configuration_request(*, pan_id: int | None, channel: int | None, permit_join_s: int | None) -> ConfigureCoordinator:
    """Return the question for these values; None: leave it.

    Raises
    ------
    ConfigurationError
        Nothing is asked for, or a value is out of its range (WIRE_FORMAT.md §4.7).
    """
    wanted = (
        ("--pan-id", pan_id, range(0xFFFF), "0x0000 to 0xFFFE"),
        ("--channel", channel, range(11, 27), "11 to 26"),
        ("--permit-join", permit_join_s, range(255), "0 to 254 seconds, 254 for good"),
    )
    problems = [
        f"{flag} is {value}, but must be {limits}" for flag, value, allowed, limits in wanted if value is not None and value not in allowed
    ]
    if all(value is None for _, value, _, _ in wanted):
        problems.append("nothing to set: give --pan-id, --channel or --permit-join")
    if problems:
        raise ConfigurationError(problems)
    return ConfigureCoordinator(
        token=random.randrange(1 << 16),
        pan_id=LEAVE_PAN_ID if pan_id is None else pan_id,
        channel=LEAVE_CHANNEL if channel is None else channel,
        permit_join_s=LEAVE_JOINING if permit_join_s is None else permit_join_s,
    )


async def configure(spec: PortSpec, request: ConfigureCoordinator, *, timeout_s: float = TIMEOUT_S) -> CoordinatorConfigured:
    """Ask a coordinator to set its network, and return what it answers.

    Raises
    ------
    TransportSpecError
        Its dialect has no such question.
    TransportOpenError, TransportClosedError
        The port cannot be opened or has gone, or nothing answers in time.
    """
    if not isinstance(spec, CanSpec) and spec.dialect != "native":
        how = (
            "give the network when the port is opened, and it is formed so where there is none: "
            f"{spec.name}?dialect={spec.dialect}&channel=15&pan_id=0x1234&permit_join_s=60"
            if spec.dialect in FORMING_DIALECTS
            else 'docs/dongles.md tells how ("Set-up without XCTU" for an XBee)'
        )
        reason = f"configure speaks to native and CAN coordinators, not to dialect {spec.dialect}; {how}"
        raise TransportSpecError(spec=spec.name, reason=reason)
    transport = await open_transport(spec)
    try:
        return await _ask(transport, _exchange(spec, request), timeout_s=timeout_s)
    finally:
        await transport.aclose()


def _exchange(spec: PortSpec, request: ConfigureCoordinator) -> _Exchange:
    if isinstance(spec, CanSpec):
        from gateway.transports.isotp_exchange import IsoTpExchange  # noqa: PLC0415  # can-isotp is loaded where it is used

        return IsoTpExchange(request, unit=spec.unit)
    return Configurator(request, session=random.randrange(1 << 16), now_ns=time.monotonic_ns())


async def _ask(transport: Transport, exchange: _Exchange, *, timeout_s: float) -> CoordinatorConfigured:
    reading = asyncio.ensure_future(transport.read())
    try:
        async with asyncio.timeout(timeout_s):
            while exchange.answer is None:
                for frame in exchange.take_frames():
                    await transport.write(frame)
                deadline_ns = exchange.next_deadline_ns()
                wait_s = None if deadline_ns is None else max(0.0, (deadline_ns - time.monotonic_ns()) / NS_PER_S)
                await asyncio.wait({reading}, timeout=wait_s)
                if reading.done():
                    exchange.feed(reading.result(), now_ns=time.monotonic_ns())
                    reading = asyncio.ensure_future(transport.read())
                exchange.handle_deadline(now_ns=time.monotonic_ns())
            for frame in exchange.take_frames():  # the last acknowledgement
                await transport.write(frame)
    except TimeoutError as error:
        details = "; ".join(exchange.faults) or "is it a coordinator of this dialect, unit and speed?"
        raise TransportClosedError(name=transport.name, reason=f"no answer within {timeout_s:g} s: {details}") from error
    finally:
        reading.cancel()
        with contextlib.suppress(asyncio.CancelledError, TransportClosedError):
            await reading
    return exchange.answer
