"""Cases are computed once, by real processes; each is kept when it is done; what goes wrong is told and costs nothing else."""

import importlib
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from studies.cases import Changed, Options, Study, Workers, results_of, run_cases
from studies.errors import (
    CaseFailedError,
    ChangedProgramError,
    DaskError,
    ForeignProgramError,
    JournalBusyError,
    JournalError,
    WorkerLostError,
)
from tests.studies.cases.arithmetic import SQUARES, Squared, Sum

ONE = Workers(jobs=1)
CASES = [Sum(number=number) for number in range(7)]


def content(results: Sequence[Squared]) -> list[object]:
    return [(one.number, one.root, one.rows.tolist()) for one in results]


def rows(journal: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in journal.read_text().splitlines()[1:]]


def test_two_processes_give_what_one_gives_in_the_order_of_the_cases(tmp_path: Path) -> None:
    alone = results_of(run_cases(SQUARES, CASES, Options(workers=ONE), label="sums"))
    journal = tmp_path / "new" / "squares.jsonl"
    together = results_of(run_cases(SQUARES, CASES, Options(journal=journal, workers=Workers(jobs=2)), label="sums"))
    assert [one.number for one in alone] == [0, 1, 4, 9, 16, 25, 36]
    assert content(together) == content(alone)
    assert all(one.threads == "1" for one in together)
    again = results_of(run_cases(SQUARES, CASES, Options(journal=journal, workers=Workers(jobs=2)), label="sums"))
    assert content(again) == content(alone)
    assert [one.worker for one in again] == [one.worker for one in together]
    assert len(rows(journal)) == len(CASES)


@pytest.mark.skipif(find_spec("distributed") is None, reason="the extra 'dask' is not installed")
def test_a_dask_cluster_gives_the_same(tmp_path: Path) -> None:
    options = Options(journal=tmp_path / "squares.jsonl", workers=Workers(jobs=2, dask="local"))
    finished = run_cases(SQUARES, [*CASES, Sum(number=7, how="raise")], options, label="sums")
    assert content(results_of(finished[:-1])) == content(results_of(run_cases(SQUARES, CASES, Options(workers=ONE), label="sums")))
    assert finished[-1].failure is not None
    assert all(one.result is None or one.result.threads == "1" for one in finished)


