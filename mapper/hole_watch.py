"""Holes that came and went from map to map, told when they have stayed or stayed away: a hole of one map alone is no news. Pure."""

from dataclasses import dataclass
from math import hypot, pi, sqrt
from typing import Final

from mapper.alert_book import AlertKind, Condition, Severity
from mapper.certainty import sure_text
from mapper.map_difference import DiffHole, compare_maps

MAPS_IN_A_ROW: Final = 3
"""A hole is new, or gone, when so many maps in a row say so."""
TOLD_NS: Final = 600 * 1_000_000_000
"""What is new is told for so long."""


@dataclass(slots=True, kw_only=True)
class _Track:
    """A hole over several maps: as it was last seen; how many maps in a row have it, or lack it."""

    hole: DiffHole
    n_seen: int = 0
    n_missed: int = 0
    is_told: bool = False


class HoleWatch:
    """Follows holes from one finished map to the next.

    Parameters
    ----------
    sure
        A hole at least so likely is told; one of which nobody knows is, too.
    """

    def __init__(self, *, sure: float) -> None:
        self._sure = sure
        self._before: bytes | None = None
        self._tracks: list[_Track] = []
        self._told: dict[Condition, int] = {}
        """Until when [ns, monotonic]."""

    def take(self, map_json: bytes, *, now_ns: int) -> None:
        """Follow the holes into a newer map; those of the first one, and of one that shares nothing with the one before, are no news."""
        found = None if self._before is None else compare_maps(self._before, map_json)
        self._before = map_json
        if found is None or not found.is_comparable:
            itself = compare_maps(map_json, map_json)
            self._tracks = [_Track(hole=one.after, n_seen=MAPS_IN_A_ROW, is_told=True) for one in itself.stayed]
            return
        present = {track.hole.hole: track for track in self._tracks if not track.n_missed}
        absent = [track for track in self._tracks if track.n_missed]
        seen = [self._see(present.get(one.before.hole), one.after) for one in found.stayed]
        for hole in found.appeared:
            back = next((track for track in absent if _is_there(track.hole, hole)), None)
            absent = [track for track in absent if track is not back]
            seen.append(self._see(back, hole))
        absent += [present[hole.hole] for hole in found.vanished if hole.hole in present]
        for track in absent:
            track.n_missed, track.n_seen = track.n_missed + 1, 0
        self._tell(seen, absent, version=found.after.version, unit=found.length_unit, until_ns=now_ns + TOLD_NS)
        self._tracks = [*seen, *(track for track in absent if track.n_missed < MAPS_IN_A_ROW)]

    def conditions(self, *, now_ns: int) -> list[Condition]:
        """Return what is new, for a while."""
        self._told = {condition: until_ns for condition, until_ns in self._told.items() if now_ns < until_ns}
        return list(self._told)

    def _see(self, track: _Track | None, hole: DiffHole) -> _Track:
        known = track or _Track(hole=hole)
        is_sure = hole.probability is None or hole.probability >= self._sure
        return _Track(hole=hole, n_seen=known.n_seen + 1 if is_sure else 0, is_told=known.is_told)

    def _tell(self, seen: list[_Track], absent: list[_Track], *, version: int, unit: str, until_ns: int) -> None:
        for track in seen:
            if not track.is_told and track.n_seen >= MAPS_IN_A_ROW:
                track.is_told = True
                text = f"The map shows a new hole{_describe(track.hole, unit)}: most likely something one can walk around stands there."
                condition = Condition(
                    kind=AlertKind.NEW_HOLE, subject=f"hole {track.hole.hole} of map {version}", severity=Severity.INFO, text=text
                )
                self._told[condition] = until_ns
        for track in absent:
            if track.is_told and track.n_missed >= MAPS_IN_A_ROW:
                text = (
                    f"The map does not show a hole any more that it showed before{_describe(track.hole, unit)}: "
                    "look at the maps before, and wait for more encounters before you rely on either."
                )
                subject = f"hole {track.hole.hole} before map {version}"
                self._told[Condition(kind=AlertKind.HOLE_VANISHED, subject=subject, severity=Severity.WARNING, text=text)] = until_ns


def _is_there(one: DiffHole, other: DiffHole) -> bool:
    """Say whether two holes of one frame are at one place; maps that follow each other are."""
    reach = sum(sqrt(hole.area / pi) for hole in (one, other) if hole.area is not None)
    return one.component == other.component and hypot(one.centre[0] - other.centre[0], one.centre[1] - other.centre[1]) <= reach


def _describe(hole: DiffHole, unit: str) -> str:
    sure = "" if hole.probability is None else f", {sure_text(hole.probability)}"
    return sure + ("" if hole.area is None else f", of about {hole.area:.2g} {unit}²")
