"""What a sweep is: a TOML file with a grid of parameters, a list of cases, and seeds; checked whole before anything is computed."""

import hashlib
import itertools
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Annotated, Any

import msgspec

from firmware_protocol.configuration import load_configuration
from firmware_protocol.errors import ConfigurationError
from mapper.config import RecipeConfig
from simulator.config import MotionConfig, RunConfig
from simulator.errors import SimulationError
from simulator.sensed_run import sensing_config
from simulator.setting import choose_setting
from studies.sweep.case import Cell, SweepCase, Value, arena_files, recipe_config, run_config
from studies.trials import HELD_OUT_SEED, SETTINGS

ENVIRONMENT_PREFIX = "BIOBOT_SWEEP"
MAX_CASES = 1_000_000
_MAX_BYTES = 1024 * 1024

# Keys of `biobot-sim run` that say where its files go and who looks on; the seed is the sweep's own.
_NO_PART_OF_A_RUN = {"seed", "out", "force", "snapshot", "snapshot_every_s", "watch", "watch_speed", "position_samples"}


def _keys_of(config: type[msgspec.Struct], *, as_list: bool, leave_out: frozenset[str] = frozenset()) -> type[msgspec.Struct]:
    """Make a Struct of the keys of a configuration, all of them optional; where ``as_list``, each holds a list of values."""
    fields: list[tuple[str, Any, Any]] = []
    for one in msgspec.structs.fields(config):
        if one.name in leave_out:
            continue
        if one.type is MotionConfig:
            inner = _keys_of(MotionConfig, as_list=as_list)
            fields.append((one.name, inner, msgspec.field(default_factory=inner)))
            continue
        wanted = Annotated[tuple[one.type, ...], msgspec.Meta(min_length=1)] if as_list else one.type  # type: ignore[name-defined]  # made here
        fields.append((one.name, wanted | msgspec.UnsetType, msgspec.UNSET))
    if config is RunConfig:
        name = Annotated[tuple[str, ...], msgspec.Meta(min_length=1)] if as_list else str
        fields.append(("setting", name | msgspec.UnsetType, msgspec.UNSET))
    kind = f"{'Grid' if as_list else 'Case'}{config.__name__}"
    return msgspec.defstruct(kind, fields, frozen=True, kw_only=True, forbid_unknown_fields=True, module=__name__)


def _table(name: str, *, as_list: bool) -> type[msgspec.Struct]:
    run = _keys_of(RunConfig, as_list=as_list, leave_out=frozenset(_NO_PART_OF_A_RUN))
    recipe = _keys_of(RecipeConfig, as_list=as_list)
    fields = [("run", run, msgspec.field(default_factory=run)), ("recipe", recipe, msgspec.field(default_factory=recipe))]
    return msgspec.defstruct(name, fields, frozen=True, kw_only=True, forbid_unknown_fields=True, module=__name__)


