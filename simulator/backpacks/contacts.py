"""What a backpack knows of an encounter that goes on, and how it says so (WIRE_FORMAT.md §5.3)."""

from collections.abc import Callable
from dataclasses import dataclass

from firmware_protocol.messages import MAX_ENCOUNTER_MS, MAX_PATH_MM, EncounterEntry
from firmware_protocol.units import Milliseconds, NodeId, RssiDbm

_TICKS = 1 << 32


@dataclass(slots=True, kw_only=True)
class Contact:
    """An encounter that goes on; instants are the backpack's own [ms].

    Parameters
    ----------
    next_report_ms
        When it is to be reported though it goes on.
    last_ms
        When the last beacon came; None where encounters are sensed continuously.
    path_mm
        What the insect has walked since the start of its encounter before; None where that is not known.
    """

    start_ms: int
    rssi_dbm: RssiDbm
    next_report_ms: int
    last_ms: int | None = None
    path_mm: int | None = None

    def known_until_ms(self, now_ms: int) -> int:
        """Return until when the encounter is known to have lasted."""
        return now_ms if self.last_ms is None else self.last_ms

    def entry(self, peer: NodeId, *, end_ms: int, is_ongoing: bool) -> EncounterEntry:
        """Report it up to ``end_ms``."""
        duration_ms = Milliseconds(min(end_ms - self.start_ms, MAX_ENCOUNTER_MS))
        return EncounterEntry(
            peer=peer, start_ms=tick(self.start_ms), duration_ms=duration_ms, rssi_dbm=self.rssi_dbm, is_ongoing=is_ongoing,
            path_mm=self.path_mm,
        )  # fmt: skip


@dataclass(slots=True, kw_only=True)
class PathMeter:
    """Measures how far the insect walks from the start of one encounter to the start of the next (WIRE_FORMAT.md §5.9).

    Parameters
    ----------
    read_mm
        What the inertial unit had measured by an instant of the backpack's clock [mm].
    """

    read_mm: Callable[[int], float]
    _mark_mm: float | None = None

    def mark(self, start_ms: int) -> int | None:
        """Return the path to ``start_ms`` [mm], where the next one begins; None for the first encounter since boot."""
        before_mm, self._mark_mm = self._mark_mm, self.read_mm(start_ms)
        return None if before_mm is None else max(0, min(round(self._mark_mm - before_mm), MAX_PATH_MM))


def tick(ms: int) -> Milliseconds:
    """Return an instant as messages carry it: modulo 2^32."""
    return Milliseconds(ms % _TICKS)


def whole_dbm(rssi_dbm: float) -> RssiDbm:
    """Return a strength as messages carry it: whole dBm, in 8 bits."""
    return RssiDbm(max(-128, min(127, round(rssi_dbm))))
