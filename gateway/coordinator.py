"""Drives the link to one coordinator dongle: opens its port, keeps the session, and tries again for ever.

One task a radio, isolated from the others. Upward, every radio payload is handed to ``on_radio`` and confirmed to the dongle
in order, each when the future that ``on_radio`` returned is done. Downward, ``send`` gives each payload a handle and a future
with what became of it; nothing is ever sent a second time from here.
"""

import asyncio
import random
import time
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from firmware_protocol.envelope import (
    CoordinatorHello,
    EnvelopeFault,
    IdentifyRequest,
    RadioConfirm,
    RadioReceived,
    RadioSend,
    decode_envelope,
    encode_envelope,
)
from firmware_protocol.errors import LinkFullError
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.link import (
    Link,
    LinkConfig,
    LinkEvent,
    LinkLost,
    LinkOpened,
    LinkState,
    LostReason,
    PayloadConfirmed,
    PayloadReceived,
    Role,
)
from firmware_protocol.units import NS_PER_S, ShortAddress
from gateway.config import LinkTable
from gateway.errors import RadioUnavailableError, TransportClosedError, TransportError
from gateway.health import Health, RadioState
from gateway.journal_file import SESSIONS_PER_START
from gateway.log import EventLog
from gateway.radio import Fate, RadioMessage, RadioOutcome, outcome_of
from gateway.transports.interface import Transport

_log = EventLog(__name__)

_WINDOW = 4
"""DATA frames in flight towards the dongle: few, so that an urgent one does not wait behind many."""

_MAX_HANDLES = 256
"""Payloads whose RadioConfirm has not come; more are refused."""


@dataclass(slots=True)
class _Receipt:
    """A payload from the dongle that waits for its confirmation."""

    number: int
    is_done: bool = False


@dataclass(slots=True)
class _Sending:
    """A payload on its way down."""

    future: asyncio.Future[RadioOutcome]
    ticket: int
    deadline_ns: int


