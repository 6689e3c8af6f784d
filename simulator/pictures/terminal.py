"""A terminal that a picture borrows: its second screen, given back whatever happens, with the log lines that fell meanwhile."""

import collections
import contextlib
import io
import os
import signal
import threading
from collections.abc import Mapping, Sequence
from typing import Self, TextIO

from simulator.log import diverted_logs

_MAX_HELD_LINES = 1_000
_FALLBACK_SIZE = (80, 24)

# xterm's control sequences: DECSET 1049 (second screen, cursor kept) and 25 (cursor shown), CUP, and ECMA-48 EL and ED.
_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l\x1b[2J", "\x1b[0m\x1b[?25h\x1b[?1049l"
_HOME, _CLEAR_LINE, _CLEAR_BELOW = "\x1b[H", "\x1b[K", "\x1b[J"


def can_show_pictures(stream: TextIO, environment: Mapping[str, str]) -> bool:
    """Tell whether a stream is a terminal that understands more than lines."""
    return stream.isatty() and environment.get("TERM", "dumb") != "dumb"


def wants_colours(environment: Mapping[str, str]) -> bool:
    """Tell whether colours are welcome: NO_COLOR is not set, or empty."""
    return not environment.get("NO_COLOR")


class Terminal:
    """The second screen of a terminal; use it in a ``with`` statement.

    Parameters
    ----------
    stream
        An open terminal.

    Notes
    -----
    While the screen is borrowed, the simulator's log is held back (the last 1,000 lines), and written when it is given back.
    Ctrl-Z gives it back for as long as the process is stopped.
    """

    __slots__ = ("_borrowed", "_held", "_stack", "_stream")

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._held = _HeldLines()
        self._stack = contextlib.ExitStack()
        self._borrowed = False

    def __enter__(self) -> Self:
        self._stack.callback(self._write_held)
        self._stack.enter_context(diverted_logs(self._held))
        self._stack.callback(self._leave)
        if threading.current_thread() is threading.main_thread():
            before = signal.signal(signal.SIGTSTP, self._suspend)
            self._stack.callback(signal.signal, signal.SIGTSTP, before)
        self._enter()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def last_log_line(self) -> str:
        """The newest of the log lines held back, or nothing."""
        return self._held.lines[-1] if self._held.lines else ""

    def size(self) -> tuple[int, int]:
        """Return how many columns and rows of characters fit now."""
        try:
            columns, rows = os.get_terminal_size(self._stream.fileno())
        except (OSError, ValueError):
            return _FALLBACK_SIZE
        return columns or _FALLBACK_SIZE[0], rows or _FALLBACK_SIZE[1]

    def show(self, lines: Sequence[str]) -> None:
        """Replace the picture; what is shown is never wider than ``lines`` are, so they must fit."""
        self._write(_HOME + "\r\n".join(line + _CLEAR_LINE for line in lines) + _CLEAR_BELOW)

    def _enter(self) -> None:
        self._borrowed = True
        self._write(_ENTER)

    def _leave(self) -> None:
        if self._borrowed:
            self._borrowed = False
            self._write(_LEAVE)

    def _suspend(self, number: int, frame: object) -> None:
        del frame
        self._leave()
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        # Here the process stands still, until it is continued.
        signal.signal(number, self._suspend)
        self._enter()

    def _write_held(self) -> None:
        self._write("".join(line + "\n" for line in self._held.lines))

    def _write(self, text: str) -> None:
        # A terminal that went away (a closed window) is no reason to lose a run.
        with contextlib.suppress(OSError, ValueError):
            self._stream.write(text)
            self._stream.flush()


class _HeldLines(io.StringIO):
    """A text stream that keeps its last lines."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: collections.deque[str] = collections.deque(maxlen=_MAX_HELD_LINES)

    def write(self, text: str) -> int:
        """Take in what a log handler writes: whole lines."""
        self.lines.extend(text.splitlines())
        return len(text)
