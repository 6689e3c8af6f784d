"""Configures a coordinator of the native dialect over its link: a session for one question (WIRE_FORMAT.md §4.7). No I/O, no clock.

What the dongle reports meanwhile is acknowledged to it and dropped. Nothing is lost by that: a backpack keeps a message until the base
station's own Acknowledge comes to it (§5.1), and none is sent here.
"""

from collections import deque

from firmware_protocol.dialects.native import COBS, Framing
from firmware_protocol.envelope import ConfigureCoordinator, CoordinatorConfigured, decode_envelope, encode_envelope
from firmware_protocol.link import Link, LinkEvent, LinkLost, LinkOpened, PayloadReceived, Role

_MAX_FAULTS = 8


class Configurator:
    """See the module. ``answer`` is None until there is one.

    Parameters
    ----------
    session
        A number that the dongle's last session did not have; where the session is lost, the next number is tried.
    """

    def __init__(self, request: ConfigureCoordinator, *, session: int, now_ns: int, framing: Framing = COBS) -> None:
        self.answer: CoordinatorConfigured | None = None
        self.faults: deque[str] = deque(maxlen=_MAX_FAULTS)
        self._request = request
        self._framing = framing
        self._decoder = framing.make_decoder()
        self._link = Link(role=Role.INITIATOR)
        self._session = session
        self._link.open(session=session, now_ns=now_ns)

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        """Take bytes from the line."""
        for body in self._decoder.feed(chunk):
            if isinstance(body, bytes):
                self._take(self._link.receive(body, now_ns=now_ns), now_ns=now_ns)

    def take_frames(self) -> list[bytes]:
        """Return what is to be written."""
        return [self._framing.encode(body) for body in self._link.take_frames()]

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called."""
        return self._link.next_deadline_ns()

    def handle_deadline(self, *, now_ns: int) -> None:
        """Repeat what was not answered."""
        self._take(self._link.handle_deadline(now_ns=now_ns), now_ns=now_ns)

    def _take(self, events: list[LinkEvent], *, now_ns: int) -> None:
        for event in events:
            match event:
                case LinkOpened():
                    self._link.send(encode_envelope(self._request), now_ns=now_ns)
                case PayloadReceived(payload=payload, receipt=receipt):
                    answer = decode_envelope(payload)
                    if isinstance(answer, CoordinatorConfigured) and answer.token == self._request.token:
                        self.answer = answer
                    self._link.confirm(receipt)
                case LinkLost(reason=reason):
                    self.faults.append(f"the link was lost ({reason.value})")
                    self._session = (self._session + 1) % (1 << 16)
                    self._link.open(session=self._session, now_ns=now_ns)
                case _:
                    pass
