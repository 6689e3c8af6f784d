"""The truth of a run, as files: encounters with their places, modes, positions, arena and parameters.

``encounters.csv`` and ``modes.csv`` hold what a perfect base station would know. Where encounters are sensed by beacons,
``encounters.csv`` holds what a real one would, and ``encounters_true.csv`` the exact ones. ``truth.npz`` holds what none can know:

    encounter_position  (rows of encounters.csv, 2)   middle between the two at the middle of the encounter [length]
    t_s                 (n_t,)                        instants [s]
    ids                 (n,)                          identities
    position            (n_t, n, 2)                   where each biobot was [length]
"""

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from simulator.arenas.arena import Arena, ArenaChange
from simulator.arenas.geojson import dump_arena
from simulator.events import (
    BackpackSilenced,
    Cause,
    EncounterBegan,
    EncounterEnded,
    EncounterTable,
    Event,
    Happenings,
    Mode,
    ModeChanged,
    SilenceReason,
)
from simulator.habitat import Habitat
from simulator.legs import Floats
from simulator.setting import change_file

RUN_FORMAT = 1
"""Told in ``run.json``; a new number for files that an older reader would misunderstand."""

Integers = NDArray[np.int64]
Columns = tuple[Integers, Integers, Floats, Floats]
Encounter = tuple[float, float, int, int]


class RecorderState(msgspec.Struct, frozen=True, kw_only=True):
    """What a recorder has collected: columns of encounters as bytes, modes and silences as they came."""

    id1: bytes
    id2: bytes
    t_start_s: bytes
    t_end_s: bytes
    modes: dict[int, list[tuple[float, str, str]]]
    silences: list[tuple[float, int, str]]


