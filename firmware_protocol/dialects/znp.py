"""The Z-Stack dialect from the base station's end: a ZigBee network processor that speaks MT (WIRE_FORMAT.md §9).

An opening (``znp_opening``) makes the dongle a coordinator; from then on payloads go to and come from one endpoint of a profile of our own.
One synchronous request is outstanding at a time, and up to two urgent payloads and an urgent broadcast on top of it: its answer may stand
behind much that the dongle has to say. A request that is not answered makes the next one a ping, and until that is answered no other answer
counts: the dongle answers in order, so an answer that is late can never be taken for another's; an opening then begins anew, with a ping as
it always does. A payload is never written twice. Three silences in a row are the end. Every few seconds the dongle is asked whether it
still has its network.
"""

from collections import Counter, deque
from collections.abc import Generator
from dataclasses import dataclass

from firmware_protocol.dialects.interface import (
    CoordinatorIdentified,
    CoordinatorSaid,
    HostEvent,
    HostLost,
    HostOpened,
    LostWhy,
    NodeSeen,
    PayloadHeard,
    SendSettled,
)
from firmware_protocol.dialects.znp_opening import (
    Ask,
    Await,
    Came,
    Opened,
    OpeningEndedError,
    Say,
    Step,
    Write,
    ZnpHostConfig,
    open_dongle,
    permit_join,
)
from firmware_protocol.dialects.znp_statuses import radio_status_of
from firmware_protocol.dialects.znp_window import SendWindow, Unsent
from firmware_protocol.envelope import RadioReceived, RadioStatus
from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.framing.znp import ZnpDecoder, encode_frame
from firmware_protocol.messages import MAX_RADIO_PAYLOAD
from firmware_protocol.units import NS_PER_MS, NS_PER_S, RSSI_UNKNOWN, RssiDbm, ShortAddress
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.codec import Message, answered_command, command_of, decode_command, encode_command
from firmware_protocol.znp.frames import Reply, Request, ZnpFault
from firmware_protocol.znp.numbers import BIOBOT_CLUSTER, BIOBOT_ENDPOINT, Command, DeviceState, ZnpStatus

_PATIENCE_NS = 1_500 * NS_PER_MS
_N_SILENCES = 3
_PERMIT_NS = 200 * NS_PER_S
"""How often a network that is to stay open is opened again: Z-Stack closes it after 254 s at most."""
_MAX_ON_TOP = 2
"""Urgent payloads that are written though a request waits for its answer, which may stand behind much that the dongle has to say. A
broadcast may be one more: three stops, of 41 octets each, fit into the smallest buffer of a chip's serial line, 128 octets."""
_BACK_OFF_NS = 100 * NS_PER_MS
"""How long nothing is written to a dongle that had no room."""

_OPTIONS = 0x20
"""Of AF_DATA_REQUEST: find a route where none is known; no acknowledgement end to end, for the messages have their own."""
_RADIUS = 30


@dataclass(slots=True)
class _Outstanding:
    """The request that waits for its answer."""

    request: Request
    until_ns: int
    transaction: int | None = None
    """Of a payload."""
    is_alone: bool = True
    """No other request waited for its answer at the same time: a lost answer cannot be taken for another's."""


