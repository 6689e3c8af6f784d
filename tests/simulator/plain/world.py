"""The world in plain numpy, for tests to compare the engine with: insects that walk in an arena, and the encounters between them.

Slower, by windows of time instead of events, and without anything but the correlated random walk.

Time is continuous and is a float of seconds since the world was made: the one place where an instant is no integer, because
encounters begin and end at the roots of quadratics. Nothing here reads a clock.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from simulator.arenas.arena import Arena
from simulator.config import Ranges
from simulator.errors import ParameterError, TimeError, UnknownBiobotError
from simulator.events import Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged
from simulator.motion import MotionParameters
from tests.simulator.plain.encounters import ContactFinder, Contacts
from tests.simulator.plain.leg_log import Floats, Indices, LegLog
from tests.simulator.plain.walk import Walk


class PlainWorld:
    """Insects in an arena, advanced from event to event.

    Parameters
    ----------
    arena
        Where they walk. Lengths are in its unit.
    motion
        Speed and mean leg length.
    ranges
        Detection radius r_d (encounters) and communication radius r_c (neighbours).
    ids
        Identities of the biobots, positive and all different. A biobot's path depends on the seed and its id alone.
    seed
        0 to 2^64 - 1. Initial places are drawn uniformly over the arena.
    speed_factor
        Multiplies speed, and with it every hazard per length walked; time is left as it is.

    Raises
    ------
    ParameterError
        Ids are not positive, not all different, or none; the seed or the factor is out of range.
    ArenaError
        The arena leaves no room to place an insect.

    Notes
    -----
    All biobots walk at first (mode CRW, cause natural), and that is no event.
    """

    __slots__ = (
        "_arena",
        "_cause",
        "_contacts",
        "_current",
        "_ids",
        "_live",
        "_log",
        "_mode",
        "_now_s",
        "_open",
        "_pending",
        "_ranges",
        "_row",
        "_walk",
    )

    def __init__(
        self, arena: Arena, *, motion: MotionParameters, ranges: Ranges, ids: Sequence[int], seed: int, speed_factor: float = 1.0
    ) -> None:
        if not ids or len(set(ids)) != len(ids) or not all(0 < one < 2**63 for one in ids):
            raise ParameterError(name="ids", got=list(ids)[:8], wanted="at least one id, all different, each from 1 to 2^63 - 1")
        if not 0 < speed_factor < float("inf"):
            raise ParameterError(name="speed_factor", got=speed_factor, wanted="a positive finite number")
        self._arena = arena
        self._ranges = ranges
        self._ids = tuple(sorted(ids))
        self._row = {one: row for row, one in enumerate(self._ids)}
        self._mode = [Mode.CRW] * len(self._ids)
        self._cause = [Cause.NATURAL] * len(self._ids)
        self._now_s = 0.0
        self._pending: list[Event] = []
        self._open: dict[tuple[int, int], float] = {}
        self._log = LegLog()
        self._walk = Walk(arena, speed=motion.speed * speed_factor, mean_leg=motion.mean_leg, ids=self._ids, seed=seed)
        self._contacts = ContactFinder(arena, detection_radius=ranges.detection, speed=motion.speed * speed_factor)
        # Each biobot begins with a rest of no length, so that its place is in the log before it first walks.
        self._current = self._log.append(self._walk.rests(np.arange(len(self._ids)), t_start_s=0.0, t_end_s=0.0))
        self._live = np.empty(0, dtype=np.int64)

    @property
    def arena(self) -> Arena:
        """Where the insects walk."""
        return self._arena

    @property
    def ids(self) -> tuple[int, ...]:
        """All identities, ascending; row ``k`` of every array of positions belongs to ``ids[k]``."""
        return self._ids

    @property
    def now_s(self) -> float:
        """The present instant [s]."""
        return self._now_s

    @property
    def ranges(self) -> Ranges:
        """Detection and communication radius."""
        return self._ranges

    def advance(self, until_s: float, *, progress: Callable[[float], None] | None = None) -> list[Event]:
        """Let time run to ``until_s`` [s] and return what happened in ``[now_s, until_s)``.

        Parameters
        ----------
        until_s
            The new present. What happens exactly then is told by the next call: that is what makes the events of any
            chunking, put together, the same, bit for bit and in the same order.
        progress
            Called now and then with the time reached [s].

        Returns
        -------
        list of Event
            By time; at one instant mode changes in the order of the commands, then ends, then beginnings, by ids. An
            encounter ends and begins anew where a wall comes between the two.

        Raises
        ------
        TimeError
            ``until_s`` is before ``now_s`` or not finite.
        """
        if not self._now_s <= until_s < float("inf"):
            raise TimeError(got_s=until_s, wanted=f"a finite time not before the present, {self._now_s!r} s")
        events: list[Event] = []
        while self._now_s < until_s:
            window_end_s = min(until_s, self._now_s + self._contacts.window_s(len(self._ids)))
            if window_end_s <= self._now_s:  # the window is shorter than a unit in the last place of the time
                window_end_s = until_s
            events += self._advance_window(window_end_s)
            if progress is not None:
                progress(self._now_s)
        return events

    def stop(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        """Make a biobot stand still from now on; return whether its mode or cause changed.

        The event comes with the next ``advance``. Stopping again changes nothing; a command on top of a natural stop
        makes it a commanded one.
        """
        row = self._find(biobot_id)
        if self._mode[row] is Mode.S and (self._cause[row] is cause or cause is Cause.NATURAL):
            return False
        if self._mode[row] is Mode.CRW:
            rows = np.array([row])
            self._log.end(int(self._current[row]), at_s=self._now_s)
            self._walk.halt(rows, *self._log.take(self._current[rows]).at(self._now_s))
            self._begin(rows, self._log.append(self._walk.rests(rows, t_start_s=self._now_s, t_end_s=float("inf"))))
        self._note(row, mode=Mode.S, cause=cause)
        return True

    def start(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        """Let a biobot walk from now on, in a new direction; return whether its mode changed.

        The event comes with the next ``advance``. Starting a walking biobot changes nothing.
        """
        row = self._find(biobot_id)
        if self._mode[row] is Mode.CRW:
            return False
        self._log.end(int(self._current[row]), at_s=self._now_s)
        self._walk.release(np.array([row]), at_s=self._now_s)
        self._note(row, mode=Mode.CRW, cause=cause)
        return True

    def mode(self, biobot_id: int) -> Mode:
        """Return the present mode of a biobot."""
        return self._mode[self._find(biobot_id)]

    def position(self, biobot_id: int, *, at_s: float | None = None) -> tuple[float, float]:
        """Return where a biobot is [length], or was at ``at_s`` [s]."""
        row = self._find(biobot_id)
        if at_s is not None and at_s != self._now_s:
            place = self.positions_of([biobot_id], [at_s])[0]
            return float(place[0]), float(place[1])
        x, y = self._log.take(self._current[row : row + 1]).at(self._now_s)
        return float(x[0]), float(y[0])

    def positions(self, *, at_s: float | None = None) -> Floats:
        """Return where all biobots are, or were at ``at_s`` [s]: shape (n, 2) [length], rows as in ``ids``."""
        if at_s is not None and at_s != self._now_s:
            return self.positions_of(self._ids, [at_s] * len(self._ids))
        return np.column_stack(self._log.take(self._current).at(self._now_s))

    def positions_of(self, biobot_ids: Sequence[int], t_s: Sequence[float] | Floats) -> Floats:
        """Return where each of some biobots was at its instant.

        Parameters
        ----------
        biobot_ids
            Which biobots, length k; one may come many times.
        t_s
            An instant for each [s], length k.

        Returns
        -------
        Floats
            Shape (k, 2) [length].

        Raises
        ------
        TimeError
            An instant lies before 0 or after the present.
        """
        times = np.asarray(t_s, dtype=np.float64)
        for wrong in times[~((times >= 0) & (times <= self._now_s))][:1]:
            raise TimeError(got_s=float(wrong), wanted=f"a time from 0 to the present, {self._now_s!r} s")
        rows = np.array([self._find(one) for one in biobot_ids], dtype=np.int64)
        return np.column_stack(self._log.take(self._log.locate(rows, times)).at(times))

    def neighbours(self, biobot_id: int) -> set[int]:
        """Return the ids within the communication radius now, without its own; walls do not hinder radio."""
        row = self._find(biobot_id)
        places = self.positions()
        near = ((places - places[row]) ** 2).sum(axis=1) <= self._ranges.communication**2
        return {self._ids[other] for other in np.flatnonzero(near) if other != row}

    def adjacency(self) -> dict[int, set[int]]:
        """Return every biobot's neighbours within the communication radius now: id to ids."""
        links: dict[int, set[int]] = {one: set() for one in self._ids}
        pairs = cKDTree(self.positions()).query_pairs(self._ranges.communication, output_type="ndarray")
        for first, second in pairs.tolist():
            links[self._ids[first]].add(self._ids[second])
            links[self._ids[second]].add(self._ids[first])
        return links

    def open_encounters(self) -> list[EncounterBegan]:
        """Return the encounters told to have begun and not yet to have ended, by start and ids."""
        began = sorted((t_s, *pair) for pair, t_s in self._open.items())
        return [EncounterBegan(t_s=t_s, id1=self._ids[first], id2=self._ids[second]) for t_s, first, second in began]

    def _find(self, biobot_id: int) -> int:
        row = self._row.get(biobot_id)
        if row is None:
            raise UnknownBiobotError(biobot_id=biobot_id, first=self._ids[0], last=self._ids[-1], count=len(self._ids))
        return row

    def _note(self, row: int, *, mode: Mode, cause: Cause) -> None:
        self._mode[row] = mode
        self._cause[row] = cause
        self._pending.append(ModeChanged(t_s=self._now_s, id=self._ids[row], mode=mode, cause=cause))

    def _begin(self, rows: Indices, legs: Indices) -> None:
        self._current[rows] = legs
        self._live = np.concatenate([self._live, legs])

    def _advance_window(self, end_s: float) -> list[Event]:
        for made in self._walk.legs_until(end_s):
            self._begin(made.biobot, self._log.append(made))
        live = self._live[self._log.t_end_s(self._live) > self._now_s]
        contacts = self._contacts.find(self._log.take(live), begin_s=self._now_s, end_s=end_s)
        changes, self._pending = self._pending, []
        events = changes + self._follow(contacts, end_s=end_s)
        self._live = live[self._log.t_end_s(live) >= end_s]
        self._now_s = end_s
        return events

    def _follow(self, contacts: Contacts, *, end_s: float) -> list[Event]:
        """Turn the contacts that touch ``[now, end)`` into beginnings and ends, and remember what stays open."""
        ends: list[tuple[float, int, int, float]] = []
        begins: list[tuple[float, int, int]] = []
        kept: dict[tuple[int, int], float] = {}
        rows = zip(contacts.first.tolist(), contacts.second.tolist(), contacts.t_start_s.tolist(), contacts.t_end_s.tolist(), strict=True)
        for first, second, start_s, stop_s in rows:
            pair = (first, second)
            met_s = self._open.pop(pair, None) if start_s <= self._now_s else None
            if met_s is None:
                met_s = start_s
                begins.append((start_s, first, second))
            if stop_s < end_s:
                ends.append((stop_s, first, second, met_s))
            else:
                kept[pair] = met_s
        # An open encounter that no contact takes up again ended with the legs that ended now.
        ends += [(self._now_s, *pair, met_s) for pair, met_s in self._open.items()]
        self._open = kept
        ids = self._ids
        told: list[tuple[tuple[float, int, int, int], Event]] = [
            ((t_s, 1, first, second), EncounterEnded(t_start_s=met_s, t_end_s=t_s, id1=ids[first], id2=ids[second]))
            for t_s, first, second, met_s in ends
        ]
        told += [((t_s, 2, first, second), EncounterBegan(t_s=t_s, id1=ids[first], id2=ids[second])) for t_s, first, second in begins]
        told.sort(key=lambda item: item[0])
        return [event for _, event in told]
