"""WIRE_FORMAT.md and the table of layouts say the same of every message and field."""

import re
from pathlib import Path

import pytest

import firmware_protocol
from firmware_protocol import envelope, messages
from firmware_protocol.framing.cobs import MAX_BODY_SIZE, MAX_ENCODED_SIZE
from firmware_protocol.layouts import (
    CODE_SIZES,
    DOWNLINK_HEADER,
    DOWNLINK_LAYOUTS,
    ENVELOPE_LAYOUTS,
    UPLINK_HEADER,
    UPLINK_LAYOUTS,
    Field,
    Layout,
)
from firmware_protocol.link import MAX_PAYLOAD, LinkConfig
from firmware_protocol.messages import MAX_RADIO_PAYLOAD, MessageFault

TEXT = (Path(firmware_protocol.__file__).parent / "WIRE_FORMAT.md").read_text(encoding="utf-8")
TYPES = {"u8": "B", "i8": "b", "u16": "H", "u32": "I", "u64": "Q"}
STARTS = {
    **dict.fromkeys((UPLINK_HEADER, DOWNLINK_HEADER), 0),
    **dict.fromkeys(UPLINK_LAYOUTS, UPLINK_HEADER.packing.size),
    **dict.fromkeys(DOWNLINK_LAYOUTS, DOWNLINK_HEADER.packing.size),
    **dict.fromkeys(ENVELOPE_LAYOUTS, 1),
}
"""Where the fields of a layout begin: behind the header, or behind the envelope's type."""


def section(number: str) -> tuple[str, str]:
    """Return heading and text of a section."""
    match = re.search(rf"^#+ {re.escape(number)} (.+)\n((?:(?!^#).*\n)*)", TEXT, re.MULTILINE)
    assert match, f"there is no section {number}"
    return match[1], match[2]


def tables(text: str) -> list[list[tuple[int, Field]]]:
    """Return the fields of each table of layouts in a section, with their offsets."""
    found = []
    for table in re.findall(r"^\| offset \| field \| type \| unit .*\n\|[-|]+\|\n((?:\|.*\n)+)", text, re.MULTILINE):
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
        for row in rows:
            assert row[6], f"{row[1]} says nothing of its meaning"
        found.append([(int(row[0]), _field(row)) for row in rows])
    return found


def _field(row: list[str]) -> Field:
    _, name, code, unit, allowed, missing, _ = row
    low, _, high = allowed.partition("..")
    return Field(
        name=name.strip("`"),
        code=TYPES[code],
        unit=unit,
        limits=(int(low), int(high)) if allowed else None,
        default=int(missing) if missing else None,
    )


def placed(fields: tuple[Field, ...], *, start: int) -> list[tuple[int, Field]]:
    offsets = [start + sum(CODE_SIZES[one.code] for one in fields[:index]) for index in range(len(fields))]
    return list(zip(offsets, fields, strict=True))


@pytest.mark.parametrize("layout", STARTS, ids=lambda layout: layout.name)
def test_the_text_says_what_the_table_does(layout: Layout) -> None:
    heading, text = section(layout.section)
    expected = [placed(layout.fields, start=STARTS[layout])] if layout.fields else []
    if layout.entry:
        expected.append(placed(layout.entry, start=0))
        least, most = layout.entry_counts
        assert f"Entries: {least} to {most} of {layout.entry_packing.size} bytes, to the end" in text
    if layout.text_limit is not None:
        assert f"Text: to the end, at most {layout.text_limit} bytes of UTF-8" in text

    assert tables(text) == expected
    kind = re.search(r", type 0x([0-9A-F]{2})$", heading)
    assert (None if kind is None else int(kind[1], 16)) == layout.kind


def test_the_overview_of_envelopes_is_true() -> None:
    _, text = section("4")
    rows = re.findall(r"^\| (4\.\d) \| 0x([0-9A-F]{2}) \| (\w+) \| (?:to coordinator|to|from) \|$", text, re.MULTILINE)

    assert {(layout.section, layout.kind, layout.name) for layout in ENVELOPE_LAYOUTS} <= {
        (number, int(kind, 16), name) for number, kind, name in rows
    }
    for number, kind, name in rows:
        assert section(number)[0] == f"{name}, type 0x{kind}"
        assert hasattr(envelope, name)


def test_the_order_of_faults_is_that_of_the_text() -> None:
    _, text = section("7.3")

    assert re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE) == [
        "too_long", "bad_crc", "bad_length", "unknown_version", "unknown_type", "bad_length", "bad_value",
    ]  # fmt: skip
    assert {fault.value for fault in MessageFault} == set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE))


def test_bounds_and_constants_are_those_of_the_text() -> None:
    config = LinkConfig()

    assert f"has 1 to {MAX_BODY_SIZE} bytes" in TEXT
    assert f"at most {MAX_ENCODED_SIZE} bytes between delimiters" in TEXT
    assert f"| 4 | 0..{MAX_PAYLOAD} |" in TEXT
    assert f"at most **{MAX_RADIO_PAYLOAD} bytes**" in TEXT
    _, constants = section("3.4")
    ms = 1_000_000
    assert f"| window | {config.window} payloads" in constants
    assert f"| {config.retransmit_ns // ms} ms, doubling up to {config.max_retransmit_ns // (1000 * ms)} s" in constants
    assert f"| {config.max_silent_retries} repetitions" in constants
    assert f"| {config.max_fruitless_retries} repetitions with no progress" in constants
    assert f"| {config.keepalive_ns // (1000 * ms)} s, then every {config.retransmit_ns // ms} ms |" in constants
    assert f"| {config.reset_retry_ns // ms} ms, for ever |" in constants


def test_every_payload_fits_and_every_layout_has_a_class_with_its_fields() -> None:
    for layout, start in STARTS.items():
        longest = start + layout.packing.size + layout.entry_counts[1] * layout.entry_packing.size + (layout.text_limit or 0)
        if layout in ENVELOPE_LAYOUTS:
            assert longest <= MAX_PAYLOAD
        else:
            assert longest + 2 <= MAX_RADIO_PAYLOAD
        if layout is DOWNLINK_HEADER:
            continue  # only its sequence number is the caller's
        cls = getattr(envelope if layout in ENVELOPE_LAYOUTS else messages, layout.name)
        names = {field.name for field in layout.fields} - {"type", "version"}
        assert names <= set(cls.__struct_fields__)
