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

import numpy as np

from simulator.events import Cause, EncounterBegan, EncounterEnded, Event, Mode, ModeChanged
from simulator.geojson import dump_arena
from simulator.legs import Floats
from simulator.world import World


class TruthRecorder:
    """Collects a world's events, and makes its files from them in the end.

    Parameters
    ----------
    world
        The world, before its first ``advance``. It remembers all paths, so places are computed only in the end.
    """

    __slots__ = ("_encounters", "_modes", "_world")

    def __init__(self, world: World) -> None:
        self._world = world
        self._encounters: list[EncounterEnded] = []
        self._modes: dict[int, list[tuple[float, Mode, Cause]]] = {one: [(0.0, Mode.CRW, Cause.NATURAL)] for one in world.ids}

    def record(self, events: Iterable[Event]) -> None:
        """Take in what ``World.advance`` returned."""
        for event in events:
            match event:
                case EncounterEnded():
                    self._encounters.append(event)
                case ModeChanged():
                    self._modes[event.id].append((event.t_s, event.mode, event.cause))
                case EncounterBegan():
                    pass

    def encounters(self, *, zero_s: float) -> list[tuple[float, float, int, int]]:
        """Return all encounters after ``zero_s``, as ``(start_s, end_s, id1, id2)`` in the world's time; those still open end now."""
        now_s = self._world.now_s
        whole = [(one.t_start_s, one.t_end_s, one.id1, one.id2) for one in self._encounters if one.t_end_s > zero_s]
        whole += [(one.t_s, now_s, one.id1, one.id2) for one in self._world.open_encounters() if now_s > max(one.t_s, zero_s)]
        return [(max(start_s, zero_s), end_s, id1, id2) for start_s, end_s, id1, id2 in whole]

    def files(
        self, *, zero_s: float, run: Mapping[str, object], position_samples: int = 201,
        observed: Sequence[tuple[float, float, int, int]] | None = None,
    ) -> dict[str, bytes]:  # fmt: skip
        """Make the content of every file, by name.

        Parameters
        ----------
        zero_s
            The world's time that the files call 0 [s]: when the landmarks were set. What ended before is left out, and what
            was going on starts at 0.
        run
            For ``run.json``; ``counts`` is added to it.
        position_samples
            Number of instants, at least 2, evenly from 0 to the present.
        observed
            What ``encounters.csv`` is to hold instead of the exact encounters, as ``encounters`` gives them.

        Notes
        -----
        Encounters still open now end now. Times are rounded to a nanosecond; rows are in order of start, end and ids.
        """
        exact = self.encounters(zero_s=zero_s)
        rows, places = self._encounter_rows(exact if observed is None else observed, zero_s=zero_s)
        spells = self._mode_rows(zero_s)
        t_s = np.linspace(zero_s, self._world.now_s, position_samples)
        ids = self._world.ids
        positions = self._world.positions_of(np.repeat(ids, position_samples).tolist(), np.tile(t_s, len(ids)))
        truth = io.BytesIO()
        np.savez(
            truth,
            encounter_position=places,
            t_s=t_s - zero_s,
            ids=np.array(ids, dtype=np.int64),
            position=np.ascontiguousarray(positions.reshape(len(ids), position_samples, 2).transpose(1, 0, 2)),
        )
        counts = {"encounters": len(rows), "mode_spells": len(spells), "position_samples": position_samples}
        header = ("t_start_s", "t_end_s", "id1", "id2")
        true = {} if observed is None else {"encounters_true.csv": _csv(header, self._encounter_rows(exact, zero_s=zero_s)[0])}
        return {
            "encounters.csv": _csv(header, rows),
            **true,
            "modes.csv": _csv(("t_start_s", "t_end_s", "id", "mode", "cause"), spells),
            "truth.npz": truth.getvalue(),
            "arena.geojson": dump_arena(self._world.arena).encode(),
            "run.json": (json.dumps({**run, "counts": counts}, indent=2) + "\n").encode(),
        }

    def _encounter_rows(
        self, encounters: Sequence[tuple[float, float, int, int]], *, zero_s: float
    ) -> tuple[list[tuple[str, str, int, int]], Floats]:
        listed = [(*_times(start_s, end_s, zero_s), id1, id2) for start_s, end_s, id1, id2 in encounters]
        order = sorted(range(len(listed)), key=lambda k: (float(listed[k][0]), float(listed[k][1]), *listed[k][2:]))
        centres = np.array([(encounters[k][0] + encounters[k][1]) / 2.0 for k in order], dtype=np.float64)
        first = self._world.positions_of([encounters[k][2] for k in order], centres)
        second = self._world.positions_of([encounters[k][3] for k in order], centres)
        return [listed[k] for k in order], (first + second) / 2.0

    def _mode_rows(self, zero_s: float) -> list[tuple[str, str, int, str, str]]:
        rows = []
        for one, changes in self._modes.items():
            ends = [change[0] for change in changes[1:]] + [self._world.now_s]
            for (start_s, mode, cause), end_s in zip(changes, ends, strict=True):
                if end_s > max(start_s, zero_s):
                    rows.append((*_times(max(start_s, zero_s), end_s, zero_s), one, mode.value, cause.value))
        return sorted(rows, key=lambda row: (float(row[0]), row[2], float(row[1])))


def _times(start_s: float, end_s: float, zero_s: float) -> tuple[str, str]:
    return f"{start_s - zero_s:.9f}", f"{end_s - zero_s:.9f}"


def _csv(header: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue().encode()
