"""A virtual coordinator dongle of the native dialect (WIRE_FORMAT.md §2 to §4), in some framing. No I/O, no clock.

Its memory is bounded. Uplink payloads wait in the link's queue until the base station confirms them; when that is full, while
no base station is there or its disk stalls, the coordinator takes no more, and the backpacks keep what they have.
"""

from collections import Counter, deque
from dataclasses import dataclass, field, replace

from firmware_protocol.dialects.native import COBS, Framing
from firmware_protocol.envelope import (
    LEAVE_CHANNEL,
    LEAVE_JOINING,
    LEAVE_PAN_ID,
    ConfigureCoordinator,
    CoordinatorConfigured,
    CoordinatorHello,
    Envelope,
    EnvelopeFault,
    IdentifyRequest,
    NodeJoined,
    RadioConfirm,
    RadioReceived,
    RadioSend,
    RadioStatus,
    decode_envelope,
    encode_envelope,
)
from firmware_protocol.errors import LinkFullError
from firmware_protocol.framing.interface import FrameDecoder, FrameFault
from firmware_protocol.link import Link, LinkConfig, LinkEvent, LinkOpened, LinkState, PayloadReceived, Role
from firmware_protocol.messages import MAX_RADIO_PAYLOAD
from firmware_protocol.units import NS_PER_S, ShortAddress

_CHANNELS = range(11, 27)  # of IEEE 802.15.4 at 2.4 GHz
_JOINING_FOR_EVER = 254
_DONE, _BAD_PARAMETER = 0, 1

_RADIO_QUEUE = 64
_RESERVE = _RADIO_QUEUE + 16
"""Places in the link's queue that uplink payloads leave to confirmations: one for each payload in the radio's queue and each
that the base station may have in its window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NativeDongleConfig:
    """What the coordinator says of itself; the EUI-64 begins with Texas Instruments' number."""

    firmware: int = 0x0001
    eui64: int = 0x00124B0000000000
    pan_id: int = 0xB10B
    channel: int = 20
    link: LinkConfig = field(default_factory=lambda: LinkConfig(max_queue=512))


