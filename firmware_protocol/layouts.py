"""The one table of byte layouts (WIRE_FORMAT.md §4 to §6): what the Python codec packs by and the C codec is generated from.

All integers are little-endian. A layout is a row of fields, then, where it has one, an entry repeated to the end, or text to the end. A
field with a ``default`` was appended to its message later: a sender of today writes it, a receiver that finds the message ended before it
takes the default, and bytes after the last field that it knows it ignores. So old and new understand each other within one version (§7).
"""

import struct
from dataclasses import dataclass

CODE_SIZES = {"B": 1, "b": 1, "H": 2, "I": 4, "Q": 8}
"""Octets of each field code, which are those of Python's ``struct``; only ``b`` is signed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """An integer on the wire.

    Parameters
    ----------
    name
        In Python and in C.
    code
        A key of ``CODE_SIZES``.
    unit
        For people: ``ms``, ``dBm``.
    limits
        Smallest and largest value that means something; outside it is BAD_VALUE. None: all that the code can say.
    default
        What it is where the message ends before it; None: it is never left out.
    """

    name: str
    code: str
    unit: str = ""
    limits: tuple[int, int] | None = None
    default: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """A message: its type byte, its fields after the header, and what is repeated after them.

    Parameters
    ----------
    name
        The Python class of the message; C names it in snake case.
    kind
        Type byte; None for the two headers.
    section
        Of WIRE_FORMAT.md.
    entry, entry_counts
        Fields of an entry that is repeated to the end, and how many entries there may be, least and most.
    text_limit
        Most octets of UTF-8 text to the end; None: the message has no text.
    has_payload
        A radio payload stands after the fields, to the end.
    """

    name: str
    kind: int | None
    section: str
    fields: tuple[Field, ...] = ()
    entry: tuple[Field, ...] = ()
    entry_counts: tuple[int, int] = (0, 0)
    text_limit: int | None = None
    has_payload: bool = False

    @property
    def packing(self) -> struct.Struct:
        """All fields, packed."""
        return struct.Struct("<" + "".join(field.code for field in self.fields))

    @property
    def entry_packing(self) -> struct.Struct:
        """One entry, packed."""
        return struct.Struct("<" + "".join(field.code for field in self.entry))

    @property
    def least_size(self) -> int:
        """Octets of the fields that are never left out."""
        return sum(CODE_SIZES[field.code] for field in self.fields if field.default is None)


_MODE = (0, 1)
_CAUSE = (0, 1)
_LEVEL = (0, 3)

UPLINK_HEADER = Layout(
    name="UplinkHeader",
    kind=None,
    section="5.1",
    fields=(
        Field(name="type", code="B"),
        Field(name="version", code="B"),
        Field(name="node", code="H"),
        Field(name="boot", code="H"),
        Field(name="sequence", code="H"),
        Field(name="sent_ms", code="I", unit="ms"),
    ),
)

DOWNLINK_HEADER = Layout(
    name="DownlinkHeader",
    kind=None,
    section="6.1",
    fields=(Field(name="type", code="B"), Field(name="version", code="B"), Field(name="sequence", code="H")),
)

_ENCOUNTER_ENTRY = (
    Field(name="peer", code="H"),
    Field(name="start_ms", code="I", unit="ms"),
    Field(name="duration_high", code="B"),  # bit 7: ongoing; bit 6: 0, ignored; bits 5..0: bits 21..16 of the duration
    Field(name="duration_low", code="H", unit="ms"),
    Field(name="rssi_dbm", code="b", unit="dBm"),
)

_CONFIGURATION = (
    Field(name="beacon_period_ms", code="H", unit="ms"),
    Field(name="rssi_enter_dbm", code="b", unit="dBm"),
    Field(name="rssi_exit_dbm", code="b", unit="dBm"),
    Field(name="gap_tolerance_ms", code="H", unit="ms"),
    Field(name="report_period_ms", code="H", unit="ms"),
)

UPLINK_LAYOUTS = (
    Layout(
        name="Hello",
        kind=0x01,
        section="5.2",
        fields=(
            Field(name="eui64", code="Q"),
            Field(name="firmware", code="H"),
            Field(name="beacon_period_ms", code="H", unit="ms"),
            Field(name="capabilities", code="H"),
            Field(name="newest_version", code="B", limits=(1, 255), default=1),
        ),
    ),
    Layout(name="EncounterBatch", kind=0x02, section="5.3", entry=_ENCOUNTER_ENTRY, entry_counts=(1, 4)),
    Layout(
        name="Status",
        kind=0x03,
        section="5.4",
        fields=(
            Field(name="mode", code="B", limits=_MODE),
            Field(name="cause", code="B", limits=_CAUSE),
            Field(name="mode_since_ms", code="I", unit="ms"),
            Field(name="battery_mv", code="H", unit="mV"),
            Field(name="buffered", code="H"),
            Field(name="dropped", code="H"),
        ),
    ),
    Layout(
        name="Neighbours",
        kind=0x04,
        section="5.5",
        fields=(Field(name="part", code="B"), Field(name="n_parts", code="B", limits=(1, 255))),
        entry=(Field(name="node", code="H"), Field(name="rssi_dbm", code="b", unit="dBm")),
        entry_counts=(0, 10),
    ),
    Layout(
        name="TimeSyncReply",
        kind=0x05,
        section="5.6",
        fields=(Field(name="token", code="H"), Field(name="received_ms", code="I", unit="ms")),
    ),
    Layout(
        name="StimulateReply",
        kind=0x06,
        section="5.7",
        fields=(
            Field(name="command", code="I"),
            Field(name="result", code="B", limits=(0, 4)),
            Field(name="executed_ms", code="I", unit="ms"),
            Field(name="mode", code="B", limits=_MODE),
        ),
    ),
    Layout(
        name="Limits",
        kind=0x07,
        section="5.8",
        fields=(
            Field(name="channels", code="B"),  # bit i: electrode channel i is there
            Field(name="waveforms", code="B"),  # bit i: waveform i of Stimulate can be made
            Field(name="max_frequency_hz", code="B", unit="Hz"),
            Field(name="max_pulse_width_us", code="H", unit="us"),
            Field(name="max_amplitude_mv", code="H", unit="mV"),
            Field(name="max_duration_ms", code="H", unit="ms"),
            Field(name="min_gap_ms", code="H", unit="ms"),
            Field(name="max_on_ms_per_minute", code="H", unit="ms"),
            Field(name="battery_mv", code="H", unit="mV"),
            Field(name="battery_empty_mv", code="H", unit="mV"),
            Field(name="encounter_capacity", code="H"),
        ),
    ),
    Layout(
        name="EncounterBatchWithPaths",
        kind=0x08,
        section="5.9",
        entry=(*_ENCOUNTER_ENTRY, Field(name="path_mm", code="H", unit="mm")),  # 0xFFFF: not known
        entry_counts=(1, 3),
    ),
    Layout(
        name="Diagnostic",
        kind=0x09,
        section="5.10",
        fields=(
            Field(name="level", code="B", limits=_LEVEL),
            Field(name="code", code="H"),
            Field(name="argument", code="I"),
            Field(name="at_ms", code="I", unit="ms"),
        ),
        text_limit=32,
    ),
    Layout(
        name="ConfigurationReport",
        kind=0x0A,
        section="5.11",
        fields=(
            Field(name="token", code="H"),
            Field(name="result", code="B", limits=(0, 2)),
            *_CONFIGURATION,
        ),
    ),
)

DOWNLINK_LAYOUTS = (
    Layout(name="HelloRequest", kind=0x81, section="6.2", fields=(Field(name="newest_version", code="B", limits=(1, 255), default=1),)),
    Layout(
        name="Acknowledge",
        kind=0x82,
        section="6.3",
        fields=(Field(name="boot", code="H"), Field(name="next_sequence", code="H"), Field(name="bitmap", code="I")),
    ),
    Layout(name="TimeSyncRequest", kind=0x83, section="6.4", fields=(Field(name="token", code="H"),)),
    Layout(
        name="Stimulate",
        kind=0x84,
        section="6.5",
        fields=(
            Field(name="command", code="I"),
            Field(name="action", code="B", limits=(1, 5)),
            Field(name="ttl_ms", code="H", unit="ms"),
            Field(name="hold_ms", code="I", unit="ms"),
            Field(name="frequency_hz", code="B", unit="Hz"),
            Field(name="pulse_width_us", code="H", unit="us"),
            Field(name="amplitude_mv", code="H", unit="mV"),
            Field(name="duration_ms", code="H", unit="ms"),
            Field(name="channel", code="B", default=0xFF),  # 0xFF: the one that the backpack uses for this action
            Field(name="waveform", code="B", limits=(0, 2), default=0),
        ),
    ),
    Layout(name="Configure", kind=0x85, section="6.6", fields=(Field(name="token", code="H"), *_CONFIGURATION)),
    Layout(name="ConfigurationRequest", kind=0x86, section="6.7", fields=(Field(name="token", code="H"),)),
)

ENVELOPE_LAYOUTS = (
    Layout(name="IdentifyRequest", kind=0x10, section="4.1"),
    Layout(
        name="CoordinatorHello",
        kind=0x11,
        section="4.2",
        fields=(
            Field(name="firmware", code="H"),
            Field(name="eui64", code="Q"),
            Field(name="pan_id", code="H"),
            Field(name="channel", code="B"),
            Field(name="max_radio_payload", code="B"),
        ),
    ),
    Layout(
        name="CoordinatorLog",
        kind=0x12,
        section="4.6",
        fields=(Field(name="level", code="B", limits=_LEVEL), Field(name="code", code="H")),
        text_limit=58,
    ),
    Layout(
        name="ConfigureCoordinator",
        kind=0x13,
        section="4.7",
        fields=(
            Field(name="token", code="H"),
            Field(name="pan_id", code="H"),  # 0xFFFF: leave it
            Field(name="channel", code="B"),  # 11..26; 0: leave it
            Field(name="permit_join_s", code="B"),  # 0: closed; 254: open; 255: leave it
        ),
    ),
    Layout(
        name="CoordinatorConfigured",
        kind=0x14,
        section="4.8",
        fields=(
            Field(name="token", code="H"),
            Field(name="result", code="B", limits=(0, 2)),
            Field(name="pan_id", code="H"),
            Field(name="channel", code="B"),
            Field(name="permit_join_s", code="B"),
        ),
    ),
    Layout(name="NodeJoined", kind=0x23, section="4.9", fields=(Field(name="address", code="H"), Field(name="eui64", code="Q"))),
)
"""Of the envelopes that carry no radio payload and tell of none."""

CARRIER_LAYOUTS = (
    Layout(
        name="RadioSend",
        kind=0x20,
        section="4.3",
        fields=(Field(name="handle", code="H"), Field(name="destination", code="H")),  # 0xFFFF: all
        has_payload=True,
    ),
    Layout(name="RadioConfirm", kind=0x21, section="4.4", fields=(Field(name="handle", code="H"), Field(name="status", code="B"))),
    Layout(
        name="RadioReceived",
        kind=0x22,
        section="4.5",
        fields=(Field(name="source", code="H"), Field(name="rssi_dbm", code="b", unit="dBm"), Field(name="lqi", code="B")),
        has_payload=True,
    ),
)
"""Of the other envelopes; ``envelope.py`` has them in its own words, because they are most of what goes over a line."""
