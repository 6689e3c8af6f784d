"""Watch a world while it goes on: a picture in the terminal, or a line of log now and then where there is none."""

import collections
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Self, TextIO

import numpy as np

from firmware_protocol.units import NS_PER_S
from simulator.arenas.arena import Arena
from simulator.clock import Clock, WallClock
from simulator.events import BackpackSilenced, Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged
from simulator.log import EventLog
from simulator.pictures.canvas import Canvas, Ink, fit_view, paint
from simulator.pictures.terminal import Terminal, can_show_pictures, wants_colours
from simulator.world import World

log = EventLog(__name__)

_FRAME_NS = NS_PER_S // 10
# Of the time that passes, drawing takes at most one part in so many.
_DRAWING_PART = 5
_LINE_PERIOD_NS = 5 * NS_PER_S
# Speed and encounters a second are told over the last so many seconds.
_RATE_WINDOW_NS = 3 * NS_PER_S
_FIRST_CHUNK_SHARE = 1e-3
_KEY = ((Ink.WALKING, "walking"), (Ink.RESTING, "resting"), (Ink.LANDMARK, "landmark (block)"), (Ink.MEETING, "meeting"))
_PLAIN_KEY = "dots are insects, blocks are landmarks"
_LEAST_COLUMNS, _LEAST_ROWS = 20, 8
_LANDMARK_DOTS = 2


