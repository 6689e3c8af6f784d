"""One engine with its insects: numpy arrays in, numpy arrays out. Rows, not ids; the world knows the ids."""

import ctypes
from ctypes import byref, c_void_p
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arenas.arena import Arena
from simulator.engine.binding import EVENT, LEG, EngineConfig, load_library
from simulator.errors import EngineMemoryError, ParameterError, SnapshotError

Floats = NDArray[np.float64]
Words = NDArray[np.uint64]
# Structured arrays of binding.EVENT and binding.LEG.
Records = NDArray[Any]

_OUT_OF_MEMORY, _TOO_NARROW, _OTHER_WALLS = -1, -2, -3
# Events and legs of so much work take some hundred megabytes at most, and Ctrl-C waits no longer than for it, some tenths of a second.
_MOST_WORK = 2_000_000


class Engine:
    """Insects that walk, owned by C; see engine.c for what happens and engine.h for the parameters.

    Parameters
    ----------
    config
        Parameters of motion.
    ids
        Identities, shape (n,): keys of the draws.
    places
        Where each insect begins, shape (n, 2) [length].
    silent_from_s
        When each backpack goes off by itself [s], shape (n,); inf for never.
    arena
        Walls; None on a torus.

    Raises
    ------
    EngineMissingError
        The compiled engine is not there.
    EngineMemoryError
        There is not memory enough.
    ParameterError
        The torus is less than four detection radii wide.
    """

    __slots__ = ("_handle", "_library", "_n")

    def __init__(self, config: EngineConfig, *, ids: Words, places: Floats, silent_from_s: Floats, arena: Arena | None) -> None:
        self._library = load_library()
        self._n = ids.size
        self._handle = self._library.engine_create(
            byref(config), self._n, _pointer(ids), _pointer(np.ascontiguousarray(places)), _pointer(silent_from_s)
        )
        if not self._handle:
            raise EngineMemoryError(n_biobots=self._n, at_s=0.0)
        low_x, low_y, high_x, high_y = (0.0, 0.0, config.period, config.period)
        if arena is not None:
            low_x, low_y, high_x, high_y = arena.bounds
            self._set_walls(arena)
        status = self._library.engine_start(self._handle, low_x, low_y, high_x, high_y)
        if status == _TOO_NARROW:
            wanted = "at least four detection radii, and four spacings of insects, to be told from its own images"
            raise ParameterError(name="side of the torus", got=config.period, wanted=wanted)
        self._check(status, at_s=0.0)

    @classmethod
    def load(cls, content: bytes, *, arena: Arena | None, n_biobots: int) -> "Engine":
        """Take up a snapshot; the arena must be the one it was taken in. Raises SnapshotError."""
        engine = cls.__new__(cls)
        cls._take_up(engine, content, n_biobots)
        if arena is not None:
            cls._set_walls(engine, arena)
        return engine

    def _take_up(self, content: bytes, n_biobots: int) -> None:
        self._library = load_library()
        self._n = n_biobots
        self._handle = self._library.engine_load(content, len(content))
        if not self._handle or self._library.engine_count(self._handle) != n_biobots:
            raise SnapshotError(source="snapshot", problem="the engine cannot read it")

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self._library.engine_free(self._handle)

    @property
    def n_steps(self) -> int:
        """Events worked off so far, of all kinds."""
        return int(self._library.engine_steps(self._handle))

    @property
    def work(self) -> int:
        """What was done so far: events, and looks at pairs; since it was made or taken up."""
        return int(self._library.engine_work(self._handle))

    @property
    def now_s(self) -> float:
        """The instant that is reached [s]; all before it has been worked off."""
        return float(self._library.engine_now(self._handle))

    def advance(self, until_s: float) -> bool:
        """Let time run to ``until_s`` [s], exclusive; False where events and legs should be taken before it goes on."""
        return self._check(self._library.engine_advance(self._handle, until_s, _MOST_WORK), at_s=until_s) == 0

    def take_events(self) -> Records:
        """Return what happened since the last call (dtype ``EVENT``), in order of time, kind, rows; modes in order of their making."""
        events = self._take(self._library.engine_take_events, EVENT)
        events = events[events["kind"] >= 0]
        is_pair = events["kind"] > 0
        order = np.lexsort((np.where(is_pair, events["second"], 0), np.where(is_pair, events["first"], 0), events["kind"], events["t_s"]))
        return events[order]

    def take_legs(self) -> Records:
        """Return the legs completed since the last call (dtype ``LEG``), in order of their ends."""
        return self._take(self._library.engine_take_legs, LEG)

    def current_legs(self) -> Records:
        """Return the present leg of every insect (dtype ``LEG``), shape (n,); its end is what is known of it, inf for a rest."""
        legs = np.empty(self._n, dtype=LEG)
        self._library.engine_current_legs(self._handle, _pointer(legs))
        return legs

    def open_encounters(self) -> Records:
        """Return the encounters going on now (dtype ``EVENT``)."""
        count = self._library.engine_open(self._handle, None, 0)
        found = np.empty(count, dtype=EVENT)
        self._library.engine_open(self._handle, _pointer(found), count)
        return found

    def modes(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return for every insect whether it stands (1) or walks (0), and whether by a command (1), shape (n,) each."""
        still, cause = np.empty(self._n, dtype=np.int32), np.empty(self._n, dtype=np.int32)
        self._library.engine_modes(self._handle, _pointer(still), _pointer(cause))
        return still, cause

    def stop(self, row: int, *, is_command: bool, at_s: float) -> None:
        """Make an insect stand still."""
        self._check(self._library.engine_stop(self._handle, row, int(is_command)), at_s=at_s)

    def go(self, row: int, *, is_command: bool, at_s: float) -> bool:
        """Let an insect walk on in a new direction; return whether it can."""
        return self._check(self._library.engine_go(self._handle, row, int(is_command)), at_s=at_s) > 0

    def turn(self, row: int, *, turns: float, distance: float, at_s: float) -> bool:
        """Turn an insect by part of a full turn (left is positive) and send it straight on; 0 as distance: a leg as drawn."""
        return self._check(self._library.engine_turn(self._handle, row, turns, distance), at_s=at_s) > 0

    def follow_walls(self, row: int, *, follows: bool, at_s: float) -> None:
        """Let an insect keep to the walls that it meets, or live by the law of all again."""
        self._check(self._library.engine_follow_walls(self._handle, row, int(follows)), at_s=at_s)

    def silence(self, row: int, *, at_s: float) -> None:
        """Switch a backpack off."""
        self._check(self._library.engine_silence(self._handle, row), at_s=at_s)

    def replace_walls(self, arena: Arena, *, places: Floats, at_s: float) -> None:
        """Put up other walls, and insects at ``places``, shape (n, 2) [length], all of them free of the new walls."""
        arguments = _wall_arguments(arena)
        places = np.ascontiguousarray(places)
        self._check(self._library.engine_replace_walls(self._handle, *arguments, _pointer(places)), at_s=at_s)

    def save(self) -> bytes:
        """Return a snapshot, without the walls."""
        size = self._library.engine_save(self._handle, None, 0)
        content = ctypes.create_string_buffer(size)
        self._library.engine_save(self._handle, content, size)
        return content.raw

    def _set_walls(self, arena: Arena) -> None:
        if self._check(self._library.engine_set_walls(self._handle, *_wall_arguments(arena)), at_s=0.0) == _OTHER_WALLS:
            raise SnapshotError(source="snapshot", problem="it was taken between other walls")

    def _take(self, function: Any, kind: np.dtype[Any]) -> Records:
        place = c_void_p()
        count = function(self._handle, byref(place))
        if not count:
            return np.empty(0, dtype=kind)
        assert place.value is not None
        return np.frombuffer((ctypes.c_char * (count * kind.itemsize)).from_address(place.value), dtype=kind).copy()

    def _check(self, status: int, *, at_s: float) -> int:
        if status == _OUT_OF_MEMORY:
            raise EngineMemoryError(n_biobots=self._n, at_s=at_s)
        return status


def _wall_arguments(arena: Arena) -> tuple[object, ...]:
    arrays = (arena.wall_start, arena.wall_end, arena.wall_inward, _previous_walls(arena))
    return (arena.wall_start.shape[0], *(_pointer(np.ascontiguousarray(array)) for array in arrays), arena.margin)


def _previous_walls(arena: Arena) -> NDArray[np.int32]:
    """Return for each wall the one before it in its ring; rings follow each other, and each closes where it began."""
    start, end = arena.wall_start.tolist(), arena.wall_end.tolist()
    previous = np.arange(-1, len(start) - 1, dtype=np.int32)
    first = 0
    for wall, place in enumerate(end):
        if place == start[first]:
            previous[first] = wall
            first = wall + 1
    return previous


def _pointer(array: NDArray[Any]) -> c_void_p:
    """Return a pointer that keeps its array alive."""
    return array.ctypes.data_as(c_void_p)
