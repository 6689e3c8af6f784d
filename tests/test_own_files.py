"""Whoever gives a program the wrong one of our files is told which it is, and what reads it. The files are those of a released version."""

import itertools
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from firmware_protocol.own_files import AUDIT_TABLE, HEAD_BYTES, JOURNAL_TABLE, MODES, OwnFile, tell_own_file
from gateway.__main__ import main as gateway
from mapper.__main__ import main as mapper
from scripts.release.formats import FROZEN, unpack_frozen

KINDS = {
    "gateway.sqlite": "a gateway's journal",
    "mapper.sqlite": "a mapper's store",
    "line.biorec": "a recording of a line",
    "map.json": "a map",
    "tokens.json": "a file of tokens",
    "gateway.toml": "a configuration",
    "roster.txt": "a roster",
    "ca.pem": "a certificate or a key",
    "encounters.csv": "a table of encounters",
}
READERS: dict[str, tuple[Callable[[list[str]], int], list[str], str]] = {
    "journal": (gateway, ["journal", "check"], "gateway.sqlite"),
    "export": (gateway, ["journal", "export", "--csv", "{out}"], "gateway.sqlite"),
    "audit": (gateway, ["audit", "verify"], "gateway.sqlite"),
    "replay": (gateway, ["replay"], "line.biorec"),
    "store": (mapper, ["serve", "--check-config", "--port", "0", "--store"], "mapper.sqlite"),
    "tokens": (mapper, ["tokens", "list", "--tokens"], "tokens.json"),
    "run": (mapper, ["run"], "encounters.csv"),
}
_CONFUSED = [(reader, kind) for reader, kind in itertools.product(READERS, KINDS) if READERS[reader][2] != kind]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One of each kind."""
    place = tmp_path_factory.mktemp("files")
    assert gateway(["certs", "init", str(place / "pki")]) == 0
    released = FROZEN / "0.1.0"
    for frozen in [*released.glob("*.xz"), *(released / "run").glob("*.csv.xz")]:
        unpack_frozen(frozen, place)
    # The frozen configuration is one that somebody wrote; what `config print-default` begins with is known.
    (place / "gateway.toml").write_text("# Configuration of biobot-gateway: every key with its default.\n[link]\nidle_s = \n")
    return {name: next(place.rglob(name)) for name in KINDS}


@pytest.mark.parametrize(("reader", "kind"), _CONFUSED)
def test_the_wrong_file_is_told_for_what_it_is(
    files: dict[str, Path], tmp_path: Path, reader: str, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main, words, _ = READERS[reader]
    arguments = [word.replace("{out}", str(tmp_path / "out.csv")) for word in words]
    before = files[kind].read_bytes()
    assert main([*arguments, str(files[kind])]) in {1, 2}
    told = capsys.readouterr().err
    own = tell_own_file(before[:HEAD_BYTES])
    assert own is not None
    assert f"{KINDS[kind]}: {own.use}" in told
    assert files[kind].read_bytes() == before
    assert not list(tmp_path.iterdir())


def test_a_store_that_a_mapper_keeps_for_itself_is_told_for_what_it_is(
    files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = tmp_path / "mapper.sqlite"
    store.write_bytes(files["mapper.sqlite"].read_bytes())
    with closing(sqlite3.connect(store, isolation_level=None)) as connection:
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        connection.execute("BEGIN EXCLUSIVE")
        assert gateway(["audit", "verify", str(store)]) == 1
    assert "is no journal but a mapper's store" in capsys.readouterr().err


def test_a_file_is_none_of_ours_where_nothing_says_so_and_a_configuration_is_told_the_file_it_got(
    files: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    for head in (b"", b"{", b"a diary", b"SQLite format 3\0" + bytes(84), b"\x1f\x8b"):
        assert tell_own_file(head) is None
    for command in ("run", "router"):
        assert gateway([command, "--check-config", "--config", str(files["gateway.sqlite"])]) == 2
        assert "gateway.sqlite: is a gateway's journal: " in (told := capsys.readouterr().err)
        assert "give the path of a TOML file" in told
    for main, words in ((gateway, ["run", "--check-config"]), (mapper, ["serve", "--check-config"])):
        assert main([*words, "--config", str(files["map.json"])]) == 2
        assert "not valid TOML" in (told := capsys.readouterr().err)
        assert "it is a map: `biobot-mapper merge`" in told


def test_the_folder_of_a_run_leads_to_its_encounters(files: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert mapper(["run", str(files["encounters.csv"].parent)]) == 1
    assert f"is a directory; give {files['encounters.csv']}" in capsys.readouterr().err


def test_tables_that_our_programs_export_are_known(files: dict[str, Path], tmp_path: Path) -> None:
    journal = str(files["gateway.sqlite"])
    assert gateway(["journal", "export", journal, "--kind", "all", "--csv", str(tmp_path / "j.csv")]) == 0
    assert gateway(["audit", "export", journal, "--csv", str(tmp_path / "a.csv")]) == 0
    assert gateway(["audit", "export", journal, "--json", str(tmp_path / "a.json")]) == 0
    kinds: dict[str, OwnFile | None] = {path.name: tell_own_file(path.read_bytes()[:HEAD_BYTES]) for path in tmp_path.iterdir()}
    assert kinds.pop("a.csv") is kinds.pop("a.json") is AUDIT_TABLE
    assert len(kinds) == 4
    assert set(kinds.values()) == {JOURNAL_TABLE}
    assert tell_own_file(files["encounters.csv"].with_name("modes.csv").read_bytes()[:HEAD_BYTES]) is MODES
