"""The native dialect from the base station's end: link frames (WIRE_FORMAT.md §3) that carry envelopes (§4) in some framing.

The framing is an argument: COBS on a serial line (§2), CAN frames on a bus.
"""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace

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
from firmware_protocol.envelope import (
    CoordinatorHello,
    CoordinatorLog,
    EnvelopeFault,
    IdentifyRequest,
    NodeJoined,
    RadioConfirm,
    RadioReceived,
    RadioSend,
    decode_envelope,
    encode_envelope,
)
from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.framing.interface import FrameDecoder, FrameFault
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
from firmware_protocol.messages import MAX_RADIO_PAYLOAD
from firmware_protocol.units import BROADCAST, ShortAddress

_WINDOW = 4
"""DATA frames in flight towards the dongle: few, so that an urgent one does not stand behind many on the line. It waits for none of them:
the link's own window is wider."""

_N_HANDLES = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """How link frames stand on the line."""

    make_decoder: Callable[[], FrameDecoder]
    encode: Callable[[bytes], bytes]


COBS = Framing(make_decoder=CobsDecoder, encode=encode_frame)


class NativeHost:
    """See the module and ``dialects.interface.Host``.

    Parameters
    ----------
    framing
        How link frames stand on the line.
    first_handle
        Where the handles of RadioSend begin: anywhere else than in an earlier process, because a RadioConfirm that the dongle kept from
        before a restart must not settle another payload.
    idle_ns
        After how much silence the dongle is asked whether it is there; None: as in WIRE_FORMAT.md §3.4.
    """

    def __init__(self, *, framing: Framing = COBS, first_handle: int = 0, idle_ns: int | None = None) -> None:
        self.faults: Counter[str] = Counter()
        self._framing = framing
        self._next_handle = first_handle % _N_HANDLES
        config = LinkConfig(window=_WINDOW)
        self._link = Link(role=Role.INITIATOR, config=config if idle_ns is None else replace(config, keepalive_ns=idle_ns))
        self._decoder = framing.make_decoder()
        self._pending: dict[int, int] = {}
        """Ticket of each payload whose RadioConfirm has not come, by its handle."""
        self._unconfirmed: deque[int] = deque()
        """Receipts of payloads heard that wait for ``confirm``."""
        self._newest_receipt = self._confirmed_receipt = 0
        self._n_ignored = 0

    @property
    def is_open(self) -> bool:
        """Payloads can be sent now."""
        return self._link.state is LinkState.OPEN

    @property
    def has_frames(self) -> bool:
        """``take_frames`` has something to give now."""
        return self._link.has_frames or self._safe_receipt > self._confirmed_receipt

    def open(self, *, session: int, now_ns: int) -> list[HostEvent]:
        """Begin a session under a number the last one did not have."""
        self._decoder = self._framing.make_decoder()
        self._pending.clear()
        self._forget_receipts()
        self._link.open(session=session, now_ns=now_ns)  # what it drops was pending, and that is forgotten
        return []

    def feed(self, chunk: bytes, *, now_ns: int) -> list[HostEvent]:
        """Take bytes from the line, cut anywhere."""
        events: list[HostEvent] = []
        for body in self._decoder.feed(chunk):
            if isinstance(body, FrameFault):
                self.faults[f"frame.{body.value}"] += 1
            else:
                events += self._take(self._link.receive(body, now_ns=now_ns), now_ns=now_ns)
        if self._link.n_ignored > self._n_ignored:
            self.faults["link.ignored"] += self._link.n_ignored - self._n_ignored
            self._n_ignored = self._link.n_ignored
        return events

    def send(self, *, destination: ShortAddress, payload: bytes, now_ns: int, is_urgent: bool = False) -> int:
        """Queue a radio payload; see ``Host.send``."""
        if len(payload) > MAX_RADIO_PAYLOAD:
            raise EncodeError(field="radio payload size", value=len(payload), limit=f"at most {MAX_RADIO_PAYLOAD} bytes")
        handle = self._take_handle()
        body = encode_envelope(RadioSend(handle=handle, destination=destination, payload=payload))
        is_first = is_urgent and destination == BROADCAST
        ticket = self._link.send(body, now_ns=now_ns, is_urgent=is_urgent, is_first=is_first)
        self._pending[handle] = ticket
        return ticket

    def forget(self, ticket: int) -> None:
        """Wait no more for what became of a payload; one that was not written yet is not sent."""
        self._link.cancel(ticket)
        for handle in [handle for handle, pending in self._pending.items() if pending == ticket]:
            del self._pending[handle]

    def withdraw(self, ticket: int) -> bool:
        """Take back a payload that was not handed out; see ``Host.withdraw``."""
        if not self._link.cancel(ticket):
            return False
        self.forget(ticket)
        return True

    def confirm(self, receipt: int) -> None:
        """Let the dongle forget all payloads up to and including ``receipt``."""
        while self._unconfirmed and self._unconfirmed[0] <= receipt:
            self._unconfirmed.popleft()

    def take_frames(self, *, at_most: int | None = None) -> list[bytes]:
        """Return what is to be written; see ``Host.take_frames``. All that was confirmed since the last call shares one ACK."""
        if (safe := self._safe_receipt) > self._confirmed_receipt:
            self._confirmed_receipt = safe
            self._link.confirm(safe)
        return [self._framing.encode(body) for body in self._link.take_frames(at_most=at_most)]

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called."""
        return self._link.next_deadline_ns()

    def handle_deadline(self, *, now_ns: int) -> list[HostEvent]:
        """Repeat what was not answered, or give the dongle up."""
        return self._take(self._link.handle_deadline(now_ns=now_ns), now_ns=now_ns)

    @property
    def _safe_receipt(self) -> int:
        return self._unconfirmed[0] - 1 if self._unconfirmed else self._newest_receipt

    def _take(self, events: list[LinkEvent], *, now_ns: int) -> list[HostEvent]:
        taken: list[HostEvent] = []
        for event in events:
            match event:
                case PayloadReceived(payload=payload, receipt=receipt):
                    self._newest_receipt = receipt
                    self._read(payload, receipt=receipt, into=taken)
                case PayloadConfirmed():
                    pass
                case LinkOpened():
                    self._forget_receipts()
                    self._link.send(encode_envelope(IdentifyRequest()), now_ns=now_ns)
                    taken.append(HostOpened())
                case LinkLost(reason=reason):
                    taken.append(self._lose(reason))
        return taken

    def _read(self, payload: bytes, *, receipt: int, into: list[HostEvent]) -> None:
        envelope = decode_envelope(payload)
        match envelope:
            case RadioReceived():
                self._unconfirmed.append(receipt)
                into.append(PayloadHeard(received=envelope, receipt=receipt))
            case RadioConfirm(handle=handle, status=status):
                ticket = self._pending.pop(handle, None)
                if ticket is None:
                    self.faults["radio.unexpected_confirms"] += 1
                else:
                    into.append(SendSettled(ticket=ticket, status=status))
            case CoordinatorHello(firmware=firmware):
                into.append(CoordinatorIdentified(hello=envelope, description=f"native firmware {firmware >> 8}.{firmware & 0xFF}"))
            case CoordinatorLog(level=level, code=code, text=text):
                into.append(CoordinatorSaid(level=level, name=f"firmware.{code}", text=text))
            case NodeJoined(address=address, eui64=eui64):
                into.append(NodeSeen(address=address, eui64=eui64))
            case EnvelopeFault():
                self.faults[f"envelope.{envelope.value}"] += 1
            case _:
                self.faults["envelope.unexpected"] += 1

    def _lose(self, reason: LostReason) -> HostLost:
        tickets = tuple(self._pending.values())
        self._pending.clear()
        self._forget_receipts()
        if reason is LostReason.NO_ANSWER:
            return HostLost(why=LostWhy.NO_ANSWER, detail="the dongle does not answer", dropped=tickets)
        if reason is LostReason.NO_PROGRESS:
            return HostLost(why=LostWhy.NO_ANSWER, detail="the dongle talks, but acknowledges nothing", dropped=tickets)
        return HostLost(why=LostWhy.RESTARTED, detail="the dongle restarted", dropped=tickets)

    def _forget_receipts(self) -> None:
        self._unconfirmed.clear()
        self._confirmed_receipt = self._newest_receipt

    def _take_handle(self) -> int:
        while self._next_handle in self._pending:
            self._next_handle = (self._next_handle + 1) % _N_HANDLES
        handle = self._next_handle
        self._next_handle = (handle + 1) % _N_HANDLES
        return handle
