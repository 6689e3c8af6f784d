"""``biobot-mapper merge``: several recordings, each a CSV file or the directory of a run, and finished maps, as one map."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from firmware_protocol.units import NS_PER_S
from mapper.config import RecipeConfig, make_recipe
from mapper.encounter_csv import read_encounters, read_modes
from mapper.errors import OutOfMemoryError, TooFewEncountersError
from mapper.kernels import choose_kernels
from mapper.map_file import merging_facts, read_map_file, take_map
from mapper.pipeline import MIN_ENCOUNTERS, compute_map, join_finished_maps
from mapper.pooling import Recording, count_shared_landmarks, pool_recordings, shift_recording
from mapper.report import JsonObject, JsonValue, to_json_object
from mapper.time_doubts import doubt_modes, doubt_unit
from mapper.types import EncounterTable, MapResult, Method, MetricKind, ModeSpell, Recipe
from mapper.window import absent_biobots, drop_repeated, stationary_spells


def merge(args: argparse.Namespace, recipe: Recipe) -> tuple[MapResult, JsonObject]:
    """Make the one map, and say what it was made of, for its document.

    Encounters are put into one table and mapped as one recording; finished maps are joined by what they share, and that map with them.

    Raises
    ------
    ConfigurationError
        The flags do not fit the inputs.
    MapError
        A file cannot be used, there is too little to map, or maps were made in different ways.
    """
    files: list[Path] = [path for path in args.inputs if _is_map(path)]
    maps = [read_map_file(path) for path in files]
    recordings, repeated = _read_recordings(args)
    result, facts = _merge_recordings(recordings, args, recipe) if recordings else (None, {})
    facts["maps"] = [str(path) for path in files]
    if result is not None:
        result = replace(result, warnings=(*repeated, *result.warnings))
    if maps:
        own = maps[0]
        by_maps = make_recipe(RecipeConfig(method=Method(own.method), metric=MetricKind(own.metric), speed_mps=own.speed_mps))
        warnings = () if result is None else result.warnings
        if result is not None:
            maps.append(take_map({**to_json_object(result), **merging_facts(result)}, name="the recordings"))
        result = join_finished_maps(maps, by_maps)
        result = replace(result, warnings=(*warnings, *result.warnings))
    assert result is not None
    return result, {"merged": facts}


def _is_map(path: Path) -> bool:
    return path.suffix.lower() == ".json" and not path.is_dir()


def _merge_recordings(recordings: Sequence[Recording], args: argparse.Namespace, recipe: Recipe) -> tuple[MapResult, JsonObject]:
    pool = pool_recordings(recordings)
    if len(pool.table) < MIN_ENCOUNTERS:
        raise TooFewEncountersError(n_encounters=len(pool.table), minimum=MIN_ENCOUNTERS, where=", ".join(map(str, args.inputs)))
    stationary = args.stationary or ()
    absent = absent_biobots(pool.table, stationary)
    warnings = list(pool.warnings)
    if absent:
        warnings.append(f"stationary biobots {', '.join(map(str, absent))} are in no encounter")
    kernels = choose_kernels()
    if kernels.shortfall is not None:
        warnings.append(kernels.shortfall)
    try:
        result = compute_map(pool.table, (*pool.spells, *stationary_spells(pool.table, stationary)), recipe, kernels=kernels)
    except MemoryError as error:
        raise OutOfMemoryError(n_encounters=len(pool.table)) from error
    inputs: list[JsonValue] = [
        {
            "name": recording.name,
            "n_encounters": len(recording.table),
            "from_s": recording.span_ns[0] / NS_PER_S,
            "until_s": recording.span_ns[1] / NS_PER_S,
        }
        for recording in recordings
    ]
    facts: JsonObject = {"inputs": inputs, "n_repeated": pool.n_repeated, "n_shared_landmarks": count_shared_landmarks(recordings)}
    return replace(result, warnings=(*warnings, *result.warnings)), facts


def _read_recordings(args: argparse.Namespace) -> tuple[list[Recording], list[str]]:
    inputs = [path for path in args.inputs if not _is_map(path)]
    modes: list[Path] = args.modes
    shifts: tuple[float, ...] = args.shift_s or (0.0,) * len(inputs)
    files = [path for path in inputs if not path.is_dir()]
    problems = []
    if modes and len(modes) != len(files):
        problems.append(
            f"--modes is given {len(modes)} times for {len(files)} CSV files of encounters; give one for each, in the same order, "
            "or directories with encounters.csv and modes.csv"
        )
    if len(shifts) != len(inputs):
        problems.append(f"--shift-s has {len(shifts)} values for {len(inputs)} recordings; give one for each, in the same order")
    if problems:
        raise ConfigurationError(problems)
    left = iter(modes)
    recordings, n_repeated = [], 0
    doubts: list[str] = []
    for path, shift_s in zip(inputs, shifts, strict=True):
        table, spells = _read_directory(path) if path.is_dir() else (read_encounters(path), _read_given(next(left, None)))
        if not len(table):
            raise TooFewEncountersError(n_encounters=0, minimum=1, where=str(path))
        table, n = drop_repeated(table)
        doubts += [f"{path}: {doubt}" for doubt in (*doubt_unit(table, has_flag=False), *doubt_modes(table, spells))]
        n_repeated += n
        recordings.append(shift_recording(Recording(name=str(path), table=table, spells=spells), shift_ns=round(shift_s * NS_PER_S)))
    repeat = "1 row repeats" if n_repeated == 1 else f"{n_repeated} rows repeat"
    warnings = [f"{repeat} another one of the same file, pair and times; each counts once"] if n_repeated else []
    return recordings, [*warnings, *doubts]


def _read_directory(path: Path) -> tuple[EncounterTable, tuple[ModeSpell, ...]]:
    modes = path / "modes.csv"
    return read_encounters(path / "encounters.csv"), _read_given(modes if modes.exists() else None)


def _read_given(modes: Path | None) -> tuple[ModeSpell, ...]:
    return () if modes is None else read_modes(modes)
