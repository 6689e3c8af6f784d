"""The ledger finds what is missing and what is there twice."""

import json
from pathlib import Path
from typing import Any

from studies.ledger import check_ledger


def truth(directory: Path, encounters: list[tuple[float, float, int, int]]) -> Path:
    """Write a truth in which both sides of every encounter reported it."""
    (directory / "run.json").write_text(json.dumps({"t0_wall_ns": 1_000_000_000_000}))
    lines = [f"{start},{end},{a},{b}" for start, end, a, b in encounters]
    (directory / "encounters.csv").write_text("\n".join(["t_start_s,t_end_s,id1,id2", *lines]) + "\n")
    reports = [f"{node},1,0,{peer},{start},{end},0,1" for start, end, a, b in encounters for node, peer in ((a, b), (b, a))]
    header = "node,boot,sequence,peer,t_start_s,t_end_s,is_ongoing,is_acknowledged"
    (directory / "reported.csv").write_text("\n".join([header, *reports]) + "\n")
    return directory


def record(start_s: float, end_s: float, a: int, b: int, *, is_void: bool = False) -> dict[str, Any]:
    zero = 1_000_000_000_000
    return {
        "node_a": a, "node_b": b, "t_start_wall_ns": zero + round(start_s * 1e9), "t_end_wall_ns": zero + round(end_s * 1e9),
        "error_ns": 10_000_000, "is_void": is_void,
    }  # fmt: skip


def test_a_record_for_each_encounter_within_the_error_is_complete(tmp_path: Path) -> None:
    ledger = check_ledger(truth(tmp_path, [(1, 2, 3, 4), (5, 6, 3, 4)]), [record(1.005, 2.005, 3, 4), record(5, 6, 3, 4)])

    assert ledger.is_complete
    assert (ledger.n_encounters, ledger.n_reports, ledger.n_records) == (2, 4, 2)


def test_a_missing_record_is_named_for_both_reporters(tmp_path: Path) -> None:
    ledger = check_ledger(truth(tmp_path, [(1, 2, 3, 4), (5, 6, 3, 4)]), [record(1, 2, 3, 4)])

    assert ledger.missing == ((3, 4, 5.0), (3, 4, 5.0))


def test_two_records_for_one_encounter_are_doubled_unless_one_is_void(tmp_path: Path) -> None:
    directory = truth(tmp_path, [(1, 2, 3, 4)])

    assert check_ledger(directory, [record(1, 2, 3, 4), record(1.001, 2, 3, 4)]).doubled == ((3, 4, 1.0),)
    assert check_ledger(directory, [record(1, 2, 3, 4), record(1.001, 2, 3, 4, is_void=True)]).is_complete


def test_a_record_of_a_pair_that_never_met_is_reported(tmp_path: Path) -> None:
    assert not check_ledger(truth(tmp_path, [(1, 2, 3, 4)]), [record(1, 2, 3, 4), record(1, 2, 3, 9)]).is_complete


def test_two_encounters_in_one_record_are_complete(tmp_path: Path) -> None:
    assert check_ledger(truth(tmp_path, [(1, 2, 3, 4), (2.001, 3, 3, 4)]), [record(1, 3, 3, 4)]).is_complete
