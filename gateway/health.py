"""Counters of what happened, and the state of each radio."""

from collections import Counter
from enum import Enum


class RadioState(Enum):
    """Where a radio stands."""

    CONNECTING = "connecting"
    UP = "up"
    DOWN = "down"


class Health:
    """Counts events by dotted name and keeps each radio's state; names are few and fixed, so it is bounded."""

    __slots__ = ("_counters", "_radios")

    def __init__(self) -> None:
        self._counters: Counter[str] = Counter()
        self._radios: dict[str, RadioState] = {}

    def count(self, name: str, n: int = 1) -> None:
        """Add ``n`` to a counter."""
        self._counters[name] += n

    def set_level(self, name: str, value: int) -> None:
        """Set a counter that goes up and down, such as the length of a queue."""
        self._counters[name] = value

    def set_radio(self, radio: str, state: RadioState) -> None:
        """Say where a radio stands."""
        self._radios[radio] = state

    def counters(self) -> dict[str, int]:
        """Return all counters, by name."""
        return dict(sorted(self._counters.items()))

    def radios(self) -> dict[str, str]:
        """Return the state of every radio, by name."""
        return {name: state.value for name, state in sorted(self._radios.items())}
