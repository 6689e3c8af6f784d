"""The world: insects that walk in an arena, the encounters between them, and the commands that move them.

Time is continuous and is a float of seconds since the world was made: the one place where an instant is no integer, because
encounters begin and end at the roots of quadratics. Nothing here reads a clock.
"""

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from simulator.arenas.arena import Arena
from simulator.config import Ranges
from simulator.engine import Engine
from simulator.engine.engine import Records
from simulator.errors import ParameterError, SnapshotError, TimeError, UnknownBiobotError
from simulator.events import Cause, EncounterBegan, Event, Happenings, Mode
from simulator.failures import draw_failures
from simulator.legs import Floats, Indices, Legs, locate
from simulator.links import links_within
from simulator.motion import MotionParameters
from simulator.past import Past, check_times, to_legs
from simulator.recipe import engine_config, motion_under_command
from simulator.snapshot import WorldParts, pack, unpack
from simulator.telling import CAUSES, MODES, tell_events, tell_open, tell_run

# Work of the engine between two reports of progress, about a tenth of a second.
_WORK_AT_ONCE = 500_000
_FIRST_WINDOW_S = 1.0


class World:
    """Insects in an arena, advanced from event to event.

    Parameters
    ----------
    arena
        Where they walk. Lengths are in its unit.
    motion
        How they walk.
    ranges
        Detection radius r_d (encounters) and communication radius r_c (neighbours).
    ids
        Identities of the biobots, positive and all different. A biobot's draws depend on the seed and its id alone.
    seed
        0 to 2^64 - 1. Initial places are drawn uniformly over the arena.
    speed_factor
        Multiplies speeds and hazards; time is left as it is.
    torus
        Take the arena's bounding square without its walls, its opposite sides joined: for comparison with theory that knows no walls.
        Places are then told as if the plane went on, and sight and geodesics mean nothing.
    keeps_legs
        Remember every leg, so that places in the past can be told; 56 bytes a leg.

    Raises
    ------
    ParameterError
        Ids are not positive, not all different, or none; the seed or the factor is out of range.
    ArenaError
        The arena leaves no room to place an insect.
    EngineMissingError, EngineMemoryError
        The compiled engine is not there, or memory is lacking.

    Notes
    -----
    All biobots walk at first (mode CRW, cause natural), and that is no event.
    """

    __slots__ = ("_arena", "_bounds", "_engine", "_ids", "_lost_first", "_now_s", "_past", "_ranges", "_row", "_torus", "_window_s")

    def __init__(
        self,
        arena: Arena,
        *,
        motion: MotionParameters,
        ranges: Ranges,
        ids: Sequence[int],
        seed: int,
        speed_factor: float = 1.0,
        torus: bool = False,
        keeps_legs: bool = True,
    ) -> None:
        if not ids or len(set(ids)) != len(ids) or not all(0 < one < 2**63 for one in ids):
            raise ParameterError(name="ids", got=list(ids)[:8], wanted="at least one id, all different, each from 1 to 2^63 - 1")
        if not 0 < speed_factor < float("inf"):
            raise ParameterError(name="speed_factor", got=speed_factor, wanted="a positive finite number")
        self._arena = arena
        self._bounds = arena.bounds
        self._ranges = ranges
        self._ids = tuple(sorted(ids))
        self._row = {one: row for row, one in enumerate(self._ids)}
        self._now_s = 0.0
        self._torus = torus
        self._past = Past(keeps=keeps_legs)
        self._window_s = _FIRST_WINDOW_S
        keys = np.array(self._ids, dtype=np.uint64)
        moved = motion.faster(speed_factor)
        lost_s, flat_s = draw_failures(moved, seed=seed, keys=keys)
        self._lost_first = lost_s <= flat_s
        self._engine = Engine(
            engine_config(
                motion_under_command(motion).faster(speed_factor),
                ranges,
                seed=seed,
                period=arena.bounds[2] - arena.bounds[0] if torus else 0.0,
            ),
            ids=keys,
            places=arena.draw_places(seed=seed, ids=keys),
            silent_from_s=np.minimum(lost_s, flat_s),
            arena=None if torus else arena,
        )

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

    @property
    def n_steps(self) -> int:
        """Engine events so far: legs, crossings of cells, encounters."""
        return self._engine.n_steps

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
            By time; at one instant mode changes in the order of the commands, then ends, then beginnings, by ids, then silences. An
            encounter ends and begins anew where a wall comes between the two.

        Raises
        ------
        TimeError
            ``until_s`` is before ``now_s`` or not finite.
        """
        told = (tell_events(records, ids=self._ids, lost_first=self._lost_first) for records in self._run(until_s, progress))
        return [event for events in told for event in events]

    def run(self, until_s: float, *, progress: Callable[[float], None] | None = None) -> Happenings:
        """Let time run as ``advance`` does, and return the encounters that ended as columns: for runs with many."""
        return tell_run(list(self._run(until_s, progress)), ids=self._ids, lost_first=self._lost_first)

    def stop(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        """Make a biobot stand still from now on; return whether its mode or cause changed.

        The event comes with the next ``advance``. Stopping again changes nothing; a command on top of a natural stop
        makes it a commanded one.
        """
        row = self._find(biobot_id)
        mode, present = self._state(row)
        if mode is Mode.S and (present is cause or cause is Cause.NATURAL):
            return False
        self._engine.stop(row, is_command=cause is Cause.COMMAND, at_s=self._now_s)
        self._past.add(self._engine.take_legs())
        return True

    def start(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        """Let a biobot walk from now on, in a new direction; return whether its mode changed.

        The event comes with the next ``advance``. Starting a walking biobot changes nothing, but that it follows walls no more if it was
        told to; nor a dead, stuck or overturned one; one that rests by itself gets up.
        """
        return self._let_go(self._find(biobot_id), cause=cause, follows_walls=False)

    def follow_walls(self, biobot_id: int, *, cause: Cause = Cause.COMMAND) -> bool:
        """Let a biobot walk as ``start`` does, and keep to walls until a start or a stop; return whether its mode changed.

        It goes along walls as with ``WallLaw.FOLLOW``, whatever the law of all (``simulator.recipe.motion_under_command``).
        """
        return self._let_go(self._find(biobot_id), cause=cause, follows_walls=True)

    def turn(self, biobot_id: int, angle_rad: float) -> bool:
        """Turn a biobot to the left (positive) or right [rad], and let it walk on from there; return whether it moved.

        One that stands by command only turns; one that rests by itself gets up; one that is dead or stuck does nothing.
        """
        return self._steer(biobot_id, turns=angle_rad / (2.0 * math.pi), distance=0.0)

    def run_straight(self, biobot_id: int, distance: float) -> bool:
        """Let a biobot walk straight on for a distance [length], or to the next wall; return whether it moved, as ``turn``."""
        if not (math.isfinite(distance) and distance > 0.0):
            raise ParameterError(name="distance", got=distance, wanted="a positive finite length")
        return self._steer(biobot_id, turns=0.0, distance=distance)

    def silence(self, biobot_id: int) -> None:
        """Switch a biobot's backpack off from now on: its open encounters end, and it has no more. The insect goes its way."""
        self._engine.silence(self._find(biobot_id), at_s=self._now_s)

    def replace_arena(self, arena: Arena) -> None:
        """Let other walls stand from now on; insects where they come to stand are pushed to the nearest free place.

        Raises
        ------
        ParameterError
            The world is a torus.
        ArenaError
            The new arena reaches beyond the bounds of the old one.
        """
        if self._torus:
            raise ParameterError(name="torus", got=True, wanted="a world with walls, where walls are to be replaced")
        arena.expect_within(self._bounds)
        places = arena.nearest_room(self.positions())
        self._engine.replace_walls(arena, places=places, at_s=self._now_s)
        self._arena = arena
        self._past.add(self._engine.take_legs())

    def mode(self, biobot_id: int) -> Mode:
        """Return the present mode of a biobot."""
        return self._state(self._find(biobot_id))[0]

    def modes(self) -> list[Mode]:
        """Return the present mode of every biobot, in the order of ``ids``."""
        return [MODES[still] for still in self._engine.modes()[0].tolist()]

    def commanded(self) -> set[int]:
        """Return the ids of those who stand by command."""
        still, cause = self._engine.modes()
        return {self._ids[row] for row in np.flatnonzero((still == 1) & (cause == 1)).tolist()}

    def position(self, biobot_id: int, *, at_s: float | None = None) -> tuple[float, float]:
        """Return where a biobot is [length], or was at ``at_s`` [s]."""
        x, y = self.positions(at_s=at_s)[self._find(biobot_id)].tolist()
        return x, y

    def positions(self, *, at_s: float | None = None) -> Floats:
        """Return where all biobots are, or were at ``at_s`` [s]: shape (n, 2) [length], rows as in ``ids``."""
        if at_s is not None and at_s != self._now_s:
            return np.asarray(self.positions_at([at_s])[0])
        return np.stack(to_legs(self._engine.current_legs()).at(self._now_s), axis=1)

    def velocities(self) -> Floats:
        """Return how all biobots move now: shape (n, 2) [length/s], 0 for one that stands; rows as in ``ids``."""
        legs = to_legs(self._engine.current_legs())
        return np.stack([legs.vx, legs.vy], axis=1)

    def positions_at(self, t_s: Sequence[float] | Floats) -> Floats:
        """Return where all biobots were at each of some instants: shape (k, n, 2) [length]. Raises TimeError."""
        times = check_times(t_s, now_s=self._now_s)
        rows = np.repeat(np.arange(len(self._ids)), times.size)
        places = self._places(rows, np.tile(times, len(self._ids)))
        return np.ascontiguousarray(places.reshape(len(self._ids), times.size, 2).transpose(1, 0, 2))

    def positions_of(self, biobot_ids: Sequence[int] | Indices, t_s: Sequence[float] | Floats) -> Floats:
        """Return where each of some biobots was at its instant.

        Parameters
        ----------
        biobot_ids, t_s
            Which biobots, length k, of which one may come many times; and an instant for each [s], length k.

        Returns
        -------
        Floats
            Shape (k, 2) [length].

        Raises
        ------
        TimeError
            An instant lies before 0 or after the present.
        UnknownBiobotError
            An id is none of this world's.
        """
        times = check_times(t_s, now_s=self._now_s)
        asked = np.asarray(biobot_ids, dtype=np.int64)
        known = np.array(self._ids, dtype=np.int64)
        rows = np.minimum(np.searchsorted(known, asked), known.size - 1)
        for wrong in asked[known[rows] != asked][:1].tolist():
            self._find(wrong)
        return self._places(rows, times)

    def legs(self) -> Legs:
        """Return every leg so far, by biobot, then start; those under way end now. Raises ParameterError where legs are not kept."""
        return self._past.legs(self._engine.current_legs(), now_s=self._now_s)

    def neighbours(self, biobot_id: int) -> set[int]:
        """Return the ids within the communication radius now, without its own; walls do not hinder radio."""
        self._find(biobot_id)
        return self.adjacency()[biobot_id]

    def adjacency(self) -> dict[int, set[int]]:
        """Return every biobot's neighbours within the communication radius now: id to ids."""
        side = self._bounds[2] - self._bounds[0] if self._torus else None
        return links_within(self.positions(), radius=self._ranges.communication, ids=self._ids, side=side)

    def open_encounters(self) -> list[EncounterBegan]:
        """Return the encounters told to have begun and not yet to have ended, by start and ids."""
        return tell_open(self._engine.open_encounters(), ids=self._ids)

    def snapshot(self) -> bytes:
        """Return all there is to know, so that ``restore`` goes on as if nothing had been: same events, bit for bit."""
        parts = WorldParts(
            engine=self._engine.save(),
            legs=self._past.completed(),
            ids=np.array(self._ids, dtype=np.int64),
            lost_first=self._lost_first,
            now_s=self._now_s,
            ranges=self._ranges,
            is_torus=self._torus,
            keeps_legs=self._past.keeps,
            arena=self._arena,
            bounds=self._bounds,
        )
        return pack(parts)

    @classmethod
    def restore(cls, content: bytes, *, source: str = "snapshot") -> "World":
        """Make the world of a snapshot; ``source`` names it in messages. Raises SnapshotError."""
        parts = unpack(content, source=source)
        world = cls.__new__(cls)
        cls._take_up(world, parts, source)
        return world

    def _take_up(self, parts: WorldParts, source: str) -> None:
        self._arena = parts.arena
        self._bounds = parts.bounds
        self._ranges = parts.ranges
        self._ids = tuple(parts.ids.tolist())
        self._row = {one: row for row, one in enumerate(self._ids)}
        self._now_s = parts.now_s
        self._torus = parts.is_torus
        self._past = Past(keeps=parts.keeps_legs, completed=parts.legs)
        self._window_s = _FIRST_WINDOW_S
        self._lost_first = parts.lost_first
        try:
            self._engine = Engine.load(parts.engine, arena=None if parts.is_torus else parts.arena, n_biobots=len(self._ids))
        except SnapshotError as error:
            raise SnapshotError(source=source, problem="it was written by another build of the engine") from error

    def _run(self, until_s: float, progress: Callable[[float], None] | None) -> Iterator[Records]:
        if not self._now_s <= until_s < float("inf"):
            raise TimeError(got_s=until_s, wanted=f"a finite time not before the present, {self._now_s!r} s")
        while self._now_s < until_s:
            end_s = min(until_s, self._now_s + self._window_s)
            end_s = until_s if end_s <= self._now_s else end_s  # the window may be shorter than a unit in the last place of the time
            work = self._engine.work
            while not self._engine.advance(end_s):
                self._past.add(self._engine.take_legs())
                yield self._engine.take_events()
                if progress is not None:
                    progress(self._engine.now_s)
            if (work := self._engine.work - work) > _WORK_AT_ONCE or end_s < until_s:
                self._window_s *= min(4.0, max(0.25, _WORK_AT_ONCE / max(1, work)))
            self._now_s = end_s
            self._past.add(self._engine.take_legs())
            yield self._engine.take_events()
            if progress is not None:
                progress(end_s)

    def _let_go(self, row: int, *, cause: Cause, follows_walls: bool) -> bool:
        self._engine.follow_walls(row, follows=follows_walls, at_s=self._now_s)
        changed = False
        if self._state(row)[0] is not Mode.CRW:
            changed = self._engine.go(row, is_command=cause is Cause.COMMAND, at_s=self._now_s)
        self._past.add(self._engine.take_legs())
        return changed

    def _steer(self, biobot_id: int, *, turns: float, distance: float) -> bool:
        if not math.isfinite(turns):
            raise ParameterError(name="angle_rad", got=turns, wanted="a finite angle")
        moved = self._engine.turn(self._find(biobot_id), turns=turns, distance=distance, at_s=self._now_s)
        self._past.add(self._engine.take_legs())
        return moved

    def _state(self, row: int) -> tuple[Mode, Cause]:
        still, cause = self._engine.modes()
        return MODES[int(still[row])], CAUSES[int(cause[row])]

    def _places(self, rows: Indices, times: Floats) -> Floats:
        legs = self.legs()
        return np.column_stack(legs.take(locate(legs, biobot=rows, t_s=times)).at(times))

    def _find(self, biobot_id: int) -> int:
        row = self._row.get(biobot_id)
        if row is None:
            raise UnknownBiobotError(biobot_id=biobot_id, first=self._ids[0], last=self._ids[-1], count=len(self._ids))
        return row
