"""A host and a virtual dongle of one dialect in one memory, with a line between them that a script harms."""

import contextlib

from firmware_protocol.dialects.choice import make_host
from firmware_protocol.dialects.interface import HostEvent, HostLost, PayloadHeard
from firmware_protocol.envelope import RadioReceived, RadioStatus
from firmware_protocol.errors import LinkFullError
from firmware_protocol.messages import MAX_RADIO_PAYLOAD
from firmware_protocol.units import RssiDbm, ShortAddress
from simulator.dongles.choice import make_dongle

_MS = 1_000_000
_NODE, _EUI64 = ShortAddress(0x1234), 0x00124B00000000AA
_STATUSES = tuple(RadioStatus)


class Pair:
    """Both ends, opened; a lost host is opened again at once, as by a gateway without patience."""

    def __init__(self, dialect: str) -> None:
        self.host = make_host(dialect)
        self.dongle = make_dongle(dialect, index=0)
        self._now_ns = 0
        self._session = 0
        self.dongle.start(now_ns=0)
        self.dongle.node_joined(_NODE, eui64=_EUI64, now_ns=0)
        self.reopen()

    @property
    def is_open(self) -> bool:
        """Both ends think so."""
        return self.host.is_open and self.dongle.is_open

    def reopen(self) -> None:
        """Begin anew from the host's end."""
        self._session += 1
        self._take(self.host.open(session=self._session, now_ns=self._now_ns))

    def restart(self) -> None:
        """Switch the dongle off and on."""
        self.dongle.start(now_ns=self._now_ns)

    def step(self, for_ms: int, *, harm: bytes = b"", status: int = 0) -> None:
        """Let time pass, and carry what both ends have to say; ``harm`` is laid over the bytes in both directions, by exclusive or."""
        self._now_ns += for_ms * _MS
        due_ns = self.host.next_deadline_ns()
        if due_ns is not None and due_ns <= self._now_ns:
            self._take(self.host.handle_deadline(now_ns=self._now_ns))
        self.dongle.feed(_laid_over(b"".join(self.host.take_frames()), harm), now_ns=self._now_ns)
        due_ns = self.dongle.next_deadline_ns()
        if due_ns is not None and due_ns <= self._now_ns:
            self.dongle.handle_deadline(now_ns=self._now_ns)
        while self.dongle.requests:
            self.dongle.confirm(self.dongle.requests.popleft().handle, _STATUSES[status % len(_STATUSES)], now_ns=self._now_ns)
        self.to_host(_laid_over(self.dongle.take_bytes(), harm))

    def to_host(self, data: bytes) -> None:
        """Let the host hear bytes."""
        self._take(self.host.feed(data, now_ns=self._now_ns))

    def to_dongle(self, data: bytes) -> None:
        """Let the dongle hear bytes."""
        self.dongle.feed(data, now_ns=self._now_ns)

    def offer(self, payload: bytes) -> None:
        """Let the dongle hear a payload from the air."""
        received = RadioReceived(source=_NODE, rssi_dbm=RssiDbm(-60), lqi=90, payload=payload[:MAX_RADIO_PAYLOAD])
        self.dongle.take_from_radio(received, eui64=_EUI64, now_ns=self._now_ns)

    def send(self, payload: bytes) -> None:
        """Send a payload to a node that is there, or to one that is not."""
        destination = _NODE if len(payload) % 2 else ShortAddress(0x4321)
        with contextlib.suppress(LinkFullError):
            self.host.send(destination=destination, payload=payload[:MAX_RADIO_PAYLOAD], now_ns=self._now_ns)

    def recovers(self, *, within_s: int = 300, patience_s: int = 60) -> bool:
        """Let an unharmed line carry until both ends are open; as a gateway does, the host is opened anew after some patience."""
        for step in range(2 * within_s):
            if self.is_open:
                return True
            if step % (2 * patience_s) == 2 * patience_s - 1:
                self.reopen()
            self.step(500)
        return False

    def _take(self, events: list[HostEvent]) -> None:
        for event in events:
            if isinstance(event, PayloadHeard):
                self.host.confirm(event.receipt)
            elif isinstance(event, HostLost):
                self.reopen()


def _laid_over(data: bytes, harm: bytes) -> bytes:
    if not harm or not data:
        return data
    size = len(data)
    mask = (harm + bytes(max(0, size - len(harm))))[:size]
    return bytes(one ^ other for one, other in zip(data, mask, strict=True))