class Watch:
    """Shows a world at most ten times a second; use it in a ``with`` statement.

    Parameters
    ----------
    world
        The world; it is only looked at, but by ``advance``.
    title
        What is on top of the picture.
    zero_s, end_s
        The world's time that is called 0, and that at which it ends [s], if known.
    n_met
        Encounters so far, where the world has a past.
    stream, environment
        Where to show it, and variables: ``TERM`` and ``NO_COLOR``.
    clock, sleep
        What measures speed, and what waits [s] to keep it.

    Notes
    -----
    Without a terminal, or where ``TERM`` is dumb, an event ``watch.progress`` is logged every five seconds; in the end
    it tells the means of all the time. Log lines wait
    while there is a picture: see ``Terminal``.
    """

    def __init__(
        self,
        world: World,
        *,
        title: str,
        zero_s: float = 0.0,
        end_s: float | None = None,
        n_met: int = 0,
        stream: TextIO | None = None,
        environment: Mapping[str, str] | None = None,
        clock: Clock | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        stream = sys.stderr if stream is None else stream
        environment = os.environ if environment is None else environment
        self._world = world
        self._title = title
        self._zero_s = zero_s
        self._end_s = end_s
        self._clock = WallClock() if clock is None else clock
        self._sleep = sleep
        self._terminal = Terminal(stream) if can_show_pictures(stream, environment) else None
        self._is_coloured = wants_colours(environment)
        self._row = {one: row for row, one in enumerate(world.ids)}
        self._commanded = world.commanded()
        self._n_met = n_met
        self._parted: collections.deque[tuple[int, int]] = collections.deque(maxlen=max(1, len(world.ids) // 20))
        self._history: collections.deque[tuple[int, float, int]] = collections.deque()
        self._began: tuple[int, float, int] | None = None
        self._due_ns = 0
        self._walls: tuple[Arena, int, int, Canvas] | None = None

    def __enter__(self) -> Self:
        if self._terminal is not None:
            self._terminal.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal is not None:
            self._terminal.__exit__()
        if self._began is not None:
            self._history.clear()
            self._history.append(self._began)
        self._remember(self._clock.monotonic_ns())
        self._log_progress()

    def note(self, events: Iterable[Event]) -> None:
        """Take in what ``World.advance`` returned."""
        for event in events:
            match event:
                case EncounterBegan():
                    self._n_met += 1
                case EncounterEnded():
                    self._n_met -= event.t_end_s <= self._zero_s  # the run's files leave out what was over by then
                    self._parted.append((event.id1, event.id2))
                case ModeChanged():
                    is_landmark = event.mode is Mode.S and event.cause is Cause.COMMAND
                    (self._commanded.add if is_landmark else self._commanded.discard)(event.id)
                case BackpackSilenced():
                    pass

    def show(self, *, more: str = "") -> None:
        """Show the world as it is now, if it is time for it.

        Parameters
        ----------
        more
            Put behind the line of state.
        """
        now_ns = self._clock.monotonic_ns()
        if now_ns < self._due_ns:
            return
        self._remember(now_ns)
        if self._terminal is None:
            self._log_progress()
            self._due_ns = now_ns + _LINE_PERIOD_NS
            return
        columns, rows = self._terminal.size()
        self._terminal.show(self.picture(columns=columns, rows=rows, more=more))
        self._parted.clear()
        self._due_ns = now_ns + max(_FRAME_NS, _DRAWING_PART * (self._clock.monotonic_ns() - now_ns))

    def advance(self, until_s: float, *, speed: float | None = None) -> list[Event]:
        """Advance the world, in steps short enough to be watched; the events are those of one step.

        Parameters
        ----------
        until_s
            As in ``World.advance``.
        speed
            How many seconds of the world pass in one of ours; without it, as many as can.
        """
        events: list[Event] = []
        world = self._world
        began_s, began_ns = world.now_s, self._clock.monotonic_ns()
        chunk_s = (until_s - began_s) * _FIRST_CHUNK_SHARE if speed is None else speed * _FRAME_NS / NS_PER_S
        while world.now_s < until_s:
            start_ns = self._clock.monotonic_ns()
            target_s = world.now_s + chunk_s
            made = world.advance(min(until_s, target_s) if target_s > world.now_s else until_s)
            took_ns = max(1, self._clock.monotonic_ns() - start_ns)
            self.note(made)
            events += made
            self.show()
            if speed is None:
                chunk_s *= min(2.0, max(0.5, _FRAME_NS / 2 / took_ns))
            else:
                early_s = (world.now_s - began_s) / speed - (self._clock.monotonic_ns() - began_ns) / NS_PER_S
                if early_s > 0:
                    self._sleep(early_s)
        return events

    def picture(self, *, columns: int, rows: int, more: str = "") -> list[str]:
        """Return the lines of the picture for a window of so many columns and rows of characters."""
        state = f"{self._state()}{'  ' + more if more else ''}"
        log_line = self._terminal.last_log_line if self._terminal is not None else ""
        if columns < _LEAST_COLUMNS or rows < _LEAST_ROWS:
            return [state[:columns]]
        canvas = self._draw(columns, rows - 4)
        fits = len("  ".join(word for _, word in _KEY)) <= columns
        key = "  ".join(paint(word, ink) for ink, word in _KEY) if fits and self._is_coloured else _PLAIN_KEY[:columns]
        return [self._title[:columns], *canvas.lines(is_coloured=self._is_coloured), key, state[:columns], log_line[:columns]]

    def _draw(self, columns: int, rows: int) -> Canvas:
        canvas = self._walls_canvas(columns, rows).copy()
        world = self._world
        places = world.positions()
        standing = np.array([mode is Mode.S for mode in world.modes()], dtype=np.bool_)
        landmark = np.array([one in self._commanded for one in world.ids], dtype=np.bool_) & standing
        pairs = [(one.id1, one.id2) for one in world.open_encounters()] + list(self._parted)
        meeting = np.array([self._row[one] for pair in pairs for one in pair], dtype=np.int64)
        canvas.draw_points(places[~standing], Ink.WALKING)
        canvas.draw_points(places[standing & ~landmark], Ink.RESTING)
        canvas.draw_points(places[landmark], Ink.LANDMARK, size=_LANDMARK_DOTS)
        canvas.draw_points(places[meeting], Ink.MEETING)
        return canvas

    def _walls_canvas(self, columns: int, rows: int) -> Canvas:
        arena = self._world.arena
        if self._walls is None or self._walls[0] is not arena or self._walls[1:3] != (columns, rows):
            canvas = Canvas(fit_view(arena.bounds, columns=columns, rows=rows), columns=columns, rows=rows)
            canvas.draw_lines(arena.wall_start, arena.wall_end, Ink.WALL)
            self._walls = (arena, columns, rows, canvas)
        return self._walls[3]

    def _state(self) -> str:
        speed, met_per_s = self._rates()
        end = "" if self._end_s is None else f" of {self._end_s - self._zero_s:g}"
        return (
            f"{self._world.now_s - self._zero_s:.1f}{end} s  {speed:.3g} x real time  {self._n_met:,} encounters, {met_per_s:.3g} a second"
        )

    def _remember(self, now_ns: int) -> None:
        self._history.append((now_ns, self._world.now_s, self._n_met))
        self._began = self._began or self._history[0]
        while len(self._history) > 2 and now_ns - self._history[1][0] >= _RATE_WINDOW_NS:
            self._history.popleft()

    def _rates(self) -> tuple[float, float]:
        """Return how many seconds of the world pass in one of ours, and how many encounters begin in one of the world's."""
        if len(self._history) < 2:
            return 0.0, 0.0
        (from_ns, from_s, from_met), (to_ns, to_s, to_met) = self._history[0], self._history[-1]
        passed_s = to_s - from_s
        return passed_s / max(1e-9, (to_ns - from_ns) / NS_PER_S), (to_met - from_met) / passed_s if passed_s > 0 else 0.0

    def _log_progress(self) -> None:
        speed, met_per_s = self._rates()
        log.info(
            "watch.progress",
            t_s=round(self._world.now_s - self._zero_s, 1),
            times_real_time=float(f"{speed:.3g}"),
            encounters=self._n_met,
            encounters_per_s=float(f"{met_per_s:.3g}"),
        )