class Coordinator:
    """One radio of the gateway; ``run`` is its task.

    Parameters
    ----------
    radio
        Its name, in records and logs.
    open_port
        Opens the transport; raises ``TransportError``.
    on_radio
        Takes a radio payload; returns a future that is done when all that the payload says is on disk, or None where there
        is nothing to wait for.
    first_session
        Number of its first session. It must not be one that an earlier process used of late: the dongle takes RESET of its
        running session for a repetition, keeps its counters, and both sides wait for ever (WIRE_FORMAT.md §3.2).
    """

    def __init__(
        self,
        *,
        radio: str,
        open_port: Callable[[], Awaitable[Transport]],
        on_radio: Callable[[RadioMessage], "asyncio.Future[None] | None"],
        config: LinkTable,
        health: Health,
        first_session: int,
        on_state: Callable[[str, RadioState, str], None] | None = None,
    ) -> None:
        self.radio = radio
        self.hello: CoordinatorHello | None = None
        self._open_port = open_port
        self._on_radio = on_radio
        self._config = config
        self._health = health
        self._on_state = on_state
        self._link = Link(role=Role.INITIATOR, config=LinkConfig(window=_WINDOW))
        self._decoder = CobsDecoder()
        self._wake = asyncio.Event()
        self._first_session = first_session
        self._n_sessions = 0
        self._receipts: deque[_Receipt] = deque()
        self._sendings: dict[int, _Sending] = {}
        # A RadioConfirm that the dongle kept from before a restart must not settle another payload.
        self._next_handle = random.randrange(1 << 16)
        self._opening_until_ns = 0
        self._has_opened = False
        self._down_since_ns: int | None = None
        self._n_attempts = 0
        health.set_radio(radio, RadioState.CONNECTING)

    @property
    def is_up(self) -> bool:
        """Whether payloads can be sent now."""
        return self._link.state is LinkState.OPEN

    @property
    def n_pending(self) -> int:
        """Payloads that were sent down and whose fate is not known yet."""
        return len(self._sendings)

    def send(self, *, destination: ShortAddress, payload: bytes, is_urgent: bool = False) -> "asyncio.Future[RadioOutcome]":
        """Send a radio payload; the future tells its fate and never fails. An urgent one overtakes all that waits.

        Raises
        ------
        RadioUnavailableError
            The radio is down, or its queue is full; nothing was sent.
        """
        if not self.is_up:
            raise RadioUnavailableError(radio=self.radio, reason="it is not connected")
        if len(self._sendings) >= _MAX_HANDLES and not is_urgent:
            raise RadioUnavailableError(radio=self.radio, reason=f"{len(self._sendings)} payloads wait for it")
        handle = self._take_handle()
        body = encode_envelope(RadioSend(handle=handle, destination=destination, payload=payload))
        now_ns = time.monotonic_ns()
        try:
            ticket = self._link.send(body, now_ns=now_ns, is_urgent=is_urgent)
        except LinkFullError as error:
            raise RadioUnavailableError(radio=self.radio, reason=str(error)) from error
        future: asyncio.Future[RadioOutcome] = asyncio.get_running_loop().create_future()
        deadline_ns = now_ns + int(self._config.radio_timeout_s * NS_PER_S)
        self._sendings[handle] = _Sending(future, ticket, deadline_ns)
        self._wake.set()
        return future

    async def run(self) -> None:
        """Keep the radio connected until cancelled."""
        backoff_s = self._config.first_backoff_s
        while True:
            self._n_attempts += 1
            self._has_opened = False
            try:
                transport = await self._open_port()
                try:
                    await self._hold(transport)
                finally:
                    await transport.aclose()
            except TransportError as error:
                self._went_down(str(error))
            if self._has_opened:
                backoff_s = self._config.first_backoff_s
            await asyncio.sleep(backoff_s * random.uniform(0.5, 1.0))
            backoff_s = min(2 * backoff_s, self._config.max_backoff_s)

    async def _hold(self, transport: Transport) -> None:
        """Keep sessions on an open port; ends with the ``TransportError`` that ended it."""
        self._decoder = CobsDecoder()
        self._open_session()
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._read(transport))
                # In the group's body, not as a task: in Python 3.11 a group whose body has ended leaves its parent marked as cancelled.
                await self._write(transport)
        except BaseExceptionGroup as group:
            _, rest = group.split(TransportError)
            if rest is not None:
                raise
            raise _first(group) from group
        finally:
            self._link = Link(role=Role.INITIATOR, config=LinkConfig(window=_WINDOW))
            self._give_up_sendings("the port was closed")

    def _open_session(self) -> None:
        self._receipts.clear()
        self._take_events(self._link.open(session=self._new_session(), now_ns=time.monotonic_ns()))
        self._opening_until_ns = time.monotonic_ns() + int(self._config.open_timeout_s * NS_PER_S)
        self._wake.set()

    def _new_session(self) -> int:
        # Only a session that opened is used up: while the dongle does not answer, numbers do not go round to its last one.
        return (self._first_session + self._n_sessions % SESSIONS_PER_START) % (1 << 16)

    async def _read(self, transport: Transport) -> None:
        while True:
            chunk = await transport.read()
            now_ns = time.monotonic_ns()
            self._health.count("radio.bytes_in", len(chunk))
            for body in self._decoder.feed(chunk):
                if isinstance(body, FrameFault):
                    self._health.count(f"frame.{body.value}")
                else:
                    self._take_events(self._link.receive(body, now_ns=now_ns), received_ns=now_ns)
            self._wake.set()

    async def _write(self, transport: Transport) -> None:
        while True:
            self._confirm()  # here, so that all payloads of one commit share one ACK
            for body in self._link.take_frames():
                await transport.write(encode_frame(body))
            deadline_ns = self._next_deadline_ns()
            wait_s = None if deadline_ns is None else max(0.0, (deadline_ns - time.monotonic_ns()) / NS_PER_S)
            try:
                async with asyncio.timeout(wait_s):
                    await self._wake.wait()
            except TimeoutError:
                self._handle_deadlines(transport)
            self._wake.clear()

    def _next_deadline_ns(self) -> int | None:
        deadlines = [self._link.next_deadline_ns()]
        if self._link.state is LinkState.OPENING:
            deadlines.append(self._opening_until_ns)
        if self._sendings:
            deadlines.append(next(iter(self._sendings.values())).deadline_ns)  # they are in the order of their deadlines
        return min((at for at in deadlines if at is not None), default=None)

    def _handle_deadlines(self, transport: Transport) -> None:
        now_ns = time.monotonic_ns()
        self._take_events(self._link.handle_deadline(now_ns=now_ns))
        if self._link.state is LinkState.OPENING and now_ns >= self._opening_until_ns:
            reason = f"no answer to RESET within {self._config.open_timeout_s:g} s; is it a coordinator, at this baud rate?"
            raise TransportClosedError(name=transport.name, reason=reason)
        for handle, sending in list(self._sendings.items()):
            if sending.deadline_ns > now_ns:
                break
            self._settle(handle, RadioOutcome(fate=Fate.UNKNOWN, reason="the dongle did not say what became of it"))

    def _take_events(self, events: list[LinkEvent], *, received_ns: int = 0) -> None:
        for event in events:
            match event:
                case PayloadReceived(payload=payload, receipt=receipt):
                    self._take_payload(payload, receipt=receipt, received_ns=received_ns)
                case PayloadConfirmed():
                    self._health.count("link.payloads_confirmed")
                case LinkOpened():
                    self._came_up()
                case LinkLost(reason=reason, dropped=dropped):
                    self._lost(reason, set(dropped))

    def _take_payload(self, payload: bytes, *, receipt: int, received_ns: int) -> None:
        entry = _Receipt(receipt)
        self._receipts.append(entry)
        envelope = decode_envelope(payload)
        waits_for: asyncio.Future[None] | None = None
        match envelope:
            case RadioReceived(source=source, rssi_dbm=rssi_dbm, lqi=lqi, payload=inner):
                self._health.count("radio.messages_in")
                message = RadioMessage(radio=self.radio, source=source, rssi_dbm=rssi_dbm, lqi=lqi, payload=inner, received_ns=received_ns)
                waits_for = self._on_radio(message)
            case RadioConfirm(handle=handle, status=status):
                self._settle(handle, outcome_of(status))
            case CoordinatorHello():
                is_known, self.hello = envelope == self.hello, envelope
                if not is_known:
                    _log.info("radio.identified", radio=self.radio, pan=f"{envelope.pan_id:04x}", channel=envelope.channel)
            case EnvelopeFault():
                self._health.count(f"envelope.{envelope.value}")
            case _:
                self._health.count("envelope.unexpected")
        if waits_for is None or waits_for.done():
            self._done(entry)
        else:
            waits_for.add_done_callback(lambda _: self._done(entry))

    def _done(self, entry: _Receipt) -> None:
        entry.is_done = True
        self._wake.set()

    def _confirm(self) -> None:
        """Confirm all receipts up to the first that is not done: confirming one confirms all before it."""
        last = None
        while self._receipts and self._receipts[0].is_done:
            last = self._receipts.popleft().number
        if last is not None:
            self._link.confirm(last)

    def _came_up(self) -> None:
        self._has_opened = True
        self._n_sessions += 1
        self._receipts.clear()
        self._link.send(encode_envelope(IdentifyRequest()), now_ns=time.monotonic_ns())
        self._health.set_radio(self.radio, RadioState.UP)
        down_s = 0.0 if self._down_since_ns is None else (time.monotonic_ns() - self._down_since_ns) / NS_PER_S
        _log.info("radio.up", radio=self.radio, attempts=self._n_attempts, down_s=round(down_s, 1))
        self._down_since_ns = None
        self._n_attempts = 0
        self._health.count("radio.sessions")
        if self._on_state is not None:
            self._on_state(self.radio, RadioState.UP, "")

    def _went_down(self, reason: str) -> None:
        """Say so when a fault begins; while it lasts, attempts are only counted."""
        self._health.set_radio(self.radio, RadioState.DOWN)
        self._health.count("radio.faults")
        if self._down_since_ns is None:
            self._down_since_ns = time.monotonic_ns()
            self._n_attempts = 0
            _log.warning("radio.down", radio=self.radio, reason=reason)
            if self._on_state is not None:
                self._on_state(self.radio, RadioState.DOWN, reason)

    def _lost(self, reason: LostReason, dropped: set[int]) -> None:
        self._health.count(f"link.lost.{reason.value}")
        for handle in [handle for handle, sending in self._sendings.items() if sending.ticket in dropped]:
            self._settle(handle, RadioOutcome(fate=Fate.UNKNOWN, reason=f"the link was lost ({reason.value})"))
        if reason is LostReason.PEER_RESTARTED:
            self._give_up_sendings("the dongle restarted")
            _log.warning("radio.restarted", radio=self.radio)
            self._open_session()
        elif reason is LostReason.NO_ANSWER:
            raise TransportClosedError(name=self.radio, reason="the dongle does not answer")

    def _give_up_sendings(self, reason: str) -> None:
        for handle in list(self._sendings):
            self._settle(handle, RadioOutcome(fate=Fate.UNKNOWN, reason=reason))

    def _settle(self, handle: int, outcome: RadioOutcome) -> None:
        sending = self._sendings.pop(handle, None)
        if sending is None:
            self._health.count("radio.unexpected_confirms")
            return
        self._health.count(f"radio.{outcome.fate.value}")
        if not sending.future.done():
            sending.future.set_result(outcome)

    def _take_handle(self) -> int:
        while self._next_handle in self._sendings:
            self._next_handle = (self._next_handle + 1) % (1 << 16)
        handle = self._next_handle
        self._next_handle = (handle + 1) % (1 << 16)
        return handle


def _first(group: BaseExceptionGroup[BaseException]) -> TransportError:
    """Return the error that ended reading or writing first; the other task may have met the same cause."""
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, TransportError)
    return error
