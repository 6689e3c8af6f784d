"""Radio messages to bytes and back (WIRE_FORMAT.md §5 and §6), by the one table of layouts.

Every payload fits ``MAX_RADIO_PAYLOAD`` bytes including its own CRC-16. What arrives is never trusted: ``decode_uplink`` and
``decode_downlink`` return a ``MessageFault`` for anything that is not a message of this version, the first that applies in the order of
§7. ``decode_uplink_fields`` stops at plain integers, for those who read many frames and need no objects.
"""

from binascii import crc_hqx
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any, TypeAlias, cast

from firmware_protocol import messages
from firmware_protocol.crc import CRC_INITIAL, CRC_SIZE, append_crc
from firmware_protocol.errors import EncodeError
from firmware_protocol.layout_codec import LayoutCodec, LayoutFault, Values
from firmware_protocol.layouts import DOWNLINK_HEADER, DOWNLINK_LAYOUTS, UPLINK_HEADER, UPLINK_LAYOUTS, Layout
from firmware_protocol.messages import (
    MAX_ENCOUNTER_MS,
    MAX_PATH_MM,
    MAX_RADIO_PAYLOAD,
    PROTOCOL_VERSION,
    Action,
    ConfigurationResult,
    Diagnostic,
    Downlink,
    EncounterBatch,
    EncounterBatchWithPaths,
    EncounterEntry,
    Level,
    MessageFault,
    Neighbour,
    Neighbours,
    StimulationResult,
    Uplink,
    UplinkHeader,
    Waveform,
    WireCause,
    WireMode,
)
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm

EncounterFields: TypeAlias = tuple[NodeId, int, int, RssiDbm, bool, int | None]
"""Peer, start [ms], duration [ms], RSSI [dBm], whether it is ongoing, and path [mm] of an entry of an encounter batch."""

UplinkFields: TypeAlias = tuple[Values, Values, tuple[Values, ...] | bytes]
"""Header, fields, and entries or text of an uplink message, as its layout has them; an empty tuple where it has neither."""

_ONGOING_BIT = 0x80
_DURATION_HIGH_BITS = 0x3F
_PATH_UNKNOWN = 0xFFFF

_ENUMS: dict[str, type[IntEnum]] = {
    "mode": WireMode,
    "cause": WireCause,
    "action": Action,
    "level": Level,
    "waveform": Waveform,
}
"""Fields that are one of few, by name; ``result`` depends on the message."""

_RESULTS: dict[str, type[IntEnum]] = {"StimulateReply": StimulationResult, "ConfigurationReport": ConfigurationResult}

_Read: TypeAlias = Callable[[bytes], "tuple[Values, tuple[Values, ...] | bytes] | LayoutFault"]
_Build: TypeAlias = Callable[[Values, Any], Any]


def encode_uplink(header: UplinkHeader, message: Uplink) -> bytes:
    """Return the radio payload of an uplink message.

    Raises
    ------
    EncodeError
        A value does not fit its field, or a list its message.
    """
    kind, write = _UPLINK_WRITERS[type(message)]
    head = (kind, PROTOCOL_VERSION, header.node, header.boot, header.sequence, header.sent_ms)
    return append_crc(_UPLINK_HEAD.write_fields(head) + write(message))


def decode_uplink(payload: bytes) -> tuple[UplinkHeader, Uplink] | MessageFault:
    """Return header and message of a radio payload from a backpack, or why it is none."""
    fields = decode_uplink_fields(payload)
    return build_uplink(fields) if isinstance(fields, tuple) else fields


def build_uplink(fields: UplinkFields) -> tuple[UplinkHeader, Uplink]:
    """Return header and message of what ``decode_uplink_fields`` returned."""
    (kind, _, node, boot, sequence, sent_ms), values, rest = fields
    header = UplinkHeader(node=NodeId(node), boot=BootId(boot), sequence=sequence, sent_ms=Milliseconds(sent_ms))
    return header, _UPLINK_BUILDERS[kind](values, rest)


