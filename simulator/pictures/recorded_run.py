"""Read a run's directory as ``truth.py`` wrote it, every fault named with its file."""

import csv
import io
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.arenas.arena import Arena
from simulator.arenas.geojson import load_arena, parse_arena
from simulator.errors import RunFileError
from simulator.events import Cause, Mode
from simulator.pictures.track import Flags, Floats, Track

Indices = NDArray[np.int64]

RUN_FILES = ("run.json", "arena.geojson", "encounters.csv", "modes.csv", "truth.npz", "reported.csv")
"""Names of what a run writes; nothing else may take their place."""

_KNOWN_FORMATS = (1,)
"""``RUN_FORMAT`` of ``truth.py``, now and before; a run of before that number was told is of format 1."""

_PROGRAMS = ("biobot-sim run", "biobot-sim serve")
_WANTED_RUN = "give the directory of a finished biobot-sim run, or of biobot-sim serve --out"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedRun:
    """What is known of a run from its files. Time 0 is when its landmarks were set.

    Parameters
    ----------
    ids
        Identities, ascending, shape (n,); rows of everything below refer to them.
    t_s
        Instants of the samples [s], shape (m,).
    track
        Places of all biobots over time.
    arenas
        From which instant on [s] which walls stood, the first from the start.
    met_start_s, met_end_s
        When each encounter began and ended [s], shape (k,), by beginning.
    met_first, met_second
        Rows of its two biobots, shape (k,).
    met_place
        Where it was, shape (k, 2) [length].
    spell_start_s, spell_end_s, spell_row
        Spells of standing still [s], and whose, shape (j,).
    spell_commanded
        Whether the base station asked for the spell, shape (j,).
    landmark_rows
        Rows of the landmarks that the run set itself; None if it left that to a base station.
    """

    name: str
    preset: str
    seed: int
    unit: str
    ids: Indices
    t_s: Floats
    position: Floats
    track: Track
    arenas: tuple[tuple[float, Arena], ...]
    met_start_s: Floats
    met_end_s: Floats
    met_first: Indices
    met_second: Indices
    met_place: Floats
    spell_start_s: Floats
    spell_end_s: Floats
    spell_row: Indices
    spell_commanded: Flags
    landmark_rows: Indices | None

    @property
    def end_s(self) -> float:
        """When the run ended [s]."""
        return float(self.t_s[-1])

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x and y, largest x and y of all arenas [length]."""
        low_x, low_y, high_x, high_y = zip(*(arena.bounds for _, arena in self.arenas), strict=True)
        return min(low_x), min(low_y), max(high_x), max(high_y)

    def standing_at(self, at_s: float) -> tuple[Flags, Flags]:
        """Tell who is a landmark at an instant [s] and who else stands still: two arrays of shape (n,).

        Where the run does not say who its landmarks are, those that stand by command count.
        """
        now = (self.spell_start_s <= at_s) & ((at_s < self.spell_end_s) | (self.spell_end_s >= self.end_s))
        standing = np.zeros(self.ids.size, dtype=np.bool_)
        standing[self.spell_row[now]] = True
        landmark = np.zeros(self.ids.size, dtype=np.bool_)
        landmark[self.spell_row[now & self.spell_commanded] if self.landmark_rows is None else self.landmark_rows] = True
        return landmark & standing, standing & ~landmark

    def meeting_at(self, at_s: float) -> Indices:
        """Return the rows of the encounters that go on at an instant [s]."""
        return np.flatnonzero((self.met_start_s <= at_s) & (at_s <= self.met_end_s))


def read_run(path: Path) -> RecordedRun:
    """Read a run's directory.

    Raises
    ------
    RunFileError
        It is no directory of a run, a file is missing or broken, or was written by a version not known here.
    ArenaError
        The arena in it is none.
    """
    if not path.is_dir():
        problem = "is not a directory" if path.exists() else "does not exist"
        raise RunFileError(path=path, problem=f"{problem}; {_WANTED_RUN}")
    about = _read_description(path / "run.json")
    arenas = ((-math.inf, load_arena(_need(path / "arena.geojson"))), *_read_changes(path, about))
    truth = _read_truth(path / "truth.npz")
    ids = truth["ids"].astype(np.int64)
    row = {one: k for k, one in enumerate(ids.tolist())}
    met = _Table(path / "encounters.csv", ("t_start_s", "t_end_s", "id1", "id2"))
    if len(met.rows) != len(truth["encounter_position"]):
        raise RunFileError(
            path=met.path,
            problem=f"has {len(met.rows)} encounters where truth.npz has places of {len(truth['encounter_position'])}; "
            "they are not of one run: make the run again",
        )
    modes = _Table(path / "modes.csv", ("t_start_s", "t_end_s", "id", "mode", "cause"))
    counts = about.get("counts")
    wanted = counts.get("mode_spells", len(modes.rows)) if isinstance(counts, dict) else len(modes.rows)
    if len(modes.rows) != wanted:
        problem = f"has {len(modes.rows)} rows where run.json counts {wanted}; it is cut short or not of this run: make the run again"
        raise RunFileError(path=modes.path, problem=problem)
    still = modes.text("mode") == Mode.S.value
    landmarks = about.get("landmark_ids")
    if landmarks is not None and not (isinstance(landmarks, list) and all(isinstance(one, int) and one in row for one in landmarks)):
        raise RunFileError(path=path / "run.json", problem="landmark_ids is no list of ids that truth.npz knows; make the run again")
    for array in (truth["t_s"], truth["position"], truth["encounter_position"], ids):
        array.setflags(write=False)
    return RecordedRun(
        name=str(about.get("scenario") or Path(str(about.get("arena") or path.name)).name),
        preset=str(about.get("preset", "unknown")),
        seed=_integer(about.get("seed"), path / "run.json", key="seed"),
        unit=str(about.get("unit_of_length", "unit")),
        ids=ids,
        t_s=truth["t_s"],
        position=truth["position"],
        track=Track(t_s=truth["t_s"], position=truth["position"], arenas=arenas),
        arenas=arenas,
        met_start_s=met.numbers("t_start_s"),
        met_end_s=met.numbers("t_end_s"),
        met_first=met.rows_of("id1", row),
        met_second=met.rows_of("id2", row),
        met_place=truth["encounter_position"],
        spell_start_s=modes.numbers("t_start_s")[still],
        spell_end_s=modes.numbers("t_end_s")[still],
        spell_row=modes.rows_of("id", row)[still],
        spell_commanded=(modes.text("cause") == Cause.COMMAND.value)[still],
        landmark_rows=None if landmarks is None else np.array([row[one] for one in landmarks], dtype=np.int64),
    )


def _need(path: Path) -> Path:
    if not path.is_file():
        raise RunFileError(path=path, problem=f"is missing; {_WANTED_RUN}")
    return path


def _read_bytes(path: Path) -> bytes:
    try:
        return _need(path).read_bytes()
    except OSError as error:
        raise RunFileError(path=path, problem=f"cannot be read: {error.strerror or error}") from error


def _read_description(path: Path) -> Mapping[str, object]:
    try:
        about = json.loads(_read_bytes(path).decode())
    except (ValueError, RecursionError) as error:
        raise RunFileError(path=path, problem=f"is not JSON ({error}); it is cut short or was changed: make the run again") from error
    program = about.get("program") if isinstance(about, dict) else None
    if not isinstance(about, dict) or program not in _PROGRAMS:
        raise RunFileError(path=path, problem=f"names the program {program!r}; wanted one of {', '.join(_PROGRAMS)}: {_WANTED_RUN}")
    form = about.get("format", 1)
    if form not in _KNOWN_FORMATS:
        raise RunFileError(
            path=path,
            problem=f"is of format {form!r}, written by version {about.get('version')}; this version reads format "
            f"{', '.join(map(str, _KNOWN_FORMATS))}: install the version that wrote it",
        )
    return about


def _read_changes(directory: Path, about: Mapping[str, object]) -> list[tuple[float, Arena]]:
    """Read how the walls change: each change has ``at_s``, and a geometry in ``arena`` or a name beside ``run.json`` in ``file``."""
    changes = about.get("arena_changes") or []
    path = directory / "run.json"
    if not isinstance(changes, list):
        raise RunFileError(path=path, problem=f"arena_changes is {changes!r}; wanted a list: make the run again")
    read: list[tuple[float, Arena]] = []
    for number, change in enumerate(changes, start=1):
        where = f"arena change {number}"
        at_s = change.get("at_s") if isinstance(change, dict) else None
        if not isinstance(at_s, int | float) or not math.isfinite(at_s):
            raise RunFileError(path=path, problem=f"{where} has at_s {at_s!r}; wanted a finite number of seconds: make the run again")
        if isinstance(change.get("arena"), dict):
            arena = parse_arena(json.dumps(change["arena"]).encode(), source=f"{path}, {where}")
        elif isinstance(change.get("file"), str) and change["file"] == Path(change["file"]).name:
            arena = load_arena(_need(directory / change["file"]))
        else:
            raise RunFileError(path=path, problem=f"{where} has neither a geometry in arena nor a plain name in file: make the run again")
        read.append((float(at_s), arena))
    return sorted(read, key=lambda one: one[0])


def _read_truth(path: Path) -> dict[str, NDArray[np.float64]]:
    content = _read_bytes(path)
    names = ("t_s", "ids", "position", "encounter_position")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            truth = {name: np.asarray(archive[name], dtype=np.float64) for name in names}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, TypeError, AttributeError) as error:
        raise RunFileError(path=path, problem=f"is no whole archive of {', '.join(names)} ({error}); make the run again") from error
    t_s, ids, position, places = (truth[name] for name in names)
    faults = {
        "t_s does not ascend": t_s.ndim != 1 or not t_s.size or bool((np.diff(t_s) < 0).any()),
        "ids do not ascend": ids.ndim != 1 or not ids.size or bool((np.diff(ids) <= 0).any()),
        f"position has shape {position.shape}": position.shape != (t_s.size, ids.size, 2),
        f"encounter_position has shape {places.shape}": places.ndim != 2 or places.shape[1] != 2,
        "there are numbers that are not finite": not all(np.isfinite(array).all() for array in truth.values()),
    }
    for fault in (fault for fault, is_so in faults.items() if is_so):
        raise RunFileError(path=path, problem=f"makes no sense: {fault}; make the run again")
    return truth


def _integer(value: object, path: Path, *, key: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise RunFileError(path=path, problem=f"{key} is {value!r}; wanted an integer: make the run again")
    return value


class _Table:
    """A CSV file of which some columns are needed; further columns are left aside."""

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        self.path = path
        try:
            lines = list(csv.reader(io.StringIO(_read_bytes(path).decode(), newline="")))
        except (UnicodeDecodeError, csv.Error) as error:
            raise RunFileError(path=path, problem=f"is no CSV text ({error}); make the run again") from error
        header = lines[0] if lines else []
        if missing := [name for name in columns if name not in header]:
            raise RunFileError(path=path, problem=f"its header lacks {', '.join(missing)}; make the run again")
        self.rows = lines[1:]
        self._column = {name: header.index(name) for name in columns}
        for number, row in enumerate(self.rows, start=2):
            if len(row) != len(header):
                raise RunFileError(
                    path=path,
                    problem=f"line {number} has {len(row)} fields, its header {len(header)}; the file is cut short: make the run again",
                )

    def text(self, name: str) -> NDArray[np.str_]:
        column = self._column[name]
        return np.array([row[column] for row in self.rows], dtype=np.str_)

    def numbers(self, name: str) -> Floats:
        column = self._column[name]
        values = []
        for line, row in enumerate(self.rows, start=2):
            try:
                value = float(row[column])
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise RunFileError(path=self.path, problem=f"line {line}: {name} is {row[column]!r}; wanted a number: make the run again")
            values.append(value)
        return np.array(values, dtype=np.float64)

    def rows_of(self, name: str, row: Mapping[int, int]) -> Indices:
        found = []
        for line, one in enumerate(self.numbers(name).tolist(), start=2):
            if one not in row:
                raise RunFileError(path=self.path, problem=f"line {line}: {name} is {one:g}, unknown to truth.npz; make the run again")
            found.append(row[one])
        return np.array(found, dtype=np.int64)