@pytest.mark.skipif(find_spec("distributed") is None, reason="the extra 'dask' is not installed")
def test_a_cluster_computes_what_this_program_would_or_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cluster is started where a module squares; the same module then cubes here."""
    distributed = importlib.import_module("distributed")
    for name, power in (("there", 2), ("here", 3)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "powers_elsewhere.py").write_text(f"def compute(case: int) -> int:\n    return case**{power}\n")
    with monkeypatch.context() as place:
        place.syspath_prepend(tmp_path / "there")
        cluster = distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0")
    monkeypatch.syspath_prepend(tmp_path / "here")
    with cluster:
        options = Options(journal=tmp_path / "powers.jsonl", workers=Workers(dask=cluster.scheduler_address))
        compute = importlib.import_module("powers_elsewhere").compute
        with pytest.raises(ForeignProgramError, match="on the whole cluster"):
            run_cases(Study(name="powers", compute=compute, result_type=int), [2, 3], options, label="powers")
        assert rows(tmp_path / "powers.jsonl") == []
        squares = replace(options, journal=None)
        assert content(results_of(run_cases(SQUARES, CASES, squares, label="sums")))[2] == (4, 2**0.5, [[2.0, 4.0], [2.0, 4.0]])


@pytest.mark.skipif(find_spec("distributed") is None, reason="the extra 'dask' is not installed")
def test_an_address_that_is_none_is_told() -> None:
    with pytest.raises(DaskError, match=r"--dask nowhere.*leave --dask out"):
        run_cases(SQUARES, CASES, Options(workers=Workers(dask="nowhere")), label="sums")


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    with pytest.raises(DaskError, match=r"biobot-gateway\[dask\]"):
        run_cases(SQUARES, CASES, Options(workers=Workers(dask="local")), label="sums")


def test_more_cases_are_added_and_a_case_given_twice_is_computed_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = Options(journal=tmp_path / "squares.jsonl", workers=ONE)
    run_cases(SQUARES, CASES[:2], options, label="sums")
    finished = run_cases(SQUARES, [CASES[3], CASES[1], CASES[3]], options, label="sums")
    assert [one.number for one in results_of(finished)] == [9, 1, 9]
    assert len(rows(tmp_path / "squares.jsonl")) == 3
    told = capsys.readouterr().err
    assert "sums: 2 of 2 cases, 1 of them before" in told
    assert "1 of 2 results belong to other cases" in told


@pytest.mark.parametrize(("how", "kind", "text"), [("raise", "ValueError", "5 is not to be squared"), ("nan", "ResultError", "JSON")])
def test_a_case_that_fails_is_written_down_and_the_others_go_on(how: str, kind: str, text: str, tmp_path: Path) -> None:
    options = Options(journal=tmp_path / "squares.jsonl", workers=ONE)
    cases = [Sum(number=5, how=how), *CASES]
    finished = run_cases(SQUARES, cases, options, label="sums")
    failure = finished[0].failure
    assert failure is not None
    assert failure.kind == kind
    assert text in failure.message
    assert "Traceback" in failure.traceback
    assert len(results_of(finished[1:])) == len(CASES)
    with pytest.raises(CaseFailedError, match=rf"1 of 8 cases failed.*number=5.*{kind}"):
        results_of(finished)
    before = rows(tmp_path / "squares.jsonl")
    assert run_cases(SQUARES, cases, options, label="sums")[0].failure == failure
    assert rows(tmp_path / "squares.jsonl") == before
    run_cases(SQUARES, cases, replace(options, retry_failed=True), label="sums")
    assert len(rows(tmp_path / "squares.jsonl")) == len(before) + 1


def test_a_process_that_dies_stops_the_study_and_what_was_done_stays(tmp_path: Path) -> None:
    options = Options(journal=tmp_path / "squares.jsonl", workers=Workers(jobs=2))
    cases = [*CASES, Sum(number=7, how="crash")]
    with pytest.raises(WorkerLostError, match="run this again"):
        run_cases(SQUARES, cases, options, label="sums")
    kept = len(rows(tmp_path / "squares.jsonl"))
    assert content(results_of(run_cases(SQUARES, CASES, options, label="sums"))) == content(
        results_of(run_cases(SQUARES, CASES, Options(workers=ONE), label="sums"))
    )
    assert len(rows(tmp_path / "squares.jsonl")) == len(CASES) >= kept


def test_a_journal_belongs_to_one_study_and_to_one_process_at_a_time(tmp_path: Path) -> None:
    options = Options(journal=tmp_path / "squares.jsonl", workers=ONE)
    run_cases(SQUARES, CASES[:1], options, label="sums")
    with pytest.raises(JournalError, match='belongs to the study "squares", wanted "cubes"'):
        run_cases(replace(SQUARES, name="cubes"), CASES, options, label="sums")

    def run_again(_: Sum) -> Squared:
        run_cases(SQUARES, CASES[:1], options, label="inner")
        raise AssertionError

    inner = Study(name="squares", compute=run_again, result_type=Squared)
    (finished,) = run_cases(inner, CASES[1:2], options, label="outer")
    assert finished.failure is not None
    assert finished.failure.kind == JournalBusyError.__name__


def test_results_of_another_program_are_refused_kept_or_computed_anew_as_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The program is a module on disk, which is changed between runs: first what it computes, then only how it is explained."""
    monkeypatch.syspath_prepend(tmp_path)
    options = Options(journal=tmp_path / "powers.jsonl", workers=ONE)
    source = '"""Powers."""\nfrom studies.errors import StudyError\ndef compute(case: int) -> int:\n    return case**{power}\n'

    def run(power: int, changed: Changed = Changed.REFUSE, extra: str = "") -> list[int]:
        (tmp_path / "powers_of_cases.py").write_text(source.format(power=power) + extra)
        importlib.invalidate_caches()
        sys.modules.pop("powers_of_cases", None)
        compute = importlib.import_module("powers_of_cases").compute
        study: Study[int, int] = Study(name="powers", compute=compute, result_type=int)
        return results_of(run_cases(study, [2, 3], replace(options, changed=changed), label="powers"))

    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert run(2) == [4, 9]
    assert run(2, extra="# a remark\n") == [4, 9]
    with pytest.raises(ChangedProgramError, match=r"2 of the 2 cases.*--changed recompute.*--changed keep"):
        run(3)
    assert run(3, Changed.KEEP) == [4, 9]
    assert run(3, Changed.RECOMPUTE) == [8, 27]
    assert run(3) == [8, 27]
    assert len(rows(tmp_path / "powers.jsonl")) == 4


def test_results_keep_every_bit_and_an_empty_array_its_shape() -> None:
    packed = json.loads(json.dumps(SQUARES.pack(SQUARES.compute(Sum(number=2)))))
    assert SQUARES.unpack(packed).root == 2**0.5
    empty = SQUARES.unpack(SQUARES.pack(SQUARES.compute(Sum(number=3)))).rows
    assert empty.shape == (0, 2)
    assert empty.dtype == np.float64
