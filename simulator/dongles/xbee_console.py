"""The text side of a virtual XBee in transparent mode: ``+++`` between two silences opens command mode, lines of AT commands follow."""

from collections.abc import Callable

from firmware_protocol.dialects.xbee_frames import AT_OK
from firmware_protocol.units import NS_PER_MS

_KNOCK = b"+++"
_LONGEST_LINE = 128


class XBeeConsole:
    """See the module.

    Parameters
    ----------
    obey
        Does an AT command at an instant [ns] and returns its status and value.
    read_time_ns
        Returns the guard time and the time after which command mode ends by itself [ns].
    """

    def __init__(self, *, obey: Callable[[str, bytes, int], tuple[int, bytes]], read_time_ns: Callable[[], tuple[int, int]]) -> None:
        self.is_in_command_mode = False
        self._obey = obey
        self._read_time_ns = read_time_ns
        self._knocked = b""
        self._line = b""
        self._heard_ns: int | None = None
        self._due_ns: int | None = None
        """When the silence after ``+++`` has been long enough, or command mode ends by itself."""

    @property
    def deadline_ns(self) -> int | None:
        """When ``handle_deadline`` is to be called."""
        return self._due_ns

    def feed(self, chunk: bytes, *, now_ns: int) -> tuple[bytes, bytes]:
        """Take bytes from the line; return the answer, and what is no command but data for the radio."""
        if not chunk:
            return b"", b""
        before_ns, self._heard_ns = self._heard_ns, now_ns
        if self.is_in_command_mode:
            return self._take_lines(chunk, now_ns), b""
        was_silent = before_ns is None or now_ns - before_ns >= self._read_time_ns()[0]
        if self._knocked or was_silent:
            knocked = self._knocked + chunk
            if _KNOCK.startswith(knocked):
                self._knocked = knocked
                self._due_ns = now_ns + self._read_time_ns()[0] if knocked == _KNOCK else None
                return b"", b""
        data, self._knocked, self._due_ns = self._knocked + chunk, b"", None
        return b"", data

    def handle_deadline(self, *, now_ns: int) -> bytes:
        """Open command mode after ``+++``, or leave it after a long silence; return what is said."""
        if self._due_ns is None or now_ns < self._due_ns:
            return b""
        if self.is_in_command_mode:
            self.leave()
            return b""
        self._knocked = self._line = b""
        self.is_in_command_mode = True
        self._due_ns = now_ns + self._read_time_ns()[1]
        return b"OK\r"

    def leave(self) -> None:
        """End command mode, and forget what was half said."""
        self.is_in_command_mode = False
        self._knocked = self._line = b""
        self._due_ns = None

    def _take_lines(self, chunk: bytes, now_ns: int) -> bytes:
        *lines, self._line = (self._line + chunk).split(b"\r")
        self._line = self._line[-_LONGEST_LINE:]
        answer = b""
        for line in lines:
            if self.is_in_command_mode:
                answer += self._answer(line.strip(b"\n"), now_ns)
        return answer

    def _answer(self, line: bytes, now_ns: int) -> bytes:
        if line[:2].upper() != b"AT":
            return b"ERROR\r"
        answer = b""
        for command in line[2:].split(b","):
            name, text = command[:2].decode("latin-1").upper(), command[2:].strip()
            if name == "CN":
                self.leave()
                return answer + b"OK\r"
            value = text if name == "NI" else _from_hex(text)
            status, given = (1, b"") if value is None else self._obey(name, value, now_ns)
            if status != AT_OK:
                answer += b"ERROR\r"
            else:
                self._due_ns = now_ns + self._read_time_ns()[1]  # only what is understood keeps command mode up
                answer += (_as_text(name, given) if given else b"OK") + b"\r"
        return answer


def guard_and_end_ns(*, guard_ms: int, end_tenths: int) -> tuple[int, int]:
    """Return ``GT`` [ms] and ``CT`` [0.1 s] in nanoseconds."""
    return guard_ms * NS_PER_MS, end_tenths * 100 * NS_PER_MS


def _from_hex(text: bytes) -> bytes | None:
    try:
        return bytes.fromhex(("0" * (len(text) % 2)) + text.decode("ascii"))
    except (ValueError, UnicodeDecodeError):
        return None


def _as_text(name: str, value: bytes) -> bytes:
    return value if name == "NI" else b"%X" % int.from_bytes(value, "big")
