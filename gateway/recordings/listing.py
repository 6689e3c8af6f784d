"""What recordings there are, for people: one look at the front and the end of each file."""

from pathlib import Path
from typing import Final

from firmware_protocol.contract.recordings import RecordingEntry, RecordingList
from firmware_protocol.units import Nanoseconds
from gateway.errors import RecordingError, TransportSpecError
from gateway.recordings.recorder import SUFFIX
from gateway.recordings.recording_file import find_last_wall_ns, read_header
from gateway.transports.spec import parse_port_spec

_MAX_LISTED: Final = 1000


def list_recordings(directory: str | None, *, gateway: str) -> RecordingList:
    """List the recordings in a directory, the oldest first; what is no recording is passed over. None: nothing is recorded."""
    if directory is None:
        return RecordingList(gateway=gateway, is_recording=False)
    entries = [entry for path in Path(directory).glob(f"*{SUFFIX}") if (entry := _look_at(path)) is not None]
    entries.sort(key=lambda entry: (entry.begin_wall_ns, entry.name))
    n_left_out = max(0, len(entries) - _MAX_LISTED)
    return RecordingList(gateway=gateway, is_recording=True, recordings=tuple(entries[n_left_out:]), n_left_out=n_left_out)


def _look_at(path: Path) -> RecordingEntry | None:
    try:
        with path.open("rb") as stream:
            header = read_header(stream, name=path.name)
            end_wall_ns = find_last_wall_ns(stream)
            return RecordingEntry(
                name=path.name,
                radio=parse_port_spec(header.port).name,
                begin_wall_ns=Nanoseconds(header.wall_ns),
                end_wall_ns=None if end_wall_ns is None else Nanoseconds(end_wall_ns),
                n_bytes=path.stat().st_size,
            )
    except (OSError, RecordingError, TransportSpecError):  # gone meanwhile, just begun, or none of ours
        return None
