"""The store's file over versions of the program, and the last finished map in it."""

import os
import signal
import sqlite3
import subprocess
import sys
import textwrap
from contextlib import closing
from pathlib import Path

from firmware_protocol.contract.records import JournalRecord, encode_journal_record
from firmware_protocol.own_files import STORE_ID
from mapper.store import KeptMap, Store
from mapper.store_file import SCHEMA_VERSION
from tests.mapper.fake_gateway import BOOT, batch, encounter, mode

# As version 1 of the schema was when stores were first made with it.
_SCHEMA_1 = """
CREATE TABLE gateway (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE);
CREATE TABLE source (id INTEGER PRIMARY KEY, gateway INTEGER NOT NULL REFERENCES gateway (id), journal TEXT NOT NULL,
  watermark INTEGER NOT NULL, UNIQUE (gateway, journal));
CREATE TABLE span (source INTEGER NOT NULL REFERENCES source (id), first INTEGER NOT NULL, last INTEGER NOT NULL,
  PRIMARY KEY (source, first)) WITHOUT ROWID;
CREATE TABLE record (id INTEGER PRIMARY KEY, gateway INTEGER NOT NULL REFERENCES gateway (id), boot INTEGER NOT NULL,
  sequence INTEGER NOT NULL, revision INTEGER NOT NULL, kind INTEGER NOT NULL, change INTEGER NOT NULL, body BLOB NOT NULL,
  UNIQUE (gateway, boot, sequence));
CREATE UNIQUE INDEX record_by_change ON record (kind, change);
INSERT INTO gateway VALUES (1, 'gateway1');
INSERT INTO source VALUES (1, 1, 'journal1', 2);
INSERT INTO span VALUES (1, 5, 5);
"""
_MAP = KeptMap(made_by="one", change=3, document=b"\x00map")


def write_version_1(path: Path) -> None:
    records: list[tuple[int, JournalRecord]] = [(0, encounter(1)), (1, mode(2, node=2**64 - 1, t_ns=(0, None))), (0, encounter(5))]
    with closing(sqlite3.connect(path)) as database:
        database.executescript(f"PRAGMA journal_mode = WAL; PRAGMA application_id = {STORE_ID}; PRAGMA user_version = 1;{_SCHEMA_1}")
        for change, (kind, record) in enumerate(records, start=1):
            row = (change, 1, BOOT, record.sequence, record.revision, kind, change, encode_journal_record(record))
            database.execute("INSERT INTO record VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)
        database.commit()


def test_a_store_of_the_first_version_is_brought_up_to_date_with_all_it_has(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    write_version_1(path)
    for _ in range(2):
        with closing(Store(path)) as store:
            assert store.n_encounters == 2
            assert store.first_hole(gateway="gateway1", journal="journal1", head_offset=5) == (3, 4)
            assert [record.offset for record in store.encounters(after=0, limit=10).records] == [1, 5]
            assert [record.node for record in store.latest_modes()] == [2**64 - 1]
            assert store.progress.change == 3
            assert store.kept_map(made_by="one") in {None, _MAP}
            store.keep_map(_MAP)
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA user_version").fetchone() == (SCHEMA_VERSION,)


def test_records_that_journals_of_one_gateway_number_alike_are_all_kept_and_stay_whose_they_are(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    write_version_1(path)
    # Of a journal whose start fell into the same second; version 1 took this for a correction of the other's first record.
    other: JournalRecord = encounter(1, journal="journal2", revision=1, nodes=(8, 9))
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE record SET revision = 1, change = 4, body = ? WHERE sequence = 1", (encode_journal_record(other),))
        database.commit()
    with closing(Store(path)) as store:
        applied = store.apply([batch([encounter(1)]), batch([other, encounter(2, journal="journal2")], journal="journal2")])
        assert (applied.n_new, applied.n_revised, applied.n_repeated) == (2, 0, 1)
    for _ in range(2):
        with closing(Store(path)) as store:
            records = store.encounters(after=0, limit=10).records
            assert {record.identity: record.node_a for record in records} == {
                ("gateway1", "journal1", BOOT, 1): 1,
                ("gateway1", "journal1", BOOT, 5): 1,
                ("gateway1", "journal2", BOOT, 1): 8,
                ("gateway1", "journal2", BOOT, 2): 1,
            }
            assert [record.node for record in store.latest_modes()] == [2**64 - 1]
            assert store.n_encounters == 4
            assert store.watermark(gateway="gateway1", journal="journal2") == 2
            assert store.first_hole(gateway="gateway1", journal="journal1", head_offset=5) == (3, 4)


def test_killed_while_it_is_brought_up_to_date_a_store_is_of_one_version_or_the_other(tmp_path: Path) -> None:
    """What is done in one transaction is done whole; here the last step before its end is left out."""
    path = tmp_path / "store.db"
    write_version_1(path)
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("BEGIN IMMEDIATE")
        database.execute("CREATE TABLE finished_map (id INTEGER)")
        database.execute("PRAGMA user_version = 2")
    with closing(Store(path)) as store:
        assert store.n_encounters == 2
        store.keep_map(_MAP)


def test_a_kept_map_comes_back_only_to_what_made_it(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    with closing(Store(path)) as store:
        assert store.kept_map(made_by="one") is None
        store.keep_map(KeptMap(made_by="one", change=1, document=b"before"))
        store.keep_map(_MAP)
    with closing(Store(path)) as store:
        assert store.kept_map(made_by="one") == _MAP
        assert store.kept_map(made_by="another recipe") is None
        store.keep_map(KeptMap(made_by="another recipe", change=4, document=b""))
        assert store.kept_map(made_by="one") is None


def test_killed_while_maps_are_kept_the_store_opens_with_a_whole_one(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    program = """
        import sys
        from pathlib import Path
        from mapper.store import KeptMap, Store
        from tests.mapper.fake_gateway import batch, encounter
        store = Store(Path(sys.argv[1]))
        change = 0
        while True:
            change += 1
            store.apply([batch([encounter(change)])])
            store.keep_map(KeptMap(made_by="one", change=change, document=bytes([change % 251]) * 200_000))
            print(change, flush=True)
    """
    child = subprocess.Popen([sys.executable, "-c", textwrap.dedent(program), str(path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    for line in child.stdout:
        if int(line) >= 60:
            break
    os.kill(child.pid, signal.SIGKILL)
    told = max([60, *(int(number) for number in child.stdout.read().split())])
    child.wait()
    child.stdout.close()
    with closing(Store(path)) as store:
        kept = store.kept_map(made_by="one")
        assert kept is not None
        assert told <= kept.change <= store.n_encounters == store.progress.change
        assert kept.document == bytes([kept.change % 251]) * 200_000
        assert store.apply([batch([encounter(kept.change)])]).n_repeated == 1
