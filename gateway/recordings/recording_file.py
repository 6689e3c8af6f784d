"""The file of a recording (docs/recordings.md): written record by record, read in one pass with bounded memory.

A recording ends where the power or the disk ended it, so a torn last record is normal and told; a damaged stretch in the middle costs
itself alone: reading goes on at the next record whose checksum fits.
"""

import json
import struct
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from io import SEEK_END
from typing import BinaryIO

from firmware_protocol.own_files import HEAD_BYTES, tell_own_file
from gateway.errors import RecordingError
from gateway.transports.recording import LineRecord, RecordKind

FILE_VERSION = 1
MAX_DATA = 0xFFFF
"""Longest data of one record [B]; what is longer is written as several."""

_MAGIC = b"BIOBREC\x01"
_HEADER_SIZE = struct.Struct("<H")
_MAX_HEADER = 4096
_CRC = struct.Struct("<I")
_MARK = b"\xa7\x5e"
_RECORD = struct.Struct("<2sBBHQQ")  # mark, kind, 0, length of data, monotonic [ns], wall [ns]
_OVERHEAD = _RECORD.size + _CRC.size
_BLOCK = 1 << 16
_KINDS = {kind.value: kind for kind in RecordKind}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingHeader:
    """What is said once, at the front: which port, spoken how, recorded when and by what."""

    port: str
    dialect: str
    software: str
    wall_ns: int
    monotonic_ns: int
    version: int = FILE_VERSION


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """A stretch of the file that is no record.

    Parameters
    ----------
    offset, n_bytes
        Where it begins, and its length.
    is_torn
        It is a last record that was not written to its end.
    """

    offset: int
    n_bytes: int
    is_torn: bool


def encode_header(header: RecordingHeader) -> bytes:
    """Return the front of a file."""
    text = json.dumps(asdict(header)).encode()
    front = _MAGIC + _HEADER_SIZE.pack(len(text)) + text
    return front + _CRC.pack(zlib.crc32(front))


def encode_record(record: LineRecord) -> bytes:
    """Return the bytes of a record; one with more than ``MAX_DATA`` bytes becomes several of the same instant."""
    parts = [record.data[at : at + MAX_DATA] for at in range(0, len(record.data), MAX_DATA)] or [b""]
    return b"".join(_encode_part(record, part) for part in parts)


def read_header(stream: BinaryIO, *, name: str) -> RecordingHeader:
    """Read the front of a file; the stream then stands at the first record.

    Raises
    ------
    RecordingError
        It is no recording, or one of a later version.
    """
    magic = stream.read(len(_MAGIC))
    if magic != _MAGIC:
        own = tell_own_file(magic + stream.read(HEAD_BYTES))
        begins = f": it begins with {magic.hex(' ') or 'nothing'}, not {_MAGIC.hex(' ')}; name a file of `biobot-gateway record`"
        raise RecordingError(path=name, reason=f"is no recording{begins}" if own is None else f"is no recording but {own.what}: {own.use}")
    size_bytes = stream.read(_HEADER_SIZE.size)
    size = _HEADER_SIZE.unpack(size_bytes)[0] if len(size_bytes) == _HEADER_SIZE.size else 0
    if not 0 < size <= _MAX_HEADER:
        raise RecordingError(path=name, reason=f"has a header of {size} bytes, but it has 1 to {_MAX_HEADER}")
    text, crc = stream.read(size), stream.read(_CRC.size)
    if len(crc) < _CRC.size or _CRC.unpack(crc)[0] != zlib.crc32(magic + size_bytes + text):
        raise RecordingError(path=name, reason="has a damaged header: its checksum does not fit")
    return _parse_header(text, name=name)


def read_records(stream: BinaryIO) -> Iterator[LineRecord | Damage]:
    """Yield the records in order, and each stretch that is none; the memory is bounded whatever the file holds."""
    buffer, at, offset = b"", 0, stream.tell() if stream.seekable() else 0
    is_at_end = is_torn = False
    n_skipped = 0
    while True:
        if not is_at_end and len(buffer) - at < _OVERHEAD + MAX_DATA:
            block = stream.read(_BLOCK)
            is_at_end = not block
            buffer, at = buffer[at:] + block, 0
            continue
        if at >= len(buffer):
            break
        record = _decode_record(buffer, at)
        if record is not None:
            if n_skipped:
                yield Damage(offset=offset - n_skipped, n_bytes=n_skipped, is_torn=False)
                n_skipped = 0
            yield record
            step = _OVERHEAD + len(record.data)
        else:
            if not n_skipped:
                is_torn = _is_cut_short(buffer, at)
            found = buffer.find(_MARK, at + 1)
            step = (found if found >= 0 else len(buffer)) - at
            if found < 0 and not is_at_end:
                step = max(1, step - 1)  # the last byte may be the first one of a mark
            n_skipped += step
        at += step
        offset += step
    if n_skipped:
        yield Damage(offset=offset - n_skipped, n_bytes=n_skipped, is_torn=is_torn)


def find_last_wall_ns(stream: BinaryIO) -> int | None:
    """Return the wall clock of the last whole record [ns], or None: there is none in the end of the file that the longest would fill."""
    size = stream.seek(0, SEEK_END)
    stream.seek(max(0, size - 2 * (_OVERHEAD + MAX_DATA)))
    buffer = stream.read()
    at = len(buffer)
    while (at := buffer.rfind(_MARK, 0, at)) >= 0:
        record = _decode_record(buffer, at)
        if record is not None:
            return record.wall_ns
    return None


def _encode_part(record: LineRecord, data: bytes) -> bytes:
    out = _RECORD.pack(_MARK, record.kind, 0, len(data), record.monotonic_ns, record.wall_ns) + data
    return out + _CRC.pack(zlib.crc32(out))


def _decode_record(buffer: bytes, at: int) -> LineRecord | None:
    if len(buffer) - at < _OVERHEAD:
        return None
    mark, kind, _, size, monotonic_ns, wall_ns = _RECORD.unpack_from(buffer, at)
    end = at + _RECORD.size + size
    if mark != _MARK or kind not in _KINDS or end + _CRC.size > len(buffer):
        return None
    if _CRC.unpack_from(buffer, end)[0] != zlib.crc32(memoryview(buffer)[at:end]):
        return None
    return LineRecord(kind=_KINDS[kind], monotonic_ns=monotonic_ns, wall_ns=wall_ns, data=buffer[at + _RECORD.size : end])


def _is_cut_short(buffer: bytes, at: int) -> bool:
    """Tell whether a record begins here whose end is not in the buffer."""
    if not _MARK.startswith(buffer[at : at + len(_MARK)]):
        return False
    if len(buffer) - at < _RECORD.size:
        return True
    size: int = _RECORD.unpack_from(buffer, at)[3]
    return at + _OVERHEAD + size > len(buffer)


def _parse_header(text: bytes, *, name: str) -> RecordingHeader:
    try:
        facts = json.loads(text)
        header = RecordingHeader(
            port=str(facts["port"]),
            dialect=str(facts["dialect"]),
            software=str(facts["software"]),
            wall_ns=int(facts["wall_ns"]),
            monotonic_ns=int(facts["monotonic_ns"]),
            version=int(facts["version"]),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise RecordingError(path=name, reason=f"has a header that says too little: {error!r}") from error
    if header.version != FILE_VERSION:
        raise RecordingError(path=name, reason=f"is of version {header.version}, this program reads {FILE_VERSION}; use a newer one")
    return header
