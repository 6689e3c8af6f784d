"""The load on a gateway, in small: whether what is measured is what is said."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from mapper.store import Store
from studies.bench_gateway import run_load
from studies.load_check import check_store


@pytest.mark.campaign
def test_a_small_load_goes_through_a_gateway_and_a_store_that_lacks_a_part_of_it_is_noticed(tmp_path: Path) -> None:
    run = run_load(tmp_path, ["--encounters", "2000", "--biobots", "32"], watches_closely=True)
    assert run.verdict.is_good
    assert run.verdict.n_found == run.verdict.n_expected == 1024, "32 biobots in 32 rounds, of which each message tells two"
    assert len(run.verdict.latency_ns) == 1024
    assert np.all(run.verdict.latency_ns > 0)

    whole, fewer, doubled = tmp_path / "store.sqlite", tmp_path / "fewer.sqlite", tmp_path / "doubled.sqlite"
    for path in (fewer, doubled):
        shutil.copy(whole, path)
    store = Store(fewer)
    with store.transaction():
        store._db.execute("DELETE FROM record WHERE id IN (SELECT id FROM record WHERE kind = 0 ORDER BY id LIMIT 3)")
    store.close()
    assert check_store(fewer, tmp_path / "timetable.npz", seen=None).n_lost == 3
    store = Store(doubled)
    with store.transaction():
        columns = "source, boot, sequence + 1000000, revision, kind, change + 1000000, body"
        query = f"INSERT INTO record (source, boot, sequence, revision, kind, change, body) SELECT {columns} FROM record WHERE kind = 0"
        store._db.execute(query + " ORDER BY id LIMIT 2")
    store.close()
    assert check_store(doubled, tmp_path / "timetable.npz", seen=None).n_duplicated == 2