class TruthRecorder:
    """Collects a world's events, and makes its files from them in the end.

    Parameters
    ----------
    world
        The world, before its first ``advance``. It remembers all paths, so places are computed only in the end.
    state
        What an earlier recorder of the same world had collected.
    """

    __slots__ = ("_encounters", "_modes", "_silences", "_tables", "_world")

    def __init__(self, world: Habitat, *, state: "RecorderState | None" = None) -> None:
        self._world = world
        self._encounters: list[EncounterEnded] = []
        self._tables: list[EncounterTable] = []
        self._silences: list[BackpackSilenced] = []
        self._modes: dict[int, list[tuple[float, Mode, Cause]]] = {one: [(0.0, Mode.CRW, Cause.NATURAL)] for one in world.ids}
        if state is not None:
            id1, id2 = (np.frombuffer(column, dtype=np.int64) for column in (state.id1, state.id2))
            start_s, end_s = (np.frombuffer(column, dtype=np.float64) for column in (state.t_start_s, state.t_end_s))
            self._tables.append(EncounterTable(id1=id1, id2=id2, t_start_s=start_s, t_end_s=end_s))
            self._modes = {one: [(t_s, Mode(mode), Cause(cause)) for t_s, mode, cause in changes] for one, changes in state.modes.items()}
            self._silences = [BackpackSilenced(t_s=t_s, id=one, reason=SilenceReason(reason)) for t_s, one, reason in state.silences]

    def state(self) -> "RecorderState":
        """Return what was collected so far, for a snapshot."""
        id1, id2, start_s, end_s = self._columns()
        return RecorderState(
            id1=id1.tobytes(),
            id2=id2.tobytes(),
            t_start_s=start_s.tobytes(),
            t_end_s=end_s.tobytes(),
            modes={one: [(t_s, mode.value, cause.value) for t_s, mode, cause in changes] for one, changes in self._modes.items()},
            silences=[(one.t_s, one.id, one.reason.value) for one in self._silences],
        )

    @property
    def silent_from_s(self) -> dict[int, float]:
        """When each backpack that is off fell silent [s of the world], by identity."""
        return {one.id: one.t_s for one in self._silences}

    def record(self, events: Iterable[Event]) -> None:
        """Take in what ``World.advance`` returned."""
        for event in events:
            match event:
                case EncounterEnded():
                    self._encounters.append(event)
                case ModeChanged():
                    self._modes[event.id].append((event.t_s, event.mode, event.cause))
                case BackpackSilenced():
                    self._silences.append(event)
                case EncounterBegan():
                    pass

    def record_run(self, run: Happenings) -> None:
        """Take in what ``World.run`` returned."""
        self._tables.append(run.ended)
        self.record(run.changes)

    def count_encounters(self, *, zero_s: float) -> int:
        """Count the encounters that the files will tell of."""
        _, _, start_s, end_s = self._columns()
        still = sum(self._world.now_s > max(one.t_s, zero_s) for one in self._world.open_encounters())
        return int(np.count_nonzero(end_s > np.maximum(start_s, zero_s))) + still

    def encounters(self, *, zero_s: float) -> list[Encounter]:
        """Return all encounters after ``zero_s``, as ``(start_s, end_s, id1, id2)`` in the world's time; those still open end now."""
        id1, id2, start_s, end_s = self._columns_until_now(zero_s)
        return list(zip(start_s.tolist(), end_s.tolist(), id1.tolist(), id2.tolist(), strict=True))

    def files(
        self,
        *,
        zero_s: float,
        run: Mapping[str, object],
        position_samples: int = 201,
        arena: Arena | None = None,
        changes: Sequence[ArenaChange] = (),
        observed: Sequence[Encounter] | None = None,
    ) -> dict[str, bytes]:
        """Make the content of every file, by name.

        Parameters
        ----------
        zero_s
            The world's time that the files call 0 [s]: when the landmarks were set. What ended before is left out, and what
            was going on starts at 0.
        run
            For ``run.json``; ``format`` and ``counts`` are added to it.
        position_samples
            Number of instants, at least 2, evenly from 0 to the present.
        arena
            The arena to begin with, where it has changed since.
        changes
            What it became meanwhile; each gets a file of its own.
        observed
            What ``encounters.csv`` is to hold instead of the exact encounters, as ``encounters`` gives them.

        Notes
        -----
        Encounters still open now end now. Times are rounded to a nanosecond; rows are in order of start, end and ids. Where the
        world's arena is unknown, there are neither ``truth.npz`` nor ``arena.geojson``.
        """
        exact = self._columns_until_now(zero_s)
        rows, places = self._encounter_rows(exact if observed is None else _to_columns(observed), zero_s=zero_s)
        spells = self._mode_rows(zero_s)
        silences = [{"t_s": one.t_s - zero_s, "id": one.id, "reason": one.reason.value} for one in self._silences]
        counts = {"encounters": len(rows), "mode_spells": len(spells)}
        header = ("t_start_s", "t_end_s", "id1", "id2")
        true = {} if observed is None else {"encounters_true.csv": _csv(header, self._encounter_rows(exact, zero_s=zero_s)[0])}
        files = {
            "encounters.csv": _csv(header, rows),
            **true,
            "modes.csv": _csv(("t_start_s", "t_end_s", "id", "mode", "cause"), spells),
        }
        first = arena or self._world.arena
        if first is not None:
            files["truth.npz"] = self._dump_places(places, zero_s=zero_s, position_samples=position_samples)
            files["arena.geojson"] = dump_arena(first).encode()
            files |= {change_file(number): dump_arena(change.arena).encode() for number, change in enumerate(changes, start=1)}
            counts["position_samples"] = position_samples
        about = {"format": RUN_FORMAT, **run, "silenced_backpacks": silences, "counts": counts}
        return {**files, "run.json": (json.dumps(about, indent=2) + "\n").encode()}

    def _dump_places(self, encounter_places: Floats, *, zero_s: float, position_samples: int) -> bytes:
        t_s = np.linspace(zero_s, self._world.now_s, position_samples)
        truth = io.BytesIO()
        np.savez(
            truth,
            encounter_position=encounter_places,
            t_s=t_s - zero_s,
            ids=np.array(self._world.ids, dtype=np.int64),
            position=self._world.positions_at(t_s),
        )
        return truth.getvalue()

    def _columns_until_now(self, zero_s: float) -> Columns:
        """Return both ids, start and end [s] of every encounter after ``zero_s``; those still open end now."""
        id1, id2, start_s, end_s = self._columns()
        still = self._world.open_encounters()
        id1 = np.concatenate([id1, np.array([one.id1 for one in still], dtype=np.int64)])
        id2 = np.concatenate([id2, np.array([one.id2 for one in still], dtype=np.int64)])
        start_s = np.maximum(np.concatenate([start_s, np.array([one.t_s for one in still], dtype=np.float64)]), zero_s)
        end_s = np.concatenate([end_s, np.full(len(still), self._world.now_s)])
        kept = end_s > start_s
        return id1[kept], id2[kept], start_s[kept], end_s[kept]

    def _encounter_rows(self, encounters: Columns, *, zero_s: float) -> tuple[list[tuple[str, str, int, int]], Floats]:
        id1, id2, start_s, end_s = encounters
        # In order of the times as they are written, to the nanosecond.
        written = [np.round(times - zero_s, 9) for times in (start_s, end_s)]
        order = np.lexsort((id2, id1, written[1], written[0]))
        id1, id2, start_s, end_s = id1[order], id2[order], start_s[order], end_s[order]
        centres = (start_s + end_s) / 2.0
        places = (self._world.positions_of(id1, centres) + self._world.positions_of(id2, centres)) / 2.0
        rows = zip(start_s.tolist(), end_s.tolist(), id1.tolist(), id2.tolist(), strict=True)
        return [(*_times(start, end, zero_s), one, other) for start, end, one, other in rows], places

    def _columns(self) -> Columns:
        """Return both ids, start and end [s] of every encounter that has ended, shape (k,) each."""
        alone = self._encounters
        tables = [
            EncounterTable(
                id1=np.array([one.id1 for one in alone], dtype=np.int64),
                id2=np.array([one.id2 for one in alone], dtype=np.int64),
                t_start_s=np.array([one.t_start_s for one in alone], dtype=np.float64),
                t_end_s=np.array([one.t_end_s for one in alone], dtype=np.float64),
            ),
            *self._tables,
        ]
        return (
            np.concatenate([table.id1 for table in tables]),
            np.concatenate([table.id2 for table in tables]),
            np.concatenate([table.t_start_s for table in tables]),
            np.concatenate([table.t_end_s for table in tables]),
        )

    def _mode_rows(self, zero_s: float) -> list[tuple[str, str, int, str, str]]:
        rows = []
        for one, changes in self._modes.items():
            ends = [change[0] for change in changes[1:]] + [self._world.now_s]
            for (start_s, mode, cause), end_s in zip(changes, ends, strict=True):
                if end_s > max(start_s, zero_s):
                    rows.append((*_times(max(start_s, zero_s), end_s, zero_s), one, mode.value, cause.value))
        return sorted(rows, key=lambda row: (float(row[0]), row[2], float(row[1])))


def _to_columns(encounters: Sequence[Encounter]) -> Columns:
    start_s, end_s, id1, id2 = zip(*encounters, strict=True) if encounters else ((), (), (), ())
    return (
        np.array(id1, dtype=np.int64),
        np.array(id2, dtype=np.int64),
        np.array(start_s, dtype=np.float64),
        np.array(end_s, dtype=np.float64),
    )


def _times(start_s: float, end_s: float, zero_s: float) -> tuple[str, str]:
    return f"{start_s - zero_s:.9f}", f"{end_s - zero_s:.9f}"


def _csv(header: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue().encode()
