"""A Digi XBee in API mode 1 or 2 from the base station's end (WIRE_FORMAT.md §8).

Radio payloads are RF data, as they are. An XBee acknowledges nothing to its host and does not wait for it: what is heard while nobody reads
is lost, and the backpack, which gets no Acknowledge, says it again. ``confirm`` therefore does nothing.
"""

from collections import Counter, deque
from dataclasses import dataclass

from firmware_protocol.dialects.interface import (
    CoordinatorSaid,
    HostEvent,
    HostLost,
    HostOpened,
    LostWhy,
    NodeSeen,
    PayloadHeard,
    SendSettled,
)
from firmware_protocol.dialects.xbee_addresses import AddressTable
from firmware_protocol.dialects.xbee_frames import (
    AT_OK,
    ZDO_PROFILE,
    AtCommand,
    AtResponse,
    Endpoints,
    ModemStatus,
    NodeIdentification,
    Receive,
    TransmitRequest,
    TransmitStatus,
    XBeeFault,
    decode_xbee,
    encode_xbee,
)
from firmware_protocol.dialects.xbee_identity import DEFAULT_LONGEST, has_short_addresses, identify
from firmware_protocol.dialects.xbee_meanings import (
    ASSOCIATED,
    DELIVERY,
    EVENTS,
    MAY_HAVE_NO_NETWORK,
    NO_NETWORK,
    OF_MODULE,
    RESTARTS,
    Happening,
    describe_association,
)
from firmware_protocol.dialects.xbee_opening import AT_FRAME_ID, Opening, Stage
from firmware_protocol.dialects.xbee_sending import Sendings
from firmware_protocol.envelope import RadioReceived, RadioStatus
from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.interface import FrameDecoder, FrameFault
from firmware_protocol.framing.xbee import encode_frame, make_decoder
from firmware_protocol.messages import MAX_RADIO_PAYLOAD
from firmware_protocol.units import BROADCAST, NS_PER_S, RSSI_UNKNOWN, RssiDbm, ShortAddress

_LQI_UNKNOWN = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class XBeeHostConfig:
    """What the host does beyond the dialect's rules.

    Parameters
    ----------
    patience_ns
        How long a module may be without a network before it is refused.
    keepalive_ns, strike_ns, max_strikes
        After how much silence it is asked whether it is there, how long an answer may take, and how many may be missing.
    check_ns
        How often it is asked whether it has its network, whatever is heard from it.
    keeps_mode
        Where a module in transparent mode is switched to API mode, write that into its memory.
    endpoints
        Of the backpacks' application; None: Digi's own for data (endpoint 0xE8, cluster 0x0011, profile 0xC105), by 0x10 frames.
    """

    patience_ns: int = 30 * NS_PER_S
    keepalive_ns: int = 3 * NS_PER_S
    strike_ns: int = NS_PER_S
    max_strikes: int = 3
    check_ns: int = 10 * NS_PER_S
    keeps_mode: bool = False
    endpoints: Endpoints | None = None