def decode_uplink_fields(payload: bytes) -> UplinkFields | MessageFault:
    """Return what ``decode_uplink`` does, as plain integers in the order of the layouts, with the same faults."""
    size = len(payload)
    if size > MAX_RADIO_PAYLOAD:
        return MessageFault.TOO_LONG
    if crc_hqx(payload, CRC_INITIAL) or size < _LEAST_UPLINK:  # a CRC without final XOR of data and its own CRC is zero
        return _fault_of_short(payload)
    header: Values = _UNPACK_UPLINK_HEAD(payload)
    if header[1] != PROTOCOL_VERSION:
        return MessageFault.UNKNOWN_VERSION
    read = _UPLINK_READERS.get(header[0])
    if read is None:
        return MessageFault.UNKNOWN_TYPE
    body = read(payload[_UPLINK_HEAD_SIZE:-CRC_SIZE])
    if isinstance(body, tuple):  # an instance of a plain class is told in a third of the time that one of an enum takes
        values, rest = body
        return header, values, rest
    return _FAULTS[body]


def read_encounters(fields: UplinkFields) -> list[EncounterFields] | None:
    """Return the entries of what ``decode_uplink_fields`` returned, as plain numbers; None where that is no encounter batch."""
    kind, entries = fields[0][0], cast("tuple[Values, ...]", fields[2])
    if kind == _BATCH_KIND:
        plain: Any = [
            (peer, start_ms, (high & _DURATION_HIGH_BITS) << 16 | low, rssi, high >= _ONGOING_BIT, None)
            for peer, start_ms, high, low, rssi in entries
        ]
        return cast("list[EncounterFields]", plain)  # once for all of them: a NewType costs a call each
    if kind == _BATCH_WITH_PATHS_KIND:
        plain = [
            (
                peer,
                start_ms,
                (high & _DURATION_HIGH_BITS) << 16 | low,
                rssi,
                high >= _ONGOING_BIT,
                None if path_mm == _PATH_UNKNOWN else path_mm,
            )
            for peer, start_ms, high, low, rssi, path_mm in entries
        ]
        return cast("list[EncounterFields]", plain)
    return None


def encode_downlink(sequence: int, message: Downlink) -> bytes:
    """Return the radio payload of a downlink message.

    Raises
    ------
    EncodeError
        A value does not fit its field.
    """
    kind, write = _DOWNLINK_WRITERS[type(message)]
    return append_crc(_DOWNLINK_HEAD.write_fields((kind, PROTOCOL_VERSION, sequence)) + write(message))


def decode_downlink(payload: bytes) -> tuple[int, Downlink] | MessageFault:
    """Return sequence number and message of a radio payload from the base station, or why it is none."""
    size = len(payload)
    if size > MAX_RADIO_PAYLOAD:
        return MessageFault.TOO_LONG
    if crc_hqx(payload, CRC_INITIAL) or size < _LEAST_DOWNLINK:
        return _fault_of_short(payload)
    kind, version, sequence = _UNPACK_DOWNLINK_HEAD(payload)
    if version != PROTOCOL_VERSION:
        return MessageFault.UNKNOWN_VERSION
    read = _DOWNLINK_READERS.get(kind)
    if read is None:
        return MessageFault.UNKNOWN_TYPE
    body = read(payload[_DOWNLINK_HEAD_SIZE:-CRC_SIZE])
    if isinstance(body, LayoutFault):
        return _FAULTS[body]
    return sequence, _DOWNLINK_BUILDERS[kind](body[0], body[1])


def _fault_of_short(payload: bytes) -> MessageFault:
    """Return what is wrong with a payload whose checksum does not fit, or whose header is not whole."""
    is_checked = len(payload) >= CRC_SIZE and crc_hqx(payload, CRC_INITIAL) == 0
    return MessageFault.BAD_LENGTH if is_checked else MessageFault.BAD_CRC


# --- messages that are nothing but fields ---------------------------------------------------------------------------


def _fields_reader(codec: LayoutCodec) -> _Read:
    read_fields = codec.read_fields

    def read(body: bytes) -> tuple[Values, tuple[Values, ...]] | LayoutFault:
        values = read_fields(body)
        return values if isinstance(values, LayoutFault) else (values, ())

    return read


def _fields_builder(layout: Layout) -> _Build:
    cls = _class_of(layout)
    names = tuple(field.name for field in layout.fields)
    members = tuple((at, _members(layout, name)) for at, name in enumerate(names) if _enum_of(layout, name) is not None)

    def build(values: Values, rest: object) -> object:  # noqa: ARG001  # of messages with entries or text
        if not members:
            return cls(**dict(zip(names, values, strict=True)))
        whole = list(values)
        for at, by_value in members:
            whole[at] = by_value[whole[at]]
        return cls(**dict(zip(names, whole, strict=True)))

    return build


