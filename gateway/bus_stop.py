"""Stops to all gateways of a site at once, whatever their names are, over Zenoh.

The stop goes out as soon as somebody is connected, to whoever hears it; a gateway that is heard of later gets it by its name. A command
id is obeyed once, so it does no harm where both arrive.
"""

import queue
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Final

import zenoh

from firmware_protocol.contract.commands import CommandStage, StimulationRequest
from firmware_protocol.contract.keys import ANY, Stream, build_key, parse_key
from firmware_protocol.contract.records import decode_record, encode_record
from firmware_protocol.contract.sessions import TlsTable, ZenohTable
from firmware_protocol.errors import KeyExpressionError, RecordError
from gateway.bus_client import nobody_alive, who_is_alive
from gateway.bus_session import open_client
from gateway.errors import BusError, CommandError
from gateway.log import EventLog

_log = EventLog(__name__)

_DISCOVERY_S: Final = 3.0
_LISTEN_S: Final = 0.5
"""Other gateways may be heard of for so long, though all known ones have answered already."""

_BY_NAME_AFTER_S: Final = 0.05
"""A gateway that is there and has not answered by then is asked by its name."""

_MAX_WAITING: Final = 10_000


def stop_everywhere(
    requests: Sequence[StimulationRequest],
    *,
    site: str,
    gateway: str | None,
    connect: Sequence[str],
    timeout_s: float,
    tls: TlsTable,
    timing: ZenohTable | None = None,
    on_gateway: Callable[[str], None] = lambda _: None,
) -> Iterator[CommandStage]:
    """Send stops to every gateway of a site, or to one, and yield each stage once, as it comes.

    ``on_gateway`` is told, once, of each gateway that is there or answers. One that hangs for longer than the lease of its link is there no
    more for Zenoh, and nobody on the bus remembers it.

    Yields nothing more once every gateway that is there has told the end of each stop, or the time is over.

    Raises
    ------
    CommandError
        No gateway is there.
    BusError
        Nobody can be connected to.
    """
    with ExitStack() as stack:
        try:
            session = stack.enter_context(open_client(connect=connect, tls=tls, timing=timing))
        except BusError as error:
            raise BusError(f"nothing was stopped: {error}") from error
        call = _Call(session, requests=requests, site=site, gateway=gateway, timeout_s=timeout_s, on_gateway=on_gateway)
        yield from call.run()
        if not call.known:
            others = who_is_alive(session)
            raise CommandError(f"{nobody_alive(site=site, gateway=gateway, connect=connect, others=others)} Nothing was stopped")


@dataclass(slots=True)
class _Known:
    """A gateway that is there."""

    since_s: float
    is_asked: bool = False
    told: set[tuple[str, int, str]] = field(default_factory=set)
    ended: set[str] = field(default_factory=set)


class _Call:
    def __init__(
        self,
        session: zenoh.Session,
        *,
        requests: Sequence[StimulationRequest],
        site: str,
        gateway: str | None,
        timeout_s: float,
        on_gateway: Callable[[str], None],
    ) -> None:
        self._session = session
        self._payloads = {request.command_id: encode_record(request) for request in requests}
        self._site = site
        self._pattern = gateway or ANY
        self._timeout_s = timeout_s
        self._on_gateway = on_gateway
        self._news: queue.Queue[CommandStage | str] = queue.Queue(_MAX_WAITING)
        self.known: dict[str, _Known] = {}

    def run(self) -> Iterator[CommandStage]:
        alive = build_key(site=self._site, stream=Stream.ALIVE, gateway=self._pattern)
        begun_s = time.monotonic()
        subscriber = self._session.liveliness().declare_subscriber(alive, self._take_token, history=True)
        self._ask(self._pattern)
        try:
            while not self._is_over(time.monotonic() - begun_s):
                stage = self._next(time.monotonic())
                if stage is not None:
                    yield stage
                for name, known in self.known.items():
                    if not known.told and not known.is_asked and time.monotonic() - known.since_s >= _BY_NAME_AFTER_S:
                        known.is_asked = True
                        self._ask(name)
        finally:
            subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def _is_over(self, elapsed_s: float) -> bool:
        if not self.known:
            return elapsed_s >= _DISCOVERY_S
        if elapsed_s >= self._timeout_s:
            return True
        has_all = all(known.ended >= self._payloads.keys() for known in self.known.values())
        return has_all and (self._pattern != ANY or elapsed_s >= _LISTEN_S)

    def _next(self, now_s: float) -> CommandStage | None:
        """Return the next stage that was not told yet; None where there is none at the moment."""
        try:
            news = self._news.get(timeout=_BY_NAME_AFTER_S)
        except queue.Empty:
            return None
        name = news if isinstance(news, str) else news.gateway
        if name not in self.known:
            self.known[name] = _Known(now_s)
            self._on_gateway(name)
        if isinstance(news, str):
            return None
        known = self.known[name]
        key = (news.command_id, news.node, news.stage.value)
        if key in known.told:
            return None
        known.told.add(key)
        if news.is_final and news.command_id in self._payloads:
            known.ended.add(news.command_id)
        return news

    def _ask(self, gateway: str) -> None:
        key = build_key(site=self._site, stream=Stream.COMMAND, gateway=gateway)
        for payload in self._payloads.values():
            self._session.get(
                key,
                self._take_reply,
                payload=payload,
                target=zenoh.QueryTarget.ALL,
                timeout=self._timeout_s,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )

    def _take_token(self, sample: zenoh.Sample) -> None:
        """Runs on a thread of Zenoh."""
        try:
            self._keep(parse_key(str(sample.key_expr)).gateway)
        except KeyExpressionError:
            return

    def _take_reply(self, reply: zenoh.Reply) -> None:
        """Runs on a thread of Zenoh."""
        if reply.ok is None:
            _log.error("stop.refused", reason="" if reply.err is None else reply.err.payload.to_string())
            return
        try:
            self._keep(decode_record(reply.ok.payload.to_bytes(), CommandStage))
        except RecordError as error:
            _log.error("stop.unreadable_answer", reason=str(error))

    def _keep(self, news: CommandStage | str) -> None:
        try:
            self._news.put_nowait(news)
        except queue.Full:
            _log.error("stop.answers_lost", waiting=_MAX_WAITING)
