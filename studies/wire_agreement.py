"""Whether the Python and the C side of the wire say the same of the same input: None, or what each of them says."""

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from firmware_protocol.crc import append_crc
from firmware_protocol.envelope import EnvelopeFault, decode_envelope
from firmware_protocol.framing.cobs import CobsDecoder
from firmware_protocol.layouts import (
    CARRIER_LAYOUTS,
    DOWNLINK_HEADER,
    DOWNLINK_LAYOUTS,
    ENVELOPE_LAYOUTS,
    UPLINK_HEADER,
    UPLINK_LAYOUTS,
    Layout,
)
from firmware_protocol.link import Link, LinkConfig, LinkLost, LinkOpened, LostReason, PayloadConfirmed, PayloadReceived, Role
from firmware_protocol.link import LinkEvent as PythonEvent
from firmware_protocol.message_codec import decode_downlink, decode_uplink_fields
from firmware_protocol.messages import MessageFault
from studies.c_link import CLink, LinkEvent, LinkEventKind
from studies.c_wire import Decoded, Wire

_UPLINKS = {layout.kind: layout for layout in UPLINK_LAYOUTS}
_DOWNLINKS = {layout.name: layout for layout in DOWNLINK_LAYOUTS}
_ENVELOPES = {layout.name: layout for layout in (*ENVELOPE_LAYOUTS, *CARRIER_LAYOUTS)}
_REASONS = (LostReason.NO_ANSWER, LostReason.PEER_RESTARTED, LostReason.PEER_RESET, LostReason.NO_PROGRESS)
_NS_PER_MS = 1_000_000
_DATA = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Disagreement:
    """An input, and what each side says of it."""

    subject: str
    given: object
    python: object
    c: object

    def __str__(self) -> str:
        """Say it in three lines."""
        return f"{self.subject}: given {self.given}\n  Python: {self.python}\n  C:      {self.c}"


def compare_uplink(wire: Wire, payload: bytes) -> Disagreement | None:
    """Decode a radio payload from a backpack on both sides, and write it again in C."""
    python = decode_uplink_fields(payload)
    c = wire.decode_uplink(payload)
    if python != c:
        return Disagreement(subject="uplink", given=payload.hex(), python=python, c=c)
    return None if isinstance(python, MessageFault) else _compare_again(wire, payload, _UPLINKS[python[0][0]], python)


def compare_downlink(wire: Wire, payload: bytes) -> Disagreement | None:
    """Decode a radio payload from the base station on both sides, and write it again in C."""
    read = decode_downlink(payload)
    c = wire.decode_downlink(payload)
    if isinstance(read, MessageFault):
        return None if read is c else Disagreement(subject="downlink", given=payload.hex(), python=read, c=c)
    sequence, message = read
    layout = _DOWNLINKS[type(message).__name__]
    assert layout.kind is not None, "only headers have no type byte"
    python: Decoded = (layout.kind, 1, sequence), tuple(int(getattr(message, field.name)) for field in layout.fields), ()
    if python != c:
        return Disagreement(subject="downlink", given=payload.hex(), python=python, c=c)
    return _compare_again(wire, payload, layout, python)


def compare_envelope(wire: Wire, body: bytes) -> Disagreement | None:
    """Decode a link payload on both sides, and write it again in C."""
    envelope = decode_envelope(body)
    c = wire.decode_envelope(body)
    if isinstance(envelope, EnvelopeFault) or isinstance(c, EnvelopeFault):
        return None if envelope is c else Disagreement(subject="envelope", given=body.hex(), python=envelope, c=c)
    layout = _ENVELOPES[type(envelope).__name__]
    assert layout.kind is not None, "only headers have no type byte"
    values = tuple(int(getattr(envelope, field.name)) for field in layout.fields)
    rest = getattr(envelope, "payload", getattr(envelope, "text", ()))
    shown = c[2].decode(errors="replace") if layout.text_limit is not None and isinstance(c[2], bytes) else c[2]
    if ((layout.kind,), values, rest) != (*c[:2], shown):
        return Disagreement(subject="envelope", given=body.hex(), python=envelope, c=c)
    canonical = bytes([layout.kind]) + _pack(layout, c)
    again = wire.encode_again("envelope")
    return None if again == canonical else Disagreement(subject="envelope again", given=body.hex(), python=canonical.hex(), c=again.hex())


def compare_stream(wire: Wire, chunks: Sequence[bytes]) -> Disagreement | None:
    """Cut a stream into frames on both sides; Python gets it in chunks."""
    decoder = CobsDecoder()
    python = [result for chunk in chunks for result in decoder.feed(chunk)]
    c = wire.frame_decoder().feed(b"".join(chunks))
    return None if python == c else Disagreement(subject="stream", given=[chunk.hex() for chunk in chunks], python=python, c=c)


def _compare_again(wire: Wire, payload: bytes, layout: Layout, read: Decoded) -> Disagreement | None:
    group, header = ("uplink", UPLINK_HEADER) if layout in UPLINK_LAYOUTS else ("downlink", DOWNLINK_HEADER)
    canonical = append_crc(header.packing.pack(*read[0]) + _pack(layout, read))
    again = wire.encode_again(group)
    return (
        None if again == canonical else Disagreement(subject=f"{group} again", given=payload.hex(), python=canonical.hex(), c=again.hex())
    )


def _pack(layout: Layout, read: Decoded) -> bytes:
    """Write a message by the table, with every field that may be left out, and nothing after the last."""
    fields = layout.packing.pack(*read[1])
    rest = read[2]
    return fields + (rest if isinstance(rest, bytes) else b"".join(layout.entry_packing.pack(*entry) for entry in rest))


