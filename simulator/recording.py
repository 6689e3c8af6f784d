"""Recorded runs: a directory as ``biobot-sim run`` and ``serve`` write it, or a CSV file of encounters from anywhere."""

import csv
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulator.arenas.arena import Arena
from simulator.arenas.geojson import load_arena
from simulator.config import Ranges
from simulator.errors import ParameterError, RecordingError
from simulator.events import Cause, Mode
from simulator.legs import Floats

ENCOUNTER_COLUMNS = ("t_start_s", "t_end_s", "id1", "id2")
MODE_COLUMNS = ("t_start_s", "t_end_s", "id", "mode", "cause")

_MAX_ROWS = 5_000_000
_MAX_ID = 2**63 - 1
_UNKNOWN_RANGES = Ranges(detection=1.0, communication=8.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedEncounter:
    """Two biobots met; ``id1 < id2``. Times are the recording's own [s]."""

    t_start_s: float
    t_end_s: float
    id1: int
    id2: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSpell:
    """A biobot was in a mode. Times are the recording's own [s]."""

    t_start_s: float
    t_end_s: float
    id: int
    mode: Mode
    cause: Cause


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedPlaces:
    """Where biobots were.

    Parameters
    ----------
    t_s
        Instants of the recording [s], shape (n_t,), ascending.
    ids
        Identities, ascending, in the order of the second axis of ``position``.
    position
        Shape (n_t, n, 2) [length].
    """

    arena: Arena
    t_s: Floats
    ids: tuple[int, ...]
    position: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A recorded run.

    Parameters
    ----------
    encounters
        By start, end and ids.
    spells
        By start and id; empty where no modes were recorded.
    zero_s
        The instant at which a replay begins [s]: 0 for a directory with a ``run.json``, else the earliest one recorded.
    places
        None where no places were recorded.
    """

    source: Path
    encounters: tuple[RecordedEncounter, ...]
    spells: tuple[RecordedSpell, ...]
    ids: tuple[int, ...]
    zero_s: float
    end_s: float
    ranges: Ranges
    places: RecordedPlaces | None


def load_recording(path: Path) -> Recording:
    """Read a directory of results, or a CSV file of encounters.

    Raises
    ------
    RecordingError
        A file cannot be read or says what cannot be; the message names file, line and reason.
    ArenaError
        The directory's arena is faulty.
    """
    if not path.is_dir():
        return _assemble(path, encounters=_read_encounters(path), spells=[], run=None, places=None)
    encounters_csv = path / "encounters.csv"
    if (path / "encounters.csv.partial").is_file():  # of a run that was killed
        return _assemble(path, encounters=_read_encounters(path / "encounters.csv.partial"), spells=[], run=None, places=None)
    if not encounters_csv.is_file():
        raise RecordingError(path=path, problem="holds no encounters.csv; give a directory of results or a CSV file of encounters")
    encounters = _read_encounters(encounters_csv)
    modes_csv, arena_file, truth_file, run_file = (path / name for name in ("modes.csv", "arena.geojson", "truth.npz", "run.json"))
    spells = _read_spells(modes_csv) if modes_csv.is_file() else []
    places = _read_places(truth_file, arena=load_arena(arena_file)) if arena_file.is_file() and truth_file.is_file() else None
    return _assemble(path, encounters=encounters, spells=spells, run=_read_run(run_file) if run_file.is_file() else None, places=places)


def _assemble(
    source: Path,
    *,
    encounters: list[RecordedEncounter],
    spells: list[RecordedSpell],
    run: Mapping[str, object] | None,
    places: RecordedPlaces | None,
) -> Recording:
    ids = {one for row in encounters for one in (row.id1, row.id2)} | {row.id for row in spells} | set(places.ids if places else ())
    if not ids:
        raise RecordingError(path=source, problem="holds not a single encounter; there is nothing to replay")
    if places is not None and set(places.ids) != ids:
        strangers = sorted(ids - set(places.ids))
        raise RecordingError(path=source / "truth.npz", problem=f"has no places of biobot {strangers[0]}; take the file away, or mend it")
    starts = [row.t_start_s for row in encounters] + [row.t_start_s for row in spells]
    ends = [row.t_end_s for row in encounters] + [row.t_end_s for row in spells]
    zero_s = 0.0 if run is not None else min(starts, default=0.0)
    if min(starts, default=0.0) < zero_s:
        raise RecordingError(path=source, problem=f"something begins at {min(starts)!r} s; in a directory with a run.json times begin at 0")
    return Recording(
        source=source,
        encounters=tuple(encounters),
        spells=tuple(spells),
        ids=tuple(sorted(ids)),
        zero_s=zero_s,
        end_s=max([zero_s, *ends, *(places.t_s[-1:].tolist() if places else ())]),
        ranges=_ranges(run),
        places=places,
    )


def _read_encounters(path: Path) -> list[RecordedEncounter]:
    rows: list[tuple[RecordedEncounter, int]] = []
    for line, row in _read_rows(path, ENCOUNTER_COLUMNS):
        start_s, end_s = _interval(row, path=path, line=line)
        id1, id2 = (_identity(row[name], name=name, path=path, line=line) for name in ("id1", "id2"))
        if id1 == id2:
            raise RecordingError(path=path, line=line, problem=f"biobot {id1} meets itself; wanted two different ids")
        rows.append((RecordedEncounter(t_start_s=start_s, t_end_s=end_s, id1=min(id1, id2), id2=max(id1, id2)), line))
    rows.sort(key=lambda item: (item[0].t_start_s, item[0].t_end_s, item[0].id1, item[0].id2))
    last: dict[tuple[int, int], tuple[RecordedEncounter, int]] = {}
    for one, line in rows:
        before = last.get((one.id1, one.id2))
        if before is not None and (one.t_start_s < before[0].t_end_s or one == before[0]):
            problem = f"biobots {one.id1} and {one.id2} meet while their encounter of line {before[1]} still goes on; wanted one row for it"
            raise RecordingError(path=path, line=line, problem=problem)
        last[one.id1, one.id2] = (one, line)
    return [one for one, _ in rows]


def _read_spells(path: Path) -> list[RecordedSpell]:
    spells = []
    until_s: dict[int, float] = {}
    for line, row in _read_rows(path, MODE_COLUMNS):
        start_s, end_s = _interval(row, path=path, line=line)
        try:
            mode, cause = Mode(row["mode"]), Cause(row["cause"])
        except ValueError:
            problem = f"mode {row['mode']!r}, cause {row['cause']!r}; wanted CRW or S, command or natural"
            raise RecordingError(path=path, line=line, problem=problem) from None
        one = _identity(row["id"], name="id", path=path, line=line)
        if start_s < until_s.get(one, -math.inf):
            raise RecordingError(path=path, line=line, problem=f"biobot {one} is still in an earlier mode at {start_s!r} s")
        until_s[one] = end_s
        spells.append(RecordedSpell(t_start_s=start_s, t_end_s=end_s, id=one, mode=mode, cause=cause))
    return sorted(spells, key=lambda one: (one.t_start_s, one.id))


def _read_rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield line number and cells by name; the columns may stand in any order, and others among them."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise RecordingError(path=path, problem=f"cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise RecordingError(path=path, problem=f"not UTF-8 text (byte {error.start}); give a CSV file") from error
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        header = next(reader, [])
        missing = [name for name in columns if header.count(name) != 1]
        if missing:
            problem = f"the header is {','.join(header)[:80]!r}; wanted each of {','.join(columns)} once"
            raise RecordingError(path=path, line=1, problem=problem)
        for count, cells in enumerate(reader):
            if count >= _MAX_ROWS:
                raise RecordingError(path=path, line=reader.line_num, problem=f"more than {_MAX_ROWS} rows; cut the recording into parts")
            if len(cells) == len(header):
                yield reader.line_num, dict(zip(header, cells, strict=True))
            elif cells:
                raise RecordingError(path=path, line=reader.line_num, problem=f"{len(cells)} cells; wanted {len(header)}, as in the header")
    except csv.Error as error:
        raise RecordingError(path=path, line=reader.line_num, problem=f"no CSV: {error}") from error


def _interval(row: Mapping[str, str], *, path: Path, line: int) -> tuple[float, float]:
    times = []
    for name in ("t_start_s", "t_end_s"):
        try:
            time_s = float(row[name])
        except ValueError:
            time_s = math.nan
        if not math.isfinite(time_s):
            raise RecordingError(path=path, line=line, problem=f"{name} is {row[name]!r}; wanted a finite number of seconds")
        times.append(time_s)
    if times[1] < times[0]:
        raise RecordingError(path=path, line=line, problem=f"ends at {times[1]!r} s, before it starts at {times[0]!r} s")
    return times[0], times[1]


def _identity(text: str, *, name: str, path: Path, line: int) -> int:
    if not (text.isascii() and text.strip().isdigit() and int(text) <= _MAX_ID):
        raise RecordingError(path=path, line=line, problem=f"{name} is {text!r}; wanted a whole number that is not negative")
    return int(text)


def _read_run(path: Path) -> Mapping[str, object]:
    try:
        run = json.loads(path.read_bytes())
    except OSError as error:
        raise RecordingError(path=path, problem=f"cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise RecordingError(path=path, problem=f"no JSON: {error}; take the file away, or mend it") from error
    if not isinstance(run, dict):
        raise RecordingError(path=path, problem="no JSON object; take the file away, or mend it")
    return run


def _ranges(run: Mapping[str, object] | None) -> Ranges:
    """Return the recorded ranges; 1 and 8 where none are said, of which only neighbours and signal strengths depend."""
    parameters = run.get("parameters") if run is not None else None
    if not isinstance(parameters, dict):
        return _UNKNOWN_RANGES
    detection, communication = parameters.get("detection_radius"), parameters.get("communication_radius")
    if not isinstance(detection, int | float) or not isinstance(communication, int | float):
        return _UNKNOWN_RANGES
    try:
        return Ranges(detection=detection, communication=communication)
    except ParameterError:
        return _UNKNOWN_RANGES


def _read_places(path: Path, *, arena: Arena) -> RecordedPlaces:
    try:
        with np.load(path, allow_pickle=False) as archive:
            t_s, ids, position = (np.asarray(archive[name]) for name in ("t_s", "ids", "position"))
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise RecordingError(path=path, problem=f"cannot be read: {error}; take the file away, or mend it") from error
    laws: dict[str, Callable[[], bool]] = {
        "t_s, ids and position of shapes (n_t,), (n,) and (n_t, n, 2)": lambda: (
            t_s.ndim == 1 and ids.ndim == 1 and position.shape == (t_s.size, ids.size, 2) and t_s.size > 0
        ),
        "finite numbers": lambda: all(array.dtype.kind in "fiu" and bool(np.isfinite(array).all()) for array in (t_s, ids, position)),
        "ascending instants and ids": lambda: bool((np.diff(t_s) >= 0).all() and (np.diff(ids.astype(np.int64)) > 0).all()),
    }
    for wanted, holds in laws.items():
        if not holds():
            raise RecordingError(path=path, problem=f"wanted {wanted}; take the file away, or mend it")
    return RecordedPlaces(
        arena=arena,
        t_s=t_s.astype(np.float64),
        ids=tuple(int(one) for one in ids),
        position=position.astype(np.float64),
    )