@dataclass(slots=True, kw_only=True)
class NativeDongle:
    """See the module. ``requests`` are what the base station wants sent; each must be answered with ``confirm``."""

    config: NativeDongleConfig = field(default_factory=NativeDongleConfig)
    framing: Framing = COBS
    requests: deque[RadioSend] = field(default_factory=deque)
    faults: Counter[str] = field(default_factory=Counter)
    """What came in and was of no use, and what had no room, by name."""
    _link: Link = field(init=False)
    _decoder: FrameDecoder = field(init=False)
    _n_in_radio: int = 0
    _joining_until_ns: int | None = 0
    """When the network closes to new nodes; None: never."""
    _has_said_hello: bool = False

    def __post_init__(self) -> None:
        self._link = Link(role=Role.RESPONDER, config=self.config.link)
        self._decoder = self.framing.make_decoder()

    @property
    def is_open(self) -> bool:
        """A base station is connected."""
        return self._link.state is LinkState.OPEN

    def start(self, *, now_ns: int) -> None:  # noqa: ARG002  # the interface's
        """Switch the coordinator on, with empty memory: it asks for a session."""
        self._link = Link(role=Role.RESPONDER, config=self.config.link)
        self._decoder = self.framing.make_decoder()
        self.requests.clear()
        self._n_in_radio = 0
        self._has_said_hello = False
        self._link.announce_restart()

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        """Take bytes from the serial line, cut anywhere."""
        for body in self._decoder.feed(chunk):
            if isinstance(body, FrameFault):
                self.faults[body.value] += 1
            else:
                self._handle(self._link.receive(body, now_ns=now_ns), now_ns=now_ns)

    def take_bytes(self) -> bytes:
        """Return what is to go out over the serial line; each byte is handed out once."""
        return b"".join(self.framing.encode(body) for body in self._link.take_frames())

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called, or None."""
        return self._link.next_deadline_ns()

    def handle_deadline(self, *, now_ns: int) -> None:
        """Repeat what was not answered, or give the session up."""
        self._handle(self._link.handle_deadline(now_ns=now_ns), now_ns=now_ns)

    def take_from_radio(self, received: RadioReceived, *, eui64: int, now_ns: int) -> bool:  # noqa: ARG002  # the interface's
        """Take a payload from the air; return False, and take nothing, where there is no room."""
        if self._link.n_free <= _RESERVE:
            self.faults["uplink_full"] += 1
            return False
        self._send(received, now_ns=now_ns)
        return True

    def confirm(self, handle: int, status: RadioStatus, *, now_ns: int) -> None:
        """Tell the base station what became of a request; the request leaves the radio's queue."""
        self._n_in_radio -= 1
        self._send(RadioConfirm(handle=handle, status=status), now_ns=now_ns)

    def configure(self, request: ConfigureCoordinator, *, now_ns: int) -> CoordinatorConfigured:
        """Set the network as asked, all of it or nothing, and return what is in force (§4.7, §4.8)."""
        is_good = request.channel == LEAVE_CHANNEL or request.channel in _CHANNELS
        if is_good:
            pan_id = self.config.pan_id if request.pan_id == LEAVE_PAN_ID else request.pan_id
            channel = self.config.channel if request.channel == LEAVE_CHANNEL else request.channel
            self.config = replace(self.config, pan_id=pan_id, channel=channel)
            if request.permit_join_s == _JOINING_FOR_EVER:
                self._joining_until_ns = None
            elif request.permit_join_s != LEAVE_JOINING:
                self._joining_until_ns = now_ns + request.permit_join_s * NS_PER_S
        left_s = _JOINING_FOR_EVER if self._joining_until_ns is None else max(0, -((now_ns - self._joining_until_ns) // NS_PER_S))
        return CoordinatorConfigured(
            token=request.token,
            result=_DONE if is_good else _BAD_PARAMETER,
            pan_id=self.config.pan_id,
            channel=self.config.channel,
            permit_join_s=left_s,
        )

    def node_joined(self, address: ShortAddress, *, eui64: int, now_ns: int) -> None:
        """Tell the base station, if there is one; it need not know, for every payload says who sent it."""
        if self.is_open and self._link.n_free > _RESERVE:
            self._send(NodeJoined(address=address, eui64=eui64), now_ns=now_ns)

    def _handle(self, events: list[LinkEvent], *, now_ns: int) -> None:
        for event in events:
            if isinstance(event, LinkOpened):
                if not self._has_said_hello:
                    self._say_hello(now_ns)
            elif isinstance(event, PayloadReceived):
                self._obey(decode_envelope(event.payload), now_ns=now_ns)
                # Nothing here outlives a power cut, so there is nothing to wait for.
                self._link.confirm(event.receipt)

    def _obey(self, envelope: Envelope | EnvelopeFault, *, now_ns: int) -> None:
        match envelope:
            case IdentifyRequest():
                self._say_hello(now_ns)
            case RadioSend(handle=handle) if len(envelope.payload) > MAX_RADIO_PAYLOAD:
                self._send(RadioConfirm(handle=handle, status=RadioStatus.TOO_LONG), now_ns=now_ns)
            case RadioSend(handle=handle) if self._n_in_radio >= _RADIO_QUEUE:
                self._send(RadioConfirm(handle=handle, status=RadioStatus.QUEUE_FULL), now_ns=now_ns)
            case RadioSend():
                self._n_in_radio += 1
                self.requests.append(envelope)
            case ConfigureCoordinator():
                self._send(self.configure(envelope, now_ns=now_ns), now_ns=now_ns)
            case EnvelopeFault():
                self.faults[envelope.value] += 1
            case _:
                self.faults["wrong_direction"] += 1

    def _say_hello(self, now_ns: int) -> None:
        hello = CoordinatorHello(
            firmware=self.config.firmware, eui64=self.config.eui64, pan_id=self.config.pan_id, channel=self.config.channel,
            max_radio_payload=MAX_RADIO_PAYLOAD,
        )  # fmt: skip
        self._send(hello, now_ns=now_ns)
        self._has_said_hello = True

    def _send(self, envelope: Envelope, *, now_ns: int) -> None:
        try:
            self._link.send(encode_envelope(envelope), now_ns=now_ns)
        except LinkFullError:
            # Only a base station that sends requests and acknowledges nothing gets here.
            self.faults["answer_lost"] += 1
