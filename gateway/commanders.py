"""Which commanders are there: those with a liveliness token whose beats, where they give any, have not fallen silent.

A token goes at once when its owner's process ends. A link that swallows all it is given takes longer to be noticed that way, so a commander
that moves biobots beats several times a second. Pure but for waiting; belongs to one event loop.
"""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

from firmware_protocol.units import NS_PER_S, NodeId
from gateway.health import Health
from gateway.log import EventLog

_log = EventLog(__name__)

LATE_TOKEN_S: Final = 0.3
"""A command may overtake its commander's token on the way through routers; it is waited for so long."""

_MAX_WAITERS: Final = 256

GoneListener = Callable[[str, str], None]
"""Hears a commander's name, and why it is taken to be gone."""


class Notes(Protocol):
    """Where it is written down, for good, what is no command's stage; never blocks and never raises."""

    def note(self, kind: str, *, facts: Mapping[str, object], operator: str = "", node: NodeId | None = None) -> None:
        """Write an entry."""


@dataclass(slots=True)
class _Commander:
    number: int = -1
    """Of its last beat."""
    beat_ns: int | None = None
    is_silent: bool = False


class Commanders:
    """The commanders of a site, as this gateway knows them; see `gateway.bus_presence` for where it hears of them."""

    def __init__(self, *, silence_s: float, health: Health, notes: Notes) -> None:
        self._silence_s = silence_s
        self._silence_ns = int(silence_s * NS_PER_S)
        self._health = health
        self._notes = notes
        self._known: dict[str, _Commander] = {}
        self._listeners: list[GoneListener] = []
        self._arrivals: list[asyncio.Event] = []

    def listen(self, on_gone: GoneListener) -> None:
        """Have ``on_gone`` called, in the loop, whenever a commander goes or falls silent."""
        self._listeners.append(on_gone)

    def is_there(self, name: str) -> bool:
        """Say whether a commander may have biobots under its control."""
        known = self._known.get(name)
        return known is not None and not known.is_silent

    async def wait_for(self, name: str, *, timeout_s: float) -> bool:
        """Return whether a commander is there, or comes in time; where too many wait already, whether it is there now."""
        if self.is_there(name) or len(self._arrivals) >= _MAX_WAITERS:
            return self.is_there(name)
        arrival = asyncio.Event()
        self._arrivals.append(arrival)
        try:
            async with asyncio.timeout(timeout_s):
                while not self.is_there(name):
                    await arrival.wait()
                    arrival.clear()
        except TimeoutError:
            return False
        finally:
            self._arrivals.remove(arrival)
        return True

    def came(self, name: str) -> None:
        """Its token is there. A second session of the same name makes no difference."""
        if name not in self._known:
            self._known[name] = _Commander()
            self._health.set_level("commanders.present", len(self._known))
            _log.info("commander.came", commander=name)
            self._notes.note("commander", facts={"event": "came", "commander": name})
        self._tell_arrival()

    def went(self, name: str) -> None:
        """Its token is there no more."""
        known = self._known.pop(name, None)
        if known is None:
            return
        self._health.set_level("commanders.present", len(self._known))
        _log.info("commander.went", commander=name)
        self._notes.note("commander", facts={"event": "went", "commander": name})
        if not known.is_silent:
            self._tell_gone(name, "its liveliness token went")

    def beat(self, name: str, *, number: int, at_ns: int) -> None:
        """It said at ``at_ns`` that it is there; what is not newer than its last beat is no sign of life."""
        known = self._known.get(name)
        if known is None or number <= known.number:
            self._health.count("commanders.unfit_beats")
            return
        known.number, known.beat_ns = number, at_ns
        if known.is_silent:
            known.is_silent = False
            _log.info("commander.heard_again", commander=name)
            self._notes.note("commander", facts={"event": "heard_again", "commander": name})
            self._tell_arrival()

    def judge(self, moving: Iterable[tuple[str, int]], *, now_ns: int) -> None:
        """Take those for gone who have been silent for too long.

        Parameters
        ----------
        moving
            Commanders who have anybody under control, and since when [ns]: nobody else has to beat, and nobody sooner.
        """
        for name, since_ns in list(moving):
            known = self._known.get(name)
            if known is None or known.is_silent or known.beat_ns is None:
                continue
            if now_ns - max(known.beat_ns, since_ns) >= self._silence_ns:
                known.is_silent = True
                self._health.count("commanders.silent")
                silent_s = round((now_ns - known.beat_ns) / NS_PER_S, 2)
                _log.warning("commander.silent", commander=name, seconds=silent_s)
                self._notes.note("commander", facts={"event": "silent", "commander": name, "seconds": silent_s})
                self._tell_gone(name, f"it has not been heard for {self._silence_s:g} s, and still has a token")

    def next_judgement_ns(self, moving: Iterable[tuple[str, int]]) -> int | None:
        """When the first of ``moving`` will have been silent for too long, if it is not heard before."""
        deadlines = []
        for name, since_ns in moving:
            known = self._known.get(name)
            if known is not None and not known.is_silent and known.beat_ns is not None:
                deadlines.append(max(known.beat_ns, since_ns) + self._silence_ns)
        return min(deadlines, default=None)

    def _tell_arrival(self) -> None:
        for arrival in self._arrivals:
            arrival.set()

    def _tell_gone(self, name: str, reason: str) -> None:
        for on_gone in self._listeners:
            on_gone(name, reason)
