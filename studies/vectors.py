"""Write the golden vectors of the wire format, which the codecs in Python and in C are both held to (WIRE_FORMAT.md §7.5).

``python -m studies.vectors [FOLDER]``, by default into ``firmware_protocol/vectors``; a test compares them with the files and with what the
codec says, both ways. They are packed here from the table of layouts alone, not by the codec that they test. Each file is a list of

    {"name", "section", "hex", "fields" or "fault", "is_one_way"?}

``fields`` has the values under the names of the table, as integers; ``is_one_way`` marks octets that decode to these fields and that no
sender of today writes.
"""

import json
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import firmware_protocol
from firmware_protocol.crc import append_crc
from firmware_protocol.layout_codec import range_of
from firmware_protocol.layouts import DOWNLINK_HEADER, DOWNLINK_LAYOUTS, ENVELOPE_LAYOUTS, UPLINK_HEADER, UPLINK_LAYOUTS, Field, Layout
from firmware_protocol.messages import MAX_RADIO_PAYLOAD, PROTOCOL_VERSION
from studies.line_vectors import framing_vectors, link_vectors, session_vectors

FOLDER = Path(firmware_protocol.__file__).parent / "vectors"

Vector: TypeAlias = dict[str, Any]

_TEXTS = ("", "loose electrode", "Grüße")
_FIRST_BYTE = 0x11


def all_vectors() -> dict[str, list[Vector]]:
    """Return the vectors of every file, by its name."""
    return {
        "framing": framing_vectors(),
        "link": link_vectors(),
        "link_sessions": session_vectors(),
        "envelope": list(_envelope_vectors()),
        "uplink": list(_message_vectors(UPLINK_HEADER, UPLINK_LAYOUTS)),
        "downlink": list(_message_vectors(DOWNLINK_HEADER, DOWNLINK_LAYOUTS)),
    }


def text_of(vectors: list[Vector]) -> str:
    """Return a file's content: one line for each vector, so that a change of one is one line of a diff."""
    return "[\n" + ",\n".join(json.dumps(vector, ensure_ascii=False) for vector in vectors) + "\n]\n"


def main(arguments: list[str]) -> int:
    """Write all files."""
    folder = Path(arguments[0]) if arguments else FOLDER
    for name, vectors in all_vectors().items():
        (folder / f"{name}.json").write_text(text_of(vectors), encoding="utf-8")
    return 0


# --- values ---------------------------------------------------------------------------------------------------------


def _telling(fields: tuple[Field, ...], *, first: int = _FIRST_BYTE) -> list[int]:
    """Return values whose octets are all different, so that an exchanged byte or field shows."""
    values = []
    for field in fields:
        size = struct.calcsize("<" + field.code)
        octets = bytes((first + index) % 0x80 for index in range(size))
        value = int.from_bytes(octets, "little")
        values.append(value if field.limits is None else min(max(value, field.limits[0]), field.limits[1]))
        first += size
    return values


def _least(fields: tuple[Field, ...]) -> list[int]:
    return [(field.limits or range_of(field.code))[0] for field in fields]


def _most(fields: tuple[Field, ...]) -> list[int]:
    return [(field.limits or range_of(field.code))[1] for field in fields]


def _pack(fields: tuple[Field, ...], values: list[int]) -> bytes:
    return struct.pack("<" + "".join(field.code for field in fields), *values)


def _named(fields: tuple[Field, ...], values: list[int]) -> dict[str, int]:
    return {field.name: value for field, value in zip(fields, values, strict=True)}


# --- a body: what follows a header or a type byte -------------------------------------------------------------------


def _bodies(layout: Layout) -> Iterator[Vector]:
    """Yield every body worth a vector, good and bad: ``name``, ``body`` and either ``fields`` or ``fault``."""
    if layout.entry:
        yield from _bodies_with_entries(layout)
    elif layout.text_limit is not None:
        yield from _bodies_with_text(layout, layout.text_limit)
    else:
        yield from _plain_bodies(layout)
    yield from _values_out_of_limits(layout)


def _plain_bodies(layout: Layout) -> Iterator[Vector]:
    fields = layout.fields
    whole = _pack(fields, _telling(fields))
    yield {"name": "every octet different", "body": whole, "fields": {"values": _named(fields, _telling(fields))}}
    if fields:
        yield {"name": "all least", "body": _pack(fields, _least(fields)), "fields": {"values": _named(fields, _least(fields))}}
        yield {"name": "all most", "body": _pack(fields, _most(fields)), "fields": {"values": _named(fields, _most(fields))}}
    newer = {"name": "of a newer peer, which appended two octets", "body": whole + b"\xa5\x5a", "is_one_way": True}
    yield newer | {"fields": {"values": _named(fields, _telling(fields))}}
    for n_fields, field in enumerate(fields):
        if field.default is not None:
            values = _telling(fields)[:n_fields] + [one.default for one in fields[n_fields:] if one.default is not None]
            older = {"name": f"of an older peer, which ends before {field.name}", "body": _pack(fields[:n_fields], values[:n_fields])}
            yield older | {"fields": {"values": _named(fields, values)}, "is_one_way": True}
    good = {len(_pack(fields[:n], _telling(fields)[:n])) for n in range(len(fields)) if all(one.default is not None for one in fields[n:])}
    if fields:
        for cut in (len(whole) - 1, 0):
            if cut not in good:
                yield {"name": f"cut to {cut} octets", "body": whole[:cut], "fault": "bad_length"}