def _fields_writer(codec: LayoutCodec) -> Callable[[Any], bytes]:
    names = tuple(field.name for field in codec.layout.fields)

    def write(message: object) -> bytes:
        return codec.write_fields([getattr(message, name) for name in names])

    return write


def _class_of(layout: Layout) -> type[Any]:
    return cast("type[Any]", getattr(messages, layout.name))


def _enum_of(layout: Layout, name: str) -> type[IntEnum] | None:
    return _RESULTS.get(layout.name) if name == "result" else _ENUMS.get(name)


def _members(layout: Layout, name: str) -> dict[int, IntEnum]:
    return {member.value: member for member in _enum_of(layout, name) or ()}


# --- messages with entries or text ----------------------------------------------------------------------------------


def _build_encounters(values: Values, entries: Sequence[Values]) -> EncounterBatch:  # noqa: ARG001  # it has no fields
    return EncounterBatch(
        entries=tuple(
            [
                EncounterEntry(
                    peer=NodeId(peer),
                    start_ms=Milliseconds(start_ms),
                    duration_ms=Milliseconds((high & _DURATION_HIGH_BITS) << 16 | low),
                    rssi_dbm=RssiDbm(rssi),
                    is_ongoing=high >= _ONGOING_BIT,
                )
                for peer, start_ms, high, low, rssi in entries
            ]
        )
    )


def _build_encounters_with_paths(values: Values, entries: Sequence[Values]) -> EncounterBatchWithPaths:  # noqa: ARG001  # it has no fields
    return EncounterBatchWithPaths(
        entries=tuple(
            [
                EncounterEntry(
                    peer=NodeId(peer),
                    start_ms=Milliseconds(start_ms),
                    duration_ms=Milliseconds((high & _DURATION_HIGH_BITS) << 16 | low),
                    rssi_dbm=RssiDbm(rssi),
                    is_ongoing=high >= _ONGOING_BIT,
                    path_mm=None if path_mm == _PATH_UNKNOWN else path_mm,
                )
                for peer, start_ms, high, low, rssi, path_mm in entries
            ]
        )
    )


def _encounter_values(entry: EncounterEntry) -> Values:
    if not 0 <= entry.duration_ms <= MAX_ENCOUNTER_MS:
        raise EncodeError(field="duration_ms", value=entry.duration_ms, limit=f"0 to {MAX_ENCOUNTER_MS}")
    high = (entry.duration_ms >> 16) | (_ONGOING_BIT if entry.is_ongoing else 0)
    return (entry.peer, entry.start_ms, high, entry.duration_ms & 0xFFFF, entry.rssi_dbm)


def _write_encounters(message: EncounterBatch) -> bytes:
    for entry in message.entries:
        if entry.path_mm is not None:
            raise EncodeError(field="path_mm", value=entry.path_mm, limit="it in an EncounterBatchWithPaths alone")
    return _ENCOUNTERS.write_entries([_encounter_values(entry) for entry in message.entries])


def _write_encounters_with_paths(message: EncounterBatchWithPaths) -> bytes:
    entries = []
    for entry in message.entries:
        path_mm = _PATH_UNKNOWN if entry.path_mm is None else entry.path_mm
        if entry.path_mm is not None and not 0 <= entry.path_mm <= MAX_PATH_MM:
            raise EncodeError(field="path_mm", value=entry.path_mm, limit=f"0 to {MAX_PATH_MM}, which stands for all longer paths, or None")
        entries.append((*_encounter_values(entry), path_mm))
    return _ENCOUNTERS_WITH_PATHS.write_entries(entries)


def _read_neighbours(body: bytes) -> tuple[Values, tuple[Values, ...]] | LayoutFault:
    read = _NEIGHBOURS.read_entries(body)
    if isinstance(read, LayoutFault):
        return read
    part, n_parts = read[0]
    return read if part < n_parts else LayoutFault.BAD_VALUE


def _build_neighbours(values: Values, entries: Sequence[Values]) -> Neighbours:
    neighbours = tuple([Neighbour(node=NodeId(node), rssi_dbm=RssiDbm(rssi)) for node, rssi in entries])
    return Neighbours(part=values[0], n_parts=values[1], neighbours=neighbours)


def _write_neighbours(message: Neighbours) -> bytes:
    if not 0 <= message.part < message.n_parts:
        raise EncodeError(field="part", value=message.part, limit=f"0 to n_parts - 1 = {message.n_parts - 1}")
    fields = _NEIGHBOURS.write_fields((message.part, message.n_parts))
    return fields + _NEIGHBOURS.write_entries([(one.node, one.rssi_dbm) for one in message.neighbours])


