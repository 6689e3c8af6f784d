"""The checksum of the wire format: CRC-16/IBM-3740 (also called CCITT-FALSE); and the short one of CAN identifiers.

Polynomial 0x1021, initial value 0xFFFF, not reflected, no final XOR; check value of ``b"123456789"``: 0x29B1 (WIRE_FORMAT.md §2).
CRC-6/CDMA2000-A has polynomial 0x27 and initial value 0x3F; its check value is 0x0D (WIRE_FORMAT.md §10.1).
"""

import binascii

CRC_SIZE = 2
CRC_INITIAL = 0xFFFF

_CRC6_POLYNOMIAL = 0x27 << 2  # kept in the upper six bits of an octet, so that data goes in octet by octet


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


def crc6(data: bytes) -> int:
    """Return the CRC-6/CDMA2000-A of ``data``; it finds every run of up to six damaged bits."""
    crc = 0xFC
    for octet in data:
        crc = _CRC6_TABLE[crc ^ octet]
    return crc >> 2


def _crc6_of_octet(octet: int) -> int:
    for _ in range(8):
        octet = octet << 1 ^ _CRC6_POLYNOMIAL if octet & 0x80 else octet << 1
        octet &= 0xFF
    return octet


_CRC6_TABLE = tuple(map(_crc6_of_octet, range(256)))