def _bodies_with_entries(layout: Layout) -> Iterator[Vector]:
    head = _pack(layout.fields, _head_of_part(layout))
    values = _named(layout.fields, _head_of_part(layout))
    least, most = layout.entry_counts
    for count in range(least, most + 1):
        entries = [_entry(layout, index) for index in range(count)]
        body = head + b"".join(_pack(layout.entry, entry) for entry in entries)
        yield {
            "name": f"{count} entries",
            "body": body,
            "fields": {"values": values, "entries": [_named(layout.entry, entry) for entry in entries]},
        }
    for name, extremes in (("least", _least(layout.entry)), ("most", _most(layout.entry))):
        vector: Vector = {"name": f"an entry of all {name}", "body": head + _pack(layout.entry, extremes)}
        # Bit 6 of duration_high means nothing: all bits set decode, and are not written.
        has_spare_bit = name == "most" and any(field.name == "duration_high" for field in layout.entry)
        vector["fields"] = {"values": values, "entries": [_named(layout.entry, extremes)]}
        yield vector | ({"is_one_way": True} if has_spare_bit else {})
    one = _pack(layout.entry, _entry(layout, 0))
    if least:
        yield {"name": "no entry", "body": head, "fault": "bad_length"}
    yield {"name": "one entry too many", "body": head + one * (most + 1), "fault": "bad_length"}
    yield {"name": "an entry cut by one octet", "body": head + one[:-1], "fault": "bad_length"}
    yield {"name": "an entry and one octet", "body": head + one + b"\x01", "fault": "bad_length"}
    if layout.name == "Neighbours":
        yield {"name": "part 3 of 3, counted from 0", "body": bytes([3, 3]), "fault": "bad_value"}
        yield {"name": "part 0 of 0", "body": bytes([0, 0]), "fault": "bad_value"}
        yield {"name": "the part without the number of parts", "body": bytes([0]), "fault": "bad_length"}


def _bodies_with_text(layout: Layout, limit: int) -> Iterator[Vector]:
    fields = layout.fields
    head = _pack(fields, _telling(fields))
    for text in (*_TEXTS, "x" * limit):
        yield {
            "name": f"text of {len(text.encode())} octets",
            "body": head + text.encode(),
            "fields": {"values": _named(fields, _telling(fields)), "text": text},
        }
    for name, values in (("least", _least(fields)), ("most", _most(fields))):
        yield {"name": f"all {name}", "body": _pack(fields, values), "fields": {"values": _named(fields, values), "text": ""}}
    yield {"name": "text one octet too long", "body": head + b"x" * (limit + 1), "fault": "bad_length"}
    yield {"name": "cut before the last octet of the fields", "body": head[:-1], "fault": "bad_length"}


def _values_out_of_limits(layout: Layout) -> Iterator[Vector]:
    for index, field in enumerate(layout.fields):
        if field.limits is None:
            continue
        code_limits = range_of(field.code)
        for value, is_code_wider in (
            (field.limits[0] - 1, field.limits[0] > code_limits[0]),
            (field.limits[1] + 1, field.limits[1] < code_limits[1]),
        ):
            if is_code_wider:
                values = _head_of_part(layout)
                values[index] = value
                yield {"name": f"{field.name} = {value}", "body": _pack(layout.fields, values), "fault": "bad_value"}
        if field.limits[1] - field.limits[0] < 8:
            for value in range(field.limits[0], field.limits[1] + 1):
                values = _head_of_part(layout)
                values[index] = value
                rest = {"text": ""} if layout.text_limit is not None else {}
                good = {"name": f"{field.name} = {value}", "body": _pack(layout.fields, values)}
                yield good | {"fields": {"values": _named(layout.fields, values)} | rest}


def _head_of_part(layout: Layout) -> list[int]:
    return [2, 5] if layout.name == "Neighbours" else _telling(layout.fields)


def _entry(layout: Layout, index: int) -> list[int]:
    values = _telling(layout.entry, first=_FIRST_BYTE + 0x10 * index)
    if layout.name != "Neighbours":
        high = [field.name for field in layout.entry].index("duration_high")
        values[high] = (0x80, 0x00, 0xBF, 0x3F)[index]  # ongoing or not, and the smallest and largest six bits
    return values


# --- whole messages -------------------------------------------------------------------------------------------------


