"""What released versions left behind is still read, and tells the same (docs/formats.md)."""

import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

import pytest

from gateway.config_loading import load_gateway_config
from gateway.journal_file import schema as journal_schema
from mapper import store_file
from mapper.config import load_mapper_config
from scripts.release.formats import FROZEN, Told, tell_journal, tell_store, unpack_frozen
from scripts.release.freeze_formats import TELLERS, main, tell_frozen
from scripts.release.version import read_version

RELEASED = sorted(path for path in FROZEN.iterdir() if path.name[0].isdigit())
BEFORE = FROZEN / "before-0.1.0"
OLD: dict[str, Callable[[Path], Told]] = {"journal": tell_journal, "store": tell_store}

CASES = [pytest.param(folder, name, id=f"{folder.name}-{name}") for folder in RELEASED for name in TELLERS]
OLD_CASES = [pytest.param(path, id=path.name) for path in sorted(BEFORE.glob("*.xz"))]


@pytest.mark.parametrize(("folder", "name"), CASES)
def test_what_a_released_version_left_behind_tells_what_it_told_then(folder: Path, name: str) -> None:
    facts = json.loads((folder / "facts.json").read_text())
    told = tell_frozen(folder, name)
    assert told.count > 0
    assert asdict(told) == facts[name]


@pytest.mark.parametrize("path", OLD_CASES)
def test_schemas_that_were_never_released_are_brought_up_to_date_with_all_they_have(path: Path, tmp_path: Path) -> None:
    """Each was written by the program of its day: a gateway and a mapper that ran together."""
    name = path.name.removesuffix(".sqlite.xz")
    file = unpack_frozen(path, tmp_path)
    told = OLD[name.split("-")[0]](file)
    assert told.count > 0
    assert asdict(told) == json.loads((BEFORE / "facts.json").read_text())[name]
    assert OLD[name.split("-")[0]](file) == told, "and a second time, when it is up to date"


def test_every_schema_that_the_programs_know_is_frozen(tmp_path: Path) -> None:
    files = [*BEFORE.glob("*.xz"), *(folder / f"{name}.sqlite.xz" for folder in RELEASED for name in ("gateway", "mapper"))]
    frozen: dict[str, set[int]] = {"journal": set(), "store": set()}
    for path in files:
        kind = "journal" if path.name.startswith(("journal", "gateway")) else "store"
        with closing(sqlite3.connect(unpack_frozen(path, tmp_path))) as database:
            frozen[kind].add(database.execute("PRAGMA user_version").fetchone()[0])
    assert frozen == {"journal": set(range(1, journal_schema.SCHEMA_VERSION + 1)), "store": set(range(1, store_file.SCHEMA_VERSION + 1))}


@pytest.mark.parametrize("folder", RELEASED, ids=lambda folder: folder.name)
def test_journal_and_store_of_a_released_site_tell_the_same_encounters(folder: Path) -> None:
    assert tell_frozen(folder, "gateway.sqlite") == tell_frozen(folder, "mapper.sqlite")


@pytest.mark.parametrize("folder", RELEASED, ids=lambda folder: folder.name)
def test_the_configuration_of_a_released_version_is_taken_key_by_key(folder: Path, tmp_path: Path) -> None:
    """What `config print-default` printed: every key with its default."""
    gateway, mapper = (unpack_frozen(folder / f"{name}.toml.xz", tmp_path) for name in ("gateway", "mapper"))
    assert load_gateway_config(toml_path=gateway, environment={}, needs_radio=False).site == "local"
    assert load_mapper_config(mapper, environment={}, flags={}).serve.port > 0


def test_the_version_in_this_tree_is_frozen() -> None:
    """Where this fails, the version number was raised: `make formats` keeps what the new version leaves behind."""
    assert read_version() in {folder.name for folder in RELEASED}


def test_what_is_frozen_is_never_written_over(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--out", str(RELEASED[0])]) == 2
    assert "set a new version first" in capsys.readouterr().err


def test_all_that_is_frozen_stays_small() -> None:
    assert sum(path.stat().st_size for path in FROZEN.rglob("*") if path.is_file()) <= 100_000 + 200_000 * len(RELEASED)
