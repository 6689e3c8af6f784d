"""Writes pcapng, the capture format of Wireshark (draft-ietf-opsawg-pcapng): a section, its interfaces, its packets."""

import struct
from enum import IntEnum
from typing import BinaryIO

_SECTION_TYPE, _INTERFACE_TYPE, _PACKET_TYPE = 0x0A0D0D0A, 1, 6
_BYTE_ORDER = 0x1A2B3C4D
_END_OF_OPTIONS = 0
_COMMENT = 1
_USER_APPLICATION, _INTERFACE_NAME, _INTERFACE_DESCRIPTION, _TIME_RESOLUTION, _PACKET_FLAGS = 4, 2, 3, 9, 2
_INBOUND, _OUTBOUND = 1, 2
_NANOSECONDS = b"\x09"  # the resolution is 10 to the minus this [s]


class LinkType(IntEnum):
    """What the packets of an interface are (tcpdump.org/linktypes.html)."""

    USER0 = 147
    CAN_SOCKETCAN = 227
    IEEE802_15_4_TAP = 283


class PcapngWriter:
    """Writes one section to a binary stream; interfaces are numbered in the order in which they are added.

    Parameters
    ----------
    stream
        Need not be seekable: a pipe into Wireshark will do.
    comment, software
        Of the section.
    """

    def __init__(self, stream: BinaryIO, *, comment: str, software: str) -> None:
        self._stream = stream
        self._n_interfaces = 0
        body = struct.pack("<IHHq", _BYTE_ORDER, 1, 0, -1)  # version 1.0, length not known
        self._write(_SECTION_TYPE, body + _options((_COMMENT, comment.encode()), (_USER_APPLICATION, software.encode())))

    def add_interface(self, link_type: LinkType, *, name: str, description: str) -> int:
        """Add an interface and return its number."""
        options = _options(
            (_INTERFACE_NAME, name.encode()), (_INTERFACE_DESCRIPTION, description.encode()), (_TIME_RESOLUTION, _NANOSECONDS)
        )
        self._write(_INTERFACE_TYPE, struct.pack("<HHI", link_type, 0, 0) + options)
        self._n_interfaces += 1
        return self._n_interfaces - 1

    def write_packet(self, interface: int, data: bytes, *, wall_ns: int, is_outgoing: bool, comments: tuple[str, ...] = ()) -> None:
        """Write a packet of an interface; ``is_outgoing``: to the dongle."""
        flags = struct.pack("<I", _OUTBOUND if is_outgoing else _INBOUND)
        head = struct.pack("<IIIII", interface, wall_ns >> 32 & 0xFFFFFFFF, wall_ns & 0xFFFFFFFF, len(data), len(data))
        options = _options((_PACKET_FLAGS, flags), *((_COMMENT, comment.encode()) for comment in comments))
        self._write(_PACKET_TYPE, head + _padded(data) + options)

    def flush(self) -> None:
        """Hand all to the operating system, so that a reader of a pipe sees it."""
        self._stream.flush()

    def _write(self, kind: int, body: bytes) -> None:
        size = struct.pack("<I", len(body) + 12)
        self._stream.write(struct.pack("<I", kind) + size + body + size)


def _options(*options: tuple[int, bytes]) -> bytes:
    out = b"".join(struct.pack("<HH", code, len(value)) + _padded(value) for code, value in options)
    return out + struct.pack("<HH", _END_OF_OPTIONS, 0)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)
