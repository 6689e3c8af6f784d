"""What a backpack knows of an encounter that goes on, and how it says so (WIRE_FORMAT.md §5.3)."""

from dataclasses import dataclass

from firmware_protocol.messages import MAX_ENCOUNTER_MS, EncounterEntry
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
    """

    start_ms: int
    rssi_dbm: RssiDbm
    next_report_ms: int
    last_ms: int | None = None

    def known_until_ms(self, now_ms: int) -> int:
        """Return until when the encounter is known to have lasted."""
        return now_ms if self.last_ms is None else self.last_ms

    def entry(self, peer: NodeId, *, end_ms: int, is_ongoing: bool) -> EncounterEntry:
        """Report it up to ``end_ms``."""
        duration_ms = Milliseconds(min(end_ms - self.start_ms, MAX_ENCOUNTER_MS))
        return EncounterEntry(
            peer=peer, start_ms=tick(self.start_ms), duration_ms=duration_ms, rssi_dbm=self.rssi_dbm, is_ongoing=is_ongoing
        )


def tick(ms: int) -> Milliseconds:
    """Return an instant as messages carry it: modulo 2^32."""
    return Milliseconds(ms % _TICKS)


def whole_dbm(rssi_dbm: float) -> RssiDbm:
    """Return a strength as messages carry it: whole dBm, in 8 bits."""
    return RssiDbm(max(-128, min(127, round(rssi_dbm))))
