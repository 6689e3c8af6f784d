"""The one checksum of the wire format: CRC-16/IBM-3740 (also called CCITT-FALSE).

Polynomial 0x1021, initial value 0xFFFF, not reflected, no final XOR; check value of ``b"123456789"``: 0x29B1 (WIRE_FORMAT.md §2).
"""

import binascii

CRC_SIZE = 2
CRC_INITIAL = 0xFFFF


def crc16(data: bytes) -> int:
    """Return the CRC-16/IBM-3740 of ``data``."""
    return binascii.crc_hqx(data, CRC_INITIAL)


def append_crc(data: bytes) -> bytes:
    """Return ``data`` followed by its checksum, high byte first."""
    return data + crc16(data).to_bytes(CRC_SIZE, "big")


def strip_crc(data: bytes) -> bytes | None:
    """Return ``data`` without its checksum, or None where the checksum is wrong or missing."""
    if len(data) < CRC_SIZE or crc16(data) != 0:  # a CRC without final XOR of data and its own CRC is zero
        return None
    return data[:-CRC_SIZE]
