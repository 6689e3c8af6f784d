"""What the command line asks of gateways that run already, over Zenoh."""

import queue
import time
from collections.abc import Iterator, Sequence

import zenoh

from firmware_protocol.contract.commands import CommandStage, StimulationRequest
from firmware_protocol.contract.keys import ANY, Stream, build_key, parse_key
from firmware_protocol.contract.mission_orders import MissionAnswer, MissionOrder
from firmware_protocol.contract.records import GatewayStatus, decode_record, encode_record
from firmware_protocol.contract.sessions import TlsTable, ZenohTable
from firmware_protocol.errors import KeyExpressionError
from gateway.bus_session import open_client
from gateway.errors import CommandError

_DISCOVERY_S = 3.0
_STATUS_POLL_S = 0.02
_MOST_NAMED = 10


def send_command(
    request: StimulationRequest,
    *,
    site: str,
    gateway: str | None,
    connect: Sequence[str],
    timeout_s: float,
    tls: TlsTable,
    timing: ZenohTable | None = None,
) -> Iterator[CommandStage]:
    """Send a command to a gateway and yield its stages as they come; for the command line.

    Parameters
    ----------
    gateway
        Its name, or None where there is only one.

    Raises
    ------
    CommandError
        No gateway, or more than one, answers there, or it cannot read the request.
    BusError
        Nobody can be connected to.
    """
    with open_client(connect=connect, tls=tls, timing=timing) as session:
        name = find_gateway(session, site=site, gateway=gateway, connect=connect)
        key = build_key(site=site, stream=Stream.COMMAND, gateway=name)
        for payload in _ask(session, key, encode_record(request), gateway=name, timeout_s=timeout_s):
            yield decode_record(payload, CommandStage)


def send_order(
    order: MissionOrder,
    *,
    site: str,
    gateway: str | None,
    connect: Sequence[str],
    timeout_s: float,
    tls: TlsTable,
    timing: ZenohTable | None = None,
) -> MissionAnswer | None:
    """Send an order to the mission of a gateway and return its answer, or None where none comes in time; for the command line.

    Raises
    ------
    CommandError
        No gateway, or more than one, answers there, or it cannot read the order.
    BusError
        Nobody can be connected to.
    """
    with open_client(connect=connect, tls=tls, timing=timing) as session:
        name = find_gateway(session, site=site, gateway=gateway, connect=connect)
        key = build_key(site=site, stream=Stream.ORDERS, gateway=name)
        for payload in _ask(session, key, encode_record(order), gateway=name, timeout_s=timeout_s):
            return decode_record(payload, MissionAnswer)
    return None


def read_status(
    *, site: str, gateway: str | None, connect: Sequence[str], timeout_s: float, tls: TlsTable, timing: ZenohTable | None = None
) -> GatewayStatus | None:
    """Return the next status that a gateway publishes, or None where none does in time; for the command line.

    Raises
    ------
    BusError
        Nobody can be connected to.
    """
    with open_client(connect=connect, tls=tls, timing=timing) as session:
        channel: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(1)
        with session.declare_subscriber(build_key(site=site, stream=Stream.STATUS, gateway=gateway or ANY), channel) as subscriber:
            deadline = time.monotonic() + timeout_s
            while time.monotonic() < deadline:
                sample = subscriber.try_recv()
                if sample is not None:
                    return decode_record(sample.payload.to_bytes(), GatewayStatus)
                time.sleep(_STATUS_POLL_S)
    return None


def find_gateway(session: zenoh.Session, *, site: str, gateway: str | None, connect: Sequence[str]) -> str:
    """Return the name of the gateway that is asked: the one named, or the only one there is.

    Raises
    ------
    CommandError
        There is none within 3 s, or several.
    """
    pattern = build_key(site=site, stream=Stream.ALIVE, gateway=gateway or ANY)
    found: queue.Queue[str] = queue.Queue()
    # A subscriber with history hears of the gateway as soon as the connection stands; a get would return empty before.
    subscriber = session.liveliness().declare_subscriber(pattern, lambda sample: found.put(str(sample.key_expr)), history=True)
    try:
        names = {parse_key(found.get(timeout=_DISCOVERY_S)).gateway}
        while not found.empty():
            names.add(parse_key(found.get_nowait()).gateway)
    except (queue.Empty, KeyExpressionError) as error:
        raise CommandError(nobody_alive(site=site, gateway=gateway, connect=connect, others=who_is_alive(session))) from error
    finally:
        subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
    if len(names) > 1:
        raise CommandError(f"there are several gateways ({', '.join(sorted(names))}); name one with --gateway")
    return names.pop()


def nobody_alive(*, site: str, gateway: str | None, connect: Sequence[str], others: Sequence[str] = ()) -> str:
    """Say that a gateway, or any, is not to be found, and which others are."""
    who = f"gateway {gateway!r} is not" if gateway else "no gateway is"
    found = f" There is {', '.join(others)}." if others else ""
    return f"{who} alive at site {site!r} on {', '.join(connect)}; is it running, and are site and endpoint right?{found}"


def who_is_alive(session: zenoh.Session) -> list[str]:
    """Return the gateways of all sites that a session sees, in order, at most ten; access control may show it its own site alone."""
    keys = session.liveliness().get(build_key(site=ANY, stream=Stream.ALIVE, gateway=ANY), timeout=_DISCOVERY_S)
    found = sorted({str(reply.ok.key_expr) for reply in keys if reply.ok is not None})
    return [f"gateway {key.gateway!r} at site {key.site!r}" for key in map(parse_key, found[:_MOST_NAMED])]


def _ask(session: zenoh.Session, key: str, payload: bytes, *, gateway: str, timeout_s: float) -> Iterator[bytes]:
    """Yield what a gateway answers."""
    for reply in session.get(key, payload=payload, timeout=timeout_s, consolidation=zenoh.ConsolidationMode.NONE):
        if reply.ok is not None:
            yield reply.ok.payload.to_bytes()
        elif reply.err is not None:
            raise CommandError(f"gateway {gateway} answers: {reply.err.payload.to_string()}")