def _build_diagnostic(values: Values, text: bytes) -> Diagnostic:
    level, code, argument, at_ms = values
    return Diagnostic(level=_LEVELS[level], code=code, argument=argument, at_ms=Milliseconds(at_ms), text=text.decode(errors="replace"))


def _write_diagnostic(message: Diagnostic) -> bytes:
    fields = _DIAGNOSTIC.write_fields((message.level, message.code, message.argument, message.at_ms))
    return fields + _DIAGNOSTIC.write_text(message.text)


# --- the tables -----------------------------------------------------------------------------------------------------

_FAULTS = {LayoutFault.BAD_LENGTH: MessageFault.BAD_LENGTH, LayoutFault.BAD_VALUE: MessageFault.BAD_VALUE}
_LEVELS = tuple(Level)

_UPLINK_HEAD = LayoutCodec(UPLINK_HEADER)
_UPLINK_HEAD_SIZE = UPLINK_HEADER.packing.size
_LEAST_UPLINK = _UPLINK_HEAD_SIZE + CRC_SIZE
_UNPACK_UPLINK_HEAD = UPLINK_HEADER.packing.unpack_from
_DOWNLINK_HEAD = LayoutCodec(DOWNLINK_HEADER)
_DOWNLINK_HEAD_SIZE = DOWNLINK_HEADER.packing.size
_LEAST_DOWNLINK = _DOWNLINK_HEAD_SIZE + CRC_SIZE
_UNPACK_DOWNLINK_HEAD = DOWNLINK_HEADER.packing.unpack_from

_UPLINKS = {layout.name: LayoutCodec(layout) for layout in UPLINK_LAYOUTS}
_DOWNLINKS = {layout.name: LayoutCodec(layout) for layout in DOWNLINK_LAYOUTS}
_ENCOUNTERS = _UPLINKS["EncounterBatch"]
_ENCOUNTERS_WITH_PATHS = _UPLINKS["EncounterBatchWithPaths"]
_NEIGHBOURS = _UPLINKS["Neighbours"]
_DIAGNOSTIC = _UPLINKS["Diagnostic"]

_OPEN_READERS: dict[str, _Read] = {
    "EncounterBatch": _ENCOUNTERS.make_entries_reader(),
    "EncounterBatchWithPaths": _ENCOUNTERS_WITH_PATHS.make_entries_reader(),
    "Neighbours": _read_neighbours,
    "Diagnostic": _DIAGNOSTIC.read_text,
}
_OPEN_BUILDERS: dict[str, _Build] = {
    "EncounterBatch": _build_encounters,
    "EncounterBatchWithPaths": _build_encounters_with_paths,
    "Neighbours": _build_neighbours,
    "Diagnostic": _build_diagnostic,
}
_OPEN_WRITERS: dict[str, Callable[[Any], bytes]] = {
    "EncounterBatch": _write_encounters,
    "EncounterBatchWithPaths": _write_encounters_with_paths,
    "Neighbours": _write_neighbours,
    "Diagnostic": _write_diagnostic,
}


def _kind_of(codec: LayoutCodec) -> int:
    assert codec.layout.kind is not None, "only the two headers have no type byte"
    return codec.layout.kind


_BATCH_KIND, _BATCH_WITH_PATHS_KIND = _kind_of(_ENCOUNTERS), _kind_of(_ENCOUNTERS_WITH_PATHS)
_UPLINK_READERS = {_kind_of(codec): _OPEN_READERS.get(name) or _fields_reader(codec) for name, codec in _UPLINKS.items()}
_UPLINK_BUILDERS = {_kind_of(codec): _OPEN_BUILDERS.get(name) or _fields_builder(codec.layout) for name, codec in _UPLINKS.items()}
_UPLINK_WRITERS = {
    _class_of(codec.layout): (_kind_of(codec), _OPEN_WRITERS.get(name) or _fields_writer(codec)) for name, codec in _UPLINKS.items()
}
_DOWNLINK_READERS = {_kind_of(codec): _fields_reader(codec) for codec in _DOWNLINKS.values()}
_DOWNLINK_BUILDERS = {_kind_of(codec): _fields_builder(codec.layout) for codec in _DOWNLINKS.values()}
_DOWNLINK_WRITERS = {_class_of(codec.layout): (_kind_of(codec), _fields_writer(codec)) for codec in _DOWNLINKS.values()}
