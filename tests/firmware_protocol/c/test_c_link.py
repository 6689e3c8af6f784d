"""The C link on a wire that loses frames: C at both ends, and C with Python at either."""

from dataclasses import dataclass, field
from typing import Protocol

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.link import Link, LinkConfig, LinkLost, LinkOpened, PayloadConfirmed, PayloadReceived, Role
from firmware_protocol.link import LinkEvent as PythonEvent
from studies.c_link import CLink, LinkEvent, LinkEventKind
from studies.c_wire import Wire

MS = 1_000_000
CLOCK_WRAPS_SOON = 2**32 - 5_000


class End(Protocol):
    """One end of the wire, in either language; what it received and what of its own was confirmed is noted."""

    received: list[bytes]
    confirmed: list[int]

    def open(self, session: int, now_ms: int) -> None: ...
    def send(self, payload: bytes, now_ms: int) -> None: ...
    def receive(self, frame: bytes, now_ms: int) -> None: ...
    def take_frames(self, now_ms: int) -> list[bytes]: ...
    def poll(self, now_ms: int) -> None: ...


@dataclass
class PythonEnd:
    role: Role
    link: Link = field(init=False)
    received: list[bytes] = field(default_factory=list)
    confirmed: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.link = Link(role=self.role, config=LinkConfig())

    def open(self, session: int, now_ms: int) -> None:
        self.link.open(session=session, now_ns=now_ms * MS)

    def send(self, payload: bytes, now_ms: int) -> None:
        self.link.send(payload, now_ns=now_ms * MS)

    def receive(self, frame: bytes, now_ms: int) -> None:
        self._note(self.link.receive(frame, now_ns=now_ms * MS))

    def take_frames(self, now_ms: int) -> list[bytes]:  # noqa: ARG002  # the other language's needs it
        return self.link.take_frames()

    def poll(self, now_ms: int) -> None:
        self._note(self.link.handle_deadline(now_ns=now_ms * MS))

    def _note(self, events: list[PythonEvent]) -> None:
        for event in events:
            match event:
                case PayloadReceived(payload=payload, receipt=receipt):
                    self.received.append(payload)
                    self.link.confirm(receipt)
                case PayloadConfirmed(ticket=ticket):
                    self.confirmed.append(ticket)
                case LinkOpened() | LinkLost():
                    pass


@dataclass
class CEnd:
    wire: Wire
    role: Role
    queue_size: int = 16_384
    link: CLink = field(init=False)
    received: list[bytes] = field(default_factory=list)
    confirmed: list[int] = field(default_factory=list)
    n_sent: int = 0

    def __post_init__(self) -> None:
        self.link = CLink(self.wire, is_initiator=self.role is Role.INITIATOR, queue_size=self.queue_size)

    def open(self, session: int, now_ms: int) -> None:
        self.link.open(session=session, now_ms=now_ms & 0xFFFF_FFFF)

    def send(self, payload: bytes, now_ms: int) -> None:  # noqa: ARG002  # the other language's needs it
        self.n_sent += 1
        assert self.link.send(payload, tag=self.n_sent)

    def receive(self, frame: bytes, now_ms: int) -> None:
        self._note(self.link.receive(frame, now_ms=now_ms & 0xFFFF_FFFF))

    def take_frames(self, now_ms: int) -> list[bytes]:
        return self.link.take_frames(now_ms=now_ms & 0xFFFF_FFFF)

    def poll(self, now_ms: int) -> None:
        self._note(self.link.poll(now_ms=now_ms & 0xFFFF_FFFF))

    def _note(self, event: LinkEvent) -> None:
        if event.kind is LinkEventKind.PAYLOAD:
            self.received.append(event.payload)
            self.link.confirm(event.receipt)
        self.confirmed += event.tags


