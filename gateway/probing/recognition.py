"""What to say to an unknown dongle, and what its answers tell. Pure: bytes in, a guess out.

Each test frame is the most harmless that its family answers: none changes a setting, a network or a session. Sources: WIRE_FORMAT.md §3;
Digi 90002002 (API frames); TI SWRA198 (MT) and SWRA466 (ROM boot loader of CC26x2); Silicon Labs UG101 (ASH) and AN760 (boot loader menu).
"""

import re
import struct
from dataclasses import dataclass
from enum import Enum

from firmware_protocol.crc import crc16
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame

XBEE_ESCAPED = bytes((0x7E, 0x7D, 0x11, 0x13))
_PING = struct.pack("<BHB", 5, 0xB0B0, 0)  # of a session that no dongle has; were it its own, it would answer all the same
_MAX_MT = 250
_NATIVE_LENGTHS = {2: (4, 5), 4: (4,), 6: (4,)}  # RESET_ACK, ACK, NEED_RESET (§3.1): what a test frame brings about
_XBEE_AP, _XBEE_STATUS = b"\x88\x01AP", 0x8A  # the answer to the test frame; modem status, as after a restart
_ZNP_ANSWERS = {b"\x61\x01": 4, b"\x41\x80": 8}  # SYS_PING's answer with capabilities, SYS_RESET_IND with reason and version
_MT_BOOT_DONE = b"\x4d\x84\x00"  # the boot loader's answer to its handshake, and that all is well
_MAX_MT_BOOT = 24
_ASH_RSTACK, _ASH_ERROR, _ASH_VERSION, _ASH_FLAG = 0xC1, 0xC2, 0x02, 0x7E
_ROM_ACK = b"\x00\xcc"
_MENU = b"\nBL >"

TEST_FRAMES = (
    encode_frame(_PING)
    + bytes.fromhex("7e 00 04 08 01 41 50 65")  # AT command AP?
    + bytes.fromhex("fe 00 21 01 20")  # SYS_PING
    + bytes.fromhex("fe 00 4d 04 49")  # handshake of the serial boot loader of CC253x
)
"""To native dongles, XBee modules, Z-Stack and its boot loader, one behind the other: each takes the others' for noise."""

LAST_TESTS = (
    bytes.fromhex("1a c0 38 bc 7e"),  # ASH: cancel, then RST
    bytes.fromhex("55 55"),  # the ROM boot loader of CC26x2 finds its baud rate from this
    b"\r",  # a boot loader with a menu shows it
)
"""Further tests, each with an answer of its own to wait for, where nothing answered ``TEST_FRAMES``."""

CAN_VERSION = b"V\r"
"""Asks an slcan adapter for its version, on no bus; it comes last, when a carriage return has ended all that was said before."""

LEAVE_BOOT_LOADER = b"\xef"
"""Tells the serial boot loader of CC253x to start its firmware; nothing else knows this byte."""

RESET_ROM_BOOT_LOADER = bytes.fromhex("03 25 25")
"""COMMAND_RESET of the ROM boot loader of CC26x2 (SWRA466)."""


class Family(Enum):
    """What kind of thing answers."""

    NATIVE = "native"
    XBEE = "xbee"
    ZNP = "znp"
    EZSP = "ezsp"
    CC253X_BOOT_LOADER = "cc253x_boot_loader"
    CC26X2_BOOT_LOADER = "cc26x2_boot_loader"
    MENU_BOOT_LOADER = "menu_boot_loader"
    SLCAN = "slcan"


@dataclass(frozen=True, slots=True, kw_only=True)
class XbeeAnswer:
    """An answer to an AT command."""

    command: str
    status: int
    value: bytes
    frame_id: int


def recognise(data: bytes) -> Family | None:
    """Return what must have sent ``data``, which may begin and end anywhere; None where nothing proves it.

    Checks of 8 bits prove nothing by themselves: among random bytes at 115,200 baud a sound MT frame comes every six
    seconds. So only answers to the test frames count, and what a restart says; a port of random bytes gives one once in a million seconds.
    """
    if any(isinstance(body, bytes) and _is_native(body) for body in CobsDecoder().feed(data)):
        return Family.NATIVE
    if any(body[:4] == _XBEE_AP or (body[0] == _XBEE_STATUS and len(body) == 2) for body in xbee_bodies(data)):
        return Family.XBEE
    answers = mt_bodies(data)
    if any(body[:3] == _MT_BOOT_DONE and len(body) <= _MAX_MT_BOOT for body in answers):
        return Family.CC253X_BOOT_LOADER
    if any(len(body) == _ZNP_ANSWERS.get(body[:2]) for body in answers):
        return Family.ZNP
    if _is_ash(data):
        return Family.EZSP
    if _MENU in data or b"ootloader" in data:
        return Family.MENU_BOOT_LOADER
    return None


