"""An slcan adapter on a pseudo-terminal, with a bus behind it on which a virtual coordinator is the only other node.

It speaks the ASCII protocol of Lawicel's CAN232 and CANUSB (CAN232 manual, version 3: S, s, O, L, C, t, T, r, R, V, N, F), with the CAN FD
commands Y, d, D, b and B of the CANable 2.0 firmware, in the form that python-can's ``slcan`` uses.
"""

import asyncio
from collections import Counter
from pathlib import Path

from firmware_protocol.framing.can_frame import FD_SIZES, CanFrame, RecordReader, encode_record
from simulator.lines.virtual_serial import PtyEnd

_OK, _BELL, _END = b"\r", b"\a", 0x0D
_MAX_LINE = 1 + 8 + 1 + 128
"""Longest command: an FD frame with a 29-bit identifier and 64 octets of data, without its end."""

_IDENTIFIER_DIGITS = {"t": 3, "r": 3, "d": 3, "b": 3, "T": 8, "R": 8, "D": 8, "B": 8}
_FD_COMMANDS, _REMOTE_COMMANDS = "dDbB", "rR"
_ANSWERS = {"V": b"V1013\r", "N": b"NB10B\r", "F": b"F00\r"}
_HEX = frozenset("0123456789ABCDEFabcdef")


class SlcanAdapter:
    """The adapter itself, without I/O: characters on its serial side, records (WIRE_FORMAT.md §10.2) on its bus."""

    def __init__(self) -> None:
        self.is_open = False
        """Its channel is open: frames pass."""
        self.faults: Counter[str] = Counter()
        self._line = bytearray()
        self._records = RecordReader()
        self._listens_only = False

    def feed(self, data: bytes) -> tuple[bytes, bytes]:
        """Take characters from the host; return what it is answered, and the records that go on the bus."""
        answers, records = bytearray(), bytearray()
        for octet in data:
            if octet != _END:
                if len(self._line) <= _MAX_LINE:
                    self._line.append(octet)
                continue
            line = self._line.decode("ascii", errors="replace")
            self._line.clear()
            answer, record = self._obey(line)
            if answer == _BELL:
                self.faults["slcan_refused"] += 1
            answers += answer
            records += record
        return bytes(answers), bytes(records)

    def pass_on(self, records: bytes) -> bytes:
        """Take records from the bus; return the characters that tell the host of them. A closed channel hears nothing."""
        frames = [one for one in self._records.feed(records) if isinstance(one, CanFrame)]
        if not self.is_open:
            return b""
        return b"".join(map(_line_of, frames))

    def _obey(self, line: str) -> tuple[bytes, bytes]:
        command, rest = line[:1], line[1:]
        if command in _IDENTIFIER_DIGITS:
            return self._transmit(command, rest)
        if not line or (command in "SY" and rest.isdigit()) or (command == "s" and len(rest) == 4 and _HEX.issuperset(rest)):
            return (_BELL if line and self.is_open else _OK), b""
        if line in _ANSWERS:
            return _ANSWERS[line], b""
        if line in {"O", "L"}:
            answer = _BELL if self.is_open else _OK
            self.is_open, self._listens_only = True, line == "L"
            return answer, b""
        if line == "C":
            answer = _OK if self.is_open else _BELL
            self.is_open = False
            return answer, b""
        return _BELL, b""

    def _transmit(self, command: str, rest: str) -> tuple[bytes, bytes]:
        digits = _IDENTIFIER_DIGITS[command]
        identifier, length, data = rest[:digits], rest[digits : digits + 1], rest[digits + 1 :]
        is_remote, is_fd = command in _REMOTE_COMMANDS, command in _FD_COMMANDS
        if not self.is_open or self._listens_only or len(identifier) != digits or not length or not _HEX.issuperset(rest):
            return _BELL, b""
        code = int(length, 16)
        if code > 8 and not is_fd:
            return _BELL, b""
        if int(identifier, 16) >> (29 if digits == 8 else 11) or len(data) != (0 if is_remote else 2 * FD_SIZES[code]):
            return _BELL, b""
        answer = b"Z\r" if digits == 8 else b"z\r"
        if is_remote or digits == 3:
            return answer, b""  # it goes out, but means nothing to a coordinator
        frame = CanFrame(can_id=int(identifier, 16), data=bytes.fromhex(data), is_fd=is_fd)
        return answer, encode_record(frame)


def _line_of(frame: CanFrame) -> bytes:
    command = "B" if frame.is_fd else "T"
    return f"{command}{frame.can_id:08X}{FD_SIZES.index(len(frame.data)):X}{frame.data.hex().upper()}\r".encode()


class SlcanEnd:
    """The adapter's serial port, under a symbolic link as with ``PtyEnd``; to the simulator it is a line of records.

    Raises
    ------
    LineError
        As ``PtyEnd``.
    """

    def __init__(self, path: Path, *, dialect: str) -> None:
        self._path = path
        self._dialect = dialect
        self._pty = PtyEnd(path)
        self._adapter = SlcanAdapter()
        self._writing = asyncio.Lock()

    @property
    def address(self) -> str:
        """Return ``can:slcan:``, the link's path and what the coordinator behind it speaks."""
        name, _, unit = self._dialect.partition(":")
        return f"can:slcan:{self._path}?unit={unit}{'&fd=1' if name == 'canfd' else ''}"

    async def read(self) -> bytes:
        """See ``SerialEnd``."""
        while True:
            answers, records = self._adapter.feed(await self._pty.read())
            if answers:
                async with self._writing:
                    await self._pty.write(answers)
            if records:
                return records

    async def write(self, data: bytes) -> None:
        """See ``SerialEnd``."""
        async with self._writing:
            await self._pty.write(self._adapter.pass_on(data))

    async def unplug(self) -> None:
        """See ``SerialEnd``; the adapter loses its power, and its channel is closed."""
        await self._pty.unplug()
        self._adapter = SlcanAdapter()

    async def plug_in(self) -> None:
        """See ``SerialEnd``."""
        await self._pty.plug_in()

    async def aclose(self) -> None:
        """See ``PtyEnd.aclose``."""
        await self._pty.aclose()