class ZnpHost:
    """See the module and ``dialects.interface.Host``.

    Parameters
    ----------
    first_handle
        Where transaction numbers begin: anywhere else than in an earlier process, so that a late confirm does not settle another payload.
    """

    def __init__(self, *, config: ZnpHostConfig | None = None, first_handle: int = 0) -> None:
        self.faults: Counter[str] = Counter()
        self.is_open = False
        self._config = config or ZnpHostConfig()
        self._decoder = ZnpDecoder()
        self._frames: list[bytes] = []
        self._opening: Generator[Step, Came, Opened] | None = None
        self._awaited: Await | None = None
        self._awaited_until_ns = 0
        self._outstanding: _Outstanding | None = None
        self._on_top: deque[_Outstanding] = deque()
        """Urgent payloads that were written before the outstanding request was answered."""
        self._n_silences = 0
        self._next_receipt = 1
        self._window = SendWindow(next_transaction=first_handle % 256)
        self._check_at_ns = 0
        self._permit_at_ns: int | None = None

    @property
    def has_frames(self) -> bool:
        """``take_frames`` has something to give now."""
        return bool(self._frames)

    def open(self, *, session: int, now_ns: int) -> list[HostEvent]:  # noqa: ARG002  # the dialect has no sessions
        """Begin with a dongle in an unknown state; what an earlier opening had not settled is forgotten."""
        self._forget_all()
        self._decoder = ZnpDecoder()
        return self._begin_opening(now_ns)

    def feed(self, chunk: bytes, *, now_ns: int) -> list[HostEvent]:
        """Take bytes from the line, cut anywhere."""
        return self._take_bodies(self._decoder.feed(chunk), now_ns=now_ns)

    def send(self, *, destination: ShortAddress, payload: bytes, now_ns: int, is_urgent: bool = False) -> int:
        """Queue a radio payload; see ``Host.send``."""
        if len(payload) > MAX_RADIO_PAYLOAD:
            raise EncodeError(field="radio payload size", value=len(payload), limit=f"at most {MAX_RADIO_PAYLOAD} bytes")
        if is_urgent:
            self._take_back_unwritten()
        ticket = self._window.add(destination=destination, payload=payload, is_urgent=is_urgent)
        self._write_next(now_ns)
        return ticket

    def forget(self, ticket: int) -> None:
        """Wait no more for what became of a payload; one that was not written yet is not sent."""
        if not self.withdraw(ticket):
            self._window.forget(ticket)

    def withdraw(self, ticket: int) -> bool:
        """Take back a payload that was not handed out; see ``Host.withdraw``."""
        self._take_back_unwritten()
        return self._window.withdraw(ticket)

    def confirm(self, receipt: int) -> None:
        """Do nothing: the dongle keeps no payload after it has handed it over."""

    def take_frames(self, *, at_most: int | None = None) -> list[bytes]:
        """Return what is to be written; see ``Host.take_frames``."""
        limit = len(self._frames) if at_most is None else at_most
        frames, self._frames = self._frames[:limit], self._frames[limit:]
        return frames

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called."""
        if self._outstanding is not None:
            return self._outstanding.until_ns
        if self._awaited is not None:
            return self._awaited_until_ns
        if not self.is_open:
            return None
        deadlines = [self._check_at_ns]
        if self._permit_at_ns is not None:
            deadlines.append(self._permit_at_ns)
        if self._window.has_unsent and (free_at_ns := self._window.free_at_ns()) is not None:
            deadlines.append(free_at_ns)
        return min(deadlines)

    def handle_deadline(self, *, now_ns: int) -> list[HostEvent]:
        """Repeat what was not answered, or give the dongle up."""
        events: list[HostEvent] = []
        if self._is_late(now_ns):
            events += self._take_bodies(self._decoder.resynchronise(), now_ns=now_ns)
        if self._opening is not None:
            events += self._opening_is_late(now_ns)
        elif self.is_open:
            events += self._answer_is_late(now_ns)
            self._write_next(now_ns)
        return events

    def _is_late(self, now_ns: int) -> bool:
        is_unanswered = self._outstanding is not None and now_ns >= self._outstanding.until_ns
        return is_unanswered or (self._awaited is not None and now_ns >= self._awaited_until_ns)

    # --- what comes in ---

    def _take_bodies(self, bodies: list[bytes | FrameFault], *, now_ns: int) -> list[HostEvent]:
        events: list[HostEvent] = []
        for body in bodies:
            if isinstance(body, FrameFault):
                self.faults[f"frame.{body.value}"] += 1
                continue
            message = decode_command(body)
            if isinstance(message, ZnpFault):
                self.faults[f"znp.{message.value}"] += 1
            elif self._opening is not None:
                events += self._take_opening(message, now_ns)
            elif self.is_open:
                events += self._take(message, now_ns)
            else:
                self.faults["znp.not_open"] += 1
        if self.is_open:
            self._write_next(now_ns)
        return events

    def _take(self, message: Message, now_ns: int) -> list[HostEvent]:
        match message:
            case znp.IncomingMessage():
                return self._hear(message)
            case znp.DataConfirm(status=status, endpoint=endpoint, transaction=transaction):
                return self._settle(transaction, status, now_ns) if endpoint == BIOBOT_ENDPOINT else []
            case znp.DeviceAnnounced(address=address, eui64=eui64) | znp.DeviceTrusted(address=address, eui64=eui64):
                return [NodeSeen(address=ShortAddress(address), eui64=eui64)]
            case znp.ResetIndication(reason=reason):
                return [self._lose(LostWhy.RESTARTED, f"it has restarted (reason {reason}: 0 power, 1 reset, 2 watchdog)")]
            case znp.StateChange(state=state) if state != DeviceState.COORDINATOR:
                return [self._lose_network(state)]
            case _ if isinstance(message, Reply):
                return self._take_answer(message, now_ns)
            case _:
                return []

    def _hear(self, message: znp.IncomingMessage) -> list[HostEvent]:
        if message.destination_endpoint != BIOBOT_ENDPOINT or message.cluster != BIOBOT_CLUSTER:
            self.faults["znp.foreign_message"] += 1
            return []
        received = RadioReceived(
            source=ShortAddress(message.source), rssi_dbm=RssiDbm(RSSI_UNKNOWN), lqi=message.lqi, payload=message.data
        )  # fmt: skip
        receipt = self._next_receipt
        self._next_receipt += 1
        return [PayloadHeard(received=received, receipt=receipt)]

    def _take_answer(self, reply: Reply, now_ns: int) -> list[HostEvent]:
        outstanding = self._outstanding
        if outstanding is None or answered_command(reply) != command_of(outstanding.request):
            self.faults["znp.unexpected_answer"] += 1
            return []
        self._outstanding = self._on_top.popleft() if self._on_top else None
        self._n_silences = 0
        if isinstance(reply, znp.NetworkInfoReply) and reply.state != DeviceState.COORDINATOR:
            return [self._lose_network(reply.state)]
        if outstanding.transaction is None:
            return []
        status = reply.status if isinstance(reply, znp.StatusReply) else int(ZnpStatus.FAILURE)
        if status == ZnpStatus.SUCCESS:
            return []
        return self._settle(outstanding.transaction, status, now_ns, is_certain=outstanding.is_alone)

    def _settle(self, transaction: int, status: int, now_ns: int, *, is_certain: bool = True) -> list[HostEvent]:
        ticket = self._window.settle(transaction)
        if ticket is None:
            self.faults["radio.unexpected_confirms"] += 1
            return []
        outcome = radio_status_of(status)
        if outcome is RadioStatus.QUEUE_FULL:
            self._window.hold(now_ns + _BACK_OFF_NS)
        return [SendSettled(ticket=ticket, status=outcome if is_certain else RadioStatus.OTHER)]

    # --- what goes out ---

    def _write_next(self, now_ns: int) -> None:
        """Write the next payload, where there is one and the dongle is ready for it; and urgent ones on top of a request."""
        while self.is_open and (
            self._outstanding is None or (self._window.has_urgent and len(self._on_top) < _MAX_ON_TOP + self._window.is_broadcast_next)
        ):
            next_one = self._window.take(now_ns)
            if next_one is None:
                return
            self._write_payload(*next_one, now_ns)

    def _write_payload(self, transaction: int, one: Unsent, now_ns: int) -> None:
        request = znp.DataRequest(
            destination=one.destination, destination_endpoint=BIOBOT_ENDPOINT, source_endpoint=BIOBOT_ENDPOINT, cluster=BIOBOT_CLUSTER,
            transaction=transaction, options=_OPTIONS, radius=_RADIUS, data=one.payload,
        )  # fmt: skip
        before, on_top = self._outstanding, list(self._on_top)
        self._ask(request, now_ns + _PATIENCE_NS, transaction=transaction)
        if before is not None and self._outstanding is not None:
            self._on_top.extend([*on_top, self._outstanding])
            self._outstanding = before
            for waiting in (before, *self._on_top):
                waiting.is_alone = False

    def _take_back_unwritten(self) -> None:
        """Let payloads whose requests were not handed out wait again."""
        while (
            self._frames and (last := self._on_top[-1] if self._on_top else self._outstanding) is not None and last.transaction is not None
        ):
            self._frames.pop()
            if self._on_top:
                self._on_top.pop()
            else:
                self._outstanding = None
            self._window.give_back(last.transaction)

    def _ask(self, request: Request, until_ns: int, *, transaction: int | None = None) -> None:
        self._outstanding = _Outstanding(request, until_ns, transaction)
        self._on_top.clear()
        self._frames.append(encode_frame(encode_command(request)))

    def _answer_is_late(self, now_ns: int) -> list[HostEvent]:
        if self._outstanding is not None and now_ns >= self._outstanding.until_ns:
            self._take_back_unwritten()  # it was the line that took nothing
        if self._outstanding is not None:
            if now_ns < self._outstanding.until_ns:
                return []
            self._n_silences += 1
            self.faults["znp.no_answer"] += 1
            if self._n_silences >= _N_SILENCES:
                name = Command(command_of(self._outstanding.request)).name
                return [self._lose(LostWhy.NO_ANSWER, f"{_N_SILENCES} requests in a row were not answered, the last one {name}")]
            self._ask(znp.PingRequest(), now_ns + _PATIENCE_NS)
        elif now_ns >= self._check_at_ns:
            self._check_at_ns = now_ns + self._config.check_ns
            self._ask(znp.NetworkInfoRequest(), now_ns + _PATIENCE_NS)
        elif self._permit_at_ns is not None and now_ns >= self._permit_at_ns:
            self._permit_at_ns = now_ns + _PERMIT_NS
            self._ask(permit_join(self._config.permit_join_s), now_ns + _PATIENCE_NS)
        return []

    # --- opening and losing ---

    def _begin_opening(self, now_ns: int) -> list[HostEvent]:
        self._outstanding = self._awaited = None
        self._frames.clear()
        self._opening = open_dongle(self._config)
        return self._advance(None, now_ns)

    def _advance(self, came: Came, now_ns: int) -> list[HostEvent]:
        """Tell the opening what came of its last step, and do its steps until one takes time."""
        events: list[HostEvent] = []
        while self._opening is not None:
            try:
                step = self._opening.send(came)
            except StopIteration as end:
                return events + self._opened(end.value, now_ns)
            except OpeningEndedError as end:
                self._n_silences += 1
                if end.why is LostWhy.NO_ANSWER and self._n_silences < _N_SILENCES:
                    return events + self._begin_opening(now_ns)
                return [*events, self._lose(end.why, end.detail)]
            came = None
            match step:
                case Ask(request=request, patience_ns=patience_ns):
                    self._ask(request, now_ns + patience_ns)
                    break
                case Await(patience_ns=patience_ns):
                    self._awaited, self._awaited_until_ns = step, now_ns + patience_ns
                    break
                case Write(data=data):
                    self._frames.append(data)
                case Say(level=level, name=name, text=text):
                    events.append(CoordinatorSaid(level=level, name=name, text=text))
        return events

    def _take_opening(self, message: Message, now_ns: int) -> list[HostEvent]:
        if self._awaited is not None and isinstance(message, self._awaited.kind):
            self._awaited = None
            return self._advance(message, now_ns)
        if isinstance(message, znp.ResetIndication):
            return self._begin_opening(now_ns)
        outstanding = self._outstanding
        if isinstance(message, Reply):
            if outstanding is not None and answered_command(message) == command_of(outstanding.request):
                self._outstanding = None
                return self._advance(message, now_ns)
            self.faults["znp.unexpected_answer"] += 1
        elif isinstance(message, znp.IncomingMessage):
            self.faults["znp.heard_while_opening"] += 1  # its sender repeats it
        return []

    def _opening_is_late(self, now_ns: int) -> list[HostEvent]:
        if not self._is_late(now_ns):
            return []
        self._outstanding = self._awaited = None
        return self._advance(None, now_ns)

    def _opened(self, opened: Opened, now_ns: int) -> list[HostEvent]:
        self._opening = None
        self.is_open = True
        self._n_silences = 0
        self._check_at_ns = now_ns + self._config.check_ns
        keeps_open = self._config.permit_join_s == 254
        self._permit_at_ns = now_ns + _PERMIT_NS if keeps_open else None
        return [HostOpened(), CoordinatorIdentified(hello=opened.hello, description=opened.description)]

    def _lose_network(self, state: int) -> HostLost:
        return self._lose(LostWhy.RESTARTED, f"it is no coordinator any more (state 0x{state:02X})")

    def _lose(self, why: LostWhy, detail: str) -> HostLost:
        return HostLost(why=why, detail=detail, dropped=self._forget_all())

    def _forget_all(self) -> tuple[int, ...]:
        """Be closed; return the tickets whose fate will not be known."""
        self._n_silences = 0
        self._frames.clear()
        self._opening = self._outstanding = self._awaited = None
        self._on_top.clear()
        self.is_open = False
        return self._window.drop_all()
