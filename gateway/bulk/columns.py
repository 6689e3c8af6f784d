"""What bulk decoding gives: a value of each column for each frame, and for each entry of an encounter batch.

The columns are ``array.array``: anything that reads buffers reads them without a copy, ``numpy.frombuffer(columns.node, "u2")`` for one.
"""

from array import array
from dataclasses import dataclass, field
from typing import TypeAlias

from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.messages import MessageFault

Column: TypeAlias = "array[int]"

UPLINK = 0
"""Status of a frame that carries an uplink message; the other columns tell it."""

OTHER = 1
"""Status of a good frame that carries none: another link frame, another envelope."""

FRAME_FAULTS = {FrameFault.BAD_CRC: 18, FrameFault.BAD_STUFFING: 19, FrameFault.TOO_SHORT: 20, FrameFault.TOO_LONG: 21}
"""Status of bytes between two delimiters that are no frame."""

MESSAGE_FAULTS = {
    MessageFault.BAD_CRC: 33,
    MessageFault.TOO_LONG: 34,
    MessageFault.UNKNOWN_VERSION: 35,
    MessageFault.UNKNOWN_TYPE: 36,
    MessageFault.BAD_LENGTH: 37,
    MessageFault.BAD_VALUE: 38,
}
"""Status of a good frame whose radio payload is no uplink message."""

NO_SOURCE = 0xFFFF
"""``source`` where the frame carries no RadioReceived."""

NO_PATH = 0xFFFF
"""``path_mm`` where it is not known."""


def _column(code: str) -> Column:
    return array(code)


@dataclass(slots=True, kw_only=True)
class Columns:
    """See the module. All of a frame are of length n_frames, all of an entry of length n_entries.

    ``entries_end`` counts the entries of a frame and of all before it: those of frame i are ``entries_end[i - 1]`` to ``entries_end[i]``.
    """

    status: Column = field(default_factory=lambda: _column("B"))
    type: Column = field(default_factory=lambda: _column("B"))
    """Of the message; this and the columns up to ``sent_ms`` are 0 where there is none."""
    node: Column = field(default_factory=lambda: _column("H"))
    boot: Column = field(default_factory=lambda: _column("H"))
    sequence: Column = field(default_factory=lambda: _column("H"))
    sent_ms: Column = field(default_factory=lambda: _column("I"))
    source: Column = field(default_factory=lambda: _column("H"))
    """Short address; ``NO_SOURCE`` where frames are bare payloads, and in OTHER."""
    rssi_dbm: Column = field(default_factory=lambda: _column("b"))
    """127 where it is not known."""
    lqi: Column = field(default_factory=lambda: _column("B"))
    entries_end: Column = field(default_factory=lambda: _column("I"))
    peer: Column = field(default_factory=lambda: _column("H"))
    start_ms: Column = field(default_factory=lambda: _column("I"))
    duration_ms: Column = field(default_factory=lambda: _column("I"))
    is_ongoing: Column = field(default_factory=lambda: _column("B"))
    entry_rssi_dbm: Column = field(default_factory=lambda: _column("b"))
    path_mm: Column = field(default_factory=lambda: _column("H"))


OF_FRAMES = ("status", "type", "node", "boot", "sequence", "sent_ms", "source", "rssi_dbm", "lqi", "entries_end")
OF_ENTRIES = ("peer", "start_ms", "duration_ms", "is_ongoing", "entry_rssi_dbm", "path_mm")