def is_can_adapter(said: bytes) -> bool:
    """Tell whether this is what an adapter of Lawicel's ASCII protocol (slcan) says to ``CAN_VERSION``, and nothing else is.

    BEL is its answer to what it does not know, such as the test frames before; CANable's firmware tells its name for a version.
    """
    return re.fullmatch(rb"[\r\a]*(V[0-9A-Fa-f]{4}\r|[ -~]{0,60}[cC][aA][nN][ -~]{0,60}\r\n?)?[\r\a]*", said) is not None and (
        b"\a" in said or len(said.strip(b"\r")) > 1
    )


def is_rom_acknowledgement(data: bytes) -> bool:
    """Tell whether this is all that the ROM boot loader of CC26x2 says to two bytes 0x55; too short to prove anything elsewhere."""
    return data in {_ROM_ACK, _ROM_ACK[1:]}


def xbee_bodies(data: bytes) -> list[bytes]:
    """Return the frame data of all sound XBee frames in ``data``, of mode 1 or 2."""
    bodies = []
    for at, byte in enumerate(data):
        if byte == 0x7E:
            plain = data[at + 1 :]
            body = _xbee_body(plain) or _xbee_body(_unescape(plain))
            if body is not None:
                bodies.append(body)
    return bodies


def xbee_answers(data: bytes) -> list[XbeeAnswer]:
    """Return the answers to AT commands in ``data``."""
    return [
        XbeeAnswer(frame_id=body[1], command=body[2:4].decode("latin-1"), status=body[4], value=body[5:])
        for body in xbee_bodies(data)
        if body[0] == 0x88 and len(body) >= 5
    ]


def xbee_query(command: str, *, frame_id: int) -> bytes:
    """Return the frame that asks for a parameter; it holds no byte that modes 1 and 2 write differently, save perhaps the checksum."""
    body = bytes((0x08, frame_id)) + command.encode("ascii")
    return b"\x7e\x00" + bytes((len(body),)) + body + bytes((0xFF - sum(body) % 256,))


def mt_bodies(data: bytes) -> list[bytes]:
    """Return command bytes and data of all sound MT frames in ``data``."""
    bodies = []
    for at, byte in enumerate(data):
        if byte == 0xFE and at + 1 < len(data) and data[at + 1] <= _MAX_MT:
            end = at + 4 + data[at + 1]
            check = 0
            for one in data[at + 1 : end]:
                check ^= one
            if end < len(data) and data[end] == check:
                bodies.append(data[at + 2 : end])
    return bodies


def mt_request(cmd0: int, cmd1: int) -> bytes:
    """Return an MT request without data."""
    return bytes((0xFE, 0, cmd0, cmd1, cmd0 ^ cmd1))


def _xbee_body(data: bytes) -> bytes | None:
    if len(data) < 4:
        return None
    length = data[0] << 8 | data[1]
    body = data[2 : 2 + length + 1]
    if not 1 <= length <= 0x200 or len(body) < length + 1 or sum(body) % 256 != 0xFF:
        return None
    return body[:-1]


def _unescape(data: bytes) -> bytes:
    out = bytearray()
    is_escaped = False
    for byte in data:
        if byte == 0x7E:
            break
        if is_escaped:
            out.append(byte ^ 0x20)
            is_escaped = False
        elif byte == 0x7D:
            is_escaped = True
        else:
            out.append(byte)
    return bytes(out)


def _is_native(body: bytes) -> bool:
    return len(body) in _NATIVE_LENGTHS.get(body[0] if body else 0, ())


def _is_ash(data: bytes) -> bool:
    """Tell whether an RSTACK or ERROR frame of ASH version 2 is in ``data`` (UG101): control, version, code, CRC."""
    for at in range(len(data) - 5):
        frame = data[at : at + 5]
        if data[at + 5] != _ASH_FLAG:
            continue
        if frame[0] in {_ASH_RSTACK, _ASH_ERROR} and frame[1] == _ASH_VERSION and crc16(frame[:3]) == frame[3] << 8 | frame[4]:
            return True
    return False