class XBeeHost:
    """See the module and ``dialects.interface.Host``. What it knows of addresses, and frame ids in use, outlive an opening.

    Parameters
    ----------
    first_handle
        Where frame ids and allotted addresses begin: anywhere else than in an earlier process.
    """

    def __init__(self, *, config: XBeeHostConfig | None = None, first_handle: int = 0) -> None:
        self.faults: Counter[str] = Counter()
        self._config = config or XBeeHostConfig()
        self._opening: Opening | None = None
        self._is_open = False
        self._is_escaped = True
        self._decoder: FrameDecoder = make_decoder(is_escaped=True)
        self._frames: list[bytes] = []
        self._launched: deque[tuple[int, bytes]] = deque()
        """Frame id and frame of each payload that was launched and waits to be handed out; urgent ones first."""
        self._n_urgent_launched = 0
        self._sendings = Sendings(first_id=first_handle)
        self._unreachable: list[int] = []
        """Tickets of payloads for addresses that nobody can have, not yet settled."""
        self._table = AddressTable(first_allotted=first_handle)
        self._next_receipt = 1
        self._ask_at_ns: int | None = None
        self._asked_ns = self._check_at_ns = 0
        self._n_strikes = 0
        self._said_delivery = 0
        """Delivery status that the log was last told of: a fault that goes on is told once."""

    @property
    def is_open(self) -> bool:
        """Payloads can be sent now."""
        return self._is_open

    @property
    def has_frames(self) -> bool:
        """``take_frames`` has something to give now."""
        return bool(self._frames or self._launched)

    def open(self, *, session: int, now_ns: int) -> list[HostEvent]:  # noqa: ARG002  # this dialect has no sessions
        """Begin with a module in an unknown state."""
        self._close()
        self._sendings.drop_all()
        self._unreachable.clear()
        self._decoder = make_decoder(is_escaped=True)
        self._opening = Opening(now_ns=now_ns, patience_ns=self._config.patience_ns, keeps_mode=self._config.keeps_mode)
        return self._follow(self._opening, now_ns)

    def feed(self, chunk: bytes, *, now_ns: int) -> list[HostEvent]:
        """Take bytes from the line, cut anywhere."""
        events: list[HostEvent] = []
        if self._opening is not None and self._opening.is_textual:
            events += self._opening.take_text(chunk, now_ns=now_ns)
            events += self._follow(self._opening, now_ns)
        for body in self._decoder.feed(chunk):
            if isinstance(body, FrameFault):
                self.faults[f"frame.{body.value}"] += 1
                continue
            frame = decode_xbee(body)
            if isinstance(frame, XBeeFault):
                self.faults[f"xbee.{frame.value}"] += 1
                continue
            if self._is_open:
                self._heard(now_ns)
            self._take(frame, events, now_ns)
        return events + self._settle_unreachable()

    def send(self, *, destination: ShortAddress, payload: bytes, now_ns: int, is_urgent: bool = False) -> int:
        """Queue a radio payload; see ``Host.send``. One for an address that nobody can have is settled at the next deadline: now."""
        if len(payload) > MAX_RADIO_PAYLOAD:
            raise EncodeError(field="radio payload size", value=len(payload), limit=f"at most {MAX_RADIO_PAYLOAD} bytes")
        ticket = self._sendings.queue(destination=destination, payload=payload, is_urgent=is_urgent)
        self._launch(now_ns)
        return ticket

    def forget(self, ticket: int) -> None:
        """Wait no more for what became of a payload; one that was not written yet is not sent."""
        if self.withdraw(ticket):
            return
        self._sendings.forget(ticket)
        if ticket in self._unreachable:
            self._unreachable.remove(ticket)

    def withdraw(self, ticket: int) -> bool:
        """Take back a payload that was not handed out; see ``Host.withdraw``."""
        if self._sendings.take_back(ticket):
            return True
        for index, (frame_id, _) in enumerate(self._launched):
            if self._sendings.is_of(frame_id, ticket=ticket):
                del self._launched[index]
                self._n_urgent_launched -= index < self._n_urgent_launched
                self._sendings.settle(frame_id)
                return True
        return False

    def confirm(self, receipt: int) -> None:
        """Do nothing: the dialect has no acknowledgement towards the module."""

    def take_frames(self, *, at_most: int | None = None) -> list[bytes]:
        """Return what is to be written; see ``Host.take_frames``."""
        limit = len(self._frames) + len(self._launched) if at_most is None else at_most
        frames, self._frames = self._frames[:limit], self._frames[limit:]
        launched = [self._launched.popleft()[1] for _ in range(min(limit - len(frames), len(self._launched)))]
        self._n_urgent_launched = max(0, self._n_urgent_launched - len(launched))
        return frames + launched

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called."""
        opening_ns = None if self._opening is None else self._opening.deadline_ns
        status_ns = self._sendings.next_deadline_ns() if self._is_open else None
        unreachable_ns = 0 if self._unreachable or (self._is_open and self._sendings.is_ready) else None
        return min((at for at in (opening_ns, self._ask_at_ns, status_ns, unreachable_ns) if at is not None), default=None)

    def handle_deadline(self, *, now_ns: int) -> list[HostEvent]:
        """Ask again, or give the module up."""
        if self._opening is not None:
            return self._opening.handle_deadline(now_ns=now_ns) + self._follow(self._opening, now_ns)
        if not self._is_open:
            return []
        events: list[HostEvent] = []
        for ticket in self._sendings.give_up(now_ns=now_ns):
            self.faults["xbee.status_missing"] += 1
            events.append(SendSettled(ticket=ticket, status=RadioStatus.OTHER))
        self._launch(now_ns)
        events += self._settle_unreachable()
        if self._ask_at_ns is not None and now_ns >= self._ask_at_ns:
            if self._n_strikes >= self._config.max_strikes:
                return [*events, self._lose(LostWhy.NO_ANSWER, f"the XBee does not answer, asked {self._n_strikes} times")]
            self._n_strikes += 1
            self._write(AtCommand(frame_id=AT_FRAME_ID, command="AI"))
            self._asked_ns = now_ns
            self._check_at_ns = now_ns + self._config.check_ns
            self._ask_at_ns = now_ns + self._config.strike_ns
        return events

    def _follow(self, opening: Opening, now_ns: int) -> list[HostEvent]:
        """Take what an opening has to write, and see whether it has ended."""
        self._frames += opening.outgoing
        opening.outgoing.clear()
        is_escaped = opening.is_escaped is not False
        if is_escaped is not self._is_escaped:
            self._is_escaped = is_escaped
            self._decoder = make_decoder(is_escaped=is_escaped)  # what the old one holds is of the other mode and worth nothing
        if opening.stage is Stage.REFUSED:
            return [self._lose(LostWhy.REFUSED, opening.refusal)]
        if opening.stage is not Stage.DONE:
            return []
        self._opening = None
        self._is_open = True
        self._said_delivery = 0
        self._asked_ns, self._check_at_ns = now_ns - self._config.strike_ns, now_ns + self._config.check_ns
        self._heard(now_ns)
        self._table.has_short_addresses = has_short_addresses(opening.answers)
        events: list[HostEvent] = [HostOpened(), identify(opening.answers)]
        longest = opening.answers.number("NP", default=DEFAULT_LONGEST)
        if longest < MAX_RADIO_PAYLOAD:
            text = (
                f"it carries {longest} bytes (NP), our longest messages have {MAX_RADIO_PAYLOAD}; switch source routing or APS security off"
            )
            events.append(CoordinatorSaid(level=2, name="short_payload", text=text))
        self._launch(now_ns)
        return events

    def _take(self, frame: object, events: list[HostEvent], now_ns: int) -> None:
        match frame:
            case Receive():
                self._hear(frame, events)
            case TransmitStatus():
                self._settle(frame, events, now_ns)
                self._launch(now_ns)
            case AtResponse():
                self._take_answer(frame, events, now_ns)
            case ModemStatus():
                self._take_event(frame, events, now_ns)
            case NodeIdentification(node64=node64, node16=node16):
                address, _ = self._table.learn(eui64=node64, address16=node16)
                events.append(NodeSeen(address=address, eui64=node64))
            case _:
                self.faults["xbee.wrong_direction"] += 1

    def _hear(self, frame: Receive, events: list[HostEvent]) -> None:
        if frame.endpoints is not None and frame.endpoints.profile == ZDO_PROFILE:
            self.faults["xbee.zdo"] += 1  # the stack's own talk, which AO = 3 lets through
            return
        address, is_news = self._table.learn(eui64=frame.source64, address16=frame.source16)
        if not self._is_open:
            self.faults["xbee.before_open"] += 1  # the backpack says it again
            return
        if is_news:
            events.append(NodeSeen(address=address, eui64=frame.source64))
        received = RadioReceived(source=address, rssi_dbm=RssiDbm(RSSI_UNKNOWN), lqi=_LQI_UNKNOWN, payload=frame.payload)
        events.append(PayloadHeard(received=received, receipt=self._next_receipt))
        self._next_receipt += 1

    def _settle(self, status: TransmitStatus, events: list[HostEvent], now_ns: int) -> None:
        settled = self._sendings.settle(status.frame_id)
        if status.delivery == NO_NETWORK:
            self._ask_soon(now_ns)
        if settled is None:
            self.faults["radio.unexpected_confirms"] += 1
            return
        delivery = DELIVERY.get(status.delivery)
        outcome = RadioStatus.OTHER if delivery is None else delivery.outcome
        sending, eui64 = settled
        if outcome is RadioStatus.SENT:
            self._table.learn(eui64=eui64, address16=status.destination16)  # of the node that it was for, whose the address may not be now
        if delivery is None or status.delivery in OF_MODULE:
            if self._said_delivery != status.delivery:
                text = "delivery status that is not known here" if delivery is None else delivery.text
                events.append(CoordinatorSaid(level=2, name="delivery", text=f"0x{status.delivery:02X}: {text}"))
            self._said_delivery = status.delivery
        elif outcome is RadioStatus.SENT:
            self._said_delivery = 0
        events.append(SendSettled(ticket=sending.ticket, status=outcome))

    def _take_answer(self, answer: AtResponse, events: list[HostEvent], now_ns: int) -> None:
        if self._opening is not None:
            events += self._opening.take_answer(answer, now_ns=now_ns)
            events += self._follow(self._opening, now_ns)
        elif self._is_open and answer.command == "AI" and answer.status == AT_OK:
            state = int.from_bytes(answer.value[:1], "big")
            if state != ASSOCIATED:
                events.append(
                    self._lose(LostWhy.RESTARTED, f"the XBee has lost its network: AI = 0x{state:02X}, {describe_association(state)}")
                )

    def _take_event(self, event: ModemStatus, events: list[HostEvent], now_ns: int) -> None:
        level, text = EVENTS.get(event.status, Happening(1, "an event that is not known here"))
        events.append(CoordinatorSaid(level=level, name="event", text=f"0x{event.status:02X}: {text}"))
        if self._opening is not None:
            self._opening.take_event(event, now_ns=now_ns)
            events += self._follow(self._opening, now_ns)
        elif self._is_open and event.status in RESTARTS:
            events.append(self._lose(LostWhy.RESTARTED, text))
        elif event.status in MAY_HAVE_NO_NETWORK:
            self._ask_soon(now_ns)

    def _launch(self, now_ns: int) -> None:
        """Write what may be in flight. Of what goes to an address that nobody can have, nothing is."""
        while self._is_open and (sending := self._sendings.take()) is not None:
            where = self._table.destination(sending.destination)
            if where is None:
                self._unreachable.append(sending.ticket)
                continue
            frame_id = self._sendings.launch(sending, eui64=where[0], now_ns=now_ns)
            request = TransmitRequest(
                frame_id=frame_id, destination64=where[0], destination16=where[1], payload=sending.payload, endpoints=self._config.endpoints
            )
            frame = encode_frame(encode_xbee(request), is_escaped=self._is_escaped)
            if sending.is_urgent and sending.destination == BROADCAST:
                self._launched.appendleft((frame_id, frame))
                self._n_urgent_launched += 1
            elif sending.is_urgent:
                self._launched.insert(self._n_urgent_launched, (frame_id, frame))
                self._n_urgent_launched += 1
            else:
                self._launched.append((frame_id, frame))

    def _settle_unreachable(self) -> list[HostEvent]:
        events: list[HostEvent] = [SendSettled(ticket=ticket, status=RadioStatus.UNKNOWN_ADDRESS) for ticket in self._unreachable]
        self._unreachable.clear()
        return events

    def _write(self, frame: AtCommand) -> None:
        self._frames.append(encode_frame(encode_xbee(frame), is_escaped=self._is_escaped))

    def _heard(self, now_ns: int) -> None:
        self._n_strikes = 0
        self._ask_at_ns = min(now_ns + self._config.keepalive_ns, self._check_at_ns)

    def _ask_soon(self, now_ns: int) -> None:
        """Ask for the network at the next deadline, where it was not asked just now."""
        self._check_at_ns = min(self._check_at_ns, max(now_ns, self._asked_ns + self._config.strike_ns))
        if self._ask_at_ns is not None:
            self._ask_at_ns = min(self._ask_at_ns, self._check_at_ns)

    def _lose(self, why: LostWhy, detail: str) -> HostLost:
        self._close()
        dropped = (*self._unreachable, *self._sendings.drop_all())
        self._unreachable.clear()
        return HostLost(why=why, detail=detail, dropped=dropped)

    def _close(self) -> None:
        self._opening = None
        self._is_open = False
        self._is_escaped = True
        self._frames.clear()
        self._launched.clear()
        self._n_urgent_launched = 0
        self._ask_at_ns = None
        self._n_strikes = 0
