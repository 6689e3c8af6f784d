"""Which recordings of lines to dongles a gateway has, told on request (CONTRACT.md §4); the files themselves are not on the bus."""

from typing import Annotated

import msgspec

from firmware_protocol.contract.records import Struct
from firmware_protocol.first_use import prepare
from firmware_protocol.units import Nanoseconds

_Count = Annotated[int, msgspec.Meta(ge=0)]


class RecordingEntry(Struct, frozen=True, kw_only=True):
    """One file; it begins and ends on the gateway's wall clock."""

    name: str
    """Of the file, in the gateway's directory of recordings."""
    radio: str
    """Name of the radio whose line it is."""
    begin_wall_ns: Nanoseconds
    end_wall_ns: Nanoseconds | None
    """Of its last record; null: it has none yet."""
    n_bytes: _Count


class RecordingList(Struct, frozen=True, kw_only=True):
    """All recordings of a gateway, the oldest first, up to a limit: ``n_left_out`` older ones are not listed."""

    gateway: str
    is_recording: bool
    """It records now."""
    recordings: tuple[RecordingEntry, ...] = ()
    n_left_out: _Count = 0


prepare(RecordingList)
