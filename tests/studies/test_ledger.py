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


def truth_with_ticks(directory: Path, encounters: list[tuple[float, float, int, int]]) -> Path:
    """Do as ``truth``, of backpacks that tell their ticks, which are those of the run."""
    path = truth(directory, encounters) / "reported.csv"
    header, *rows = path.read_text().splitlines()
    ticks = [",".join(str(round(float(time) * 1000)) for time in row.split(",")[4:6]) for row in rows]
    path.write_text("\n".join([f"{header},start_ms,end_ms", *(f"{row},{more}" for row, more in zip(rows, ticks, strict=True))]) + "\n")
    return directory


def record(
    start_s: float, end_s: float, a: int, b: int, *, is_void: bool = False, ticks: dict[int, tuple[int, int]] | None = None
) -> dict[str, Any]:
    zero = 1_000_000_000_000
    own = [{"node": node, "boot": 1, "start_ms": first, "end_ms": last} for node, (first, last) in (ticks or {}).items()]
    return {
        "node_a": a, "node_b": b, "t_start_wall_ns": zero + round(start_s * 1e9), "t_end_wall_ns": zero + round(end_s * 1e9),
        "error_ns": 10_000_000, "is_void": is_void, "own_clocks": own,
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


def test_a_report_is_known_by_its_own_clock_however_wrong_it_is_dated(tmp_path: Path) -> None:
    """Both sides' ticks are those of the run, in ms; the record of the one is 9 s late."""
    directory = truth_with_ticks(tmp_path, [(1, 2, 3, 4), (5, 6, 3, 4)])
    early, late = record(1, 2, 3, 4, ticks={3: (1000, 2000), 4: (1000, 2000)}), record(14, 15, 3, 4, ticks={3: (5000, 6000)})
    found = check_ledger(directory, [early, late])
    assert (found.missing, found.doubled, found.misdated) == (((3, 4, 5.0),), (), ((3, 4, 5.0),)), "of 4 nothing is there"
    whole = record(14, 15, 3, 4, ticks={3: (5000, 6000), 4: (5000, 6000)})
    assert check_ledger(directory, [early, whole]).is_complete


def test_a_report_that_was_told_to_two_gateways_is_one_where_they_are_joined_and_else_two(tmp_path: Path) -> None:
    directory = truth_with_ticks(tmp_path, [(1, 2, 3, 4)])
    ticks = {3: (1000, 2000), 4: (1000, 2000)}
    apart = [record(1, 2, 3, 4, ticks=ticks), record(9, 10, 3, 4, ticks=ticks)]
    assert check_ledger(directory, apart).doubled == ((3, 4, 1.0),)
    names = [{"gateway": "a", "journal": "j", "boot": 1, "sequence": 0}, {"gateway": "b", "journal": "j", "boot": 1, "sequence": 0}]
    joint = {
        "is_counted": True,
        "t_start_wall_ns": apart[0]["t_start_wall_ns"],
        "t_end_wall_ns": apart[0]["t_end_wall_ns"],
        "records": names,
    }
    found = check_ledger(directory, [{**one, "joint": joint} for one in apart])
    assert found.is_complete
    assert found.n_records == 1


def test_two_halves_of_an_encounter_that_no_tick_connects_are_doubled(tmp_path: Path) -> None:
    directory = truth_with_ticks(tmp_path, [(1, 2, 3, 4), (3, 4, 3, 4)])
    halves = [record(1, 4, 3, 4, ticks={3: (1000, 4000)}), record(1, 2, 3, 4, ticks={4: (1000, 2000)})]
    found = check_ledger(directory, [*halves, record(3, 4, 3, 4, ticks={4: (3000, 4000)})])
    assert (found.missing, set(found.doubled)) == ((), {(3, 4, 1.0), (3, 4, 3.0)})


def test_an_encounter_at_ticks_that_nobody_reported_is_told(tmp_path: Path) -> None:
    directory = truth_with_ticks(tmp_path, [(1, 2, 3, 4)])
    real = record(1, 2, 3, 4, ticks={3: (1000, 2000), 4: (1000, 2000)})
    assert len(check_ledger(directory, [real, record(1, 2, 3, 4, ticks={3: (1200, 2500)})]).doubled) == 1


def test_of_reports_of_two_starts_in_one_encounter_those_whose_ticks_are_not_told_go_by_time(tmp_path: Path) -> None:
    directory = truth_with_ticks(tmp_path, [(1, 2, 3, 4)])
    of_next_start = record(1, 2, 3, 4, ticks={3: (0, 100), 4: (1000, 2000)})
    of_next_start["own_clocks"][0]["boot"] = 2
    assert not check_ledger(directory, [of_next_start]).missing


def test_of_a_report_that_no_gateway_has_acknowledged_it_is_enough_that_the_encounter_is_there(tmp_path: Path) -> None:
    """The swarm ended before it came through."""
    directory = truth_with_ticks(tmp_path, [(1, 2, 3, 4), (5, 6, 3, 4)])
    path = directory / "reported.csv"
    header, first, of_4, *others = path.read_text().splitlines()
    path.write_text(
        "\n".join([header, first, of_4.replace(",0,1,1000", ",0,0,1000"), *(one.replace(",0,1,5000", ",0,0,5000") for one in others)])
    )
    one_sided = [record(1, 2, 3, 4, ticks={3: (1000, 2000)})]
    assert check_ledger(directory, one_sided).missing == ((3, 4, 5.0), (3, 4, 5.0))