# --- links ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Wait:
    """Let time pass, and do what is due."""

    ms: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Hear:
    """Take a frame body. ``session`` and ``sequence`` are counted from those of the link, so that most are of use."""

    kind: int
    session: int
    sequence: int
    payload: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Garbage:
    """Take bytes that need be no link frame."""

    body: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Say:
    """Queue a payload."""

    payload: bytes
    is_urgent: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirm:
    """Acknowledge all but so many of the payloads received."""

    but: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Open:
    """Begin a session (initiator)."""


Operation: TypeAlias = Wait | Hear | Garbage | Say | Confirm | Open


def compare_links(wire: Wire, operations: Iterable[Operation], *, is_initiator: bool, start_ms: int = 0) -> Disagreement | None:
    """Do the same to a Python and a C link: each operation brings about the same events, and the same frames to be sent."""
    return _LinkPair(wire, is_initiator=is_initiator, now_ms=start_ms).run(operations)


class _LinkPair:
    """A Python and a C link that are treated alike. Receipts of the two count from different numbers, so each has its own list."""

    def __init__(self, wire: Wire, *, is_initiator: bool, now_ms: int) -> None:
        self._is_initiator = is_initiator
        self._python = Link(role=Role.INITIATOR if is_initiator else Role.RESPONDER, config=LinkConfig(max_queue=1 << 30))
        self._c = CLink(wire, is_initiator=is_initiator, queue_size=32767)
        self._now_ms = now_ms
        self._session = 0
        self._python_receipts: list[int] = []
        self._c_receipts: list[int] = []
        self._next_sequence = 0
        self._n_sent = 0

    def run(self, operations: Iterable[Operation]) -> Disagreement | None:
        done: list[Operation] = []
        for operation in operations:
            done.append(operation)
            python, c = self._do(operation)
            frames = self._python.take_frames(), self._c.take_frames(now_ms=self._now_ms & 0xFFFF_FFFF)
            if python != c or sorted(set(frames[0])) != sorted(frames[1]) or self._deadlines_differ():
                return Disagreement(
                    subject="link", given=done, python=(python, frames[0], self._python.next_deadline_ns()), c=(c, frames[1])
                )
        return None

    def _do(self, operation: Operation) -> tuple[object, object]:
        now = {"now_ns": self._now_ms * _NS_PER_MS}
        match operation:
            case Wait(ms=ms):
                self._now_ms += ms
                python = self._python.handle_deadline(now_ns=self._now_ms * _NS_PER_MS)
                return self._note(python, self._c.poll(now_ms=self._now_ms & 0xFFFF_FFFF))
            case Hear(kind=kind, session=session, sequence=sequence, payload=payload):
                number = (self._next_sequence if kind == _DATA else self._python._first_unacknowledged) + sequence  # noqa: SLF001
                body = struct.pack("<BHB", kind, (self._session + session) & 0xFFFF, number & 0xFF) + payload
                return self._receive(body)
            case Garbage(body=body):
                return self._receive(body)
            case Say(payload=payload, is_urgent=is_urgent):
                self._n_sent += 1
                if self._c.send(payload, tag=self._n_sent & 0xFFFF, is_urgent=is_urgent):
                    self._python.send(payload, now_ns=now["now_ns"], is_urgent=is_urgent)
                else:
                    self._n_sent -= 1
            case Confirm(but=but):
                if len(self._c_receipts) > but:
                    last = len(self._c_receipts) - 1 - but
                    self._python.confirm(self._python_receipts[last])
                    self._c.confirm(self._c_receipts[last])
            case Open() if self._is_initiator:
                self._session = (self._session + 1) & 0xFFFF
                self._python.open(session=self._session, **now)
                self._c.open(session=self._session, now_ms=self._now_ms & 0xFFFF_FFFF)
            case Open():
                pass
        return None, None

    def _receive(self, body: bytes) -> tuple[object, object]:
        python = self._python.receive(body, now_ns=self._now_ms * _NS_PER_MS)
        told = self._note(python, self._c.receive(body, now_ms=self._now_ms & 0xFFFF_FFFF))
        self._session = self._python._session  # noqa: SLF001  # a RESET that was accepted
        self._next_sequence = self._python._next_expected  # noqa: SLF001
        return told

    def _note(self, python: list[PythonEvent], c: LinkEvent) -> tuple[object, object]:
        told: list[object] = []
        for event in python:
            match event:
                case LinkOpened():
                    told.append("opened")
                case PayloadReceived(payload=payload, receipt=receipt):
                    self._python_receipts.append(receipt)
                    told.append(payload)
                case PayloadConfirmed(ticket=ticket):
                    told.append(ticket & 0xFFFF)
                case LinkLost(reason=reason):
                    told.append(reason)
        match c.kind:
            case LinkEventKind.NOTHING:
                return told, []
            case LinkEventKind.OPENED:
                return told, ["opened"]
            case LinkEventKind.PAYLOAD:
                self._c_receipts.append(c.receipt)
                return told, [c.payload]
            case LinkEventKind.CONFIRMED:
                return told, list(c.tags)
            case LinkEventKind.LOST:
                return told, [_REASONS[c.reason]]

    def _deadlines_differ(self) -> bool:
        python = self._python.next_deadline_ns()
        c = self._c.next_deadline_ms(now_ms=self._now_ms & 0xFFFF_FFFF)
        return (None if python is None else python // _NS_PER_MS & 0xFFFF_FFFF) != c
