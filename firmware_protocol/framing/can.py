"""Framing on a CAN bus: one CAN FD frame a link frame, or up to eight classic frames (WIRE_FORMAT.md §10.3).

The link frame's kind and sequence stand in the CAN identifier, its session and payload in the data. Pure: bytes go in, link frame bodies
and faults come out; the memory is bounded.
"""

from dataclasses import dataclass, field

from firmware_protocol.errors import EncodeError
from firmware_protocol.framing.can_frame import (
    CONFIGURATION_KIND,
    FD_SIZES,
    MAX_CLASSIC_DATA,
    MAX_FD_DATA,
    CanFrame,
    CanId,
    Direction,
    RecordReader,
    encode_record,
    make_frame,
)
from firmware_protocol.framing.interface import FrameFault

MAX_LINK_PAYLOAD = MAX_FD_DATA - 2
"""Longest link payload on CAN [B]: what one CAN FD frame has beside the session. A radio payload of 57 B in its envelope is just that."""

_LINK_HEADER = 4
_SESSION = 2
_DATA = 3  # the link's kind DATA (§3.1)
_MAX_INDEX = 7
_ONLY_PART = 1  # index 0, and the last
_GIVEN_UP = -1
"""Stands for the number of parts of a message that is complete or lacks one: nothing more is expected of it."""


def encode_message(body: bytes, *, unit: int, direction: Direction, is_fd: bool) -> bytes:
    """Return a link frame body as it goes over a CAN line: the records of its frames, in the order in which they are sent.

    Raises
    ------
    EncodeError
        The body is no link frame, or its payload is longer than ``MAX_LINK_PAYLOAD``.
    """
    if not _LINK_HEADER <= len(body) <= _LINK_HEADER + MAX_LINK_PAYLOAD:
        limit = f"{_LINK_HEADER} to {_LINK_HEADER + MAX_LINK_PAYLOAD} bytes on CAN"
        raise EncodeError(field="link frame size", value=len(body), limit=limit)
    kind, sequence = body[0], body[3]
    if not 1 <= kind < CONFIGURATION_KIND:
        raise EncodeError(field="link frame kind", value=kind, limit=f"1 to {CONFIGURATION_KIND - 1} on CAN")
    data = body[1:3] + body[_LINK_HEADER:]
    prefix = (priority_of(kind, direction), direction, unit, kind, sequence)
    if is_fd:
        pad = next(size for size in FD_SIZES if size >= len(data)) - len(data)
        return encode_record(make_frame(CanId(*prefix, pad), data + bytes(pad), is_fd=True))
    last = (len(data) - 1) // MAX_CLASSIC_DATA
    parts = [data[at : at + MAX_CLASSIC_DATA] for at in range(0, len(data), MAX_CLASSIC_DATA)]
    return b"".join(
        encode_record(make_frame(CanId(*prefix, index << 1 | (index == last)), part, is_fd=False)) for index, part in enumerate(parts)
    )


def priority_of(kind: int, direction: Direction) -> int:
    """Return the priority of a link frame, 0 first: commands to animals, then the link's own frames, then what animals report (§10.1).

    All DATA of one sender have the same: were one to overtake another, the link would take it for lost.
    """
    if kind != _DATA:
        return 1
    return 0 if direction is Direction.TO_COORDINATOR else 2


@dataclass(slots=True)
class _Assembly:
    """A message of which some parts have come, and the last part, to know it again."""

    prefix: int = -1
    data: bytes = b""
    n_parts: int = _GIVEN_UP
    latest: CanFrame | None = None


@dataclass(slots=True, kw_only=True)
class CanDecoder:
    """Cut a CAN line's bytes into link frame bodies.

    A message that lacks a part, or whose parts come out of order, costs itself alone; a part that comes twice costs nothing.

    Parameters
    ----------
    direction, unit
        Whose frames to take; None: everybody's. Frames of others, and ISO-TP frames, are passed over.
    """

    direction: Direction | None = None
    unit: int | None = None
    _reader: RecordReader = field(default_factory=RecordReader)
    _assemblies: dict[int, _Assembly] = field(default_factory=dict)
    """By priority, direction and unit, the identifier's upper eight bits: a sender sends the parts of one priority without a gap."""

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        """Take the next bytes of the line; return the bodies and faults they complete, in order."""
        results: list[bytes | FrameFault] = []
        for frame in self._reader.feed(chunk):
            if isinstance(frame, FrameFault):
                results.append(frame)
            else:
                self._take(frame, results)
        return results

    def _take(self, frame: CanFrame, results: list[bytes | FrameFault]) -> None:
        fields = frame.fields
        if (
            fields.kind == CONFIGURATION_KIND
            or self.unit not in {None, fields.unit}
            or self.direction not in {None, Direction(fields.direction)}
        ):
            return
        if frame.is_fd:
            results.append(_unpad(fields, frame.data))
            return
        assembly = self._assemblies.setdefault(frame.can_id >> 21, _Assembly())
        self._add_part(assembly, frame, fields, results)

    def _add_part(self, assembly: _Assembly, frame: CanFrame, fields: CanId, results: list[bytes | FrameFault]) -> None:
        prefix, index, is_last = frame.can_id >> 10, fields.part >> 1, fields.part & 1
        if fields.part != _ONLY_PART and frame == assembly.latest:
            return  # a CAN controller sends a frame again whose end was disturbed, though others have taken it
        if index and prefix == assembly.prefix and assembly.n_parts == _GIVEN_UP:
            return
        is_expected = index == 0 or (prefix == assembly.prefix and index == assembly.n_parts)
        is_whole = is_last or (len(frame.data) == MAX_CLASSIC_DATA and index < _MAX_INDEX)
        if not (is_expected and is_whole) or (index == 0 and assembly.n_parts > 0):
            results.append(FrameFault.INCOMPLETE)
        if index == 0:
            assembly.data, assembly.n_parts = b"", 0
        assembly.prefix, assembly.latest = prefix, frame
        if not (is_expected and is_whole):
            assembly.n_parts = _GIVEN_UP
            return
        assembly.data += frame.data
        assembly.n_parts += 1
        if is_last:
            assembly.n_parts = _GIVEN_UP
            results.append(_body(fields, assembly.data))


def _unpad(fields: CanId, data: bytes) -> bytes | FrameFault:
    size = len(data) - fields.part
    if size < 0 or any(data[size:]):
        return FrameFault.BAD_STUFFING
    return _body(fields, data[:size])


def _body(fields: CanId, data: bytes) -> bytes | FrameFault:
    if len(data) < _SESSION:
        return FrameFault.TOO_SHORT
    return bytes((fields.kind, data[0], data[1], fields.sequence)) + data[_SESSION:]
