"""Drives the host of one coordinator dongle: opens its port, keeps the dongle open, and tries again for ever.

One task a radio, isolated from the others: whatever goes wrong with one, it is opened again, and the others go on. Upward, every
radio payload is handed to ``on_radio`` and confirmed to the dongle in order, each when the future that ``on_radio`` returned is
done, or when the disk has taken nothing for a while (``receipts``). Downward, ``send`` gives each payload a future with what became
of it; nothing is ever sent a second time from here.
"""

import asyncio
import time
import traceback
from collections.abc import Callable

from firmware_protocol.dialects.interface import (
    CoordinatorIdentified,
    CoordinatorSaid,
    Host,
    HostEvent,
    HostLost,
    HostOpened,
    LostWhy,
    NodeSeen,
    PayloadHeard,
    SendSettled,
)
from firmware_protocol.envelope import CoordinatorHello
from firmware_protocol.errors import LinkFullError
from firmware_protocol.units import BROADCAST, LAST_NODE_ADDRESS, NS_PER_S, ShortAddress
from gateway.backoff import Backoff
from gateway.config import LinkTable
from gateway.errors import RadioUnavailableError, TransportClosedError, TransportError, TransportSilentError, first_transport_error
from gateway.health import Health
from gateway.line_pace import LinePace
from gateway.line_writer import LineWriter
from gateway.log import EventLog
from gateway.outage import OnState, Outage
from gateway.port_opening import OpenPort, PortOpening
from gateway.radio import Fate, RadioMessage, RadioOutcome, outcome_of
from gateway.radio_log import RadioLog
from gateway.radio_sessions import STEADY_NS, RadioSessions
from gateway.receipts import Receipts
from gateway.sendings import Sendings
from gateway.transports.interface import Transport
from gateway.wake_timer import WakeTimer

_log = EventLog(__name__)

_MAX_SENDINGS = 256
"""Payloads whose fate is not known; more are refused."""

_SAID = {0: _log.debug, 1: _log.info, 2: _log.warning, 3: _log.error}


