"""A recorded run as a world: what was recorded happens again at its time, and nothing can change it."""

import bisect
import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulator.arenas.arena import Arena
from simulator.config import Ranges
from simulator.errors import ParameterError, TimeError, UnknownBiobotError
from simulator.events import Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged
from simulator.legs import Floats, Indices
from simulator.log import EventLog
from simulator.recording import Recording

log = EventLog(__name__)

_AFTER_S = 0.001
"""The replay goes on for so long after the last instant recorded [s], so that what happened then is told."""


@dataclass(frozen=True, slots=True)
class _Due:
    t_s: float
    order: int
    event: Event


class RecordedWorld:
    """A ``Habitat`` whose past is fixed.

    Parameters
    ----------
    recording
        What happened.
    compression
        So many recorded seconds go by in a second of this world. Its instant 0 is the recording's ``zero_s``.
    renumber
        Give the biobots the ids 1, 2, ... in the order of their recorded ones.

    Notes
    -----
    Commands change nothing; the first one is told in the log. Between recorded places biobots are taken to go straight.
    """

    __slots__ = ("_compression", "_events", "_ids", "_is_told", "_mode", "_next", "_now_s", "_open", "_recorded_id", "_recording")

    def __init__(self, recording: Recording, *, compression: float = 1.0, renumber: bool = False) -> None:
        if not 0 < compression < float("inf"):
            raise ParameterError(name="speed_factor", got=compression, wanted="a positive finite number")
        self._recording = recording
        self._compression = compression
        ids = range(1, len(recording.ids) + 1) if renumber else recording.ids
        self._ids = tuple(ids)
        self._recorded_id = dict(zip(self._ids, recording.ids, strict=True))
        self._mode = dict.fromkeys(self._ids, Mode.CRW)
        self._events = self._list_events({recorded: one for one, recorded in self._recorded_id.items()})
        self._next = 0
        self._now_s = 0.0
        self._open: dict[tuple[int, int], float] = {}
        self._is_told = False

    @property
    def arena(self) -> Arena | None:
        """See ``Habitat``."""
        return None if self._recording.places is None else self._recording.places.arena

    @property
    def ids(self) -> tuple[int, ...]:
        """See ``Habitat``."""
        return self._ids

    @property
    def recorded_ids(self) -> dict[int, int]:
        """Identity here to identity in the recording."""
        return dict(self._recorded_id)

    @property
    def now_s(self) -> float:
        """See ``Habitat``."""
        return self._now_s

    @property
    def zero_s(self) -> float:
        """The instant of the recording that is 0 here [s]."""
        return self._recording.zero_s

    @property
    def end_s(self) -> float:
        """When everything recorded has happened [s]."""
        return self._scale(self._recording.end_s) + _AFTER_S

    @property
    def ranges(self) -> Ranges:
        """See ``Habitat``."""
        return self._recording.ranges

    def advance(self, until_s: float) -> list[Event]:
        """See ``Habitat``."""
        if not self._now_s <= until_s < float("inf"):
            raise TimeError(got_s=until_s, wanted=f"a finite time not before the present, {self._now_s!r} s")
        events = []
        while self._next < len(self._events) and self._events[self._next].t_s < until_s:
            event = self._events[self._next].event
            self._next += 1
            events.append(event)
            match event:
                case EncounterBegan(t_s=t_s, id1=id1, id2=id2):
                    self._open[id1, id2] = t_s
                case EncounterEnded(id1=id1, id2=id2):
                    del self._open[id1, id2]
                case ModeChanged(id=one, mode=mode):
                    self._mode[one] = mode
                case _:
                    pass
        self._now_s = until_s
        return events

    def stop(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        """Change nothing: the past stays as it was."""
        return self._refuse(biobot_id, cause)

    def start(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        """Change nothing: the past stays as it was."""
        return self._refuse(biobot_id, cause)

    def follow_walls(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        """Change nothing: the past stays as it was."""
        return self._refuse(biobot_id, cause)

    def turn(self, biobot_id: int, angle_rad: float) -> bool:  # noqa: ARG002  # of a Habitat
        """Change nothing: the past stays as it was."""
        return self._refuse(biobot_id, Cause.COMMAND)

    def run_straight(self, biobot_id: int, distance: float) -> bool:  # noqa: ARG002  # of a Habitat
        """Change nothing: the past stays as it was."""
        return self._refuse(biobot_id, Cause.COMMAND)

    def mode(self, biobot_id: int) -> Mode:
        """See ``Habitat``."""
        self._find(biobot_id)
        return self._mode[biobot_id]

    def positions(self) -> Floats:
        """See ``Habitat``."""
        return self.positions_of(self._ids, [self._now_s] * len(self._ids))

    def positions_of(self, biobot_ids: Sequence[int] | Indices, t_s: Sequence[float] | Floats) -> Floats:
        """See ``Habitat``; before the first and after the last recorded place a biobot stands there."""
        rows = np.array([self._find(int(one)) for one in biobot_ids], dtype=np.int64)
        places = self._recording.places
        if places is None:
            return np.full((rows.size, 2), np.nan)
        recorded_s = np.asarray(t_s, dtype=np.float64) * self._compression + self._recording.zero_s
        after = np.clip(np.searchsorted(places.t_s, recorded_s, side="right"), 1, max(1, places.t_s.size - 1))
        after = np.minimum(after, places.t_s.size - 1)
        before = np.maximum(after - 1, 0)
        span_s = places.t_s[after] - places.t_s[before]
        share = np.where(span_s > 0, (recorded_s - places.t_s[before]) / np.where(span_s > 0, span_s, 1.0), 1.0)
        share = np.clip(share, 0.0, 1.0)[:, None]
        found: Floats = (1.0 - share) * places.position[before, rows] + share * places.position[after, rows]
        return found

    def positions_at(self, t_s: Sequence[float] | Floats) -> Floats:
        """See ``Habitat``."""
        times = np.asarray(t_s, dtype=np.float64)
        places = self.positions_of(np.tile(np.array(self._ids, dtype=np.int64), times.size), np.repeat(times, len(self._ids)))
        return places.reshape(times.size, len(self._ids), 2)

    def open_encounters(self) -> list[EncounterBegan]:
        """See ``Habitat``."""
        began = sorted((t_s, *pair) for pair, t_s in self._open.items())
        return [EncounterBegan(t_s=t_s, id1=id1, id2=id2) for t_s, id1, id2 in began]

    def count_short_gaps(self, gap_s: float) -> int:
        """Return how often two encounters of one pair are less than ``gap_s`` [s] apart here."""
        ends: dict[tuple[int, int], float] = {}
        count = 0
        for one in self._recording.encounters:
            count += self._scale(one.t_start_s) - ends.get((one.id1, one.id2), -float("inf")) < gap_s
            ends[one.id1, one.id2] = self._scale(one.t_end_s)
        return count

    def _scale(self, recorded_s: float) -> float:
        return (recorded_s - self._recording.zero_s) / self._compression

    def _list_events(self, ids: dict[int, int]) -> list[_Due]:
        """List events as a world tells them: at one instant changes of mode, then ends, then beginnings, by ids.

        An encounter of no length stands as a whole between ends and beginnings, so that it fits between its pair's neighbours.
        """
        encounters: list[tuple[float, int, int, int, Event]] = []
        for one in self._recording.encounters:
            id1, id2 = sorted((ids[one.id1], ids[one.id2]))
            start_s, end_s = self._scale(one.t_start_s), self._scale(one.t_end_s)
            began = EncounterBegan(t_s=start_s, id1=id1, id2=id2)
            ended = EncounterEnded(t_start_s=start_s, t_end_s=end_s, id1=id1, id2=id2)
            has_length = end_s > start_s
            encounters.append((start_s, 4 if has_length else 2, id1, id2, began))
            encounters.append((end_s, 1 if has_length else 3, id1, id2, ended))
        encounters.sort(key=lambda item: item[:4])
        changes: list[_Due] = []
        current = dict.fromkeys(ids.values(), (Mode.CRW, Cause.NATURAL))
        for spell in self._recording.spells:
            biobot = ids[spell.id]
            if current[biobot] != (spell.mode, spell.cause):
                current[biobot] = (spell.mode, spell.cause)
                t_s = self._scale(spell.t_start_s)
                changes.append(_Due(t_s, 0, ModeChanged(t_s=t_s, id=biobot, mode=spell.mode, cause=spell.cause)))
        meetings = [_Due(t_s, order, event) for t_s, order, _, _, event in encounters]
        return list(heapq.merge(changes, meetings, key=lambda due: (due.t_s, due.order)))

    def _find(self, biobot_id: int) -> int:
        row = bisect.bisect_left(self._ids, biobot_id)
        if row == len(self._ids) or self._ids[row] != biobot_id:
            raise UnknownBiobotError(biobot_id=biobot_id, first=self._ids[0], last=self._ids[-1], count=len(self._ids))
        return row

    def _refuse(self, biobot_id: int, cause: Cause) -> bool:
        self._find(biobot_id)
        if not self._is_told:
            self._is_told = True
            log.warning("replay.command_without_effect", biobot=biobot_id, cause=cause.value, hint="the past stays as it was recorded")
        return False
