"""What one end of a link has to send: payloads that wait, and those in its window (WIRE_FORMAT.md §3.3). Used by ``link.py``.

A payload gets its number when it is handed out to be written, not before: until then an urgent one goes ahead of it, and it can be taken
back. What was handed out keeps its place, since go-back-N needs an order that stands.
"""

from collections import deque
from dataclasses import dataclass, field

Entry = tuple[int, bytes]
"""Ticket and payload."""


@dataclass(slots=True, kw_only=True)
class LinkQueue:
    """See the module; ``window`` and ``urgent_window`` are those of ``LinkConfig``."""

    window: int
    urgent_window: int
    n_repeated: int = 0
    """Payloads handed out more than once."""
    _urgent: deque[Entry] = field(default_factory=deque)
    _unsent: deque[Entry] = field(default_factory=deque)
    _in_window: deque[Entry] = field(default_factory=deque)
    """Numbered ones first, then urgent ones, then others."""
    _n_numbered: int = 0
    _n_handed_out: int = 0
    """Of the numbered ones, since the window was last to be repeated."""
    _n_urgent_next: int = 0
    """Urgent ones behind the numbered ones."""

    def __len__(self) -> int:
        """Return how many payloads wait or are not acknowledged."""
        return len(self._urgent) + len(self._unsent) + len(self._in_window)

    @property
    def n_in_window(self) -> int:
        """Payloads that are handed out, or may be now."""
        return len(self._in_window)

    @property
    def n_numbered(self) -> int:
        """Payloads that were handed out and are not acknowledged."""
        return self._n_numbered

    @property
    def has_next(self) -> bool:
        """Whether ``take`` gives one."""
        return self._n_handed_out < len(self._in_window)

    def add(self, entry: Entry, *, is_urgent: bool, is_first: bool) -> None:
        """Let a payload wait; a first one waits before all that was not handed out, urgent ones too."""
        if is_first:
            self._add_first(entry)
        else:
            (self._urgent if is_urgent else self._unsent).append(entry)

    def _add_first(self, entry: Entry) -> None:
        first, last = self._n_numbered, self._n_numbered + self._n_urgent_next
        for _ in range(first, last):
            self._urgent.appendleft(self._in_window[last - 1])
            last -= 1
            del self._in_window[last]
        self._n_urgent_next = 0
        self._urgent.appendleft(entry)

    def fill_window(self) -> None:
        """Let into the window what it has room for; nothing else may, while urgent ones wait."""
        while self._urgent and len(self._in_window) < max(self.window, self.urgent_window):
            self._in_window.insert(self._n_numbered + self._n_urgent_next, self._urgent.popleft())
            self._n_urgent_next += 1
        while self._unsent and not self._urgent and len(self._in_window) < self.window:
            self._in_window.append(self._unsent.popleft())

    def take(self) -> tuple[int, bytes] | None:
        """Hand out the next payload: how many stand before it in the window, and what it says."""
        index = self._n_handed_out
        if index >= len(self._in_window):
            return None
        self._n_handed_out += 1
        if index < self._n_numbered:
            self.n_repeated += 1
        else:
            self._n_numbered += 1
            self._n_urgent_next = max(0, self._n_urgent_next - 1)
        return index, self._in_window[index][1]

    def cancel(self, ticket: int) -> bool:
        """Take back a payload that was not handed out; return whether it was not."""
        for queue in (self._urgent, self._unsent):
            for entry in queue:
                if entry[0] == ticket:
                    queue.remove(entry)
                    return True
        for index in range(self._n_numbered, len(self._in_window)):
            if self._in_window[index][0] == ticket:
                self._n_urgent_next -= index < self._n_numbered + self._n_urgent_next
                del self._in_window[index]
                return True
        return False

    def acknowledge(self, n: int) -> list[int]:
        """Forget the first ``n`` of those that were handed out; return their tickets."""
        self._n_numbered -= n
        self._n_handed_out = max(0, self._n_handed_out - n)
        return [self._in_window.popleft()[0] for _ in range(n)]

    def repeat(self) -> None:
        """Hand out again all that was."""
        self._n_handed_out = 0

    def start_anew(self) -> None:
        """Let all in the window wait again, before all others: numbers begin anew."""
        self._unsent.extendleft(reversed(self._in_window))
        self._in_window.clear()
        self._n_numbered = self._n_handed_out = self._n_urgent_next = 0

    def drop_all(self) -> tuple[int, ...]:
        """Forget everything; return the tickets."""
        dropped = tuple(entry[0] for entry in (*self._in_window, *self._urgent, *self._unsent))
        for queue in (self._in_window, self._urgent, self._unsent):
            queue.clear()
        self._n_numbered = self._n_handed_out = self._n_urgent_next = 0
        return dropped