def _message_vectors(header: Layout, layouts: tuple[Layout, ...]) -> Iterator[Vector]:
    for layout in layouts:
        for vector in _bodies(layout):
            if layout.entry and "fault" in vector and vector["name"].startswith(tuple(f"{one.name} =" for one in layout.fields)):
                continue  # no entry: its length is wrong too, and is told first
            head = _header_values(header, kind=layout.kind or 0)
            payload = append_crc(_pack(header.fields, head) + vector.pop("body"))
            if len(payload) > MAX_RADIO_PAYLOAD:
                vector["fault"] = "too_long"
            name = f"{layout.name}: {vector.pop('name')}"
            if "fields" in vector:
                vector["fields"] = {"message": layout.name, "header": _named(header.fields, head)} | vector["fields"]
            yield {"name": name, "section": layout.section, "hex": payload.hex()} | vector
    yield from _broken_payloads(header, layouts[0])


def _broken_payloads(header: Layout, layout: Layout) -> Iterator[Vector]:
    head = _header_values(header, kind=layout.kind or 0)
    good = _pack(header.fields, head) + _pack(layout.fields, _telling(layout.fields))
    section = header.section
    other_version = bytes([good[0], PROTOCOL_VERSION + 1]) + good[2:]
    version_0 = bytes([good[0], 0]) + good[2:]
    foreign = bytes([0x7F]) + good[1:]
    flipped = bytearray(append_crc(good))
    flipped[4] ^= 0x10
    for name, payload, fault in (
        ("nothing", b"", "bad_crc"),
        ("one octet", b"\xff", "bad_crc"),
        ("a checksum of nothing", append_crc(b""), "bad_length"),
        ("a header cut by one octet", append_crc(good[: header.packing.size - 1]), "bad_length"),
        ("a bit flipped", bytes(flipped), "bad_crc"),
        ("the last octet lost", append_crc(good)[:-1], "bad_crc"),
        ("version 2", append_crc(other_version), "unknown_version"),
        ("version 0", append_crc(version_0), "unknown_version"),
        ("type 0x7F", append_crc(foreign), "unknown_type"),
        ("type 0x7F of version 2: the version is told first", append_crc(foreign[:1] + other_version[1:]), "unknown_version"),
        ("58 octets", append_crc(good + bytes(MAX_RADIO_PAYLOAD - 1 - len(good))), "too_long"),
        ("58 octets with a wrong checksum: the length is told first", good + bytes(MAX_RADIO_PAYLOAD + 1 - len(good)), "too_long"),
    ):
        yield {"name": f"{header.name}: {name}", "section": section, "hex": payload.hex(), "fault": fault}


def _header_values(header: Layout, *, kind: int) -> list[int]:
    return [kind, PROTOCOL_VERSION, *_telling(header.fields[2:], first=1)]


# --- envelopes ------------------------------------------------------------------------------------------------------


def _envelope_vectors() -> Iterator[Vector]:
    for layout in ENVELOPE_LAYOUTS:
        for vector in _bodies(layout):
            octets = bytes([layout.kind or 0]) + vector.pop("body")
            name = f"{layout.name}: {vector.pop('name')}"
            if "fault" in vector:
                vector["fault"] = vector["fault"].replace("bad_", "bad_envelope_")
            else:
                vector["fields"] = {"message": layout.name} | vector["fields"]
            yield {"name": name, "section": layout.section, "hex": octets.hex()} | vector
    payload = append_crc(bytes(range(1, MAX_RADIO_PAYLOAD - 1)))
    for message, section, kind, code, names, values, tail in (
        ("RadioSend", "4.3", 0x20, "<HH", ("handle", "destination"), (0x1211, 0xFFFF), payload),
        ("RadioSend", "4.3", 0x20, "<HH", ("handle", "destination"), (0xFFFF, 0x1413), b""),
        ("RadioConfirm", "4.4", 0x21, "<HB", ("handle", "status"), (0x1211, 0), None),
        ("RadioConfirm", "4.4", 0x21, "<HB", ("handle", "status"), (0x1211, 255), None),
        ("RadioReceived", "4.5", 0x22, "<HbB", ("source", "rssi_dbm", "lqi"), (0x1211, -128, 255), payload),
        ("RadioReceived", "4.5", 0x22, "<HbB", ("source", "rssi_dbm", "lqi"), (0, 127, 0), b""),
    ):
        fields: Vector = {"message": message, "values": dict(zip(names, values, strict=True))}
        fields |= {} if tail is None else {"payload": tail.hex()}
        octets = bytes([kind]) + struct.pack(code, *values) + (tail or b"")
        what = f"{message}: {values}" if tail is None else f"{message}: {values} and {len(tail)} octets"
        yield {"name": what, "section": section, "hex": octets.hex(), "fields": fields}
        cut = octets[: struct.calcsize(code)].hex()
        yield {"name": f"{what}, cut in its last field", "section": section, "hex": cut, "fault": "bad_envelope_length"}
    for octets in (b"", b"\x00", b"\x24\x01", b"\xff"):
        yield {"name": f"no type: {octets.hex() or 'nothing'}", "section": "4", "hex": octets.hex(), "fault": "unknown_envelope_type"}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
