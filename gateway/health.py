"""What happened and how things stand, in numbers: counters, levels, durations, and the condition of each radio.

Written on the event loop; other threads only read copies. Names are few and fixed, so all of it is bounded.
"""

import time
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Self

DURATION_BOUNDS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0)
"""Upper bounds of the classes in which durations are counted [s]; what is longer has a class of its own."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Durations:
    """How many durations fell into each class of ``DURATION_BOUNDS_S`` and beyond the last, and the sum of all [s]."""

    classes: tuple[int, ...]
    sum_s: float


@dataclass(frozen=True, slots=True)
class _Shared:
    """What all radios' views of one Health have in common."""

    levels: dict[str, int] = field(default_factory=dict)
    durations: dict[str, tuple[list[int], list[float]]] = field(default_factory=dict)
    conditions: dict[str, RadioCondition] = field(default_factory=dict)


class Health:
    """Counts events by dotted name, for each radio too where they are a radio's, and keeps levels, durations and conditions."""

    __slots__ = ("_counters", "_of_radios", "_shared")

    def __init__(self, shared: _Shared | None = None) -> None:
        self._counters: Counter[str] = Counter()
        self._shared = shared or _Shared()
        self._of_radios: dict[str, Self] = {}

    def of_radio(self, radio: str) -> Self:
        """Return where to count what is of one radio: all is shared with this one, except that counters are also kept apart."""
        return self._of_radios.setdefault(radio, type(self)(self._shared))

    def count(self, name: str, n: int = 1) -> None:
        """Add ``n`` to a counter."""
        self._counters[name] += n

    def set_level(self, name: str, value: int) -> None:
        """Set what goes up and down, such as the length of a queue."""
        self._shared.levels[name] = value

    def observe(self, name: str, duration_s: float) -> None:
        """Count a duration [s] in its class."""
        if name not in self._shared.durations:
            self._shared.durations[name] = ([0] * (len(DURATION_BOUNDS_S) + 1), [0.0])
        classes, total = self._shared.durations[name]
        classes[bisect_left(DURATION_BOUNDS_S, duration_s)] += 1
        total[0] += duration_s

    def set_radio(self, radio: str, state: RadioState, *, reason: str = "") -> None:
        """Say where a radio stands, and why it is down."""
        known = self._shared.conditions.get(radio)
        if known is None or known.state is not state:
            firmware = "" if known is None else known.firmware
            known = RadioCondition(state=state, since_wall_ns=time.time_ns(), firmware=firmware)
        self._shared.conditions[radio] = replace(known, reason=reason)

    def note_attempts(self, radio: str, n_attempts: int) -> None:
        """Say how often a radio was tried."""
        self._shared.conditions[radio] = replace(self._shared.conditions[radio], n_attempts=n_attempts)

    def note_firmware(self, radio: str, firmware: str) -> None:
        """Say what a radio's dongle is."""
        self._shared.conditions[radio] = replace(self._shared.conditions[radio], firmware=firmware)

    def counters(self) -> dict[str, int]:
        """Return all counters and levels by name, those of radios summed over all radios."""
        every = Counter(self._counters.copy())
        for counters in self.radio_counters().values():
            every.update(counters)
        return dict(sorted({**every, **self._shared.levels}.items()))

    def own_counters(self) -> dict[str, int]:
        """Return the counters that were not kept apart for a radio, by name."""
        return dict(self._counters)

    def radio_counters(self) -> dict[str, dict[str, int]]:
        """Return, for each radio, the counters that were kept apart for it."""
        return {radio: view.own_counters() for radio, view in sorted(self._of_radios.copy().items())}

    def levels(self) -> dict[str, int]:
        """Return all levels, by name."""
        return dict(self._shared.levels)

    def durations(self) -> dict[str, Durations]:
        """Return all durations, by name."""
        return {name: Durations(classes=tuple(classes), sum_s=total[0]) for name, (classes, total) in self._shared.durations.copy().items()}

    def radios(self) -> dict[str, str]:
        """Return the state of every radio, by name."""
        return {name: condition.state.value for name, condition in self.radio_conditions().items()}

    def radio_conditions(self) -> dict[str, RadioCondition]:
        """Return all that is known of every radio, by name."""
        return dict(sorted(self._shared.conditions.copy().items()))
