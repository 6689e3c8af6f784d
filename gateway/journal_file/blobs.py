"""The bytes of a segment: records, pairs and reports, packed and checked. Pure.

Records: their number, the length of each, then one after the other as MessagePack. Pairs: four octets a record, so that SQLite's
``instr`` finds the segments that may hold a pair without unpacking them. Reports: one after the other. All integers are little-endian.
"""

import sqlite3
import struct
import sys
import zlib
from array import array
from collections.abc import Iterable, Iterator, Sequence

from firmware_protocol.units import BootId, NodeId
from gateway.journal_file.writes import UplinkReport

NO_PAIR = 0xFFFF_FFFF
"""In the place of a pair where a record has none: twice the broadcast number, which is nobody's."""

RECORDS_COMPRESSED, REPORTS_COMPRESSED = 1, 2
"""Bits of a segment's ``encoding``."""

_SMALLEST_TO_COMPRESS = 1024
"""Octets; below, zlib's own head and tables eat what it saves. Such segments are merged, and compressed then."""

_LEVEL = 1
# Measured 2026-11 on encounter records with one or two sides: level 1 makes 331 octets 57 for 1.3 us a record, level 3 makes them 54 for
# 1.9, level 6 makes them 48 for 6.5.

_REPORT = struct.Struct("<IIqqqIbBBH")
"""Node, boot, number, next number, received, address, RSSI, LQI, length of the radio's name, length of the payload."""


class DamagedSegmentError(sqlite3.DatabaseError):
    """The bytes of a segment are not what was written: to whoever reads, one more way in which a file is damaged."""


def pair_key(node_a: int, node_b: int) -> int:
    """Return what a pair is looked for with; a few other pairs may have the same where a number is beyond 16 bits."""
    return (node_a & 0xFFFF) << 16 | (node_b & 0xFFFF)


def pack_pairs(keys: Iterable[int]) -> bytes:
    """Return the pairs of a segment's records, in their order."""
    return _pack_numbers(keys)


def pair_needle(node_a: int, node_b: int) -> bytes:
    """Return what ``instr`` looks for in a segment's pairs; it may be found where it is not aligned, and mean nothing."""
    return pair_key(node_a, node_b).to_bytes(4, "little")


def pack_records(bodies: list[bytes]) -> bytes:
    """Return a segment's records, not compressed yet."""
    return b"".join((len(bodies).to_bytes(4, "little"), _pack_numbers(map(len, bodies)), *bodies))


def unpack_records(packed: bytes) -> list[bytes]:
    """Return the records of a segment, each as its MessagePack.

    Raises
    ------
    DamagedSegmentError
        The lengths do not add up.
    """
    lengths, end = _read_lengths(packed)
    bodies = []
    for length in lengths:
        bodies.append(packed[end : end + length])
        end += length
    return bodies


def join_records(parts: Sequence[bytes]) -> bytes:
    """Return the records of neighbours as those of one segment, without looking at each.

    Raises
    ------
    DamagedSegmentError
        The lengths of one do not add up.
    """
    ends = [_read_lengths(part)[1] for part in parts]
    n_records = sum(end - 4 for end in ends) // 4
    lengths = (part[4:end] for part, end in zip(parts, ends, strict=True))
    bodies = (part[end:] for part, end in zip(parts, ends, strict=True))
    return b"".join((n_records.to_bytes(4, "little"), *lengths, *bodies))


def pack_report(report: UplinkReport) -> bytes:
    """Return a report; raises ``struct.error`` or ``UnicodeEncodeError`` where it can never be stored."""
    radio = report.radio.encode()
    head = _REPORT.pack(
        report.node,
        report.boot,
        report.number,
        report.next_number,
        report.received_wall_ns,
        report.address,
        report.rssi_dbm,
        report.lqi,
        len(radio),
        len(report.payload),
    )
    return head + radio + report.payload


def unpack_reports(packed: bytes) -> Iterator[UplinkReport]:
    """Yield the reports of a segment.

    Raises
    ------
    DamagedSegmentError
        The bytes end within a report, or a name is no text.
    """
    at = 0
    try:
        while at < len(packed):
            node, boot, number, next_number, received, address, rssi_dbm, lqi, n_radio, n_payload = _REPORT.unpack_from(packed, at)
            at += _REPORT.size
            radio, payload = packed[at : at + n_radio].decode(), packed[at + n_radio : at + n_radio + n_payload]
            at += n_radio + n_payload
            if at > len(packed):
                raise DamagedSegmentError("it ends within a report")
            yield UplinkReport(
                node=NodeId(node),
                boot=BootId(boot),
                number=number,
                next_number=next_number,
                received_wall_ns=received,
                radio=radio,
                address=address,
                rssi_dbm=rssi_dbm,
                lqi=lqi,
                payload=payload,
            )
    except (struct.error, UnicodeDecodeError) as error:
        raise DamagedSegmentError(f"its reports cannot be read: {error}") from error


def read_contents(connection: sqlite3.Connection, segment: int, *, crc: int) -> tuple[bytes, bytes, bytes]:
    """Return a segment's pairs, records and reports as they are stored, each byte as it was written.

    Raises
    ------
    DamagedSegmentError
        They are not what was written, or the database cannot find them.
    """
    try:
        row = connection.execute("SELECT pairs, records, reports FROM contents WHERE segment = ?", (segment,)).fetchone()
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_CORRUPT:
            raise DamagedSegmentError(str(error)) from error
        raise
    if row is None:
        raise DamagedSegmentError("it has no contents")
    pairs, records, reports = row
    if checksum(pairs, records, reports) != crc:
        raise DamagedSegmentError("its bytes are not those that were written (CRC-32)")
    return pairs, records, reports


def compress(packed: bytes) -> tuple[bytes, bool]:
    """Return the bytes as they are stored, and whether they are compressed."""
    if len(packed) < _SMALLEST_TO_COMPRESS:
        return packed, False
    small = zlib.compress(packed, _LEVEL)
    return (small, True) if len(small) < len(packed) else (packed, False)


def decompress(stored: bytes, *, is_compressed: bool) -> bytes:
    """Return the bytes that were stored.

    Raises
    ------
    DamagedSegmentError
        They are none of zlib's.
    """
    if not is_compressed:
        return stored
    try:
        return zlib.decompress(stored)
    except zlib.error as error:
        raise DamagedSegmentError(f"it cannot be decompressed: {error}") from error


def checksum(*parts: bytes) -> int:
    """Return the CRC-32 of all parts together."""
    total = 0
    for part in parts:
        total = zlib.crc32(part, total)
    return total


def _read_lengths(packed: bytes) -> tuple["array[int]", int]:
    """Return the length of each record, and where the first one begins."""
    n_records = int.from_bytes(packed[:4], "little")
    end = 4 + 4 * n_records
    lengths = array("I", packed[4:end]) if len(packed) >= end else array("I")
    if sys.byteorder == "big":
        lengths.byteswap()
    if len(packed) < 4 or len(lengths) != n_records or end + sum(lengths) != len(packed):
        raise DamagedSegmentError("the lengths of its records do not add up")
    return lengths, end


def _pack_numbers(numbers: Iterable[int]) -> bytes:
    packed = array("I", numbers)
    if sys.byteorder == "big":
        packed.byteswap()
    return packed.tobytes()