class Coordinator:
    """One radio of the gateway; ``run`` is its task.

    Parameters
    ----------
    radio
        Its name, in records and logs.
    make_host
        Makes the base station's end of the dongle's dialect, once: it is opened anew with the port, and what it knows of addresses and of
        numbers in use stays. After a fault that nobody thought of, another is made.
    open_port
        Opens the transport; raises ``TransportError``.
    reset_port
        Opens it with its dongle reset, where that can be done.
    on_radio
        Takes a radio payload; returns a future that is done when all that the payload says is on disk, or None where there
        is nothing to wait for.
    first_session
        Number of its first session; see ``RadioSessions``.
    pace
        Of its line; None: the driver takes no more than the line does.
    """

    def __init__(
        self,
        *,
        radio: str,
        make_host: Callable[[], Host],
        open_port: OpenPort,
        on_radio: Callable[[RadioMessage], "asyncio.Future[None] | None"],
        config: LinkTable,
        health: Health,
        first_session: int,
        on_state: OnState | None = None,
        reset_port: OpenPort | None = None,
        pace: LinePace | None = None,
    ) -> None:
        self.radio = radio
        self.hello: CoordinatorHello | None = None
        self._make_host = make_host
        self._on_radio = on_radio
        self._config = config
        self._health = health
        self._host = make_host()
        self._line: LineWriter | None = None
        """While the port is open."""
        self._pace = pace or LinePace(bytes_per_s=None)
        self._wake = asyncio.Event()
        self._sessions = RadioSessions(first=first_session)
        self._receipts = Receipts()
        self._sendings = Sendings(health=health)
        self._opening_until_ns = 0
        self._reopen_at_ns: int | None = None
        self._reopen_pause_s = 0.0
        self._outage = Outage(radio=radio, health=health, on_state=on_state)
        self._opening = PortOpening(open_port=open_port, reset_port=reset_port, config=config, health=health, outage=self._outage)
        self._log = RadioLog(radio=radio, health=health)

    @property
    def is_up(self) -> bool:
        """Whether payloads can be sent now."""
        return self._line is not None and self._host.is_open

    @property
    def n_pending(self) -> int:
        """Payloads that were sent down and whose fate is not known yet."""
        return len(self._sendings)

    @property
    def n_unconfirmed(self) -> int:
        """How many writes payloads from the dongle wait for before they are confirmed."""
        return len(self._receipts)

    def send(self, *, destination: ShortAddress, payload: bytes, is_urgent: bool = False) -> "asyncio.Future[RadioOutcome]":
        """Send a radio payload; the future tells its fate and never fails. An urgent one overtakes all that waits.

        Raises
        ------
        RadioUnavailableError
            The radio is down, its queue is full, or the address is none of one biobot; nothing was sent.
        """
        self._check_address(destination)
        return self._send(destination=destination, payload=payload, is_urgent=is_urgent)

    def send_to_all(self, payload: bytes) -> "asyncio.Future[RadioOutcome]":
        """Send an urgent radio payload by broadcast, as ``send`` does."""
        return self._send(destination=BROADCAST, payload=payload, is_urgent=True)

    def withdraw(self, sending: "asyncio.Future[RadioOutcome]") -> bool:
        """Take back a payload that was not handed to the port; True: its future says so, and it never will be."""
        outcome = RadioOutcome(fate=Fate.NOT_SENT, reason="withdrawn before it was written")
        if self._sendings.drop_timed(sending, outcome):
            return True
        ticket = self._sendings.ticket_of(sending)
        if ticket is None or not self._host.withdraw(ticket):
            return False
        self._sendings.settle(ticket, outcome)
        self._wake.set()  # what waited behind it may go
        return True

    def _send(self, *, destination: ShortAddress, payload: bytes, is_urgent: bool) -> "asyncio.Future[RadioOutcome]":
        self._check_open()
        if len(self._sendings) >= _MAX_SENDINGS and not is_urgent:
            raise RadioUnavailableError(radio=self.radio, reason=f"{len(self._sendings)} payloads wait for it")
        now_ns = time.monotonic_ns()
        try:
            ticket = self._host.send(destination=destination, payload=payload, now_ns=now_ns, is_urgent=is_urgent)
        except LinkFullError as error:
            raise RadioUnavailableError(radio=self.radio, reason=str(error)) from error
        future = self._sendings.add(ticket, deadline_ns=now_ns + int(self._config.radio_timeout_s * NS_PER_S))
        if is_urgent and self._line is not None:
            self._line.write_at_once(self._next_frame)
        self._wake.set()
        return future

    def send_timed(self, *, destination: ShortAddress, make: Callable[[int], bytes]) -> "asyncio.Future[RadioOutcome]":
        """Send a payload that ``make`` makes of the instant [ns] at which the port is about to take it; it overtakes all that waits then.

        What is urgent and was sent before goes first, and at most one of these waits for the port at a time.

        Raises
        ------
        RadioUnavailableError
            As of ``send``, or another one waits; nothing will be sent.
        """
        self._check_address(destination)
        self._check_open()
        future = self._sendings.hold_timed(destination=destination, make=make, radio=self.radio)
        self._wake.set()
        return future

    async def run(self) -> None:
        """Keep the radio connected until cancelled."""
        backoff = Backoff(first_s=self._config.first_backoff_s, max_s=self._config.max_backoff_s)
        while True:
            self._outage.attempt()
            self._sessions.was_steady = False
            try:
                transport = await self._opening.open()
                try:
                    await self._hold(transport)
                finally:
                    await transport.aclose()
            except TransportError as error:
                self._opening.n_silences += isinstance(error, TransportSilentError)
                self._outage.begin(str(error))
            except Exception as error:  # noqa: BLE001  # one radio's fault must not end the gateway, which stops the other radios' animals
                reason = f"{type(error).__name__}: {error}"
                self._health.count("radio.broken")
                self._log.say(_log.error, "radio.broken", reason=reason, trace=traceback.format_exc())
                self._outage.begin(reason)
                self._host = self._make_host()  # what the old one knows may be what broke it
            if self._sessions.was_steady:
                backoff.start_anew()
            await asyncio.sleep(backoff.take_s())

    def _check_address(self, destination: ShortAddress) -> None:
        if destination > LAST_NODE_ADDRESS:
            raise RadioUnavailableError(radio=self.radio, reason=f"{destination:#06x} is no biobot's address: it would reach many, or none")

    def _check_open(self) -> None:
        if not self.is_up:
            raise RadioUnavailableError(radio=self.radio, reason=self._outage.why_down)

    async def _hold(self, transport: Transport) -> None:
        """Keep the dongle open on an open port; ends with the ``TransportError`` that ended it."""
        self._line = LineWriter(transport, pace=self._pace)
        self._reopen_pause_s = 0.0
        self._open_host()
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._read(transport))
                # In the group's body, not as a task: in Python 3.11 a group whose body has ended leaves its parent marked as cancelled.
                await self._write(transport, self._line)
        except BaseExceptionGroup as group:
            _, rest = group.split(TransportError)
            if rest is not None:
                raise
            raise first_transport_error(group) from group
        finally:
            self._line = None
            self._sessions.end(now_ns=time.monotonic_ns())
            self._count_faults()
            self._sendings.settle_all(RadioOutcome(fate=Fate.UNKNOWN, reason="the port was closed"))

    def _open_host(self) -> None:
        self._receipts.clear()
        self._reopen_at_ns = None
        now_ns = time.monotonic_ns()
        self._allow_opening(now_ns)
        self._take_events(self._host.open(session=self._sessions.next_number(), now_ns=now_ns))
        self._wake.set()

    def _allow_opening(self, now_ns: int) -> None:
        self._opening_until_ns = now_ns + int(self._config.open_timeout_s * NS_PER_S)

    async def _read(self, transport: Transport) -> None:
        while True:
            chunk = await transport.read()
            now_ns = time.monotonic_ns()
            self._health.count("radio.bytes_in", len(chunk))
            self._take_events(self._host.feed(chunk, now_ns=now_ns), received_ns=now_ns)
            self._count_faults()
            self._wake.set()

    async def _write(self, transport: Transport, line: LineWriter) -> None:
        timer = WakeTimer(self._wake.set)
        try:
            while True:
                # Here, so that all payloads of one commit share one acknowledgement.
                if (safe := self._receipts.take_ready(now_ns=time.monotonic_ns())) is not None:
                    self._host.confirm(safe)
                await line.write_what_fits(self._next_frame)
                deadline_ns = self._next_deadline_ns()
                timer.aim(deadline_ns)
                await self._wake.wait()
                self._wake.clear()
                if deadline_ns is not None and time.monotonic_ns() >= deadline_ns:
                    self._handle_deadlines(transport)
        finally:
            timer.stop()

    def _next_frame(self, now_ns: int) -> bytes | None:
        """Return what the port is to have now: what is urgent before all that was not handed out yet.

        The timed payload that waits is made for it: the next to go, but for what is urgent and was sent before.
        """
        if (timed := self._sendings.take_timed()) is not None:
            try:
                timed.follow(self.send(destination=timed.destination, payload=timed.make(now_ns), is_urgent=True))
            except RadioUnavailableError as error:
                timed.settle(RadioOutcome(fate=Fate.UNKNOWN, reason=error.reason))
        return next(iter(self._host.take_frames(at_most=1)), None)

    def _next_deadline_ns(self) -> int | None:
        deadlines = [self._host.next_deadline_ns(), self._reopen_at_ns, self._sendings.next_deadline_ns, self._receipts.next_deadline_ns]
        if self._host.has_frames or self._sendings.has_timed:
            deadlines.append(self._pace.free_at_ns)
        if not self._host.is_open:
            deadlines.append(self._opening_until_ns)
        return min((at for at in deadlines if at is not None), default=None)

    def _handle_deadlines(self, transport: Transport) -> None:
        now_ns = time.monotonic_ns()
        self._take_events(self._host.handle_deadline(now_ns=now_ns))
        self._count_faults()
        if self._reopen_at_ns is not None and now_ns >= self._reopen_at_ns:
            self._open_host()
        if not self._host.is_open and now_ns >= self._opening_until_ns:
            question = "is it a coordinator of this dialect, at this baud rate? `biobot-gateway probe` tells"
            raise TransportSilentError(name=transport.name, reason=f"no answer for {self._config.open_timeout_s:g} s; {question}")
        for ticket in self._sendings.overdue(now_ns=now_ns):
            self._host.forget(ticket)
            self._sendings.settle(ticket, RadioOutcome(fate=Fate.UNKNOWN, reason="the dongle did not say what became of it"))

    def _take_events(self, events: list[HostEvent], *, received_ns: int = 0) -> None:
        if events and not self._host.is_open and self._reopen_at_ns is None:
            self._allow_opening(time.monotonic_ns())  # it is slow to open, and alive
        last: asyncio.Future[None] | None = None
        for event in events:
            match event:
                case PayloadHeard():
                    last = self._take_payload(event, received_ns=received_ns) or last
                case SendSettled(ticket=ticket, status=status):
                    self._sendings.settle(ticket, outcome_of(status))
                case HostOpened():
                    self._came_up()
                case CoordinatorIdentified():
                    self._identified(event)
                case NodeSeen():
                    self._health.count("radio.nodes_seen")
                case CoordinatorSaid(level=level, name=name, text=text):
                    self._log.say(_SAID[level], f"dongle.{name}", text=text)
                case HostLost():
                    self._lost(event)
        if last is not None:  # the others are done before: writes are committed in their order
            last.add_done_callback(self._wake_up)

    def _wake_up(self, _: "asyncio.Future[None]") -> None:
        self._wake.set()

    def _take_payload(self, heard: PayloadHeard, *, received_ns: int) -> "asyncio.Future[None] | None":
        """Hand a payload up; return what it waits for, where nothing before it waits for the same."""
        self._health.count("radio.messages_in")
        received = heard.received
        message = RadioMessage(
            radio=self.radio,
            source=received.source,
            rssi_dbm=received.rssi_dbm,
            lqi=received.lqi,
            payload=received.payload,
            received_ns=received_ns,
        )
        return self._receipts.add(heard.receipt, self._hand_up(message), now_ns=received_ns)

    def _hand_up(self, message: RadioMessage) -> "asyncio.Future[None] | None":
        """Hand a payload up. One that the gateway fails at is no reason to keep the dongle repeating it, nor to give the dongle up."""
        try:
            return self._on_radio(message)
        except Exception as error:  # noqa: BLE001  # whatever it is, it comes from this payload alone
            self._health.count("message.broken")
            reason = f"{type(error).__name__}: {error}"
            self._log.say(_log.error, "message.broken", payload=message.payload.hex(), reason=reason, trace=traceback.format_exc())
            return None

    def _identified(self, event: CoordinatorIdentified) -> None:
        is_known, self.hello = event.hello == self.hello, event.hello
        if not is_known:
            pan, channel = f"{event.hello.pan_id:04x}", event.hello.channel
            self._health.note_firmware(self.radio, event.description)
            self._log.say(_log.info, "radio.identified", firmware=event.description, pan=pan, channel=channel)

    def _came_up(self) -> None:
        self._sessions.begin(now_ns=time.monotonic_ns())
        self._receipts.clear()
        self._opening.n_silences = 0
        self._outage.end()

    def _lost(self, lost: HostLost) -> None:
        self._health.count(f"link.lost.{lost.why.value}")
        for ticket in lost.dropped:
            self._sendings.settle(ticket, RadioOutcome(fate=Fate.UNKNOWN, reason=f"the dongle was lost ({lost.detail or lost.why.value})"))
        if lost.why is not LostWhy.RESTARTED:
            kind = TransportSilentError if lost.why is LostWhy.NO_ANSWER else TransportClosedError
            raise kind(name=self.radio, reason=lost.detail or lost.why.value)
        if self._reopen_at_ns is not None:
            return
        self._sendings.settle_all(RadioOutcome(fate=Fate.UNKNOWN, reason="the dongle restarted"))
        is_steady = self._sessions.end(now_ns=time.monotonic_ns())
        self._health.count("radio.restarts")
        if is_steady:
            self._reopen_pause_s = 0.0
            _log.warning("radio.restarted", radio=self.radio)
            self._open_host()
            return
        # A dongle that starts again and again is not to be asked as fast as the line goes.
        self._reopen_pause_s = min(max(2 * self._reopen_pause_s, self._config.first_backoff_s), self._config.max_backoff_s)
        self._outage.begin(f"the dongle restarted within {STEADY_NS // NS_PER_S} s")
        self._reopen_at_ns = time.monotonic_ns() + int(self._reopen_pause_s * NS_PER_S)
        self._opening_until_ns = self._reopen_at_ns + int(self._config.open_timeout_s * NS_PER_S)

    def _count_faults(self) -> None:
        for name, count in self._host.faults.items():
            self._health.count(name, count)
        self._host.faults.clear()