@dataclass
class Line:
    """Joins two ends, loses the frames it is told to lose; time passes in steps of 50 ms, and the clock of 32 bits wraps on the way."""

    base: End
    dongle: End
    losses: list[bool] = field(default_factory=list)
    now_ms: int = CLOCK_WRAPS_SOON

    def run(self, steps: int) -> None:
        for _ in range(steps):
            self.now_ms += 50
            self.base.poll(self.now_ms)
            self.dongle.poll(self.now_ms)
            for _ in range(3):
                self.carry(self.base, self.dongle)
                self.carry(self.dongle, self.base)

    def carry(self, sender: End, receiver: End) -> None:
        for frame in sender.take_frames(self.now_ms):
            if not (self.losses and self.losses.pop(0)):
                receiver.receive(frame, self.now_ms)


def ends(wire: Wire, languages: str) -> tuple[End, End]:
    """Make base station and dongle, each of its language."""
    base: End = PythonEnd(Role.INITIATOR) if languages.startswith("Python") else CEnd(wire, Role.INITIATOR)
    dongle: End = PythonEnd(Role.RESPONDER) if languages.endswith("Python") else CEnd(wire, Role.RESPONDER)
    return base, dongle


everyone = pytest.mark.parametrize("languages", ["Python to C", "C to C", "C to Python"])


@everyone
@given(losses=st.lists(st.integers(0, 9).map(lambda n: n < 3), max_size=200), n_up=st.integers(0, 40), n_down=st.integers(0, 40))
def test_everything_arrives_once_and_in_order_whatever_is_lost(
    wire: Wire, languages: str, losses: list[bool], n_up: int, n_down: int
) -> None:
    """A session that is given up is opened again by its owner; that is not this law's business, so no more than four in a row are lost."""
    for at in range(len(losses) - 4):
        if all(losses[at : at + 5]):
            losses[at + 4] = False
    base, dongle = ends(wire, languages)
    line = Line(base=base, dongle=dongle, losses=losses)
    base.open(7, line.now_ms)
    up = [b"u%d" % i for i in range(n_up)]
    down = [b"d%d" % i for i in range(n_down)]
    for payload in up:
        dongle.send(payload, line.now_ms)
    line.run(5)
    for payload in down:
        base.send(payload, line.now_ms)

    line.run(400)

    assert dongle.received == down
    assert base.received == up
    assert base.confirmed == [*range(1, n_down + 1)]
    assert dongle.confirmed == [*range(1, n_up + 1)]


@everyone
def test_more_than_256_payloads_keep_their_order(wire: Wire, languages: str) -> None:
    base, dongle = ends(wire, languages)
    line = Line(base=base, dongle=dongle)
    base.open(1, line.now_ms)
    sent = [i.to_bytes(2, "big") for i in range(700)]
    for start in range(0, 700, 100):
        for payload in sent[start : start + 100]:
            dongle.send(payload, line.now_ms)
        line.run(10)

    assert base.received == sent


@everyone
def test_what_the_dongle_heard_survives_a_new_session(wire: Wire, languages: str) -> None:
    base, dongle = ends(wire, languages)
    line = Line(base=base, dongle=dongle)
    base.open(1, line.now_ms)
    line.run(2)
    line.losses = [True] * 1000
    dongle.send(b"heard", line.now_ms)
    line.run(2)
    line.losses = []

    base.open(2, line.now_ms)
    line.run(5)

    assert base.received == [b"heard"]


@given(st.lists(st.tuples(st.binary(max_size=20), st.booleans()), max_size=30), st.integers(16, 300))
def test_a_ring_that_is_full_takes_nothing_and_loses_nothing(wire: Wire, said: list[tuple[bytes, bool]], queue_size: int) -> None:
    """What was taken arrives: urgent payloads first, the newest of them in front; the others in their order."""
    base, dongle = CEnd(wire, Role.INITIATOR, queue_size=queue_size), CEnd(wire, Role.RESPONDER)
    line = Line(base=base, dongle=dongle)
    base.open(1, line.now_ms)
    taken: list[bytes] = []
    used = 0
    for payload, is_urgent in said:
        fits = used + len(payload) + 3 <= queue_size
        assert base.link.send(payload, is_urgent=is_urgent) is fits
        if fits:
            used += len(payload) + 3
            taken.insert(0 if is_urgent else len(taken), payload)

    line.run(10)

    assert dongle.received == taken
