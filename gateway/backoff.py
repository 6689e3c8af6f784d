"""How long to wait before the next attempt: doubled after each, drawn at random from its upper half, never above a limit."""

import random

_LEAST = 0.5
"""Of a pause at most so much is saved by the draw: radios that failed together do not try together, and none is asked twice at once."""


class Backoff:
    """Pauses between attempts that go on for ever.

    Parameters
    ----------
    first_s, max_s
        Longest pause after the first failure, and ever [s].
    """

    def __init__(self, *, first_s: float, max_s: float) -> None:
        self._first_s = first_s
        self._max_s = max_s
        self._next_s = min(first_s, max_s)

    def start_anew(self) -> None:
        """Begin with the first pause again: what was tried has held."""
        self._next_s = min(self._first_s, self._max_s)

    def take_s(self) -> float:
        """Return the next pause [s]."""
        pause_s, self._next_s = self._next_s, min(2 * self._next_s, self._max_s)
        return pause_s * random.uniform(_LEAST, 1.0)
