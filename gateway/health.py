"""Counters of what happened, and the state of each radio."""

import time
from collections import Counter
from dataclasses import dataclass, replace
from enum import Enum


class RadioState(Enum):
    """Where a radio stands."""

    CONNECTING = "connecting"
    UP = "up"
    DOWN = "down"


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioCondition:
    """Where a radio stands, since when, and what is the matter."""

    state: RadioState
    since_wall_ns: int
    reason: str = ""
    """Why it is down; empty where nothing is the matter."""
    n_attempts: int = 0
    """How often it was tried since it went down."""
    firmware: str = ""
    """What the dongle last said that it is, in its maker's words."""


class Health:
    """Counts events by dotted name and keeps each radio's state; names are few and fixed, so it is bounded."""

    __slots__ = ("_counters", "_radios")

    def __init__(self) -> None:
        self._counters: Counter[str] = Counter()
        self._radios: dict[str, RadioCondition] = {}

    def count(self, name: str, n: int = 1) -> None:
        """Add ``n`` to a counter."""
        self._counters[name] += n

    def set_level(self, name: str, value: int) -> None:
        """Set a counter that goes up and down, such as the length of a queue."""
        self._counters[name] = value

    def set_radio(self, radio: str, state: RadioState, *, reason: str = "") -> None:
        """Say where a radio stands, and why it is down."""
        known = self._radios.get(radio)
        if known is None or known.state is not state:
            firmware = "" if known is None else known.firmware
            known = RadioCondition(state=state, since_wall_ns=time.time_ns(), firmware=firmware)
        self._radios[radio] = replace(known, reason=reason)

    def note_attempts(self, radio: str, n_attempts: int) -> None:
        """Say how often a radio was tried."""
        self._radios[radio] = replace(self._radios[radio], n_attempts=n_attempts)

    def note_firmware(self, radio: str, firmware: str) -> None:
        """Say what a radio's dongle is."""
        self._radios[radio] = replace(self._radios[radio], firmware=firmware)

    def counters(self) -> dict[str, int]:
        """Return all counters, by name."""
        return dict(sorted(self._counters.items()))

    def radios(self) -> dict[str, str]:
        """Return the state of every radio, by name."""
        return {name: condition.state.value for name, condition in sorted(self._radios.items())}

    def radio_conditions(self) -> dict[str, RadioCondition]:
        """Return all that is known of every radio, by name."""
        return dict(sorted(self._radios.items()))