GridTable = _table("GridTable", as_list=True)
CaseTable = _table("CaseTable", as_list=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """A sweep whose every cell has been checked."""

    name: str
    cells: tuple[Cell, ...]
    seeds: range
    files: Mapping[str, str]

    def cases(self) -> list[SweepCase]:
        """Return all cases: every cell with the first seed, then every cell with the next."""
        return [
            SweepCase(cell=dict(cell), seed=seed, files={path: self.files[path] for path in arena_files(cell)})
            for seed in self.seeds
            for cell in self.cells
        ]


def load_sweep(path: Path, *, flags: Mapping[str, object]) -> Sweep:
    """Read a sweep from its TOML file, ``BIOBOT_SWEEP__...`` variables and flags.

    Raises
    ------
    ConfigurationError
        With every fault: of the file's keys, then of cells that make no run.
    """
    config_type = msgspec.defstruct(
        "SweepConfig",
        [
            ("name", Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")]),
            ("repeats", Annotated[int, msgspec.Meta(ge=1, le=MAX_CASES)], 20),
            ("first_seed", Annotated[int, msgspec.Meta(ge=0, le=2**62)], HELD_OUT_SEED),
            ("grid", GridTable, msgspec.field(default_factory=GridTable)),
            ("cases", tuple[CaseTable, ...], ()),  # type: ignore[valid-type]  # made here
        ],
        frozen=True,
        kw_only=True,
        forbid_unknown_fields=True,
    )
    config: Any = load_configuration(
        config_type,
        toml_text=_read(path),
        toml_name=str(path),
        environment=os.environ,
        environment_prefix=ENVIRONMENT_PREFIX,
        flags=flags,
    )
    grid = flatten(config.grid)
    listed = [flatten(one) for one in config.cases] or [{}]
    problems = [
        f"{path}: {key} stands in cases[{number}] and in grid; give it in one of them"
        for number, one in enumerate(listed)
        for key in sorted(one.keys() & grid.keys())
    ]
    problems += [
        f"{path}: {key} in grid holds {value!r} {values.count(value)} times; give each value once"
        for key, values in grid.items()
        for number, value in enumerate(values)
        if values.count(value) > 1 and values.index(value) == number
    ]
    problems += [
        f"{path}: cases[{number}] says the same as cases[{listed.index(one)}]; leave it out"
        for number, one in enumerate(listed)
        if listed.index(one) < number
    ]
    n_cases = len(listed) * prod(map(len, grid.values())) * config.repeats
    if n_cases > MAX_CASES:
        problems.append(f"{path}: grid, cases and repeats make {n_cases} cases; wanted at most {MAX_CASES}")
    if problems:
        raise ConfigurationError(problems)
    cells = tuple(one | chosen for one in listed for chosen in expand(grid))
    problems = [f"{path}: {problem}" for problem in _check(cells, seed=config.first_seed)]
    if problems:
        raise ConfigurationError(problems)
    files = {file: hashlib.sha256(Path(file).read_bytes()).hexdigest() for cell in cells for file in arena_files(cell)}
    seeds = range(config.first_seed, config.first_seed + config.repeats)
    return Sweep(name=config.name, cells=cells, seeds=seeds, files=files)


def expand(grid: Mapping[str, list[Value]]) -> Iterator[dict[str, Value]]:
    """Yield every combination of one value for each key, the last key changing fastest."""
    for values in itertools.product(*grid.values()):
        yield dict(zip(grid.keys(), values, strict=True))


def flatten(table: msgspec.Struct, prefix: str = "") -> dict[str, Any]:
    """Return what is set in a table and in those within it, by dotted key, as JSON holds it."""
    found: dict[str, Any] = {}
    for name in table.__struct_fields__:
        value = getattr(table, name)
        if isinstance(value, msgspec.Struct):
            found |= flatten(value, f"{prefix}{name}.")
        elif value is not msgspec.UNSET:
            found[f"{prefix}{name}"] = msgspec.to_builtins(value)
    return found


def _check(cells: tuple[Cell, ...], *, seed: int) -> list[str]:
    """Say what is wrong with cells, each run and each recipe looked at once."""
    problems: list[str] = []
    seen: set[str] = set()
    for cell in cells:
        for name, check in (("run", _check_run), ("recipe", _check_recipe)):
            told = ", ".join(f"{key} = {value!r}" for key, value in cell.items() if key.startswith(f"{name}."))
            if told not in seen:
                seen.add(told)
                problem = check(cell, seed)
                problems += [f"{told or name + ' (nothing given)'}: {problem}"] if problem else []
    return problems


def _check_run(cell: Cell, seed: int) -> str | None:
    name = cell.get("run.setting")
    if name is not None:
        others = [key for key in cell if key.startswith("run.") and key != "run.setting"]
        if others:
            return f"a setting says all of a run; leave out {', '.join(others)}, or give preset and scenario instead of setting"
        return None if name in SETTINGS else f"no setting is called {name!r}; known: {', '.join(SETTINGS)}"
    try:
        config = run_config(cell, seed=seed)
        setting = choose_setting(config)
        if config.sensing == "beacon":
            sensing_config(config, setting)
    except (msgspec.ValidationError, ConfigurationError, SimulationError) as error:
        return str(error)
    return None


def _check_recipe(cell: Cell, _: int) -> str | None:
    try:
        recipe_config(cell)
    except msgspec.ValidationError as error:
        return str(error)
    return None


def _read(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
        if len(content) > _MAX_BYTES:
            raise ConfigurationError([f"{path}: larger than {_MAX_BYTES} bytes; give the TOML file of a sweep"])
        return content.decode()
    except OSError as error:
        raise ConfigurationError([f"{path}: cannot be read: {error.strerror or error}; give the path of a TOML file"]) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError([f"{path}: not UTF-8 text (byte {error.start}); give the TOML file of a sweep"]) from error
